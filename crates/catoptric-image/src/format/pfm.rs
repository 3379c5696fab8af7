//! Portable float maps (Debevec): `PF` or `Pf`, width and height, a scale whose sign is the byte order, rows bottom up.

use crate::{Image, ImageError, ReadLimits};

pub(crate) fn decode(bytes: &[u8], limits: &ReadLimits) -> Result<Image, ImageError> {
    let damaged = |reason: &str| ImageError::damaged("PFM", reason);
    // Read four words separated by white space; exactly one white space byte ends the header.
    let mut words = Vec::new();
    let mut at = 0;
    while words.len() < 4 {
        let start = at + bytes[at..].iter().take(256).take_while(|b| b.is_ascii_whitespace()).count();
        let length = bytes[start..].iter().take(32).take_while(|b| !b.is_ascii_whitespace()).count();
        let word =
            std::str::from_utf8(&bytes[start..start + length]).map_err(|_| damaged("unreadable header"))?;
        if word.is_empty() {
            return Err(damaged("incomplete header"));
        }
        words.push(word);
        at = start + length;
    }
    at += 1;
    let names: &[&str] = if words[0] == "PF" { &["R", "G", "B"] } else { &["Y"] };
    let side = |word: &str| {
        word.parse::<u32>().ok().filter(|&n| n > 0).ok_or_else(|| damaged("bad width or height"))
    };
    let (width, height) = (side(words[1])?, side(words[2])?);
    let scale = words[3]
        .parse::<f32>()
        .ok()
        .filter(|s| s.is_finite() && *s != 0.0)
        .ok_or_else(|| damaged("bad scale"))?;
    let pixels = limits.check(u64::from(width), u64::from(height), names.len())?;
    let data =
        bytes.get(at..at + pixels * names.len() * 4).ok_or_else(|| damaged("it ends before its pixels"))?;

    let (width, height) = (width as usize, height as usize);
    let mut image = Image::new(width, height);
    for (k, name) in names.iter().enumerate() {
        let sample = |i: usize| {
            let (x, y) = (i % width, height - 1 - i / width);
            let offset = 4 * ((y * width + x) * names.len() + k);
            let raw = [data[offset], data[offset + 1], data[offset + 2], data[offset + 3]];
            if scale < 0.0 { f32::from_le_bytes(raw) } else { f32::from_be_bytes(raw) }
        };
        image.push_channel(name, (0..pixels).map(sample).collect());
    }
    Ok(image)
}

pub(crate) fn encode(image: &Image) -> Result<Vec<u8>, ImageError> {
    let pixels = image.rgb("").ok_or_else(|| ImageError::Inconsistent("it has no beauty".to_owned()))?;
    let mut bytes = format!("PF\n{} {}\n-1.0\n", image.width, image.height).into_bytes();
    for row in pixels.chunks_exact(image.width.max(1)).rev() {
        bytes.extend(row.as_flattened().iter().flat_map(|v| v.to_le_bytes()));
    }
    Ok(bytes)
}
