//! The stages: what is commanded in each, and what its readings mean.

use heliostat_channel::MirrorAngles;
use heliostat_proto::Nanos;

use super::timing::Purpose;
use super::{Session, Stage};
use crate::fit::Reading;
use crate::grid::{Expected, Grid};
use crate::optics::{OFFSET, nominal_at};
use crate::parameters::Spot;
use crate::probes::{self, Job, State};
use crate::stand::{Stand, distance, median};

/// Dark readings at each spot.
const DARK_READINGS: usize = 4;

/// Dark readings as long as fewer direct gains are known, for the noise of a reading.
const DIRECT_READINGS: usize = 12;

/// Roll in rad by which a mirror is turned up, away from the receiver: 12 degrees, far above the
/// width of its light and any offset.
const AWAY_RAD: f64 = 12.0 * std::f64::consts::PI / 180.0;

/// Largest distance in m of the receiver from the stated place of a spot.
const AT_M: f64 = 0.6;

/// Least distance in m between two spots that are not stated.
const APART_M: f64 = 0.5;

/// Noise of a gain where the direct path is blocked, relative.
const NOISE_RELATIVE: f64 = 0.05;

/// Least standard deviation in m of a tracked mean: a hand is not a tripod.
pub(super) const TRACKED_MIN_M: f64 = 0.003;

/// Mirrors probed first at a later spot, and the share of them that has to show light.
const FIRST_MIRRORS: usize = 12;
const FIRST_SHARE: f64 = 0.7;

/// Readings of each pattern of the verification.
const VERIFY_READINGS: usize = 10;

/// Readings of a mirror at the first spot and at a later one, for the estimate of the time.
const EXPECTED_READINGS: [f64; 2] = [5.5, 3.5];

/// Largest angle in rad at which the edge of a light is looked for.
const EDGE_RAD: f64 = 12.0 * std::f64::consts::PI / 180.0;

impl Session {
    /// Whether the receiver stands at a place of the setup.
    pub(super) fn is_at(&self, place: usize) -> bool {
        let at = self.stand.mean();
        match self.place_of(place).floor_m {
            Some([x, y]) => {
                let stated = self.optics.array().wall_from_room(&heliostat_channel::Vec3::new(x, y, 0.0));
                distance([stated.x, stated.y], at) < AT_M
            }
            None => self
                .spots
                .iter()
                .zip(&self.places)
                .all(|(spot, other)| *other == place || distance(spot.tracked_m, at) > APART_M),
        }
    }

    /// The receiver stands at a place: a new spot begins.
    pub(super) fn arrive(&mut self, place: usize) {
        let height_m = self.place_of(place).height_m;
        let at = self.stand.mean();
        let led = (0..self.optics.leds.len())
            .max_by(|a, b| {
                let gain = |led: usize| self.optics.direct_gain(led, &nominal_at(at, height_m));
                gain(*a).total_cmp(&gain(*b))
            })
            .unwrap_or(0);
        self.spots.push(Spot {
            tracked_m: at,
            tracked_deviation_m: TRACKED_MIN_M,
            height_m,
            led,
            direct_gain: 0.0,
            direct_deviation: 0.0,
            noise_relative: NOISE_RELATIVE,
            noise_gain: 0.0,
            group: 1,
        });
        self.places.push(place);
        self.refresh_spot();
        self.extend_estimate();
        let spot = self.spots.len() - 1;
        self.dark_gains.clear();
        self.times.clear();
        self.is_located = false;
        self.dark_angles = (0..self.optics.centres.len())
            .map(|mirror| {
                let aim = self.optics.aim((mirror, led), &self.quantities((mirror, spot))).unwrap_or_default();
                let [roll, yaw] = self.within([aim[0] - AWAY_RAD, aim[1]]);
                // Where the range ends, the mirror turns the other way.
                if (roll - aim[0]).abs() < 0.7 * AWAY_RAD { self.within([aim[0] + AWAY_RAD, yaw]) } else { [roll, yaw] }
            })
            .collect();
        self.stage = Stage::Dark(place);
    }

