//! Keyed random numbers and low-discrepancy sequences: the same bits for any thread count, because every
//! stream is derived from (entity, sample) and never from a thread.
//!
//! Sources: Sobol' 1967 (dimensions 0 and 1 form a (0,2)-sequence); nested uniform scrambling of Owen 1995 by
//! hashing, Laine & Karras 2011, with the hash of Burley 2020, "Practical hash-based Owen scrambling",
//! JCGT 9(4) (keys in docs/references.md: Owen1995, LaineKarras2011, Burley2020).

use std::f32::consts::PI;

use glam::{Vec2, Vec3};

/// What a stream of numbers is for, so that no two uses share one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Purpose {
    /// Hemisphere directions.
    Hemisphere = 1,
    /// Points on a patch.
    PatchPoint = 2,
    /// Branch choices of walks.
    Roulette = 3,
    /// Points on emitters.
    Emitter = 4,
    /// Points inside pixels.
    Pixel = 5,
    /// Light-side rays.
    LightRay = 6,
    /// Choice among emitters.
    EmitterChoice = 7,
    /// Points inside display elements.
    ElementPoint = 8,
    /// Anything in tests.
    Test = 9,
    /// Samples of a form factor method.
    FormFactor = 10,
    /// Paths from sources over image chains.
    Glint = 11,
    /// Looks at bodies that may be lenses.
    Lens = 12,
}

/// A well-mixed 32-bit hash (the finaliser of Murmur3).
#[inline]
pub fn mix(mut x: u32) -> u32 {
    x ^= x >> 16;
    x = x.wrapping_mul(0x85eb_ca6b);
    x ^= x >> 13;
    x = x.wrapping_mul(0xc2b2_ae35);
    x ^ (x >> 16)
}

/// Key of a stream: the user's seed, what it is for, and the entity it belongs to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Key(u32);

impl Key {
    /// A key from seed, purpose and entity.
    #[inline]
    pub fn new(seed: u32, purpose: Purpose, entity: u64) -> Self {
        let low = entity as u32;
        let high = (entity >> 32) as u32;
        let with_purpose = mix(seed.wrapping_mul(0x9e37_79b9) ^ (purpose as u32).wrapping_mul(0x7feb_352d));
        Self(mix(mix(with_purpose ^ low).wrapping_add(high.wrapping_mul(0x846c_a68b)) ^ 0x68bc_21eb))
    }

    /// A key derived from this one.
    #[inline]
    pub fn child(self, index: u32) -> Self {
        Self(mix(self.0 ^ mix(index.wrapping_add(0x02e5_be93))))
    }

    /// A number in [0, 1) for `index`.
    #[inline]
    pub fn uniform(self, index: u32) -> f32 {
        unit(mix(self.0 ^ mix(index.wrapping_mul(0x9e37_79b9).wrapping_add(0x3c6e_f372))))
    }

    /// Number `index` of van der Corput's sequence, shifted as a whole by a random number, in [0, 1).
    #[inline]
    pub fn shifted(self, index: u32) -> f32 {
        unit(self.bits(0).wrapping_add(index.reverse_bits()))
    }

    /// Raw bits for `index`.
    #[inline]
    pub fn bits(self, index: u32) -> u32 {
        mix(self.0 ^ mix(index.wrapping_mul(0x9e37_79b9).wrapping_add(0x3c6e_f372)))
    }

    /// Point `index` of an Owen-scrambled (0,2)-sequence in [0, 1)².
    #[inline]
    pub fn point2(self, index: u32) -> Vec2 {
        // Scrambling the index as well decorrelates the streams beyond 2-d (Burley 2020, §3).
        let index = owen_scramble(index, self.0);
        let x = owen_scramble(index.reverse_bits(), mix(self.0 ^ 0xa511_e9b3));
        let y = owen_scramble(sobol1(index), mix(self.0 ^ 0x63d8_3595));
        Vec2::new(unit(x), unit(y))
    }

