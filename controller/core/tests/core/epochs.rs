//! Epochs: controllers, an array that obeys by the rules of CONTRACT.md, and forged messages.

use heliostat_core::tenure::{Evidence, FORGIVEN_NS, RANK_MAX, Standing, Tenure, TenureEvent};
use heliostat_proto::{EPOCH_SLOTS, Nanos};

use crate::support::MS;

mod contested;
mod forged;
mod guests;
mod links;

const S: Nanos = 1000 * MS;
const INTERVAL: Nanos = 10 * MS;
/// UTC at the start, in s and ms.
const NOON: Nanos = 1_767_000_000 * S;
const NOON_MS: u64 = NOON / MS;
const DAY_MS: u64 = 86_400_000;

/// What an array accepts: rules 3 and 4 of a driver, and its bound on epochs.
#[derive(Default)]
struct Array {
    shown: Evidence,
    lead_max_ms: Option<u64>,
}

impl Array {
    fn handle(&mut self, now: Nanos, epoch: u64, sequence: u64) -> bool {
        let Evidence { epoch: followed, applied_sequence, stopped, .. } = self.shown;
        let bound = self.lead_max_ms.map_or(u64::MAX, |lead_ms| followed.max(now / MS).saturating_add(lead_ms));
        let is_old = epoch < followed || (epoch == followed && sequence <= applied_sequence);
        if stopped || is_old || epoch > bound {
            self.shown.refused += u64::from(!stopped);
            return false;
        }
        let accepted = self.shown.accepted + 1;
        self.shown = Evidence { epoch, applied_sequence: sequence, accepted, following: true, ..self.shown };
        true
    }
}

/// A controller with its own clock.
struct Controller {
    tenure: Tenure,
    is_alive: bool,
    clock_ahead_ns: Nanos,
    sent: (u64, u64),
    accepted: u64,
    events: Vec<TenureEvent>,
}

impl Controller {
    fn new(source: u64) -> Self {
        let tenure = Tenure::live(source, INTERVAL);
        Self { tenure, is_alive: true, clock_ahead_ns: 0, sent: (0, 0), accepted: 0, events: Vec::new() }
    }

    fn report(&mut self, now: Nanos, array: &mut Array) {
        let now = now + self.clock_ahead_ns;
        let (epoch, event) = self.tenure.permit(now);
        self.events.extend(event);
        if let Some(epoch) = epoch {
            let sequence = self.tenure.next_sequence();
            self.sent = (epoch, sequence);
            self.accepted += u64::from(array.handle(now - self.clock_ahead_ns, epoch, sequence));
        }
    }

    fn telemetry(&mut self, now: Nanos, shown: Evidence) {
        let shown = Evidence { sampled_ns: now, ..shown };
        self.events.extend(self.tenure.handle_telemetry(now + self.clock_ahead_ns, shown));
    }
}

/// A room with a report every 10 ms, and telemetry every 50 ms or before each report.
struct Room {
    now: Nanos,
    array: Array,
    controllers: Vec<Controller>,
    telemetry_interval: Nanos,
}

impl Room {
    fn new(sources: &[u64]) -> Self {
        let controllers = sources.iter().map(|source| Controller::new(*source)).collect();
        Self { now: NOON, array: Array::default(), controllers, telemetry_interval: 50 * MS }
    }

    fn run(&mut self, duration: Nanos) {
        for _ in 0..duration / INTERVAL {
            self.now += INTERVAL;
            if self.telemetry_interval == INTERVAL {
                self.show(self.array.shown);
            }
            for controller in self.controllers.iter_mut().filter(|controller| controller.is_alive) {
                controller.report(self.now, &mut self.array);
            }
            if self.telemetry_interval > INTERVAL && self.now.is_multiple_of(self.telemetry_interval) {
                self.show(self.array.shown);
            }
        }
    }

    fn show(&mut self, shown: Evidence) {
        let alive = self.controllers.iter_mut().filter(|controller| controller.is_alive);
        alive.for_each(|controller| controller.telemetry(self.now, shown));
    }

    /// A controller appears, or its liveliness token ends; every other one sees it.
    fn announce(&mut self, source: u64, is_present: bool) {
        for controller in &mut self.controllers {
            controller.events.extend(controller.tenure.handle_controller(source, is_present));
        }
    }

