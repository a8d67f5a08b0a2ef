//! The emergency stop as the page shows it: only the reports of the arrays confirm a stop or a release.

use std::time::{Duration, Instant};

use heliostat_proto::StopName;
use heliostat_proto::reported_stops::{RoomStop, Standing};
use heliostat_service::printable::printable;
use serde::Serialize;

use crate::stop_watch::RoomStops;

/// After this time without a confirmation, the page warns.
const CONFIRM_LIMIT: Duration = Duration::from_secs(1);
/// A release is shown this long.
const RELEASED_SHOWN: Duration = Duration::from_secs(8);

/// How far a stop has come.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum StopPhase {
    /// No stop.
    #[default]
    None,
    /// Ordered less than a second ago, and never confirmed.
    Requested,
    /// Held for more than a second or confirmed before, and not confirmed by every array for which it is held.
    Unconfirmed,
    /// Every array for which a stop is held reports that its device has executed it.
    Confirmed,
    /// The last stop ended some seconds ago.
    Released,
}

/// A stop that is held or in force.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct StopFigure {
    /// Its name, as an order to re-arm repeats it.
    pub name: String,
    /// Name of the operator who ordered it.
    pub operator: String,
    /// The operator's reason.
    pub reason: String,
    /// Time in s for which the page knows of it.
    pub age_s: f64,
    /// Indices of the arrays for which it is held.
    pub arrays: Vec<usize>,
    /// Indices of those that have stopped.
    pub stopped: Vec<usize>,
}

impl StopFigure {
    /// The stops of a room.
    pub(crate) fn of(room: &RoomStops) -> Vec<Self> {
        let has_stopped = |array: &usize| room.standings.contains(&(*array, Standing::Stopped));
        let figure = |stop: &RoomStop| Self {
            name: stop.name.to_string(),
            operator: printable(&stop.operator).into_owned(),
            reason: printable(&stop.reason).into_owned(),
            age_s: room.now.saturating_sub(stop.known).as_secs_f64(),
            arrays: stop.arrays.clone(),
            stopped: stop.arrays.iter().copied().filter(has_stopped).collect(),
        };
        room.stops.iter().map(figure).collect()
    }
}

/// The emergency stop.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct StopFigures {
    /// How far it has come.
    pub phase: StopPhase,
    /// Time in this phase in s; for an unconfirmed stop, the time since the order, or since the last confirmation.
    pub since_s: f64,
    /// Age in s of the oldest telemetry of the arrays that confirm the stop; absent without one.
    pub report_age_s: Option<f64>,
    /// All stops, in the order in which they became known.
    pub stops: Vec<StopFigure>,
    /// The stops that a controller alone holds, for arrays that do not report, in the words of its state.
    pub held: Option<String>,
    /// What is open, array by array, and which stops are not recorded.
    pub problems: Vec<String>,
    /// Indices of the arrays that no stop holds while one holds another array.
    pub free: Vec<usize>,
    /// The lost drivers that confirm no release, in words: those at the end of the stop while it is shown as released.
    pub lost: Vec<String>,
}

/// Follows the phases of a stop.
#[derive(Debug, Default)]
pub(crate) struct StopState {
    /// The present phase of a stop, and its beginning.
    phase: Option<(StopPhase, Instant)>,
    /// When a stop was first held without a confirmation.
    open: Option<Instant>,
    /// The stops that were held at the last confirmation.
    confirmed: Vec<StopName>,
    /// Whether a controller alone holds the stop: no array confirms its end.
    is_unreported: bool,
    /// The lost drivers while a stop was held last, in words: controllers forget them at the release.
    lost: Vec<String>,
}

