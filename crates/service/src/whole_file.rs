//! Files that a command writes after its work: complete, or not at all.

use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use heliostat_files::{folder_of, is_direct, write_advice, write_whole};
use thiserror::Error;

use crate::exit::{UnusableInput, unusable};
use crate::file_id::file_id;
use crate::output::note;

/// ENOLCK and EOPNOTSUPP of Linux, else of macOS and BSD: the first one, as of NFS without its daemon for locks, has
/// no kind of its own in the standard library.
const NO_LOCKS: [i32; 2] = if cfg!(target_os = "linux") { [37, 95] } else { [77, 45] };

/// What a file to write has to be.
const EXPECTED: &str = "expected a file in a folder that exists";

/// What a file to create has to be, by the error of its creation.
pub fn expected_new(error: &io::Error) -> &'static str {
    match error.kind() {
        io::ErrorKind::AlreadyExists => "expected a file that does not exist yet",
        _ => EXPECTED,
    }
}

/// Attempts to hold a file whose holders end meanwhile; bounded, because some file systems change the numbers of files.
const HOLD_TRIES: usize = 100;

/// Refuses a file that cannot be written, before the work starts. It changes nothing: the file does
/// not appear, and existing content stays. Others may check the same file at the same time.
///
/// # Errors
/// [`UnusableInput`] for a folder that does not exist, a file that this user cannot write, or `-`.
pub fn check_writable(file: &Path) -> Result<()> {
    if file == Path::new("-") {
        bail!(UnusableInput::new("cannot write -: expected a file; /dev/stdout is standard output"));
    }
    let refused = |error| unusable(unwritable(file, error, EXPECTED));
    // To open a pipe is to wait for its reader, and to close it ends the work of that reader.
    if is_pipe(file) {
        return Ok(());
    }
    if file.exists() {
        return File::options().append(true).open(file).map(drop).map_err(refused);
    }
    tempfile::tempfile_in(folder_of(file)).map(drop).map_err(refused)
}

/// Whether a path names a pipe.
#[cfg(unix)]
fn is_pipe(file: &Path) -> bool {
    fs::metadata(file).is_ok_and(|found| std::os::unix::fs::FileTypeExt::is_fifo(&found.file_type()))
}

/// Whether a path names a pipe.
#[cfg(not(unix))]
fn is_pipe(_file: &Path) -> bool {
    false
}

/// The error of a file that is not written, with its name and what to do.
fn unwritable(file: &Path, error: io::Error, expected: &str) -> anyhow::Error {
    let advice = write_advice(&error, expected);
    anyhow::Error::new(error).context(format!("cannot write {}: {advice}", file.display()))
}

/// As [`check_writable`], for a file that other commands read: it refuses one that exists. A pipe or device may exist.
///
/// # Errors
/// [`UnusableInput`] for a file that exists, or as of [`check_writable`].
pub fn check_new(file: &Path) -> Result<()> {
    let exists = || {
        UnusableInput::new(format!(
            "{} exists already: expected a new file; name another one, or delete it",
            file.display()
        ))
    };
    ensure!(!file.is_file(), exists());
    check_writable(file)
}

/// Refuses one file for two flags: the later one would replace the former. A pipe or device may serve several.
///
/// # Errors
/// [`UnusableInput`], which names both flags.
pub fn check_distinct<'a>(named: impl IntoIterator<Item = (&'a str, Option<&'a PathBuf>)>) -> Result<()> {
    let is_replaced = |file: &&PathBuf| !is_direct(file);
    let named = named.into_iter().filter_map(|(flag, file)| Some((flag, absolute(file.filter(is_replaced)?)?)));
    let named: Vec<_> = named.collect();
    for (index, (flag, file)) in named.iter().enumerate() {
        if let Some((other, _)) = named[..index].iter().find(|(_, other)| other == file) {
            bail!(UnusableInput::new(format!("{other} and {flag} name one file, {}: expected two", file.display())));
        }
    }
    Ok(())
}

/// The path without links, whether or not the file exists.
fn absolute(file: &Path) -> Option<PathBuf> {
    let path = std::path::absolute(file).ok()?;
    let in_folder = || Some(path.parent()?.canonicalize().ok()?.join(path.file_name()?));
    let beyond_links = path.canonicalize().ok().or_else(in_folder);
    Some(beyond_links.unwrap_or(path))
}

