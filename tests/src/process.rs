//! A program of this workspace as an operating-system process.

use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;

use heliostat_proto::NodeKind;
use heliostat_service::signals::restore_in_children;
use serde_json::Value;

use crate::wait::wait_until;

/// A running program; it is killed when dropped.
pub struct Process {
    child: Child,
    output: Arc<Mutex<String>>,
    errors: Arc<Mutex<String>>,
    readers: Vec<JoinHandle<()>>,
    /// The files of the Unix sockets at which it listens. A killed process leaves them behind.
    sockets: Vec<String>,
}

impl Process {
    /// Starts `heliostat` with these arguments.
    ///
    /// # Panics
    /// When the program is not built or does not start.
    pub fn heliostat(arguments: &[&str]) -> Self {
        Self::heliostat_under::<&str>(&[], &[], arguments)
    }

    /// Starts a controller that connects to a room, listens, and ends with this process.
    ///
    /// # Panics
    /// As [`Process::heliostat`].
    pub fn controller(policy: &str, room: &str, own: &str, more: &[&str]) -> Self {
        let flags = ["controller", "--policy", policy, "--connect", room, "--listen", own, "--exit-with-parent"];
        Self::heliostat(&[&flags[..], more].concat())
    }

    /// Like [`Process::heliostat`], for tests that may lose no message: on a busy machine Zenoh waits up to a second
    /// before it drops one, instead of 50 us.
    ///
    /// # Panics
    /// When the program is not built or does not start.
    pub fn heliostat_without_loss(arguments: &[&str]) -> Self {
        let wait = "transport/link/tx/queue/congestion_control/drop/wait_before_drop=1000000";
        Self::heliostat_under::<&str>(&[], &[("HELIOSTAT_ZENOH", wait)], arguments)
    }

    /// Starts `heliostat` with these environment variables, under another program if `wrapper` is
    /// not empty, for example `ip netns exec NAME`. The wrapper replaces itself with `heliostat`.
    ///
    /// # Panics
    /// When the program is not built or does not start.
    pub fn heliostat_under<W: AsRef<str>>(wrapper: &[W], variables: &[(&str, &str)], arguments: &[&str]) -> Self {
        let wrapper: Vec<&str> = wrapper.iter().map(AsRef::as_ref).collect();
        let path = built("heliostat");
        let arguments = &in_test_room(arguments)[..];
        match &wrapper[..] {
            [] => Self::start(&path, arguments, variables),
            [first, rest @ ..] => {
                let program = [path.to_str().expect("the path is text")];
                Self::start(Path::new(first), &[rest, &program, arguments].concat(), variables)
            }
        }
    }

    /// Starts a program of another project with these arguments, under another program.
    ///
    /// # Panics
    /// When it does not start.
    pub fn foreign(wrapper: &[String], program: &Path, arguments: &[&str]) -> Self {
        let wrapper: Vec<&str> = wrapper.iter().map(String::as_str).collect();
        let words = [&wrapper[..], &[program.to_str().expect("the path is text")], arguments].concat();
        Self::start(Path::new(words[0]), &words[1..], &[])
    }

    /// Starts a program of the workspace with these arguments.
    ///
    /// # Panics
    /// When the program is not built or does not start.
    pub fn program(name: &str, arguments: &[&str]) -> Self {
        Self::start(&built(name), arguments, &[])
    }

    fn start(path: &Path, arguments: &[&str], variables: &[(&str, &str)]) -> Self {
        restore_in_children();
        let mut child = Command::new(path)
            .args(arguments)
            .envs(variables.iter().copied())
            .current_dir(workspace())
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap_or_else(|error| panic!("{} does not start: {error}", path.display()));
        let (output, errors) = (Arc::default(), Arc::default());
        let stdout = child.stdout.take().expect("standard output is piped");
        let stderr = child.stderr.take().expect("standard error is piped");
        let readers = vec![collect(stdout, &output), collect(stderr, &errors)];
        Self { child, output, errors, readers, sockets: sockets(arguments) }
    }

    /// Sends SIGKILL, and removes the Unix sockets of the process.
    pub fn kill(&mut self) {
        self.child.kill().expect("the process can be killed");
        self.child.wait().expect("the process can be waited for");
        // A process that never listened made none.
        self.sockets.drain(..).for_each(|file| drop(std::fs::remove_file(file)));
    }

    /// Sends a signal by its name, for example `STOP`.
    ///
    /// # Panics
    /// When the process is gone.
    pub fn signal(&self, name: &str) {
        let sent = Command::new("kill").args([format!("-{name}"), self.id().to_string()]).status();
        assert!(sent.expect("there is a kill command").success(), "SIG{name} cannot be sent to process {}", self.id());
    }

    /// The process id.
    pub fn id(&self) -> u32 {
        self.child.id()
    }

    /// Whether it is running.
    pub fn is_running(&mut self) -> bool {
        matches!(self.child.try_wait(), Ok(None))
    }

    /// Its output on standard error so far.
    pub fn errors(&self) -> String {
        self.errors.lock().expect("no reader panics").clone()
    }

    /// Whether this recorder has noted a process of the kind in its room.
    pub fn has_noted(&self, node: NodeKind) -> bool {
        let noted = format!(" {node} ");
        self.errors().lines().any(|line| line.contains(&noted) && line.ends_with(" is alive"))
    }

