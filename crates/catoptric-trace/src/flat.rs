//! Which flat mirrors, panes and coats have images.

use catoptric_scene::{Scene, TriangleId};

use crate::extent::Extent;
use crate::plane::Planes;

/// Planes with images, at most: chains grow with a power of their number.
const MAX_IMAGE_PLANES: usize = 32;
/// Reflecting planes below this share of the scene's reflecting and diffuse area are facets: only what they reflect alone has an image.
const MIN_IMAGE_AREA: f64 = 2e-4;
/// … and below this share they are parts of curved things.
const MIN_FACET_AREA: f64 = 5e-6;
/// Facets at most: receivers ask of each whether its light comes their way.
const MAX_FACETS: usize = 512;

/// What reflects in a plane.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Flat {
    /// Nothing, or too little.
    #[default]
    Nothing,
    /// A small mirror: one of those of which only single reflections have images.
    Facet,
    /// A mirror that has images, and images of images.
    Mirror,
}

/// The flat reflectors of each plane, the largest by reflecting area first.
pub(crate) fn flat_mirrors(scene: &Scene, extent: &Extent, planes: &Planes) -> Vec<Flat> {
    let mut area = vec![0.0_f64; planes.len()];
    let mut total = 0.0_f64;
    for index in 0..scene.triangles().len() {
        let triangle = TriangleId(index as u32);
        let material = scene.material_of(triangle);
        let size = f64::from(scene.area(triangle));
        // The ground to the horizon does not make facets of the mirrors in the house.
        total += if extent.is_outlying(triangle) { 0.0 } else { size };
        let reflects = material.may_be_specular() && !material.is_solid() && !scene.is_smooth(triangle);
        if reflects {
            area[planes.of(triangle).0 as usize] += size;
        }
    }
    let mut order: Vec<usize> = (0..area.len()).filter(|&p| area[p] > MIN_FACET_AREA * total).collect();
    order.sort_by(|&a, &b| area[b].total_cmp(&area[a]).then(a.cmp(&b)));
    let large = order.iter().take_while(|&&p| area[p] > MIN_IMAGE_AREA * total).count().min(MAX_IMAGE_PLANES);
    let (mirrors, facets) = order.split_at(large);
    let mut flat = vec![Flat::Nothing; planes.len()];
    mirrors.iter().for_each(|&plane| flat[plane] = Flat::Mirror);
    facets.iter().take(MAX_FACETS).for_each(|&plane| flat[plane] = Flat::Facet);
    flat
}
