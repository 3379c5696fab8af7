//! What small bright places send to what is beside them, such as a wall at whose foot a patch of sun ends: a hierarchy of their elements
//! (Walter et al. 2005, "Lightcuts"), opened where it is near.

use glam::Vec3;

use catoptric_light::{Receiver, contour};
use catoptric_scene::Rgb;
use catoptric_trace::{PlaneId, Tracer};

/// Radius of what stands for all in it, as a share of its distance, at most: irradiance by it is off by up to one and a half
/// times the square, 6 %, where it arrives and leaves at a grazing angle; and evenly so, which bends nothing.
const NARROW: f32 = 0.2;

/// Cosine to a common normal from which on elements look the same way.
const FLAT: f32 = 0.999_999;
/// Height over a plane, in radii, below which something lies in it.
const IN_PLANE: f32 = 1e-3;

/// An element of a bright place.
#[derive(Clone, Copy, Debug)]
pub(super) struct Bright {
    pub(super) corners: [Vec3; 3],
    /// Unit, on the side that sends.
    pub(super) normal: Vec3,
    pub(super) plane: PlaneId,
    /// Largest channel.
    pub(super) radiance: f32,
    /// m².
    pub(super) area: f32,
}

impl Bright {
    fn middle(&self) -> Vec3 {
        self.corners.iter().sum::<Vec3>() / 3.0
    }
}

/// Some of them.
#[derive(Clone, Copy, Debug)]
struct Node {
    /// Weighted by what they send.
    center: Vec3,
    /// Mean of their normals, likewise: its length tells how much they agree.
    axis: Vec3,
    radius: f32,
    /// All look the same way, and lie in one plane.
    is_flat: bool,
    /// Radiance times area.
    sent: f32,
    /// The node after all that are in this one.
    end: u32,
    /// The element that it is, or that stands for it in the way of things.
    element: u32,
}

impl Node {
    /// How far it reaches above and below its middle along a unit normal.
    fn reach(&self, normal: Vec3) -> f32 {
        self.radius * if self.is_flat { self.axis.cross(normal).length() } else { 1.0 }
    }

    /// Whether all of it lies in the plane of a point `way` off, or below.
    fn is_below(&self, way: Vec3, normal: Vec3) -> bool {
        way.dot(normal) + self.reach(normal) <= IN_PLANE * self.radius
    }
}

/// The elements of bright places, by where they are.
#[derive(Clone, Debug, Default)]
pub(super) struct Beside {
    elements: Vec<Bright>,
    /// Depth first.
    nodes: Vec<Node>,
}

impl Beside {
    pub(super) fn new(elements: Vec<Bright>) -> Self {
        let mut order: Vec<u32> = (0..elements.len() as u32).collect();
        let mut beside = Self { nodes: Vec::with_capacity(2 * elements.len()), elements };
        if !order.is_empty() {
            beside.push(&mut order);
        }
        beside
    }

    /// Appends the node of some elements, and all in it.
    fn push(&mut self, own: &mut [u32]) {
        let place = self.nodes.len();
        let (mut center, mut axis, mut sent) = (Vec3::ZERO, Vec3::ZERO, 0.0);
        let (mut low, mut high) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
        for element in own.iter().map(|&index| &self.elements[index as usize]) {
            let power = element.radiance * element.area;
            center += element.middle() * power;
            axis += element.normal * power;
            sent += power;
            (low, high) = (low.min(element.middle()), high.max(element.middle()));
        }
        let share = 1.0 / sent.max(f32::MIN_POSITIVE);
        let center = center * share;
        let away = |index: &u32| self.elements[*index as usize].middle().distance_squared(center);
        let corners = own.iter().flat_map(|&index| self.elements[index as usize].corners);
        let radius = corners.map(|corner| corner.distance(center)).fold(0.0, f32::max);
        let element = own.iter().copied().min_by(|a, b| away(a).total_cmp(&away(b)).then(a.cmp(b)));
        let element = element.unwrap_or(0);
        let axis = axis * share;
        let is_flat = own.iter().map(|&index| &self.elements[index as usize]).all(|element| {
            let off = (element.middle() - center).dot(axis).abs();
            element.normal.dot(axis) > FLAT && off <= IN_PLANE * radius
        });
        self.nodes.push(Node { center, axis, radius, is_flat, sent, end: 0, element });
        if own.len() > 1 {
            let extent = high - low;
            let longest = extent.max_position();
            let along = |index: &u32| self.elements[*index as usize].middle()[longest];
            let half = own.len() / 2;
            own.select_nth_unstable_by(half, |a, b| along(a).total_cmp(&along(b)).then(a.cmp(b)));
            let (one, other) = own.split_at_mut(half);
            self.push(one);
            self.push(other);
        }
        self.nodes[place].end = self.nodes.len() as u32;
    }

