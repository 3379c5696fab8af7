//! The report: one HTML file that needs nothing else, with the data of both images inside.
//!
//! The page (`page.html`, `style.css`, `app.js`) is constant; this module fills in the tables and the data. Pixels travel
//! as base64 of little-endian floats, of halves for images above `FLOAT_PIXELS`; error maps as bytes. Images above
//! `PIXELS` are averaged down by a whole factor for display, and the page says so; the numbers are of the full images.

mod base64;
mod index;

use std::fmt::Write;

use half::f16;
use serde_json::json;

pub use index::{Entry, EntryState, index_page};

use crate::colour::MAGMA;
use crate::limits::Check;
use crate::metric::{Reading, Sense};
use crate::pair::Rgb;
use crate::pictures::{histogram, worst_places};
use crate::planes::Planes;
use crate::{Comparison, LayerComparison, Pair};

/// Pixels of a layer that are shown.
const PIXELS: usize = 4 << 20;
/// Pixels of a layer that travel as floats.
const FLOAT_PIXELS: usize = 1 << 18;
/// Layers whose pixels are in the page; of others it has the numbers.
const LAYERS: usize = 12;

const PAGE: &str = include_str!("page.html");
const STYLE: &str = include_str!("style.css");
const APP: &str = include_str!("app.js");

/// What the page says above the pictures.
pub struct Heading<'a> {
    /// Name of the test image.
    pub test: &'a str,
    /// Name of the reference.
    pub reference: &'a str,
    /// The checks; empty if nothing was limited.
    pub checks: &'a [Check],
    /// Further sentences: layers that were not compared.
    pub notes: &'a [String],
}

/// The page for a comparison.
pub fn html(comparison: &Comparison, heading: &Heading<'_>) -> String {
    let within = heading.checks.iter().all(|check| check.holds);
    let layers: Vec<serde_json::Value> = comparison.layers.iter().take(LAYERS).map(layer_data).collect();
    let data = json!({ "magma": MAGMA, "layers": layers });
    let title = format!("{} against {}", heading.test, heading.reference);
    // Script text ends at "</": the only place where JSON and HTML disagree.
    let data = data.to_string().replace("</", "<\\/");
    fill(
        PAGE,
        &[
            ("TITLE", &escape(&title)),
            ("STYLE", STYLE),
            ("TEST", &escape(heading.test)),
            ("REFERENCE", &escape(heading.reference)),
            ("VERDICT", if within { "within limits" } else { "outside limits" }),
            ("VERDICT_CLASS", if within { "good" } else { "bad" }),
            ("NOTES", &notes(comparison, heading)),
            ("CHECKS", &checks_table(heading.checks)),
            ("TABLES", &comparison.layers.iter().map(layer_section).collect::<String>()),
            ("APP", APP),
            ("DATA", &data),
        ],
    )
}

/// Replaces `{{NAME}}` by its value; values are not searched again.
fn fill(template: &str, values: &[(&str, &str)]) -> String {
    let mut out = String::new();
    let mut rest = template;
    while let Some((before, after)) = rest.split_once("{{") {
        out.push_str(before);
        let (name, after) = after.split_once("}}").unwrap_or((after, ""));
        out.push_str(values.iter().find(|(key, _)| *key == name).map_or("", |(_, value)| value));
        rest = after;
    }
    out + rest
}

fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// A number with four significant digits.
fn number(value: f64) -> String {
    match value {
        v if v.is_infinite() => "∞".to_owned(),
        v if v != 0.0 && (v.abs() < 1e-3 || v.abs() >= 1e5) => format!("{v:.3e}"),
        v if v.fract() == 0.0 => format!("{v}"),
        v => format!("{v:.*}", (3 - v.abs().log10().floor() as i32).clamp(0, 6) as usize),
    }
}

fn notes(comparison: &Comparison, heading: &Heading<'_>) -> String {
    let mut out = String::new();
    for note in heading.notes {
        let _ = write!(out, "<p class=\"note\">{}</p>", escape(note));
    }
    for layer in &comparison.layers {
        if let Some(noise) = &layer.noise {
            let verdict = if noise.explained { "is explained by" } else { "is more than" };
            let _ = write!(
                out,
                "<p class=\"note\">The difference of the {} <strong>{verdict} the reference's own noise</strong>: {} pixels beyond {} \
                 standard errors (largest {} at {}, {}), χ²/n = {} where 1 is expected (p = {}).</p>",
                escape(layer.title()),
                noise.excess_pixels,
                number(noise.bound),
                number(noise.worst_z),
                noise.worst_pixel[0],
                noise.worst_pixel[1],
                number(noise.chi2_per_degree),
                number(noise.probability),
            );
        }
    }
    if comparison.layers.len() > LAYERS {
        let _ = write!(
            out,
            "<p class=\"note\">Pixels of the first {LAYERS} layers are in this page; of the others the numbers.</p>"
        );
    }
    out
}

fn checks_table(checks: &[Check]) -> String {
    let mut rows = String::new();
    for check in checks {
        let layer = if check.layer.is_empty() { "beauty" } else { &check.layer };
        let (class, word) = if check.holds { ("good", "holds") } else { ("bad", "broken") };
        let _ = write!(
            rows,
            "<tr class=\"{class}\"><th scope=\"row\">{}</th><td>{}</td><td class=\"number\">{}</td><td class=\"number\">{}</td><td>{word}</td></tr>",
            escape(&check.metric),
            escape(layer),
            number(check.value),
            escape(&check.limit),
        );
    }
    format!(
        "<table><caption>Limits</caption><thead><tr><th scope=\"col\">metric</th><th scope=\"col\">layer</th><th scope=\"col\" class=\"number\">value</th>\
         <th scope=\"col\" class=\"number\">limit</th><th scope=\"col\">verdict</th></tr></thead><tbody>{rows}</tbody></table>"
    )
}

