//! What the operating system reports about this process and its machine, and allows it.

use std::ffi::OsStr;

/// Memory, files and threads of this process.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Usage {
    /// Resident memory in bytes.
    pub resident_bytes: u64,
    /// Open file descriptors.
    pub files: u64,
    /// Threads.
    pub threads: u64,
}

/// The present usage; `None` where the operating system has no `/proc`, as outside Linux.
pub fn usage() -> Option<Usage> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let field = |name: &str| {
        let line = status.lines().find_map(|line| line.strip_prefix(name))?;
        line.split_whitespace().next()?.parse::<u64>().ok()
    };
    // The listing itself is one open file.
    let files = std::fs::read_dir("/proc/self/fd").ok()?.count().saturating_sub(1) as u64;
    Some(Usage { resident_bytes: field("VmRSS:")? * 1024, files, threads: field("Threads:")? })
}

/// Raises a low limit of open files as far as this user may.
///
/// # Errors
/// Too few files for a session on the bus, whose library would panic, with what to do.
#[cfg(unix)]
pub fn allow_files() -> anyhow::Result<()> {
    use nix::sys::resource::{Resource, getrlimit, rlim_t, setrlimit};

    /// What a process opens at its start: a session with its threads, a page and a log.
    const LEAST: rlim_t = 64;
    /// Enough for the connections of a page and of a room with many processes.
    const WANTED: rlim_t = 4096;

    let files = Resource::RLIMIT_NOFILE;
    let Ok((soft, hard)) = getrlimit(files) else { return Ok(()) };
    let wanted = hard.min(WANTED);
    let is_raised = soft < wanted && setrlimit(files, wanted, hard).is_ok();
    let allowed = if is_raised { wanted } else { soft };
    anyhow::ensure!(
        allowed >= LEAST,
        "{allowed} open files are allowed: expected at least {LEAST}; raise the limit, for example by ulimit -n {WANTED}"
    );
    Ok(())
}

/// Nothing limits the open files.
#[cfg(not(unix))]
pub fn allow_files() -> anyhow::Result<()> {
    Ok(())
}

/// The name of this machine; `None` if it has none that is text.
pub fn machine_name() -> Option<String> {
    gethostname::gethostname().into_string().ok()
}

/// The file of this program, and the version that all programs have in common: the first line of a log.
pub fn program_and_version() -> String {
    let file = std::env::current_exe().unwrap_or_default();
    let name = file.file_stem().map_or("heliostat".into(), OsStr::to_string_lossy);
    format!("{name} {}", env!("CARGO_PKG_VERSION"))
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;

    #[test]
    fn the_first_line_names_the_file_of_the_program_and_a_version() {
        let line = program_and_version();
        let (name, version) = line.split_once(' ').expect("two words");
        assert!(name.starts_with("heliostat_service"), "the file of this test: {line}");
        assert_eq!(version, env!("CARGO_PKG_VERSION"));
    }

    #[test]
    fn memory_that_is_written_to_is_resident_and_open_files_count() {
        let before = usage().expect("Linux has /proc");
        let block = std::hint::black_box(vec![1_u8; 64 << 20]);
        // More files than the other tests of this process close meanwhile.
        let files = [(); 64].map(|()| std::fs::File::open("/proc/self/status").expect("it exists"));
        let after = usage().expect("Linux has /proc");
        assert!(after.resident_bytes >= before.resident_bytes + (60 << 20), "{before:?} {after:?}");
        assert!(after.files > before.files + 32 && after.threads >= 1, "{before:?} {after:?}");
        drop((block, files));
    }
}
