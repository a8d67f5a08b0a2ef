//! The procedure on a live room, without I/O: reports in, commands out.
//!
//! # Calling order
//!
//! 1. [`Session::new`]; [`Session::resume`] with the log of an earlier session.
//! 2. [`Session::handle_users`] and [`Session::handle_channel`] for each report, and
//!    [`Session::handle_command_delay`] when telemetry shows when a command was applied.
//! 3. [`Session::next_command`] after each of them, and at [`Session::next_wake`]: the angles to
//!    command now. The array must hold them until the next ones, so the caller repeats the last
//!    command before its validity ends. The first of these calls after the last reading of a place
//!    makes the joint estimate. A caller that has to save the readings before it calls
//!    [`Session::run_estimate`] itself, while [`Session::is_estimate_due`].
//! 4. [`Session::stage`] says what the receiver's holder has to do. [`Stage::Ended`] is the end:
//!    [`Session::outcome`] has the result.
//!
//! All times are those of the room. `now` is an argument.
//!
//! # Stages
//!
//! ```text
//! Await --stands at the spot--> Dark --4 readings--> Probe --all located--> fit --> Await (next spot)
//!   ^                             |                   |  |
//!   +-----------leaves------------+-------------------+  +--few lit--> Locate --> Probe
//!
//! after the last spot:   Await --> Dark --> Verify --> Ended
//! ```
//!
//! A refinement, [`Session::refine`], has the same stages. It compares the former aims of the mirrors that
//! have changed with their new ones, and ends after the last spot if none has.

mod fitting;
mod groups;
mod log;
mod log_check;
mod pause;
pub(crate) mod refinement;
mod search;
mod stages;
#[cfg(test)]
mod test_room;
mod timing;

use heliostat_channel::{ChannelModel, MirrorAngles, Vec3};
use heliostat_proto::{Capabilities, ChannelReport, Nanos, UserReport};
use thiserror::Error;

use crate::fit::{Estimate, Reading};
use crate::optics::Optics;
use crate::outcome::{Outcome, Verification};
use crate::parameters::{Prior, Spot};
use crate::probes::{Job, State};
use crate::signal::Signal;
use crate::stand::{Moved, Stand, median};

pub use fitting::aim_deviation;
pub use log::Log;
use log_check::GAIN;
pub use refinement::Change;
use timing::Timing;

/// Why a session cannot start.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum SetupError {
    /// The receiver has several branches, or one that does not face up.
    #[error("the receiver has several branches, or one that does not face up: expected one branch that faces up")]
    Receiver,
    /// The channel mode has no spot of light.
    #[error("channel.mode has no spot of light: expected \"specular\"")]
    Mode,
    /// No such array.
    #[error("unknown array {found}: expected 0 to {last}, the arrays of the scenario")]
    Array {
        /// The index.
        found: usize,
        /// The highest index.
        last: usize,
    },
    /// The array has another number of mirrors than the scenario.
    #[error("the array has {found} mirrors: expected {expected}, as in the scenario")]
    Mirrors {
        /// Mirrors that the array announces.
        found: usize,
        /// Mirrors of the scenario.
        expected: usize,
    },
    /// No spot.
    #[error("no spot: expected at least one, better three in a wide triangle")]
    NoSpots,
    /// The log of an earlier session is of another array.
    #[error("the readings are of {found} mirrors: expected {expected}, as the array has")]
    OtherLog {
        /// Mirrors of the log.
        found: usize,
        /// Mirrors of the array.
        expected: usize,
    },
    /// A field of the log that no session gives.
    #[error("the readings have {0}")]
    Field(String),
    /// The log is of a calibration, and the session is a refinement of another one, or the reverse.
    #[error("the readings are not of this refinement: expected a new file, or those of the same --refine")]
    OtherFormer,
    /// The log of the former calibration has no readings.
    #[error("the former calibration has no readings: expected those of a complete calibration")]
    Incomplete,
    /// The readings of the former calibration do not give the corrections in use.
    #[error("the readings give other corrections than those in use: expected the readings from which they were made")]
    OtherCorrections,
}

