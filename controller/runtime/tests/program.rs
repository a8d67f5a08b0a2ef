//! The program `heliostat-controller`.

use std::process::Command;

#[test]
fn the_flag_for_an_array_in_the_same_process_names_the_program_that_has_it() {
    let program = env!("CARGO_BIN_EXE_heliostat-controller");
    let ended = Command::new(program).args(["--driver", "array.toml"]).output().expect("the program runs");
    let errors = String::from_utf8_lossy(&ended.stderr);
    assert_eq!(ended.status.code(), Some(2), "{errors}");
    assert!(errors.contains("heliostat controller --driver FILE"), "{errors}");
}