    /// Point `index` of an Owen-scrambled Sobol' sequence in [0, 1)⁴. Its first two dimensions are a (0,2)-sequence.
    #[inline]
    pub fn point4(self, index: u32) -> [f32; 4] {
        let index = owen_scramble(index, self.0);
        let digits = [index.reverse_bits(), sobol1(index), sobol(&SOBOL2, index), sobol(&SOBOL3, index)];
        let seeds = [0xa511_e9b3, 0x63d8_3595, 0x1f83_d9ab, 0x5be0_cd19];
        std::array::from_fn(|d| unit(owen_scramble(digits[d], mix(self.0 ^ seeds[d]))))
    }

    /// Point `index` of an Owen-scrambled van der Corput sequence in [0, 1).
    #[inline]
    pub fn point1(self, index: u32) -> f32 {
        let index = owen_scramble(index, self.0);
        unit(owen_scramble(index.reverse_bits(), mix(self.0 ^ 0xb5ad_4ece)))
    }
}

/// 24 random bits to [0, 1).
#[inline]
fn unit(bits: u32) -> f32 {
    (bits >> 8) as f32 * (1.0 / 16_777_216.0)
}

/// Second dimension of Sobol' (direction numbers of the polynomial x + 1), as a 32-bit fraction.
#[inline]
fn sobol1(index: u32) -> u32 {
    // Multiplication by the Pascal matrix mod 2, by doubling (Ahmed 2024 gives the same closed form).
    let mut x = index.reverse_bits();
    x ^= x << 16;
    x ^= (x & 0x00ff_00ff) << 8;
    x ^= (x & 0x0f0f_0f0f) << 4;
    x ^= (x & 0x3333_3333) << 2;
    x ^ ((x & 0x5555_5555) << 1)
}

/// Direction numbers of dimensions 2 and 3 (Joe & Kuo 2008, "Constructing Sobol sequences with better
/// two-dimensional projections"): degree, coefficients and initial numbers m of the primitive polynomials.
const SOBOL2: [u32; 32] = direction_numbers(2, 1, [1, 3, 0]);
const SOBOL3: [u32; 32] = direction_numbers(3, 1, [1, 3, 1]);

const fn direction_numbers(degree: usize, coefficients: u32, initial: [u32; 3]) -> [u32; 32] {
    let mut v = [0; 32];
    let mut i = 0;
    while i < 32 {
        if i < degree {
            v[i] = initial[i] << (31 - i);
        } else {
            v[i] = v[i - degree] ^ (v[i - degree] >> degree);
            let mut k = 1;
            while k < degree {
                if coefficients >> (degree - 1 - k) & 1 == 1 {
                    v[i] ^= v[i - k];
                }
                k += 1;
            }
        }
        i += 1;
    }
    v
}

/// A dimension of Sobol' by its direction numbers, as a 32-bit fraction.
#[inline]
fn sobol(directions: &[u32; 32], mut index: u32) -> u32 {
    let mut value = 0;
    let mut bit = 0;
    while index != 0 {
        if index & 1 == 1 {
            value ^= directions[bit];
        }
        index >>= 1;
        bit += 1;
    }
    value
}

/// Owen scrambling of a binary fraction (most significant bit first): each bit is flipped or not by a hash of the bits
/// before it. Applied to an index it permutes aligned blocks. Constants of Burley 2020.
#[inline]
fn owen_scramble(fraction: u32, seed: u32) -> u32 {
    let mut reversed = fraction.reverse_bits();
    reversed = reversed.wrapping_add(seed);
    reversed ^= reversed.wrapping_mul(0x6c50_b47c);
    reversed ^= reversed.wrapping_mul(0xb82f_1e52);
    reversed ^= reversed.wrapping_mul(0xc7af_e638);
    reversed ^= reversed.wrapping_mul(0x8d22_f6e6);
    reversed.reverse_bits()
}

