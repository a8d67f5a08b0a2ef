//! Signals to a process. This test starts itself as the process that is signalled.
#![cfg(unix)]

use std::io::{BufRead, BufReader};
use std::path::PathBuf;
use std::process::{Child, ChildStdout, Command, Stdio};
use std::time::{Duration, Instant};

use heliostat_service::EndArgs;
use heliostat_service::signals::{end_on_signals, restore_in_children};

/// Set in the process that is signalled.
const CHILD: &str = "HELIOSTAT_SIGNALLED";

/// The value of this variable where the process ends at the first signal, with a note.
const NOTES: &str = "notes";

/// The value of this variable where the process starts another one, which shows its signals.
const STARTS: &str = "starts";

/// Not a test by itself: waits for the request to end, and then for longer than the parent does.
#[test]
fn child() {
    let Some(kind) = std::env::var_os(CHILD) else { return };
    if kind == STARTS {
        restore_in_children();
        let shown = Command::new("cat").arg("/proc/self/status").status();
        return assert!(shown.expect("cat starts").success());
    }
    if kind == NOTES {
        // More than a pipe holds.
        end_on_signals("child", || "x".repeat(1 << 20)).expect("the first handler");
        println!("\nready");
        return std::thread::sleep(Duration::from_secs(60));
    }
    let stop = EndArgs { exit_with_parent: true, ..EndArgs::default() }.stop().expect("the first handler");
    println!("\nready");
    while !stop.wait_for(Duration::from_secs(60)) {}
    println!("\nending");
    std::thread::sleep(Duration::from_secs(60));
}

fn own_file() -> PathBuf {
    std::env::current_exe().expect("a test has a file")
}

struct Signalled {
    child: Child,
    lines: std::io::Lines<BufReader<ChildStdout>>,
}

impl Signalled {
    fn start() -> Self {
        Self::start_by(&mut Command::new(own_file()), "stops")
    }

    /// The process that this command starts, with further arguments.
    fn start_by(command: &mut Command, kind: &str) -> Self {
        restore_in_children();
        let mut child = command
            .args(["--exact", "signals::child", "--nocapture"])
            .env(CHILD, kind)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .expect("the test starts itself");
        let lines = BufReader::new(child.stdout.take().expect("piped")).lines();
        let mut signalled = Self { child, lines };
        signalled.await_line("ready");
        signalled
    }

    fn await_line(&mut self, expected: &str) {
        let found = self.lines.by_ref().map_while(Result::ok).any(|line| line == expected);
        assert!(found, "the process ended without \"{expected}\"");
    }

    fn send(&self, signal: &str) {
        let sent = Command::new("kill").args([signal, &self.child.id().to_string()]).status();
        assert!(sent.expect("kill starts").success());
    }
}

#[test]
fn the_first_signal_requests_the_end_and_the_second_exits_with_130() {
    for [first, second] in [["-INT", "-INT"], ["-TERM", "-INT"]] {
        let mut signalled = Signalled::start();
        signalled.send(first);
        signalled.await_line("ending");
        signalled.send(second);
        let status = signalled.child.wait().expect("waited for");
        assert_eq!(status.code(), Some(130), "{status}");
    }
}

#[test]
fn the_end_of_standard_input_requests_the_end() {
    let mut signalled = Signalled::start();
    drop(signalled.child.stdin.take());
    signalled.await_line("ending");
    // A first signal is never the second, whatever requested the end before.
    signalled.send("-INT");
    std::thread::sleep(Duration::from_millis(200));
    assert!(signalled.child.try_wait().expect("waited for").is_none(), "one signal ended the process");
    signalled.send("-INT");
    assert_eq!(signalled.child.wait().expect("waited for").code(), Some(130));
}

#[test]
fn the_second_signal_ends_a_note_without_a_reader() {
    let mut signalled = Signalled::start_by(Command::new(own_file()).stderr(Stdio::piped()), NOTES);
    signalled.send("-TERM");
    signalled.send("-INT");
    let sent = Instant::now();
    let status = loop {
        if let Some(status) = signalled.child.try_wait().expect("waited for") {
            break status;
        }
        assert!(sent.elapsed() < Duration::from_secs(30), "the first signal waits for a reader");
        std::thread::sleep(Duration::from_millis(5));
    };
    assert_eq!(status.code(), Some(130), "{status}");
}

/// Whether a mask of signals in the status of a process contains a signal.
#[cfg(target_os = "linux")]
fn has(status: &str, mask: &str, signal: u32) -> bool {
    let line = status.lines().find_map(|line| line.strip_prefix(mask)).expect("Linux has this mask");
    (u64::from_str_radix(line.trim(), 16).expect("a mask") >> (signal - 1)) & 1 == 1
}

/// Whether a process ignores SIGHUP and handles SIGTERM.
#[cfg(target_os = "linux")]
fn ignores_a_logout(process: &Child) -> bool {
    let status = std::fs::read_to_string(format!("/proc/{}/status", process.id())).expect("it runs");
    has(&status, "SigIgn:", 1) && has(&status, "SigCgt:", 15)
}

#[cfg(target_os = "linux")]
#[test]
fn a_signal_that_the_process_was_started_to_ignore_stays_ignored() {
    let mut by_nohup = Signalled::start_by(Command::new("nohup").arg(own_file()), "stops");
    assert!(ignores_a_logout(&by_nohup.child));
    by_nohup.child.kill().expect("it runs");
    by_nohup.child.wait().expect("waited for");
}

#[cfg(target_os = "linux")]
#[test]
fn a_test_in_a_background_script_starts_processes_that_can_be_interrupted() {
    // So does a shell without job control for a command in the background.
    let script = r#"trap "" INT; exec "$0" "$@""#;
    let mut command = Command::new("sh");
    command.args(["-c", script]).arg(own_file()).args(["--exact", "signals::child", "--nocapture"]).env(CHILD, STARTS);
    let output = command.output().expect("sh starts");
    let status = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success() && !has(&status, "SigIgn:", 2), "{status}");
}