    /// Closes its standard input, which ends a process started with `--exit-with-parent`, and waits
    /// for it.
    pub fn end(mut self) -> Ended {
        drop(self.child.stdin.take());
        self.wait()
    }

    /// Waits for its end.
    ///
    /// # Panics
    /// When it does not end within the time limit.
    pub fn wait(mut self) -> Ended {
        self.wait_mut()
    }

    /// The same for a process that another structure holds.
    ///
    /// # Panics
    /// When it does not end within the time limit.
    pub fn wait_mut(&mut self) -> Ended {
        let mut status = None;
        wait_until("the end of a process", || {
            status = self.child.try_wait().expect("the process can be waited for");
            status.is_some()
        });
        self.readers.drain(..).for_each(|reader| reader.join().expect("no reader panics"));
        Ended {
            status: status.expect("waited for"),
            output: self.output.lock().expect("no reader panics").clone(),
            errors: self.errors(),
        }
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        if self.is_running() {
            self.kill();
        }
    }
}

/// The number at a JSON pointer.
///
/// # Panics
/// When there is none.
pub fn number(value: &Value, path: &str) -> f64 {
    value.pointer(path).and_then(Value::as_f64).unwrap_or_else(|| panic!("no number at {path} in {value}"))
}

/// The output of a process that has ended.
#[derive(Debug)]
pub struct Ended {
    /// Its exit status.
    pub status: ExitStatus,
    /// Its standard output.
    pub output: String,
    /// Its standard error.
    pub errors: String,
}

impl Ended {
    /// The JSON object on the last line of its output, after success.
    ///
    /// # Panics
    /// When the exit status is a failure, or the last line is not JSON.
    pub fn json(&self) -> Value {
        assert!(self.status.success(), "{}: {}", self.status, self.errors);
        self.last_json()
    }

    /// The JSON object on the last line of its output, after a success or a failure.
    ///
    /// # Panics
    /// When the last line is not JSON.
    pub fn last_json(&self) -> Value {
        let line = self.output.lines().last().unwrap_or_default();
        serde_json::from_str(line).unwrap_or_else(|error| panic!("the last line is not JSON ({error}): {line}"))
    }

    /// Its standard error, after a failure.
    ///
    /// # Panics
    /// When the exit status is a success.
    pub fn refusal(&self) -> &str {
        assert!(!self.status.success(), "ended with success: {}", self.output);
        &self.errors
    }
}

/// The Unix sockets at which a process with these arguments listens, each with its lock.
fn sockets(arguments: &[&str]) -> Vec<String> {
    let listen = arguments.windows(2).filter(|words| words[0] == "--listen");
    let paths = listen.filter_map(|words| words[1].strip_prefix("unixsock-stream/"));
    paths.flat_map(|path| [path.to_owned(), format!("{path}.lock")]).collect()
}

fn collect(mut stream: impl Read + Send + 'static, into: &Arc<Mutex<String>>) -> JoinHandle<()> {
    let into = Arc::clone(into);
    std::thread::spawn(move || {
        for line in BufReader::new(&mut stream).lines().map_while(Result::ok) {
            let mut text = into.lock().expect("no reader panics");
            text.push_str(&line);
            text.push('\n');
        }
    })
}

/// The room of a process that names none. It reports 100 times a second, so that a test waits for many
/// reports in a short time.
const TEST_SCENARIO: &str = "specular";

/// A scenario with six mirrors on one wall, then eight on another.
pub const TWO_ARRAYS: &str =
    "name = \"two\"\n[[mirrors]]\nrows = 2\ncolumns = 3\n[[mirrors]]\nrows = 2\ncolumns = 4\nwall = \"-x\"\n";

/// The arguments of a process, with the scenario of the tests where they name none.
fn in_test_room<'a>(arguments: &[&'a str]) -> Vec<&'a str> {
    let runs_a_room = matches!(arguments, ["sim-node" | "controller" | "demo" | "record", ..]);
    let sets_a_room = matches!(arguments, ["ui", ..]) && arguments.contains(&"--set");
    let names_one = arguments.iter().any(|argument| argument.starts_with("--scenario"));
    let mut all = arguments.to_vec();
    if (runs_a_room || sets_a_room) && !names_one {
        all.splice(1..1, ["--scenario", TEST_SCENARIO]);
    }
    all
}

/// The folder of the workspace.
///
/// # Panics
/// When it is gone.
pub fn workspace() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..").canonicalize().expect("the workspace is there")
}

/// A recording of 120 ticks that every version replays.
///
/// # Panics
/// As [`workspace`].
pub fn golden_recording() -> PathBuf {
    workspace().join("tests/data/golden.mcap")
}

/// The folder of the built programs.
///
/// # Panics
/// When this is not called from a test.
pub fn programs() -> PathBuf {
    let test = std::env::current_exe().expect("a test is a file");
    let folder = test.parent().and_then(Path::parent).expect("a test lies in target/PROFILE/deps");
    folder.to_path_buf()
}

/// A program built beside this test: tests run from `target/PROFILE/deps`, programs are in
/// `target/PROFILE`.
fn built(name: &str) -> PathBuf {
    let path = programs().join(name).with_extension(std::env::consts::EXE_EXTENSION);
    assert!(path.exists(), "{} is not built: run the tests with `cargo test --release --workspace`", path.display());
    path
}
