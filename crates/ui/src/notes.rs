//! What is wrong in a room and lasts, in words: each note says what to do.

mod demo;
mod present;

use std::time::{Duration, Instant};

use heliostat_proto::array_keys::array_name;
use heliostat_proto::gauges::ServedLight;
use heliostat_proto::{NodeKind, NodeStatus};
use heliostat_service::printable::printable;

use crate::causes::{
    AND, NO_DRIVER, NO_POSITIONS, NO_SIMULATED_POSITIONS, OTHERS_MISSING, STANDBY_MISSING, TWO_DRIVERS, causes_first,
};
use crate::controllers::{ControllerFigures, Role, refusal_of};
use crate::error::CHECK_REACH;
use crate::view::{Dated, EXPIRY, Received};

pub(crate) use demo::in_demo;

/// Telemetry of this age shows that an array is present, even without a process that is known.
pub(crate) const REPORTING: Duration = Duration::from_secs(1);

/// Time after its last process has left within which the last messages of a room get old. Some follow the token.
const ENDING: Duration = EXPIRY.saturating_add(Duration::from_secs(1));

impl Received {
    /// The lasting faults of a room with so many arrays, the most serious first. `opened` is the start of
    /// the viewer: a process that has not answered yet is missing only some seconds later.
    fn notes(&self, arrays: usize, opened: Instant) -> Vec<String> {
        let is_settled = opened.elapsed() > EXPIRY;
        if let Some(unseen) = self.unseen().filter(|_| is_settled) {
            return vec![unseen];
        }
        let mut notes: Vec<String> = self.arrays.shared().into_iter().map(two_drivers).collect();
        notes.extend(self.others_missing().filter(|_| is_settled).map(String::from));
        if is_settled && self.is_controller_unseen() {
            notes.push(UNSEEN_CONTROLLER.into());
        } else if is_settled && !self.is_controller_alive() && !self.arrays.are_newly_commanded() {
            notes.extend(self.without_controller().map(String::from));
        }
        if let Some(status) = self.fresh_status(NodeKind::Controller.name()) {
            notes.extend(absent_drivers(status, arrays, self.arrays.at().is_some()));
            notes.extend(ServedLight::all_of(status).iter().filter_map(off_light));
        }
        let controllers = self.present_controllers();
        notes.extend(controllers.iter().filter_map(refusing_standby));
        notes.extend(self.telemetry_ages.problems(Instant::now()));
        let is_old = |at: Option<Instant>| at.unwrap_or(opened).elapsed() > EXPIRY;
        if is_old(arrival(&self.truth)) && is_old(arrival(&self.users)) {
            notes.push(if controllers.iter().any(|one| one.is_deciding) {
                format!("{UNSEEN_REPORTS}: connect to the tracker, or to the router of the room, too")
            } else if self.is_simulated() {
                simulator_silent()
            } else {
                let again = if self.users.is_some() { AGAIN } else { "" };
                format!("{NO_POSITIONS}: start the tracker or the simulator{again}")
            });
        }
        notes.extend(self.standby_missing(&controllers).map(String::from));
        notes
    }

    /// [`notes`](Self::notes) with those about geometries.
    pub(crate) fn notes_with(&self, of_geometry: Vec<String>, arrays: usize, opened: Instant) -> Vec<String> {
        causes_first(self.notes(arrays, opened), of_geometry)
    }

    /// What is to be said of a room of which no process but viewers is seen, and no recent message.
    pub(crate) fn unseen(&self) -> Option<String> {
        let messages = [self.arrays.at(), arrival(&self.users), arrival(&self.truth)];
        let is_recent = |at: &Option<Instant>| at.is_some_and(|at| at.elapsed() < EXPIRY);
        if self.has_processes() || messages.iter().any(is_recent) {
            return None;
        }
        Some(if messages.iter().any(Option::is_some) { ROOM_GONE.into() } else { room_unseen(self.rooms.absent()) })
    }

