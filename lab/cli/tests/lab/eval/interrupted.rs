//! The end of an evaluation by a signal.

use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

use heliostat_service::exit::INTERRUPTED;
use heliostat_service::signals;

/// Whether a process handles SIGINT.
fn handles_interrupts(process: u32) -> bool {
    let status = std::fs::read_to_string(format!("/proc/{process}/status")).unwrap_or_default();
    let mask = status.lines().find_map(|line| u64::from_str_radix(line.strip_prefix("SigCgt:")?.trim(), 16).ok());
    mask.is_some_and(|mask| mask & 0b10 != 0)
}

/// The output of an evaluation that writes this file, and is interrupted; also as a part of another command.
fn interrupted(csv: &Path, is_part: bool) -> Output {
    signals::restore_in_children();
    let mut eval = Command::new(env!("CARGO_BIN_EXE_heliostat-lab"));
    eval.args(["eval", "--scenario", "specular", "--policies", "greedy", "--states", "1000000", "--csv"]).arg(csv);
    if is_part {
        signals::part(&mut eval);
    }
    let mut child = eval.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("the program starts");
    let started = Instant::now();
    while !handles_interrupts(child.id()) {
        assert!(started.elapsed().as_secs() < 120, "it does not handle the signal");
        assert!(child.try_wait().expect("a child").is_none(), "it ended before the signal");
        std::thread::sleep(Duration::from_millis(5));
    }
    let sent = Command::new("kill").args(["-INT", &child.id().to_string()]).status().expect("kill");
    assert!(sent.success());
    child.wait_with_output().expect("it ends")
}

#[test]
fn an_interrupted_evaluation_says_how_far_it_was_and_how_to_go_on_unless_another_command_does() {
    let folder = tempfile::tempdir().expect("a folder");
    let csv = folder.path().join("figures.csv");
    for is_part in [false, true] {
        let output = interrupted(&csv, is_part);
        let errors = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(INTERRUPTED.into()), "{errors}");
        for words in ["heliostat-lab: interrupted: the comparison was at", "nothing is written", "eval has no --resume"]
        {
            assert_eq!(errors.contains(words), !is_part, "{words}: {errors}");
        }
        assert!(output.stdout.is_empty() && !csv.exists());
    }
}
