//! Irradiance by polygons: Lambert's contour formula with exact horizon and aperture clipping.
//!
//! Source: Lambert 1760; Baum, Rushmeier & Winget 1989, eq. 10: the irradiance at a point by a polygon of unit
//! radiance is ½ Σ_k γ_k (n · Γ_k), γ_k the angle under which edge k is seen and Γ_k the unit normal of the plane
//! through the point and the edge. For emitters with a cosine lobe the same by irradiance tensors (Arvo 1995). Keys in
//! docs/references.md: Lambert1760, Baum1989, Arvo1995.

use glam::DVec3;

/// Most corners that a clipped polygon keeps: four, plus one per clipping plane that cuts a new corner off.
pub const MAX_CORNERS: usize = 24;

/// A convex planar polygon.
#[derive(Clone, Copy, Debug, Default)]
pub struct Polygon {
    corners: [DVec3; MAX_CORNERS],
    count: usize,
}

impl Polygon {
    /// From up to [`MAX_CORNERS`] corners; further ones are dropped.
    pub fn new(corners: &[DVec3]) -> Self {
        let mut polygon = Self { corners: [DVec3::ZERO; MAX_CORNERS], count: 0 };
        for &corner in corners {
            polygon.push(corner);
        }
        polygon
    }

    /// Its corners.
    #[inline]
    pub fn corners(&self) -> &[DVec3] {
        &self.corners[..self.count]
    }

    /// Whether nothing is left.
    #[inline]
    pub fn is_empty(&self) -> bool {
        self.count < 3
    }

    #[inline]
    fn push(&mut self, corner: DVec3) {
        if self.count < MAX_CORNERS {
            self.corners[self.count] = corner;
            self.count += 1;
        }
    }

    /// The part where normal·x ≥ offset.
    pub fn clipped(&self, normal: DVec3, offset: f64) -> Self {
        // Most planes cut nothing off: told without a copy of what is left.
        if self.corners().iter().all(|c| normal.dot(*c) - offset >= 0.0) {
            return *self;
        }
        let mut result = Self::new(&[]);
        self.clip_into(normal, offset, &mut result);
        result
    }

    /// Leaves that part of it; `spare` is a buffer. Half a kilobyte need not be moved.
    pub fn cut(&mut self, normal: DVec3, offset: f64, spare: &mut Self) {
        if self.corners().iter().any(|c| normal.dot(*c) - offset < 0.0) {
            self.clip_into(normal, offset, spare);
            self.assign(spare.corners());
        }
    }

    /// Becomes that of up to [`MAX_CORNERS`] corners.
    pub fn assign(&mut self, corners: &[DVec3]) {
        self.count = corners.len().min(MAX_CORNERS);
        self.corners[..self.count].copy_from_slice(&corners[..self.count]);
    }

    /// The part of it, written over another polygon.
    pub fn clip_into(&self, normal: DVec3, offset: f64, result: &mut Self) {
        result.count = 0;
        clip(self.corners(), |c| normal.dot(c) - offset, DVec3::lerp, |corner| result.push(corner));
    }

    /// Unit normals, towards the polygon, of the planes through `eye` and each edge that is not seen end-on.
    pub fn sight_planes(&self, eye: DVec3) -> impl Iterator<Item = DVec3> {
        let corners = self.corners();
        let center = corners.iter().copied().sum::<DVec3>() / corners.len().max(1) as f64;
        corners.iter().zip(corners.iter().cycle().skip(1)).filter_map(move |(&a, &b)| {
            let normal = (a - eye).cross(b - eye).try_normalize()?;
            Some(if normal.dot(center - eye) < 0.0 { -normal } else { normal })
        })
    }

    /// Its vector area: half the sum of cross products, along its normal.
    pub fn vector_area(&self) -> DVec3 {
        let corners = self.corners();
        let Some(&first) = corners.first() else { return DVec3::ZERO };
        corners.windows(2).map(|w| (w[0] - first).cross(w[1] - first)).sum::<DVec3>() * 0.5
    }

    /// A point of the polygon: fan of triangles, uniform by area.
    pub fn point(&self, u: f64, v: f64) -> DVec3 {
        point_in(self.corners(), u, v)
    }
}