    /// What is to be said of a room of which one controller alone is seen, which sees no driver and no position reports
    /// either.
    pub(crate) fn others_missing(&self) -> Option<&'static str> {
        let mut present = self.present_controllers();
        present.retain(|one| one.role != Role::Silent);
        let is_alone = matches!(&present[..], [one] if one.role != Role::Calibrates && !one.is_deciding);
        let is_tracked = self.alive.iter().any(|(node, _)| *node == NodeKind::Tracker.name()) || self.has_users();
        let status = self.fresh_status(NodeKind::Controller.name());
        let is_driverless = status.is_some_and(|status| status.counters.iter().any(is_driver_absent));
        (is_alone && is_driverless && !is_tracked && !self.is_array_present()).then_some(OTHERS_MISSING)
    }

    /// That the displayed controller has no standby any longer. Another controller that this process sees has not gone: it
    /// has no link to the displayed one, or is silent and named as such.
    fn standby_missing(&self, controllers: &[ControllerFigures]) -> Option<&'static str> {
        let status = self.fresh_status(NodeKind::Controller.name())?;
        let is_missing = status.counter(NodeStatus::STANDBY_MISSING).is_some_and(|missing| missing > 0);
        let seen = controllers.iter().filter(|one| one.role != Role::Calibrates).count();
        (is_missing && seen < 2).then_some(STANDBY_MISSING)
    }

    /// What is missing in a room without a controller.
    fn without_controller(&self) -> Option<&'static str> {
        // The tokens end before the messages are old: the processes of the room have ended together.
        let is_ending = !self.has_processes() && self.left_at.is_some_and(|at| at.elapsed() < ENDING);
        let is_array_gone = !self.is_array_present() && self.arrays.at().is_some();
        match (is_ending, is_array_gone) {
            (true, _) => None,
            (false, true) => Some(ARRAY_GONE),
            (false, false) => Some(NO_CONTROLLER),
        }
    }

    /// Whether an array accepts commands, and no controller or calibration is seen that sends them. Those that it
    /// accepted lately may be of a controller that has just left, and the first ones of a controller that has just
    /// started: its commands arrive at the array before its token arrives here.
    pub(crate) fn is_controller_unseen(&self) -> bool {
        let is_seen = self.is_controller_alive() || self.fresh_status(NodeKind::Controller.name()).is_some();
        let is_commanded = self.arrays.are_commanded() && !self.arrays.are_newly_commanded();
        is_commanded && (!is_seen || self.stand_by_for_unseen())
    }
}

fn arrival<T>(message: &Dated<T>) -> Option<Instant> {
    message.as_ref().map(|(at, _)| *at)
}

/// The notes of a viewer that has lost its router: the other ones would state what it no longer sees. `reason` is why it
/// does not connect again, where that is known.
pub(crate) fn without_router(router: &str, reason: Option<String>) -> Vec<String> {
    let lost = format!("this page has lost its connection to {router}: what follows is the last that it saw");
    [lost].into_iter().chain(reason).collect()
}

/// The note of a room of which nothing was seen so far. `absent` is that other rooms are seen, with their names.
pub(crate) fn room_unseen(absent: Option<String>) -> String {
    let seen = absent.map_or_else(|| "no process of this room answers: ".to_owned(), |absent| absent + "; ");
    format!("{seen}{CHECK_REACH}, or start a driver or a simulator, and a controller")
}

/// The note of a simulated room whose positions do not come.
pub(crate) fn simulator_silent() -> String {
    format!("{NO_SIMULATED_POSITIONS}: start it{AGAIN}")
}

/// End of the advice to start a process that was seen before.
pub(crate) const AGAIN: &str = " again, or restart it if it hangs";
/// The note of a room that was seen before.
const ROOM_GONE: &str = "no process of this room answers any longer: its driver or simulator has ended or hangs, or the connection to it has ended; start it again";
const ARRAY_GONE: &str = "no array answers any longer, and no controller: start its driver or the simulator again, or restart it if it hangs; then heliostat controller";
const NO_CONTROLLER: &str = "no controller commands the mirrors: start one with heliostat controller";
/// Beginning of the note about position reports that reach the controller, and not this process.
pub(crate) const UNSEEN_REPORTS: &str = "no position reports reach this viewer, but the controller decides on them";
/// The note about commands that reach the array from a controller that this process does not see.
pub(crate) const UNSEEN_CONTROLLER: &str = "a controller or a calibration commands the mirrors, but its messages do not reach this viewer: connect to it, or to the router of the room, too";

fn off_light(light: &ServedLight) -> Option<String> {
    light.off_since_s.map(|_| printable(&format!("{light}: {}", light.advice())).into_owned())
}