    /// The receiver has left its place at this time: readings from then on do not count.
    pub(super) fn leave(&mut self, since: Nanos) {
        let place = match self.stage {
            Stage::Dark(place) | Stage::Probe(place) | Stage::Locate(place) => place,
            Stage::Verify => self.setup.spots.len(),
            Stage::Await(_) | Stage::Ended => return,
        };
        self.drop_readings(since);
        if self.stage == Stage::Verify {
            self.verification = crate::outcome::Verification::default();
        }
        self.search = None;
        self.drop_pending();
        self.stage = Stage::Await(place);
        self.stand = Stand::default();
    }

    /// What the next command is for, and its angles.
    pub(super) fn plan(&mut self) -> Option<(Purpose, MirrorAngles)> {
        let purpose = match self.stage {
            Stage::Await(_) | Stage::Ended => return None,
            Stage::Dark(_) => Purpose::Dark,
            Stage::Probe(_) if self.group() > 1 => self.plan_group()?,
            Stage::Probe(_) => self.next_probe().map(|(mirror, command)| Purpose::Probe(mirror, command))?,
            Stage::Locate(place) => self.plan_search().or_else(|| {
                self.reject_spot(place);
                None
            })?,
            Stage::Verify => Purpose::Verify(self.verification.is_calibrated_next()),
        };
        let mut angles = MirrorAngles {
            roll: self.dark_angles.iter().map(|angles| angles[0]).collect(),
            yaw: self.dark_angles.iter().map(|angles| angles[1]).collect(),
        };
        match purpose {
            Purpose::Dark => {}
            Purpose::Group(number, pattern) => self.light_group((number, pattern), &mut angles),
            Purpose::Probe(mirror, command) => (angles.roll[mirror], angles.yaw[mirror]) = command.into(),
            Purpose::Locate(target, turn) => {
                for (mirror, command) in self.search_probes(target, turn) {
                    (angles.roll[mirror], angles.yaw[mirror]) = command.into();
                }
            }
            Purpose::Verify(is_calibrated) => {
                let is_turned = |change: &super::Change| change.turned_deg.is_some();
                let changed =
                    |mirror: usize| self.changes.iter().any(|change| change.mirror == mirror && is_turned(change));
                for mirror in (0..angles.len()).filter(|mirror| !self.is_refinement() || changed(*mirror)) {
                    (angles.roll[mirror], angles.yaw[mirror]) = self.verified_aim(mirror, is_calibrated).into();
                }
            }
        }
        // The mirrors are at angles that a message can carry.
        let narrow = |angles: &mut Vec<f64>| angles.iter_mut().for_each(|angle| *angle = f64::from(*angle as f32));
        narrow(&mut angles.roll);
        narrow(&mut angles.yaw);
        Some((purpose, angles))
    }

    /// A reading of a command.
    pub(super) fn handle_reading(&mut self, time_ns: Nanos, purpose: Purpose, gain: f64) {
        if self.is_estimate_due() {
            return;
        }
        match (self.stage, purpose) {
            (Stage::Dark(place), Purpose::Dark) => {
                self.dark_gains.push(gain);
                self.dark_ns = time_ns;
                if self.dark_gains.len() >= DARK_READINGS && self.stand.direct_count() >= DIRECT_READINGS {
                    self.begin_probes(place);
                }
            }
            (Stage::Probe(place), Purpose::Probe(mirror, command)) => {
                self.handle_probe(time_ns, (mirror, command), gain - median(&self.dark_gains));
                self.after_probe(place);
            }
            (Stage::Probe(place), Purpose::Group(number, pattern)) => {
                self.handle_group(time_ns, place, (number, pattern), gain);
            }
            (Stage::Locate(place), Purpose::Locate(target, turn)) => {
                let (gain, probes) = (gain - median(&self.dark_gains), self.search_probes(target, turn));
                // The readings of a spot have the same noise, and these are of single mirrors.
                if self.group() == 1
                    && let [probe] = probes[..]
                {
                    self.keep(time_ns, probe, gain);
                }
                self.handle_search(place, &probes, gain);
            }
            (Stage::Verify, Purpose::Verify(is_calibrated)) => {
                self.verification.handle_reading(is_calibrated, gain - median(&self.dark_gains));
                if self.verification.is_complete(VERIFY_READINGS) {
                    self.refresh_noise();
                    self.end();
                }
            }
            _ => {}
        }
    }

