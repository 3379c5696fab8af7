//! Files that are either the old one or the new one, never torn.

use std::io::Write;
use std::path::{Path, PathBuf};

/// Writes `bytes` beside `path`, flushes them to the disk and renames the file into place. What a link leads to is written, not the link
/// replaced; a device or a pipe is written to as it is.
pub fn write_bytes_atomically(path: &Path, bytes: &[u8]) -> std::io::Result<()> {
    let path = place_of_output(path);
    if is_stream(&path) {
        let mut stream = std::fs::OpenOptions::new().write(true).open(&path)?;
        stream.write_all(bytes)?;
        return stream.flush();
    }
    let folder = match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    let mut builder = tempfile::Builder::new();
    builder.prefix(".catoptric-").suffix(".tmp");
    // A temporary file is private by default; an output has the mode of any new file, which the umask narrows.
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    let mut file = builder.tempfile_in(folder)?;
    file.write_all(bytes)?;
    file.as_file().sync_all()?;
    file.persist(&path).map_err(|error| error.error)?;
    Ok(())
}

/// Where an output lies: past links, as far as they lead to something or would.
pub fn place_of_output(path: &Path) -> PathBuf {
    if let Ok(place) = path.canonicalize() {
        return place;
    }
    // A link to what is not there yet; a ring of links ends in the error of writing it.
    match path.read_link() {
        Ok(target) => path.parent().map_or(target.clone(), |folder| folder.join(&target)),
        Err(_) => path.to_owned(),
    }
}

/// Whether something is there that is written to, not replaced: a device, a pipe, a socket.
pub fn is_stream(path: &Path) -> bool {
    std::fs::metadata(path).is_ok_and(|data| !data.is_file() && !data.is_dir())
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;
    use std::os::unix::fs::symlink;

    #[test]
    fn links_and_devices_stay_what_they_are() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = |name: &str| folder.path().join(name);
        std::fs::write(path("file"), "old").expect("written");
        symlink("file", path("link")).expect("linked");
        write_bytes_atomically(&path("link"), b"new").expect("written");
        assert!(path("link").is_symlink());
        assert_eq!(std::fs::read(path("file")).expect("read"), b"new");
        symlink("later", path("ahead")).expect("linked");
        write_bytes_atomically(&path("ahead"), b"new").expect("written");
        assert!(path("ahead").is_symlink() && path("later").is_file());
        symlink("/dev/null", path("null")).expect("linked");
        write_bytes_atomically(&path("null"), b"new").expect("nobody minds");
        assert!(path("null").is_symlink() && is_stream(Path::new("/dev/null")));
    }
}
