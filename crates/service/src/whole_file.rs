//! Files that a command writes after its work: complete, or not at all.

use std::fs::{self, File};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};

/// Refuses a file that cannot be written, before the work starts. It changes nothing: the file does
/// not appear, and existing content stays. Others may check the same file at the same time.
///
/// # Errors
/// A folder that does not exist, or a file that this user cannot write.
pub fn check_writable(file: &Path) -> Result<()> {
    let refused = || format!("cannot write {}: expected a file in a folder that exists", file.display());
    if file.exists() {
        return File::options().append(true).open(file).map(drop).with_context(refused);
    }
    let folder = file.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    tempfile::tempfile_in(folder).map(drop).with_context(refused)
}

/// Writes a file beside the final one and renames it. A pipe or device is written directly.
///
/// # Errors
/// A file that cannot be written, by name.
pub fn write(file: &Path, contents: &[u8]) -> Result<()> {
    let refused = || format!("cannot write {}", file.display());
    if file.exists() && !file.is_file() {
        return fs::write(file, contents).with_context(refused);
    }
    let part = part_of(file);
    let written = fs::write(&part, contents).and_then(|()| fs::rename(&part, file));
    if written.is_err() {
        drop(fs::remove_file(&part));
    }
    written.with_context(refused)
}

fn part_of(file: &Path) -> PathBuf {
    let mut name = file.file_name().unwrap_or_default().to_owned();
    name.push(".part");
    file.with_file_name(name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_check_changes_nothing_and_the_file_is_replaced_at_once() {
        let folder = tempfile::tempdir().expect("a folder");
        let file = folder.path().join("figures.csv");
        let names = || fs::read_dir(folder.path()).expect("a folder").count();
        check_writable(&file).expect("writable");
        assert_eq!(names(), 0);
        for text in ["first", "second"] {
            write(&file, text.as_bytes()).expect("written");
            check_writable(&file).expect("writable");
            assert_eq!((fs::read_to_string(&file).expect("the file").as_str(), names()), (text, 1));
        }
        let refusal = check_writable(&folder.path().join("no/figures.csv")).expect_err("no folder");
        assert!(format!("{refusal:#}").contains("no/figures.csv: expected a file in a folder that exists"));
    }

    #[test]
    fn several_can_check_the_same_file() {
        let folder = tempfile::tempdir().expect("a folder");
        let file = folder.path().join("figures.csv");
        std::thread::scope(|scope| {
            for _ in 0..4 {
                scope.spawn(|| (0..1000).for_each(|_| check_writable(&file).expect("writable")));
            }
        });
        assert_eq!(fs::read_dir(folder.path()).expect("a folder").count(), 0);
    }
}