/// A direction about +Z with density cosθ/π, by the concentric map of the disk (Malley's method;
/// Shirley & Chiu 1997).
///
/// One point in 2²⁴ is rounded to the border of the square: there its direction would lie in the surface, from which
/// nothing comes, and count for those beside it.
#[inline]
pub fn cosine_hemisphere(point: Vec2) -> Vec3 {
    let disk = concentric_disk(point);
    Vec3::new(disk.x, disk.y, (1.0 - disk.length_squared()).max(f32::EPSILON).sqrt())
}

/// Shirley & Chiu's map of the unit square to the unit disk, area-preserving.
#[inline]
pub fn concentric_disk(point: Vec2) -> Vec2 {
    let offset = point * 2.0 - 1.0;
    if offset == Vec2::ZERO {
        return Vec2::ZERO;
    }
    let (radius, angle) = if offset.x.abs() > offset.y.abs() {
        (offset.x, (PI / 4.0) * (offset.y / offset.x))
    } else {
        (offset.y, (PI / 2.0) - (PI / 4.0) * (offset.x / offset.y))
    };
    let (sin, cos) = libm::sincosf(angle);
    Vec2::new(radius * cos, radius * sin)
}

/// The point that [`cosine_hemisphere`] maps to a unit direction above the plane.
pub fn hemisphere_point(direction: Vec3) -> Vec2 {
    let radius = direction.truncate().length();
    let (x, y) = (direction.x, direction.y);
    // Of its four triangles, the one that the disk's sector comes from.
    let offset = if x.abs() > y.abs() {
        let along = radius.copysign(x);
        Vec2::new(along, along * libm::atanf(y / x) * (4.0 / PI))
    } else if radius > 0.0 {
        let along = radius.copysign(y);
        Vec2::new(along * libm::atanf(x / y) * (4.0 / PI), along)
    } else {
        Vec2::ZERO
    };
    (offset + 1.0) * 0.5
}

/// A uniform direction on the unit sphere.
#[inline]
pub fn uniform_sphere(point: Vec2) -> Vec3 {
    let z = 1.0 - 2.0 * point.x;
    let radius = (1.0 - z * z).max(0.0).sqrt();
    let (sin, cos) = libm::sincosf(2.0 * PI * point.y);
    Vec3::new(radius * cos, radius * sin, z)
}

/// Two unit vectors that complete `normal` to a right-handed frame (Duff et al. 2017), and turn little where it turns little.
///
/// They jump where the sign changes: not at z = 0 as in the paper, but at a slant that no wall has, since gathers compare
/// directions from point to point and a wall's normal has z = ±0 as rounding wants.
#[inline]
pub fn frame(normal: Vec3) -> (Vec3, Vec3) {
    let sign = if normal.z > -0.6 { 1.0 } else { -1.0 };
    let a = -1.0 / (sign + normal.z);
    let b = normal.x * normal.y * a;
    (
        Vec3::new(1.0 + sign * normal.x * normal.x * a, sign * b, -sign * normal.x),
        Vec3::new(b, sign + normal.y * normal.y * a, -normal.y),
    )
}

