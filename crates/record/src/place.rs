//! The place of a recording: whether its path still leads to the file that is being written.

use std::fs;
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};

use heliostat_service::file_id::{FileId, file_id};

use crate::file::RecordingError;

/// A path, and the file to which it led when the recording began.
#[derive(Debug)]
pub(crate) struct Place {
    path: PathBuf,
    /// Unknown where the path could not be read.
    file: Option<FileId>,
}

impl Place {
    /// The place of a file that was just created.
    pub fn new(path: PathBuf) -> Self {
        Self { file: identify(&path).ok(), path }
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Notes that this process gave the file another path.
    pub fn rename(&mut self, path: PathBuf) {
        self.path = path;
    }

    /// Whether the path leads to the file. A path that cannot be read at present shows no loss.
    pub fn has_file(&self) -> bool {
        match identify(&self.path) {
            Ok(found) => self.file.is_none_or(|file| file == found),
            Err(error) => !matches!(error.kind(), ErrorKind::NotFound | ErrorKind::NotADirectory),
        }
    }

    /// Checks that the path leads to the file.
    ///
    /// # Errors
    /// [`RecordingError::Gone`].
    pub fn check(&self) -> Result<(), RecordingError> {
        if self.has_file() { Ok(()) } else { Err(RecordingError::Gone(self.path.display().to_string())) }
    }
}

fn identify(path: &Path) -> io::Result<FileId> {
    fs::metadata(path).map(|found| file_id(&found))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_that_is_deleted_or_moved_with_its_folder_is_gone() {
        let folder = tempfile::tempdir().expect("a folder");
        let (before, after) = (folder.path().join("before"), folder.path().join("after"));
        fs::create_dir(&before).expect("a folder");
        let path = before.join("room.mcap");
        fs::write(&path, "").expect("a file");
        let place = Place::new(path.clone());
        assert!(place.check().is_ok());
        fs::rename(&before, &after).expect("a moved folder");
        let gone = place.check().expect_err("it is gone").to_string();
        let expected = format!("the recording {} is gone: it was deleted or moved", path.display());
        assert!(gone.starts_with(&expected), "{gone}");
        fs::create_dir(&before).expect("a folder");
        fs::write(&path, "").expect("another file");
        assert_eq!(place.has_file(), cfg!(not(unix)), "another file of this name");
    }
}
