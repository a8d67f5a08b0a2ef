//! Every flag that takes seconds follows one rule.

use std::process::Command;

#[test]
fn every_command_refuses_an_invalid_duration_in_the_same_words() {
    let commands: [&[&str]; 9] = [
        &["demo"],
        &["ui"],
        &["controller"],
        &["sim-node"],
        &["driver", "run", "--config", "none.toml"],
        &["record", "--out", "none.mcap"],
        &["bench", "decide"],
        &["stop"],
        &["rearm"],
    ];
    for command in commands {
        let flag = match command[0] {
            "stop" | "rearm" => "--timeout",
            _ => "--seconds",
        };
        for value in ["x", "-1", "0", "1e9", "nan", "3 s", "3m"] {
            let ended = Command::new(env!("CARGO_BIN_EXE_heliostat")).args(command).args([flag, value]).output();
            let ended = ended.expect("the program starts");
            let errors = String::from_utf8_lossy(&ended.stderr);
            let expected = format!("invalid duration \"{value}\": expected seconds between 0.01 and 10000000");
            assert!(errors.contains(&expected), "{command:?} {flag} {value}: {errors}");
            assert_eq!(ended.status.code(), Some(2), "{command:?} {flag} {value}");
        }
    }
}
