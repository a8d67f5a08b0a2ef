//! The UTC clock of one process, shifted while it runs.

use std::fs::OpenOptions;
use std::io::Write;
use std::path::Path;
use std::process::Command;

use tempfile::TempDir;

/// Shifts the UTC clock of the processes that start with its [`SystemClock::variables`].
///
/// A small C library replaces `clock_gettime` in such a process; no other process sees the shift.
pub struct SystemClock {
    folder: TempDir,
}

impl SystemClock {
    /// Builds the library.
    ///
    /// # Panics
    /// When it does not compile.
    pub fn build() -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("data/shifted_clock.c");
        let library = folder.path().join("clock.so");
        let flags = ["-shared", "-fPIC", "-O1", "-Wall", "-Werror", "-o"];
        let built = Command::new("cc").args(flags).arg(library).arg(source).output().expect("cc runs");
        assert!(built.status.success(), "{}", String::from_utf8_lossy(&built.stderr));
        let clock = Self { folder };
        clock.shift(0);
        clock
    }

    /// Variables in the environment of the process.
    pub fn variables(&self) -> Vec<(String, String)> {
        let path = |name: &str| self.folder.path().join(name).display().to_string();
        vec![("LD_PRELOAD".to_owned(), path("clock.so")), ("SHIFTED_CLOCK".to_owned(), path("shift"))]
    }

    /// Sets the difference from the true time, in s.
    ///
    /// # Panics
    /// When the file of the shift cannot be written.
    pub fn shift(&self, seconds: i64) {
        // Without truncation: the processes read the file through a memory map.
        let file = OpenOptions::new().write(true).create(true).truncate(false).open(self.folder.path().join("shift"));
        let mut file = file.expect("a file can be created");
        file.write_all(&(seconds * 1_000_000_000).to_le_bytes()).expect("a file can be written");
    }
}

#[cfg(test)]
mod tests {
    use heliostat_needs::needs;

    use super::*;

    #[needs("cc")]
    #[test]
    fn the_clock_of_a_process_is_shifted_while_it_runs() {
        let clock = SystemClock::build();
        let now = || {
            let mut date = Command::new("date");
            let output = date.arg("+%s").envs(clock.variables()).output().unwrap();
            String::from_utf8(output.stdout).unwrap().trim().parse::<i64>().unwrap()
        };
        let before = now();
        clock.shift(3600);
        assert!((3600..3660).contains(&(now() - before)));
        clock.shift(-3600);
        assert!((-3600..-3540).contains(&(now() - before)));
    }
}
