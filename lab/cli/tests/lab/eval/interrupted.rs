//! The end of an evaluation by a signal.

use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use heliostat_needs::needs;
use heliostat_service::exit::INTERRUPTED;
use heliostat_service::signals;

/// Whether a process handles SIGINT.
fn handles_interrupts(process: u32) -> bool {
    let status = std::fs::read_to_string(format!("/proc/{process}/status")).unwrap_or_default();
    let mask = status.lines().find_map(|line| u64::from_str_radix(line.strip_prefix("SigCgt:")?.trim(), 16).ok());
    mask.is_some_and(|mask| mask & 0b10 != 0)
}

/// Waits until a child has reached this state.
fn wait_until(child: &mut Child, state: impl Fn(u32) -> bool) {
    let started = Instant::now();
    while !state(child.id()) {
        assert!(started.elapsed().as_secs() < 120, "it is not ready for the signal");
        assert!(child.try_wait().expect("a child").is_none(), "it ended before the signal");
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// The output of an evaluation that writes this file with these flags, and is interrupted; also as a part of another
/// command.
fn interrupted(csv: &Path, flags: &[&str], is_part: bool) -> Output {
    signals::restore_in_children();
    let mut eval = Command::new(env!("CARGO_BIN_EXE_heliostat-lab"));
    eval.args(["eval", "--scenario", "specular", "--policies", "greedy", "--states", "1000000"]).args(flags);
    eval.arg("--csv").arg(csv);
    if is_part {
        signals::part(&mut eval);
    }
    let mut child = eval.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("the program starts");
    wait_until(&mut child, handles_interrupts);
    let sent = Command::new("kill").args(["-INT", &child.id().to_string()]).status().expect("kill");
    assert!(sent.success());
    child.wait_with_output().expect("it ends")
}

#[test]
fn an_interrupted_evaluation_says_how_far_it_was_and_how_to_go_on_unless_another_command_does() {
    let folder = tempfile::tempdir().expect("a folder");
    let csv = folder.path().join("figures.csv");
    for is_part in [false, true] {
        let output = interrupted(&csv, &[], is_part);
        let errors = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(INTERRUPTED.into()), "{errors}");
        for words in ["heliostat-lab: interrupted: the comparison was at", "nothing is written", "eval has no --resume"]
        {
            assert_eq!(errors.contains(words), !is_part, "{words}: {errors}");
        }
        assert!(output.stdout.is_empty() && !csv.exists());
        let output = interrupted(&csv, &["--json"], is_part).stdout;
        let object: Option<serde_json::Value> = serde_json::from_slice(&output).ok();
        let error = object.as_ref().and_then(|object| object["error"].as_str());
        assert_eq!(error.is_some_and(|error| error.starts_with("interrupted: the comparison was at")), !is_part);
        assert_eq!(output.is_empty(), is_part, "{}", String::from_utf8_lossy(&output));
    }
}

#[needs("numpy")]
#[test]
fn an_interrupted_evaluation_ends_a_function_in_python_without_a_traceback() {
    signals::restore_in_children();
    let folder = tempfile::tempdir().expect("a folder");
    let (file, begun, done) = (folder.path().join("slow.py"), folder.path().join("begun"), folder.path().join("done"));
    let code = format!(
        "import time\n\
         def act(seen):\n    open({begun:?}, 'w').close()\n\
         \x20   for _ in range(6000):\n        time.sleep(0.01)\n\
         \x20   open({done:?}, 'w').close()\n"
    );
    std::fs::write(&file, code).expect("writable");
    let policy = format!("{}:act", file.to_str().expect("a plain path"));
    let mut eval = Command::new(env!("CARGO_BIN_EXE_heliostat-lab"));
    eval.args(["eval", "--scenario", "specular", "--states", "1", "--seeds", "1", "--policies", &policy]);
    eval.process_group(0).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut child = eval.spawn().expect("the program starts");
    wait_until(&mut child, |_| begun.exists());
    // As a terminal does: to all processes of the command.
    let group = format!("-{}", child.id());
    let sent = Command::new("kill").args(["-INT", "--", &group]).status().expect("kill");
    assert!(sent.success());
    // The end of its output is the end of the function's process too.
    let output = child.wait_with_output().expect("it ends");
    let errors = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(INTERRUPTED.into()), "{errors}");
    assert!(errors.contains("heliostat-lab: interrupted: the comparison was at"), "{errors}");
    assert!(!errors.contains("Traceback") && !done.exists(), "{errors}");
}
