//! Pauses of a session, while the array follows another sender.
//!
//! The array is known to have followed this session only as far as its telemetry shows it. Later readings may be of
//! another sender's angles: they are dropped, and their mirrors are measured again.

use heliostat_proto::Nanos;

use super::{Session, Stage};
use crate::outcome::Verification;

impl Session {
    /// The array follows another sender for some time: no report measures an earlier command, and none is
    /// to be passed until the array follows this session again. `confirmed_ns`: until when telemetry has shown
    /// the array to follow this session; later readings are dropped.
    pub fn handle_pause(&mut self, confirmed_ns: Nanos) {
        self.timing.forget_sent();
        self.drop_pending();
        let has_dropped = self.drop_readings(confirmed_ns.saturating_add(1));
        let is_dark_known = self.dark_ns <= confirmed_ns;
        match self.stage {
            Stage::Probe(_) if is_dark_known => {}
            // The readings of groups are not kept one by one, so the search begins again.
            Stage::Locate(place) if is_dark_known => self.begin_search(place),
            Stage::Verify if is_dark_known => self.verification = Verification::default(),
            Stage::Dark(place) | Stage::Probe(place) | Stage::Locate(place) => self.darken_again(place),
            Stage::Verify => self.darken_again(self.setup.spots.len()),
            // The estimate of the place that was complete is made again, without them.
            Stage::Await(place) if has_dropped && self.jobs.is_empty() => self.complete = place.checked_sub(1),
            Stage::Await(_) | Stage::Ended => {}
        }
    }

    /// Drops the readings at the present spot from this time on; whether there are any. Their mirrors are measured
    /// again as before their first probe, so the place is not complete.
    pub(super) fn drop_readings(&mut self, since: Nanos) -> bool {
        let dropped = self.times.iter().rev().take_while(|time| **time >= since).count();
        self.times.truncate(self.times.len() - dropped);
        for reading in self.readings.split_off(self.readings.len() - dropped) {
            // The estimate of a place has ended its jobs.
            if !self.jobs.is_empty() {
                self.jobs[reading.mirror] = self.job(reading.mirror, reading.spot);
            }
            self.complete = None;
            self.unused += 1;
        }
        dropped > 0
    }

    /// Begins with the dark readings of the present spot again, as many as at an arrival.
    fn darken_again(&mut self, place: usize) {
        self.unused += self.dark_gains.len() as u64;
        self.dark_gains.clear();
        self.stand.forget_direct();
        self.verification = Verification::default();
        self.search = None;
        self.is_located = false;
        if let Some(spot) = self.spots.last_mut() {
            spot.group = 1;
        }
        self.stage = Stage::Dark(place);
    }
}

#[cfg(test)]
mod tests {
    use super::super::test_room::{PERIOD_NS, Room};
    use super::*;
    use crate::probes::State;

    #[test]
    fn readings_that_no_telemetry_confirms_are_dropped_and_their_mirrors_are_measured_again() {
        let mut room = Room::new(20.0);
        room.step_until(|session| session.readings().len() >= 150);
        let confirmed_ns = room.now - 3 * PERIOD_NS;
        let session = &mut room.session;
        let left = session.times.iter().filter(|time| **time <= confirmed_ns).count();
        assert!(left < session.readings.len() && session.dark_ns <= confirmed_ns);
        let before = session.readings.clone();
        session.handle_pause(confirmed_ns);
        assert_eq!(session.readings, before[..left]);
        for reading in &before[left..] {
            let job = &session.jobs[reading.mirror];
            assert_eq!((job.state, job.readings), (State::Open, 0), "mirror {}", reading.mirror);
        }
        session.handle_pause(confirmed_ns);
        assert_eq!(session.readings.len(), left, "confirmed ones stay");
        room.step_until(Session::is_estimate_due);
    }

    #[test]
    fn a_surprise_whose_first_new_reading_is_dropped_is_still_confirmed() {
        let mut room = Room::new(20.0);
        room.step_until(Session::is_estimate_due);
        let (session, now) = (&mut room.session, room.now);
        session.handle_pause(now);
        session.complete = None;
        let located = session.jobs.iter_mut().find(|job| job.state == State::Located).expect("a located mirror");
        assert!(located.confirm());
        let before = session.readings.len();
        room.step_until(|session| session.readings().len() > before);
        room.session.handle_pause(room.now - 1);
        assert_eq!(room.session.readings.len(), before);
        room.step_until(Session::is_estimate_due);
    }

    #[test]
    fn a_mirror_whose_readings_are_dropped_is_not_located_when_the_receiver_returns() {
        for left_before in [false, true] {
            let mut room = Room::new(20.0);
            let located = |session: &Session| session.jobs.iter().position(|job| job.state == State::Located);
            room.step_until(|session| located(session).is_some());
            let (session, now) = (&mut room.session, room.now);
            let mirror = located(session).expect("a located mirror");
            if left_before {
                session.leave(Nanos::MAX);
                session.handle_pause(now - 1);
            } else {
                session.leave(now);
            }
            assert_eq!((session.stage(), session.jobs[mirror].state), (Stage::Await(0), State::Open));
        }
    }

    #[test]
    fn a_spot_whose_dark_readings_no_telemetry_confirms_begins_with_them_again() {
        let mut room = Room::new(2.0);
        room.step_until(|session| matches!(session.stage(), Stage::Probe(_)));
        let (dark_ns, dark) = (room.session.dark_ns, room.session.dark_gains.len());
        assert!(dark_ns > 0 && room.session.group() > 1);
        room.session.handle_pause(dark_ns - 1);
        assert_eq!((room.session.stage(), room.session.group()), (Stage::Dark(0), 1));
        room.step_until(|session| matches!(session.stage(), Stage::Probe(_)));
        assert!(room.session.dark_ns > dark_ns && room.session.spots.len() == 1);
        assert!(room.session.dark_gains.len() >= dark, "the noise is known as well as before");
    }

    #[test]
    fn the_estimate_of_a_complete_place_is_made_again_without_the_readings_that_are_dropped() {
        let mut room = Room::new(20.0);
        room.step_until(Session::is_estimate_due);
        let (readings, now) = (room.session.readings.len(), room.now);
        room.know_offsets();
        room.session.stage = Stage::Await(1);
        room.session.handle_pause(now);
        assert!(!room.session.is_estimate_due() && room.session.readings.len() == readings);
        room.session.handle_pause(now - 1);
        assert!(room.session.is_estimate_due() && room.session.readings.len() < readings);
        assert_eq!(room.session.log().complete, 1);
        // The receiver is carried to the next place before the estimate is made.
        (0..100).for_each(|_| room.step(1.0));
        assert_eq!((room.session.stage(), room.session.spots.len()), (Stage::Await(1), 1));
    }
}
