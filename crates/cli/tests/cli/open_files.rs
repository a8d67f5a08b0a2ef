//! Each program looks at its limit of open files before its command begins.

use std::process::{Command, Output};

/// The program below a limit of the shell.
fn limited(limit: &str) -> Output {
    let script = format!("ulimit {limit} && exec \"$0\" scenario check hall");
    Command::new("sh").args(["-c", &script, env!("CARGO_BIN_EXE_heliostat")]).output().expect("a shell starts")
}

#[test]
fn a_low_limit_of_open_files_is_raised_and_one_that_cannot_be_is_refused() {
    let ended = limited("-S -n 30");
    assert!(ended.status.success(), "{}", String::from_utf8_lossy(&ended.stderr));
    let ended = limited("-n 30");
    let errors = String::from_utf8_lossy(&ended.stderr);
    assert!(errors.contains("30 open files are allowed: expected at least 64; raise the limit"), "{errors}");
    assert_eq!(ended.status.code(), Some(1));
}
