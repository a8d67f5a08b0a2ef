//! The texts of a controller's status: absent drivers, events of the tenure, refused reports.

use std::time::Duration;

use heliostat_core::{
    refusal::{Found, LastRefusal, LeftOut, Refusal, Stream, TelemetrySizes},
    tenure::{Tenure, TenureEvent},
};
use heliostat_proto::{NodeStatus, array_keys::array_name, takeover_reason};
use heliostat_service::duration::in_seconds;

use super::super::decision_loop::DecisionLoop;
use super::Problem;

/// Which commands reach no driver, in a room with this number of arrays.
pub(super) fn describe_absence(without_driver: &[usize], arrays: usize) -> String {
    let all = NodeStatus::NO_DRIVER;
    if without_driver.len() == arrays {
        return all.into();
    }
    let names: Vec<String> = without_driver.iter().map(|array| array_name(*array)).collect();
    format!("{all} to {}", names.join(" and "))
}

/// The most serious event of the tenure among those since the last snapshot. A takeover that proves contested in
/// the same time is one event. A controller that ends expects its successor.
pub(super) fn describe_events(rose: &[TenureEvent], tenure: &Tenure, is_ending: bool) -> Option<Problem> {
    let is_takeover = |event: TenureEvent| event == TenureEvent::TookOver;
    let event = rose.iter().copied().max_by_key(|event| (is_alarm(*event), is_takeover(*event)))?;
    if is_ending && event == TenureEvent::Superseded {
        return Some(Problem::End(describe_hand_over(tenure)));
    }
    let text = match rose.iter().any(|of| is_takeover(*of)) {
        true if event == TenureEvent::Contested => format!("{}. {LOOK_AFTER_CONTEST}", describe_takeover(tenure, true)),
        true if !is_takeover(event) => {
            format!("{}; {}", describe_takeover(tenure, false), describe_event(event, tenure))
        }
        _ => describe_event(event, tenure),
    };
    Some(match event {
        _ if is_alarm(event) => Problem::Alarm(text),
        TenureEvent::Resumed => Problem::End(text),
        // As ordered.
        TenureEvent::StoodBy if tenure.is_reserve => Problem::End(text),
        // At its first report a controller stands by beside a leader, as after a planned restart.
        TenureEvent::StoodBy => Problem::Notice(text),
        TenureEvent::TookOver if tenure.has_leader_ended() => Problem::End(text),
        TenureEvent::TookOver => Problem::Event(text),
        _ => Problem::Warning(text),
    })
}

/// The same problem; the takeover of a room, by this controller or from it, with the pause of this process before it.
pub(super) fn with_pause(problem: Problem, rose: &[TenureEvent], pause: Option<Duration>) -> Problem {
    let is_takeover = |event: &TenureEvent| matches!(event, TenureEvent::TookOver | TenureEvent::Superseded);
    // An orderly end of the former leader needs no other reason.
    let is_expected = matches!(problem, Problem::End(_));
    let Some(pause) = pause.filter(|_| !is_expected && rose.iter().any(is_takeover)) else { return problem };
    let pause = in_seconds(pause);
    problem.map(|text| {
        format!(
            "{text}; this process itself stood still for {pause} shortly before: look at the load of its host first"
        )
    })
}

/// Whether an event leaves the room without commands, or shows another sender.
fn is_alarm(event: TenureEvent) -> bool {
    use TenureEvent::{Resumed, StoodBy, Superseded, TookOver};
    !matches!(event, Resumed | StoodBy | Superseded | TookOver)
}

/// What to do about a contested takeover.
const LOOK_AFTER_CONTEST: &str = "Look for a slow controller, or a link that loses messages";

/// The end of a leader that another controller follows.
fn describe_hand_over(tenure: &Tenure) -> String {
    let (successor, epoch) = (tenure.followed_epoch().unwrap_or_default(), tenure.epoch());
    format!("this controller (epoch {epoch}) ends, and another one (epoch {successor}) has taken over")
}

/// A takeover with what is known of the former leader.
fn describe_takeover(tenure: &Tenure, is_contested: bool) -> String {
    let reason = takeover_reason(tenure.has_leader_ended(), is_contested);
    format!("this controller takes over with the new epoch {}: {reason}", tenure.epoch())
}