/// A place at which the receiver shall stand, in the room's frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place {
    /// x and y in m; `None`: anywhere, at least half a metre from the other spots.
    pub floor_m: Option<[f64; 2]>,
    /// Height of the detector above the floor in m.
    pub height_m: f64,
}

/// What a session needs to know.
#[derive(Clone, Debug)]
pub struct Setup {
    /// The nominal room.
    pub model: ChannelModel,
    /// Its dimensions.
    pub room: heliostat_scenario::Room,
    /// Index of the array.
    pub array: usize,
    /// What the array announces.
    pub capabilities: Capabilities,
    /// Prior spreads of the differences between the nominal room and the true one.
    pub prior: Prior,
    /// The spots, in the order of the walk.
    pub spots: Vec<Place>,
    /// The place at which the result is verified.
    pub verify: Place,
    /// Number of the user who holds the receiver; `None`: the only one.
    pub user: Option<u32>,
    /// Mirrors known not to follow.
    pub unusable: Vec<u32>,
}

/// What is going on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Stage {
    /// The receiver is not at the place of this index; `spots.len()` is that of the verification.
    Await(usize),
    /// All mirrors are turned away.
    Dark(usize),
    /// Mirrors are probed.
    Probe(usize),
    /// The spot is not where the tracker reports it: it is searched.
    Locate(usize),
    /// Nominal and calibrated aims are compared.
    Verify,
    /// The session has ended.
    Ended,
}

/// How far a session is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Progress {
    /// The stage.
    pub stage: Stage,
    /// Mirrors located at the present spot, and mirrors to be probed there.
    pub located: (usize, usize),
    /// Readings of mirrors so far.
    pub readings: usize,
    /// Channel reports that served no reading: lost, too early, or with a body in the path.
    pub unused: u64,
    /// Estimated time in s until the end, without the walks.
    pub remaining_s: f64,
}

/// A calibration of one array.
#[derive(Clone, Debug)]
pub struct Session {
    setup: Setup,
    optics: Optics,
    timing: Timing,
    stage: Stage,
    stand: Stand,
    /// Angles that are dark for the receiver at its present place.
    dark_angles: Vec<[f64; 2]>,
    dark_gains: Vec<f64>,
    /// Time of the last of them.
    dark_ns: Nanos,
    /// Spots at which the receiver has stood; several can belong to one place of the setup.
    spots: Vec<Spot>,
    /// The place of the setup of each spot.
    places: Vec<usize>,
    readings: Vec<Reading>,
    /// Times of the readings at the present spot.
    times: Vec<Nanos>,
    jobs: Vec<Job>,
    cursor: usize,
    groups: groups::Groups,
    /// Whether the present spot was searched.
    is_located: bool,
    /// Search of the present spot.
    search: Option<search::Search>,
    estimate: Option<Estimate>,
    /// The place whose readings are complete, until the estimate that follows them.
    complete: Option<usize>,
    verification: Verification,
    rejected: Vec<usize>,
    outcome: Option<Outcome>,
    /// The complete calibration that this session refines.
    former: Option<refinement::Former>,
    changes: Vec<Change>,
    noise: TrackerNoise,
    unused: u64,
    /// The gains of the latest channel report, if no light has them.
    impossible: Option<[f64; 2]>,
    last_reading_ns: Nanos,
}

/// Pooled noise of the tracker.
#[derive(Clone, Copy, Debug, Default)]
struct TrackerNoise {
    count: f64,
    position_square: f64,
    velocity_square: f64,
}