/// A point of a convex polygon: fan of triangles, uniform by area.
pub fn point_in(corners: &[DVec3], u: f64, v: f64) -> DVec3 {
    let first = corners[0];
    let total: f64 = corners.windows(2).skip(1).map(|w| (w[0] - first).cross(w[1] - first).length()).sum();
    let mut remaining = u * total;
    for (index, w) in corners.windows(2).enumerate().skip(1) {
        let area = (w[0] - first).cross(w[1] - first).length();
        if remaining <= area || index + 2 == corners.len() {
            let s = if area > 0.0 { (remaining / area).clamp(0.0, 1.0).sqrt() } else { 0.0 };
            return first + (w[0] - first) * (s * (1.0 - v)) + (w[1] - first) * (s * v);
        }
        remaining -= area;
    }
    first
}

/// Sums of the areas (doubled) of the fan of triangles around the first corner: for many points of one polygon.
pub fn fan_of(corners: &[DVec3], sums: &mut Vec<f64>) {
    sums.clear();
    let mut sum = 0.0;
    sums.extend(corners.windows(2).skip(1).map(|w| {
        sum += (w[0] - corners[0]).cross(w[1] - corners[0]).length();
        sum
    }));
}

/// A point of a convex polygon with its fan, uniform by area.
pub fn point_in_fan(corners: &[DVec3], sums: &[f64], u: f64, v: f64) -> DVec3 {
    let Some(&total) = sums.last() else { return corners[0] };
    let along = u * total;
    let index = sums.partition_point(|&sum| sum < along).min(sums.len() - 1);
    let before = if index > 0 { sums[index - 1] } else { 0.0 };
    let area = sums[index] - before;
    let s = if area > 0.0 { ((along - before) / area).clamp(0.0, 1.0).sqrt() } else { 0.0 };
    let (first, a, b) = (corners[0], corners[index + 1], corners[index + 2]);
    first + (a - first) * (s * (1.0 - v)) + (b - first) * (s * v)
}

/// Leaves of a convex polygon of any number of corners the part where normal·x ≥ offset; `spare` is a buffer.
pub fn cut(corners: &mut Vec<DVec3>, normal: DVec3, offset: f64, spare: &mut Vec<DVec3>) {
    if corners.iter().any(|c| normal.dot(*c) - offset < 0.0) {
        spare.clear();
        clip(corners, |c| normal.dot(c) - offset, DVec3::lerp, |corner| spare.push(corner));
        std::mem::swap(corners, spare);
    }
}

/// Corners this near to a line, as a share of the largest distance of one from it, lie on it: 1e-10 of a polygon's area, and beyond what
/// rounding leaves of a kilometre beside a decimetre. An edge between what rounding tells apart would have any direction.
const ON_LINE: f64 = 1e-10;

/// Visits the corners of the part of a polygon whose `height` is not below zero, in space or in a plane (Sutherland & Hodgman 1974).
#[inline]
pub fn clip<P: Copy>(
    corners: &[P],
    height: impl Fn(P) -> f64,
    lerp: impl Fn(P, P, f64) -> P,
    mut visit: impl FnMut(P),
) {
    let Some(&last) = corners.last() else { return };
    let near = ON_LINE * corners.iter().map(|&corner| height(corner).abs()).fold(0.0, f64::max);
    let (mut previous, mut previous_height) = (last, height(last));
    for &corner in corners {
        let height = height(corner);
        let (is_inside, was_inside) = (height >= -near, previous_height >= -near);
        if is_inside != was_inside && height.max(previous_height) > near {
            visit(lerp(previous, corner, previous_height / (previous_height - height)));
        }
        if is_inside {
            visit(corner);
        }
        (previous, previous_height) = (corner, height);
    }
}

/// Irradiance at `point` with unit normal `normal` by a polygon of unit radiance: the configuration factor times π.
/// The polygon is clipped to the horizon. The sign of its winding does not matter.
pub fn irradiance(point: DVec3, normal: DVec3, polygon: &Polygon) -> f64 {
    let height = normal.dot(point);
    if polygon.corners().iter().all(|c| normal.dot(*c) - height >= 0.0) {
        return irradiance_above(point, normal, polygon.corners());
    }
    irradiance_above(point, normal, polygon.clipped(normal, height).corners())
}

/// The same by a polygon of any number of corners; `spare` is a buffer.
pub fn irradiance_of(point: DVec3, normal: DVec3, corners: &[DVec3], spare: &mut Vec<DVec3>) -> f64 {
    let height = normal.dot(point);
    if corners.iter().all(|c| normal.dot(*c) - height >= 0.0) {
        return irradiance_above(point, normal, corners);
    }
    spare.clear();
    clip(corners, |c| normal.dot(c) - height, DVec3::lerp, |corner| spare.push(corner));
    irradiance_above(point, normal, spare)
}