/// An event of the tenure, with what to do.
fn describe_event(event: TenureEvent, tenure: &Tenure) -> String {
    let epoch = tenure.epoch();
    match event {
        TenureEvent::Superseded => format!(
            "another controller (epoch {}) has superseded this one (epoch {epoch}), which stands by: it takes over when reports stay without an accepted command",
            tenure.followed_epoch().unwrap_or_default()
        ),
        TenureEvent::Resumed if tenure.followed_epoch().is_some_and(|followed| followed > epoch) => format!(
            "standby has ended: there is no telemetry, so this controller commands under its former epoch {epoch}; an array that follows a higher one refuses it"
        ),
        TenureEvent::Resumed => format!(
            "standby has ended: the array follows no higher epoch than {epoch}, or a calibration has given the mirrors back"
        ),
        TenureEvent::TookOver => describe_takeover(tenure, false),
        TenureEvent::LockedOut => format!(
            "the array refused every command for 1 s; the new epoch {epoch} is used. Look for another sender of commands in the room"
        ),
        TenureEvent::ForeignSequence => format!(
            "the array applied a command of this controller's epoch that it did not send; the new epoch {epoch} is used. Look for another sender of commands in the room"
        ),
        TenureEvent::ClocksDiffer => {
            "the array refused every command for 1 s as expired: synchronise the clocks of controller and driver".into()
        }
        TenureEvent::StoodBy => {
            let followed = match tenure.followed_epoch().filter(|epoch| *epoch > 0) {
                Some(epoch) => format!("the array follows another controller (epoch {epoch})"),
                None => "started with --standby".into(),
            };
            format!("{followed}: this one stands by, and takes over when reports stay without an accepted command")
        }
        TenureEvent::Contested => format!(
            "the takeover (epoch {epoch}) is contested: {}. {LOOK_AFTER_CONTEST}",
            takeover_reason(tenure.has_leader_ended(), true)
        ),
    }
}

/// The last refused report, with what to do.
pub(super) fn describe_refusal(decision_loop: &DecisionLoop) -> Option<String> {
    let inbox = decision_loop.room.controller().inbox();
    let LastRefusal { stream, array, refusal, found } = inbox.refused().last()?;
    let (name, owner) = match stream {
        Stream::Telemetry => (format!("telemetry of {}", array_name(array)), inbox.array_source(array)),
        _ => (stream.name().to_owned(), inbox.source()),
    };
    if let Some(of_user) = describe_user(found) {
        return Some(format!("{name} refused: {of_user}"));
    }
    Some(match (refusal, decision_loop.room.last_malformed()) {
        (Refusal::ForeignSource, _) if let Found::Source(source) = found => format!(
            "a second source {source:016x} reports {name} in this room, which source {:016x} owns; it is refused",
            owner.unwrap_or_default()
        ),
        (Refusal::WrongMirrorCount, _) if let Found::Sizes(TelemetrySizes { roll, yaw, expected }) = found => format!(
            "{name} refused: it has {roll} roll and {yaw} yaw angles, expected {expected} of each; \
             start its driver with the size that the scenario gives {}",
            array_name(array)
        ),
        (_, Some(error)) if refusal == Refusal::from(error) => format!("{name}: {error}"),
        (Refusal::Stale, _) if let Found::AgeS(age_s) = found => describe_stale(&name, age_s),
        (Refusal::FromFuture, _) if let Found::AgeS(age_s) = found => format!(
            "{name} refused: a report is {:.1} s ahead of this controller's clock; check the clocks of both",
            -age_s
        ),
        _ => format!("{name} refused: {}", refusal.name()),
    })
}

/// A report that is too old, with both causes: its age is the time on its way and the difference of two clocks.
fn describe_stale(name: &str, age_s: f64) -> String {
    format!(
        "{name} refused: a report is {age_s:.1} s old; it waited in a process that stood still, or the clocks of its \
         sender and of this controller differ"
    )
}

/// An announcement of this array by a source other than the one that is followed.
pub(super) fn describe_foreign_array(array: usize, source: u64, followed: Option<u64>) -> String {
    format!(
        "{}is refused: source {source:016x} announces {}, which source {:016x} drives; expected one driver of it: stop one of them",
        NodeStatus::FOREIGN_ARRAY,
        array_name(array),
        followed.unwrap_or_default()
    )
}

/// The user for whom a report is refused, with what to do.
fn describe_user(found: Found) -> Option<String> {
    match found {
        Found::User(left_out) => Some(format!("user {}: {}", left_out.user, describe_values(left_out))),
        Found::Twice(user) => Some(format!(
            "user {user} has two entries: expected one for each user; give each receiver a number of its own"
        )),
        Found::Gain { user, los_gain } => Some(format!(
            "user {user}: a gain of {los_gain:e}: expected 0 to 1, the received share of the light; check scale and \
             offset of the receiver"
        )),
        Found::Nothing | Found::Sizes(_) | Found::AgeS(_) | Found::Source(_) => None,
    }
}

