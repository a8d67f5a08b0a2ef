//! Help texts and refusals of the command line.

use std::process::{Command, Stdio};

use heliostat_scenario::DEFAULT_SCENARIO;

use super::lab;

#[test]
fn every_command_has_a_help_text() {
    let overview = String::from_utf8(lab(&["--help"]).stdout).expect("text");
    for command in ["train", "eval", "reproduce", "report", "map", "trace", "calibrate", "bench"] {
        assert!(overview.contains(command), "{command} is missing in: {overview}");
        let help = lab(&[command, "--help"]);
        assert!(help.status.success() && help.stdout.len() > 200, "{command}");
    }
}

#[test]
fn a_help_text_states_what_a_flag_requires_and_accepts() {
    let words = |command: &[&str]| {
        let help = String::from_utf8(lab(command).stdout).expect("text");
        help.split_whitespace().collect::<Vec<_>>().join(" ")
    };
    let help = words(&["eval", "--help"]);
    assert!(help.contains("to the first measured instant of an episode, at least 0.01"), "{help}");
    assert!(help.contains("A value may be a list, as in `led.positions_m=[[0,0,3]],[[1,0,3],[-1,0,3]]`"), "{help}");
    let help = words(&["trace", "import", "--help"]);
    assert!(help.contains(&format!("[default: {DEFAULT_SCENARIO}; the report says so]")), "{help}");
}

#[test]
fn every_command_refuses_an_invalid_duration_in_the_same_words() {
    for arguments in [
        &["bench", "env", "--seconds"][..],
        &["bench", "demo", "--seconds"],
        &["eval", "--closed-loop", "--warm"],
        &["trace", "import", "walks.txt", "--max-gap-s"],
        &["trace", "import", "walks.txt", "--duration-s"],
    ] {
        for value in ["x", "-1", "0", "1e9", "nan"] {
            let ended = lab(&[arguments, &[value]].concat());
            let errors = String::from_utf8_lossy(&ended.stderr);
            let expected = format!("invalid duration \"{value}\": expected seconds between 0.01 and 10000000");
            assert!(errors.contains(&expected), "{arguments:?} {value}: {errors}");
            assert_eq!(ended.status.code(), Some(2), "{arguments:?} {value}");
        }
    }
}

#[test]
fn what_the_user_typed_or_named_and_cannot_be_used_has_one_exit_status() {
    for command in [
        "calibrate --reports-hz 0",
        "calibrate --spot-error-m nan",
        "map --step-cm 0",
        "map --out map.png",
        "eval --policies flat --csv no/such/folder/figures.csv",
        "eval --policies flat --sweep users.count=1 --sweep users.count=2",
        "eval --policies flat --set users.count=2 --sweep users.count=1,2",
        "report absent.toml",
    ] {
        let ended = lab(&command.split(' ').collect::<Vec<_>>());
        assert_eq!(ended.status.code(), Some(2), "{command}: {}", String::from_utf8_lossy(&ended.stderr));
    }
}

/// As of `heliostat-lab ... | head -0`.
#[test]
fn a_closed_output_is_not_an_error() {
    let mut command = Command::new(env!("CARGO_BIN_EXE_heliostat-lab"));
    command.args(["bench", "env", "--seconds", "0.01", "--json"]).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut program = command.spawn().expect("the program starts");
    drop(program.stdout.take());
    let ended = program.wait_with_output().expect("it ends");
    assert!(ended.status.success() && ended.stderr.is_empty(), "{}", String::from_utf8_lossy(&ended.stderr));
}

#[test]
fn completions_are_those_of_this_program() {
    let script = String::from_utf8(lab(&["completions", "bash"]).stdout).expect("text");
    let command =
        script.lines().find(|line| line.trim_start().starts_with("complete -F")).expect("a line for the shell");
    assert!(command.ends_with(" heliostat-lab"), "{command}");
}

#[test]
fn more_threads_than_can_start_are_refused_by_the_name_of_their_variable() {
    let mut command = Command::new(env!("CARGO_BIN_EXE_heliostat-lab"));
    command.args(["eval", "--policies", "flat", "--states", "1", "--seeds", "1"]).env("RAYON_NUM_THREADS", "100000");
    let refused = command.output().expect("the program starts");
    let message = String::from_utf8_lossy(&refused.stderr);
    assert_eq!(refused.status.code(), Some(2), "{message}");
    assert!(message.contains("RAYON_NUM_THREADS=100000: expected at most 1024 threads"), "{message}");
}
