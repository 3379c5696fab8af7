//! Luminous intensity by direction as luminaire makers publish it: IES LM-63 files (IESNA 2002, and the editions of 1986 to
//! 1995), type C.
//!
//! Vertical angles run from 0 (nadir, along the light) to 180; horizontal ones turn about that axis from the C0 half-plane. A file
//! names only what symmetry does not give: one half-plane, a quadrant (to 90), a half (to 180, or 90 to 270) or all (to 360).

use std::fmt;

/// Intensity relative to the largest, on a grid of angles.
#[derive(Clone, Debug, PartialEq)]
pub struct Photometry {
    /// Degrees from the axis, ascending.
    vertical: Vec<f32>,
    /// Degrees about the axis, ascending, without what symmetry repeats.
    horizontal: Vec<f32>,
    /// By horizontal angle, then vertical; 1 is the peak.
    share: Vec<f32>,
    /// Candela of the peak, ballast included.
    peak: f32,
}

/// Why a text is no photometric file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PhotometryError(String);

impl fmt::Display for PhotometryError {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for PhotometryError {}

/// Angles of one kind, at most: more than any goniometer gives, less than memory.
const MAX_ANGLES: usize = 2_000;
/// Photometric type of LM-63 that luminaires have.
const TYPE_C: f32 = 1.0;

impl Photometry {
    /// Reads the text of a file.
    pub fn parse(text: &str) -> Result<Self, PhotometryError> {
        let fail = |message: &str| PhotometryError(message.to_owned());
        let start = text.find("TILT=").ok_or_else(|| fail("expected an LM-63 file: it has no line TILT="))?;
        let (tilt, rest) = text[start + 5..].split_once('\n').unwrap_or((&text[start + 5..], ""));
        let mut numbers = rest
            .split(|c: char| c.is_whitespace() || c == ',')
            .filter(|word| !word.is_empty())
            .map(|word| word.parse::<f32>().ok().filter(|n| n.is_finite()));
        let mut next = |what: &str| match numbers.next() {
            Some(Some(number)) => Ok(number),
            Some(None) => Err(PhotometryError(format!("{what}: expected a number"))),
            None => Err(PhotometryError(format!("the file ends before {what}"))),
        };
        match tilt.trim() {
            "NONE" => {}
            "INCLUDE" => {
                // How lamps dim when tilted: luminaires are meant as they hang.
                next("the lamp's geometry")?;
                let pairs = count(next("the number of tilt angles")?)?;
                for _ in 0..2 * pairs {
                    next("the tilt factors")?;
                }
            }
            other => return Err(PhotometryError(format!("TILT={other}: expected NONE or INCLUDE"))),
        }
        for what in ["the number of lamps", "the lumens per lamp"] {
            next(what)?;
        }
        let multiplier = next("the multiplier")?;
        let vertical = count(next("the number of vertical angles")?)?;
        let horizontal = count(next("the number of horizontal angles")?)?;
        let kind = next("the photometric type")?;
        if kind != TYPE_C {
            return Err(PhotometryError(format!("photometric type {kind}: only type C (1) is read")));
        }
        for what in ["the units", "the width", "the length", "the height"] {
            next(what)?;
        }
        let ballast = next("the ballast factor")? * next("the ballast-lamp factor")?;
        next("the input watts")?;
        let mut list = |what: &str, count: usize| -> Result<Vec<f32>, PhotometryError> {
            (0..count).map(|_| next(what)).collect()
        };
        let vertical = list("the vertical angles", vertical)?;
        let horizontal = list("the horizontal angles", horizontal)?;
        let mut share = list("the candela values", vertical.len() * horizontal.len())?;
        let ascends = |angles: &[f32]| angles.windows(2).all(|w| w[0] < w[1]);
        if !ascends(&vertical)
            || !ascends(&horizontal)
            || vertical[0] < 0.0
            || vertical[vertical.len() - 1] > 180.0
        {
            return Err(fail("its angles do not ascend, or leave 0 to 180 degrees"));
        }
        let (first, last) = (horizontal[0], horizontal[horizontal.len() - 1]);
        let known = [(0.0, 0.0), (0.0, 90.0), (0.0, 180.0), (0.0, 360.0), (90.0, 270.0)];
        if !known.contains(&(first, last)) {
            return Err(PhotometryError(format!(
                "horizontal angles from {first} to {last}: expected 0 to 0, 90, 180 or 360, or 90 to 270"
            )));
        }
        let largest = share.iter().copied().fold(0.0, f32::max);
        let peak = largest * multiplier * ballast;
        if !(peak > 0.0 && peak.is_finite()) || share.iter().any(|c| *c < 0.0) {
            return Err(fail("its candela values are not positive numbers"));
        }
        share.iter_mut().for_each(|c| *c /= largest);
        Ok(Self { vertical, horizontal, share, peak })
    }

    /// Candela of the peak.
    pub fn peak(&self) -> f32 {
        self.peak
    }

