//! `heliostat-lab calibrate`: how well `heliostat calibrate` measures a room, and what that is worth.
//!
//! Each episode is a room of its own, whose equipment differs from the scenario as `mismatch.level`
//! says. The session of `heliostat calibrate` runs in it in virtual time ([`live`]). The truth of the
//! simulated room judges the result ([`truth`]). Then the same episode runs three times in closed loop:
//! as assumed, with the corrections of the mirrors, and with the measured room too. All rates are
//! relative to the oracle in the true room.

pub mod live;
pub mod truth;

use anyhow::ensure;
use heliostat_array::calibration_file::CalibrationFile;
use heliostat_core::core::Controller;
use heliostat_core::policy::PolicyKind;
use heliostat_environment::closed_loop::ClosedLoop;
use heliostat_environment::episodes::{HeldOutEpisode, INSTANTS, WARM, held_out_episodes, start_ns};
use heliostat_environment::score::Sample;
use heliostat_models::{ActorSource, build};
use heliostat_proto::Stamp;
use heliostat_room::SimulatedRoom;
use heliostat_room::episode::Episode;
use heliostat_scenario::{ChannelMode, MismatchLevel, Scenario};
use serde::Serialize;

use crate::comparison::progress_bar;
use crate::evaluation::Estimate;
use truth::judge;

/// The settings of a study.
#[derive(Clone, Debug)]
pub struct Settings {
    /// The room as the controller assumes it; `mismatch.level` says how far true rooms differ, and its
    /// seed is the first one.
    pub scenario: Scenario,
    /// Index of the array that is calibrated; the room has no other one.
    pub array: usize,
    /// Number of consecutive seeds.
    pub seeds: usize,
    /// Episodes of each seed, each a room of its own.
    pub episodes: usize,
    /// The policy.
    pub policy: PolicyKind,
    /// Position and channel reports a second during a calibration.
    pub reports_hz: f64,
    /// Whether a second user crosses the light of the mirrors at each place.
    pub has_passer_by: bool,
    /// How far in m the tracker reports the receiver from its true place at the second spot.
    pub spot_error_m: f64,
}

/// The result of a study.
#[derive(Clone, Debug, Serialize)]
pub struct Study {
    /// Name of the scenario.
    pub scenario: String,
    /// Hash of the effective scenario.
    pub configuration: String,
    /// Index of the calibrated array; all rates are those of this array alone.
    pub array: usize,
    /// Name of the policy.
    pub policy: String,
    /// The first seed.
    pub seed: u64,
    /// Number of seeds.
    pub seeds: usize,
    /// Episodes in all, each a room of its own.
    pub episodes: usize,
    /// Sampling times of each seed.
    pub states: usize,
    /// Position and channel reports a second during a calibration.
    pub reports_hz: f64,
    /// Whether a second user crosses the light of the mirrors at each place.
    pub has_passer_by: bool,
    /// How far in m the tracker reports the receiver from its true place at the second spot.
    pub spot_error_m: f64,
    /// Whether the rooms do not differ from the scenario.
    pub is_as_described: bool,
    /// Means over all rooms, in one row.
    pub rows: [Row; 1],
    /// Every room.
    pub rooms: Vec<Room>,
}

/// One room.
#[derive(Clone, Debug, Serialize)]
pub struct Room {
    /// Its seed.
    pub seed: u64,
    /// Channel reports that served as readings.
    pub readings: usize,
    /// Room time in s while the receiver stood at its places.
    pub seconds: f64,
    /// Root mean square errors of roll and yaw of corrected mirrors at held-out places in degrees.
    pub pointing_deg: [f64; 2],
    /// Root mean square error of the LEDs' coordinates in cm.
    pub led_cm: f64,
    /// Error of the height of the tracker's frame in cm.
    pub frame_cm: f64,
    /// 95 % intervals that contain the truth, and all.
    pub covered: [usize; 2],
    /// Mirrors without a correction.
    pub uncorrected: usize,
    /// Spots that were searched, because few mirrors lit the receiver there.
    pub searched_spots: usize,
    /// Spots that most mirrors contradict.
    pub rejected_spots: usize,
    /// Whether the calibrated aims give more light: otherwise nothing is written, and the room stays as
    /// assumed.
    pub written: bool,
    /// Sum rate of the room as assumed, over that of the oracle.
    pub assumed_ratio: f64,
    /// The same with the corrections of the mirrors.
    pub mirrors_ratio: f64,
    /// The same with the measured room too.
    pub calibrated_ratio: f64,
}

