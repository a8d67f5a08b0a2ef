//! What a user can do about a file that could not be written.

use std::io::{Error, ErrorKind};

/// What to do about an error of a write, for its message: free some space on a full disk, leave one that is read-only,
/// else `usual`.
///
/// ```
/// use heliostat_files::write_advice;
/// use std::io::ErrorKind;
///
/// let usual = "expected a folder that this user may write";
/// assert_eq!(write_advice(&ErrorKind::PermissionDenied.into(), usual), usual);
/// assert_eq!(write_advice(&ErrorKind::StorageFull.into(), usual), "free some space, or choose another disk");
/// assert!(write_advice(&ErrorKind::ReadOnlyFilesystem.into(), usual).starts_with("expected a disk that"));
/// ```
pub fn write_advice<'a>(error: &Error, usual: &'a str) -> &'a str {
    match error.kind() {
        ErrorKind::StorageFull | ErrorKind::QuotaExceeded => "free some space, or choose another disk",
        ErrorKind::ReadOnlyFilesystem => "expected a disk that can be written: mount it so, or choose another one",
        _ => usual,
    }
}
