//! Curves on logarithmic axes, as SVG.

use std::fmt::Write;

/// Points that belong together.
pub(crate) struct Curve {
    pub(crate) name: String,
    pub(crate) points: Vec<(f64, f64)>,
}

impl Curve {
    pub(crate) fn new(name: &str) -> Self {
        Self { name: name.to_owned(), points: Vec::new() }
    }
}

/// One diagram.
pub(crate) struct Panel {
    pub(crate) x: &'static str,
    pub(crate) y: &'static str,
    pub(crate) curves: Vec<Curve>,
    /// Single points with a name.
    pub(crate) points: Vec<(String, (f64, f64))>,
}

impl Panel {
    pub(crate) fn new(x: &'static str, y: &'static str) -> Self {
        Self { x, y, curves: Vec::new(), points: Vec::new() }
    }
}

const COLOURS: [&str; 6] = ["#1f4e9c", "#c0392b", "#2e8b57", "#8e44ad", "#d68910", "#34495e"];
const WIDTH: f64 = 330.0;
const HEIGHT: f64 = 290.0;
const LEFT: f64 = 62.0;
const BOTTOM: f64 = 46.0;
const LEGEND: f64 = 18.0;

/// Panels beside each other, with one legend below.
pub(crate) fn svg(panels: &[Panel]) -> String {
    let names: Vec<&str> = panels[0].curves.iter().map(|c| c.name.as_str()).collect();
    let per_line = if panels.len() > 1 { 6 } else { 2 };
    let lines = names.len().div_ceil(per_line);
    let width = panels.len() as f64 * WIDTH + 14.0;
    let height = HEIGHT + lines as f64 * LEGEND + 8.0;
    let mut text = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" font-family=\"sans-serif\" \
         font-size=\"11\">\n<rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n"
    );
    for (index, panel) in panels.iter().enumerate() {
        draw(&mut text, panel, index as f64 * WIDTH);
    }
    for (index, name) in names.iter().enumerate() {
        let x = LEFT + (index % per_line) as f64 * 150.0;
        let y = HEIGHT + (index / per_line) as f64 * LEGEND + 6.0;
        let _ = writeln!(
            text,
            "<path d=\"M{x} {y} h22\" stroke=\"{}\" stroke-width=\"2\"/><text x=\"{}\" y=\"{}\">{name}</text>",
            COLOURS[index % COLOURS.len()],
            x + 27.0,
            y + 4.0
        );
    }
    text.push_str("</svg>\n");
    text
}

/// Powers of ten around values.
fn decades(values: impl Iterator<Item = f64> + Clone) -> (i32, i32) {
    let logs = values.filter(|v| *v > 0.0).map(f64::log10);
    let low = logs.clone().fold(f64::INFINITY, f64::min).floor();
    let high = logs.fold(f64::NEG_INFINITY, f64::max).ceil();
    (low as i32, (high as i32).max(low as i32 + 1))
}

fn draw(text: &mut String, panel: &Panel, left: f64) {
    let all = || panel.curves.iter().flat_map(|c| c.points.iter()).chain(panel.points.iter().map(|p| &p.1));
    let (x_low, x_high) = decades(all().map(|p| p.0));
    let (y_low, y_high) = decades(all().map(|p| p.1));
    let (right, top, bottom) = (left + WIDTH - 8.0, 10.0, HEIGHT - BOTTOM);
    let start = left + LEFT;
    let x = |v: f64| start + (v.log10() - f64::from(x_low)) / f64::from(x_high - x_low) * (right - start);
    let y = |v: f64| bottom - (v.log10() - f64::from(y_low)) / f64::from(y_high - y_low) * (bottom - top);
    for power in x_low..=x_high {
        let at = x(10_f64.powi(power));
        let _ = writeln!(
            text,
            "<path d=\"M{at:.1} {top} V{bottom}\" stroke=\"#ddd\"/>\
             <text x=\"{at:.1}\" y=\"{}\" text-anchor=\"middle\">{}</text>",
            bottom + 15.0,
            power_of_ten(power)
        );
    }
    for power in y_low..=y_high {
        let at = y(10_f64.powi(power));
        let _ = writeln!(
            text,
            "<path d=\"M{start} {at:.1} H{right}\" stroke=\"#ddd\"/>\
             <text x=\"{}\" y=\"{:.1}\" text-anchor=\"end\">{}</text>",
            start - 5.0,
            at + 4.0,
            power_of_ten(power)
        );
    }
    let middle = 0.5 * (start + right);
    let _ = writeln!(
        text,
        "<text x=\"{middle}\" y=\"{}\" text-anchor=\"middle\">{}</text>",
        bottom + 34.0,
        panel.x
    );
    let (tx, ty) = (left + 14.0, 0.5 * (top + bottom));
    let _ = writeln!(
        text,
        "<text transform=\"translate({tx} {ty}) rotate(-90)\" text-anchor=\"middle\">{}</text>",
        panel.y
    );
    for (index, curve) in panel.curves.iter().enumerate() {
        let points: Vec<String> = curve
            .points
            .iter()
            .filter(|p| p.0 > 0.0 && p.1 > 0.0)
            .map(|p| format!("{:.1},{:.1}", x(p.0), y(p.1)))
            .collect();
        let colour = COLOURS[index % COLOURS.len()];
        let _ = writeln!(
            text,
            "<polyline points=\"{}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"1.7\"/>",
            points.join(" ")
        );
    }
    for (name, point) in &panel.points {
        let (px, py) = (x(point.0), y(point.1));
        let _ = writeln!(
            text,
            "<circle cx=\"{px:.1}\" cy=\"{py:.1}\" r=\"4\"/><text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{name}</text>",
            px - 7.0,
            py - 5.0
        );
    }
}

fn power_of_ten(power: i32) -> String {
    match power {
        0 => "1".to_owned(),
        1 => "10".to_owned(),
        2 => "100".to_owned(),
        _ => format!("10<tspan dy=\"-4\" font-size=\"8\">{}</tspan>", power.to_string().replace('-', "−")),
    }
}
