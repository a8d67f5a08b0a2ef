//! What the state of a room says of emergency stops.

use heliostat_proto::ArrayState;
use heliostat_proto::messages::fault;

use super::RoomStatus;
use crate::causes::NOT_FOLLOWING;
use crate::stop_state::StopFigure;
use crate::stop_watch::RoomStops;

impl RoomStatus {
    /// Whether the stops have this problem of a process, as that of a stop that is not recorded.
    pub(super) fn is_of_stops(&self, problem: &str) -> bool {
        self.stops.iter().any(|stop| stop.contains(problem))
    }

    /// Whether a stop that is seen holds the arrays: their state and the absence of a leader follow from it.
    pub(super) fn is_stopped(&self) -> bool {
        !self.stops.is_empty() && self.figures.array.state == ArrayState::Stopped.name()
    }

    /// That the arrays do not follow. A stop is one problem: the state of the array follows from it.
    pub(super) fn array_problem(&self) -> Option<String> {
        let array = &self.figures.array;
        let is_following = array.state == ArrayState::Following.name();
        (!is_following && !self.is_stopped()).then(|| format!("{NOT_FOLLOWING}: {}", array.state))
    }

    /// The state of the array. A latched stop is not yet a stopped device.
    pub(super) fn array_state(&self) -> String {
        let array = &self.figures.array;
        let is_executed = array.faults.iter().all(|fault| !fault::names(fault::STOP).contains(fault));
        if is_executed { array.state.clone() } else { format!("{} (a device has not executed the stop)", array.state) }
    }

    /// The stops, or only their names where each is a problem with a line of its own. Only the reports of an array show
    /// that no stop holds it.
    pub(super) fn stop_line(&self) -> String {
        let silent = &self.figures.array.silent;
        match (self.stops.is_empty(), self.is_array_seen(), silent.is_empty()) {
            (false, ..) if self.stops.iter().all(|stop| self.problems.contains(stop)) => match &self.in_force[..] {
                [] => "held, and no array here reports it".into(),
                stops => format!("{} in force: {}", stops.len(), stops.join(", ")),
            },
            (false, ..) => self.stops.join("; "),
            (true, true, true) => "none".into(),
            (true, false, _) => "unknown: no array reports; connect to its process or router too".into(),
            (true, true, false) => format!("none that reports show; unknown of {}", silent.join(" and ")),
        }
    }
}