    /// Time until a controller's next accepted command, at most a minute.
    fn until_accepted(&mut self, of: usize) -> Nanos {
        let (start, before) = (self.now, self.controllers[of].accepted);
        while self.controllers[of].accepted == before && self.now - start < 60 * S {
            self.run(INTERVAL);
        }
        self.now - start
    }

    /// A controller is served no longer; the time until the next accepted command of another one.
    fn takeover(&mut self, from: usize, by: usize) -> Nanos {
        self.controllers[from].is_alive = false;
        self.until_accepted(by)
    }

    /// A controller hangs until another one has taken over, and is served again for a second.
    fn hang(&mut self, from: usize, by: usize) -> Nanos {
        let waited = self.takeover(from, by);
        self.controllers[from].is_alive = true;
        self.run(S);
        waited
    }

    /// A command of the former leader arrives, and the next telemetry shows it; whether this contests the takeover.
    fn is_contested(&mut self, from: usize, by: usize) -> bool {
        let (epoch, sequence) = self.controllers[from].sent;
        assert!(!self.array.handle(self.now, epoch, sequence + 1));
        self.run(INTERVAL);
        self.controllers[by].events.last() == Some(&TenureEvent::Contested)
    }

    fn standings(&self) -> Vec<Standing> {
        self.controllers.iter().map(|controller| controller.tenure.standing()).collect()
    }
}

#[test]
fn the_first_epoch_is_above_utc_and_above_every_epoch_of_the_array() {
    let first = |prepare: &dyn Fn(&mut Tenure)| {
        let mut tenure = Tenure::live(5, INTERVAL);
        assert_eq!((tenure.standing(), tenure.epoch()), (Standing::Waiting, 0));
        prepare(&mut tenure);
        // Without telemetry, which is awaited.
        let permitted = [0, 100, 200].map(|wait_ms| tenure.permit(NOON + wait_ms * MS).0);
        permitted.into_iter().flatten().next().expect("the first command is sent")
    };
    let is_next = |epoch: u64, base: u64| epoch > base && epoch <= base + EPOCH_SLOTS && epoch % EPOCH_SLOTS == 5;
    assert!(is_next(first(&|_| {}), NOON_MS));
    assert!(is_next(first(&|tenure| tenure.handle_announced_epoch(NOON_MS + DAY_MS)), NOON_MS + DAY_MS));
    let seen = Evidence { epoch: NOON_MS + DAY_MS, ..Evidence::default() };
    assert!(is_next(first(&|tenure| assert_eq!(tenure.handle_telemetry(NOON, seen), None)), NOON_MS + DAY_MS));
    assert!(is_next(first(&|tenure| tenure.handle_announced_epoch(u64::MAX)), NOON_MS + 200), "there is no higher one");
}

#[test]
fn controllers_with_other_source_ids_never_choose_the_same_epoch() {
    for step in 0..3000 {
        let now = NOON + step * MS;
        let epochs = [11, 700].map(|source| {
            let mut tenure = Tenure::live(source, INTERVAL);
            tenure.handle_telemetry(now, Evidence::default());
            tenure.permit(now).0.expect("no other controller")
        });
        assert_ne!(epochs[0], epochs[1]);
    }
}

#[test]
fn a_controller_whose_clock_was_a_day_ahead_is_replaced_after_the_correction() {
    for hears_telemetry_first in [true, false] {
        let mut room = Room::new(&[1]);
        room.controllers[0].clock_ahead_ns = DAY_MS * MS;
        room.run(S);
        room.controllers[0].is_alive = false;
        room.controllers.push(Controller::new(2));
        if hears_telemetry_first {
            room.show(room.array.shown);
        }
        let waited = room.until_accepted(1);
        // Telemetry first shows that the array follows, then that it accepts no command.
        assert!(waited <= 110 * MS, "{} ms", waited / MS);
        room.run(10 * S);
        assert!(room.controllers[1].accepted > 990, "{}", room.controllers[1].accepted);
    }
}

