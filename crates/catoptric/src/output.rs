//! Where results go: names for cameras and frames, and whether a file can be written before hours are spent on it.

use std::collections::HashSet;
use std::path::{Path, PathBuf};

use catoptric_image::tone::{Curve, ToneMap, auto_exposure, to_srgb8};
use catoptric_image::{Image, is_stream, place_of_output, write_png8};

use catoptric_render::lines;

use crate::args::Layers;
use crate::failure::Failure;

/// What an image file holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Format {
    Exr,
    Pfm,
    Png,
}

/// Where the images of a run go.
#[derive(Clone, Debug)]
pub(crate) struct Outputs {
    image: PathBuf,
    format: Format,
    preview: Option<PathBuf>,
    /// Exposure of PNGs in stops; the first image decides where nobody did.
    exposure: Option<f32>,
}

impl Outputs {
    /// Checks the names; layers need an EXR, but lines of the mesh can be drawn over a PNG.
    pub(crate) fn new(
        image: Option<&Path>,
        preview: Option<&Path>,
        layers: &[Layers],
        exposure: Option<f32>,
    ) -> Result<Self, Failure> {
        let Some(image) = image else {
            return Err(Failure::usage("no output was named", "add -o FILE.exr"));
        };
        let format = match extension(image).as_str() {
            "exr" => Format::Exr,
            "pfm" => Format::Pfm,
            "png" => Format::Png,
            _ => {
                return Err(Failure::usage(
                    format_args!("{}: unknown kind of image", image.display()),
                    "images are written as .exr, .pfm or .png: name the output like out.exr",
                ));
            }
        };
        let drawn = format == Format::Png || preview.is_some();
        let cannot = |layers: &Layers| format != Format::Exr && !(*layers == Layers::Mesh && drawn);
        if layers.iter().any(cannot) {
            return Err(Failure::usage(
                format_args!("{}: --layers needs an OpenEXR file", image.display()),
                "name the output like out.exr",
            ));
        }
        if let Some(preview) = preview.filter(|preview| extension(preview) != "png") {
            return Err(Failure::usage(
                format_args!("{}: previews are written as .png", preview.display()),
                "name the preview like out.png",
            ));
        }
        if let Some(exposure) = exposure.filter(|ev| !ev.is_finite()) {
            return Err(Failure::usage(
                format_args!("an exposure of {exposure} stops"),
                "expected a number like -1.5",
            ));
        }
        Ok(Self { image: image.to_owned(), format, preview: preview.map(Path::to_owned), exposure })
    }

    /// Every path that is written for these cameras and frames.
    pub(crate) fn paths(&self, tag: &Tag) -> Vec<PathBuf> {
        std::iter::once(&self.image).chain(&self.preview).map(|path| tag.apply(path)).collect()
    }

    /// Writes an image; returns the files.
    pub(crate) fn write(&mut self, image: &Image, tag: &Tag) -> Result<Vec<PathBuf>, Failure> {
        let path = tag.apply(&self.image);
        match self.format {
            Format::Exr => image.write_exr(&path)?,
            Format::Pfm => image.write_pfm(&path)?,
            Format::Png => self.write_display(image, &path)?,
        }
        if let Some(preview) = &self.preview {
            self.write_display(image, &tag.apply(&preview.clone()))?;
        }
        Ok(self.paths(tag))
    }

    fn write_display(&mut self, image: &Image, path: &Path) -> Result<(), Failure> {
        let pixels = image.rgb("").unwrap_or_default();
        let exposure_ev = *self.exposure.get_or_insert_with(|| auto_exposure(pixels.iter().copied()));
        let tone = ToneMap { exposure_ev, curve: Curve::Clip };
        let mut bytes = to_srgb8(&pixels, image.width, &tone);
        if let Some(lines) = image.channel(lines::LAYER) {
            draw(&mut bytes, lines);
        }
        Ok(write_png8(path, image.width, image.height, &bytes)?)
    }
}

/// sRGB of the lines of the mesh: plain to see on white and on black, and rare in rooms.
const LINE: [f32; 3] = [0.0, 130.0, 255.0];

/// Draws lines over a picture.
fn draw(pixels: &mut [[u8; 3]], lines: &[f32]) {
    for (pixel, covered) in pixels.iter_mut().zip(lines) {
        for (byte, line) in pixel.iter_mut().zip(LINE) {
            *byte = (f32::from(*byte) * (1.0 - covered) + line * covered).round() as u8;
        }
    }
}

/// What distinguishes one image of a run from the others.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Tag {
    /// The camera, if there are several.
    pub(crate) camera: Option<String>,
    /// The frame, if there are frames.
    pub(crate) frame: Option<u32>,
}

impl Tag {
    /// `out.exr` → `out.Left.0012.exr`.
    pub(crate) fn apply(&self, path: &Path) -> PathBuf {
        let mut name = path.file_stem().unwrap_or_default().to_os_string();
        if let Some(camera) = &self.camera {
            name.push(".");
            name.push(in_file_name(camera));
        }
        if let Some(frame) = self.frame {
            name.push(format!(".{frame:04}"));
        }
        if let Some(extension) = path.extension() {
            name.push(".");
            name.push(extension);
        }
        path.with_file_name(name)
    }
}

/// A camera's name without what file systems cannot hold.
pub(crate) fn in_file_name(name: &str) -> String {
    let legal = |c: char| if c.is_control() || "/\\:*?\"<>|".contains(c) { '_' } else { c };
    name.chars().map(legal).collect()
}

fn extension(path: &Path) -> String {
    path.extension().unwrap_or_default().to_string_lossy().to_lowercase()
}

