//! The geometry that the room announces, compared with the given scenario and with the controller that leads.

use heliostat_scenario::{RoomDifference, Scenario};
use heliostat_service::printable::printable;

use super::check::Check;
use super::controller::{Answers, ControllerState};

/// Names of the checks of the given scenario and of the controller.
const GIVEN: &str = "room";
const CONTROLLER: &str = "controller";

/// What to do where the given scenario is that of another room.
const GIVE_ROOM: &str =
    "a run with this scenario would decide for another room: give the --scenario and --set of the room";

/// What to do where the controller decides for another room.
const RESTART: &str = "its commands are for another room: correct its scenario, or that of the room";

/// What to do with a geometry that cannot be read.
const SAME_VERSION: &str = "run the same version of heliostat in every process of the room";

/// The checks; none where the room announces no geometry, as a room without a simulator.
pub(super) fn checks(scenario: &Scenario, answers: &Answers) -> Vec<Check> {
    let Some(announced) = &answers.room else { return Vec::new() };
    match Scenario::read_announced(announced, "the room") {
        Ok(room) => {
            let of_controller = answers.controller.as_ref().and_then(|controller| check_controller(controller, &room));
            std::iter::once(check_given(scenario, &room)).chain(of_controller).collect()
        }
        Err(refused) => vec![Check::fail(GIVEN, printable(&refused), SAME_VERSION)],
    }
}

fn check_given(scenario: &Scenario, room: &Scenario) -> Check {
    let difference = scenario.difference_from_room(room, "the given scenario");
    check(GIVEN, difference, "the given scenario has the geometry that the room announces", GIVE_ROOM)
}

/// `None` for a controller that announces no geometry.
fn check_controller(controller: &ControllerState, room: &Scenario) -> Option<Check> {
    let name = format!("the controller {}", controller.name);
    Some(match Scenario::read_announced(controller.geometry.as_deref()?, &name) {
        Ok(own) => {
            let same = format!("{name} has the geometry that the room announces");
            check(CONTROLLER, own.room_difference(room, &name), &same, RESTART)
        }
        Err(refused) => Check::fail(CONTROLLER, printable(&refused), SAME_VERSION),
    })
}

/// The check of a difference. One that a calibration explains is a remark.
fn check(name: &'static str, difference: Option<RoomDifference>, same: &str, advice: &str) -> Check {
    match difference {
        None => Check::ok(name, same),
        Some(RoomDifference::Measured(remark)) => Check::ok(name, printable(&remark)),
        Some(RoomDifference::Problem(problem)) => Check::fail(name, printable(&problem), advice),
    }
}

#[cfg(test)]
mod tests {
    use super::super::check::Verdict;
    use super::*;

    fn with(height_m: f64) -> Scenario {
        Scenario::default().with_overrides(&[format!("room.height_m={height_m:?}")]).expect("a valid height")
    }

    /// Name, verdict and text of the checks of a scenario and a controller of these heights, in a room of 3 m.
    fn found(given_m: f64, controller_m: f64) -> Vec<(&'static str, Verdict, String)> {
        let geometry = Some(with(controller_m).geometry_toml());
        let controller = ControllerState { name: "c1".into(), geometry, ..ControllerState::default() };
        let answers = Answers { controller: Some(controller), room: Some(with(3.0).geometry_toml()) };
        let found = checks(&with(given_m), &answers).into_iter();
        found.map(|check| (check.name, check.verdict, check.found)).collect()
    }

    #[test]
    fn a_scenario_or_a_controller_of_another_room_fails_with_the_key_and_both_values() {
        let found = found(3.5, 3.4);
        let named: Vec<_> = found.iter().map(|(name, verdict, _)| (*name, *verdict)).collect();
        assert_eq!(named, [(GIVEN, Verdict::Fail), (CONTROLLER, Verdict::Fail)]);
        assert_eq!(found[0].2, "room.height_m is 3.0 in the room and 3.5 in the given scenario");
        let values = "room and controller differ: room.height_m is 3.0 in the room and 3.4 in the controller c1;";
        assert!(found[1].2.starts_with(values), "{found:?}");
    }

    #[test]
    fn the_geometry_of_the_room_passes_and_what_a_calibration_measures_is_a_remark() {
        let [same, measured] = [found(3.0, 3.0), found(3.02, 3.02)];
        let verdicts = |found: &[(&str, Verdict, String)]| found.iter().map(|one| one.1).collect::<Vec<_>>();
        assert_eq!([verdicts(&same), verdicts(&measured)], [[Verdict::Ok; 2], [Verdict::Ok; 2]]);
        let remark = "differs from the room only in what heliostat calibrate measures: room.height_m. Most: ";
        assert!(measured.iter().all(|(.., text)| text.contains(remark)), "{measured:?}");
        assert!(!same.iter().any(|(.., text)| text.contains(remark)), "{same:?}");
    }

    #[test]
    fn a_room_that_announces_nothing_is_not_compared_and_an_announcement_that_cannot_be_read_fails() {
        assert!(checks(&with(3.0), &Answers::default()).is_empty());
        let refused = checks(&with(3.0), &Answers { room: Some("[room".into()), controller: None });
        assert_eq!(refused.iter().map(|check| check.verdict).collect::<Vec<_>>(), [Verdict::Fail]);
        let expected = "the geometry that the room announces is refused: ";
        assert!(refused[0].found.starts_with(expected), "{refused:?}");
    }
}
