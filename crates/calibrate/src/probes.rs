//! Which mirror to probe next at a spot, and where.
//!
//! Each mirror has a grid of the deviations of its light from the prediction. While the mirror was
//! dark, a probe goes where most of the probability fits into one window of light. Then probes go
//! to the edges, half of the gain, where a reading says most. The axis is that of the larger
//! deviation. Some mirrors take turns, so that the latency of the reports costs no rate. They are not
//! all: a short stay at a spot shall locate a part of a large array.

use crate::grid::{Expected, Grid};

/// A mirror is located at a spot when both deviations are below this, in rad.
const TARGET_RAD: f64 = 0.15 * std::f64::consts::PI / 180.0;

/// Fewest readings of a mirror at a spot.
const READINGS_MIN: u32 = 3;

/// Most readings of a mirror at a spot that shows light.
pub const READINGS_MAX: u32 = 10;

/// Most readings of a mirror at a spot that shows none.
const DARK_MAX: u32 = 7;

/// Most times that a surprise at a spot is measured again.
const CONFIRMATIONS_MAX: u32 = 3;

/// Mirrors that take turns: more than the commands whose reports are on their way, and two coded groups.
const TURNS: usize = 64;

/// Share of the largest gain from which on a reading counts as light.
pub(crate) const LIT_SHARE: f64 = 0.25;

/// The state of a mirror at a spot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum State {
    /// More probes are due.
    Open,
    /// Its light is located.
    Located,
    /// It showed no light here.
    Dark,
    /// It cannot be aimed at this spot, or is known not to follow.
    Excluded,
}

/// One mirror at one spot.
#[derive(Clone, Debug)]
pub struct Job {
    /// The deviation of the light from the prediction: roll and yaw in rad.
    pub grid: Grid,
    /// True angles at which the light is centred by the prediction, in rad.
    pub aim: [f64; 2],
    /// Angles from the centre to half of the gain, in rad: each axis upwards and downwards.
    pub half: [[f64; 2]; 2],
    /// The largest gain by the prediction.
    pub peak: f64,
    /// The state.
    pub state: State,
    /// Readings so far.
    pub readings: u32,
    /// Fewest readings until it is located.
    least: u32,
    /// How often it was opened again.
    confirmations: u32,
    /// The largest reading.
    pub brightest: f64,
    /// A reading is awaited.
    pub is_pending: bool,
    /// Probes of each axis, whose parity gives the side.
    sides: [u32; 2],
}

impl Job {
    /// A mirror before its first probe.
    pub fn new(grid: Grid, aim: [f64; 2], half: [[f64; 2]; 2], peak: f64) -> Self {
        Self {
            grid,
            aim,
            half,
            peak,
            state: State::Open,
            readings: 0,
            least: READINGS_MIN,
            confirmations: 0,
            brightest: 0.0,
            is_pending: false,
            sides: [0; 2],
        }
    }

    /// Opens a located mirror again, for about as many readings: a surprise has to be confirmed. Whether it
    /// was opened.
    pub fn confirm(&mut self) -> bool {
        let is_due = self.state == State::Located && self.confirmations < CONFIRMATIONS_MAX;
        if is_due {
            self.confirmations += 1;
            self.least = self.readings + self.readings.min(READINGS_MAX / 2);
            self.state = State::Open;
        }
        is_due
    }

    /// Whether it was measured again.
    pub fn is_measured_again(&self) -> bool {
        self.confirmations > 0
    }

    /// Whether it showed light.
    pub fn is_lit(&self) -> bool {
        self.brightest > LIT_SHARE * self.peak
    }

    /// The deviation from the aim at which the next probe shall be, if the mirror's own deviation
    /// is as the grid says: the commanded angles are aim + this - estimated offset.
    pub fn next_probe(&mut self) -> [f64; 2] {
        let (mean, deviation) = self.grid.moments();
        if !self.is_lit() {
            let half = self.half.map(|sides| 0.5 * (sides[0] + sides[1]));
            return self.grid.best_window(half).0.map(|at| -at);
        }
        let axis = usize::from(deviation[1] > deviation[0]);
        let side = (self.sides[axis] % 2) as usize;
        self.sides[axis] += 1;
        let mut target = mean.map(|at| -at);
        target[axis] += if side == 0 { self.half[axis][0] } else { -self.half[axis][1] };
        target
    }

