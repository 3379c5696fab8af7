//! Edges, and what is thinner than a pixel, in pictures: as bright as they are, with no gaps.

use catoptric_render::{RenderParams, RenderReport, render};
use catoptric_scene::{Camera, Material, Projection, Radiance, Rgb, Scene, SceneParts, Silent};
use catoptric_solution::{Quality, Solution};
use catoptric_trace::Tracer;
use glam::{Affine3A, Vec3};

/// A slanted lamp on black, and a wall of nearly the same brightness behind it.
fn slanted_lamp(behind: f32) -> Scene {
    let mut parts = SceneParts::default();
    let glowing = |strength: f32| Material::emitter("glowing", Radiance(Rgb::splat(strength)));
    let lamp = parts.add_material(glowing(1.0));
    let turned = |x: f32, y: f32| Vec3::new(0.96 * x - 0.28 * y, 0.28 * x + 0.96 * y, 0.0);
    parts.add_quad("lamp", lamp, turned(-0.5, -0.5), turned(1.0, 0.0), turned(0.0, 1.0));
    if behind > 0.0 {
        let wall = parts.add_material(glowing(behind));
        let corner = Vec3::new(-2.0, -2.0, -1.0);
        parts.add_quad("wall", wall, corner, Vec3::X * 4.0, Vec3::Y * 4.0);
    }
    Scene::new(parts).expect("a valid scene")
}

/// A picture of the square of 2 m around the origin, its luminance pixel by pixel, and what was done.
fn picture(scene: &Scene, params: &RenderParams) -> (Vec<f64>, RenderReport) {
    let camera = Camera {
        name: "eye".to_owned(),
        world_from_camera: Affine3A::from_translation(Vec3::Z),
        projection: Projection::Orthographic { xmag: 1.0, ymag: 1.0 },
        aspect: None,
        near: 0.0,
    };
    let tracer = Tracer::new(scene);
    let rendered = render(&tracer, &Solution::default(), &camera, params, &Silent).expect("not stopped");
    let samples = rendered.image.channel("G").expect("a picture");
    (samples.iter().map(|v| f64::from(*v)).collect(), rendered.report)
}

#[test]
fn strong_edges_are_smooth_and_faint_ones_cost_little() {
    let (strong, faint) = (slanted_lamp(0.0), slanted_lamp(0.97));
    for quality in [Quality::Draft, Quality::Standard, Quality::High] {
        let params = RenderParams::for_quality(quality, 64, 64);
        let (pixels, many) = picture(&strong, &params);
        let (_, few) = picture(&faint, &params);
        let mean = pixels.iter().sum::<f64>() / pixels.len() as f64;
        // The lamp covers a quarter of the picture, 1024 pixels, and its border about 128. Samples deviate by half of the
        // light at most, means of 16 by an eighth, the sum of 128 by 1.4: three times that are 4.2e-3 of 1024.
        assert!((mean / 0.25 - 1.0).abs() < 4.2e-3, "{quality:?}: {mean}");
        // Behind the faint edge nothing calls for more than the least: its samples deviate by 1.5 % at most.
        assert!(few.refined_pixels > 100, "{quality:?}: {few:?}");
        assert_eq!(few.samples, 64 * 64 + few.refined_pixels * u64::from(params.edge_samples));
        assert!(many.samples > 64 * 64 + many.refined_pixels * u64::from(params.edge_samples));
    }
}

/// A lamp of some width behind the eye, that nothing but a ball shows, before a wall that glows, too.
fn lamp_before_a_ball(
    ball: Material,
    at: Vec3,
    strength: f32,
    [length, width]: [f32; 2],
    wall: f32,
) -> Scene {
    let mut parts = SceneParts::default();
    let mut glowing =
        |strength: f32| parts.add_material(Material::emitter("glowing", Radiance(Rgb::splat(strength))));
    let (lamp, wall) = (glowing(strength), glowing(wall));
    let ball = parts.add_material(ball);
    parts.add_sphere("ball", ball, at, 0.8, 48);
    let along = Vec3::new(length, 0.15 * length, 0.0);
    parts.add_quad("lamp", lamp, Vec3::new(-0.1, 1.45, 1.5) - 0.5 * along, along, Vec3::Z * width);
    parts.add_quad("wall", wall, Vec3::new(-4.0, -4.0, -3.0), Vec3::X * 8.0, Vec3::Y * 8.0);
    Scene::new(parts).expect("a valid scene")
}

/// Light of a square picture, in its pixels.
fn sum(scene: &Scene, size: usize, most_samples: u32) -> f64 {
    let params = RenderParams { most_samples, ..RenderParams::for_quality(Quality::Standard, size, size) };
    picture(scene, &params).0.iter().sum()
}

