//! A calibration against the simulated room in virtual time: one user carries one receiver from spot to
//! spot, reports arrive as late and noisy as the scenario says, and commands turn simulated mirrors.

use std::collections::BTreeSet;
use std::fmt::Write;

use anyhow::{Context, ensure};
use heliostat_array::moment::Moment;
use heliostat_calibrate::places::{default_spots, default_verification};
use heliostat_calibrate::{Outcome, Place, Prior, Session, Setup, Stage};
use heliostat_channel::{MirrorAngles, Vec3};
use heliostat_proto::{Capabilities, MirrorCommand, UserReport};
use heliostat_room::episode::{Episode, Event};
use heliostat_room::reports::Report;
use heliostat_scenario::{MinRate, MismatchLevel, Scenario};

/// Time at each spot in s.
const STAY_S: f64 = 120.0;

/// Time of a walk between two spots in s.
const WALK_S: f64 = 4.0;

/// A room in which the walk takes three times as long ends a session that does not.
const PATIENCE: f64 = 3.0;

/// Time between two commands with the same angles in ns.
const REPEAT_NS: u64 = 100_000_000;

/// Validity of a command in ms.
const VALIDITY_MS: u32 = 400;

/// The second user of a room with one who passes.
const PASSER_BY: u32 = 1;

/// When this user is on which side of the mirrors: times in s after the beginning of each stay, and shares of half the
/// length of their wall.
const CROSSING: [(f64, f64); 5] = [(0.0, 0.92), (15.0, 0.92), (21.0, -0.92), (30.0, -0.92), (36.0, 0.92)];

/// Distance in m from the wall of the mirrors at which this user crosses their light.
const CROSSING_M: f64 = 0.6;

/// Distance in m from a spot within which the receiver is at it, as far as the error of a tracker there is concerned.
const AT_SPOT_M: f64 = 0.6;

/// The spot at which a tracker is in error: the first one with which the light of an earlier spot can disagree.
const WRONG_SPOT: usize = 1;

/// The room of a calibration: one receiver that is carried and put down level, and no obstacles.
///
/// # Errors
/// A room whose users come and go, or that does not exist with one user.
pub fn with_receiver(scenario: &Scenario) -> anyhow::Result<Scenario> {
    ensure!(
        scenario.users.arrivals.is_none(),
        "users.arrivals: a calibration needs a fixed number of users; remove the arrivals"
    );
    let mut changes =
        ["blockage.obstacles_per_m2=0", "users.count=1", "users.trace=walk.csv"].map(String::from).to_vec();
    if let MinRate::Each(rates) = &scenario.users.min_rate_mbps {
        changes.extend(rates.first().map(|rate| format!("users.min_rate_mbps={rate:?}")));
    }
    if scenario.users.orientation.is_some() {
        changes.push("users.orientation.model=up".to_owned());
    }
    Ok(scenario.with_overrides(&changes)?)
}

/// The places of a calibration: the spots, then that of the verification.
pub fn places(scenario: &Scenario) -> Vec<Place> {
    default_spots(scenario).into_iter().chain([default_verification(scenario)]).collect()
}

/// The recorded walk of the receiver, whose holder faces the mirrors; further rows are those of other
/// users.
pub fn walk(scenario: &Scenario, others: &str) -> String {
    let inward = scenario.channel_model().map_or(Vec3::y(), |model| -model.mirrors.arrays()[0].inward());
    let heading_deg = inward.y.atan2(inward.x).to_degrees();
    let mut csv = String::from("time,user,x,y,heading_deg\n");
    for (index, place) in places(scenario).iter().enumerate() {
        let [x, y] = place.floor_m.unwrap_or_default();
        let begin = index as f64 * (STAY_S + WALK_S);
        // A string takes every text.
        let _ = writeln!(csv, "{begin},0,{x},{y},{heading_deg}\n{},0,{x},{y},{heading_deg}", begin + STAY_S);
    }
    csv + others
}

/// The same room with a second user, and the recorded walk of both: this user crosses the light of the mirrors, there
/// and back, at each place.
///
/// # Errors
/// A room that does not exist with two users.
pub fn with_passer_by(carried: &Scenario) -> anyhow::Result<(Scenario, String)> {
    let scenario = carried.with_overrides(&["users.count=2"])?;
    let model = scenario.channel_model()?;
    let array = &model.mirrors.arrays()[0];
    let corner = Vec3::new(0.5 * scenario.room.length_x_m, 0.5 * scenario.room.length_y_m, 0.0);
    let half = array.wall_from_room(&corner).abs();
    let mut rows = String::new();
    for index in 0..places(&scenario).len() {
        for (time_s, share) in CROSSING {
            let time_s = index as f64 * (STAY_S + WALK_S) + time_s;
            let at = array.room_from_wall(&Vec3::new(share * half.x, half.y - CROSSING_M, 0.0));
            // A string takes every text.
            let _ = writeln!(rows, "{time_s},{PASSER_BY},{},{},0", at.x, at.y);
        }
    }
    let walk = walk(&scenario, &rows);
    Ok((scenario, walk))
}

/// A tracker that reports the receiver this far in m from its true place while it is at the second spot.
pub fn with_spot_error(scenario: &Scenario, error_m: f64) -> impl Fn(&mut UserReport) + use<> {
    let spot = default_spots(scenario).get(WRONG_SPOT).and_then(|place| place.floor_m);
    let error = [error_m, -error_m].map(|error| (error * std::f64::consts::FRAC_1_SQRT_2) as f32);
    move |report| {
        for user in report.users.iter_mut().filter(|user| user.user != PASSER_BY) {
            let [x, y, _] = user.position_m.map(f64::from);
            if spot.is_some_and(|spot| (x - spot[0]).hypot(y - spot[1]) < AT_SPOT_M) {
                user.position_m[0] += error[0];
                user.position_m[1] += error[1];
            }
        }
    }
}

