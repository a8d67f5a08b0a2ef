//! Signals to a process. This test starts itself as the process that is signalled.
#![cfg(unix)]

use std::io::{BufRead, BufReader};
use std::process::{Child, ChildStdout, Command, Stdio};
use std::time::Duration;

use heliostat_service::EndArgs;

/// Set in the process that is signalled.
const CHILD: &str = "HELIOSTAT_SIGNALLED";

/// Not a test by itself: waits for the request to end, and then for longer than the parent does.
#[test]
fn child() {
    if std::env::var_os(CHILD).is_none() {
        return;
    }
    let stop = EndArgs { exit_with_parent: true, ..EndArgs::default() }.stop().expect("the first handler");
    println!("\nready");
    while !stop.wait_for(Duration::from_secs(60)) {}
    println!("\nending");
    std::thread::sleep(Duration::from_secs(60));
}

struct Signalled {
    child: Child,
    lines: std::io::Lines<BufReader<ChildStdout>>,
}

impl Signalled {
    fn start() -> Self {
        let mut child = Command::new(std::env::current_exe().expect("a test has a file"))
            .args(["--exact", "signals::child", "--nocapture"])
            .env(CHILD, "1")
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
