//! NumPy's container: a ZIP archive of `.npy` arrays, stored without compression.
//!
//! Sources: NEP 1 (format 1.0 of `.npy`); PKWARE APPNOTE 6.3 (local headers, central directory). Arrays of 4 GB and
//! more would need ZIP64: they are refused.

/// An archive in the making.
#[derive(Debug, Default)]
pub(crate) struct Npz {
    body: Vec<u8>,
    directory: Vec<u8>,
    entries: u16,
}

impl Npz {
    pub(crate) fn add_f64(&mut self, name: &str, values: &[f64]) {
        let data = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        self.add(name, "<f8", &format!("({},)", values.len()), data);
    }

    pub(crate) fn add_i64(&mut self, name: &str, values: &[i64]) {
        let data = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        self.add(name, "<i8", &format!("({},)", values.len()), data);
    }

    /// A single byte string, as SciPy names its formats.
    pub(crate) fn add_bytes(&mut self, name: &str, text: &str) {
        self.add(name, &format!("|S{}", text.len()), "()", text.as_bytes().to_vec());
    }

    /// Strings as UTF-32, padded with zeros.
    pub(crate) fn add_strings(&mut self, name: &str, values: &[&str]) {
        let width = values.iter().map(|v| v.chars().count()).max().unwrap_or(0).max(1);
        let mut data = Vec::with_capacity(values.len() * width * 4);
        for value in values {
            let padded = value.chars().map(u32::from).chain(std::iter::repeat(0)).take(width);
            data.extend(padded.flat_map(u32::to_le_bytes));
        }
        self.add(name, &format!("<U{width}"), &format!("({},)", values.len()), data);
    }

    fn add(&mut self, name: &str, kind: &str, shape: &str, data: Vec<u8>) {
        let mut header = format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}");
        // Magic, version, length and header are a multiple of 64 bytes, the last of them a line end.
        let padding = 63 - (10 + header.len()) % 64;
        header.push_str(&" ".repeat(padding));
        header.push('\n');
        let mut array = b"\x93NUMPY\x01\x00".to_vec();
        array.extend((header.len() as u16).to_le_bytes());
        array.extend(header.as_bytes());
        array.extend(data);

        let file_name = format!("{name}.npy");
        let offset = self.body.len() as u32;
        let mut common = Vec::new();
        // Version 2.0, no flags, stored, 1 January of the year 1980: the same bits every time.
        for field in [20_u16, 0, 0, 0, 0x21] {
            common.extend(field.to_le_bytes());
        }
        common.extend(crc32(&array).to_le_bytes());
        common.extend((array.len() as u32).to_le_bytes());
        common.extend((array.len() as u32).to_le_bytes());
        common.extend((file_name.len() as u16).to_le_bytes());
        common.extend(0_u16.to_le_bytes());
        self.body.extend(b"PK\x03\x04");
        self.body.extend(&common);
        self.body.extend(file_name.as_bytes());
        self.body.extend(array);
        self.directory.extend(b"PK\x01\x02");
        self.directory.extend(20_u16.to_le_bytes());
        self.directory.extend(&common);
        // Comment, disk, attributes.
        self.directory.extend([0; 10]);
        self.directory.extend(offset.to_le_bytes());
        self.directory.extend(file_name.as_bytes());
        self.entries += 1;
    }

    /// The archive; `None` where it would need more than 4 GB.
    pub(crate) fn finish(mut self) -> Option<Vec<u8>> {
        let offset = u32::try_from(self.body.len()).ok()?;
        let size = u32::try_from(self.directory.len()).ok()?;
        self.body.append(&mut self.directory);
        self.body.extend(b"PK\x05\x06");
        self.body.extend([0; 4]);
        self.body.extend(self.entries.to_le_bytes());
        self.body.extend(self.entries.to_le_bytes());
        self.body.extend(size.to_le_bytes());
        self.body.extend(offset.to_le_bytes());
        self.body.extend([0; 2]);
        Some(self.body)
    }
}

/// CRC-32 of ISO 3309, reflected, polynomial 0xedb88320, by a table of nibbles.
fn crc32(bytes: &[u8]) -> u32 {
    let table: [u32; 16] = std::array::from_fn(|n| {
        (0..4).fold(n as u32, |c, _| if c & 1 == 1 { 0xedb8_8320 ^ (c >> 1) } else { c >> 1 })
    });
    !bytes.iter().fold(u32::MAX, |crc, &byte| {
        let low = table[((crc ^ u32::from(byte)) & 15) as usize] ^ (crc >> 4);
        table[((low ^ u32::from(byte >> 4)) & 15) as usize] ^ (low >> 4)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The check value of the CRC catalogue.
    #[test]
    fn the_checksum_has_its_check_value() {
        assert_eq!(crc32(b"123456789"), 0xcbf4_3926);
    }

    #[test]
    fn array_data_starts_at_a_multiple_of_64_bytes() {
        let mut npz = Npz::default();
        npz.add_f64("a", &[1.0, 2.0]);
        let bytes = npz.finish().expect("small");
        let start = bytes.windows(6).position(|w| w == b"\x93NUMPY").expect("an array");
        let length = u16::from_le_bytes([bytes[start + 8], bytes[start + 9]]) as usize;
        assert_eq!((10 + length) % 64, 0);
        assert_eq!(bytes[start + 10 + length..start + 18 + length], 1.0_f64.to_le_bytes());
    }
}