/// What a run gives.
pub struct Run {
    /// The result.
    pub outcome: Outcome,
    /// Channel reports that served no reading.
    pub unused: u64,
    /// Room time in s while the receiver stood at its places.
    pub busy_s: f64,
    /// Places of the setup that were searched, because few mirrors lit the receiver there.
    pub searched: BTreeSet<usize>,
}

/// The session for a room with one array; it expects the deviations of the scenario's own level, or
/// rough ones.
///
/// # Errors
/// A scenario that describes no room, or that no session can calibrate.
pub fn session(scenario: &Scenario, capabilities: Capabilities) -> anyhow::Result<Session> {
    let level = match scenario.mismatch.level {
        MismatchLevel::None => MismatchLevel::Rough,
        level => level,
    };
    Ok(Session::new(Setup {
        model: scenario.channel_model()?,
        room: scenario.room.clone(),
        array: 0,
        capabilities,
        prior: Prior::of_level(level),
        spots: default_spots(scenario),
        verify: default_verification(scenario),
        user: Some(0),
        unusable: Vec::new(),
    })?)
}

/// Runs a session to its end in the room of this seed. `tracker` may change position reports on their
/// way.
///
/// # Errors
/// Those of [`session`], and a session that does not end.
pub fn run(scenario: &Scenario, trace: &str, seed: u64, tracker: impl FnMut(&mut UserReport)) -> anyhow::Result<Run> {
    let mut episode = Episode::new(scenario, Some(trace), seed, 0)?;
    let capabilities = episode.capabilities().next().context("a room without an array")?;
    let mut session = session(scenario, capabilities)?;
    let mut searched = BTreeSet::new();
    let is_over = |session: &Session| {
        if let Stage::Locate(place) = session.stage() {
            searched.insert(place);
        }
        session.stage() == Stage::Ended
    };
    let busy_s = drive(&mut session, &mut episode, tracker, is_over)?;
    let progress = session.progress();
    let outcome =
        session.outcome().with_context(|| format!("the calibration of seed {seed} has no end: {progress:?}"))?;
    Ok(Run { outcome: outcome.clone(), unused: progress.unused, busy_s, searched })
}

/// Delivers reports and commands until `is_over`, or until the receiver has been carried round for too
/// long; returns the time at the places in s.
///
/// # Errors
/// A command that the array refuses.
pub fn drive(
    session: &mut Session,
    episode: &mut Episode,
    tracker: impl FnMut(&mut UserReport),
    is_over: impl FnMut(&Session) -> bool,
) -> anyhow::Result<f64> {
    drive_turned(session, episode, tracker, |_| {}, is_over)
}

/// The same with mirrors that have turned in their mounts: `mounts` changes the angles of each command.
///
/// # Errors
/// A command that the array refuses.
pub fn drive_turned(
    session: &mut Session,
    episode: &mut Episode,
    mut tracker: impl FnMut(&mut UserReport),
    mounts: fn(&mut MirrorAngles),
    mut is_over: impl FnMut(&Session) -> bool,
) -> anyhow::Result<f64> {
    let limit_ns = (PATIENCE * 4.0 * (STAY_S + WALK_S) * 1e9) as u64;
    let (mut sequence, mut angles, mut sent_ns) = (0, MirrorAngles::default(), 0);
    let (mut now_ns, mut busy_ns) = (0, 0);
    while !is_over(session) && now_ns < limit_ns {
        let before_ns = now_ns;
        let until_ns = session.next_wake(now_ns).min(sent_ns + REPEAT_NS).max(now_ns + 1);
        match episode.poll_event(until_ns) {
            Some((at, event)) => {
                now_ns = now_ns.max(at.room_ns);
                match event {
                    Event::Report(Report::Users(mut report)) => {
                        tracker(&mut report);
                        session.handle_users(&report);
                    }
                    Event::Report(Report::Channel(report)) => session.handle_channel(&report),
                    _ => {}
                }
            }
            None => {
                now_ns = until_ns;
                episode.advance(now_ns);
            }
        }
        if !matches!(session.stage(), Stage::Await(_)) {
            busy_ns += now_ns - before_ns;
        }
        if is_over(session) {
            break;
        }
        let next = session.next_command(now_ns);
        if next.is_some() || (now_ns >= sent_ns + REPEAT_NS && !angles.is_empty()) {
            angles = next.unwrap_or(angles);
            (sequence, sent_ns) = (sequence + 1, now_ns);
            let mut turned = angles.clone();
            mounts(&mut turned);
            let narrow = |list: &[f64]| list.iter().map(|angle| *angle as f32).collect();
            let command = MirrorCommand {
                epoch: 1,
                sequence,
                answers: 0,
                time_ns: now_ns,
                validity_ms: VALIDITY_MS,
                roll: narrow(&turned.roll),
                yaw: narrow(&turned.yaw),
            };
            let refused = episode.handle_command(0, Moment::simulated(now_ns), &command);
            ensure!(refused.is_ok(), "the simulated array refuses a command: {refused:?}");
        } else if angles.is_empty() {
            sent_ns = now_ns;
        }
    }
    Ok(busy_ns as f64 * 1e-9)
}
