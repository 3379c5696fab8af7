//! FLIP against NVIDIA's implementation on the pairs of `tests/data/pairs`.

use std::path::Path;

use catoptric_diff::metric::flip::Exposures;
use catoptric_diff::{Pair, Space};
use catoptric_image::{Image, ReadLimits};

#[test]
fn means_are_those_of_the_reference_implementation_to_1e_4() {
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data");
    let text = std::fs::read_to_string(data.join("pairs.json")).expect("stored values");
    let stored: serde_json::Value = serde_json::from_str(&text).expect("JSON");
    let stored = stored.as_object().expect("an object");
    assert_eq!(stored.len(), 10);
    let mut worst: f64 = 0.0;
    for (name, value) in stored {
        let extension = if name.starts_with("hdr") { "exr" } else { "png" };
        let read = |which: &str| {
            let path = data.join("pairs").join(format!("{name}_{which}.{extension}"));
            Image::read(&path, &ReadLimits::default()).unwrap_or_else(|e| panic!("{e}"))
        };
        let (test, reference) = (read("test"), read("ref"));
        let pixels = |image: &Image| image.rgb("").expect("a beauty");
        let encodings = [test.encoding, reference.encoding];
        let pair =
            Pair::new(test.width, test.height, pixels(&test), pixels(&reference), encodings, Space::Auto);
        let map = pair.flip_map();
        let mean = map.iter().map(|&v| f64::from(v)).sum::<f64>() / map.len() as f64;
        let expected = |key: &str| value[key].as_f64().unwrap_or_else(|| panic!("{name}: {key}"));
        println!("{name}: {mean:.7} against {:.7}", expected("mean"));
        worst = worst.max((mean - expected("mean")).abs());
        let largest = map.iter().copied().fold(0.0, f32::max);
        assert!(
            (f64::from(largest) - expected("max")).abs() < 2e-3,
            "{name}: {largest} against {}",
            expected("max")
        );
        for (i, pixel) in value["first_row"].as_array().expect("pixels").iter().enumerate() {
            assert!(
                (f64::from(map[i]) - pixel.as_f64().expect("a number")).abs() < 2e-3,
                "{name}: pixel {i}"
            );
        }
        if let Exposures::Range { start, stop, count } = pair.exposures() {
            let parameters = &value["parameters"];
            let close =
                |key: &str, own: f32| (parameters[key].as_f64().expect(key) - f64::from(own)).abs() < 1e-4;
            assert!(close("startExposure", start) && close("stopExposure", stop), "{name}: {start} {stop}");
            assert_eq!(parameters["numExposures"].as_f64(), Some(count as f64), "{name}");
        }
    }
    println!("largest deviation of a mean: {worst:.2e}");
    assert!(worst < 1e-4, "{worst}");
}
