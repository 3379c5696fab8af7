//! Morton order (Morton1966 in docs/references.md): places that are near in it are near in space.

use glam::Vec3;

use catoptric_trace::Tracer;
use catoptric_trace::extent::Bounds;

/// Place on the curve through the box of a scene, which is cut into 1024³ cells; what is outlying is moved into the outermost.
pub(crate) fn on_curve(tracer: &Tracer, place: Vec3) -> u32 {
    let Bounds { center, diagonal } = tracer.extent().inner;
    let diagonal = diagonal as f32;
    let low = center.as_vec3() - Vec3::splat(0.5 * diagonal);
    let scale = 1023.0 / diagonal.max(f32::MIN_POSITIVE);
    let [x, y, z] = ((place - low) * scale).to_array().map(|v| to_every_third(v.clamp(0.0, 1023.0) as u32));
    x << 2 | y << 1 | z
}

/// Ten bits, each where every third is.
fn to_every_third(v: u32) -> u32 {
    let v = (v | v << 16) & 0x0300_00ff;
    let v = (v | v << 8) & 0x0300_f00f;
    let v = (v | v << 4) & 0x030c_30c3;
    (v | v << 2) & 0x0924_9249
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bits_are_spread() {
        for v in 0..1024_u32 {
            let spread = to_every_third(v);
            let back: u32 = (0..10).map(|bit| (spread >> (3 * bit) & 1) << bit).sum();
            assert_eq!((back, spread & !0x0924_9249), (v, 0));
        }
    }
}
