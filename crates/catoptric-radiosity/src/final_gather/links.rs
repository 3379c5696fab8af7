//! Light that goes to and fro between the vertices of the gathers.
//!
//! Under a ball on a floor, and along every corner, light dies away within less than a patch. The coarse solution holds its mean
//! there, and a gather takes but one reflection off that error. So what the rays of a vertex met is kept as links to the mesh
//! (Hanrahan, Salzman & Aupperle 1991), and the vertices are solved on them, without further rays.

use catoptric_scene::Rgb;
use catoptric_solution::DisplayMesh;
use catoptric_solution::mesh::Located;

use crate::gather::Witness;
use crate::guide::{Aim, Findings, PlaceId};

use super::spots::Spots;

/// A place on the mesh that a gather met, and what irradiance there counts.
#[derive(Clone, Copy, Debug)]
struct Link {
    element: u32,
    /// Of its first two vertices; that of the last is what is left of 1.
    weights: [f32; 2],
    share: Rgb,
}

/// What one gather met.
#[derive(Clone, Debug, Default)]
pub(super) struct Links(Vec<Link>);

impl Links {
    /// For a gather of so many rays.
    fn with_room(rays: u32) -> Self {
        Self(Vec::with_capacity(rays as usize))
    }

    /// All count less, or more.
    pub(super) fn scale(&mut self, by: f32) {
        for link in &mut self.0 {
            link.share *= by;
        }
    }

    /// Adds what another gather met.
    pub(super) fn append(&mut self, mut other: Self) {
        self.0.append(&mut other.0);
    }

    /// What irradiance per vertex of the mesh brings here.
    pub(super) fn gathered(&self, mesh: &DisplayMesh, irradiance: &[Rgb]) -> Rgb {
        let at = |link: &Link| {
            let [a, b, c] = mesh.elements[link.element as usize].vertices.map(|v| irradiance[v as usize]);
            let [u, v] = link.weights;
            a * u + b * v + c * (1.0 - u - v)
        };
        self.0.iter().map(|link| at(link) * link.share).sum()
    }
}

/// Keeps what a gather finds by direction, and what it meets.
pub(super) struct Linking<'a> {
    pub(super) findings: Findings,
    pub(super) links: Links,
    spots: &'a Spots,
    /// The bright place that the ray met.
    place: Option<PlaceId>,
}

impl<'a> Linking<'a> {
    /// For a gather of so many rays that adds to what is known by direction.
    pub(super) fn new(rays: u32, findings: Findings, spots: &'a Spots) -> Self {
        Self { findings, links: Links::with_room(rays), spots, place: None }
    }
}

impl Witness for Linking<'_> {
    #[inline]
    fn sent(&mut self, aim: &Aim, radiance: f32) {
        self.findings.add(aim, radiance, self.place.take());
    }

    #[inline]
    fn met(&mut self, located: &Located, share: Rgb) {
        self.place = self.place.or(self.spots.place_of(located.element));
        let [u, v, _] = located.weights;
        self.links.0.push(Link { element: located.element, weights: [u, v], share });
    }
}
