//! Each program looks at its limit of open files between its command line and its command.

use std::process::{Command, Output};

/// The program with these arguments below a limit of the shell.
fn limited(limit: &str, arguments: &str) -> Output {
    let script = format!("ulimit {limit} && exec \"$0\" {arguments}");
    Command::new("sh").args(["-c", &script, env!("CARGO_BIN_EXE_heliostat")]).output().expect("a shell starts")
}

#[test]
fn a_low_limit_of_open_files_is_raised_and_one_that_cannot_be_is_refused() {
    let ended = limited("-S -n 30", "scenario check hall");
    assert!(ended.status.success(), "{}", String::from_utf8_lossy(&ended.stderr));
    let ended = limited("-n 30", "scenario check hall --json");
    let errors = String::from_utf8_lossy(&ended.stderr);
    assert!(errors.contains("30 open files are allowed: expected at least 64; raise the limit"), "{errors}");
    assert_eq!(ended.status.code(), Some(1));
    let object: serde_json::Value = serde_json::from_slice(&ended.stdout).expect("one object");
    let error = object["error"].as_str().expect("an error");
    assert!(error.starts_with("30 open files are allowed"), "{error}");
}

#[test]
fn a_low_limit_of_open_files_refuses_neither_help_nor_version() {
    for arguments in ["--help", "--version", "stop --help"] {
        let ended = limited("-n 30", arguments);
        assert!(ended.status.success(), "{arguments}: {}", String::from_utf8_lossy(&ended.stderr));
    }
}