/// The ball shows a strip 4 cm wide and 2 m long some 0.5 m long and half a centimetre wide: at 32 pixels a pixel is 6 cm wide, at 200 one,
/// so that centres meet it rarely or never.
#[test]
fn a_strip_in_a_chrome_ball_is_as_bright_at_any_size() {
    let chrome = Material::mirror("chrome", Rgb::splat(0.9));
    let scene = lamp_before_a_ball(chrome, Vec3::new(0.03, -0.02, -1.0), 300.0, [2.0, 0.04], 0.0);
    let mean = |size: usize, most_samples: u32| sum(&scene, size, most_samples) / (size * size) as f64;
    // Every pixel by as many samples as it likes.
    let expected = mean(600, 4096);
    assert!(expected > 0.0);
    for size in [32, 48, 64, 96, 128, 200] {
        let found = mean(size, 256);
        // At 32 pixels it is a twelfth of one wide: 256 samples of a pixel deviate by √(11/256) = 0.21, the mean of eight
        // pixels by 0.07.
        assert!((found / expected - 1.0).abs() < 0.14, "{size}: {found} of {expected}");
    }
}

/// A glass ball shows a lamp twice, in front and, upside down, in its back: both much fainter than what is seen through it, and smaller than
/// a pixel.
#[test]
fn a_small_lamp_in_a_glass_ball_is_never_missed() {
    let light = |at: Vec3, size: usize, most_samples: u32| {
        let [lit, dark] = [600.0, 0.0].map(|strength| {
            let glass = Material::glass("glass", 1.5);
            sum(&lamp_before_a_ball(glass, at, strength, [0.1, 0.1], 1.0), size, most_samples)
        });
        (lit - dark) / (size * size) as f64
    };
    for step in 0..12 {
        // A pixel is 3 cm wide.
        let at = Vec3::new(0.0053 * step as f32, 0.0082 * step as f32, -1.0);
        let (found, expected) = (light(at, 64, 256), light(at, 384, 256));
        // Each of three images, one in the rim, is met by about half of eight samples: they deviate by √(1/8) at most, their sum by 0.2.
        assert!((found / expected - 1.0).abs() < 0.3, "{step}: {found} of {expected}");
    }
}

/// A slit a fifth of a pixel wide, a hundred times as bright as the wall: from row 8 to row 56 it passes between the centres
/// of columns 31 and 32.
#[test]
fn what_is_thinner_than_a_pixel_is_whole_between_the_centres() {
    let mut parts = SceneParts::default();
    let glowing = |strength: f32| Material::emitter("glowing", Radiance(Rgb::splat(strength)));
    let (wall, slit) = (parts.add_material(glowing(1.0)), parts.add_material(glowing(100.0)));
    parts.add_quad("wall", wall, Vec3::new(-2.0, -2.0, -1.0), Vec3::X * 4.0, Vec3::Y * 4.0);
    // A pixel is 1/32 m wide; from bottom to top it leans by one and a quarter.
    let (width, lean) = (0.2 / 32.0, 1.25 / 32.0);
    let corner = Vec3::new(-0.5 * (width + lean), -1.0, 0.0);
    parts.add_quad("slit", slit, corner, Vec3::X * width, Vec3::new(lean, 2.0, 0.0));
    let scene = Scene::new(parts).expect("a valid scene");
    for quality in [Quality::Draft, Quality::Standard, Quality::High] {
        let params = RenderParams::for_quality(quality, 64, 64);
        let (pixels, _) = picture(&scene, &params);
        // Each row holds a fifth of a pixel. It covers as much of one pixel or shares it between two; of so many samples
        // that deviates by √(0.2·0.8/n) at most (the grids are stratified), and one in ten thousand rows by four times that.
        let tolerance = 4.0 * (0.16 / f64::from(params.most_samples)).sqrt();
        for (row, pixels) in pixels.chunks(64).enumerate() {
            let covered = (pixels.iter().sum::<f64>() - 64.0) / 99.0;
            assert!((covered - 0.2).abs() < tolerance, "{quality:?}, row {row}: {covered} of a pixel");
        }
    }
}

/// A joint a third of a pixel wide, half as bright as the wall: a slope of one in forty, so that it passes between centres for most of
/// its way, and no pixel of it is noisy.
#[test]
fn a_joint_of_little_contrast_is_whole_between_the_centres() {
    let mut parts = SceneParts::default();
    let glowing = |strength: f32| Material::emitter("glowing", Radiance(Rgb::splat(strength)));
    let (wall, joint) = (parts.add_material(glowing(1.0)), parts.add_material(glowing(0.5)));
    parts.add_quad("wall", wall, Vec3::new(-2.0, -2.0, -1.0), Vec3::X * 4.0, Vec3::Y * 4.0);
    let (width, lean) = (0.33 / 32.0, 1.6 / 32.0);
    let corner = Vec3::new(-0.5 * (width + lean), -1.0, 0.0);
    parts.add_quad("joint", joint, corner, Vec3::X * width, Vec3::new(lean, 2.0, 0.0));
    let scene = Scene::new(parts).expect("a valid scene");
    for quality in [Quality::Draft, Quality::Standard, Quality::High] {
        let params = RenderParams::for_quality(quality, 64, 64);
        let (pixels, _) = picture(&scene, &params);
        // A third of a pixel in each row, of at least 16 stratified samples of one pixel or two: it deviates by √(0.33·0.67/16) at
        // most, the mean of 64 rows by an eighth of that, and one picture in ten thousand by four times.
        let covered = |row: &[f64]| (64.0 - row.iter().sum::<f64>()) / 0.5;
        let rows: Vec<f64> = pixels.chunks(64).map(covered).collect();
        let mean = rows.iter().sum::<f64>() / 64.0;
        assert!((mean - 0.33).abs() < 4.0 * 0.118 / 8.0, "{quality:?}: {mean} of a pixel");
        let missed = rows.iter().filter(|&&row| row == 0.0).count();
        assert_eq!(missed, 0, "{quality:?}: rows without a joint");
    }
}