    /// Share of the peak at `vertical` degrees from the axis and `horizontal` degrees about it, bilinear between the
    /// angles of the file; nothing beyond them.
    pub fn share(&self, vertical: f32, horizontal: f32) -> f32 {
        let (first, last) = (self.vertical[0], self.vertical[self.vertical.len() - 1]);
        if vertical < first || vertical > last {
            return 0.0;
        }
        let (row, v) = place(&self.vertical, vertical);
        let (column, h) = place(&self.horizontal, self.folded(horizontal));
        let at = |column: usize, row: usize| {
            let column = column.min(self.horizontal.len() - 1);
            self.share[column * self.vertical.len() + row.min(self.vertical.len() - 1)]
        };
        let along = |column: usize| at(column, row) * (1.0 - v) + at(column, row + 1) * v;
        along(column) * (1.0 - h) + along(column + 1) * h
    }

    /// The horizontal angle with what symmetry says.
    fn folded(&self, degrees: f32) -> f32 {
        let (first, last) = (self.horizontal[0], self.horizontal[self.horizontal.len() - 1]);
        let around = degrees.rem_euclid(360.0);
        let half = if around > 180.0 { 360.0 - around } else { around };
        match (first, last) {
            (0.0, 90.0) => half.min(180.0 - half),
            (0.0, 180.0) => half,
            (0.0, 360.0) => around,
            (90.0, 270.0) if around < 90.0 => 180.0 - around,
            (90.0, 270.0) if around > 270.0 => 540.0 - around,
            (90.0, 270.0) => around,
            _ => 0.0,
        }
    }

    /// Its numbers, for hashing.
    pub(crate) fn numbers(&self) -> impl Iterator<Item = f32> + '_ {
        [self.peak]
            .into_iter()
            .chain([&self.vertical, &self.horizontal, &self.share].into_iter().flatten().copied())
    }
}

fn count(number: f32) -> Result<usize, PhotometryError> {
    let count = number as usize;
    if number < 1.0 || number > MAX_ANGLES as f32 || count as f32 != number {
        return Err(PhotometryError(format!("{number} angles: expected 1 to {MAX_ANGLES}")));
    }
    Ok(count)
}

/// The interval of `angles` that holds a value, and where in it.
fn place(angles: &[f32], value: f32) -> (usize, f32) {
    let index = angles.partition_point(|a| *a <= value).saturating_sub(1);
    match angles.get(index + 1) {
        Some(next) => (index, ((value - angles[index]) / (next - angles[index])).clamp(0.0, 1.0)),
        None => (index, 0.0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(horizontal: &[f32], value: impl Fn(f32, f32) -> f32) -> String {
        let vertical: Vec<f32> = (0..=36).map(|k| 5.0 * k as f32).collect();
        let list = |angles: &[f32]| angles.iter().map(f32::to_string).collect::<Vec<_>>().join(" ");
        let mut text = format!(
            "IESNA:LM-63-2002\r\n[TEST] none\r\n[MANUFAC] nobody\r\nTILT=NONE\r\n1 1000 2 {} {} 1 2 0 0 0\r\n0.5 1 40\r\n{}\r\n{}\r\n",
            vertical.len(),
            horizontal.len(),
            list(&vertical),
            list(horizontal)
        );
        for &h in horizontal {
            let row: Vec<f32> = vertical.iter().map(|&v| value(v, h)).collect();
            text.push_str(&list(&row));
            text.push_str("\r\n");
        }
        text
    }

    #[test]
    fn intensity_is_what_the_file_says_with_multiplier_and_ballast() {
        let photometry = Photometry::parse(&file(&[0.0], |v, _| 180.0 - v)).unwrap();
        assert_eq!(photometry.peak(), 180.0 * 2.0 * 0.5);
        assert_eq!(photometry.share(0.0, 77.0), 1.0);
        assert_eq!(photometry.share(180.0, 0.0), 0.0);
        // Linear between the angles of the file.
        assert!((photometry.share(92.5, 200.0) - 87.5 / 180.0).abs() < 1e-6);
    }

    #[test]
    fn symmetry_gives_the_angles_that_the_file_leaves_out() {
        let whole = |h: f32| 2.0 + libm::cosf(h.to_radians() * 2.0);
        let angles = |from: u32, to: u32| (from..=to).step_by(10).map(|a| a as f32).collect::<Vec<_>>();
        for (from, to) in [(0, 90), (0, 180), (0, 360), (90, 270)] {
            let photometry = Photometry::parse(&file(&angles(from, to), |_, h| whole(h))).unwrap();
            for h in [0.0, 40.0, 130.0, 220.0, 310.0, -50.0, 400.0] {
                let expected = whole(h) / 3.0;
                assert!((photometry.share(30.0, h) - expected).abs() < 1e-5, "{from} to {to}: {h}");
            }
        }
    }

    #[test]
    fn files_that_are_broken_say_where() {
        let good = file(&[0.0], |_, _| 1.0);
        for (text, part) in [
            ("", "TILT"),
            ("TILT=SIDEWAYS\n", "SIDEWAYS"),
            ("TILT=NONE\n1 1000", "multiplier"),
            (&good.replace("37 1 1 2", "37 1 3 2"), "type C"),
            (&good.replace("37 1 1 2", "1e9 1 1 2"), "angles"),
            (&good.replace("0 5 10", "0 15 10"), "ascend"),
            (&good[..good.len() - 20], "candela"),
            (&good.replace("0.5 1 40", "x 1 40"), "ballast"),
        ] {
            let error = Photometry::parse(text).unwrap_err().to_string();
            assert!(error.contains(part), "{error}");
        }
    }
}