/// Where a file lies or will lie, whatever leads to it.
fn place(path: &Path) -> PathBuf {
    let path = place_of_output(path);
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    match (path.canonicalize(), folder.canonicalize(), path.file_name()) {
        (Ok(place), ..) => place,
        (Err(_), Ok(folder), Some(name)) => folder.join(name),
        _ => path,
    }
}

/// Says now, not after the work, that `path` cannot be written. Devices and pipes are written to as they are.
pub(crate) fn check(path: &Path) -> Result<(), Failure> {
    let shown = path.display();
    if path.is_dir() {
        return Err(Failure::run(format_args!("{shown}: is a folder"), "name a file in it, like out.exr"));
    }
    if is_stream(path) {
        return Ok(());
    }
    let target = place_of_output(path);
    let folder = match target.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    if !folder.is_dir() {
        return Err(Failure::run(
            format_args!("{shown}: the folder {} does not exist", folder.display()),
            format_args!("make it first: mkdir -p {}", folder.display()),
        ));
    }
    if let Err(error) = tempfile::Builder::new().prefix(".catoptric-").suffix(".tmp").tempfile_in(folder) {
        return Err(Failure::run(
            format_args!("{shown}: cannot be written: {error}"),
            format_args!(
                "the folder {} must be writable: results are written beside and renamed",
                folder.display()
            ),
        ));
    }
    Ok(())
}

/// Checks that no file that will be written is one of those that are read.
pub(crate) fn check_are_no_inputs<'a>(
    paths: impl IntoIterator<Item = &'a PathBuf>,
    inputs: &[PathBuf],
) -> Result<(), Failure> {
    let read: HashSet<PathBuf> = inputs.iter().map(|input| place(input)).collect();
    match paths.into_iter().find(|path| !is_stream(path) && read.contains(&place(path))) {
        None => Ok(()),
        Some(path) => Err(Failure::usage(
            format_args!("{}: is an input of this command and would be overwritten", path.display()),
            "name another output",
        )),
    }
}

/// Checks that no two outputs are the same file, by whatever names.
pub(crate) fn check_distinct(paths: &[PathBuf]) -> Result<(), Failure> {
    let files = paths.iter().filter(|path| !is_stream(path));
    let mut sorted: Vec<(PathBuf, &PathBuf)> = files.map(|path| (place(path), path)).collect();
    sorted.sort();
    match sorted.windows(2).find(|pair| pair[0].0 == pair[1].0) {
        None => Ok(()),
        Some(pair) => Err(Failure::usage(
            format_args!("{}: is named for two outputs", pair[0].1.display()),
            "give each output its own name",
        )),
    }
}

/// Bytes of a camera's name in a file's, at most: file systems hold 255, with the output's own name, frames and endings.
const MOST_OF_NAME: usize = 100;

/// Names for files, of so many cameras: no two are the same, whatever file systems cannot tell apart in them.
pub(crate) fn file_names<'a>(names: impl Iterator<Item = &'a str>) -> Vec<String> {
    let mut taken: HashSet<String> = HashSet::new();
    let free = |name: &str| {
        let mut own = in_file_name(name);
        while own.len() > MOST_OF_NAME {
            own.pop();
        }
        let numbered = (2..).map(|number| format!("{own}_{number}"));
        let found =
            std::iter::once(own.clone()).chain(numbered).find(|name| taken.insert(name.to_lowercase()));
        found.unwrap_or(own)
    };
    names.map(free).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cameras_and_frames_stand_before_the_extension() {
        let tag = |camera: Option<&str>, frame| Tag { camera: camera.map(str::to_owned), frame };
        let name = |t: &Tag| t.apply(Path::new("dir/out.v2.exr")).display().to_string();
        assert_eq!(name(&tag(None, None)), "dir/out.v2.exr");
        assert_eq!(name(&tag(Some("Left"), None)), "dir/out.v2.Left.exr");
        assert_eq!(name(&tag(Some("a/b"), Some(7))), "dir/out.v2.a_b.0007.exr");
        assert_eq!(name(&tag(None, Some(12345))), "dir/out.v2.12345.exr");
    }

    #[test]
    fn an_output_has_a_known_extension_and_a_folder() {
        let new = |image: &str, layers: &[Layers]| Outputs::new(Some(Path::new(image)), None, layers, None);
        assert!(new("a.exr", &[Layers::Light, Layers::Mesh]).is_ok());
        assert!(matches!(new("a.jpeg", &[]), Err(Failure::Usage(_))));
        assert!(matches!(new("a.png", &[Layers::Light]), Err(Failure::Usage(_))));
        assert!(new("a.png", &[Layers::Mesh]).is_ok());
        assert!(matches!(new("a.pfm", &[Layers::Mesh]), Err(Failure::Usage(_))));
        assert!(matches!(check(Path::new("no/such/folder/a.exr")), Err(Failure::Run(_))));
        assert!(check_distinct(&["a.png".into(), "b.png".into(), "a.png".into()]).is_err());
        assert!(check_distinct(&["a.png".into(), "./a.png".into()]).is_err());
        assert!(check_distinct(&["a.png".into(), "b.png".into()]).is_ok());
    }

    #[test]
    fn cameras_have_files_of_their_own() {
        let long = "ü".repeat(200);
        let names = file_names(["a/b", "a_b", "A_B", "\u{7}", &long].into_iter());
        assert_eq!(names[..4], ["a_b", "a_b_2", "A_B_3", "_"]);
        assert!(names[4].len() <= MOST_OF_NAME && names[4].starts_with('ü'));
    }
}
