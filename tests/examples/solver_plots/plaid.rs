//! The hemicube's plaid: its error at the points of a floor under a square lamp, with the cells turned alike or by chance.

use std::f64::consts::PI;
use std::fmt::Write;

use catoptric_light::contour::{Polygon, irradiance};
use catoptric_radiosity::method::hemicube::Raster;
use catoptric_trace::sequence::{Key, Purpose};
use glam::DVec3;

/// Cells along an edge of the top.
pub(crate) const RESOLUTION: u32 = 32;
/// Points along an edge of the floor, 4 m long; the lamp is 1 m² in a height of 1 m.
const POINTS: u32 = 72;
const EXTENT: f64 = 4.0;
/// Colours of −12 % to 12 %, in steps of 3 %.
const COLOURS: [&str; 9] =
    ["#053061", "#2166ac", "#67a9cf", "#d1e5f0", "#ffffff", "#fddbc7", "#ef8a62", "#b2182b", "#67001f"];
const STEP: f64 = 0.03;
const SIZE: u32 = 4;
const GAP: u32 = 20;

/// Both pictures, and the root mean square of each.
pub(crate) fn svg() -> (String, [f64; 2]) {
    let raster = Raster::new(RESOLUTION);
    let edge = POINTS * SIZE;
    let mut text = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {} {}\" font-family=\"sans-serif\" font-size=\"11\">\n\
         <rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n",
        2 * edge + 3 * GAP,
        edge + 3 * GAP
    );
    let mut deviations = [0.0; 2];
    for (panel, name) in ["all hemicubes turned alike", "each turned by chance"].into_iter().enumerate() {
        let left = GAP + panel as u32 * (edge + GAP);
        let mut paths = vec![String::new(); COLOURS.len()];
        for index in 0..POINTS * POINTS {
            let at = |k: u32| ((f64::from(k) + 0.5) / f64::from(POINTS) - 0.5) * EXTENT;
            let (column, row) = (index % POINTS, index / POINTS);
            let chance = Key::new(0, Purpose::Hemisphere, u64::from(index)).uniform(0);
            let turn = if panel == 0 { 0.0 } else { f64::from(chance) * 0.5 * PI };
            let error = error(&raster, DVec3::new(at(column), at(row), 0.0), turn);
            deviations[panel] += error * error / f64::from(POINTS * POINTS);
            let level = (error / STEP).round().clamp(-4.0, 4.0) as i32 + 4;
            let (x, y) = (left + column * SIZE, GAP + row * SIZE);
            if level != 4 {
                let _ = write!(paths[level as usize], "M{x} {y}h{SIZE}v{SIZE}h-{SIZE}z");
            }
        }
        for (path, colour) in paths.iter().zip(COLOURS).filter(|p| !p.0.is_empty()) {
            let _ = writeln!(text, "<path d=\"{path}\" fill=\"{colour}\" shape-rendering=\"crispEdges\"/>");
        }
        deviations[panel] = deviations[panel].sqrt();
        let _ = writeln!(
            text,
            "<rect x=\"{left}\" y=\"{GAP}\" width=\"{edge}\" height=\"{edge}\" fill=\"none\" stroke=\"#888\"/>\
             <text x=\"{left}\" y=\"14\">{name}: {:.1} % root mean square</text>",
            100.0 * deviations[panel]
        );
    }
    for (level, colour) in COLOURS.iter().enumerate() {
        let x = GAP + level as u32 * 60;
        let percent = (level as f64 - 4.0) * 100.0 * STEP;
        let _ = writeln!(
            text,
            "<rect x=\"{x}\" y=\"{0}\" width=\"14\" height=\"14\" fill=\"{colour}\" stroke=\"#888\"/>\
             <text x=\"{1}\" y=\"{2}\">{percent:+.0} %</text>",
            edge + GAP + 14,
            x + 18,
            edge + GAP + 25
        );
    }
    text.push_str("</svg>\n");
    (text, deviations)
}

/// Relative error of the form factor from a point of the floor, looking up, to the lamp.
fn error(raster: &Raster, point: DVec3, turn: f64) -> f64 {
    let n = RESOLUTION as usize;
    let (sin, cos) = libm::sincos(turn);
    let meets = |x: f64, y: f64, z: f64| {
        let hit = point + DVec3::new(x * cos - y * sin, x * sin + y * cos, z) / z;
        hit.x.abs() <= 0.5 && hit.y.abs() <= 0.5
    };
    let at = |k: usize| (2.0 * k as f64 + 1.0) / n as f64;
    let mut sum = 0.0;
    for cell in 0..n * n {
        if meets(at(cell % n) - 1.0, at(cell / n) - 1.0, 1.0) {
            sum += raster.delta(0, cell);
        }
    }
    for cell in 0..n * n / 2 {
        let (side, up) = (at(cell % n) - 1.0, at(cell / n));
        for (face, (x, y)) in [(1.0, side), (-side, 1.0), (-1.0, -side), (side, -1.0)].into_iter().enumerate()
        {
            if meets(x, y, up) {
                sum += raster.delta(face + 1, cell);
            }
        }
    }
    let corner = |x: f64, y: f64| DVec3::new(0.5 * x, 0.5 * y, 1.0);
    let lamp = Polygon::new(&[corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)]);
    sum * PI / irradiance(point, DVec3::Z, &lamp) - 1.0
}