/// The beginning of the note about a controller of this name that does not lead, and refuses the reports.
fn standby_refuses(name: &str) -> String {
    format!("controller {name} refuses the reports (")
}

/// Whether a note states this problem of the controller of this name, which stands by and refuses the reports.
pub(crate) fn is_of_standby(notes: &[String], name: &str, problem: &str) -> bool {
    let start = standby_refuses(name);
    refusal_of(problem).is_some() && notes.iter().any(|note| note.starts_with(&start))
}

/// The note about a controller that does not lead, and refuses each position report. One with a wrong clock may refuse
/// telemetry too, and then never knows that it has to stand by.
fn refusing_standby(ControllerFigures { name, role, refuses, .. }: &ControllerFigures) -> Option<String> {
    let is_refusing = matches!(role, Role::StandsBy | Role::Unfollowed) && !refuses.is_empty();
    is_refusing.then(|| format!("{}{refuses}): it could not take over", standby_refuses(name)))
}

/// The note about an array that two processes drive.
pub(crate) fn two_drivers((array, [one, other]): (usize, [u64; 2])) -> String {
    format!(
        "{TWO_DRIVERS} ({}, sources {one:016x} and {other:016x}): stop one of them, because the controller follows only one",
        array_name(array)
    )
}

/// Whether this counter of a controller shows that commands reach no driver.
fn is_driver_absent((name, count): &(String, u64)) -> bool {
    name == NodeStatus::DRIVER_ABSENT && *count > 0
}