/// The same by the corners of a polygon no part of which lies below the horizon.
pub fn irradiance_above(point: DVec3, normal: DVec3, corners: &[DVec3]) -> f64 {
    if corners.len() < 3 {
        return 0.0;
    }
    let mut previous = (corners[corners.len() - 1] - point).normalize_or_zero();
    let mut sum = 0.0;
    for &corner in corners {
        let current = (corner - point).normalize_or_zero();
        let cross = previous.cross(current);
        sum += angle_over_sine(cross.length_squared(), previous.dot(current)) * normal.dot(cross);
        previous = current;
    }
    (0.5 * sum).abs()
}

/// γ / sin γ of an angle by the square of its sine and its cosine; 0 where there is no plane through its sides.
#[inline]
fn angle_over_sine(sine2: f64, cosine: f64) -> f64 {
    if sine2 < 0.01 && cosine > 0.0 {
        // The series of arcsin x / x, in x²; the next term is below 2e-14.
        const SERIES: [f64; 6] = [1.0, 1.0 / 6.0, 3.0 / 40.0, 15.0 / 336.0, 105.0 / 3456.0, 945.0 / 42240.0];
        return SERIES.iter().rev().fold(0.0, |sum, c| sum * sine2 + c);
    }
    // atan2 keeps the angle exact for long edges; sinγ = 0: no plane, no contribution.
    let sine = sine2.sqrt();
    if sine > 0.0 { libm::atan2(sine, cosine) / sine } else { 0.0 }
}

/// Irradiance at `point` by a polygon whose radiance is (n+1)/2 · cosⁿ⁻¹θ about its unit normal `axis`, n = `exponent`: for
/// n = 1 the same as [`irradiance`].
///
/// With u the directions of the polygon A, w = −axis, z = w·u = cosθ and v = `normal` it is (n+1)/2 · ∫_A zⁿ⁻¹ (v·u) dω, a
/// double-axis moment of Arvo 1995. Its Stokes reduction, m the outward normals of the planes through the point and the edges,
/// (n+1) ∫ zⁿ⁻¹ (v·u) dω = (n−1)(w·v) ∫ zⁿ⁻² dω − ∮ zⁿ⁻¹ (v·m) ds, leaves an axial moment, which for whole n he brings to
/// n = 0 or 1 step by step. For any n > 0 the field h(z)·(w − z·u) with h = (zⁿ⁻¹ − 1)/((n−1)(1 − z²)) has the divergence
/// zⁿ⁻² and is regular at z = 1, so that the whole is one integral along the edges, on which w·m and v·m are constant:
/// ½ ∮ [ (w·v)(w·m)·(zⁿ⁻¹ − 1)/(1 − z²) − (v·m)·zⁿ⁻¹ ] ds. Gauss's rule finds it.
#[cold]
pub fn lobed_irradiance(point: DVec3, normal: DVec3, polygon: &Polygon, axis: DVec3, exponent: f64) -> f64 {
    let above = polygon.clipped(normal, normal.dot(point));
    if above.is_empty() {
        return 0.0;
    }
    let (w, power) = (-axis, exponent - 1.0);
    let corners = above.corners();
    let mut previous = (corners[corners.len() - 1] - point).normalize_or_zero();
    let mut sum = 0.0;
    for &corner in corners {
        let current = (corner - point).normalize_or_zero();
        let cross = previous.cross(current);
        let sine = cross.length();
        if sine > 0.0 {
            let angle = libm::atan2(sine, previous.dot(current));
            let inward = cross / sine;
            let across = inward.cross(previous);
            // Both integrands change over 1/√n: panels of twice that leave errors of 1e-12.
            let panels = (0.5 * angle * exponent.max(1.0).sqrt()).ceil().max(1.0);
            let half = 0.5 * angle / panels;
            let (mut axial, mut double) = (0.0, 0.0);
            for panel in 0..panels as u32 {
                let middle = (f64::from(2 * panel) + 1.0) * half;
                for (node, weight) in GAUSS {
                    for place in [middle - node * half, middle + node * half] {
                        let (sin, cos) = libm::sincos(place);
                        let u = previous * cos + across * sin;
                        // 1 − z² without cancellation.
                        let q = w.cross(u).length_squared();
                        let raised = power * libm::log(w.dot(u).max(1e-12));
                        double += weight * libm::exp(raised);
                        axial += weight * if q > 1e-14 { libm::expm1(raised) / q } else { -0.5 * power };
                    }
                }
            }
            sum += half * (normal.dot(inward) * double - w.dot(normal) * w.dot(inward) * axial);
        }
        previous = current;
    }
    (0.5 * sum).abs()
}