/// A lamp of 20 × 0.3 pixels between two rows of centres, straight and in a mirror.
#[test]
fn a_thin_lamp_between_all_centres_is_seen() {
    for mirrored in [false, true] {
        let mut parts = SceneParts::default();
        let lamp = parts.add_material(Material::emitter("lamp", Radiance(Rgb::splat(100.0))));
        // A pixel is 1/32 m wide; the row of centres above is at half a pixel.
        let (left, bottom) = (Vec3::X * (-10.0 / 32.0), Vec3::Y * (-0.15 / 32.0));
        let (wide, high) = (Vec3::X * (20.0 / 32.0), Vec3::Y * (0.3 / 32.0));
        if mirrored {
            let mirror = parts.add_material(Material::mirror("mirror", Rgb::ONE));
            parts.add_quad("mirror", mirror, Vec3::new(-1.0, -1.0, -1.0), Vec3::X * 2.0, Vec3::Y * 2.0);
            // Behind the eye, and turned to it.
            parts.add_quad("lamp", lamp, left + bottom + Vec3::Z * 2.0, high, wide);
        } else {
            parts.add_quad("lamp", lamp, left + bottom, wide, high);
        }
        let scene = Scene::new(parts).expect("a valid scene");
        for quality in [Quality::Draft, Quality::Standard, Quality::High] {
            let (pixels, _) = picture(&scene, &RenderParams::for_quality(quality, 64, 64));
            let covered = pixels.iter().sum::<f64>() / 100.0;
            // 6 pixels' worth, shared by 40 pixels of at least 16 samples: on stratified grids each deviates by less than
            // √(0.15·0.85/16) = 0.09, their sum by 0.56, and one picture in ten thousand by four times that.
            assert!((covered - 6.0).abs() < 2.3, "{quality:?}, mirrored: {mirrored}: {covered} pixels");
        }
    }
}

/// Specks that cover a four-hundredth of a pixel each, two hundred times as bright as the stripes behind them, for whose edges all pixels are
/// sampled: of 400 specks, 16 samples of a pixel meet sixteen.
#[test]
fn a_speck_that_one_sample_meets_is_no_bright_dot() {
    let mut parts = SceneParts::default();
    let shown = |v: f32| Material { unlit: true, ..Material::lambertian("shown", Rgb::splat(v)) };
    let [dark, light, bright] = [0.002, 0.005, 1.0].map(|v| parts.add_material(shown(v)));
    let pixel = 1.0 / 32.0;
    for stripe in 0..96_u8 {
        let left = Vec3::new(-1.0 + f32::from(stripe) * pixel * 2.0 / 3.0, -1.0, -1.0);
        let material = if stripe % 2 == 0 { dark } else { light };
        parts.add_quad("stripe", material, left, Vec3::X * (pixel * 2.0 / 3.0), Vec3::Y * 2.0);
    }
    for speck in 0..400_u16 {
        let [x, y] = [speck % 20, speck / 20].map(|v| (f32::from(v) - 9.5) * 3.1 + 0.013 * f32::from(speck));
        let corner = Vec3::new(x.rem_euclid(60.0) - 30.0, y.rem_euclid(60.0) - 30.0, 0.0) * pixel;
        parts.add_quad("speck", bright, corner, Vec3::X * (0.05 * pixel), Vec3::Y * (0.05 * pixel));
    }
    let scene = Scene::new(parts).expect("a valid scene");
    for quality in [Quality::Draft, Quality::Standard, Quality::High] {
        let (pixels, _) = picture(&scene, &RenderParams::for_quality(quality, 64, 64));
        // At most 0.005 and 1/400, with a tenth of the mean of 0.0035 that is added; a standard error of a fifth of that, and one in
        // ten thousand pixels off by four of them. One of 16 samples alone would be 0.0625.
        let most = 0.0075 + 4.0 * 0.2 * 0.00785;
        let brightest = pixels.iter().copied().fold(0.0, f64::max);
        assert!(brightest < most, "{quality:?}: {brightest}");
    }
}
