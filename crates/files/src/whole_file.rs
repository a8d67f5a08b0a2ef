//! Files that are complete at any time.

use std::io;
use std::path::Path;

/// The folder of a file.
pub fn folder_of(file: &Path) -> &Path {
    file.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// Whether a path names a pipe or a device.
pub fn is_direct(file: &Path) -> bool {
    file.exists() && !file.is_file()
}

/// Has `write` write a new file beside the final one, and renames it. Its name is random: another user of the folder
/// cannot have placed a link there. A pipe or device is written directly.
///
/// # Errors
/// Those of `write` and of the operating system; the former file then stays.
pub fn write_whole(file: &Path, write: impl FnOnce(&Path) -> io::Result<()>) -> io::Result<()> {
    if is_direct(file) {
        return write(file);
    }
    let mut part = tempfile::Builder::new();
    part.prefix(file.file_name().unwrap_or_default()).suffix(".part");
    // As of every new file: the umask of the process applies.
    #[cfg(unix)]
    part.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    let part = part.tempfile_in(folder_of(file))?;
    write(part.path())?;
    part.persist(file).map(drop).map_err(|error| error.error)
}