fn layer_section(layer: &LayerComparison) -> String {
    let rows: String = layer.readings.iter().map(reading_row).collect();
    format!(
        "<section class=\"numbers\"><table><caption>Metrics: {}</caption><thead><tr><th scope=\"col\">metric</th>\
         <th scope=\"col\" class=\"number\">value</th><th scope=\"col\" class=\"number\">equal is</th><th scope=\"col\">pixel</th></tr></thead><tbody>{rows}</tbody></table>{}</section>",
        escape(layer.title()),
        histogram_figure(&layer.pair),
    )
}

fn reading_row(reading: &Reading) -> String {
    let perfect = match reading.sense {
        Sense::LowerIsBetter => "0",
        Sense::NearOne => "1",
        Sense::HigherIsBetter if reading.name == "SSIM" => "1",
        Sense::HigherIsBetter => "∞",
        Sense::Information => "",
    };
    let at = reading.at.map_or(String::new(), |[x, y]| {
        format!("<button type=\"button\" class=\"place\" data-x=\"{x}\" data-y=\"{y}\">{x}, {y}</button>")
    });
    format!(
        "<tr><th scope=\"row\">{}</th><td class=\"number\">{}</td><td class=\"number\">{perfect}</td><td>{at}</td></tr>",
        escape(&reading.name),
        number(reading.value)
    )
}

fn histogram_figure(pair: &Pair) -> String {
    let bins = histogram(pair);
    let most = bins.iter().map(|(_, n)| *n).max().unwrap_or(1).max(1);
    let mut bars = String::new();
    for (i, &(from, n)) in bins.iter().enumerate() {
        let height = 100.0 * n as f64 / most as f64;
        let _ = write!(
            bars,
            "<rect x=\"{}\" y=\"{:.1}\" width=\"18\" height=\"{height:.1}\"><title>relative error from {}: {n} pixels</title></rect>",
            i * 20 + 1,
            100.0 - height,
            number(from)
        );
    }
    let mut labels = String::new();
    for (i, text) in [(1, "1e-4"), (4, "1e-3"), (7, "1e-2"), (10, "0.1"), (13, "1"), (16, "10")] {
        let _ = write!(labels, "<text x=\"{}\" y=\"116\">{text}</text>", i * 20);
    }
    format!(
        "<figure><svg viewBox=\"0 0 342 122\" role=\"img\" aria-label=\"Histogram of the relative error, logarithmic\">{bars}\
         <line x1=\"0\" y1=\"100\" x2=\"342\" y2=\"100\"/>{labels}</svg><figcaption>Pixels by relative error of luminance</figcaption></figure>"
    )
}

/// The pixels and maps of a layer.
fn layer_data(layer: &LayerComparison) -> serde_json::Value {
    let pair = &layer.pair;
    let factor = (1..).find(|f| (pair.width / f) * (pair.height / f) <= PIXELS).unwrap_or(1);
    let (width, height) = ((pair.width / factor).max(1), (pair.height / factor).max(1));
    let small = Shrink { pair, factor, width, height };
    let floats = width * height <= FLOAT_PIXELS;
    let pixels = |planes: &Planes| {
        let values = small.rgb(planes);
        let bytes: Vec<u8> = if floats {
            values.as_flattened().iter().flat_map(|v| v.to_le_bytes()).collect()
        } else {
            values
                .as_flattened()
                .iter()
                .flat_map(|v| f16::from_f32(v.clamp(-65504.0, 65504.0)).to_le_bytes())
                .collect()
        };
        base64::encode(&bytes)
    };
    let byte = |v: f32| (v * 255.0).round().clamp(0.0, 255.0) as u8;
    let flip: Vec<u8> = small.map(pair.flip_map()).into_iter().map(byte).collect();
    let signed: Vec<u8> = small.map(&pair.signed_map()).into_iter().map(|v| byte(0.5 + 0.5 * v)).collect();
    let exposure = pair.display_exposure();
    json!({
        "name": layer.title(),
        "width": width,
        "height": height,
        "factor": factor,
        "floats": floats,
        "exposure": exposure,
        "mean_luminance": pair.mean_luminance(),
        "test": pixels(&pair.test),
        "reference": pixels(&pair.reference),
        "flip": base64::encode(&flip),
        "signed": base64::encode(&signed),
        "places": worst_places(pair, 6),
    })
}

/// Averages squares of pixels.
struct Shrink<'a> {
    pair: &'a Pair,
    factor: usize,
    width: usize,
    height: usize,
}

impl Shrink<'_> {
    fn rgb(&self, planes: &Planes) -> Vec<Rgb> {
        self.each(|i| planes.at(i))
    }

    fn map(&self, map: &[f32]) -> Vec<f32> {
        self.each(|i| [map[i]]).into_iter().map(|[v]| v).collect()
    }

    fn each<const K: usize>(&self, value: impl Fn(usize) -> [f32; K]) -> Vec<[f32; K]> {
        let f = self.factor;
        (0..self.width * self.height)
            .map(|i| {
                let mut sum = [0.0; K];
                for p in 0..f * f {
                    let (x, y) = ((i % self.width) * f + p % f, (i / self.width) * f + p / f);
                    let v = value(y.min(self.pair.height - 1) * self.pair.width + x.min(self.pair.width - 1));
                    for k in 0..K {
                        sum[k] += v[k];
                    }
                }
                sum.map(|s| s / (f * f) as f32)
            })
            .collect()
    }
}
