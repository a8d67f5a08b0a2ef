//! The notes of a demo, which has started the processes of its room.

use crate::causes::{NO_DRIVER, NO_SIMULATED_POSITIONS, OTHERS_MISSING};
use crate::notes::NO_CONTROLLER;

/// [`NO_CONTROLLER`] beside a page whose button restarts the controller.
const RESTART_CONTROLLER: &str = "no controller commands the mirrors: press restart on the page";
/// What to do about the simulator of a demo.
const CONTINUE_SIMULATOR: &str = "its process has ended, is paused or hangs; start it by the command in the terminal, continue it, or end the demo and start it again";

/// These notes as a demo shows them: its button restarts the controller. Its simulator is the only array and tracker, so
/// where that is silent, one note about it is all.
pub(crate) fn in_demo(notes: Vec<String>) -> Vec<String> {
    let is_of_simulator = |note: &String| note.starts_with(NO_SIMULATED_POSITIONS);
    let is_silent = notes.iter().any(is_of_simulator);
    let follows = |note: &String| is_silent && [OTHERS_MISSING, NO_DRIVER].iter().any(|start| note.starts_with(start));
    let replaced = |note: String| {
        if note == NO_CONTROLLER {
            RESTART_CONTROLLER.to_owned()
        } else if is_of_simulator(&note) {
            format!("{NO_SIMULATED_POSITIONS}: {CONTINUE_SIMULATOR}")
        } else {
            note
        }
    };
    notes.into_iter().filter(|note| !follows(note)).map(replaced).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::notes::{AGAIN, ARRAY_GONE};

    #[test]
    fn only_in_a_demo_the_button_that_restarts_the_controller_is_the_advice() {
        let notes = || vec![NO_CONTROLLER.to_owned(), ARRAY_GONE.to_owned()];
        assert!(notes().iter().all(|note| !note.contains("press")), "without such a page");
        assert_eq!(in_demo(notes()), [RESTART_CONTROLLER, ARRAY_GONE]);
        let cause = |note: &str| note.split(": ").next().map(str::to_owned);
        assert_eq!(cause(RESTART_CONTROLLER), cause(NO_CONTROLLER));
    }

    #[test]
    fn a_silent_simulator_of_a_demo_is_one_note_without_links_routers_and_drivers() {
        let silent = format!("{NO_SIMULATED_POSITIONS}: start it{AGAIN}");
        let driver = format!("{NO_DRIVER}: start a driver or a simulator{AGAIN}");
        let notes = [OTHERS_MISSING, &driver, "another note"].map(str::to_owned).to_vec();
        assert_eq!(in_demo(notes.clone()), notes, "it reports");
        let notes = [notes, vec![silent]].concat();
        assert_eq!(
            in_demo(notes),
            ["another note".to_owned(), format!("{NO_SIMULATED_POSITIONS}: {CONTINUE_SIMULATOR}")]
        );
    }
}