    /// Applies a reading.
    pub fn handle_reading(&mut self, gain: f64, expected: impl Fn([f64; 2]) -> Expected) {
        self.grid.observe(gain, self.peak, expected);
        self.readings += 1;
        self.brightest = self.brightest.max(gain);
        if self.state != State::Open {
            return;
        }
        let (_, deviation) = self.grid.moments();
        let is_located = deviation.iter().all(|deviation| *deviation < TARGET_RAD);
        if self.is_lit() && self.readings >= self.least && (is_located || self.readings >= READINGS_MAX) {
            self.state = State::Located;
        } else if !self.is_lit() && self.readings >= DARK_MAX {
            self.state = State::Dark;
        }
    }
}

/// The mirrors that take turns: the first open ones.
fn turns(jobs: &[Job]) -> impl Iterator<Item = usize> {
    (0..jobs.len()).filter(|mirror| jobs[*mirror].state == State::Open).take(TURNS)
}

/// The next mirror of those that take turns that awaits no reading, from `cursor` on, in a ring.
pub fn next_mirror(jobs: &[Job], cursor: usize) -> Option<usize> {
    let later = turns(jobs).filter(|mirror| *mirror >= cursor);
    later.chain(turns(jobs).filter(|mirror| *mirror < cursor)).find(|mirror| !jobs[*mirror].is_pending)
}

/// Of the mirrors that take turns, how many await no reading, and how many do.
pub fn free_and_pending(jobs: &[Job]) -> (usize, usize) {
    let pending = turns(jobs).filter(|mirror| jobs[*mirror].is_pending).count();
    (turns(jobs).count() - pending, pending)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_short_stay_locates_a_part_of_a_large_array() {
        let job = || Job::new(Grid::normal([0.0; 2], [0.001; 2]), [0.0; 2], [[0.01; 2]; 2], 1.0);
        let mut jobs: Vec<Job> = (0..400).map(|_| job()).collect();
        let mut cursor = 0;
        // Each mirror needs three readings: of 600, a ring of all mirrors would locate none before its third turn.
        for _ in 0..600 {
            let mirror = next_mirror(&jobs, cursor).expect("an open one");
            cursor = (mirror + 1) % jobs.len();
            jobs[mirror].handle_reading(1.0, |_| Expected { gain: 1.0, deviation: 0.1 });
        }
        let located = jobs.iter().filter(|job| job.state == State::Located).count();
        assert!(located > 600 / 3 - TURNS, "{located}");
        jobs.iter_mut().for_each(|job| job.is_pending = true);
        assert_eq!(next_mirror(&jobs, cursor), None);
    }

    #[test]
    fn a_located_mirror_is_opened_again_for_as_many_readings_and_some_times_at_most() {
        let mut job = Job::new(Grid::normal([0.0; 2], [0.001; 2]), [0.0; 2], [[0.01; 2]; 2], 1.0);
        let read = |job: &mut Job, readings: u32| {
            for _ in 0..readings {
                job.handle_reading(1.0, |_| Expected { gain: 1.0, deviation: 0.1 });
            }
            job.state
        };
        assert!(!job.confirm(), "it is open");
        assert_eq!(read(&mut job, READINGS_MIN), State::Located);
        assert!(!job.is_measured_again() && job.confirm() && job.is_measured_again());
        assert_eq!(read(&mut job, READINGS_MIN - 1), State::Open);
        assert_eq!(read(&mut job, 1), State::Located);
        for _ in 1..CONFIRMATIONS_MAX {
            assert!(job.confirm());
            assert_eq!(read(&mut job, READINGS_MAX / 2), State::Located);
        }
        assert!(!job.confirm(), "not without end");
    }
}