impl StopState {
    /// The stop at this instant.
    pub fn update(&mut self, room: &RoomStops) -> StopFigures {
        let now = Instant::now();
        let since = |at: Instant| now.saturating_duration_since(at);
        let is_held = room.is_held() || room.ordered.is_some();
        let is_unreported = room.held.is_some() && room.ordered.is_none();
        let was_unreported = std::mem::replace(&mut self.is_unreported, is_unreported);
        if is_held {
            self.lost.clone_from(&room.unreleased_lost);
        }
        let is_confirmed = is_held && room.is_confirmed();
        self.open = if is_held && !is_confirmed { self.open.or(Some(now)) } else { None };
        match (is_held, is_confirmed) {
            (true, true) => self.confirmed = room.stops.iter().map(|stop| stop.name).collect(),
            (true, false) => {}
            (false, _) => self.confirmed.clear(),
        }
        // A further stop begins its own second.
        let is_known = room.stops.iter().all(|stop| self.confirmed.contains(&stop.name));
        let was_confirmed = is_known && !self.confirmed.is_empty();
        // A lost confirmation is open from its loss on, not from the order.
        let ordered = room.ordered.filter(|_| !was_confirmed);
        let phase = match (is_held, is_confirmed) {
            (true, true) => Some(StopPhase::Confirmed),
            (true, false) => {
                let begun = ordered.or(self.open).unwrap_or(now);
                let is_new = !was_confirmed && since(begun) < CONFIRM_LIMIT;
                Some(if is_new { StopPhase::Requested } else { StopPhase::Unconfirmed })
            }
            (false, _) if was_unreported => None,
            (false, _) => match self.phase {
                Some((StopPhase::Released, at)) if since(at) >= RELEASED_SHOWN => None,
                Some(_) => Some(StopPhase::Released),
                None => None,
            },
        };
        self.phase = phase.map(|phase| match self.phase {
            Some((before, at)) if before == phase => (phase, at),
            _ => (phase, now),
        });
        let Some((phase, at)) = self.phase else { return StopFigures::default() };
        let begun = if phase == StopPhase::Unconfirmed { ordered.or(self.open).unwrap_or(at) } else { at };
        StopFigures {
            phase,
            since_s: since(begun).as_secs_f64(),
            report_age_s: room.report_age.filter(|_| is_confirmed).map(|age| age.as_secs_f64()),
            stops: StopFigure::of(room),
            held: room.held.clone(),
            problems: room.problems(),
            free: room.free(),
            lost: self.lost.clone(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ago(ms: u64) -> Instant {
        Instant::now() - Duration::from_millis(ms)
    }

    /// A room with a stop, of which the second array has this standing.
    fn room(ordered_ms: Option<u64>, second: Standing) -> RoomStops {
        let now = Duration::from_millis(ordered_ms.unwrap_or(0));
        let (name, operator, reason) = (StopName { source: 3, sequence: 4 }, "ann".to_owned(), "test".to_owned());
        let (arrays, known) = (vec![0, 1], Duration::ZERO);
        RoomStops {
            now,
            stops: vec![RoomStop { name, operator, reason, arrays, known, stands_for_unlisted: false }],
            held: None,
            standings: vec![(0, Standing::Stopped), (1, second)],
            unrecorded: Vec::new(),
            unreleased_lost: Vec::new(),
            report_age: Some(Duration::from_millis(10)),
            ordered: ordered_ms.map(ago),
            has_geometry: true,
            is_heard: true,
        }
    }

    #[test]
    fn an_order_is_requested_then_unconfirmed_until_every_array_has_stopped() {
        let mut state = StopState::default();
        assert_eq!(state.update(&RoomStops::default()).phase, StopPhase::None);
        assert_eq!(state.update(&room(Some(100), Standing::Silent)).phase, StopPhase::Requested);
        let figures = state.update(&room(Some(1500), Standing::Silent));
        assert_eq!(
            (figures.phase, figures.problems),
            (StopPhase::Unconfirmed, vec!["array 1 does not answer: cut its power".to_owned()])
        );
        for standing in [Standing::Moving, Standing::Unknown, Standing::Latched { problem: "no link".into() }] {
            assert_eq!(state.update(&room(Some(1500), standing)).phase, StopPhase::Unconfirmed);
        }
        let figures = state.update(&room(Some(1500), Standing::Stopped));
        assert_eq!((figures.phase, figures.stops[0].name.as_str()), (StopPhase::Confirmed, "0000000000000003/4"));
        assert_eq!(state.update(&RoomStops::default()).phase, StopPhase::Released);
    }

    #[test]
    fn a_stop_that_loses_its_confirmation_is_not_requested_again() {
        let mut state = StopState::default();
        assert_eq!(state.update(&room(Some(5000), Standing::Stopped)).phase, StopPhase::Confirmed);
        let lost = state.update(&room(Some(5000), Standing::Silent));
        assert!(lost.phase == StopPhase::Unconfirmed && lost.since_s < 5.0, "{lost:?}");
        state.update(&RoomStops::default());
        assert_eq!(state.update(&room(Some(100), Standing::Silent)).phase, StopPhase::Requested, "another stop");
    }

    #[test]
    fn a_room_of_an_unknown_number_of_arrays_is_not_confirmed() {
        let unknown = RoomStops { has_geometry: false, ..room(Some(1500), Standing::Stopped) };
        let figures = StopState::default().update(&unknown);
        assert_eq!((figures.phase, figures.problems.len()), (StopPhase::Unconfirmed, 1));
    }

    #[test]
    fn a_stop_is_not_confirmed_before_each_array_and_each_controller_was_heard() {
        let mut state = StopState::default();
        let unheard = RoomStops { is_heard: false, ..room(None, Standing::Stopped) };
        assert_eq!(state.update(&unheard).phase, StopPhase::Requested);
        assert_eq!(state.update(&room(None, Standing::Stopped)).phase, StopPhase::Confirmed);
    }

    #[test]
    fn a_confirmed_stop_that_is_not_recorded_is_shown_with_its_problem() {
        let unrecorded = vec!["array 0 has stopped, but the stop is not recorded: no space".to_owned()];
        let room = RoomStops { unrecorded: unrecorded.clone(), ..room(Some(100), Standing::Stopped) };
        let figures = StopState::default().update(&room);
        assert_eq!((figures.phase, figures.problems), (StopPhase::Confirmed, unrecorded));
    }

    #[test]
    fn a_stop_that_one_of_two_drivers_has_confirmed_is_not_confirmed() {
        let problems = |open: &[u64], problem: &str| {
            let shared = Standing::Shared { drivers: 2, open: open.to_vec(), problem: problem.to_owned() };
            let figures = StopState::default().update(&room(Some(1500), shared));
            assert_eq!((figures.phase, figures.problems.len()), (StopPhase::Unconfirmed, 1));
            figures.problems[0].clone()
        };
        let one =
            "array 1 has 2 drivers, and the one of source 0000000000000007 has not confirmed the stop: cut its power";
        assert_eq!(problems(&[7], ""), one);
        let both = problems(&[7, 9], "no link");
        let expected = "the ones of sources 0000000000000007, 0000000000000009 have not confirmed the stop (no link): cut their power";
        assert!(both.ends_with(expected), "{both}");
    }

    #[test]
    fn a_stop_that_a_controller_alone_holds_is_open_and_its_end_is_no_release() {
        let held = "withheld by the stop of ann";
        let room = RoomStops { held: Some(held.to_owned()), ..RoomStops::default() };
        let mut state = StopState { open: Some(ago(1200)), ..StopState::default() };
        let figures = state.update(&room);
        assert_eq!((figures.phase, figures.held.as_deref()), (StopPhase::Unconfirmed, Some(held)));
        assert!(figures.stops.is_empty() && figures.problems[0].contains(held), "{figures:?}");
        assert_eq!(state.update(&RoomStops::default()).phase, StopPhase::None, "no array has confirmed a release");
        assert_eq!(state.update(&RoomStops::default()).phase, StopPhase::None);
    }

    #[test]
    fn a_driver_that_was_lost_before_it_answered_is_named() {
        let mut state = StopState { open: Some(ago(1200)), ..StopState::default() };
        let lost = |drivers: &[u64], since_ns| Standing::Lost { drivers: drivers.to_vec(), since_ns };
        let figures = state.update(&room(Some(1500), lost(&[7], None)));
        let expected = "array 1 is not confirmed: driver 0000000000000007 was lost before it answered; its mirrors may \
                        still move: cut the power";
        assert_eq!((figures.phase, &figures.problems[..]), (StopPhase::Unconfirmed, &[expected.to_owned()][..]));
        let figures = state.update(&room(Some(1500), lost(&[7, 9], Some(43_384_000_000_000))));
        let expected = "array 1 is not confirmed: drivers 0000000000000007, 0000000000000009 were lost at 12:03:04 UTC; \
                        their mirrors may still move: cut the power";
        assert_eq!(figures.problems, [expected.to_owned()]);
    }

    #[test]
    fn a_release_that_a_lost_driver_has_not_confirmed_names_it_and_the_next_one_does_not() {
        let mut state = StopState::default();
        let lost = vec!["array 1: driver 0000000000000007 was lost".to_owned()];
        let held = RoomStops { unreleased_lost: lost.clone(), ..room(Some(100), Standing::Stopped) };
        assert_eq!(state.update(&held).lost, lost);
        // The controllers have forgotten the driver.
        let released = state.update(&RoomStops::default());
        assert_eq!((released.phase, released.lost), (StopPhase::Released, lost));
        state.update(&room(Some(100), Standing::Stopped));
        let released = state.update(&RoomStops::default());
        assert_eq!((released.phase, released.lost), (StopPhase::Released, Vec::new()));
    }

    #[test]
    fn an_order_without_any_array_is_open() {
        let room = RoomStops { ordered: Some(ago(2000)), ..RoomStops::default() };
        assert_eq!(StopState::default().update(&room).phase, StopPhase::Unconfirmed);
    }

    #[test]
    fn a_stop_that_the_page_did_not_order_is_warned_of_too() {
        let mut state = StopState { open: Some(ago(1200)), ..StopState::default() };
        assert_eq!(state.update(&room(None, Standing::Silent)).phase, StopPhase::Unconfirmed);
    }
}
