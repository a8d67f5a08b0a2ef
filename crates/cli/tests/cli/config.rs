//! `heliostat config` on the command line.

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;

fn config(folder: &Path, arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_heliostat"));
    command.args(["config", "--as-json", "controller", "--connect", "tcp/127.0.0.1:7447"]);
    command.args(arguments).current_dir(folder).output().expect("the program starts")
}

#[test]
fn the_processes_of_a_room_have_the_defaults_of_the_demo() {
    let defaults = |process: &[&str]| -> (Value, Value) {
        let mut command = Command::new(env!("CARGO_BIN_EXE_heliostat"));
        let printed = command.args(["config", "--as-json"]).args(process).output().expect("the program starts");
        assert!(printed.status.success(), "{}", String::from_utf8_lossy(&printed.stderr));
        let document: Value = serde_json::from_slice(&printed.stdout).expect("one JSON object");
        (document["scenario_hash"].clone(), document["process"]["policy"].clone())
    };
    let (scenario, policy) = defaults(&["demo"]);
    assert_eq!(
        defaults(&["demo", "--scenario", "hall", "--policy", "fixed-point"]),
        (scenario.clone(), policy.clone())
    );
    assert_eq!(defaults(&["controller", "--connect", "tcp/127.0.0.1:7447"]), (scenario.clone(), policy));
    assert_eq!(defaults(&["sim-node", "--listen", "tcp/127.0.0.1:7447"]).0, scenario);
}

/// The page has the names by which Python has the parts.
#[test]
fn the_layout_of_an_actor_has_the_parts_of_the_page_on_python() {
    let page = include_str!("../../../../docs/python.md");
    let table = page.split("| part | shape |").nth(1).and_then(|rest| rest.split("\n\n").next()).expect("a table");
    let mut parts: Vec<&str> = table.lines().filter_map(|row| row.strip_prefix("| `")?.split('`').next()).collect();
    let mut command = Command::new(env!("CARGO_BIN_EXE_heliostat"));
    let printed = command.args(["config", "--as-json", "actor"]).output().expect("the program starts");
    let document: Value = serde_json::from_slice(&printed.stdout).expect("one JSON object");
    let layout = document["layout"].as_object().expect("an object");
    let mut names: Vec<&str> = layout.keys().map(String::as_str).collect();
    // The order of the keys of an object has no meaning.
    parts.sort_unstable();
    names.sort_unstable();
    assert_eq!((names, parts.len()), (parts.clone(), 7));
}

#[test]
fn the_configuration_of_a_controller_is_printed_only_where_it_can_use_its_model() {
    let folder = tempfile::tempdir().expect("a folder");
    let shipped = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../models/actors/ddpg-specular.onnx");
    let actor = fs::read(shipped).expect("it is part of the sources");
    fs::write(folder.path().join("actor.onnx"), &actor).expect("a file");
    fs::write(folder.path().join("cut.onnx"), &actor[..actor.len() / 2]).expect("a file");

    let printed = config(folder.path(), &["--model", "actor.onnx"]);
    assert!(printed.status.success(), "{}", String::from_utf8_lossy(&printed.stderr));
    let document: Value = serde_json::from_slice(&printed.stdout).expect("one JSON object");
    assert_eq!(document.pointer("/process/model"), Some(&"actor.onnx".into()), "{document}");

    for (arguments, words) in [
        (&["--model", "cut.onnx"][..], "cut.onnx is not an ONNX model"),
        (&["--model", "missing.onnx"], "no actor at missing.onnx"),
        (&["--model", "actor.onnx", "--set", "channel.mode=paper"], "actor.onnx was made for"),
    ] {
        let refused = config(folder.path(), arguments);
        let errors = String::from_utf8_lossy(&refused.stderr);
        assert!(!refused.status.success() && refused.stdout.is_empty(), "{arguments:?}: {errors}");
        assert!(errors.contains(words), "{arguments:?}: {errors}");
    }
}
