//! Pauses of a session, while the array follows another sender.
//!
//! The array is known to have followed this session only as far as its telemetry shows it. Later readings may be of
//! another sender's angles: they are dropped, and with them what was concluded from them.

use heliostat_proto::Nanos;

use super::{Session, Stage};
use crate::outcome::Verification;
use crate::probes::State;

impl Session {
    /// The array follows another sender for some time: no report measures an earlier command, and none is
    /// to be passed until the array follows this session again. `confirmed_ns`: until when telemetry has shown
    /// the array to follow this session; later readings are dropped.
    pub fn handle_pause(&mut self, confirmed_ns: Nanos) {
        self.timing.forget_sent();
        self.drop_pending();
        let mirrors = self.drop_readings(confirmed_ns.saturating_add(1));
        let is_dark_known = self.dark_ns <= confirmed_ns;
        match self.stage {
            Stage::Probe(_) if is_dark_known => mirrors.into_iter().for_each(|mirror| self.judge_again(mirror)),
            // The readings of groups are not kept one by one, so the search begins again.
            Stage::Locate(place) if is_dark_known => self.begin_search(place),
            Stage::Verify if is_dark_known => self.verification = Verification::default(),
            Stage::Dark(place) | Stage::Probe(place) | Stage::Locate(place) => self.darken_again(place, &mirrors),
            Stage::Verify => self.darken_again(self.setup.spots.len(), &mirrors),
            // The estimate of the place that was complete is made again, without them.
            Stage::Await(place) if self.jobs.is_empty() && !mirrors.is_empty() => {
                self.complete = place.checked_sub(1);
            }
            Stage::Await(_) | Stage::Ended => {}
        }
    }

    /// Drops the readings at the present spot from this time on; the mirrors of which they were.
    pub(super) fn drop_readings(&mut self, since: Nanos) -> Vec<usize> {
        let mut mirrors = Vec::new();
        while self.times.last().is_some_and(|time| *time >= since) {
            self.times.pop();
            mirrors.extend(self.readings.pop().map(|reading| reading.mirror));
            self.unused += 1;
        }
        mirrors.sort_unstable();
        mirrors.dedup();
        mirrors
    }

    /// Begins with the dark readings of the present spot again; these mirrors are not located there.
    fn darken_again(&mut self, place: usize, mirrors: &[usize]) {
        self.unused += self.dark_gains.len() as u64;
        self.dark_gains.clear();
        self.verification = Verification::default();
        self.search = None;
        self.is_located = false;
        for mirror in mirrors {
            self.jobs[*mirror].state = State::Open;
        }
        if let Some(spot) = self.spots.last_mut() {
            spot.group = 1;
        }
        self.stage = Stage::Dark(place);
    }

    /// What is known of a mirror at the present spot, by the readings that are left.
    fn judge_again(&mut self, mirror: usize) {
        let spot = self.spots.len() - 1;
        self.jobs[mirror] = self.job(mirror, spot);
        let left: Vec<_> =
            self.readings.iter().filter(|reading| (reading.mirror, reading.spot) == (mirror, spot)).copied().collect();
        left.into_iter().for_each(|reading| self.judge(mirror, reading.command, reading.gain));
    }
}

#[cfg(test)]
mod tests {
    use super::super::test_room::{PERIOD_NS, Room};
    use super::*;

    #[test]
    fn readings_that_no_telemetry_confirms_are_dropped_and_their_mirrors_are_judged_without_them() {
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
            let judged = session.readings.iter().filter(|other| other.mirror == reading.mirror).count();
            assert_eq!(session.jobs[reading.mirror].readings as usize, judged, "mirror {}", reading.mirror);
        }
        session.handle_pause(confirmed_ns);
        assert_eq!(session.readings.len(), left, "confirmed ones stay");
        room.step_until(Session::is_estimate_due);
    }

    #[test]
    fn a_spot_whose_dark_readings_no_telemetry_confirms_begins_with_them_again() {
        let mut room = Room::new(2.0);
        room.step_until(|session| matches!(session.stage(), Stage::Probe(_)));
        let dark_ns = room.session.dark_ns;
        assert!(dark_ns > 0 && room.session.group() > 1);
        room.session.handle_pause(dark_ns - 1);
        assert_eq!((room.session.stage(), room.session.group()), (Stage::Dark(0), 1));
        room.step_until(|session| matches!(session.stage(), Stage::Probe(_)));
        assert!(room.session.dark_ns > dark_ns && room.session.spots.len() == 1);
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
    }
}