/// The values for which a user is left out, with what to do.
fn describe_values(LeftOut { refusal, position_m: [x, y, z], values, .. }: LeftOut) -> String {
    match refusal {
        Refusal::OutsideRoom => format!(
            "({x:.1}, {y:.1}, {z:.1}) is outside the room: positions are in m, in the frame of the room; check unit and \
             axes of the tracker"
        ),
        _ => format!("{values}; correct it in the tracker"),
    }
}

/// A user of an accepted report who is left out.
pub(super) fn describe_left_out(left_out: LeftOut) -> String {
    format!("user {} is left out: {}", left_out.user, describe_values(left_out))
}

#[cfg(test)]
mod tests {
    use std::time::Instant;

    use heliostat_core::{refusal::UserValues, tenure::Evidence};
    use heliostat_proto::{EPOCH_SLOTS, Nanos, UserState};
    use heliostat_service::log_limit::LogLimit;

    use super::*;

    const INTERVAL: Nanos = 10_000_000;

    #[test]
    fn a_contested_takeover_is_an_alarm_with_the_reason_of_the_takeover() {
        let tenure = Tenure::live(2, INTERVAL);
        let problem = describe_events(&[TenureEvent::TookOver, TenureEvent::Contested], &tenure, false);
        let Some(Problem::Alarm(text)) = problem else { panic!("an alarm") };
        for part in ["takes over", takeover_reason(false, true), LOOK_AFTER_CONTEST] {
            assert!(text.contains(part), "{text}");
        }
    }

    #[test]
    fn a_takeover_names_the_pause_of_this_process_before_it_and_another_event_does_not() {
        use TenureEvent::{LockedOut, Superseded, TookOver};
        let tenure = Tenure::live(2, INTERVAL);
        let names_pause = |event: TenureEvent, pause: Option<Duration>| {
            let problem = describe_events(&[event], &tenure, false).expect("a problem");
            let problem = with_pause(problem, &[event], pause);
            problem
                .text()
                .contains("; this process itself stood still for 0.35 s shortly before: look at the load of its host")
        };
        let pause = Some(Duration::from_millis(350));
        assert_eq!([TookOver, Superseded, LockedOut].map(|event| names_pause(event, pause)), [true, true, false]);
        assert!(!names_pause(TookOver, None));
    }

    #[test]
    fn a_takeover_from_a_silent_leader_is_an_event() {
        let problem = describe_events(&[TenureEvent::TookOver], &Tenure::live(2, INTERVAL), false);
        let Some(Problem::Event(text)) = problem else { panic!("an event") };
        assert!(text.ends_with(takeover_reason(false, false)), "{text}");
    }

    #[test]
    fn a_takeover_after_the_end_of_the_leader_is_no_problem() {
        let (start, leader) = (1_000_000 * INTERVAL, 1);
        let mut tenure = Tenure::live(2, INTERVAL);
        tenure.handle_controller(leader, true);
        let following = Evidence { epoch: EPOCH_SLOTS + leader, accepted: 5, following: true, ..Evidence::default() };
        assert_eq!(tenure.handle_telemetry(start, following), None);
        assert_eq!(tenure.permit(start).1, Some(TenureEvent::StoodBy));
        tenure.handle_controller(leader, false);
        let mut events: Vec<TenureEvent> =
            (1..=3).filter_map(|step| tenure.permit(start + step * INTERVAL).1).collect();
        assert_eq!(events, [TenureEvent::TookOver]);
        let problem = describe_events(&events, &tenure, false).expect("an event");
        let pause = Some(Duration::from_millis(350));
        let Problem::End(text) = with_pause(problem, &events, pause) else { panic!("no problem") };
        assert!(text.ends_with(": the former leader has ended"), "{text}");
        events.push(TenureEvent::Contested);
        let Some(Problem::Alarm(text)) = describe_events(&events, &tenure, false) else { panic!("an alarm") };
        assert!(text.contains(takeover_reason(true, true)) && !text.contains("has ended"), "{text}");
    }

