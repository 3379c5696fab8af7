//! How far the light of a source goes over mirrors: receivers elsewhere need not ask for it.

use std::collections::BTreeMap;

use glam::DVec3;

use catoptric_scene::{PunctualKind, PunctualLight};
use catoptric_trace::Tracer;
use catoptric_trace::plane::Plane;

use crate::contour::{MAX_CORNERS, Polygon};
use crate::emitter::Emitters;

/// A ball around something.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Ball {
    center: DVec3,
    radius: f64,
}

impl Ball {
    /// Around points; not the smallest.
    pub(crate) fn around(points: impl Iterator<Item = DVec3> + Clone) -> Self {
        let (low, high) = points
            .clone()
            .fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), p| (low.min(p), high.max(p)));
        let center = 0.5 * (low + high);
        Self { center, radius: points.map(|p| p.distance(center)).fold(0.0, f64::max) }
    }

    /// Whether some of it lies on the side of a place to which a unit normal points.
    #[inline]
    pub(crate) fn is_above(&self, place: DVec3, normal: DVec3) -> bool {
        normal.dot(self.center - place) > -self.radius
    }
}

/// Where something may arrive.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Reach {
    /// Anywhere.
    Everywhere,
    /// In a cone, whose half-angle has this cosine.
    Cone { apex: DVec3, axis: DVec3, cos: f64 },
    /// In a tube around a straight line.
    Tube { point: DVec3, axis: DVec3, radius: f64 },
}

/// Places this much outside of a cone, as a difference of cosines, or of a tube, as a share of its radius, are in it: rounding.
const ROUNDING: f64 = 1e-7;

impl Reach {
    /// What lines from one ball through another one meet beyond that: the tangents that touch both, one on each side, cross
    /// between them, and all such lines go on inside the cone that they make.
    fn through(source: Ball, window: Ball) -> Self {
        let towards = window.center - source.center;
        let (distance, radii) = (towards.length(), source.radius + window.radius);
        let sin = radii / distance;
        if sin.is_nan() || sin >= 1.0 {
            return Self::Everywhere;
        }
        let apex = source.center + towards * (source.radius / radii.max(f64::MIN_POSITIVE));
        Self::Cone { apex, axis: towards / distance, cos: (1.0 - sin * sin).sqrt() }
    }

    /// Where light of a source in `ball` arrives by a mirror in `plane` whose pieces lie in `window`.
    pub(crate) fn over(plane: &Plane, window: Ball, ball: Ball) -> Self {
        Self::through(Ball { center: plane.reflect_point(ball.center), ..ball }, window)
    }

    /// Whether a place lies in it.
    #[inline]
    pub(crate) fn holds(&self, place: DVec3) -> bool {
        match *self {
            Self::Everywhere => true,
            Self::Cone { apex, axis, cos } => {
                let offset = place - apex;
                offset.dot(axis) >= (cos - ROUNDING) * offset.length()
            }
            Self::Tube { point, axis, radius } => {
                (place - point).cross(axis).length_squared() <= radius * radius * (1.0 + ROUNDING)
            }
        }
    }
}

/// What a punctual light sends through some windows.
#[derive(Clone, Debug)]
pub(crate) struct Beam<'a> {
    light: &'a PunctualLight,
    /// Planes around it: unit normals inwards, and offsets.
    sides: Vec<(DVec3, f64)>,
}

/// A beam is wider by this share of the window than what passes it: corners of a mirror are in its plane but for rounding.
const MARGIN: f64 = 1e-6;

impl<'a> Beam<'a> {
    /// All that it sends.
    pub(crate) fn of(light: &'a PunctualLight) -> Self {
        Self { light, sides: Vec::new() }
    }

    /// Where it starts; `None` if far away.
    fn origin(&self) -> Option<DVec3> {
        match self.light.kind {
            PunctualKind::Directional => None,
            PunctualKind::Point
            | PunctualKind::Spot { .. }
            | PunctualKind::Lobe { .. }
            | PunctualKind::Photometric { .. } => Some(self.light.position.as_dvec3()),
        }
    }

    fn direction(&self) -> DVec3 {
        self.light.direction.as_dvec3()
    }

    /// Cosine of the half-angle of the cone outside of which nothing is sent.
    fn cos(&self) -> f64 {
        match self.light.kind {
            PunctualKind::Spot { cos_outer, .. } => f64::from(cos_outer),
            PunctualKind::Lobe { .. } => 0.0,
            PunctualKind::Point | PunctualKind::Directional | PunctualKind::Photometric { .. } => -1.0,
        }
    }