    /// The next probe of a single mirror, which awaits a reading from now on.
    pub(super) fn next_probe(&mut self) -> Option<(usize, [f64; 2])> {
        let mirror = probes::next_mirror(&self.jobs, self.cursor)?;
        self.cursor = (mirror + 1) % self.jobs.len();
        let quantities = self.quantities((mirror, self.spots.len() - 1));
        let job = &mut self.jobs[mirror];
        job.is_pending = true;
        let (probe, aim) = (job.next_probe(), job.aim);
        let command = [0, 1].map(|axis| aim[axis] - quantities[OFFSET + axis] + probe[axis]);
        Some((mirror, self.within(command)))
    }

    /// The light of a mirror that was probed.
    pub(super) fn handle_probe(&mut self, time_ns: Nanos, (mirror, command): (usize, [f64; 2]), gain: f64) {
        self.keep(time_ns, (mirror, command), gain);
        self.judge(mirror, command, gain);
        self.jobs[mirror].is_pending = false;
    }

    /// Readings that are still to come.
    pub(super) fn remaining_readings(&self) -> f64 {
        let mirrors = self.optics.centres.len() as f64;
        let places = self.setup.spots.len();
        let has_groups = self.spots.iter().any(|spot| spot.group > 1);
        let is_weak = has_groups || self.signal().is_some_and(|signal| signal.is_weak());
        let usual = |place: usize| EXPECTED_READINGS[usize::from(place > 0 || self.is_refinement())];
        let expected = |place: usize| if is_weak { f64::from(probes::READINGS_MAX) } else { usual(place) };
        let verify = (2 * VERIFY_READINGS + DARK_READINGS) as f64;
        let later = |from: usize| (from..places).map(|place| mirrors * expected(place)).sum::<f64>() + verify;
        let open = |place: usize| {
            let jobs = self.jobs.iter().filter(|job| job.state == State::Open);
            jobs.map(|job| (expected(place) - f64::from(job.readings)).max(1.0)).sum::<f64>()
        };
        match self.stage {
            // A place to which the receiver returns keeps the mirrors that were located there.
            Stage::Await(place) | Stage::Dark(place) if self.jobs.is_empty() || self.places.last() != Some(&place) => {
                later(place)
            }
            Stage::Await(place) | Stage::Dark(place) | Stage::Probe(place) | Stage::Locate(place) => {
                open(place) + later(place + 1)
            }
            Stage::Verify => verify,
            Stage::Ended => 0.0,
        }
    }

    /// Angles within the range of the array.
    pub(super) fn within(&self, [roll, yaw]: [f64; 2]) -> [f64; 2] {
        let axes = [&self.setup.capabilities.roll, &self.setup.capabilities.yaw];
        [0, 1].map(|axis| [roll, yaw][axis].clamp(axes[axis].min_rad.into(), axes[axis].max_rad.into()))
    }

