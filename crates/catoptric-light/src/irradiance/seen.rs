//! What a receiver sees of the emitters: pieces of cells and outlines of lamps, clipped to its horizon and to the mirrors'
//! windows, and groups of cells that are small, or too many.

use std::ops::Range;

use glam::DVec3;

use catoptric_scene::Rgb;
use catoptric_trace::plane::Plane;

use crate::chains::Unfolded;
use crate::contour::{self, Polygon};
use crate::emitter::{Cell, Emitters};
use crate::lamp::{Beyond, Outline, Sight};
use crate::light_tree::{Cut, Part, Windows};

use super::{Lights, OWN_STRATA, Standpoint};

/// A visible part of a cell.
#[derive(Clone, Debug)]
pub(super) struct Piece {
    pub cell: u32,
    /// Where its corners lie in [`Found::corners`].
    pub corners: Range<usize>,
    /// All of the cell.
    pub whole: bool,
    /// Irradiance by unit radiance.
    pub unit: f64,
    /// By its radiance, the sum of channels.
    pub weight: f64,
    /// Its samples are drawn together with those of others.
    pub shares: bool,
}

impl Piece {
    /// What it sends if nothing blocks.
    pub(super) fn irradiance(&self, emitters: &Emitters) -> Rgb {
        emitters.cells()[self.cell as usize].radiance * self.unit as f32
    }
}

/// A part of a cell as it is visited.
#[derive(Clone, Copy, Debug)]
pub(super) struct CellPart<'a> {
    pub corners: &'a [DVec3],
    /// All of the cell.
    pub whole: bool,
    /// Irradiance by unit radiance.
    pub unit: f64,
}

/// Buffers of polygons that are cut.
#[derive(Clone, Debug, Default)]
pub(super) struct Spare([Polygon; 3]);

/// A visible part of a lamp.
#[derive(Clone, Debug)]
pub(super) struct LampPart {
    pub lamp: u32,
    /// Its outline is known at once. That of others costs more than a shadow ray, and each gets one.
    pub is_flat: bool,
    /// Where its corners lie in [`Found::corners`].
    pub corners: Range<usize>,
    /// Unit normal of the outline's plane, away from the receiver.
    pub axis: DVec3,
    /// Irradiance by unit radiance.
    pub unit: f64,
    /// By its radiance, the sum of channels.
    pub weight: f64,
    /// Its samples are drawn together with those of others.
    pub shares: bool,
}

impl LampPart {
    /// What it sends if nothing blocks.
    pub(super) fn irradiance(&self, emitters: &Emitters) -> Rgb {
        emitters.lamps()[self.lamp as usize].radiance * self.unit as f32
    }
}

/// What one receiver sees of the emitters.
#[derive(Clone, Debug, Default)]
pub(super) struct Found {
    pub lamps: Vec<LampPart>,
    /// Of the lamps and the pieces.
    pub corners: Vec<DVec3>,
    /// Parts of cells, known exactly.
    pub pieces: Vec<Piece>,
    /// Small and far groups with their irradiance.
    pub small: Vec<(u32, f64)>,
    /// Bundles with their irradiance.
    pub bundles: Vec<(u32, Rgb)>,
    /// Groups beyond the budget with the bound of their irradiance.
    pub loose: Vec<(u32, f64)>,
    pub windows: Windows,
}

impl Found {
    /// So few that each gets strata of its own.
    pub(super) fn is_few(&self) -> bool {
        let groups = self.small.len() + self.bundles.len() + self.loose.len();
        self.lamps.len() + self.pieces.len() + groups <= 4
    }

    /// Whether what is due so many samples is to draw them together with others.
    pub(super) fn is_shared(&self, due: f64) -> bool {
        due < OWN_STRATA && !self.is_few()
    }

    /// Irradiance of the groups, the sum of channels.
    pub(super) fn groups(&self) -> f64 {
        let bundles: f64 = self.bundles.iter().map(|b| f64::from(b.1.element_sum())).sum();
        self.small.iter().chain(&self.loose).map(|s| s.1).sum::<f64>() + bundles
    }

    /// From `eye` to the middle of the strongest of pieces and lamps; zero where there are none.
    pub(super) fn towards(&self, eye: DVec3) -> DVec3 {
        let pieces = self.pieces.iter().map(|p| (p.weight, &self.corners[p.corners.clone()]));
        let lamps = self.lamps.iter().map(|l| (l.weight, &self.corners[l.corners.clone()]));
        let strongest = pieces.chain(lamps).max_by(|a, b| a.0.total_cmp(&b.0));
        strongest
            .map_or(DVec3::ZERO, |(_, corners)| corners.iter().sum::<DVec3>() / corners.len() as f64 - eye)
    }

