//! What light is sent from: lamps in groups, punctual lights, bright parts of the sky.

use glam::{DVec3, Vec2, Vec3};

use rayon::prelude::*;

use catoptric_light::Lights;
use catoptric_light::emitter::Cell;
use catoptric_scene::{Lobe, PunctualKind, Rgb, Sky};
use catoptric_trace::sequence::{Key, Purpose, cosine_hemisphere, frame, uniform_sphere};
use catoptric_trace::{MediumId, MediumStack, PlaneId, Ray};

use crate::caustic::table::Table;
use crate::caustic::target::Target;
use crate::media::{has_solids, vote};

/// A group of like sources.
#[derive(Clone, Debug)]
pub(super) struct Source {
    kind: Kind,
    /// A ball around it; for sources at infinity the mean direction towards them, and the sine of the largest angle.
    center: Vec3,
    radius: f32,
    /// Cone of the normals of emitting sides.
    axis: Vec3,
    cos_cone: f32,
    /// Of its emitting sides; diffuse where they differ.
    lobe: Lobe,
    /// Σ over channels of radiance × area, intensity, or radiance × solid angle.
    strength: f32,
    pub(super) media: MediumStack,
}

#[derive(Clone, Debug)]
enum Kind {
    /// Emitter cells, chosen by power; of a single one the part (s, t) ∈ `low` + `size`·[0, 1)².
    Cells { members: Vec<u32>, table: Table, low: Vec2, size: Vec2 },
    /// A punctual light.
    Punctual(u32),
    /// Bright texels by power.
    Texels { members: Vec<u32>, table: Table },
}

/// Light on its way to a point of a target.
#[derive(Clone, Copy, Debug)]
pub(super) struct Beam {
    pub(super) direction: Vec3,
    /// Power per area of the target, over the density with which the point of the source was chosen.
    pub(super) power: Rgb,
    /// Density per area of the target with which a ray of a cosine-weighted direction from that point meets this one; 0 where none does.
    pub(super) straight: f32,
}

/// Groups of sources times targets, at most.
const MAX_TABLE: usize = 4_000_000;
const MAX_SOURCES: usize = 64;
/// Cells are cut until they are this small against their distance from the targets.
const CELL_RATIO: f32 = 0.25;
/// Of lamps whose middle is within so many radii of a target, rays are also sent in directions of their own.
const BESIDE: f32 = 1.25;
/// Targets count as this share of a group's radius away, at least.
const NEAREST: f32 = 0.25;

/// All sources that are concentrated.
pub(super) fn collect(lights: &Lights, targets: &[Target], seed: u32) -> Vec<Source> {
    let mut sources = Vec::new();
    let limit = (MAX_TABLE / targets.len().max(1)).clamp(1, MAX_SOURCES);
    cells(lights, targets, limit, &mut sources);
    punctual(lights, &mut sources);
    texels(lights, limit.min(16), &mut sources);
    if has_solids(lights.tracer()) {
        for (index, source) in sources.iter_mut().enumerate() {
            source.find_medium(lights, Key::new(seed, Purpose::LightRay, index as u64 | 1 << 40));
        }
    }
    sources
}

