//! Pass two from end to end.

use catoptric_image::Image;
use catoptric_scene::{Camera, Cancelled, Progress};
use catoptric_solution::{Quality, Solution};
use catoptric_trace::Tracer;
use catoptric_trace::walk::split::SplitParams;

/// Parameters of pass two.
#[derive(Clone, Debug, PartialEq)]
pub struct RenderParams {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Limits of the eye's walk.
    pub walk: SplitParams,
    /// Seed of all sequences.
    pub seed: u32,
    /// Write the light layers and the data layers (albedo, normal, depth, ids) beside the beauty.
    pub layers: bool,
}

impl RenderParams {
    /// The budgets of a quality.
    pub fn for_quality(_quality: Quality, width: usize, height: usize) -> Self {
        Self { width, height, walk: SplitParams::default(), seed: 0, layers: false }
    }
}

/// What pass two did.
#[derive(Clone, Debug, Default)]
pub struct RenderReport {
    /// Eye rays, one per sample of a pixel.
    pub samples: u64,
    /// Pixels that got more than the first samples.
    pub refined_pixels: u64,
}

/// The result of pass two.
#[derive(Clone, Debug)]
pub struct Rendered {
    /// The image: beauty and, if asked for, layers.
    pub image: Image,
    /// What was done.
    pub report: RenderReport,
}

/// Renders a view.
pub fn render(
    tracer: &Tracer,
    solution: &Solution,
    camera: &Camera,
    params: &RenderParams,
    progress: &dyn Progress,
) -> Result<Rendered, Cancelled> {
    let _ = (tracer, solution, camera, progress);
    Ok(Rendered { image: Image::new(params.width, params.height), report: RenderReport::default() })
}
