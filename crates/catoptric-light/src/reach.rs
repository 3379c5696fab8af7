//! How far the light of a source goes over a small mirror: receivers elsewhere need not ask for it.

use std::collections::BTreeMap;

use glam::DVec3;

use catoptric_scene::{PunctualKind, PunctualLight};
use catoptric_trace::Tracer;
use catoptric_trace::plane::Plane;

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

    /// Where a punctual light arrives likewise.
    pub(crate) fn of_punctual(plane: &Plane, window: Ball, light: &PunctualLight) -> Self {
        match light.kind {
            PunctualKind::Directional => Self::Tube {
                point: window.center,
                axis: plane.reflect_vector(light.direction.as_dvec3()).normalize_or_zero(),
                radius: window.radius,
            },
            PunctualKind::Point
            | PunctualKind::Spot { .. }
            | PunctualKind::Lobe { .. }
            | PunctualKind::Photometric { .. } => {
                Self::over(plane, window, Ball { center: light.position.as_dvec3(), radius: 0.0 })
            }
        }
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
        let sun = Reach::of_punctual(&plane, window, &light(PunctualKind::Directional, Vec3::ZERO, down));
        let lamp =
            Reach::of_punctual(&plane, window, &light(PunctualKind::Point, Vec3::new(-2.0, 2.0, 0.0), down));
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
    }
}
