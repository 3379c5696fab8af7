//! The result of pass one.

use std::collections::BTreeMap;

use catoptric_scene::{Irradiance, Rgb, SceneHash};

use crate::mesh::{DisplayMesh, Located};

/// Who owns a light path between a source and a diffuse receiver (ARCHITECTURE.md).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Term {
    /// Sources seen straight, or through panes and blended surfaces.
    Direct,
    /// Sources seen in planar mirrors, panes and coats by image polygons.
    Mirrored,
    /// Sources by way of curved or refracting surfaces.
    Caustic,
    /// Everything else: light from other diffuse surfaces.
    Indirect,
}

impl Term {
    /// All terms in storage order.
    pub const ALL: [Term; 4] = [Term::Direct, Term::Mirrored, Term::Caustic, Term::Indirect];

    /// Position in storage order.
    #[inline]
    pub fn index(self) -> usize {
        self as usize
    }

    /// Name in files and layers.
    pub fn name(self) -> &'static str {
        match self {
            Term::Direct => "direct",
            Term::Mirrored => "mirrored",
            Term::Caustic => "caustic",
            Term::Indirect => "indirect",
        }
    }
}

/// Radiosity of the patches of the coarse solve, kept for gathers and for people who look at the transport.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PatchRadiosity {
    /// Area of each patch, m².
    pub areas: Vec<f32>,
    /// Centre of each patch, metres.
    pub centers: Vec<[f32; 3]>,
    /// Radiosity B of each patch.
    pub radiosity: Vec<[f32; 3]>,
}

/// Irradiance on the display mesh, and what is needed to use it again.
///
/// Invariant: every term has one value per vertex of the mesh (held by [`Solution::validate`]).
#[derive(Clone, Debug, Default)]
pub struct Solution {
    /// The mesh.
    pub mesh: DisplayMesh,
    /// Irradiance per term and vertex. Coated surfaces: H_T.
    pub irradiance: [Vec<Rgb>; 4],
    /// The part of the direct and the mirrored term that no lamp sends: dim sky, broad emitters, chains on no list.
    /// Empty where there is none. What is left of the term is the light of sources, which pass two can evaluate itself.
    pub gathered: [Vec<Rgb>; 2],
    /// Irradiance by punctual lights, direct and mirrored, per vertex. For viewers: pass two shades it per pixel.
    pub punctual: Vec<Rgb>,
    /// Patch radiosity.
    pub patches: PatchRadiosity,
    /// Hash of the scene it belongs to.
    pub scene_hash: SceneHash,
    /// Settings and version, as text.
    pub settings: BTreeMap<String, String>,
}

impl Solution {
    /// Interpolated irradiance of one term.
    #[inline]
    pub fn irradiance(&self, term: Term, at: &Located) -> Irradiance {
        interpolated(&self.irradiance[term.index()], at)
    }

    /// The part of one term that hemisphere rays own, interpolated: nothing but for direct and mirrored light.
    #[inline]
    pub fn gathered(&self, term: Term, at: &Located) -> Irradiance {
        match self.gathered.get(term.index()) {
            Some(values) if !values.is_empty() => interpolated(values, at),
            _ => Irradiance(Rgb::ZERO),
        }
    }

    /// Checks the invariants; says what is broken.
    pub fn validate(&self) -> Result<(), String> {
        self.mesh.validate()?;
        let vertices = self.mesh.vertices.len();
        for term in Term::ALL {
            let values = &self.irradiance[term.index()];
            if values.len() != vertices {
                return Err(format!(
                    "term {} has {} values for {vertices} vertices",
                    term.name(),
                    values.len()
                ));
            }
            if let Some(bad) = values.iter().position(|v| !v.is_finite()) {
                return Err(format!("term {} is not finite at vertex {bad}", term.name()));
            }
        }
        for (term, values) in Term::ALL.iter().zip(&self.gathered).filter(|(_, values)| !values.is_empty()) {
            if values.len() != vertices || values.iter().any(|v| !v.is_finite()) {
                return Err(format!(
                    "the gathered part of term {} is not one number per vertex",
                    term.name()
                ));
            }
        }
        if self.punctual.len() != vertices {
            return Err(format!("punctual light has {} values for {vertices} vertices", self.punctual.len()));
        }
        Ok(())
    }
}

#[inline]
fn interpolated(values: &[Rgb], at: &Located) -> Irradiance {
    let [a, b, c] = at.vertices.map(|v| values[v as usize]);
    Irradiance(a * at.weights[0] + b * at.weights[1] + c * at.weights[2])
}
