//! The program `heliostat-controller`.

use std::process::Command;

use heliostat_bus::free_loopback_endpoint;

#[test]
fn the_flag_for_an_array_in_the_same_process_names_the_program_that_has_it() {
    let program = env!("CARGO_BIN_EXE_heliostat-controller");
    let ended = Command::new(program).args(["--driver", "array.toml"]).output().expect("the program runs");
    let errors = String::from_utf8_lossy(&ended.stderr);
    assert_eq!(ended.status.code(), Some(2), "{errors}");
    assert!(errors.contains("heliostat controller --driver FILE"), "{errors}");
}

#[test]
fn a_request_to_the_operating_system_that_is_not_granted_is_a_warning() {
    let endpoint = free_loopback_endpoint().expect("a free port");
    let words = ["--pin", "1048576", "--log-format", "json", "--seconds", "1", "--listen", &endpoint];
    let ended = Command::new(env!("CARGO_BIN_EXE_heliostat-controller")).args(words).output().expect("it runs");
    let errors = String::from_utf8_lossy(&ended.stderr);
    let line = errors.lines().find(|line| line.contains("not granted, continuing without: on processors"));
    assert!(line.is_some_and(|line| line.contains("\"level\":\"WARN\"")), "{errors}");
}
