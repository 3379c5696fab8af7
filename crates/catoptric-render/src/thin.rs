//! Pixels that a lamp thinner than a pixel may cross, straight or over planar mirrors: their centres may all miss it, and nothing else
//! would call for more samples.

use glam::{DVec2, DVec3, Vec3};

use catoptric_light::emitter::Cell;
use catoptric_light::{Lights, contour};
use catoptric_scene::Camera;
use catoptric_scene::quantity::LUMINANCE;

/// Width in pixels from which on the centre of some pixel sees a lamp: a square of that width holds an upright one of a pixel.
const WIDE: f64 = std::f64::consts::SQRT_2;
/// Lamps times mirror chains that are looked at: a few milliseconds.
const MOST_LOOKS: usize = 1 << 16;
/// Share of the pixels that thin lamps may ask for: in a cloud of sparks, the brightest.
const MOST_PIXELS: f64 = 0.05;

/// Marks the pixels that thin lamps may cross, of those that `unlit` holds for: by index, those of the brightest lamps first.
pub(crate) fn thin_lamps(
    lights: &Lights,
    camera: &Camera,
    (width, height): (usize, usize),
    unlit: impl Fn(usize) -> bool,
) -> Vec<usize> {
    let emitters = lights.emitters();
    let mut cells: Vec<&Cell> = emitters.cells().iter().collect();
    let power = |cell: &Cell| f64::from(cell.radiance.dot(LUMINANCE)) * cell.area;
    cells.sort_by(|a, b| power(b).total_cmp(&power(a)));
    cells.truncate(MOST_LOOKS);
    let eye = camera.world_from_camera.translation.as_dvec3();
    let ahead = camera.world_from_camera.transform_vector3(Vec3::NEG_Z).as_dvec3();
    let camera_from_world = camera.world_from_camera.inverse();
    let near = f64::from(camera.near).max(NEAREST);
    let most = (MOST_PIXELS * (width * height) as f64) as usize;

    let chains = lights.chains();
    let views = (MOST_LOOKS / cells.len().max(1)).max(1) - 1;
    let chains_and_none = std::iter::once(None).chain(chains.chains().iter().take(views).map(Some));
    let (mut marked, mut is_marked) = (Vec::new(), vec![false; width * height]);
    let (mut targets, mut spare) = (Vec::new(), Vec::new());
    for chain in chains_and_none {
        let image = chain.map(|chain| chains.unfold(chain, eye, ahead, ahead));
        let Some(eye) = image.map_or(Some(eye), |image| image.map(|image| image.position)) else { continue };
        for cell in &cells {
            let polygon = cell.polygon();
            let is_turned_away = polygon.corners().iter().all(|&c| cell.normal.dot(eye - c) <= 0.0);
            if camera.is_perspective() && is_turned_away {
                continue;
            }
            let mut corners: Vec<DVec3> = polygon
                .corners()
                .iter()
                .map(|&corner| {
                    let seen = chain.map_or(corner.as_vec3(), |chain| {
                        chains.targets(chain, corner, &mut targets);
                        targets[0]
                    });
                    camera_from_world.transform_point3(seen).as_dvec3()
                })
                .collect();
            contour::cut(&mut corners, DVec3::NEG_Z, near, &mut spare);
            let at = |c: &DVec3| camera.pixel_of(c.as_vec3(), width, height).as_dvec2();
            let outline: Vec<DVec2> = corners.iter().map(at).collect();
            if outline.len() < 3 || least_width(&outline) > WIDE {
                continue;
            }
            touched(&outline, (width, height), |index| {
                if !is_marked[index] && unlit(index) {
                    is_marked[index] = true;
                    marked.push(index);
                }
            });
            if marked.len() > most {
                return marked;
            }
        }
    }
    marked
}

/// Nothing nearer to the eye than this is projected, metres.
const NEAREST: f64 = 1e-4;

/// Width of a convex outline where it is narrowest: the least, over its edges, of the greatest distance from an edge.
fn least_width(outline: &[DVec2]) -> f64 {
    let edges = outline.iter().zip(outline.iter().cycle().skip(1));
    let height = |(a, b): (&DVec2, &DVec2)| {
        let along = (*b - *a).normalize_or_zero();
        outline.iter().map(|c| along.perp_dot(*c - *a).abs()).fold(0.0, f64::max)
    };
    edges.filter(|(a, b)| a != b).map(height).fold(f64::INFINITY, f64::min)
}

/// Visits all pixels that a convex outline touches, column by column.
fn touched(outline: &[DVec2], (width, height): (usize, usize), mut visit: impl FnMut(usize)) {
    let least = outline.iter().fold(DVec2::INFINITY, |least, c| least.min(*c));
    let most = outline.iter().fold(DVec2::NEG_INFINITY, |most, c| most.max(*c));
    let inside = |value: f64, end: usize| value.clamp(0.0, end as f64) as usize;
    if most.x < 0.0 || most.y < 0.0 || least.x >= width as f64 || least.y >= height as f64 {
        return;
    }
    for x in inside(least.x, width)..inside(most.x.floor() + 1.0, width) {
        let (left, right) = (x as f64, x as f64 + 1.0);
        let (mut top, mut bottom) = (f64::INFINITY, f64::NEG_INFINITY);
        for (a, b) in outline.iter().zip(outline.iter().cycle().skip(1)) {
            let (a, b) = if a.x <= b.x { (a, b) } else { (b, a) };
            if b.x < left || a.x > right {
                continue;
            }
            let y_at = |x: f64| if b.x > a.x { a.y + (b.y - a.y) * (x - a.x) / (b.x - a.x) } else { a.y };
            for y in [y_at(left.max(a.x)), if b.x > a.x { y_at(right.min(b.x)) } else { b.y }] {
                (top, bottom) = (top.min(y), bottom.max(y));
            }
        }
        if bottom < 0.0 {
            continue;
        }
        for y in inside(top, height)..inside(bottom.floor() + 1.0, height) {
            visit(y * width + x);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pixels(outline: &[DVec2]) -> Vec<(usize, usize)> {
        let mut pixels = Vec::new();
        touched(outline, (8, 8), |index| pixels.push((index % 8, index / 8)));
        pixels
    }

    #[test]
    fn an_outline_touches_each_pixel_that_it_crosses() {
        let at = DVec2::new;
        // A strip between two rows of centres.
        let strip = [at(1.2, 2.6), at(4.5, 2.6), at(4.5, 2.9), at(1.2, 2.9)];
        assert_eq!(pixels(&strip), [(1, 2), (2, 2), (3, 2), (4, 2)]);
        assert!((least_width(&strip) - 0.3).abs() < 1e-12);
        // One that leans, partly outside.
        let leaning = [at(-2.0, -0.5), at(2.5, 1.75), at(2.5, 1.8)];
        assert_eq!(pixels(&leaning), [(0, 0), (0, 1), (1, 1), (2, 1)]);
        // Upright, a hair.
        let hair = [at(3.5, 1.5), at(3.5, 3.5), at(3.5, 3.0)];
        assert_eq!(pixels(&hair), [(3, 1), (3, 2), (3, 3)]);
        assert!(least_width(&hair) == 0.0);
        for outside in [at(9.0, 0.0), at(-9.0, 0.0), at(0.0, 9.0), at(0.0, -9.0)] {
            assert!(pixels(&strip.map(|c| c + outside)).is_empty());
        }
    }
}