    /// Brings the present spot up to date with the receiver's stand.
    pub(super) fn refresh_spot(&mut self) {
        let (stand, dark) = (&self.stand, &self.dark_gains);
        let Some(spot) = self.spots.last_mut() else { return };
        let count = stand.count().max(1.0);
        if !self.is_located {
            spot.tracked_m = stand.mean();
            spot.tracked_deviation_m = (stand.noise_m() / count.sqrt()).max(TRACKED_MIN_M);
        }
        spot.direct_gain = stand.direct_gain();
        spot.noise_relative = stand.direct_noise().unwrap_or(NOISE_RELATIVE);
        spot.direct_deviation = spot.noise_relative / (stand.direct_count().max(1) as f64).sqrt();
        if spot.group > 1 {
            return;
        }
        let usual = median(dark);
        let squares: f64 = dark.iter().map(|gain| (gain - usual).powi(2)).sum();
        spot.noise_gain = (squares / dark.len().saturating_sub(1).max(1) as f64).sqrt();
    }

    fn keep(&mut self, time_ns: Nanos, (mirror, command): (usize, [f64; 2]), gain: f64) {
        self.readings.push(Reading { spot: self.spots.len() - 1, mirror, command, gain });
        self.times.push(time_ns);
    }

    fn begin_probes(&mut self, place: usize) {
        self.refresh_spot();
        self.extend_estimate();
        if place >= self.setup.spots.len() {
            self.stage = Stage::Verify;
            return;
        }
        self.stage = Stage::Probe(place);
        self.cursor = 0;
        self.open_jobs();
        self.choose_group(place);
    }

    /// New jobs for the present spot. Mirrors that are located at this place already stay so.
    pub(super) fn open_jobs(&mut self) {
        self.groups.clear();
        let spot = self.spots.len() - 1;
        let place = self.places[spot];
        let earlier: Vec<State> = self.jobs.iter().map(|job| job.state).collect();
        let continues = !self.is_located && spot > 0 && self.places[spot - 1] == place && !earlier.is_empty();
        self.jobs = (0..self.optics.centres.len())
            .map(|mirror| {
                let mut job = self.job(mirror, spot);
                if continues && earlier[mirror] == State::Located {
                    job.state = State::Located;
                }
                if self.setup.unusable.contains(&(mirror as u32)) {
                    job.state = State::Excluded;
                }
                job
            })
            .collect();
    }

    /// The job of a mirror at a spot, by the present estimate.
    pub(super) fn job(&self, mirror: usize, spot: usize) -> Job {
        let led = self.spots[spot].led;
        let quantities = self.quantities((mirror, spot));
        let drift_rad = if self.is_refinement() { super::refinement::DRIFT_RAD } else { 0.0 };
        let deviation = self.aim_deviation((mirror, spot)).map(|deviation| deviation.hypot(drift_rad));
        let grid = Grid::normal([0.0; 2], deviation);
        let Some(aim) = self.optics.aim((mirror, led), &quantities) else {
            let mut job = Job::new(grid, [0.0; 2], [[0.01; 2]; 2], f64::MIN_POSITIVE);
            job.state = State::Excluded;
            return job;
        };
        let mut exact = quantities;
        exact[OFFSET..OFFSET + 4].fill(0.0);
        let peak = self.optics.mirror_gain((mirror, led), aim, &exact).max(f64::MIN_POSITIVE);
        let half = [0, 1].map(|axis| {
            [1.0, -1.0].map(|sign| {
                let (mut inside, mut outside) = (0.0, EDGE_RAD);
                for _ in 0..16 {
                    let middle = 0.5 * (inside + outside);
                    let mut at = aim;
                    at[axis] += sign * middle;
                    let gain = self.optics.mirror_gain((mirror, led), at, &exact);
                    *(if gain > 0.5 * peak { &mut inside } else { &mut outside }) = middle;
                }
                inside.max(1e-4)
            })
        });
        let mut job = Job::new(grid, aim, half, peak);
        let command = [0, 1].map(|axis| aim[axis] - quantities[OFFSET + axis]);
        if self.within(command) != command {
            job.state = State::Excluded;
        }
        job
    }