/// Means over rooms with 95 % intervals.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// Readings of a calibration.
    pub readings: Estimate,
    /// Room time in s while the receiver stood at its places.
    pub seconds: Estimate,
    /// Root mean square error of roll of corrected mirrors at held-out places in degrees.
    pub roll_deg: Estimate,
    /// The same of yaw.
    pub yaw_deg: Estimate,
    /// Root mean square error of the LEDs' coordinates in cm.
    pub led_cm: Estimate,
    /// Error of the height of the tracker's frame in cm.
    pub frame_cm: Estimate,
    /// Share of the 95 % intervals that contain the truth.
    pub coverage: f64,
    /// Mirrors without a correction.
    pub uncorrected: Estimate,
    /// Rooms in which a spot was searched.
    pub searched: usize,
    /// Rooms in which a spot was rejected.
    pub rejected: usize,
    /// Rooms whose calibration is written.
    pub written: usize,
    /// Sum rate of the room as assumed, over that of the oracle.
    pub assumed_ratio: Estimate,
    /// The same with the corrections of the mirrors.
    pub mirrors_ratio: Estimate,
    /// The same with the measured room too.
    pub calibrated_ratio: Estimate,
    /// The last ratio minus the first one, room by room.
    pub difference_ratio: Estimate,
    /// Rooms in which this difference is negative.
    pub worse: usize,
}

/// Runs a study with a progress bar on standard error.
///
/// # Errors
/// A scenario that cannot be calibrated, a policy that cannot be built for it, or a calibration without
/// end.
pub fn study(settings: &Settings) -> anyhow::Result<Study> {
    ensure!(settings.seeds > 0 && settings.episodes > 0, "a study needs at least one seed and one episode");
    let scenario = settings.scenario.with_array_alone(settings.array)?;
    let mode = scenario.channel.mode;
    ensure!(
        mode == ChannelMode::Specular,
        "channel.mode = \"{}\" has no spot of light: expected \"specular\"",
        mode.name()
    );
    let rates = ["channel", "positions"].map(|stream| format!("streams.{stream}.rate_hz={}", settings.reports_hz));
    let alone = live::with_receiver(&scenario.with_overrides(&rates)?)?;
    let (carried, walk) = match settings.has_passer_by {
        true => live::with_passer_by(&alone)?,
        false => {
            let walk = live::walk(&alone, "");
            (alone, walk)
        }
    };
    let states = settings.episodes * INSTANTS;
    let episodes = held_out_episodes(&scenario, scenario.read_trace()?.as_deref(), (states, settings.seeds), WARM)?;
    let bar = progress_bar()?;
    bar.set_length(episodes.len() as u64);
    bar.set_message("rooms");
    let mut rooms = Vec::new();
    for episode in &episodes {
        rooms.push(room(settings, &scenario, (&carried, &walk), episode)?);
        bar.inc(1);
    }
    bar.finish_and_clear();
    Ok(Study {
        scenario: scenario.name.clone(),
        configuration: settings.scenario.hash(),
        array: settings.array,
        policy: settings.policy.name(),
        seed: scenario.seed,
        seeds: settings.seeds,
        episodes: rooms.len(),
        states,
        reports_hz: settings.reports_hz,
        has_passer_by: settings.has_passer_by,
        spot_error_m: settings.spot_error_m,
        is_as_described: scenario.mismatch.level == MismatchLevel::None,
        rows: [Row::of(&rooms)],
        rooms,
    })
}

