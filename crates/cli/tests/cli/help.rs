//! Help texts and scenario files on the command line.

use super::heliostat;

#[test]
fn every_command_has_a_help_text() {
    let commands = [
        "demo",
        "controller",
        "sim-node",
        "driver",
        "ui",
        "link",
        "bench",
        "scenario",
        "record",
        "replay",
        "doctor",
        "status",
        "calibrate",
    ];
    let overview = String::from_utf8(heliostat(&["--help"]).stdout).expect("text");
    for command in commands {
        assert!(overview.contains(command), "{command} is missing in: {overview}");
        let help = heliostat(&[command, "--help"]);
        assert!(help.status.success() && help.stdout.len() > 200, "{command}");
    }
}

/// The text of flags that two commands share would take the place of that of a command.
#[test]
fn a_command_is_described_and_not_its_flags() {
    let overview = String::from_utf8(heliostat(&["--help"]).stdout).expect("text");
    let commands = overview.lines().skip_while(|line| *line != "Commands:").skip(1).take_while(|line| !line.is_empty());
    let described = commands.filter_map(|line| line.strip_prefix("  ")?.split_once("  "));
    let described: Vec<(&str, &str)> = described.filter(|(name, _)| !name.is_empty()).collect();
    assert!(described.len() > 10, "{overview}");
    for (name, text) in described {
        assert!(!text.trim().starts_with("Flags"), "{name}: {text}");
    }
}

#[test]
fn a_help_text_states_what_a_flag_requires() {
    let help = String::from_utf8(heliostat(&["sim-node", "--help"]).stdout).expect("text");
    let words = help.split_whitespace().collect::<Vec<_>>().join(" ");
    assert!(words.contains("--start-armed With --state: start parked"), "{help}");
}

#[test]
fn a_command_of_the_laboratory_names_the_command_that_replaces_it() {
    for command in ["train ddpg --seed 3", "eval", "reproduce --help", "map", "trace import", "bench env"] {
        let ended = heliostat(&command.split(' ').collect::<Vec<_>>());
        let errors = String::from_utf8(ended.stderr).expect("text");
        assert_eq!((ended.status.code(), ended.stdout.len(), errors.lines().count()), (Some(2), 0, 1), "{errors}");
        assert!(errors.contains(&format!("cargo run --release -p heliostat-lab -- {command}`")), "{errors}");
    }
}

#[test]
fn scenario_new_writes_a_file_that_check_accepts() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("room.toml");
    let file = file.to_str().expect("a plain path");
    assert!(heliostat(&["scenario", "new", file]).status.success());
    assert!(!heliostat(&["scenario", "new", file]).status.success(), "nothing is overwritten");
    assert!(heliostat(&["scenario", "check", file]).status.success());

    let text = std::fs::read_to_string(file).expect("readable").replace("rows = 10", "rwos = 10");
    std::fs::write(file, text).expect("writable");
    let refused = heliostat(&["scenario", "check", file]);
    let errors = String::from_utf8(refused.stderr).expect("text");
    assert!(!refused.status.success() && errors.contains("rwos") && errors.contains("line"), "{errors}");
}

#[test]
fn what_the_user_typed_or_named_and_cannot_be_used_has_one_exit_status() {
    for command in [
        "demo --policy fixd",
        "demo --scenario absent.toml",
        "demo --policy ddpg --model absent.onnx",
        "demo --room a/b",
        "sim-node --set users.count=99",
        "controller --connect tcp/nowhere",
        "config controller --connect tcp/127.0.0.1:7447 --policy ddpg --model absent.onnx",
        "status --connect nowhere",
        "stop --connect tls/127.0.0.1:7447 --tls absent",
        "driver run --config absent.toml",
        "replay absent.mcap",
        "link --user 1",
        "calibrate --out new.toml --array 16",
        "calibrate apply absent.toml --array 16",
        "doctor --array 16",
        "link --users absent.csv",
        "link --user 1,1 --obstacles absent.csv",
    ] {
        let ended = heliostat(&command.split(' ').collect::<Vec<_>>());
        assert_eq!(ended.status.code(), Some(2), "{command}: {}", String::from_utf8_lossy(&ended.stderr));
    }
    // A process that does not answer is a failure. The port is reserved.
    let absent = heliostat(&["status", "--connect", "tcp/127.0.0.1:1"]);
    assert_eq!(absent.status.code(), Some(1), "{}", String::from_utf8_lossy(&absent.stderr));
}