/// Which commands reach no driver, by the status of a controller of so many arrays. A driver that was seen may hang.
fn absent_drivers(status: &NodeStatus, arrays: usize, was_seen: bool) -> Option<String> {
    let again = if was_seen { AGAIN } else { "" };
    let (_, absent) = status.counters.iter().find(|counter| is_driver_absent(counter))?;
    let name =
        |(name, _): &(String, u64)| Some(name.strip_prefix(NodeStatus::DRIVER_ABSENT)?.strip_prefix(':')?.to_owned());
    let names: Vec<String> = status.counters.iter().filter_map(name).collect();
    if names.is_empty() || *absent == arrays as u64 {
        return Some(format!("{NO_DRIVER}: start a driver or a simulator{again}"));
    }
    Some(format!("{NO_DRIVER} to {}: start its driver{again}", printable(&names.join(AND))))
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use heliostat_bus::Presence;
    use heliostat_proto::{Counters, MirrorTelemetry, RoomTruth, Stamp, UserReport};

    use super::*;
    use crate::causes::{causes_and_others, follows_from};

    fn ago(seconds: u64) -> Instant {
        Instant::now() - Duration::from_secs(seconds)
    }

    fn telemetry(received: &mut Received, source: u64) {
        let stamp = Stamp { source, ..Stamp::default() };
        received.arrays.note(0, MirrorTelemetry { stamp, ..MirrorTelemetry::default() });
    }

    /// A room in which user reports arrive and the array accepts commands.
    fn commanded() -> Received {
        let mut received = Received::default();
        for accepted in [5, 6] {
            let counters = Counters { accepted, ..Counters::default() };
            received.arrays.note(0, MirrorTelemetry { epoch: 500, counters, ..MirrorTelemetry::default() });
        }
        received.users = Some((Instant::now(), UserReport::default()));
        received
    }

    /// The status of a controller with one counter.
    fn counting(source: u64, counter: &str, count: u64) -> NodeStatus {
        let stamp = Stamp { source, ..Stamp::default() };
        let counters = vec![(counter.to_owned(), count)];
        NodeStatus { stamp, node: NodeKind::Controller, counters, ..NodeStatus::default() }
    }

    /// The status of a controller that is in the room and displayed.
    fn display(received: &mut Received, status: NodeStatus) {
        received.alive.insert((NodeKind::Controller.name(), status.stamp.source));
        received.controllers.take(&status);
        received.statuses.insert(NodeKind::Controller.name().into(), (Instant::now(), status));
    }

    #[test]
    fn each_missing_process_is_named_with_what_to_start() {
        let mut received = Received::default();
        assert_eq!(received.notes(1, ago(0)), Vec::<String>::new(), "processes may answer yet");
        let empty = received.notes(1, ago(60));
        assert_eq!(empty, [room_unseen(None)]);
        received.alive.insert((NodeKind::Viewer.name(), 3));
        assert!(received.unseen().is_some(), "a viewer is no process of the room");
        received.alive.insert((NodeKind::Driver.name(), 4));
        let missing = received.notes(1, ago(60));
        assert!(missing[0].starts_with("no controller commands the mirrors: start one"), "{missing:?}");
        assert!(missing[1].starts_with("no process reports the positions of users: start"), "{missing:?}");
        received.alive.insert((NodeKind::Controller.name(), 5));
        received.users = Some((Instant::now(), UserReport::default()));
        assert_eq!(received.notes(1, ago(60)), Vec::<String>::new());
    }

    #[test]
    fn a_standby_that_has_gone_is_noted_once() {
        let mut received = commanded();
        let status = |missing| counting(5, NodeStatus::STANDBY_MISSING, missing);
        display(&mut received, status(0));
        assert_eq!(received.notes(1, ago(60)), [""; 0]);
        display(&mut received, status(1));
        assert_eq!(received.notes(1, ago(60)), [STANDBY_MISSING]);
        // Every other note is more serious.
        received.users = None;
        assert_eq!(received.notes(1, ago(60)).last().map(String::as_str), Some(STANDBY_MISSING));
        received.users = Some((Instant::now(), UserReport::default()));
        // Another one is here, and has no link to this controller.
        received.controllers.take(&counting(6, NodeStatus::STANDBY, 1));
        received.alive.insert((NodeKind::Controller.name(), 6));
        assert_eq!(received.notes(1, ago(60)), [""; 0]);
        // One that hangs has a line of its own.
        received.controllers.age(Duration::from_secs(60));
        display(&mut received, status(1));
        assert_eq!(received.notes(1, ago(60)), [""; 0]);
    }

    #[test]
    fn a_controller_that_the_array_follows_and_this_viewer_does_not_see_is_not_missing() {
        let mut received = commanded();
        let notes = received.notes(1, ago(60));
        assert_eq!(notes, [UNSEEN_CONTROLLER]);
        let status = NodeStatus { node: NodeKind::Controller, ..NodeStatus::default() };
        received.statuses.insert(NodeKind::Controller.name().into(), (Instant::now(), status));
        received.alive.insert((NodeKind::Driver.name(), 4));
        let notes = received.notes(1, ago(60));
        assert_eq!(notes, [NO_CONTROLLER], "it has just left");
    }

    #[test]
    fn a_controller_that_starts_is_not_called_unseen_before_its_token_can_arrive() {
        let mut received = commanded();
        received.alive.insert((NodeKind::SimNode.name(), 4));
        // It was killed a minute ago.
        received.arrays.age(Duration::from_secs(60));
        assert_eq!(received.notes(1, ago(60)), [NO_CONTROLLER]);
        let mut follow = |accepted| {
            let counters = Counters { accepted, ..Counters::default() };
            received.arrays.note(0, MirrorTelemetry { epoch: 501, counters, ..MirrorTelemetry::default() });
            let found = (received.is_controller_unseen(), received.notes(1, ago(60)));
            received.arrays.age(Duration::from_millis(500));
            found
        };
        assert_eq!(follow(7), (false, Vec::new()), "its first command");
        assert_eq!(follow(8), (false, Vec::new()));
        for accepted in 9..14 {
            follow(accepted);
        }
        let last = follow(14);
        assert_eq!(last, (true, vec![UNSEEN_CONTROLLER.to_owned()]), "its token has had the time to arrive");
    }

    #[test]
    fn where_one_controller_alone_is_seen_and_sees_nothing_a_cut_link_is_named_as_a_cause() {
        let mut received = Received::default();
        let status = |source, absent| counting(source, "driver_absent", absent);
        display(&mut received, status(5, 0));
        assert_eq!(received.others_missing(), None, "the controller sees a driver that this viewer does not");
        display(&mut received, status(5, 1));
        assert_eq!(received.others_missing(), Some(OTHERS_MISSING));
        assert_eq!(received.notes(1, ago(60))[0], OTHERS_MISSING, "before what to start");
        assert_eq!(received.notes(1, ago(0)).iter().filter(|note| *note == OTHERS_MISSING).count(), 0);
        let (causes, others) = causes_and_others(["another note".to_owned(), OTHERS_MISSING.to_owned()]);
        assert_eq!((causes, others), (vec![OTHERS_MISSING.to_owned()], vec!["another note".to_owned()]));
        received.users = Some((Instant::now(), UserReport::default()));
        assert_eq!(received.others_missing(), None, "position reports arrive");
        received.users = None;
        display(&mut received, status(6, 1));
        assert_eq!(received.others_missing(), None, "another controller is seen");
    }

    #[test]
    fn a_process_that_was_seen_and_is_silent_may_hang() {
        let status = counting(5, "driver_absent", 1);
        let advice = |was_seen| absent_drivers(&status, 1, was_seen).expect("a note");
        let start = "no driver receives the commands: start a driver or a simulator";
        assert_eq!([advice(false), advice(true)], [start.to_owned(), format!("{start}{AGAIN}")]);
        let mut received = Received::default();
        received.alive.insert((NodeKind::Controller.name(), 5));
        let start = "no process reports the positions of users: start the tracker or the simulator";
        assert_eq!(received.notes(1, ago(60)), [start]);
        received.users = Some((ago(60), UserReport::default()));
        assert_eq!(received.notes(1, ago(60)), [format!("{start}{AGAIN}")]);
        received.truth = Some((ago(60), RoomTruth::default()));
        let of_simulator = format!("{NO_SIMULATED_POSITIONS}: start it{AGAIN}");
        assert_eq!(received.notes(1, ago(60)), [of_simulator.as_str()], "both came from one process");
        let stamp = Stamp { source: 9, ..Stamp::default() };
        received.users = Some((ago(60), UserReport { stamp, ..UserReport::default() }));
        assert_eq!(received.notes(1, ago(60)), [format!("{start}{AGAIN}")], "a tracker came after the simulator");
    }

    #[test]
    fn a_viewer_without_its_router_says_so_alone_with_the_reason_if_it_is_known() {
        let lost = "this page has lost its connection to tls/one:7448: what follows is the last that it saw";
        let notes = |reason: Option<&str>| without_router("tls/one:7448", reason.map(str::to_owned));
        assert_eq!(notes(None), [lost]);
        assert_eq!(notes(Some("its certificate has expired")), [lost, "its certificate has expired"]);
    }

    #[test]
    fn a_calibration_that_this_viewer_does_not_see_commands_in_place_of_the_controller() {
        let mut received = commanded();
        let status = counting(7, "standby", 1);
        display(&mut received, status);
        assert!(received.is_controller_unseen());
        assert_eq!(received.notes(1, ago(60)), [UNSEEN_CONTROLLER]);
    }

    #[test]
    fn where_the_process_of_the_room_has_ended_no_controller_is_asked_for_unless_messages_go_on() {
        let mut received = Received::default();
        for presence in [Presence::Alive, Presence::Gone] {
            received.take_presence((NodeKind::SimNode.name(), 7), presence);
        }
        received.users = Some((Instant::now(), UserReport::default()));
        assert_eq!(received.notes(1, ago(60)), [""; 0], "its last messages are fresh");
        received.users = Some((ago(60), UserReport::default()));
        assert_eq!(received.notes(1, ago(60)), [ROOM_GONE]);
        let status = NodeStatus { node: NodeKind::Driver, ..NodeStatus::default() };
        received.statuses.insert(NodeKind::Driver.name().into(), (Instant::now(), status));
        received.users = Some((Instant::now(), UserReport::default()));
        received.left_at = Some(ago(60));
        assert_eq!(received.notes(1, ago(60)), [NO_CONTROLLER], "of processes whose tokens are not seen");
    }

    #[test]
    fn where_the_array_alone_has_ended_it_is_asked_for_first() {
        let mut received = Received::default();
        received.alive.insert((NodeKind::Tracker.name(), 6));
        received.users = Some((Instant::now(), UserReport::default()));
        telemetry(&mut received, 7);
        assert_eq!(received.notes(1, ago(60)), [NO_CONTROLLER]);
        received.arrays.age(REPORTING);
        assert_eq!(received.notes(1, ago(60)), [ARRAY_GONE]);
    }

    #[test]
    fn a_tracker_whose_reports_reach_the_controller_is_not_missing() {
        let mut received = Received::default();
        received.alive.insert((NodeKind::Controller.name(), 5));
        for decisions in [20, 40] {
            received.controllers.take(&counting(5, "decisions", decisions));
        }
        let notes = received.notes(1, ago(60));
        assert!(notes.len() == 1 && notes[0].starts_with(UNSEEN_REPORTS), "{notes:?}");
    }

    #[test]
    fn a_standby_that_refuses_each_report_is_noted_and_its_own_problem_is_not_repeated() {
        let mut received = Received::default();
        let reason = "a report is 5.0 s ahead of this controller's clock; check the clocks of both";
        let mut noted = |standby, refused| {
            let last_problem = format!("users refused: {reason}");
            let mut status = NodeStatus { last_problem, ..counting(7, "refused:users:from-future", refused) };
            status.counters.push(("standby".to_owned(), standby));
            received.alive.extend([(NodeKind::Controller.name(), 7), (NodeKind::Tracker.name(), 8)]);
            received.users = Some((Instant::now(), UserReport::default()));
            received.controllers.take(&status);
            received.notes(1, ago(60))
        };
        assert_eq!(noted(1, 5), [""; 0], "they may be old");
        let notes = noted(1, 6);
        let note = format!("controller 0000000000000007 refuses the reports ({reason}): it could not take over");
        assert_eq!(notes, [note]);
        let is_stated = |name: &str, problem: &str| is_of_standby(&notes, name, problem);
        let problem = format!("users refused: {reason}");
        assert!(is_stated("0000000000000007", &problem));
        assert!(!is_stated("0000000000000009", &problem), "of the leader, which refuses them too");
        assert!(!is_stated("0000000000000007", "the array receives no commands"));
        assert_eq!(noted(0, 7), [""; 0], "the problem of a leader is shown as its own");
        let with_role = |role| ControllerFigures { role, refuses: reason.into(), ..ControllerFigures::default() };
        let is_noted = |role| refusing_standby(&with_role(role)).is_some();
        assert_eq!([Role::StandsBy, Role::Unfollowed, Role::Leads].map(is_noted), [true, true, false]);
    }

    #[test]
    fn light_that_is_off_is_noted_with_what_to_do_while_it_lasts() {
        let mut received = Received::default();
        received.alive.insert((NodeKind::Controller.name(), 5));
        let mut noted = |off_since_s| {
            let light = |of: &str, ratio, off_since_s| ServedLight { of: of.into(), ratio, off_since_s };
            let all = [light("led-1", 0.6, off_since_s), light("mirrors", 1.0, None)];
            let gauges = all.iter().flat_map(ServedLight::gauges).collect();
            let status = NodeStatus { node: NodeKind::Controller, gauges, ..NodeStatus::default() };
            received.statuses.insert(NodeKind::Controller.name().into(), (Instant::now(), status));
            received.notes(1, ago(0))
        };
        let notes = noted(Some(3.0));
        assert!(notes.len() == 1 && notes[0].starts_with("LED 1 brings 0.60 of the expected light: look"), "{notes:?}");
        assert_eq!(noted(None), Vec::<String>::new());
    }

    #[test]
    fn a_second_tracker_is_not_explained_by_two_drivers() {
        let notes = [two_drivers((0, [7, 8]))];
        let second = |name| format!("a second source 09 reports {name} in this room, which source 07 owns");
        assert!(follows_from(&notes, &second("telemetry of mirrors")) && !follows_from(&notes, &second("users")));
        assert!(!follows_from(&[], &second("telemetry of mirrors")));
    }

    #[test]
    fn two_drivers_of_one_array_are_noted_and_a_restarted_driver_is_not() {
        let mut received = Received::default();
        received.alive.insert((NodeKind::Controller.name(), 5));
        for source in [7, 7, 8, 8] {
            telemetry(&mut received, source);
        }
        assert_eq!(received.notes(1, ago(0)), Vec::<String>::new(), "the second replaces the first");
        telemetry(&mut received, 7);
        let notes = received.notes(1, ago(0));
        let expected = "two drivers serve one array (mirrors, sources 0000000000000007 and 0000000000000008): stop one";
        assert!(notes.len() == 1 && notes[0].starts_with(expected), "{notes:?}");
    }
}
