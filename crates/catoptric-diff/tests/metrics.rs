//! The battery of metrics: exact values, an independent implementation, and what must hold for every metric.

use std::path::Path;

use catoptric_diff::metric::Settings;
use catoptric_diff::{Metric, Pair, Params, Rgb, Sense, Space, StandardError, compare};
use catoptric_image::{Encoding, Image, ReadLimits};
use serde_json::Value;

fn stored(name: &str) -> Value {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name);
    serde_json::from_str(&std::fs::read_to_string(path).expect("in the repository")).expect("JSON")
}

fn grey(rows: &Value, scale: f32) -> (usize, usize, Vec<Rgb>) {
    let rows = rows.as_array().expect("rows");
    let pixels: Vec<Rgb> = rows
        .iter()
        .flat_map(|row| row.as_array().expect("a row"))
        .map(|v| [v.as_f64().expect("a code") as f32 / scale; 3])
        .collect();
    (pixels.len() / rows.len(), rows.len(), pixels)
}

fn measure_all(pair: &Pair) -> Vec<catoptric_diff::Reading> {
    Metric::ALL.iter().flat_map(|m| m.measure(pair, &Settings::default())).collect()
}

#[test]
fn integer_images_have_their_exact_metrics() {
    for case in stored("exact.json").as_array().expect("cases") {
        let scale = case["scale"].as_f64().expect("a scale") as f32;
        let (width, height, test) = grey(&case["test"], scale);
        let (_, _, reference) = grey(&case["reference"], scale);
        let pair = Pair::new(width, height, test, reference, [Encoding::Linear; 2], Space::Auto);
        let readings = measure_all(&pair);
        for (name, value) in case["values"].as_object().expect("values") {
            let found =
                readings.iter().find(|r| r.name == *name).unwrap_or_else(|| panic!("no {name}")).value;
            let expected = value.as_f64().expect("a number");
            // Codes over a scale are rounded to single precision, 6e-8 of them; differences of them to 1e-5.
            let tolerance = 2e-5 * expected.abs() + 1e-9;
            assert!(
                (found - expected).abs() <= tolerance,
                "{}: {name} {found} against {expected}",
                case["name"]
            );
        }
    }
}

#[test]
fn byte_images_have_their_exact_metrics_to_ten_digits() {
    let case = &stored("exact.json")[0];
    let (width, height, test) = grey(&case["test"], 255.0);
    let (_, _, reference) = grey(&case["reference"], 255.0);
    // As from PNG files: decoded to linear light, compared as codes.
    let linear = |plane: Vec<Rgb>| -> Vec<Rgb> {
        plane.into_iter().map(|p| p.map(catoptric_image::srgb::decode)).collect()
    };
    let pair = Pair::new(width, height, linear(test), linear(reference), [Encoding::Srgb; 2], Space::Auto);
    let readings = measure_all(&pair);
    for name in ["MSE", "MAE", "PSNR", "SSIM", "relMSE", "MRSE"] {
        let found = readings.iter().find(|r| r.name == name).expect(name).value;
        let expected = case["values"][name].as_f64().expect("a number");
        assert!((found / expected - 1.0).abs() < 1e-10, "{name} {found} against {expected}");
    }
}

#[test]
fn an_independent_implementation_agrees() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/pairs");
    for (pair, values) in stored("project_values.json").as_object().expect("pairs") {
        let read = |which: &str| {
            Image::read(&folder.join(format!("{pair}_{which}.exr")), &ReadLimits::default())
                .unwrap_or_else(|e| panic!("{e}"))
        };
        let comparison = compare(read("test"), read("ref"), &Params::default()).expect("comparable");
        let beauty = &comparison.layers[0];
        assert_eq!(comparison.layers.len(), 1, "the standard error is not a layer to compare");
        for (name, value) in values.as_object().expect("values") {
            let own = if name == "PSNR" { "PSNR_srgb" } else { name };
            let found = beauty.reading(own).unwrap_or_else(|| panic!("no {own}")).value;
            let expected = value.as_f64().expect("a number");
            let tolerance = if name.starts_with("FLIP") { 1e-4 } else { 1e-5 * expected.abs() };
            assert!((found - expected).abs() <= tolerance, "{pair}: {name} {found} against {expected}");
        }
    }
}

fn textured(seed: u32) -> Vec<Rgb> {
    (0..48 * 40u32)
        .map(|i| {
            [0, 1, 2].map(|k| {
                0.05 + (i
                    .wrapping_mul(2_654_435_761)
                    .wrapping_add(seed * 40_503)
                    .wrapping_add(k * 977_000_777)
                    >> 24) as f32
                    / 256.0
            })
        })
        .collect()
}

fn pair_of(test: Vec<Rgb>, reference: Vec<Rgb>) -> Pair {
    let mut pair = Pair::new(48, 40, test, reference, [Encoding::Linear; 2], Space::Auto);
    pair.noise = Some(StandardError::Planes(vec![[0.01; 3]; 48 * 40].into()));
    pair
}

#[test]
fn equal_images_are_perfect_by_every_metric() {
    for reading in measure_all(&pair_of(textured(1), textured(1))) {
        match reading.sense {
            Sense::NearOne => assert_eq!(reading.value, 1.0, "{}", reading.name),
            Sense::HigherIsBetter if reading.name == "SSIM" => {
                assert!((reading.value - 1.0).abs() < 1e-12);
            }
            Sense::HigherIsBetter => assert!(reading.value.is_infinite(), "{}", reading.name),
            // Noise-corrected errors of an exact image are minus their floor.
            Sense::LowerIsBetter => assert!(reading.value <= 0.0, "{} is {}", reading.name, reading.value),
            Sense::Information => {}
        }
    }
}