    /// Whether it arrives on the side of a plane to which its normal points.
    pub(crate) fn is_above(&self, normal: DVec3, point: DVec3) -> bool {
        normal.dot(self.origin().map_or(-self.direction(), |origin| origin - point)) > 0.0
    }

    /// The part of a window that it lights.
    pub(crate) fn part(&self, window: &Polygon) -> Polygon {
        let mut part = *window;
        for &(normal, offset) in &self.sides {
            part = part.clipped(normal, offset);
        }
        if part.is_empty() {
            return part;
        }
        let ball = Ball::around(part.corners().iter().copied());
        let is_off = self.origin().is_some_and(|origin| {
            let towards = ball.center - origin;
            let (distance, cos) = (towards.length(), self.cos());
            // Off by more than the cone and the ball take up together.
            let angle = libm::acos((towards.dot(self.direction()) / distance).clamp(-1.0, 1.0));
            cos > -1.0
                && distance > ball.radius
                && angle > libm::acos(cos) + libm::asin(ball.radius / distance) + MARGIN
        });
        if is_off { Polygon::new(&[]) } else { part }
    }

    /// Keeps what goes on through a window.
    pub(crate) fn narrow(&mut self, window: &Polygon) {
        let corners = window.corners();
        // As many sides as this may cut off as many corners: the sides of the window before do, then.
        if corners.len() > MAX_CORNERS / 2 {
            return;
        }
        let center = corners.iter().copied().sum::<DVec3>() / corners.len().max(1) as f64;
        let margin = MARGIN * Ball::around(corners.iter().copied()).radius;
        let way = |corner: DVec3| self.origin().map_or(self.direction(), |origin| corner - origin);
        // A light in the window's own plane, as one that is mounted on a mirror, has no planes through it and the edges that say more.
        let (across, along) = (window.vector_area().normalize_or_zero(), way(center));
        if across.dot(along).abs() <= MARGIN * along.length() {
            return;
        }
        let ends = corners.iter().zip(corners.iter().cycle().skip(1));
        let side = |(&a, &b): (&DVec3, &DVec3)| {
            let normal = (b - a).cross(way(a)).try_normalize()?;
            let normal = if normal.dot(center - a) < 0.0 { -normal } else { normal };
            Some((normal, normal.dot(a) - margin))
        };
        self.sides = ends.filter_map(side).collect();
    }

    /// Where it arrives by way of mirrors of which the receiver sees the first in `window`: `imaged` and `turned` say where a point and a
    /// direction are seen in them.
    pub(crate) fn reach(
        &self,
        window: Ball,
        imaged: impl Fn(DVec3) -> DVec3,
        turned: impl Fn(DVec3) -> DVec3,
    ) -> Reach {
        let axis = turned(self.direction()).normalize_or_zero();
        let Some(origin) = self.origin() else {
            return Reach::Tube { point: window.center, axis, radius: window.radius };
        };
        let apex = imaged(origin);
        let through = Reach::through(Ball { center: apex, radius: 0.0 }, window);
        match through {
            Reach::Cone { cos, .. } if cos < self.cos() => Reach::Cone { apex, axis, cos: self.cos() },
            _ => through,
        }
    }
}

/// Area sources that have a reach of their own; of more, all have one together.
const MAX_BALLS: usize = 16;

/// Balls around the area sources, by surface.
pub(crate) fn source_balls(tracer: &Tracer, emitters: &Emitters) -> Vec<Ball> {
    let mut corners: BTreeMap<u32, Vec<DVec3>> = BTreeMap::new();
    for cell in emitters.cells() {
        let surface = tracer.scene().surface_of(cell.triangle()).triangles.start;
        corners.entry(surface).or_default().extend_from_slice(cell.polygon().corners());
    }
    if corners.len() > MAX_BALLS {
        return vec![Ball::around(corners.values().flatten().copied())];
    }
    corners.values().map(|own| Ball::around(own.iter().copied())).collect()
}

#[cfg(test)]
mod tests {
    use catoptric_scene::Rgb;
    use catoptric_trace::sequence::{Key, Purpose};
    use glam::{DVec2, Vec3};

    use super::*;

    fn point_in(ball: Ball, key: Key) -> DVec3 {
        let [a, b] = [0, 1].map(|k| key.child(k).point2(0).as_dvec2());
        let unit = DVec3::new(2.0 * a.x - 1.0, 2.0 * a.y - 1.0, 2.0 * b.x - 1.0);
        ball.center + unit * (ball.radius / 3.0_f64.sqrt())
    }