fn cells(lights: &Lights, targets: &[Target], limit: usize, sources: &mut Vec<Source>) {
    let cells = lights.emitters().cells();
    let groups = grouped(cells, targets, limit);
    let parts = (limit / groups.len().max(1)).max(1);
    for numbers in groups {
        let members: Vec<&Cell> = numbers.iter().map(|&number| &cells[number as usize]).collect();
        let table = Table::new(members.iter().map(|cell| strength(cell)));
        let corners = || members.iter().flat_map(|c| c.polygon().corners().to_vec());
        let count = corners().count() as f64;
        let center = corners().sum::<DVec3>() / count;
        let radius = corners().map(|c| (c - center).length()).fold(0.0, f64::max);
        let axis = members.iter().map(|c| c.normal * c.area).sum::<DVec3>().normalize_or_zero();
        let cos_cone = members.iter().map(|c| c.normal.dot(axis)).fold(1.0, f64::min) as f32;
        let whole = Source {
            center: center.as_vec3(),
            radius: radius as f32,
            axis: axis.as_vec3(),
            cos_cone: if axis == DVec3::ZERO { -1.0 } else { cos_cone },
            lobe: if members.iter().all(|c| c.lobe == members[0].lobe) {
                members[0].lobe
            } else {
                Lobe::DIFFUSE
            },
            strength: members.iter().map(|cell| strength(cell)).sum(),
            media: MediumStack::AIR,
            kind: Kind::Cells { members: numbers, table, low: Vec2::ZERO, size: Vec2::ONE },
        };
        let outline = members[0].polygon().corners().to_vec();
        if members.len() > 1 || outline.len() != 4 {
            sources.push(whole);
            continue;
        }
        // A large lamp is cut into a grid.
        let near = nearest(targets, whole.center).max(NEAREST * whole.radius);
        let wanted = (whole.radius / (CELL_RATIO * near)).ceil();
        let [a, b] = [outline[1] - outline[0], outline[3] - outline[0]].map(|e| e.length() as f32);
        let cut = |length: f32| (wanted * length / a.max(b)).ceil().clamp(1.0, (parts as f32).sqrt().floor());
        let grid = Vec2::new(cut(a), cut(b));
        for i in 0..grid.x as u32 {
            for j in 0..grid.y as u32 {
                let size = 1.0 / grid;
                let low = Vec2::new(i as f32, j as f32) * size;
                let middle = low + 0.5 * size;
                let center = members[0].point(f64::from(middle.x), f64::from(middle.y)).as_vec3();
                let mut part = whole.clone();
                part.center = center;
                part.radius = 0.5 * Vec2::new(a * size.x, b * size.y).length() * 1.5;
                part.strength *= size.x * size.y;
                if let Kind::Cells { low: l, size: s, .. } = &mut part.kind {
                    (*l, *s) = (low, size);
                }
                sources.push(part);
            }
        }
    }
}

/// Σ over channels of radiance × area.
fn strength(cell: &Cell) -> f32 {
    cell.radiance.element_sum() * cell.area as f32
}

/// Distance from a place to the nearest target, metres: less than 0 within its ball.
fn nearest(targets: &[Target], place: Vec3) -> f32 {
    let away = |t: &Target| (t.center - place).length() - t.radius;
    targets.par_iter().with_min_len(1024).map(away).reduce(|| f32::INFINITY, f32::min)
}

/// Cells that are sent from together, in a box.
struct Group {
    members: Vec<u32>,
    low: DVec3,
    high: DVec3,
    /// How much it matters that it is not smaller.
    cost: f32,
}

impl Group {
    fn new(cells: &[Cell], targets: &[Target], members: Vec<u32>) -> Self {
        let corners = || members.iter().flat_map(|&m| cells[m as usize].polygon().corners().to_vec());
        let low = corners().fold(DVec3::INFINITY, DVec3::min);
        let high = corners().fold(DVec3::NEG_INFINITY, DVec3::max);
        let radius = 0.5 * (high - low).length() as f32;
        let near = nearest(targets, (0.5 * (low + high)).as_vec3()).max(NEAREST * radius);
        let strength: f32 = members.iter().map(|&m| strength(&cells[m as usize])).sum();
        let ratio = radius / near.max(f32::MIN_POSITIVE);
        let cost = if members.len() < 2 { 0.0 } else { strength * ratio * ratio };
        Self { members, low, high, cost }
    }

    /// Its halves, in the middle of the box: lamps that are apart come apart.
    fn halves(self, cells: &[Cell], targets: &[Target]) -> [Self; 2] {
        let axis = (self.high - self.low).max_position();
        let middle = 0.5 * (self.low + self.high)[axis];
        let below = |&m: &u32| {
            let corners = cells[m as usize].polygon().corners().to_vec();
            corners.iter().map(|c| c[axis]).sum::<f64>() < middle * corners.len() as f64
        };
        let (mut one, mut other): (Vec<u32>, Vec<u32>) = self.members.into_iter().partition(below);
        if one.is_empty() || other.is_empty() {
            one.append(&mut other);
            other = one.split_off(one.len() / 2);
        }
        [one, other].map(|members| Self::new(cells, targets, members))
    }
}

