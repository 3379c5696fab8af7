//! The validated, immutable [`Scene`] in world space and linear light, and glTF in and out.
//!
//! Does not know patches, rays or trees. Only the [`gltf`] module knows the file format.

pub mod builder;
pub mod camera;
pub mod gltf;
pub mod hash;
pub mod id;
pub mod light;
pub mod lobe;
pub mod material;
mod normal_map;
pub mod photometry;
pub mod progress;
pub mod quantity;
pub mod scene;
pub mod side;
pub mod texture;
pub mod union;

pub use camera::{Camera, Film, Projection};
pub use hash::SceneHash;
pub use id::{MaterialId, SurfaceId, TextureId, TriangleId};
pub use light::{PunctualKind, PunctualLight, Sky, SkyImage};
pub use lobe::Lobe;
pub use material::{AlphaMode, Material, MaterialReading, SurfacePoint, Transmission};
pub use photometry::{Photometry, PhotometryError};
pub use progress::{Cancelled, Progress, Silent};
pub use quantity::{Irradiance, Radiance, Radiosity, Rgb};
pub use scene::{BRIGHTEST, Barycentric, Scene, SceneIssue, SceneParts, Surface, Triangle, Vertex};
pub use side::Side;
pub use texture::{Texture, TextureRef, TextureTransform, Wrap};
pub use union::Union;
