//! URIs in a glTF file: data, or a file in the folder of the asset. Nothing else is opened.

use std::io::Read;
use std::path::{Path, PathBuf};

/// Why a URI gave no bytes.
pub(super) struct UriProblem {
    pub(super) expected: &'static str,
    pub(super) found: String,
    pub(super) hint: &'static str,
}

const OWN_FOLDER: &str =
    "put the file beside the .gltf and use a relative path, or pack everything into one .glb";

/// Where external files may be: the canonical folder of the asset; how many more bytes may be read.
pub(super) struct Folder {
    root: Option<PathBuf>,
    remaining: u64,
    /// Canonical paths of what was read.
    pub(super) files: Vec<PathBuf>,
}

impl Folder {
    /// The folder of `file`; `budget` bytes may be read from it.
    pub(super) fn of(file: &Path, budget: u64) -> Self {
        let parent = file.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
        Self { root: parent.canonicalize().ok(), remaining: budget, files: Vec::new() }
    }

    /// The bytes behind a URI, and the media type if it names one.
    pub(super) fn read(&mut self, uri: &str) -> Result<(Vec<u8>, Option<String>), UriProblem> {
        if let Some(data) = uri.strip_prefix("data:") {
            let problem = |found: &str| UriProblem {
                expected: "a data URI in base64",
                found: found.to_owned(),
                hint: "",
            };
            let (header, payload) =
                data.split_once(',').ok_or_else(|| problem("a data URI without a comma"))?;
            let media_type = header.split(';').next().filter(|t| !t.is_empty()).map(str::to_ascii_lowercase);
            let bytes = if header.ends_with(";base64") {
                decode_base64(payload).ok_or_else(|| problem("characters that are not base64"))?
            } else {
                percent_decode(payload)
            };
            return Ok((bytes, media_type));
        }
        let path = self.resolve(uri)?;
        let bytes = self.read_file(&path).map_err(|error| UriProblem {
            expected: "a readable file in the folder of the asset",
            found: format!("{uri:?}: {error}"),
            hint: "copy the missing file beside the .gltf",
        })?;
        Ok((bytes, None))
    }

    /// The canonical path of a relative URI, if it lies inside of the folder.
    fn resolve(&self, uri: &str) -> Result<PathBuf, UriProblem> {
        let refuse = |why: &str| UriProblem {
            expected: "a data URI or a relative path inside the folder of the asset",
            found: format!("{uri:?} ({why})"),
            hint: OWN_FOLDER,
        };
        let scheme = uri.split(['/', '?', '#']).next().unwrap_or_default();
        if scheme.contains(':') {
            return Err(refuse("an address with a scheme is never opened"));
        }
        let decoded = String::from_utf8(percent_decode(uri)).map_err(|_| refuse("not UTF-8"))?;
        if decoded.is_empty() || decoded.contains('\0') {
            return Err(refuse("not a path"));
        }
        let relative = Path::new(&decoded);
        if decoded.starts_with(['/', '\\']) || decoded.contains(":\\") || relative.is_absolute() {
            return Err(refuse("an absolute path is never opened"));
        }
        let root = self.root.as_ref().ok_or_else(|| refuse("the asset has no folder"))?;
        // What does not exist lies nowhere; say so before saying that it lies outside.
        let inside = relative
            .components()
            .all(|part| matches!(part, std::path::Component::Normal(_) | std::path::Component::CurDir));
        if !inside {
            return Err(refuse("it leaves the folder of the asset"));
        }
        let path = root.join(relative).canonicalize().map_err(|error| UriProblem {
            expected: "an existing file in the folder of the asset",
            found: format!("{uri:?}: {error}"),
            hint: "copy the missing file beside the .gltf",
        })?;
        if path.starts_with(root) { Ok(path) } else { Err(refuse("it leads out of the folder of the asset")) }
    }

    fn read_file(&mut self, path: &Path) -> Result<Vec<u8>, String> {
        let (bytes, rest) = read_limited(path, self.remaining)?;
        self.remaining = rest;
        self.files.push(path.to_owned());
        Ok(bytes)
    }
}

/// A regular file of at most `limit` bytes, and what is left of the limit.
pub(super) fn read_limited(path: &Path, limit: u64) -> Result<(Vec<u8>, u64), String> {
    let metadata = std::fs::metadata(path).map_err(|error| error.to_string())?;
    // Devices and pipes may block or never end.
    if !metadata.is_file() {
        return Err("not a regular file".to_owned());
    }
    if metadata.len() > limit {
        return Err(format!("{} bytes, more than the limit leaves ({limit})", metadata.len()));
    }
    let file = std::fs::File::open(path).map_err(|error| error.to_string())?;
    let mut bytes = Vec::new();
    // One more: the end of the file is found without growing.
    let size = usize::try_from(metadata.len()).unwrap_or(0).saturating_add(1);
    bytes.try_reserve_exact(size).map_err(|error| error.to_string())?;
    file.take(limit + 1).read_to_end(&mut bytes).map_err(|error| error.to_string())?;
    if bytes.len() as u64 > limit {
        return Err(format!("more bytes than the limit leaves ({limit})"));
    }
    let rest = limit - bytes.len() as u64;
    Ok((bytes, rest))
}