/// Gauss–Legendre rule of eight points on [−1, 1]: places and weights of the positive half.
const GAUSS: [(f64, f64); 4] = [
    (0.183_434_642_495_649_8, 0.362_683_783_378_362),
    (0.525_532_409_916_329, 0.313_706_645_877_887_3),
    (0.796_666_477_413_626_7, 0.222_381_034_453_374_48),
    (0.960_289_856_497_536_2, 0.101_228_536_290_376_26),
];

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    fn rectangle(corner: DVec3, a: DVec3, b: DVec3) -> Polygon {
        Polygon::new(&[corner, corner + a, corner + a + b, corner + b])
    }

    /// Parallel rectangle with one corner above the point (Howell B-3):
    /// F = (A/√(1+A²)·atan(B/√(1+A²)) + B/√(1+B²)·atan(A/√(1+B²)))/2π.
    #[test]
    fn a_parallel_rectangle_matches_its_closed_form() {
        for (a, b, c) in [(1.0, 1.0, 1.0), (0.3, 2.0, 0.7), (20.0, 0.1, 0.05)] {
            let (x, y): (f64, f64) = (a / c, b / c);
            let (rx, ry) = ((1.0 + x * x).sqrt(), (1.0 + y * y).sqrt());
            let exact = (x / rx * (y / rx).atan() + y / ry * (x / ry).atan()) / (2.0 * PI);
            let polygon = rectangle(DVec3::new(0.0, 0.0, c), DVec3::X * a, DVec3::Y * b);
            let ours = irradiance(DVec3::ZERO, DVec3::Z, &polygon) / PI;
            assert!((ours / exact - 1.0).abs() < 1e-12, "{a} {b} {c}: {ours} {exact}");
        }
    }

    /// Perpendicular rectangle that stands on the point's plane (Howell B-4):
    /// F = (atan(1/y) − y/√(x²+y²)·atan(1/√(x²+y²)))/2π with x = a/b, y = c/b; here the width b is on one side.
    #[test]
    fn a_perpendicular_rectangle_matches_its_closed_form_below_the_horizon_too() {
        let (width, height, distance): (f64, f64, f64) = (0.8, 1.3, 0.4);
        let (x, y) = (height / width, distance / width);
        let root = (x * x + y * y).sqrt();
        let exact = ((1.0 / y).atan() - y / root * (1.0 / root).atan()) / (2.0 * PI);
        // The same wall goes on below the horizon: that part gives nothing.
        let wall = rectangle(DVec3::new(0.0, distance, -5.0), DVec3::X * width, DVec3::Z * (5.0 + height));
        let ours = irradiance(DVec3::ZERO, DVec3::Z, &wall) / PI;
        assert!((ours / exact - 1.0).abs() < 1e-12, "{ours} {exact}");
    }

    /// The same integral by midpoints over the area: (n+1)/2 · Σ cosⁿθ·cosθ'/r² dA.
    fn by_area(point: DVec3, normal: DVec3, [corner, a, b]: [DVec3; 3], exponent: f64) -> f64 {
        let axis = a.cross(b);
        let steps = 1000;
        let mut sum = 0.0;
        for i in 0..steps {
            for j in 0..steps {
                let at = |k: i32| (f64::from(k) + 0.5) / f64::from(steps);
                let offset = corner + a * at(i) + b * at(j) - point;
                let r2 = offset.length_squared();
                let leaves = -axis.dot(offset) / (axis.length() * r2.sqrt());
                let arrives = normal.dot(offset).max(0.0) / r2.sqrt();
                sum += libm::pow(leaves, exponent) * arrives / r2;
            }
        }
        0.5 * (exponent + 1.0) * sum * axis.length() / f64::from(steps * steps)
    }

    #[test]
    fn a_lobed_rectangle_matches_its_sum_over_the_area() {
        // Straight below, off the axis, beside it with a tilted receiver that it sets for, close to it.
        let places = [
            (DVec3::ZERO, DVec3::Z),
            (DVec3::new(0.9, -0.4, 0.2), DVec3::Z),
            (DVec3::new(1.5, 0.3, 0.1), DVec3::new(-0.8, 0.0, 0.6)),
            (DVec3::new(0.1, 0.2, 0.8), DVec3::new(0.0, 0.6, 0.8)),
        ];
        for exponent in [0.3, 0.7, 1.0, 1.8, 2.0, 5.0, 30.0, 400.0] {
            for (point, normal) in places {
                // The front looks down.
                let sides = [DVec3::new(-0.5, -0.4, 1.0), DVec3::Y * 0.8, DVec3::X];
                let polygon = rectangle(sides[0], sides[1], sides[2]);
                let ours = lobed_irradiance(point, normal, &polygon, DVec3::NEG_Z, exponent);
                let sum = by_area(point, normal, sides, exponent);
                assert!((ours - sum).abs() < 5e-5 * sum + 1e-9, "n = {exponent} at {point}: {ours} {sum}");
                if exponent == 1.0 {
                    let lambert = irradiance(point, normal, &polygon);
                    assert!((ours / lambert - 1.0).abs() < 1e-12, "{ours} {lambert}");
                }
            }
        }
    }

    /// A lamp that fills the view sends (n+1)/2 · ∫ cosⁿθ dω = π whatever n is, straight below.
    #[test]
    fn a_lobed_ceiling_without_end_gives_what_a_diffuse_one_gives() {
        for exponent in [0.5, 3.0, 50.0, 1000.0] {
            let wide = 1e6;
            let polygon =
                rectangle(DVec3::new(-wide, -wide, 1.0), DVec3::Y * (2.0 * wide), DVec3::X * (2.0 * wide));
            let ours = lobed_irradiance(DVec3::ZERO, DVec3::Z, &polygon, DVec3::NEG_Z, exponent);
            assert!(
                (ours / PI - 1.0).abs() < if exponent < 1.0 { 1e-3 } else { 1e-5 },
                "n = {exponent}: {ours}"
            );
        }
    }

    /// Seen through a window in a plane half-way, the part of a screen is twice the window.
    #[test]
    fn a_window_half_way_shows_a_part_of_twice_its_size() {
        let screen = rectangle(DVec3::new(-10.0, -10.0, 2.0), DVec3::X * 20.0, DVec3::Y * 20.0);
        let window = rectangle(DVec3::new(0.1, 0.2, 1.0), DVec3::X * 0.3, DVec3::Y * 0.4);
        let mut part = screen;
        for normal in window.sight_planes(DVec3::ZERO) {
            part = part.clipped(normal, 0.0);
        }
        assert!((part.vector_area().length() - 0.3 * 0.4 * 4.0).abs() < 1e-12);
        for i in 0..50 {
            let p = part.point(f64::from(i) / 50.0, f64::from(i * 7 % 50) / 50.0);
            assert!(p.x >= 0.2 - 1e-12 && p.x <= 0.8 + 1e-12 && p.y >= 0.4 - 1e-12 && p.y <= 1.2 + 1e-12);
        }
    }

    /// Planes through its own edges, as rounding leaves them, cut nothing off and add no corner; one through a diagonal adds none either.
    #[test]
    fn what_a_plane_touches_has_no_new_corners() {
        let square = rectangle(DVec3::new(3.1, -0.2, 2.0), DVec3::X * 0.4, DVec3::Y * 0.4);
        let (left, right) = (square.corners()[0].x, square.corners()[1].x);
        for error in [0.0, 1e-12, -1e-12, 4e-16, -4e-16] {
            assert_eq!(square.clipped(DVec3::X, left + error).corners(), square.corners());
            assert_eq!(square.clipped(DVec3::NEG_X, -right + error).corners(), square.corners());
            let across = DVec3::new(-1.0, 1.0, 0.0);
            let half = square.clipped(across, across.dot(square.corners()[0]) + error);
            assert_eq!(half.corners(), [0, 2, 3].map(|k| square.corners()[k]));
        }
        // What is more than that is cut.
        let less = square.clipped(DVec3::X, left + 1e-8);
        assert!((less.vector_area().length() - 0.4 * (0.4 - 1e-8)).abs() < 1e-15);
    }

    #[test]
    fn a_fan_gives_the_points_that_the_polygon_gives() {
        let corners: Vec<DVec3> = (0..9)
            .map(|k| DVec3::new(libm::cos(0.7 * f64::from(k)), libm::sin(0.7 * f64::from(k)), 0.3))
            .collect();
        let mut fan = Vec::new();
        fan_of(&corners, &mut fan);
        for i in 0..200 {
            let (u, v) = (f64::from(i) / 199.0, f64::from(i * 7 % 200) / 199.0);
            let difference = point_in_fan(&corners, &fan, u, v) - point_in(&corners, u, v);
            // What is left of sums of seven areas is off by some 1e-15 of them; its square root, the place, by 3e-8.
            assert!(difference.length() < 1e-7, "{u} {v}: {difference}");
        }
    }
}
