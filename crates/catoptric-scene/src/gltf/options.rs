//! What a file may cost at most.

/// Limits that keep a hostile or broken file from taking memory or time.
#[derive(Clone, Debug)]
pub struct LoadOptions {
    /// Bytes of the file and of all files it names, together.
    pub max_file_bytes: u64,
    /// Estimated memory of the parsed JSON, bytes.
    pub max_json_memory: u64,
    /// Triangles, instances multiplied out.
    pub max_triangles: u64,
    /// Texels of all decoded images, together.
    pub max_texture_pixels: u64,
    /// Nodes of the scene.
    pub max_nodes: usize,
    /// Surfaces: primitives times nodes.
    pub max_surfaces: usize,
    /// Depth of the node hierarchy.
    pub max_node_depth: usize,
    /// Texts of photometric files (IES LM-63) by the name of the light or of its node; they become part of the asset.
    pub photometry: Vec<(String, String)>,
}

impl Default for LoadOptions {
    fn default() -> Self {
        Self {
            max_file_bytes: 4 << 30,
            max_json_memory: 2 << 30,
            max_triangles: 10_000_000,
            max_texture_pixels: 1 << 28,
            max_nodes: 1_000_000,
            max_surfaces: 1_000_000,
            max_node_depth: 1_000,
            photometry: Vec::new(),
        }
    }
}