    #[test]
    fn a_standby_that_ends_without_telemetry_does_not_say_that_the_array_follows_no_higher_epoch() {
        let start = 1_000_000 * INTERVAL;
        let mut tenure = Tenure::live(2, INTERVAL);
        tenure.handle_telemetry(start, Evidence::default());
        let epoch = tenure.permit(start).0.expect("no other controller");
        let applied_sequence = tenure.next_sequence();
        let obeyed = Evidence { epoch, applied_sequence, accepted: 1, following: true, ..Evidence::default() };
        assert_eq!(tenure.handle_telemetry(start, obeyed), None);
        let higher = Evidence { epoch: epoch + EPOCH_SLOTS + 1, accepted: 2, ..obeyed };
        assert_eq!(tenure.handle_telemetry(start, higher), Some(TenureEvent::Superseded));
        let events: Vec<TenureEvent> = (1..200).filter_map(|step| tenure.permit(start + step * INTERVAL).1).collect();
        assert_eq!(events, [TenureEvent::Resumed]);
        let Some(Problem::End(text)) = describe_events(&events, &tenure, false) else { panic!("no problem") };
        assert!(text.starts_with("standby has ended: there is no telemetry"), "{text}");
    }

    #[test]
    fn a_standby_that_was_ordered_is_no_problem_and_one_at_a_start_beside_a_leader_is_a_notice() {
        let tenure = Tenure::live(2, INTERVAL);
        let found = |tenure: &Tenure| describe_events(&[TenureEvent::StoodBy], tenure, false);
        assert!(matches!(found(&tenure), Some(Problem::Notice(_))));
        assert!(matches!(found(&tenure.in_reserve(None)), Some(Problem::End(_))));
    }

    #[test]
    fn a_leader_that_ends_expects_its_successor_and_another_one_is_warned_of_it() {
        let tenure = Tenure::live(2, INTERVAL);
        let found = |is_ending| describe_events(&[TenureEvent::Superseded], &tenure, is_ending);
        let Some(Problem::Warning(text)) = found(false) else { panic!("a warning") };
        assert!(text.starts_with("another controller") && text.contains("has superseded this one"), "{text}");
        let Some(Problem::End(text)) = found(true) else { panic!("no problem") };
        assert!(text.contains("ends, and another one"), "{text}");
        // Another sender remains an alarm.
        let events = [TenureEvent::Superseded, TenureEvent::LockedOut];
        assert!(matches!(describe_events(&events, &tenure, true), Some(Problem::Alarm(_))));
    }

    #[test]
    fn a_report_that_is_refused_for_a_user_names_the_user_and_what_to_do() {
        let state = UserState { user: 3, position_m: [40.0, 0.0, 1.0], ..UserState::default() };
        let values = UserValues { speed_m_s: 101.0, ..UserValues::from(&state) };
        let left_out = LeftOut { user: 3, refusal: Refusal::OutsideRoom, position_m: state.position_m, values };
        let cases = [
            (Found::User(left_out), "user 3: (40.0, 0.0, 1.0) is outside the room", "unit and axes of the tracker"),
            (
                Found::User(LeftOut { refusal: Refusal::Implausible, ..left_out }),
                "user 3: a speed of 101",
                "correct it",
            ),
            (Found::Twice(3), "user 3 has two entries", "a number of its own"),
            (Found::Gain { user: 3, los_gain: 1.5 }, "user 3: a gain of 1.5e0: expected 0 to 1", "the receiver"),
        ];
        for (found, start, remedy) in cases {
            let text = describe_user(found).expect("a user");
            assert!(text.starts_with(start) && text.contains(remedy), "{text}");
        }
        assert_eq!(describe_user(Found::Nothing), None);
        let text = describe_left_out(left_out);
        assert!(text.starts_with("user 3 is left out: (40.0, 0.0, 1.0) is outside the room"), "{text}");
    }

    #[test]
    fn an_old_report_has_waited_or_the_clocks_differ() {
        let text = describe_stale("users", 0.52);
        assert!(text.starts_with("users refused: a report is 0.5 s old; it waited in a process"), "{text}");
        assert!(text.ends_with("or the clocks of its sender and of this controller differ"), "{text}");
    }

    #[test]
    fn the_announcements_of_a_second_driver_name_both_and_are_one_line_in_ten_seconds() {
        let text = describe_foreign_array(0, 0xa, Some(0xb));
        assert!(
            text.contains("source 000000000000000a announces mirrors, which source 000000000000000b drives"),
            "{text}"
        );
        let (mut limit, now) = (LogLimit::default(), Instant::now());
        assert!(limit.line(now, &text, 1).is_some());
        assert_eq!(limit.line(now, &text, 2), None);
    }
}
