//! glTF 2.0 in and out: the only code that knows the file format.
//!
//! [`load`] reads a `.gltf` or `.glb` file in three steps. The *container* step reads every file it names
//! into one self-contained [`Asset`] (JSON and one blob of bytes). The *scene* step reads the asset's JSON
//! through typed look-ups that report every problem with its place, and builds a validated
//! [`Scene`](crate::Scene) in world space. Because both steps are separate, a scene that was
//! written with [`Asset::to_glb`] loads to the same bits.
//!
//! Nothing here trusts the file: each index, range, count and depth is checked before it is used, and the
//! work is limited by [`LoadOptions`]. The `gltf` crate writes the container; its reader is not used, since
//! it panics on malformed accessors and follows paths out of the folder.

mod accessor;
mod animation;
mod append;
mod asset;
mod camera;
mod clean;
mod container;
mod deform;
mod document;
mod embed;
mod extension;
mod light;
mod load;
mod material;
mod mesh;
mod node;
mod options;
mod origin;
mod place;
mod report;
mod solid;
mod spec_gloss;
mod survey;
mod texture;
mod uri;

pub use animation::AnimatedCameras;
pub use append::{AppendError, DisplayPrimitive};
pub use asset::Asset;
pub use load::{Described, Loaded, Unread, load, load_asset, open};
pub use options::LoadOptions;
pub use report::{LoadError, Problem, Warning};