#[test]
fn a_larger_error_is_worse_by_every_metric() {
    let damaged = |by: f32| {
        let pixels = textured(1)
            .into_iter()
            .enumerate()
            .map(|(i, p)| p.map(|v| v * if i % 3 == 0 { 1.0 + by } else { 1.0 + 0.5 * by }));
        pair_of(pixels.collect(), textured(1))
    };
    let (small, large) = (measure_all(&damaged(0.05)), measure_all(&damaged(0.2)));
    for (s, l) in small.iter().zip(&large) {
        assert_eq!(s.name, l.name);
        match s.sense {
            Sense::HigherIsBetter => assert!(l.value < s.value, "{}: {} then {}", s.name, s.value, l.value),
            Sense::NearOne => assert!(l.distance() > s.distance(), "{}", s.name),
            // Pixel counts may stay; errors grow.
            Sense::LowerIsBetter => assert!(l.value >= s.value, "{}: {} then {}", s.name, s.value, l.value),
            Sense::Information => {}
        }
    }
}

#[test]
fn every_metric_gives_the_same_bits_for_any_number_of_threads() {
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        pool.install(|| measure_all(&pair_of(textured(1), textured(9))))
            .into_iter()
            .map(|r| (r.name, r.value.to_bits()))
            .collect::<Vec<_>>()
    };
    assert_eq!(with(1), with(2));
    assert_eq!(with(1), with(5));
}

#[test]
fn nan_infinities_and_fireflies_are_counted_and_do_not_spread() {
    let mut test = vec![[0.5; 3]; 48 * 40];
    test[100] = [f32::NAN, 0.5, 0.5];
    test[500] = [f32::INFINITY; 3];
    test[900] = [500.0; 3];
    let mut reference = vec![[0.5; 3]; 48 * 40];
    reference[500] = [f32::NEG_INFINITY; 3];
    let readings = measure_all(&Pair::new(48, 40, test, reference, [Encoding::Linear; 2], Space::Auto));
    let value =
        |name: &str| readings.iter().find(|r| r.name == name).unwrap_or_else(|| panic!("no {name}")).value;
    let counts = ["nan", "inf", "nonfinite", "ref_nonfinite", "fireflies"].map(value);
    assert_eq!(counts, [1.0, 1.0, 1.0, 1.0, 1.0]);
    assert!(readings.iter().all(|r| r.value.is_finite()));
}

#[test]
fn noise_is_explained_and_bias_is_not() {
    // Normal noise by the sum of twelve uniform numbers is too light in the tails to alarm, and has the right variance.
    let mut state = 1u64;
    let mut normal = || {
        let sum: f64 = (0..12)
            .map(|_| {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                (state >> 11) as f64 / (1u64 << 53) as f64
            })
            .sum();
        (sum - 6.0) as f32
    };
    let truth = vec![[0.5; 3]; 48 * 40];
    let reference: Vec<Rgb> = truth.iter().map(|p| p.map(|v| v + 0.01 * normal())).collect();
    let exact = pair_of(truth.clone(), reference.clone());
    let verdict = catoptric_diff::metric::noise_verdict(&exact).expect("a standard error");
    assert!(verdict.explained && verdict.excess_pixels == 0, "{verdict:?}");
    let biased = pair_of(truth.iter().map(|p| p.map(|v| v * 1.01)).collect(), reference.clone());
    assert!(!catoptric_diff::metric::noise_verdict(&biased).expect("a standard error").explained);
    let mut spotted = truth;
    spotted[77] = [0.57; 3];
    let verdict =
        catoptric_diff::metric::noise_verdict(&pair_of(spotted, reference)).expect("a standard error");
    assert!(!verdict.explained && verdict.excess_pixels == 1 && verdict.worst_pixel == [77 % 48, 77 / 48]);
}

#[test]
fn crop_and_mask_select_the_same_numbers() {
    let (test, reference) = (Image::from_rgb(48, 40, &textured(1)), Image::from_rgb(48, 40, &textured(5)));
    let inside = |x: usize, y: usize| (8..24).contains(&x) && (16..32).contains(&y);
    let mask: Vec<Rgb> = (0..48 * 40).map(|i| [f32::from(u8::from(inside(i % 48, i / 48))); 3]).collect();
    let cropped = compare(
        test.clone(),
        reference.clone(),
        &Params { crop: Some([8, 16, 16, 16]), ..Params::default() },
    )
    .expect("inside");
    let masked = Params { mask: Some(Image::from_rgb(48, 40, &mask)), ..Params::default() };
    let masked = compare(test, reference, &masked).expect("some pixels");
    for name in ["MSE", "relMSE", "MRSE", "energy_R", "lum_ratio", "p95_abs", "max_abs"] {
        let value = |c: &catoptric_diff::Comparison| c.layers[0].reading(name).expect(name).value;
        let (a, b) = (value(&cropped), value(&masked));
        assert!((a - b).abs() <= 1e-12 * a.abs(), "{name}: {a} cropped, {b} masked");
    }
}
