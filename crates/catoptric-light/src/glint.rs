//! Where small mirrors throw light: a patch of it may be narrower than the elements of a mesh, and none of their vertices
//! may lie in it.

use std::collections::BTreeMap;

use glam::{DVec3, Vec2};

use catoptric_scene::{PunctualKind, PunctualLight, Side, TriangleId};
use catoptric_trace::sequence::{Key, Purpose};
use catoptric_trace::{PlaneId, Ray, walk};

use crate::chains::ImageChain;
use crate::contour::Polygon;
use crate::emitter::Cell;
use crate::irradiance::Lights;

/// A place in the light that a chain of planar mirrors throws.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Glint {
    /// Where it falls.
    pub triangle: TriangleId,
    /// On which side.
    pub side: Side,
    /// World position.
    pub position: DVec3,
    /// How narrow that light is there, metres, about: no less.
    pub width: f64,
    /// How long it is, metres, about.
    pub length: f64,
}

/// Paths through each window of a chain from area sources, and from each punctual light, at least.
const PATHS: u32 = 8;
const PUNCTUAL_PATHS: u32 = 4;
/// … and at most, where what is thrown is that much longer than it is wide.
const MOST_PATHS: u32 = 64;
/// Chains that reflect less throw nothing that is seen beside the direct light.
const MIN_STRENGTH: f32 = 0.1;
/// Paths at most, at all: a few milliseconds.
const MAX_PATHS: u32 = 1 << 14;
/// Streams of a window's key, beside its own for points of the window.
const CHOICE: u32 = 1;
const POINT: u32 = 2;
const FIRST_PUNCTUAL: u32 = 3;

/// Where light starts.
#[derive(Clone, Copy)]
enum Start {
    /// At a point on a source.
    Place {
        position: DVec3,
        plane: PlaneId,
        /// Size of the source, metres.
        extent: f64,
    },
    /// Far away, against this offset.
    Far(DVec3),
}

impl Start {
    /// The place from which a point is lit.
    fn before(self, aim: DVec3) -> DVec3 {
        match self {
            Start::Place { position, .. } => position,
            Start::Far(offset) => aim - offset,
        }
    }

    /// The plane that it lies in.
    fn plane(self) -> PlaneId {
        match self {
            Start::Place { plane, .. } => plane,
            Start::Far(_) => PlaneId::NONE,
        }
    }
}

/// The emitting cells, to be chosen by their strength.
struct AreaSources<'a> {
    cells: &'a [Cell],
    /// Sums of the strengths up to and with each cell.
    sums: Vec<f64>,
    /// Size of the source that each cell belongs to: the root of its surface's area, metres.
    extents: Vec<f64>,
}

impl<'a> AreaSources<'a> {
    fn new(lights: &'a Lights) -> Self {
        let cells = lights.emitters().cells();
        let strengths = cells.iter().scan(0.0, |sum, cell| {
            *sum += cell.strength();
            Some(*sum)
        });
        let surface = |cell: &Cell| lights.tracer().scene().surface_of(cell.triangle()).triangles.start;
        let mut areas: BTreeMap<u32, f64> = BTreeMap::new();
        for cell in cells {
            *areas.entry(surface(cell)).or_default() += cell.area;
        }
        let extents = cells.iter().map(|cell| areas[&surface(cell)].sqrt()).collect();
        Self { cells, sums: strengths.collect(), extents }
    }

    /// A point of them.
    fn start(&self, key: Key, path: u32) -> Option<Start> {
        let (choice, at) = (key.child(CHOICE).point2(path), key.child(POINT).point2(path));
        let sum = self.sums.last()? * f64::from(choice.x);
        let chosen = self.sums.partition_point(|&s| s <= sum).min(self.cells.len() - 1);
        let cell = &self.cells[chosen];
        let position = cell.point(f64::from(at.x), f64::from(at.y));
        Some(Start::Place { position, plane: cell.plane, extent: self.extents[chosen] })
    }
}