/// Writes a file as [`write_whole`] does.
///
/// # Errors
/// A file that cannot be written, by name.
pub fn write(file: &Path, contents: &[u8]) -> Result<()> {
    write_whole(file, |part| fs::write(part, contents)).map_err(|error| unwritable(file, error, EXPECTED))
}

/// Writes a file that does not exist yet.
///
/// # Errors
/// A file that exists or cannot be written, by name. Nothing is left of what was begun.
pub fn write_new(file: &Path, contents: &[u8]) -> Result<()> {
    write_opened(file, File::options().write(true).create_new(true), contents)
}

/// As [`write_new`], for a secret: only its owner may read and write the file. On Windows it has the permissions of
/// its folder.
///
/// # Errors
/// As of [`write_new`].
pub fn write_new_secret(file: &Path, contents: &[u8]) -> Result<()> {
    let mut options = File::options();
    options.write(true).create_new(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
    write_opened(file, &options, contents)
}

/// Writes a new file that these options open.
fn write_opened(file: &Path, options: &OpenOptions, contents: &[u8]) -> Result<()> {
    let refused = |error: io::Error| {
        let expected = expected_new(&error);
        unwritable(file, error, expected)
    };
    let mut begun = options.open(file).map_err(refused)?;
    // Some file systems report only then that they are full.
    let written = begun.write_all(contents).and_then(|()| begun.sync_all());
    drop(begun);
    complete(file, written).map_err(refused)
}

/// The result of writing a file that this process has begun; what cannot be completed is removed.
fn complete(begun: &Path, written: io::Result<()>) -> io::Result<()> {
    if written.is_err() {
        drop(fs::remove_file(begun));
    }
    written
}

/// A file that one process holds: another one that asks for it is refused until this value is dropped. Where the file
/// system has no locks, as some network file systems, a warning takes the place of the refusal.
#[derive(Debug)]
pub struct Held {
    /// The lock is of a file beside the held one, which each [`write()`] replaces.
    lock: File,
    path: PathBuf,
}

impl Drop for Held {
    fn drop(&mut self) {
        // A file that stays, as after a kill, holds nothing.
        if is_named(&self.lock, &self.path) {
            drop(fs::remove_file(&self.path));
        }
    }
}

/// Another process holds a file.
#[derive(Debug, Error)]
#[error("{} is in use by another process: end it, or name another file", .0.display())]
pub struct InUse(PathBuf);

/// Holds a file that [`check_writable`] accepts, whether or not it exists.
///
/// # Errors
/// [`InUse`], or a folder that takes no further file.
pub fn hold(file: &Path) -> Result<Held> {
    let path = beside(file, ".lock");
    let refused = || format!("cannot hold {}", file.display());
    let mut tries = 0..HOLD_TRIES;
    loop {
        // For reading too: a pipe of this name makes no process wait for its reader.
        let mut options = File::options();
        let lock = options.create(true).truncate(false).read(true).write(true).open(&path).with_context(refused)?;
        let cause = unlocked(lock.try_lock(), file)?;
        // A holder that ended meanwhile has removed the file: the lock would hold nothing.
        if !is_named(&lock, &path) && tries.next().is_some() {
            continue;
        }
        if let Some(cause) = cause {
            note(format_args!("cannot lock {}: {cause}. No other process must write it meanwhile", file.display()));
        }
        return Ok(Held { lock, path });
    }
}

/// Whether a path still names an open file.
fn is_named(open: &File, path: &Path) -> bool {
    let id = |found: io::Result<fs::Metadata>| found.ok().map(|found| file_id(&found));
    id(open.metadata()) == id(fs::metadata(path))
}

/// Why there is no lock, where the file system has none; `None` with a lock.
///
/// # Errors
/// A lock that another process has, or that fails on a file system with locks.
fn unlocked(locked: Result<(), TryLockError>, file: &Path) -> Result<Option<io::Error>> {
    match locked {
        Ok(()) => Ok(None),
        Err(TryLockError::WouldBlock) => bail!(InUse(file.to_owned())),
        Err(TryLockError::Error(error)) if is_without_locks(&error) => Ok(Some(error)),
        Err(TryLockError::Error(error)) => Err(error).with_context(|| {
            format!(
                "cannot lock {}: expected a lock, or a file system without locks; name a file in another folder",
                file.display()
            )
        }),
    }
}

/// Whether a lock fails because the file system has none.
fn is_without_locks(error: &io::Error) -> bool {
    let is_named = cfg!(unix) && error.raw_os_error().is_some_and(|number| NO_LOCKS.contains(&number));
    is_named || matches!(error.kind(), io::ErrorKind::Unsupported | io::ErrorKind::InvalidInput)
}

fn beside(file: &Path, suffix: &str) -> PathBuf {
    let mut name = file.file_name().unwrap_or_default().to_owned();
    name.push(suffix);
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
        let refusal = check_writable(Path::new("-")).expect_err("no file").to_string();
        assert!(refusal.contains("/dev/stdout is standard output"), "{refusal}");
        let refusal = check_writable(&folder.path().join("no/figures.csv")).expect_err("no folder");
        assert!(format!("{refusal:#}").contains("no/figures.csv: expected a file in a folder that exists"));
    }

    #[cfg(unix)]
    #[test]
    fn a_link_beside_the_file_redirects_nothing_and_the_file_has_the_mode_of_a_new_one() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().expect("a folder");
        let (file, other) = (folder.path().join("figures.csv"), folder.path().join("other"));
        fs::write(&other, "own").expect("written");
        std::os::unix::fs::symlink(&other, folder.path().join("figures.csv.part")).expect("a link");
        write(&file, b"figures").expect("written");
        assert_eq!(fs::read_to_string(&other).expect("the file"), "own");
        assert_eq!(fs::read_to_string(&file).expect("the file"), "figures");
        let mode = |path: &Path| fs::metadata(path).expect("the file").permissions().mode() & 0o777;
        assert_eq!(mode(&file), mode(&other));
    }

    #[test]
    fn a_new_file_is_refused_where_one_exists_and_that_one_stays() {
        let folder = tempfile::tempdir().expect("a folder");
        let file = folder.path().join("walk.csv");
        check_new(&file).expect("no file yet");
        fs::write(&file, "first").expect("written");
        let refusal = check_new(&file).expect_err("a file").to_string();
        assert!(
            refusal.ends_with("walk.csv exists already: expected a new file; name another one, or delete it"),
            "{refusal}"
        );
        assert_eq!(fs::read_to_string(&file).expect("the file"), "first");
        if cfg!(unix) {
            check_new(Path::new("/dev/null")).expect("a device");
        }
    }

    #[test]
    fn a_new_file_that_cannot_be_completed_is_removed_and_one_that_exists_stays() {
        let folder = tempfile::tempdir().expect("a folder");
        let file = folder.path().join("room.toml");
        write_new(&file, b"first").expect("written");
        let refusal = write_new(&file, b"second").expect_err("a file").to_string();
        assert!(refusal.ends_with("room.toml: expected a file that does not exist yet"), "{refusal}");
        let elsewhere = write_new(&folder.path().join("no/room.toml"), b"first").expect_err("no folder").to_string();
        assert!(elsewhere.ends_with("room.toml: expected a file in a folder that exists"), "{elsewhere}");
        assert_eq!(fs::read_to_string(&file).expect("the file"), "first");
        complete(&file, Ok(())).expect("complete");
        assert!(file.exists());
        let full = complete(&file, Err(io::ErrorKind::StorageFull.into())).expect_err("full");
        assert!(!file.exists());
        let refusal = unwritable(&file, full, EXPECTED).to_string();
        assert!(refusal.ends_with("room.toml: free some space, or choose another disk"), "{refusal}");
    }

    #[cfg(unix)]
    #[test]
    fn a_new_secret_is_for_its_owner_only() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().expect("a folder");
        let file = folder.path().join("token");
        write_new_secret(&file, b"secret").expect("written");
        assert_eq!(fs::read_to_string(&file).expect("the file"), "secret");
        assert_eq!(fs::metadata(&file).expect("the file").permissions().mode() & 0o777, 0o600);
        let refusal = write_new_secret(&file, b"other").expect_err("a file").to_string();
        assert!(refusal.contains("expected a file that does not exist yet"), "{refusal}");
    }

    #[test]
    fn a_file_is_held_once_while_it_is_replaced_and_until_the_holder_ends() {
        let folder = tempfile::tempdir().expect("a folder");
        let file = folder.path().join("readings.json");
        let held = hold(&file).expect("free");
        write(&file, b"first").expect("written");
        let refusal = hold(&file).expect_err("held").to_string();
        assert!(refusal.ends_with("readings.json is in use by another process: end it, or name another file"));
        hold(&file.with_file_name("others.json")).expect("another file");
        drop(held);
        drop(hold(&file).expect("free again"));
        assert_eq!(fs::read_dir(folder.path()).expect("a folder").count(), 1, "the file alone");
    }

    /// What work with a pipe gives that has no reader: work that waits for one fails.
    #[cfg(unix)]
    fn with_unread_pipe<T: Send + 'static>(at: &Path, work: impl FnOnce() -> T + Send + 'static) -> T {
        let made = std::process::Command::new("mkfifo").arg(at).status().expect("mkfifo runs");
        assert!(made.success(), "mkfifo {}", at.display());
        let (sender, result) = std::sync::mpsc::channel();
        std::thread::spawn(move || drop(sender.send(work())));
        result.recv_timeout(std::time::Duration::from_secs(60)).expect("no wait for a reader")
    }

    #[cfg(unix)]
    #[test]
    fn the_check_of_a_pipe_waits_for_no_reader_and_its_reader_gets_the_text() {
        let folder = tempfile::tempdir().expect("a folder");
        let pipe = folder.path().join("pipe");
        let file = pipe.clone();
        with_unread_pipe(&pipe, move || check_writable(&file)).expect("writable");
        let file = pipe.clone();
        let reader = std::thread::spawn(move || fs::read_to_string(file).expect("text"));
        check_writable(&pipe).expect("writable");
        write(&pipe, b"figures").expect("written");
        assert_eq!(reader.join().expect("a text"), "figures");
    }

    #[cfg(unix)]
    #[test]
    fn a_pipe_in_place_of_a_lock_makes_no_process_wait() {
        let folder = tempfile::tempdir().expect("a folder");
        let file = folder.path().join("readings.json");
        let named = file.clone();
        let held = with_unread_pipe(&beside(&file, ".lock"), move || hold(&named)).expect("free");
        assert!(hold(&file).is_err(), "held");
        drop(held);
    }

    #[cfg(unix)]
    #[test]
    fn a_lock_whose_file_was_removed_and_made_again_holds_nothing() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("readings.json.lock");
        let lock = File::create(&path).expect("a file");
        assert!(is_named(&lock, &path));
        fs::remove_file(&path).expect("removed");
        assert!(!is_named(&lock, &path));
        let _again = File::create(&path).expect("a file");
        assert!(!is_named(&lock, &path));
    }

    #[test]
    fn a_file_system_without_locks_holds_nothing_and_refuses_nothing() {
        let file = Path::new("readings.json");
        let failed = |error: io::Error| unlocked(Err(TryLockError::Error(error)), file);
        let without: [io::Error; 2] = [io::ErrorKind::Unsupported.into(), io::ErrorKind::InvalidInput.into()];
        let of_unix = NO_LOCKS.into_iter().filter(|_| cfg!(unix)).map(io::Error::from_raw_os_error);
        for error in without.into_iter().chain(of_unix) {
            assert!(failed(error).expect("the work goes on").is_some());
        }
        for kind in [io::ErrorKind::PermissionDenied, io::ErrorKind::Interrupted, io::ErrorKind::Other] {
            let refusal = failed(kind.into()).expect_err("refused");
            assert!(refusal.to_string().contains("cannot lock readings.json: expected a lock"), "{refusal}");
        }
        assert!(unlocked(Ok(()), file).expect("locked").is_none());
        assert!(unlocked(Err(TryLockError::WouldBlock), file).is_err());
    }

    #[test]
    fn one_file_for_two_flags_is_refused_and_one_device_is_not() {
        let folder = tempfile::tempdir().expect("a folder");
        let one = |file: PathBuf| check_distinct(["--csv", "--html"].map(|flag| (flag, Some(&file))));
        let refusal = one(folder.path().join("figures")).expect_err("one file").to_string();
        assert!(refusal.starts_with("--csv and --html name one file"), "{refusal}");
        if cfg!(unix) {
            one(PathBuf::from("/dev/null")).expect("a device");
        }
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