/// At most `limit` groups of cells: those are halved first that are strong, and large against their distance from the targets. A group
/// of two lamps is as far from what is right beside one as from what is beside none, and its importance is worth nothing.
fn grouped(cells: &[Cell], targets: &[Target], limit: usize) -> Vec<Vec<u32>> {
    let all = 0..cells.len() as u32;
    if cells.len() <= limit {
        return all.map(|number| vec![number]).collect();
    }
    let mut groups = vec![Group::new(cells, targets, all.collect())];
    while groups.len() < limit {
        let costs = || groups.iter().map(|group| group.cost).enumerate();
        let Some((worst, cost)) = costs().max_by(|x, y| x.1.total_cmp(&y.1).then(y.0.cmp(&x.0))) else {
            break;
        };
        if cost <= 0.0 {
            break;
        }
        groups.swap_remove(worst).halves(cells, targets).into_iter().for_each(|half| groups.push(half));
    }
    groups.into_iter().map(|group| group.members).collect()
}

fn punctual(lights: &Lights, sources: &mut Vec<Source>) {
    for (index, light) in lights.tracer().scene().lights().iter().enumerate() {
        let directional = light.kind == PunctualKind::Directional;
        sources.push(Source {
            kind: Kind::Punctual(index as u32),
            center: if directional { -light.direction } else { light.position },
            radius: 0.0,
            axis: Vec3::ZERO,
            cos_cone: -1.0,
            lobe: Lobe::DIFFUSE,
            strength: light.intensity.element_sum(),
            media: MediumStack::AIR,
        });
    }
}

/// Bright texels, grouped by octant and row so that a group lies close together.
fn texels(lights: &Lights, limit: usize, sources: &mut Vec<Source>) {
    let texels = lights.bright_sky().texels();
    if texels.is_empty() {
        return;
    }
    let mut order: Vec<u32> = (0..texels.len() as u32).collect();
    let octant = |i: u32| {
        let d = texels[i as usize].direction;
        u32::from(d.x < 0.0) | u32::from(d.y < 0.0) << 1 | u32::from(d.z < 0.0) << 2
    };
    order.sort_by_key(|&i| (octant(i), i));
    let per_group = order.len().div_ceil(limit);
    for members in order.chunks(per_group) {
        let weight = |i: &u32| texels[*i as usize].power.element_sum();
        let mean: Vec3 = members.iter().map(|i| texels[*i as usize].direction * weight(i)).sum();
        let axis = mean.try_normalize().unwrap_or(Vec3::Y);
        let cos = members.iter().map(|i| texels[*i as usize].direction.dot(axis)).fold(1.0, f32::min);
        // A texel of an image 64 rows high spans 0.05 rad: directions lie beside centres.
        let spread = (1.0 - cos * cos).max(0.0).sqrt() + 0.05;
        sources.push(Source {
            kind: Kind::Texels { members: members.to_vec(), table: Table::new(members.iter().map(weight)) },
            center: axis,
            radius: if cos <= 0.2 { 2.0 } else { spread },
            axis: Vec3::ZERO,
            cos_cone: -1.0,
            lobe: Lobe::DIFFUSE,
            strength: members.iter().map(weight).sum(),
            media: MediumStack::AIR,
        });
    }
}

impl Source {
    /// Whether receivers may see it: not a point, and not far away.
    pub(super) fn is_lamp(&self) -> bool {
        matches!(self.kind, Kind::Cells { .. })
    }

    fn is_infinite(&self, lights: &Lights) -> bool {
        match &self.kind {
            Kind::Cells { .. } => false,
            Kind::Punctual(index) => {
                lights.tracer().scene().lights()[*index as usize].kind == PunctualKind::Directional
            }
            Kind::Texels { .. } => true,
        }
    }