impl Session {
    /// A session before its first report.
    ///
    /// # Errors
    /// [`SetupError`].
    pub fn new(setup: Setup) -> Result<Self, SetupError> {
        if setup.model.mode != heliostat_channel::Mode::Specular {
            return Err(SetupError::Mode);
        }
        let arrays = setup.model.mirrors.arrays();
        let Some(array) = arrays.get(setup.array) else {
            return Err(SetupError::Array { found: setup.array, last: arrays.len() - 1 });
        };
        let expected = array.len();
        if setup.capabilities.mirrors() != expected {
            return Err(SetupError::Mirrors { found: setup.capabilities.mirrors(), expected });
        }
        if setup.spots.is_empty() {
            return Err(SetupError::NoSpots);
        }
        let optics = Optics::new(&setup.model, setup.array).ok_or(SetupError::Receiver)?;
        Ok(Self {
            timing: Timing::new(&setup.capabilities),
            optics,
            stage: Stage::Await(0),
            stand: Stand::default(),
            dark_angles: Vec::new(),
            dark_gains: Vec::new(),
            dark_ns: 0,
            spots: Vec::new(),
            places: Vec::new(),
            readings: Vec::new(),
            times: Vec::new(),
            jobs: Vec::new(),
            cursor: 0,
            groups: groups::Groups::default(),
            is_located: false,
            search: None,
            estimate: None,
            complete: None,
            verification: Verification::default(),
            rejected: Vec::new(),
            outcome: None,
            former: None,
            changes: Vec::new(),
            noise: TrackerNoise::default(),
            unused: 0,
            impossible: None,
            last_reading_ns: 0,
            setup,
        })
    }

    /// What is going on.
    pub fn stage(&self) -> Stage {
        self.stage
    }

    /// The place of the setup at which the receiver shall be; `None` at the end.
    pub fn place(&self) -> Option<Place> {
        match self.stage {
            Stage::Await(place) | Stage::Dark(place) | Stage::Probe(place) | Stage::Locate(place) => {
                Some(self.place_of(place))
            }
            Stage::Verify => Some(self.setup.verify),
            Stage::Ended => None,
        }
    }

    /// Where the latest position reports place the receiver: x and y in m, in the room's frame.
    pub fn receiver_m(&self) -> Option<[f64; 2]> {
        let [x, y] = self.stand.latest()?;
        let at = self.optics.array().room_from_wall(&Vec3::new(x, y, 0.0));
        Some([at.x, at.y])
    }

    /// The result, once the session has ended.
    pub fn outcome(&self) -> Option<&Outcome> {
        self.outcome.as_ref()
    }

    /// Number of the user who holds the receiver.
    fn user_of(&self, mut users: impl Iterator<Item = u32>) -> Option<u32> {
        match self.setup.user {
            Some(user) => users.find(|found| *found == user),
            None => users.next(),
        }
    }

    /// The number of the user who holds the receiver is known from now on.
    pub fn set_user(&mut self, user: u32) {
        self.setup.user = Some(user);
    }

    /// Handles a position report.
    pub fn handle_users(&mut self, report: &UserReport) {
        let Some(user) = self.user_of(report.users.iter().map(|user| user.user)) else { return };
        let Some(state) = report.users.iter().find(|state| state.user == user) else { return };
        let [x, y, _] = state.position_m.map(f64::from);
        let [along_x, along_y] = state.velocity_m_s.map(f64::from);
        let at = self.optics.array().wall_from_room(&Vec3::new(x, y, 0.0));
        let velocity = self.optics.array().wall_from_room(&Vec3::new(along_x, along_y, 0.0));
        match self.stand.handle_position(report.stamp.time_ns, [at.x, at.y], [velocity.x, velocity.y]) {
            Some(Moved::Left(since)) => self.leave(since),
            Some(Moved::Stands(_)) | None => {}
        }
        if let Stage::Await(place) = self.stage
            && !self.is_estimate_due()
            && self.stand.is_standing()
            && self.is_at(place)
        {
            self.arrive(place);
        }
    }

    /// Handles a channel report.
    pub fn handle_channel(&mut self, report: &ChannelReport) {
        let time_ns = report.stamp.time_ns;
        self.timing.handle_sample(time_ns);
        let lost = self.timing.take_lost(time_ns);
        for purpose in lost {
            self.forget(purpose);
        }
        let Some(user) = self.user_of(report.users.iter().map(|user| user.user)) else { return };
        let Some(channel) = report.users.iter().find(|channel| channel.user == user) else { return };
        let gains = [channel.los_gain, channel.irs_gain].map(f64::from);
        self.impossible = (!gains.iter().all(|gain| GAIN.contains(gain))).then_some(gains);
        if !self.stand.is_standing() || self.stage == Stage::Ended {
            return;
        }
        if self.impossible.is_some() {
            self.unused += 1;
            return;
        }
        let is_clear = self.stand.handle_direct(f64::from(channel.los_gain));
        let Some(purpose) = self.timing.purpose_at(time_ns) else {
            self.unused += 1;
            return;
        };
        if !is_clear {
            self.unused += 1;
            self.reject(purpose);
            return;
        }
        self.last_reading_ns = time_ns;
        self.handle_reading(time_ns, purpose, f64::from(channel.irs_gain));
    }

