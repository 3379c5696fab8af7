//! The light of a scene while it is being solved for: one solution per frame, to be rendered like any other.

use catoptric_scene::Rgb;
use catoptric_solution::{DisplayMesh, Solution, Term};

use crate::coarse::Frame;
use crate::display::Displayed;
use crate::draft::Draft;
use crate::final_gather::spread;
use crate::patch::PatchMesh;

/// Frames on one mesh. What sources send is the same in all of them; what has been reflected grows.
#[derive(Clone, Debug)]
pub struct Frames {
    mesh: DisplayMesh,
    /// Draft vertex of each vertex of the mesh.
    origin: Vec<u32>,
    draft: Draft,
    patches: PatchMesh,
    /// Direct, mirrored, caustic and punctual irradiance per vertex.
    sources: Vec<[Rgb; 4]>,
    /// What sources send to each patch.
    sent: Vec<Rgb>,
    frames: Vec<Frame>,
}

impl Frames {
    pub(crate) fn new(
        displayed: &Displayed,
        draft: &Draft,
        patches: &PatchMesh,
        sources: Vec<[Rgb; 4]>,
        sent: Vec<Rgb>,
        frames: Vec<Frame>,
    ) -> Self {
        Self {
            mesh: displayed.mesh.clone(),
            origin: displayed.origin.clone(),
            draft: draft.clone(),
            patches: patches.clone(),
            sources,
            sent,
            frames,
        }
    }

    /// The patches' light, by ascending steps.
    pub fn frames(&self) -> &[Frame] {
        &self.frames
    }

    /// The light of a frame, with its ambient term or without it.
    ///
    /// A vertex shows the irradiance that made the reflected part of the radiosities around it: Σ (B − ρS) / Σ ρ.
    pub fn solution(&self, frame: &Frame, ambient: bool) -> Solution {
        let parts = frame.radiosity.iter().zip(&self.sent).zip(&self.patches.reflectances);
        let reflected: Vec<Rgb> = parts.map(|((b, s), r)| *b - *s * *r).collect();
        let reflected = spread(&self.draft, &self.patches, &reflected);
        let reflectance = spread(&self.draft, &self.patches, &self.patches.reflectances);
        let more = if ambient { frame.ambient } else { Rgb::ZERO };
        let mut solution = Solution { mesh: self.mesh.clone(), ..Solution::default() };
        for (&[direct, mirrored, caustic, punctual], &vertex) in self.sources.iter().zip(&self.origin) {
            let bounced = divide(reflected[vertex as usize], reflectance[vertex as usize]);
            solution.irradiance[Term::Direct.index()].push(direct);
            solution.irradiance[Term::Mirrored.index()].push(mirrored);
            solution.irradiance[Term::Caustic.index()].push(caustic);
            solution.irradiance[Term::Indirect.index()].push(bounced + more);
            solution.punctual.push(punctual);
        }
        solution
    }
}

/// Channel by channel; 0 where nothing is reflected, and nobody sees it.
fn divide(radiosity: Rgb, reflectance: Rgb) -> Rgb {
    let channel = |b: f32, r: f32| if r > 0.0 { (b / r).max(0.0) } else { 0.0 };
    Rgb::new(
        channel(radiosity.x, reflectance.x),
        channel(radiosity.y, reflectance.y),
        channel(radiosity.z, reflectance.z),
    )
}
