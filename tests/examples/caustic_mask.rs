//! Writes the region of the caustics of a picture with layers, white on black: `-- RENDER.exr MASK.png`.
//!
//! The picture comes from `catoptric render SCENE.glb -o RENDER.exr --size 256 --layers`. A pixel belongs to the region
//! where caustic light, seen directly, is at least a tenth of all light.

use std::path::Path;

use catoptric_image::{Image, ReadLimits, write_png8};

const SHARE: f32 = 0.1;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [render, mask] = arguments.as_slice() else {
        return Err("usage: caustic_mask RENDER.exr MASK.png".into());
    };
    let image = Image::read(Path::new(render), &ReadLimits::default())?;
    let beauty = image.rgb("").ok_or("no beauty")?;
    let caustic = image.rgb("caustic").ok_or("no layer `caustic`: render with --layers")?;
    let sum = |p: &[f32; 3]| p.iter().sum::<f32>();
    let pixels: Vec<[u8; 3]> = caustic
        .iter()
        .zip(&beauty)
        .map(|(c, b)| [if sum(c) > SHARE * sum(b) { 255 } else { 0 }; 3])
        .collect();
    println!("{} of {} pixels", pixels.iter().filter(|p| p[0] > 0).count(), pixels.len());
    write_png8(Path::new(mask), image.width, image.height, &pixels)?;
    Ok(())
}