/// The stops in force, each with its name and its operator.
pub(super) fn in_force(room: &RoomStops) -> Vec<String> {
    let named = |StopFigure { name, operator, .. }: StopFigure| match operator.is_empty() {
        true => name,
        false => format!("{name} of {operator}"),
    };
    StopFigure::of(room).into_iter().map(named).collect()
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use heliostat_proto::StopName;
    use heliostat_proto::reported_stops::{RoomStop, Standing};

    use crate::array_faults::faults_note;
    use crate::controllers::{ControllerFigures, Role};
    use crate::figures::{ArrayFigures, Figures, NodeFigures};
    use crate::terminal::texts::stops;

    use super::*;

    #[test]
    fn a_stop_is_one_problem() {
        let array = |faults| ArrayFigures { state: "stopped".into(), faults, ..ArrayFigures::default() };
        let found = |stops: &[&str], faults: Vec<&'static str>| {
            let notes = faults_note(&faults, !stops.is_empty()).into_iter().collect();
            let (controllers, array) = (vec![ControllerFigures::default()], array(faults));
            let figures = Figures { controllers, array, notes, ..Figures::default() };
            let stops = stops.iter().map(|stop| (*stop).to_owned()).collect();
            RoomStatus { reports_per_s: 20.0, stops, figures, ..RoomStatus::default() }.found()
        };
        let stop = "no array has stopped: stop 7:1 (smoke)";
        assert_eq!(found(&[stop], vec!["stop"]), [stop]);
        let of_mirror = faults_note(&["mirror"], true).expect("a note");
        assert_eq!(found(&[stop], vec!["mirror", "stop"]), [stop, of_mirror.as_str()]);
        assert_eq!(found(&[], vec![]), ["the array does not follow: stopped"], "its stop is not seen");
    }

    #[test]
    fn an_array_whose_device_has_not_executed_its_stop_is_not_shown_as_stopped() {
        let line = |faults| {
            let array = ArrayFigures { state: "stopped".into(), arrays: 1, faults, ..ArrayFigures::default() };
            let status = RoomStatus { figures: Figures { array, ..Figures::default() }, ..RoomStatus::default() };
            let text = status.to_string();
            text.lines().find(|line| line.starts_with("array")).unwrap_or_default().to_owned()
        };
        assert_eq!(line(vec!["mirror"]), "array        stopped, 0 mirrors, 0 unusable");
        let open = "array        stopped (a device has not executed the stop), 0 mirrors, 0 unusable";
        assert_eq!(line(vec!["link", "stop"]), open);
    }

    #[test]
    fn a_lost_device_is_one_problem_of_its_array() {
        let array = ArrayFigures { state: "fault".into(), faults: vec!["link", "mirror"], ..ArrayFigures::default() };
        let note = faults_note(&array.faults, false).expect("a note");
        let line = format!("{note}; it causes: the array does not follow");
        let controllers = vec![ControllerFigures::default()];
        let figures = Figures { controllers, array, notes: vec![note], ..Figures::default() };
        let found = RoomStatus { reports_per_s: 20.0, figures, ..RoomStatus::default() }.found();
        assert_eq!(found, [line]);
    }

    #[test]
    fn controllers_of_which_none_leads_are_no_problem_of_their_own_during_a_stop() {
        for role in [Role::Unfollowed, Role::StandsBy] {
            let controllers = vec![ControllerFigures { role, ..ControllerFigures::default() }; 2];
            let found = |stops: &[&str], state: &str| {
                let array = ArrayFigures { state: state.into(), ..ArrayFigures::default() };
                let figures = Figures { controllers: controllers.clone(), array, ..Figures::default() };
                let stops = stops.iter().map(|stop| (*stop).to_owned()).collect();
                RoomStatus { reports_per_s: 20.0, stops, figures, ..RoomStatus::default() }.found()
            };
            let stop = "array 0 has stopped: stop 7/1 of anna (ladder)";
            assert_eq!(found(&[stop], "stopped"), [stop]);
            for unseen in [found(&[], "stopped"), found(&[stop], "parked")] {
                assert!(unseen.iter().any(|problem| problem.starts_with("no controller leads: ")), "{unseen:?}");
            }
        }
    }

    #[test]
    fn no_stop_is_shown_as_absent_for_an_array_that_does_not_report() {
        let line = |silent: &[&str]| {
            let silent = silent.iter().map(|name| (*name).to_owned()).collect();
            let array = ArrayFigures { arrays: 2, mirrors: 24, silent, ..ArrayFigures::default() };
            let status = RoomStatus { figures: Figures { array, ..Figures::default() }, ..RoomStatus::default() };
            let text = status.to_string();
            let line = |name| text.lines().find(|line| line.starts_with(name)).unwrap_or_default().to_owned();
            (line("stops"), line("array").contains("24 mirrors"))
        };
        assert_eq!(line(&[]), ("stops        none".into(), true));
        assert_eq!(line(&["array 1"]), ("stops        none that reports show; unknown of array 1".into(), true));
        let (stops, has_mirrors) = line(&["mirrors", "array 1"]);
        assert!(stops.starts_with("stops        unknown: no array reports") && !has_mirrors, "{stops}");
    }

    #[test]
    fn a_stop_that_a_controller_alone_holds_is_in_the_text_the_json_and_the_problems() {
        let held = "withheld by the stop of anna (\"ladder\") since 12:00:00 UTC";
        let stops = stops(&RoomStops { held: Some(held.to_owned()), ..RoomStops::default() });
        assert_eq!(stops.len(), 1);
        let node = NodeFigures { node: "controller".into(), problem: held.into(), ..NodeFigures::default() };
        let array = ArrayFigures { arrays: 1, silent: vec!["mirrors".into()], ..ArrayFigures::default() };
        let figures = Figures { array, nodes: vec![node], ..Figures::default() };
        let status = RoomStatus { stops: stops.clone(), figures, ..RoomStatus::default() };
        let line = format!("\nstops        no array here reports a stop, and commands are {held}: ");
        assert!(status.to_string().contains(&line), "{status}");
        let json = serde_json::to_value(&status).expect("numbers, texts and lists");
        assert!(json["stops"][0].as_str().is_some_and(|stop| stop.contains(held)), "{json}");
        let problems = status.found();
        assert_eq!(problems.iter().filter(|problem| problem.contains(held)).collect::<Vec<_>>(), [&stops[0]]);
        let text = RoomStatus { problems, ..status }.to_string();
        assert_eq!(text.matches(held).count(), 1, "{text}");
        assert!(text.contains("\nstops        held, and no array here reports it\n"), "{text}");
    }

    #[test]
    fn the_row_of_the_stops_names_each_of_them_where_the_problems_have_the_rest() {
        let named = |source, operator: &str| RoomStop {
            name: StopName { source, sequence: 4 },
            operator: operator.to_owned(),
            reason: "ladder".to_owned(),
            arrays: vec![0],
            known: Duration::ZERO,
            stands_for_unlisted: false,
        };
        let held = vec![named(3, "anna"), named(5, "")];
        let room = RoomStops { stops: held, standings: vec![(0, Standing::Stopped)], ..RoomStops::default() };
        let (stops, in_force) = (stops(&room), in_force(&room));
        let status = RoomStatus { problems: stops.clone(), stops, in_force, ..RoomStatus::default() };
        let row = "\nstops        2 in force: 0000000000000003/4 of anna, 0000000000000005/4\n";
        assert!(status.to_string().contains(row), "{status}");
    }
}