    /// Applies a reading to the grid of its mirror.
    pub(super) fn judge(&mut self, mirror: usize, command: [f64; 2], gain: f64) {
        let spot = self.spots.len() - 1;
        let (led, quantities) = (self.spots[spot].led, self.quantities((mirror, spot)));
        let (optics, peak) = (&self.optics, self.jobs[mirror].peak);
        let (relative, additive) = (self.spots[spot].noise_relative, self.spots[spot].noise_gain);
        self.jobs[mirror].handle_reading(gain, |[roll, yaw]| {
            let mut at = quantities;
            at[OFFSET] += roll;
            at[OFFSET + 1] += yaw;
            let gain = optics.mirror_gain((mirror, led), command, &at);
            Expected { gain, deviation: crate::fit::deviation((relative, additive), gain, peak) }
        });
    }

    /// What follows a reading of a probe.
    pub(super) fn after_probe(&mut self, place: usize) {
        let first = self.jobs.iter().filter(|job| job.state != State::Excluded).take(FIRST_MIRRORS);
        let (mut probed, mut lit, mut once) = (0, 0, true);
        for job in first {
            once &= job.readings == 1;
            probed += usize::from(job.readings > 0);
            lit += usize::from(job.is_lit());
        }
        let is_checked = probed >= FIRST_MIRRORS && once && !self.is_located;
        if is_checked && (lit as f64) < FIRST_SHARE * probed as f64 && self.knows_earlier_than(place) {
            self.begin_search(place);
            return;
        }
        if self.jobs.iter().all(|job| job.state != State::Open) && !self.confirm_changes() {
            self.complete_place(place);
        }
    }

    /// Whether a mirror showed light at an earlier place: only then its light should be at this one too.
    fn knows_earlier_than(&self, place: usize) -> bool {
        self.is_refinement() || self.lit_pairs().iter().any(|(_, spot)| self.places[*spot] < place)
    }

    /// The readings of a place are complete: its estimate is due.
    pub(super) fn complete_place(&mut self, place: usize) {
        self.refresh_spot();
        self.refresh_noise();
        self.complete = Some(place);
    }

    /// Pools the noise of the tracker at the present stand.
    fn refresh_noise(&mut self) {
        let count = self.stand.count();
        self.noise.count += count;
        self.noise.position_square += count * self.stand.noise_m().powi(2);
        self.noise.velocity_square += count * self.stand.velocity_noise_m_s().powi(2);
    }
}

#[cfg(test)]
mod tests {
    use super::super::test_room::Room;
    use super::*;

    #[test]
    fn the_readings_to_come_fall_with_each_reading_and_a_receiver_that_leaves_keeps_them() {
        let mut room = Room::new(20.0);
        room.step_until(|session| matches!(session.stage(), Stage::Probe(_)));
        let [x, y] = room.session.receiver_m().expect("reports");
        assert!((x + 1.2).abs() < 1e-3 && (y - 0.4).abs() < 1e-3, "{x} {y}");
        let mut before = room.session.remaining_readings();
        for _ in 0..100 {
            room.step(1.0);
            let now = room.session.remaining_readings();
            assert!(now <= before, "{now} after {before}");
            before = now;
        }
        room.session.leave(Nanos::MAX);
        assert_eq!((room.session.stage(), room.session.remaining_readings()), (Stage::Await(0), before));
        assert_eq!(room.session.receiver_m(), None);
    }

    #[test]
    fn a_report_of_gains_that_no_light_has_is_without_use_and_says_so() {
        let mut room = Room::new(20.0);
        room.step_until(|session| matches!(session.stage(), Stage::Probe(_)));
        let before = room.session.unused;
        room.step(1e12);
        assert!(room.session.impossible_gains().is_some_and(|[direct, _]| direct > 1.0));
        assert_eq!(room.session.unused, before + 1);
        room.step(1.0);
        assert_eq!(room.session.impossible_gains(), None);
    }
}
