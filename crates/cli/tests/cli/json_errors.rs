//! What a command with `--json` prints where it fails.

use serde_json::Value;

use super::heliostat;

/// The error on standard output, beside that on standard error.
fn error_of(arguments: &[&str]) -> String {
    let ended = heliostat(arguments);
    assert!(!ended.status.success(), "{arguments:?}");
    let object: Value = serde_json::from_slice(&ended.stdout).unwrap_or_else(|error| panic!("{arguments:?}: {error}"));
    let error = object["error"].as_str().unwrap_or_else(|| panic!("{arguments:?}: {object}")).to_owned();
    let in_one_line = |text: &str| text.split_whitespace().collect::<Vec<_>>().join(" ");
    let errors = in_one_line(&String::from_utf8_lossy(&ended.stderr));
    assert!(errors.contains(&in_one_line(&error)), "{arguments:?}: {errors} instead of {error}");
    error
}

#[test]
fn a_refused_input_is_also_an_object() {
    for (arguments, part) in [
        (&["link", "--json"][..], "no users: give --user X,Y"),
        (&["link", "--user", "1,1", "--json", "--scenario", "nope"], "nope"),
        (&["link", "--user", "1,1", "--json", "--set", "users.count=0"], "users.count"),
        (&["replay", "none.mcap", "--verify", "--json"], "none.mcap"),
        (&["keys", "show", "--json", "--dir", "no-such-folder"], "no-such-folder"),
    ] {
        let error = error_of(arguments);
        assert!(error.contains(part), "{error}");
    }
}

#[test]
fn a_refused_command_line_is_also_an_object_without_its_usage() {
    let error = error_of(&["link", "--json", "--xyz"]);
    assert!(error.starts_with("unexpected argument '--xyz' found") && !error.contains("Usage"), "{error}");
    let error = error_of(&["link", "--seed", "x", "--json"]);
    assert!(error.starts_with("invalid value 'x' for '--seed <SEED>': expected a whole number from 0 to "), "{error}");
    let error = error_of(&["record", "--json"]);
    assert_eq!(error, "the following required arguments were not provided: --out <FILE.mcap>");
}

#[test]
fn an_object_with_the_problem_is_the_only_one() {
    let ended = heliostat(&["scenario", "check", "nope.toml", "--json"]);
    let object: Value = serde_json::from_slice(&ended.stdout).expect("one object");
    assert_eq!((&object["valid"], object.get("error")), (&false.into(), None), "{object}");
}

#[test]
fn without_the_flag_an_error_is_on_standard_error_alone() {
    for arguments in [&["link", "--scenario", "nope"][..], &["ui", "--json"], &["link", "--xyz"]] {
        let ended = heliostat(arguments);
        assert!(ended.stdout.is_empty() && !ended.stderr.is_empty(), "{arguments:?}");
    }
}
