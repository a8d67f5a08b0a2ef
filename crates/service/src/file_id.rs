//! Which file a path leads to: that it is still the one of before.

use std::fs::Metadata;

/// Device and number of a file.
#[cfg(unix)]
pub type FileId = (u64, u64);

/// That there is a file: the standard library tells nothing more of it.
#[cfg(not(unix))]
pub type FileId = ();

/// The id of the file with this metadata.
#[cfg(unix)]
pub fn file_id(found: &Metadata) -> FileId {
    use std::os::unix::fs::MetadataExt;
    (found.dev(), found.ino())
}

/// The id of the file with this metadata.
#[cfg(not(unix))]
pub fn file_id(_found: &Metadata) -> FileId {}