    /// Irradiance of all, the sum of channels.
    pub(super) fn weight(&self) -> f64 {
        self.lamps.iter().map(|l| l.weight).sum::<f64>()
            + self.pieces.iter().map(|p| p.weight).sum::<f64>()
            + self.groups()
    }
}

/// Buffers of the search.
#[derive(Clone, Debug, Default)]
pub(super) struct Seeker {
    cut: Cut,
    /// Of trees over the facets of lamps that are to be asked.
    roots: Vec<u32>,
    outline: Outline,
    spare: [Vec<DVec3>; 2],
    polygons: Spare,
}

/// Parts that all emitters may be for one receiver, and how many more for each sample, so that the cut never costs much
/// beside the shadow rays.
const WHOLE: [usize; 2] = [48, 2];
/// The same where they are more: the strongest groups, others by chance.
const PARTS: [usize; 2] = [16, 1];

impl Lights<'_> {
    /// Finds the parts of the emitters that may be seen, clipped to horizon and windows.
    pub(super) fn gather(&self, at: Standpoint, samples: u32, found: &mut Found, seeker: &mut Seeker) {
        found.small.clear();
        found.bundles.clear();
        found.loose.clear();
        self.gather_lamps(at, found, seeker);
        let budget = |[least, each]: [usize; 2]| least + each * samples as usize;
        let (tree, cells) = (self.emitters.tree(), self.emitters.cells());
        tree.cut(cells, &at.image.view(&found.windows), budget(WHOLE), budget(PARTS), &mut seeker.cut);
        self.gather_parts(at.image, found, seeker);
        for index in 0..seeker.roots.len() {
            let root = seeker.roots[index];
            tree.cut_added(cells, &at.image.view(&found.windows), root, budget(PARTS), &mut seeker.cut);
            self.gather_parts(at.image, found, seeker);
        }
    }

    /// Adds the parts of a cut.
    fn gather_parts(&self, image: &Unfolded, found: &mut Found, seeker: &mut Seeker) {
        let Seeker { cut, polygons, .. } = seeker;
        let Found { pieces, corners, small, bundles, loose, windows, .. } = found;
        let view = image.view(windows);
        for part in cut.parts() {
            match part {
                Part::Group(group) => {
                    let irradiance = self.emitters.tree().irradiance(group, image.position, image.normal);
                    if irradiance.max_element() > 0.0 {
                        small.push((group, f64::from(irradiance.element_sum())));
                    }
                }
                Part::Bundle(group) => {
                    let irradiance = self.emitters.tree().irradiance_of_bundle(group, &view);
                    if irradiance.max_element() > 0.0 {
                        bundles.push((group, irradiance));
                    }
                }
                Part::Loose(group, bound) => loose.push((group, bound)),
                Part::Cell(index) => {
                    self.pieces_of(index, image, windows, polygons, |part| {
                        self.add_piece(index, part, pieces, corners);
                    });
                }
            }
        }
    }

    /// The windows, and the parts of the lamps that the receiver may see; those that are too near, by their cells.
    fn gather_lamps(&self, at: Standpoint, found: &mut Found, seeker: &mut Seeker) {
        let Found { pieces, windows, lamps, corners, .. } = found;
        let Seeker { outline, spare: [part, spare], polygons, roots, .. } = seeker;
        let image = at.image;
        roots.clear();
        pieces.clear();
        lamps.clear();
        corners.clear();
        windows.clear();
        for outlines in at.chain.iter().flat_map(|c| &c.windows) {
            windows.add(image.position, outlines);
        }
        let horizon = image.geometric.dot(image.position);
        for (index, lamp) in self.emitters.lamps().iter().enumerate() {
            if !lamp.may_be_seen(image.position, windows) {
                continue;
            }
            let sight = match lamp.beyond(image.beyond, image.position, windows, spare) {
                Beyond::No => Sight::Hidden,
                Beyond::Partly => Sight::Facets,
                Beyond::Wholly => lamp.outline_of_light(image.position, image.geometric, image.last, outline),
            };
            match sight {
                Sight::Hidden => {}
                Sight::Facets if let Some(root) = lamp.root => roots.push(root),
                Sight::Facets => {
                    for cell in lamp.cells.clone() {
                        if self.emitters.cells()[cell as usize].faces(image.position) {
                            self.pieces_of(cell, image, windows, polygons, |part| {
                                self.add_piece(cell, part, pieces, corners);
                            });
                        }
                    }
                }
                Sight::Outline => {
                    contour::cut(&mut outline.corners, image.geometric, horizon, spare);
                    let axis = outline.axis;
                    let mut add = |seen: &[DVec3], spare: &mut Vec<DVec3>| {
                        let unit = contour::irradiance_of(image.position, image.normal, seen, spare);
                        if unit > 0.0 {
                            let weight = unit * f64::from(lamp.radiance.element_sum());
                            let start = corners.len();
                            corners.extend(seen);
                            let range = start..corners.len();
                            let (lamp, is_flat) = (index as u32, lamp.plane().is_some());
                            let shares = false;
                            lamps.push(LampPart {
                                lamp,
                                is_flat,
                                corners: range,
                                axis,
                                unit,
                                weight,
                                shares,
                            });
                        }
                    };
                    if windows.is_empty() {
                        add(&outline.corners, spare);
                    }
                    for window in windows.iter() {
                        part.clone_from(&outline.corners);
                        for normal in window {
                            contour::cut(part, *normal, normal.dot(image.position), spare);
                        }
                        add(part, spare);
                    }
                }
            }
        }
    }

    /// Irradiance by unit radiance of a cell that nothing cuts: far cheaper than its pieces. `None` where something may.
    #[inline]
    pub(super) fn unit_of_whole(cell: &Cell, image: &Unfolded, windows: &Windows) -> Option<f64> {
        let is_free = windows.is_empty() && image.beyond.is_none() && !image.is_along(cell.plane);
        if !is_free || !cell.lobe.is_diffuse() {
            return None;
        }
        let (corners, count) = cell.corners();
        let corners = &corners[..count];
        let above = |normal: DVec3| {
            let height = normal.dot(image.position);
            corners.iter().all(|c| normal.dot(*c) - height >= 0.0)
        };
        (above(image.geometric) && above(image.normal))
            .then(|| contour::irradiance_above(image.position, image.normal, corners))
    }

    /// Adds a part of a cell to the pieces, and its corners to these.
    fn add_piece(&self, cell: u32, part: CellPart, pieces: &mut Vec<Piece>, corners: &mut Vec<DVec3>) {
        let CellPart { whole, unit, .. } = part;
        let weight = unit * f64::from(self.emitters.cells()[cell as usize].radiance.element_sum());
        let start = corners.len();
        corners.extend(part.corners);
        pieces.push(Piece { cell, corners: start..corners.len(), whole, unit, weight, shares: false });
    }

    /// The parts of a cell above the horizon, one for each window that shows some.
    pub(super) fn pieces_of(
        &self,
        index: u32,
        image: &Unfolded,
        windows: &Windows,
        Spare([above, seen, spare]): &mut Spare,
        mut visit: impl FnMut(CellPart),
    ) {
        let cell = &self.emitters.cells()[index as usize];
        if image.is_along(cell.plane) {
            return;
        }
        let mut add = |polygon: &Polygon, whole: bool| {
            let unit = cell.unit_irradiance(image.position, image.normal, polygon);
            if unit <= 0.0 {
                return;
            }
            if cell.lobe.exponent() > 1.0 {
                let lit = cell.lit_part(image.position, *polygon);
                visit(CellPart { corners: lit.corners(), whole: false, unit });
            } else {
                visit(CellPart { corners: polygon.corners(), whole, unit });
            }
        };
        // What is all outside is told without a copy.
        let (corners, count) = cell.corners();
        let corners = &corners[..count];
        let is_outside = |normal: DVec3, offset: f64| corners.iter().all(|c| normal.dot(*c) < offset);
        if is_outside(image.geometric, image.geometric.dot(image.position))
            || image.beyond.is_some_and(|plane| is_outside(plane.normal, plane.offset))
            || !windows.may_show_where(|normal| !is_outside(*normal, normal.dot(image.position)))
        {
            return;
        }
        above.assign(corners);
        above.cut(image.geometric, image.geometric.dot(image.position), spare);
        // What lies between the receiver's image and the last mirror is not before that mirror.
        if let Some(Plane { normal, offset }) = image.beyond {
            above.cut(normal, offset, spare);
        }
        if above.is_empty() {
            return;
        }
        if windows.is_empty() {
            add(above, above.corners() == corners);
        }
        for window in windows.iter() {
            seen.assign(above.corners());
            for normal in window {
                seen.cut(*normal, normal.dot(image.position), spare);
                if seen.is_empty() {
                    break;
                }
            }
            if !seen.is_empty() {
                add(seen, false);
            }
        }
    }
}