    /// Power that a target gets, about: zero only where nothing gets there.
    pub(super) fn importance(&self, lights: &Lights, target: &Target) -> f32 {
        let size = self.strength * target.strength * target.area;
        if self.is_infinite(lights) {
            // A ball far away in that direction.
            let far = target.center + self.center * 1e3;
            return size * target.cosine_bound(far, self.radius * 1e3, MediumId::AIR);
        }
        let medium = self.media.current();
        let there = target.cosine_bound(self.center, self.radius, medium);
        let offset = target.center - self.center;
        let reach = self.radius + target.radius;
        let distance = offset.length().max(0.5 * reach).max(f32::MIN_POSITIVE);
        let falloff = match &self.kind {
            Kind::Punctual(index) => {
                let light = &lights.tracer().scene().lights()[*index as usize];
                let towards = offset / distance;
                // A cone may end within the target.
                let inside = light.intensity_towards(towards).element_sum();
                let slack = (target.radius / distance).min(1.0);
                (inside / self.strength.max(f32::MIN_POSITIVE)).max(slack)
            }
            _ => {
                // The cone of normals widens the cosine, the extents do as well.
                let cos = self.axis.dot(offset) / distance;
                let sin = (1.0 - cos * cos).max(0.0).sqrt();
                let sin_cone = (1.0 - self.cos_cone * self.cos_cone).max(0.0).sqrt();
                let widened = if cos >= self.cos_cone { 1.0 } else { cos * self.cos_cone + sin * sin_cone };
                let cosine = (widened + reach / distance).clamp(0.0, 1.0);
                // A narrow lobe sees the extents, as chords, in its own way; below n = 1 all directions count alike.
                if self.lobe.exponent() > 1.0 {
                    let nearest = f64::from((widened + 1.5 * reach / distance).clamp(0.0, 1.0));
                    cosine * self.lobe.factor(nearest) as f32
                } else {
                    cosine
                }
            }
        };
        size * there * falloff / (distance * distance)
    }

    /// Whether targets are nearer than it is large: towards those beside it, power per area has no bound.
    pub(super) fn is_beside(&self, targets: &[Target]) -> bool {
        self.is_lamp() && nearest(targets, self.center) < BESIDE * self.radius
    }

    /// A ray from a point of a lamp by `at`, as [`connect`](Self::connect) has it, in a direction by `towards` ∈ [0, 1)².
    pub(super) fn ray(&self, lights: &Lights, at: Vec2, towards: Vec2) -> Option<Ray> {
        let (cell, origin, _) = self.point(lights, at)?;
        let normal = cell.normal.as_vec3();
        let ((x, y), local) = (frame(normal), cosine_hemisphere(towards));
        let direction = x * local.x + y * local.y + normal * local.z;
        Some(Ray { origin: origin.as_vec3(), direction, from: cell.plane })
    }

    /// A cell of a lamp and a point of it by `at` ∈ [0, 1)²; the area that it stands for, m², and how likely that was chosen.
    fn point<'l>(&self, lights: &'l Lights, at: Vec2) -> Option<(&'l Cell, DVec3, [f64; 2])> {
        let Kind::Cells { members, table, low, size } = &self.kind else { return None };
        let (member, probability, left) = table.pick(at.x);
        let cell = &lights.emitters().cells()[members[member] as usize];
        let place = *low + Vec2::new(left, at.y) * *size;
        let area = cell.area * f64::from(size.x * size.y);
        Some((cell, cell.point(f64::from(place.x), f64::from(place.y)), [area, f64::from(probability)]))
    }

    /// A point of the source by `at` ∈ [0, 1)², and what it sends straight to a point of a target's plane.
    pub(super) fn connect(
        &self,
        lights: &Lights,
        at: Vec2,
        point: Vec3,
        normal: Vec3,
        plane: PlaneId,
    ) -> Option<Beam> {
        let tracer = lights.tracer();
        match &self.kind {
            Kind::Cells { .. } => {
                let (cell, origin, [area, probability]) = self.point(lights, at)?;
                let offset = point.as_dvec3() - origin;
                let r2 = offset.length_squared();
                let distance = r2.sqrt();
                let direction = offset / distance;
                let sent = cell.normal.dot(direction) * direction.dot(normal.as_dvec3()).abs() / r2;
                if !(sent > 0.0 && sent.is_finite()) {
                    return None;
                }
                let leaves = cell.normal.dot(direction);
                let radiance = cell.radiance_at(tracer, origin) * cell.lobe.factor(leaves) as f32;
                let seen = tracer.visibility(origin.as_vec3(), cell.plane, point, plane);
                let medium = tracer.media().transmittance(self.media.current(), distance as f32);
                let power = radiance * seen * medium * (sent * area / probability) as f32;
                let straight = if seen == Rgb::ONE { sent / std::f64::consts::PI } else { 0.0 };
                let beam = beam(direction.as_vec3(), power)?;
                Some(Beam { straight: straight as f32, ..beam })
            }
            Kind::Punctual(index) => {
                let light = &tracer.scene().lights()[*index as usize];
                if light.kind == PunctualKind::Directional {
                    let seen = tracer.visibility_to_infinity(point, plane, -light.direction);
                    let power = light.intensity * seen * light.direction.dot(normal).abs();
                    return beam(light.direction, power);
                }
                let offset = point - light.position;
                let r2 = offset.length_squared();
                let direction = offset.try_normalize()?;
                let sent = light.intensity_towards(direction) * (direction.dot(normal).abs() / r2);
                if sent.max_element() <= 0.0 {
                    return None;
                }
                let seen = tracer.visibility(light.position, PlaneId::NONE, point, plane);
                let medium = tracer.media().transmittance(self.media.current(), r2.sqrt());
                beam(direction, sent * seen * medium)
            }
            Kind::Texels { members, table } => {
                let Some(Sky::Image(map)) = tracer.scene().sky() else { return None };
                let (member, probability, left) = table.pick(at.x);
                let texel = &lights.bright_sky().texels()[members[member] as usize];
                let towards = lights.bright_sky().direction_in(map, texel, left, at.y);
                let seen = tracer.visibility_to_infinity(point, plane, towards);
                let power = texel.power * seen * (towards.dot(normal).abs() / probability);
                beam(-towards, power)
            }
        }
    }

    /// Lamps may stand in water or glass.
    fn find_medium(&mut self, lights: &Lights, key: Key) {
        if self.is_infinite(lights) {
            return;
        }
        let direction = |index: u32| {
            let direction = uniform_sphere(key.point2(index));
            if direction.dot(self.axis) < 0.0 { -direction } else { direction }
        };
        let (origin, from) = match &self.kind {
            Kind::Cells { members, low, size, .. } => {
                let cell = &lights.emitters().cells()[members[0] as usize];
                let middle = *low + 0.5 * *size;
                (cell.point(f64::from(middle.x), f64::from(middle.y)).as_vec3(), cell.plane)
            }
            _ => (self.center, PlaneId::NONE),
        };
        let medium = vote(lights.tracer(), origin, from, direction);
        if medium != MediumId::AIR {
            self.media = MediumStack::inside(medium);
        }
    }
}

