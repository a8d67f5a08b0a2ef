//! What a command reports where its standard output cannot be written.

use std::fs::OpenOptions;
use std::process::{Command, Output};

#[test]
fn an_output_that_cannot_be_written_is_named() {
    for command in [
        &["scenario", "check", "hall"][..],
        &["completions", "bash"],
        &["--help"],
        &["--version"],
        &["scenario", "check", "--help"],
        &["link", "--user", "1,1", "--json"],
    ] {
        let full = OpenOptions::new().write(true).open("/dev/full").expect("a device of Linux");
        let ended = Command::new(env!("CARGO_BIN_EXE_heliostat")).args(command).stdout(full).output();
        let ended = ended.expect("the program starts");
        let errors = String::from_utf8_lossy(&ended.stderr);
        assert!(errors.contains("cannot write to standard output: No space left on device"), "{command:?}: {errors}");
        assert_eq!(ended.status.code(), Some(1), "{command:?}");
    }
}

/// The result of a command whose standard output nothing reads.
fn unread(command: &[&str]) -> Output {
    let (reader, writer) = std::io::pipe().expect("a pipe");
    drop(reader);
    let ended = Command::new(env!("CARGO_BIN_EXE_heliostat")).args(command).stdout(writer).output();
    ended.expect("the program starts")
}

#[test]
fn a_closed_reader_of_the_help_is_no_failure() {
    let ended = unread(&["--help"]);
    assert!(ended.status.success() && ended.stderr.is_empty(), "{ended:?}");
}

/// As of `heliostat status | head -1` in a script with `pipefail`.
#[test]
fn a_closed_reader_hides_no_problem() {
    for command in [
        &["scenario", "check", "absent.toml", "--json"][..],
        &["doctor", "--scenario", "absent.toml"],
        &["doctor", "--scenario", "absent.toml", "--json"],
    ] {
        let ended = unread(command);
        assert_eq!(ended.status.code(), Some(1), "{command:?}: {ended:?}");
        assert!(String::from_utf8_lossy(&ended.stderr).starts_with("heliostat: "), "{command:?}: {ended:?}");
    }
}