/// A room with telemetry before each report, in which the first controller has led for a second and
/// the others stand by.
fn led_room(sources: &[u64]) -> Room {
    let mut room = Room::new(&sources[..1]);
    room.telemetry_interval = INTERVAL;
    room.run(S);
    for source in &sources[1..] {
        let mut standby = Controller::new(*source);
        standby.telemetry(room.now, room.array.shown);
        room.controllers.push(standby);
    }
    sources.iter().for_each(|source| room.announce(*source, true));
    room.run(60 * S);
    assert_eq!(room.array.shown.accepted, 6100, "every report is answered");
    assert_eq!(room.standings()[0], Standing::Leading);
    assert!(room.controllers[1..].iter().all(|standby| standby.events == [TenureEvent::StoodBy]), "they do not fight");
    room
}

#[test]
fn a_leader_that_commands_on_after_its_token_has_ended_is_known_to_have_ended_unless_it_goes_on() {
    for (goes_on, has_ended) in [(5 * INTERVAL, true), (2 * S, false)] {
        let mut room = led_room(&[1, 600]);
        room.controllers[1].tenure = room.controllers[1].tenure.clone().in_reserve(Some(3));
        room.announce(1, false);
        room.run(goes_on);
        assert_eq!(room.standings(), [Standing::Leading, Standing::Standby], "each report is answered");
        room.takeover(0, 1);
        assert_eq!(room.controllers[1].tenure.has_leader_ended(), has_ended, "{goes_on} ns");
    }
}

#[test]
fn a_controller_that_starts_beside_a_leader_stands_by_and_takes_over_within_two_reports_of_its_end() {
    for (reports, is_announced) in [(1, true), (2, false)] {
        let mut room = led_room(&[1, 600]);
        room.controllers[0].is_alive = false;
        if is_announced {
            room.announce(1, false);
        }
        let waited = room.until_accepted(1);
        assert_eq!(waited, reports * INTERVAL, "the token of the leader ended: {is_announced}");
        // The former leader had only lost its reports, and stands by.
        room.controllers[0].is_alive = true;
        room.run(60 * S);
        assert_eq!(room.standings(), [Standing::Standby, Standing::Leading]);
        assert_eq!(room.controllers[0].events, [TenureEvent::Superseded]);
        assert_eq!(room.controllers[1].events, [TenureEvent::StoodBy, TenureEvent::TookOver]);
    }
}

#[test]
fn of_two_standbys_the_one_of_the_lower_rank_takes_over_and_the_other_waits_for_it() {
    for is_announced in [true, false] {
        let mut room = led_room(&[1, 600, 300]);
        room.controllers[0].is_alive = false;
        if is_announced {
            room.announce(1, false);
        }
        room.run(60 * S);
        assert_eq!(room.standings()[1..], [Standing::Standby, Standing::Leading]);
        assert_eq!(room.controllers[1].events, [TenureEvent::StoodBy]);
        // A controller whose token has not ended counts for the rank.
        assert_eq!(room.takeover(2, 1), if is_announced { 2 } else { 3 } * INTERVAL);
    }
}

#[test]
fn a_rank_that_the_operator_gives_counts_unanswered_reports() {
    for rank in 1..=3 {
        let mut room = led_room(&[1]);
        let mut reserve = Controller::new(2);
        reserve.tenure = Tenure::live(2, INTERVAL).in_reserve(Some(rank));
        room.controllers.push(reserve);
        room.run(S);
        assert_eq!(room.standings()[1], Standing::Standby);
        assert_eq!(room.takeover(0, 1), (1 + Nanos::from(rank)) * INTERVAL);
    }
}

#[test]
fn a_reserve_that_starts_first_leads_after_the_reports_of_its_rank() {
    let mut room = Room::new(&[]);
    room.telemetry_interval = INTERVAL;
    let mut reserve = Controller::new(2);
    reserve.tenure = Tenure::live(2, INTERVAL).in_reserve(None);
    room.controllers.push(reserve);
    let is_standing_by = |room: &Room| room.controllers[0].tenure.is_standing_by();
    assert!(is_standing_by(&room), "before its first report too");
    assert_eq!(room.until_accepted(0), 3 * INTERVAL);
    assert!(!is_standing_by(&room));
}