/// Barycentric weights (u, v) of a uniform point in a triangle, continuous in `point`
/// (Heitz 2019, "A low-distortion map between triangle and square").
#[inline]
pub fn triangle_point(point: Vec2) -> (f32, f32) {
    let (x, y) = (point.x, point.y);
    if y > x {
        let x = x * 0.5;
        (x, y - x)
    } else {
        let y = y * 0.5;
        (x - y, y)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hemisphere_points_are_found_again() {
        let key = Key::new(3, Purpose::Hemisphere, 0);
        for index in 0..1000 {
            let point = key.point2(index);
            let found = hemisphere_point(cosine_hemisphere(point));
            // Rounding of the angle, by a radius of 1 at most.
            assert!(found.distance(point) < 1e-6, "{point} {found}");
        }
        assert_eq!(hemisphere_point(Vec3::Z), Vec2::splat(0.5));
    }

    /// Every elementary interval of a (0,2)-sequence in base 2 holds exactly one of 2^m consecutive points.
    #[test]
    fn each_elementary_interval_holds_exactly_one_point() {
        for entity in 0..20 {
            let key = Key::new(7, Purpose::Test, entity);
            for m in [4_u32, 6, 8] {
                let points: Vec<Vec2> = (0..1 << m).map(|i| key.point2(i)).collect();
                for a in 0..=m {
                    let (nx, ny) = (1 << a, 1 << (m - a));
                    let mut counts = vec![0; 1 << m];
                    for p in &points {
                        let (ix, iy) = ((p.x * nx as f32) as usize, (p.y * ny as f32) as usize);
                        counts[iy * nx + ix] += 1;
                    }
                    assert!(counts.iter().all(|&c| c == 1), "entity {entity}, m {m}, split {a}");
                }
            }
        }
    }

    /// Each of the four dimensions alone is a (0,1)-sequence: one of 2^m consecutive points in each of 2^m intervals.
    #[test]
    fn each_dimension_of_four_is_stratified() {
        for entity in 0..20 {
            let key = Key::new(3, Purpose::Test, entity);
            let points: Vec<[f32; 4]> = (0..256).map(|i| key.point4(i)).collect();
            for d in 0..4 {
                let mut seen = [false; 256];
                for p in &points {
                    seen[(p[d] * 256.0) as usize] = true;
                }
                assert!(seen.iter().all(|s| *s), "entity {entity}, dimension {d}");
            }
        }
    }

    #[test]
    fn the_closed_form_of_sobol_s_second_dimension_is_its_recurrence() {
        for index in (0..4096).chain([u32::MAX, 0x8000_0000, 0x1234_5678]) {
            let (mut value, mut direction) = (0_u32, 1_u32 << 31);
            for bit in 0..32 {
                if index >> bit & 1 == 1 {
                    value ^= direction;
                }
                direction ^= direction >> 1;
            }
            assert_eq!(sobol1(index), value, "{index}");
        }
    }

    /// Points of 24 bits lie on the border, too.
    #[test]
    fn no_direction_lies_in_the_surface() {
        let edge = [0.0, f32::EPSILON, 0.25, 0.737_149_7, 1.0 - f32::EPSILON];
        for (x, y) in edge.into_iter().flat_map(|x| edge.map(|y| (x, y))) {
            let direction = cosine_hemisphere(Vec2::new(x, y));
            assert!(direction.z > 0.0, "{x} {y}: {direction}");
            assert!((direction.length() - 1.0).abs() < 1e-6, "{x} {y}: {direction}");
        }
    }

    /// The mean of cosθ over a cosine-distributed hemisphere is 2/3; the tolerance is far above the
    /// N^(−3/2) error of 4096 scrambled points (≈ 4e-6) and far below any wrong density (≥ 0.05).
    #[test]
    fn malley_directions_have_the_cosine_density() {
        let key = Key::new(1, Purpose::Test, 0);
        let n = 4096;
        let mean: f32 = (0..n).map(|i| cosine_hemisphere(key.point2(i)).z).sum::<f32>() / n as f32;
        assert!((mean - 2.0 / 3.0).abs() < 1e-3, "{mean}");
    }

    #[test]
    fn frames_of_one_wall_are_one() {
        for wall in [Vec3::X, Vec3::Y, Vec3::NEG_X, Vec3::NEG_Y, Vec3::new(0.6, -0.8, 0.0)] {
            let [front, back] = [1e-7, -1e-7].map(|z| frame(wall + Vec3::Z * z));
            assert!((front.0 - back.0).length() + (front.1 - back.1).length() < 1e-6, "{wall}");
        }
    }

    #[test]
    fn frames_are_orthonormal_and_right_handed() {
        let key = Key::new(1, Purpose::Test, 1);
        for i in 0..1000 {
            let n = uniform_sphere(key.point2(i));
            let (t, b) = frame(n);
            assert!(t.dot(b).abs() < 1e-5 && t.dot(n).abs() < 1e-5 && (t.cross(b) - n).length() < 1e-5);
        }
    }
}