/// `%41` → `A`; a `%` without two hexadecimal digits stays.
fn percent_decode(text: &str) -> Vec<u8> {
    let bytes = text.as_bytes();
    let digit = |at: usize| bytes.get(at).and_then(|b| char::from(*b).to_digit(16));
    let mut decoded = Vec::with_capacity(bytes.len());
    let mut at = 0;
    while at < bytes.len() {
        match (bytes[at], digit(at + 1), digit(at + 2)) {
            (b'%', Some(high), Some(low)) => {
                decoded.push((high * 16 + low) as u8);
                at += 3;
            }
            (byte, ..) => {
                decoded.push(byte);
                at += 1;
            }
        }
    }
    decoded
}

/// RFC 4648 base64, either alphabet, padding optional, white space skipped.
fn decode_base64(text: &str) -> Option<Vec<u8>> {
    let mut decoded = Vec::with_capacity(text.len() / 4 * 3);
    let (mut bits, mut filled) = (0_u32, 0);
    for byte in text.trim_end_matches('=').bytes() {
        let digit = match byte {
            b'A'..=b'Z' => byte - b'A',
            b'a'..=b'z' => byte - b'a' + 26,
            b'0'..=b'9' => byte - b'0' + 52,
            b'+' | b'-' => 62,
            b'/' | b'_' => 63,
            b' ' | b'\n' | b'\r' | b'\t' => continue,
            _ => return None,
        };
        bits = bits << 6 | u32::from(digit);
        filled += 6;
        if filled >= 8 {
            filled -= 8;
            decoded.push((bits >> filled) as u8);
            bits &= (1 << filled) - 1;
        }
    }
    Some(decoded)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_decodes_the_vectors_of_rfc_4648() {
        for (text, bytes) in [
            ("", ""),
            ("Zg==", "f"),
            ("Zm8=", "fo"),
            ("Zm9v", "foo"),
            ("Zm9vYg", "foob"),
            ("Zm9vYmFy", "foobar"),
        ] {
            assert_eq!(decode_base64(text).as_deref(), Some(bytes.as_bytes()), "{text}");
        }
        assert_eq!(decode_base64("Zm9v*"), None);
    }

    #[test]
    fn paths_that_leave_the_folder_and_addresses_are_refused() {
        let directory = tempfile::tempdir().unwrap();
        let inner = directory.path().join("inner");
        std::fs::create_dir(&inner).unwrap();
        std::fs::write(directory.path().join("secret.bin"), b"secret").unwrap();
        std::fs::write(inner.join("own file.bin"), b"own").unwrap();
        let mut folder = Folder::of(&inner.join("scene.gltf"), 100);
        for uri in [
            "../secret.bin",
            "%2e%2e/secret.bin",
            "..%2fsecret.bin",
            "x/../../secret.bin",
            "/etc/passwd",
            "file:///etc/passwd",
            "http://example.org/a.bin",
            "C:\\windows\\a.bin",
            "\\\\server\\a.bin",
            "%00",
            "%ff",
            "",
        ] {
            assert!(folder.read(uri).is_err(), "{uri:?} must be refused");
        }
        assert_eq!(folder.read("own%20file.bin").ok().map(|r| r.0), Some(b"own".to_vec()));
    }

    #[cfg(unix)]
    #[test]
    fn a_link_out_of_the_folder_is_refused() {
        let directory = tempfile::tempdir().unwrap();
        let inner = directory.path().join("inner");
        std::fs::create_dir(&inner).unwrap();
        std::fs::write(directory.path().join("secret.bin"), b"secret").unwrap();
        std::os::unix::fs::symlink(directory.path().join("secret.bin"), inner.join("link.bin")).unwrap();
        assert!(Folder::of(&inner.join("scene.gltf"), 100).read("link.bin").is_err());
    }

    #[test]
    fn the_byte_limit_counts_all_files_together() {
        let directory = tempfile::tempdir().unwrap();
        std::fs::write(directory.path().join("a.bin"), [0; 60]).unwrap();
        let mut folder = Folder::of(&directory.path().join("scene.gltf"), 100);
        assert!(folder.read("a.bin").is_ok());
        assert!(folder.read("a.bin").is_err(), "only 40 bytes are left");
    }
}