    /// Whether any of them is within a distance of a point, before a unit normal there.
    pub(super) fn is_near(&self, point: Vec3, normal: Vec3, within: f32) -> bool {
        let mut next = 0;
        while let Some(node) = self.nodes.get(next) {
            let way = node.center - point;
            let is_far = way.length_squared() > (within + node.radius).powi(2);
            if is_far || node.is_below(way, normal) {
                next = node.end as usize;
            } else if node.end as usize == next + 1 {
                return true;
            } else {
                next += 1;
            }
        }
        false
    }

    /// Irradiance at a point with a unit normal, if `sees` an element of each part.
    fn irradiance(&self, point: Vec3, normal: Vec3, sees: impl Fn(&Bright) -> bool) -> f32 {
        let (mut sum, mut next) = (0.0, 0);
        let mut spare = Vec::new();
        while let Some(node) = self.nodes.get(next) {
            let way = node.center - point;
            if node.is_below(way, normal) {
                next = node.end as usize;
                continue;
            }
            let distance = way.length_squared();
            let height = way.dot(normal);
            let is_leaf = node.end as usize == next + 1;
            // What the horizon cuts is opened, too.
            let is_narrow =
                node.radius * node.radius < NARROW * NARROW * distance && height >= node.reach(normal);
            if !(is_narrow || is_leaf) {
                next += 1;
                continue;
            }
            next = node.end as usize;
            let element = &self.elements[node.element as usize];
            let found = if is_narrow {
                let cosines = height * (-way.dot(node.axis)).max(0.0);
                node.sent * cosines / (distance * distance)
            } else if (element.corners[0] - point).dot(element.normal) < 0.0 {
                let corners = element.corners.map(Vec3::as_dvec3);
                let unit = contour::irradiance_of(point.as_dvec3(), normal.as_dvec3(), &corners, &mut spare);
                element.radiance * unit as f32
            } else {
                0.0
            };
            if found > 0.0 && sees(element) {
                sum += found;
            }
        }
        sum
    }

    /// Irradiance at a point with a unit normal, if nothing is in the way.
    pub(super) fn free(&self, point: Vec3, normal: Vec3) -> f32 {
        self.irradiance(point, normal, |_| true)
    }

    /// Irradiance at a receiver.
    pub(super) fn seen(&self, tracer: &Tracer, receiver: &Receiver) -> f32 {
        self.irradiance(receiver.position, receiver.normal, |element| {
            let (from, to) = (receiver.position, element.middle());
            tracer.visibility(from, receiver.plane, to, element.plane) != Rgb::ZERO
        })
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;

    /// A square patch of the floor of 0.2 m, radiance 1, in `parts` by `parts` squares.
    fn patch(parts: usize) -> Beside {
        let side = 0.2 / parts as f32;
        let mut elements = Vec::new();
        for index in 0..parts * parts {
            let corner = Vec3::new((index % parts) as f32, 0.0, (index / parts) as f32) * side;
            let [a, b, c, d] =
                [Vec3::ZERO, Vec3::Z, Vec3::X + Vec3::Z, Vec3::X].map(|step| corner + step * side);
            for corners in [[a, b, c], [a, c, d]] {
                elements.push(Bright {
                    corners,
                    normal: Vec3::Y,
                    plane: PlaneId::NONE,
                    radiance: 1.0,
                    area: 0.5 * side * side,
                });
            }
        }
        Beside::new(elements)
    }

    #[test]
    fn what_stands_for_many_elements_sends_what_they_do() {
        let beside = patch(16);
        let square = [DVec3::ZERO, DVec3::Z * 0.2, DVec3::new(0.2, 0.0, 0.2), DVec3::X * 0.2];
        // On a wall at the patch's border, on one that it crosses, before one, and above.
        for (x, normal) in [(0.0, Vec3::X), (0.1, Vec3::X), (-0.3, Vec3::X), (0.05, Vec3::NEG_Y)] {
            for y in [0.003, 0.01, 0.05, 0.2, 1.0] {
                let point = Vec3::new(x, y, 0.13);
                let own = point.as_dvec3();
                let exact = contour::irradiance_of(own, normal.as_dvec3(), &square, &mut Vec::new()) as f32;
                let found = beside.free(point, normal);
                assert!(
                    (found / exact - 1.0).abs() < 0.06,
                    "{found} for {exact} at {point} towards {normal}"
                );
            }
        }
        // Nothing below, and nothing behind.
        assert_eq!(beside.free(Vec3::new(0.1, -0.2, 0.1), Vec3::Y), 0.0);
        assert_eq!(beside.free(Vec3::new(0.1, 0.2, 0.1), Vec3::Y), 0.0);
        assert_eq!(Beside::new(Vec::new()).free(Vec3::ZERO, Vec3::Y), 0.0);
    }
}