#[inline]
fn beam(direction: Vec3, power: Rgb) -> Option<Beam> {
    (power.max_element() > 0.0).then_some(Beam { direction, power, straight: 0.0 })
}

#[cfg(test)]
mod tests {
    use catoptric_light::LightParams;
    use catoptric_scene::{Material, Radiance, Scene, SceneParts};
    use catoptric_trace::Tracer;

    use super::*;
    use crate::caustic::target;

    /// Three bulbs in mirrors, more facets than groups: a group that held facets of two would be half a metre away from the mirrors, and
    /// what it sends to those that are 3 cm from a bulb would be chosen a hundred times too rarely.
    #[test]
    fn no_group_holds_two_lamps() {
        let mut parts = SceneParts::default();
        let glowing = parts.add_material(Material::emitter("bulb", Radiance(Rgb::ONE)));
        let mirror = parts.add_material(Material::mirror("mirror", Rgb::ONE));
        let (bulb, shell) = (0.01, 0.04);
        for x in [-1.0, 0.0, 1.0] {
            parts.add_sphere("bulb", glowing, Vec3::X * x, bulb, 8);
            parts.add_sphere("mirror", mirror, Vec3::X * x, shell, 8);
        }
        let scene = Scene::new(parts).expect("a valid scene");
        let tracer = Tracer::new(&scene);
        let lights = Lights::new(&tracer, LightParams::default());
        let cells = lights.emitters().cells().len();
        assert!(cells > 2 * MAX_SOURCES, "{cells}");
        let targets = target::collect(&lights);
        for limit in [MAX_SOURCES, 7] {
            let mut sources = Vec::new();
            super::cells(&lights, &targets, limit, &mut sources);
            assert_eq!(sources.len(), limit);
            let mut held: Vec<u32> = Vec::new();
            for source in &sources {
                let Kind::Cells { members, .. } = &source.kind else { panic!("not of cells") };
                held.extend(members);
                // Places of one bulb are within its diameter of each other; those of two are 98 of its radii apart.
                assert!(source.radius < 1.8 * bulb, "{limit}: {}", source.radius);
            }
            held.sort_unstable();
            assert_eq!(held, (0..cells as u32).collect::<Vec<_>>(), "each cell is in one group");
        }
    }
}