#[test]
fn scenario_check_applies_overrides() {
    let check = |set: &str| heliostat(&["scenario", "check", "hall", "--set", set]);
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).expect("text");
    let valid = check("users.count=3");
    assert!(valid.status.success() && text(valid.stdout).contains("3 users"));
    let stated = text(check("blockage.forced_users=2").stdout);
    assert!(stated.contains("\ncondition: the cause of a blocked path does not apply: "), "{stated}");
    let refused = check("users.count=99");
    let message = text(refused.stderr);
    assert!(refused.status.code() == Some(1) && message.contains("users.count = 99: expected"), "{message}");
}

#[test]
fn scenario_check_lists_every_problem_of_the_file_and_of_its_recording() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = |name: &str| folder.path().join(name).to_str().expect("a plain path").to_owned();
    let check = |room: &str| {
        std::fs::write(at("room.toml"), room).expect("writable");
        let output = heliostat(&["scenario", "check", "--json", &at("room.toml")]);
        assert_eq!(output.status.code(), Some(1));
        let json: serde_json::Value = serde_json::from_slice(&output.stdout).expect("one JSON object");
        let errors = String::from_utf8(output.stderr).expect("text");
        let problems = json["problems"].as_array().expect("a list").clone();
        problems.iter().for_each(|problem| assert!(errors.contains(problem.as_str().expect("text")), "{errors}"));
        problems.iter().map(|problem| problem.as_str().expect("text").to_owned()).collect::<Vec<_>>()
    };
    std::fs::write(at("walk.csv"), "time,user,x,y\n0,0,9,0\n0,1,0,0\n1,1,b,0\n").expect("writable");
    let found =
        check("[users]\ncount = 2\ntrace = \"walk.csv\"\n[mirrors]\nreflectivity = 2\n[control]\nvalidty_ms = 1\n");
    let expected =
        ["line 5: mirrors.reflectivity", "line 7: control.validty_ms: ", "walk.csv: line 2", "walk.csv: line 4"];
    assert_eq!(found.len(), expected.len(), "{found:#?}");
    for (problem, text) in found.iter().zip(expected) {
        assert!(problem.contains(text) && !problem.contains('\n'), "{text}: {found:#?}");
    }
    std::fs::write(at("walk.csv"), "time,user,x,y\n0,0,1,0\n").expect("writable");
    let found = check("[users]\ncount = 1\ntrace = \"walk.csv\"\n");
    assert!(matches!(&found[..], [only] if only.contains("walk.csv: all samples are of the time 0 s")), "{found:?}");
}

#[test]
fn scenario_check_reads_the_recording_beside_the_file_and_names_lines() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = |name: &str| folder.path().join(name).to_str().expect("a plain path").to_owned();
    let check = |room: &str, walk: &str| {
        std::fs::write(at("room.toml"), room).expect("writable");
        std::fs::write(at("walk.csv"), walk).expect("writable");
        let output = heliostat(&["scenario", "check", &at("room.toml")]);
        (output.status.success(), String::from_utf8(output.stderr).expect("text"))
    };
    let recorded = "[users]\ncount = 1\ntrace = \"walk.csv\"\n";
    assert_eq!(check(recorded, "time,user,x,y\n0,0,-1,0\n2,0,1,0\n"), (true, String::new()));
    for (room, walk, expected) in [
        (recorded, "time,user,x,y\n0,0,-1,0\n2,0,9,0\n", "walk.csv: line 3"),
        (recorded, "time,user,x,y\n0,0,-1,0\n1e-9,0,1,0\n", "walk.csv: line 3: user 0 moves 2.000 m within 1.000e-9 s"),
        (recorded, "time,user,x\n0,0,-1\n", "walk.csv: line 1"),
        ("[users]\ncount = 1\ntrace = \"other.csv\"\n", "", "other.csv"),
        ("[mirrors]\n\nreflectivity = 2\n", "", "line 3"),
        ("[mirrors]\nrows = ten\n", "", "line 2"),
    ] {
        let (valid, errors) = check(room, walk);
        assert!(!valid && errors.contains(expected), "{expected} is missing in: {errors}");
    }
}