    /// All lines through both balls stay in the cone, and it is no wider than it must be.
    #[test]
    fn a_cone_holds_what_passes_two_balls_and_little_else() {
        let source = Ball { center: DVec3::new(1.0, 2.0, -0.5), radius: 0.3 };
        let window = Ball { center: DVec3::new(-1.0, 1.0, 2.0), radius: 0.1 };
        let reach = Reach::through(source, window);
        for index in 0..1000 {
            let key = Key::new(0, Purpose::Test, index);
            let (from, through) = (point_in(source, key.child(1)), point_in(window, key.child(2)));
            let beyond = 1.0 + 5.0 * f64::from(key.child(3).uniform(0));
            assert!(reach.holds(from + (through - from) * beyond), "{index}");
        }
        // On the tangent from the rim of one to the far rim of the other, and a hundredth of the angle off it.
        let axis = (window.center - source.center).normalize_or_zero();
        let across = axis.any_orthonormal_vector();
        let Reach::Cone { apex, cos, .. } = reach else { panic!("the balls are apart") };
        let half = libm::acos(cos);
        let at = |angle: f64| apex + axis * libm::cos(angle) + across * libm::sin(angle);
        assert!(reach.holds(at(0.999 * half)) && !reach.holds(at(1.01 * half)));
        // A ball around the window has it everywhere.
        assert_eq!(Reach::through(source, Ball { radius: 9.0, ..window }), Reach::Everywhere);
    }

    /// No point of a ball that is not above a horizon is; of one that just is, some are.
    #[test]
    fn a_ball_is_above_a_horizon_as_long_as_its_highest_point_is() {
        let ball = Ball { center: DVec3::new(0.4, 1.0, -2.0), radius: 0.25 };
        let normal = DVec3::new(2.0, -1.0, 2.0) / 3.0;
        let highest = ball.center + normal * ball.radius;
        let beside = normal.any_orthonormal_vector() * 3.0;
        assert!(ball.is_above(highest + beside - normal * 1e-6, normal));
        let place = highest + beside + normal * 1e-6;
        assert!(!ball.is_above(place, normal) && ball.is_above(place, -normal));
        let is_above = |index| normal.dot(point_in(ball, Key::new(0, Purpose::Test, index)) - place) > 0.0;
        assert!(!(0..1000).any(is_above));
    }

    #[test]
    fn the_sun_reaches_a_tube_and_a_lamp_a_cone_over_a_mirror() {
        let plane = Plane { normal: DVec3::Y, offset: 0.0 };
        let window = Ball { center: DVec3::ZERO, radius: 0.5 };
        let light = |kind, position, direction| PunctualLight {
            name: "light".to_owned(),
            kind,
            position,
            direction,
            intensity: Rgb::ONE,
        };
        let down = Vec3::new(1.0, -1.0, 0.0).normalize_or_zero();
        let over = |light: &PunctualLight| {
            Beam::of(light).reach(window, |p| plane.reflect_point(p), |v| plane.reflect_vector(v))
        };
        let sun = over(&light(PunctualKind::Directional, Vec3::ZERO, down));
        let lamp = over(&light(PunctualKind::Point, Vec3::new(-2.0, 2.0, 0.0), down));
        for (reach, name) in [(sun, "sun"), (lamp, "lamp")] {
            let at = |p: DVec2| reach.holds(DVec3::new(p.x, p.y, 0.0));
            // Both go up to the right by 45 degrees.
            assert!(
                at(DVec2::new(5.0, 5.0)) && !at(DVec2::new(-5.0, 5.0)) && !at(DVec2::new(5.0, 0.5)),
                "{name}"
            );
        }
        // What is as wide as the mirror there, and what has widened from 2.83 m to 11.3 m.
        let off = DVec3::new(-0.5, 0.5, 0.0).normalize_or_zero();
        let far = DVec3::new(6.0, 6.0, 0.0);
        assert!(sun.holds(far + off * 0.49) && !sun.holds(far + off * 0.51));
        assert!(lamp.holds(far + off * 1.9) && !lamp.holds(far + off * 2.1));
        // A spot whose cone is narrower: 1° of half-angle are 0.197 m after 11.3 m.
        let (cos_inner, cos_outer) = (1.0, libm::cosf(1.0_f32.to_radians()));
        let spot = PunctualKind::Spot { cos_inner, cos_outer };
        let spot = over(&light(spot, Vec3::new(-2.0, 2.0, 0.0), down));
        assert!(spot.holds(far + off * 0.19) && !spot.holds(far + off * 0.21));
    }
}