/// Calibrates the room of an episode with a carried receiver, and runs the episode in closed loop without and
/// with the result.
fn room(
    settings: &Settings,
    scenario: &Scenario,
    (carried, walk): (&Scenario, &str),
    episode: &HeldOutEpisode,
) -> anyhow::Result<Room> {
    // The same seed is the same equipment.
    let run = live::run(carried, walk, episode.seed, live::with_spot_error(carried, settings.spot_error_m))?;
    let errors = judge(&run.outcome, carried, episode.seed)?;
    let written = run.outcome.verification.is_improvement();
    let calibration = run.outcome.calibration();
    let mut oracle = 0.0;
    let trace = scenario.read_trace()?;
    episode.solve(scenario, trace.as_deref(), |world, angles| oracle += Sample::of(world, angles).sum_rate_mbps)?;
    let ratio = |assumed: &Scenario, calibration: Option<&CalibrationFile>| {
        Ok::<f64, anyhow::Error>(sum_rate(settings.policy, (scenario, assumed), episode, calibration)? / oracle)
    };
    let assumed_ratio = ratio(scenario, None)?;
    let [mirrors_ratio, calibrated_ratio] = if written {
        let measured = run.outcome.measured_room(scenario, 0);
        [ratio(scenario, Some(&calibration))?, ratio(&measured, Some(&calibration))?]
    } else {
        [assumed_ratio; 2]
    };
    Ok(Room {
        seed: episode.seed,
        readings: run.outcome.readings,
        seconds: run.busy_s,
        pointing_deg: errors.pointing_deg,
        led_cm: errors.led_m * 100.0,
        frame_cm: errors.frame_m * 100.0,
        covered: errors.covered,
        uncorrected: scenario.mirror_count() - errors.corrected,
        searched_spots: run.searched.len(),
        rejected_spots: run.outcome.rejected_places.len(),
        written,
        assumed_ratio,
        mirrors_ratio,
        calibrated_ratio,
    })
}

/// The sum of the sum rates at the sampling times of an episode, for a controller that assumes the
/// second room, with or without corrections of the array.
fn sum_rate(
    policy: PolicyKind,
    (scenario, assumed): (&Scenario, &Scenario),
    episode: &HeldOutEpisode,
    calibration: Option<&CalibrationFile>,
) -> anyhow::Result<f64> {
    let mut room = SimulatedRoom::new(scenario, scenario.read_trace()?.as_deref(), episode.seed)?;
    if let Some(file) = calibration {
        room.set_calibration(0, &file.message(Stamp { source: 1, sequence: 1, time_ns: 0 }))?;
    }
    let inner = Episode::of_room(room, scenario, episode.seed, start_ns());
    let policy = build(policy, assumed, &ActorSource::Shipped)?;
    let mut closed = ClosedLoop::new(inner, Controller::new(assumed, assumed.channel_model()?, policy, 1));
    let mut sum = 0.0;
    for instant in &episode.instants_ns {
        while let Some((now, event)) = closed.poll_event(*instant) {
            closed.deliver(now, event, &mut |_| {})?;
        }
        closed.advance(*instant);
        sum += Sample::of(closed.room().world(), closed.room().angles()).sum_rate_mbps;
    }
    Ok(sum)
}

impl Row {
    fn of(rooms: &[Room]) -> Self {
        let over_rooms = |value: &dyn Fn(&Room) -> f64| Estimate::of(&rooms.iter().map(value).collect::<Vec<_>>());
        let difference = |room: &Room| room.calibrated_ratio - room.assumed_ratio;
        let covered = [0, 1].map(|index| rooms.iter().map(|room| room.covered[index]).sum::<usize>());
        Self {
            readings: over_rooms(&|room| room.readings as f64),
            seconds: over_rooms(&|room| room.seconds),
            roll_deg: over_rooms(&|room| room.pointing_deg[0]),
            yaw_deg: over_rooms(&|room| room.pointing_deg[1]),
            led_cm: over_rooms(&|room| room.led_cm),
            frame_cm: over_rooms(&|room| room.frame_cm),
            coverage: covered[0] as f64 / covered[1] as f64,
            uncorrected: over_rooms(&|room| room.uncorrected as f64),
            searched: rooms.iter().filter(|room| room.searched_spots > 0).count(),
            rejected: rooms.iter().filter(|room| room.rejected_spots > 0).count(),
            written: rooms.iter().filter(|room| room.written).count(),
            assumed_ratio: over_rooms(&|room| room.assumed_ratio),
            mirrors_ratio: over_rooms(&|room| room.mirrors_ratio),
            calibrated_ratio: over_rooms(&|room| room.calibrated_ratio),
            difference_ratio: over_rooms(&difference),
            worse: rooms.iter().filter(|room| difference(room) < 0.0).count(),
        }
    }
}