#[test]
fn a_link_between_controllers_that_is_cut_changes_the_leader_at_most_once() {
    let mut room = led_room(&[1, 600]);
    room.announce(1, false);
    room.announce(600, false);
    room.run(60 * S);
    assert_eq!(room.standings(), [Standing::Standby, Standing::Leading]);
    assert_eq!(room.controllers[0].events, [TenureEvent::Superseded]);
    assert!(room.array.shown.accepted >= 12_100, "no report lacks an answer");
    room.announce(1, true);
    room.announce(600, true);
    room.run(60 * S);
    assert_eq!(room.standings(), [Standing::Standby, Standing::Leading]);
}

#[test]
fn a_standby_whose_telemetry_is_sparser_than_the_reports_takes_over_after_two_messages() {
    let mut room = Room::new(&[1]);
    room.run(S);
    let mut standby = Controller::new(600);
    standby.telemetry(room.now, room.array.shown);
    room.controllers.push(standby);
    room.run(60 * S);
    assert_eq!(room.standings(), [Standing::Leading, Standing::Standby]);
    let waited = room.takeover(0, 1);
    assert!(waited <= 110 * MS, "{} ms", waited / MS);
}

#[test]
fn a_controller_that_starts_right_after_another_waits_for_telemetry_and_stands_by() {
    let mut room = Room::new(&[1000]);
    room.run(70 * MS);
    room.controllers.push(Controller::new(600));
    room.run(60 * S);
    assert_eq!(room.standings(), [Standing::Leading, Standing::Standby]);
    assert_eq!(room.controllers[1].events, [TenureEvent::StoodBy]);
}

#[test]
fn a_controller_that_starts_without_telemetry_beside_another_takes_over_for_good() {
    let mut room = Room::new(&[NOON_MS + 900]);
    room.telemetry_interval = 500 * MS;
    room.run(260 * MS);
    let first = room.controllers[0].tenure.epoch();
    room.controllers.push(Controller::new(NOON_MS + 480));
    room.run(220 * MS);
    let second = room.controllers[1].tenure.epoch();
    assert!(second > 0 && second < first, "the case that this test is for: {second} {first}");
    room.run(60 * S);
    assert_eq!(room.standings(), [Standing::Standby, Standing::Leading]);
    assert_eq!(room.controllers[1].events, [TenureEvent::TookOver]);
}

#[test]
fn of_several_controllers_in_standby_one_takes_over() {
    let mut room = Room::new(&[1]);
    for source in [2, 3, 4] {
        room.run(S);
        room.controllers.push(Controller::new(source));
    }
    room.run(S);
    room.controllers[3].is_alive = false;
    room.run(5 * S);
    let leading = room.standings()[..3].iter().filter(|standing| **standing == Standing::Leading).count();
    assert_eq!(leading, 1);
    let before = room.array.shown.accepted;
    room.run(10 * S);
    assert_eq!(room.array.shown.accepted - before, 1000);
}

#[test]
fn standby_ends_when_telemetry_is_absent() {
    let mut room = Room::new(&[1]);
    room.run(S);
    let epoch = room.controllers[0].tenure.epoch();
    room.show(Evidence { epoch: u64::MAX, ..room.array.shown });
    let permitted = (1..300).find_map(|tick| {
        let permitted = room.controllers[0].tenure.permit(room.now + tick * INTERVAL);
        permitted.0.map(|epoch| (tick, epoch, permitted.1))
    });
    assert_eq!(permitted, Some((101, epoch, Some(TenureEvent::Resumed))));
}

#[test]
fn a_stopped_array_is_not_taken_over() {
    let mut room = Room::new(&[1, 2]);
    room.run(S);
    let events = |room: &Room| room.controllers.iter().map(|controller| controller.events.clone()).collect::<Vec<_>>();
    let before = events(&room);
    room.array.shown.stopped = true;
    room.run(60 * S);
    assert_eq!(events(&room), before);
}

#[test]
fn a_pause_of_the_reports_is_no_reason_to_take_over() {
    let mut room = Room::new(&[1]);
    room.run(S);
    room.controllers.push(Controller::new(2));
    room.run(S);
    for pause in [3 * S, 3600 * S] {
        room.now += pause;
        room.run(10 * S);
    }
    assert_eq!(room.standings(), [Standing::Leading, Standing::Standby]);
    assert_eq!(room.controllers[0].events, []);
    assert_eq!(room.controllers[1].events, [TenureEvent::StoodBy]);
}