    /// Notes the time in ns from a command to its application, as telemetry shows it.
    pub fn handle_command_delay(&mut self, delay_ns: Nanos) {
        self.timing.handle_delay(delay_ns);
    }

    /// No mirror awaits a reading.
    fn drop_pending(&mut self) {
        self.groups.clear();
        self.jobs.iter_mut().for_each(|job| job.is_pending = false);
    }

    /// The angles to command at `now`, if a command is due.
    pub fn next_command(&mut self, now: Nanos) -> Option<MirrorAngles> {
        self.run_estimate();
        if !self.timing.is_due(now) {
            return None;
        }
        let (purpose, angles) = self.plan()?;
        self.timing.handle_sent(now, purpose, &angles);
        Some(angles)
    }

    /// Whether the readings of a place are complete, and their estimate is not made yet.
    pub fn is_estimate_due(&self) -> bool {
        self.complete.is_some()
    }

    /// Index of the place whose estimate is due. The stage can be another place's: after a pause the estimate of the
    /// place before is made again.
    pub fn due_place(&self) -> Option<usize> {
        self.complete
    }

    /// Makes the estimate that is due; with many mirrors it takes minutes.
    pub fn run_estimate(&mut self) {
        if let Some(place) = self.complete.take() {
            self.end_place(place);
        }
    }

    /// The time of the next call of [`next_command`](Self::next_command) without a report, after one
    /// at `now`; `Nanos::MAX` where only a report can cause a command.
    pub fn next_wake(&self, now: Nanos) -> Nanos {
        let due_ns = self.timing.due_ns();
        if due_ns > now { due_ns } else { Nanos::MAX }
    }

    /// How far the session is.
    pub fn progress(&self) -> Progress {
        let open = self.jobs.iter().filter(|job| job.state == State::Open).count();
        let probed = self.jobs.iter().filter(|job| job.state != State::Excluded).count();
        Progress {
            stage: self.stage,
            located: (probed - open, probed),
            readings: self.readings.len(),
            unused: self.unused,
            remaining_s: self.remaining_readings() * self.timing.seconds_per_reading(),
        }
    }

    /// The light of single mirrors at the present spot, compared with the noise of its readings; `None` before the
    /// dark ones.
    pub fn signal(&self) -> Option<Signal> {
        let (Stage::Probe(place), Some(spot)) = (self.stage, self.spots.last()) else { return None };
        let probed = self.jobs.iter().filter(|job| job.state != State::Excluded);
        let gain = median(&probed.map(|job| job.peak).collect::<Vec<_>>());
        (gain > 0.0).then_some(Signal { place, gain, ratio: gain / spot.noise_gain })
    }

    /// Direct gain and gain of the mirrors in the latest channel report, if they are no shares of an LED's light.
    pub fn impossible_gains(&self) -> Option<[f64; 2]> {
        self.impossible
    }

    /// Readings of mirrors so far.
    pub fn readings(&self) -> &[Reading] {
        &self.readings
    }

    /// The joint estimate so far.
    pub fn estimate(&self) -> Option<&Estimate> {
        self.estimate.as_ref()
    }

    /// Number of spots, without the place of the verification.
    pub fn spot_count(&self) -> usize {
        self.setup.spots.len()
    }

    /// The nominal equipment, in the frame of the wall.
    pub fn optics(&self) -> &Optics {
        &self.optics
    }

    fn place_of(&self, place: usize) -> Place {
        self.setup.spots.get(place).copied().unwrap_or(self.setup.verify)
    }
}
