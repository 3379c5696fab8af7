//! Says what the reader makes of each file: one line per file, `ok` with the size and the channels, or the error.
//!
//! ```text
//! cargo run --release -p catoptric-image --example verdicts -- FILES...
//! ```

use std::path::Path;
use std::time::Instant;

use catoptric_image::{Image, ReadLimits};

fn main() {
    for path in std::env::args().skip(1) {
        let start = Instant::now();
        let verdict = match Image::read(Path::new(&path), &ReadLimits::default()) {
            Ok(image) => {
                let names: Vec<&str> = image.channels.iter().map(|c| c.name.as_str()).collect();
                format!("ok {path}: {}x{} {}", image.width, image.height, names.join(","))
            }
            Err(error) => format!("error {error}"),
        };
        println!("{:6.1} ms  {verdict}", start.elapsed().as_secs_f64() * 1e3);
    }
}