impl Lights<'_> {
    /// Places in the light of area and punctual sources over each image chain with windows, by paths from points of the
    /// sources through points of the narrowest window.
    pub fn glints(&self, seed: u32) -> Vec<Glint> {
        let mut glints = Vec::new();
        if self.chains().chains().is_empty() {
            return glints;
        }
        let mut room = MAX_PATHS;
        let area = AreaSources::new(self);
        let punctual = self.tracer().scene().lights();
        for (index, chain) in self.chains().chains().iter().enumerate() {
            if chain.strength() < MIN_STRENGTH {
                continue;
            }
            for (number, window) in chain.windows.iter().enumerate() {
                let key = Key::new(seed, Purpose::Glint, (index as u64) << 8 | number as u64);
                let mut follow = |paths: u32, key: Key, start: &dyn Fn(u32) -> Option<Start>| {
                    // As many paths as it takes to follow a narrow strip.
                    let mut count = f64::from(paths);
                    for path in 0..MOST_PATHS {
                        if f64::from(path) >= count || room == 0 {
                            break;
                        }
                        room -= 1;
                        let through = key.point2(path);
                        let start = start(path);
                        if let Some(glint) = start.and_then(|start| self.glint(chain, window, start, through))
                        {
                            count = count.max(glint.length / glint.width);
                            glints.push(glint);
                        }
                    }
                };
                follow(PATHS, key, &|path| area.start(key, path));
                for (which, light) in punctual.iter().enumerate() {
                    let start = self.start_of(light);
                    follow(PUNCTUAL_PATHS, key.child(FIRST_PUNCTUAL + which as u32), &|_| Some(start));
                }
            }
        }
        glints
    }

    /// Where the light of a punctual source starts.
    fn start_of(&self, light: &PunctualLight) -> Start {
        match light.kind {
            PunctualKind::Directional => {
                Start::Far(light.direction.as_dvec3() * (2.0 * f64::from(self.tracer().diagonal())))
            }
            PunctualKind::Point
            | PunctualKind::Spot { .. }
            | PunctualKind::Lobe { .. }
            | PunctualKind::Photometric { .. } => {
                Start::Place { position: light.position.as_dvec3(), plane: PlaneId::NONE, extent: 0.0 }
            }
        }
    }

    /// Where the path from a point of a source through a point of the narrowest part of a window arrives.
    fn glint(&self, chain: &ImageChain, window: &[Polygon], start: Start, through: Vec2) -> Option<Glint> {
        let view = |part: &&Polygon| {
            let corner = part.corners()[0];
            let towards = corner - start.before(corner);
            part.vector_area().dot(towards).abs() / towards.length().powi(3)
        };
        let narrowest = window.iter().min_by(|a, b| view(a).total_cmp(&view(b)))?;
        let aim = narrowest.point(f64::from(through.x), f64::from(through.y));
        let origin = start.before(aim);
        let direction = (aim - origin).normalize_or_zero().as_vec3();
        let ray = Ray { origin: origin.as_vec3(), direction, from: start.plane() };
        let (hit, position, surface) =
            walk::arrival_over(self.tracer(), ray, chain.planes.iter().rev().copied())?;
        let (position, normal) = (position.as_dvec3(), surface.geometric.as_dvec3());
        // In the unfolded space the path is straight, and the window throws its shadow from where the light really is.
        let image = self.chains().unfold(chain, position, normal, normal)?;
        let mut thrown = Vec::with_capacity(narrowest.corners().len());
        for &corner in narrowest.corners() {
            let origin = start.before(corner);
            let (height, rise) =
                (image.normal.dot(image.position - origin), image.normal.dot(corner - origin));
            // Beyond the horizon: as wide as one likes.
            if rise * height <= 0.0 {
                return None;
            }
            thrown.push(origin + (corner - origin) * (height / rise));
        }
        let longest =
            thrown.iter().flat_map(|a| thrown.iter().map(move |b| (*a - *b).length())).fold(0.0, f64::max);
        let width = Polygon::new(&thrown).vector_area().length() / longest;
        let blur = match start {
            Start::Place { position, extent, .. } => {
                extent * (image.position - aim).length() / (aim - position).length()
            }
            Start::Far(_) => 0.0,
        };
        let is_known = width > 0.0 && width.is_finite() && blur.is_finite();
        is_known.then_some(Glint {
            triangle: hit.triangle,
            side: surface.side,
            position,
            width: width.max(blur),
            length: longest.max(blur),
        })
    }
}
