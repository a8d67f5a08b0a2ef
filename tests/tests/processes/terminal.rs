//! The full-screen view in a pseudo-terminal: it leaves the terminal as it was.

use std::io::{Read, Write};
use std::net::TcpListener;
use std::process::{Child, Command, Stdio};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use heliostat_needs::needs;
use heliostat_tests::{programs, wait_until};

const TO_ALTERNATE_SCREEN: &str = "\u{1b}[?1049h";
const TO_MAIN_SCREEN: &str = "\u{1b}[?1049l";

/// Generous limit of the restoration, which may not wait for the close of the session: up to 10 s.
const RESTORE_LIMIT: Duration = Duration::from_secs(9);

/// `heliostat ui` and then `stty` in a pseudo-terminal.
struct Terminal {
    script: Child,
    output: Arc<Mutex<Vec<u8>>>,
    /// Accepts connections, and never answers.
    _silent: TcpListener,
}

impl Terminal {
    fn start() -> Self {
        let heliostat = programs().join("heliostat");
        let silent = TcpListener::bind(("127.0.0.1", 0)).expect("a free port");
        let endpoint = format!("tcp/{}", silent.local_addr().expect("bound"));
        let inner = format!("{} ui --no-ui --connect {endpoint}; stty -a", heliostat.display());
        let script = Command::new("script")
            .args(["-q", "-f", "-e", "-c", &format!("stty rows 24 cols 80; {inner}"), "/dev/null"])
            .env("SHELL", "/bin/sh")
            .env("HELIOSTAT_ZENOH", "transport/unicast/open_timeout=60000")
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn();
        let mut script = script.expect("script runs");
        let mut stdout = script.stdout.take().expect("piped");
        let output: Arc<Mutex<Vec<u8>>> = Arc::default();
        let kept = Arc::clone(&output);
        std::thread::spawn(move || {
            let mut bytes = [0; 4096];
            while let Ok(count @ 1..) = stdout.read(&mut bytes) {
                kept.lock().expect("no reader panics").extend(&bytes[..count]);
            }
        });
        Self { script, output, _silent: silent }
    }

    fn text(&self) -> String {
        String::from_utf8_lossy(&self.output.lock().expect("no reader panics")).into_owned()
    }

    fn type_key(&mut self, key: &[u8]) {
        let input = self.script.stdin.as_mut().expect("piped");
        input.write_all(key).and_then(|()| input.flush()).expect("script reads");
    }

    /// The id of `heliostat`: the grandchild of `script`.
    fn viewer(&self) -> String {
        let children = |parent: &str| {
            let found = Command::new("ps").args(["-o", "pid=", "--ppid", parent]).output().expect("ps runs");
            String::from_utf8_lossy(&found.stdout).split_whitespace().next().map(str::to_owned)
        };
        let shell = children(&self.script.id().to_string()).expect("a shell");
        children(&shell).expect("a viewer")
    }
}

impl Drop for Terminal {
    fn drop(&mut self) {
        // It may have ended already.
        let _ = self.script.kill();
        let _ = self.script.wait();
    }
}

#[needs("script")]
#[test]
fn the_terminal_is_restored_after_q_ctrl_c_and_sigterm() {
    type End = fn(&mut Terminal);
    let by_signal = |terminal: &mut Terminal| {
        let sent = Command::new("kill").args(["-TERM", &terminal.viewer()]).status();
        assert!(sent.expect("there is a kill command").success());
    };
    let ends: [(&str, End); 3] = [
        ("q", |terminal| terminal.type_key(b"q")),
        ("Ctrl-C", |terminal| terminal.type_key(b"\x03")),
        ("SIGTERM", by_signal),
    ];
    for (name, end) in ends {
        let mut terminal = Terminal::start();
        wait_until("the full-screen view", || terminal.text().contains("q quits"));
        assert!(terminal.text().contains(TO_ALTERNATE_SCREEN));
        end(&mut terminal);
        let asked = Instant::now();
        wait_until("the main screen", || terminal.text().contains(TO_MAIN_SCREEN));
        assert!(asked.elapsed() < RESTORE_LIMIT, "{name}: restored after {:?}", asked.elapsed());
        wait_until("the settings of the terminal", || terminal.text().contains("echoe"));
        let text = terminal.text();
        let (_, after) =
            text.rsplit_once(TO_MAIN_SCREEN).unwrap_or_else(|| panic!("{name}: the main screen is not restored"));
        assert!(!after.contains("q quits"), "{name}: drawn on the main screen");
        let is_set = |setting: &str| after.split_whitespace().any(|word| word.trim_end_matches(';') == setting);
        assert!(is_set("icanon") && is_set("echo") && is_set("isig"), "{name}: {after}");
        assert!(text.rfind("\u{1b}[?25h") > text.rfind("\u{1b}[?25l"), "{name}: the cursor is hidden");
    }
}