#[test]
fn commands_continue_after_a_clock_has_stepped_back() {
    let mut room = Room::new(&[1]);
    room.run(10 * S);
    room.controllers.push(Controller::new(2));
    room.run(S);
    room.now -= 3600 * S;
    room.run(S);
    let waited = room.takeover(1, 0);
    assert!(waited <= 1200 * MS, "{} ms", waited / MS);
}

#[test]
fn commands_refused_as_expired_are_reported_without_a_new_epoch() {
    let mut tenure = Tenure::live(1, INTERVAL);
    let mut events = Vec::new();
    for tick in 0..250 {
        let now = NOON + tick * INTERVAL;
        let shown = Evidence { expired: tick, ..Evidence::default() };
        events.extend(tenure.handle_telemetry(now, shown));
        tenure.permit(now);
    }
    assert_eq!(events, [TenureEvent::ClocksDiffer; 2]);
    assert!(tenure.epoch() <= NOON_MS + EPOCH_SLOTS);
}

#[test]
fn a_controller_that_nothing_obeys_tries_at_growing_intervals() {
    let mut tenure = Tenure::live(1, INTERVAL);
    let mut tried = Vec::new();
    for tick in 0..6000 {
        let now = NOON + tick * INTERVAL;
        let event = tenure.handle_telemetry(now, Evidence { refused: tick, ..Evidence::default() });
        tried.extend(event.map(|_| tick / 100));
        tenure.permit(now);
    }
    assert_eq!(tried, [1, 2, 4, 8, 16, 24, 32, 40, 48, 56]);
}

#[test]
fn commands_are_numbered_from_one_in_each_epoch_without_a_gap() {
    let mut tenure = Tenure::live(1, INTERVAL);
    tenure.handle_telemetry(NOON, Evidence::default());
    let first = tenure.permit(NOON).0.expect("no other controller");
    assert_eq!([1, 2, 3].map(|_| tenure.next_sequence()), [1, 2, 3]);
    let foreign = Evidence { epoch: first, applied_sequence: 4, ..Evidence::default() };
    assert_eq!(tenure.handle_telemetry(NOON, foreign), Some(TenureEvent::ForeignSequence));
    assert!(tenure.permit(NOON).0.is_some_and(|epoch| epoch > first));
    assert_eq!([1, 2].map(|_| tenure.next_sequence()), [1, 2]);
}

#[test]
fn a_second_controller_in_lockstep_stands_by_and_keeps_its_epoch() {
    let mut second = Tenure::lockstep(1);
    assert_eq!((second.permit(S), second.next_sequence()), ((Some(1), None), 1));
    let of_first = Evidence { epoch: 1, applied_sequence: 40, accepted: 40, ..Evidence::default() };
    assert_eq!(second.handle_telemetry(S, of_first), Some(TenureEvent::Superseded));
    for tick in 1..50 {
        assert_eq!(second.permit(S + tick * INTERVAL), (None, None));
    }
    assert_eq!(second.epoch(), 1);
}

#[test]
fn replay_keeps_its_epoch_whatever_telemetry_shows() {
    let mut tenure = Tenure::fixed(7);
    assert_eq!(tenure.handle_telemetry(S, Evidence { epoch: u64::MAX, ..Evidence::default() }), None);
    assert_eq!(tenure.permit(S), (Some(7), None));
}

#[test]
fn a_start_beside_the_leader_of_an_array_that_has_parked_stands_by() {
    for is_present in [true, false] {
        let mut room = led_room(&[1]);
        room.array.shown.following = false;
        let mut second = Controller::new(600);
        second.tenure.handle_controller(1, is_present);
        second.telemetry(room.now, room.array.shown);
        second.report(room.now + INTERVAL, &mut room.array);
        let expected = if is_present { Standing::Standby } else { Standing::Leading };
        assert_eq!(second.tenure.standing(), expected, "the leader is in the room: {is_present}");
    }
}

#[test]
fn a_driver_that_starts_again_leaves_no_report_unanswered() {
    let mut room = led_room(&[1, 600]);
    room.array.shown.accepted = 0;
    room.run(S);
    assert_eq!(room.standings(), [Standing::Leading, Standing::Standby]);
}
