//! A calibration against the simulated room in virtual time, and its judgement by the truth.

use std::fmt::Write;

use heliostat_array::moment::Moment;
use heliostat_calibrate::{Measured, Outcome, Place, Prior, Session, Setup, Stage, Verdict};
use heliostat_channel::specular::bisector;
use heliostat_channel::{ChannelModel, MirrorAngles, Vec3};
use heliostat_proto::{Capabilities, MirrorCommand};
use heliostat_room::SimulatedRoom;
use heliostat_room::episode::{Episode, Event};
use heliostat_room::mismatch::true_room;
use heliostat_scenario::{MismatchLevel, Scenario};

/// The spots, in a wide triangle, and the place of the verification.
pub const SPOTS: [[f64; 2]; 3] = [[-1.5, 0.8], [1.4, 1.0], [0.2, -1.4]];
pub const VERIFY: [f64; 2] = [-0.7, -0.4];

/// Time at each spot in s.
const STAY_S: f64 = 120.0;
/// Time of a walk between two spots in s.
const WALK_S: f64 = 4.0;

/// A room with rough differences, reports at 20 Hz that are 100 ms old, and one receiver that is
/// carried from spot to spot.
pub fn scenario(changes: &[&str]) -> Scenario {
    let fixed = [
        "blockage.obstacles_per_m2=0",
        "users.count=1",
        "users.trace=walk.csv",
        "mismatch.level=rough",
        "streams.channel.rate_hz=20",
        "streams.positions.rate_hz=20",
    ];
    let changes: Vec<String> = fixed.iter().chain(changes).map(|change| (*change).to_owned()).collect();
    Scenario::builtin("hall").unwrap().with_overrides(&changes).unwrap()
}

/// The walk of the receiver, whose holder faces the mirrors; further rows are those of other users.
pub fn walk(spots: &[[f64; 2]], others: &str) -> String {
    let mut csv = String::from("time,user,x,y,heading_deg\n");
    for (index, [x, y]) in spots.iter().enumerate() {
        let begin = index as f64 * (STAY_S + WALK_S);
        writeln!(csv, "{begin},0,{x},{y},90\n{},0,{x},{y},90", begin + STAY_S).unwrap();
    }
    csv + others
}

/// Changes reports on their way.
#[derive(Default)]
pub struct Faults {
    /// Adds this to reported positions, given the true place.
    pub tracker: Option<fn([f32; 3]) -> [f32; 2]>,
}

/// What a run gives.
pub struct Run {
    pub outcome: Outcome,
    /// Channel reports that served no reading.
    pub unused: u64,
    /// Room time in s while the receiver stood at its places.
    pub busy_s: f64,
    pub scenario: Scenario,
    pub seed: u64,
}

pub fn setup(scenario: &Scenario, capabilities: Capabilities) -> Setup {
    let height_m = scenario.receiver.height_m;
    let place = |floor_m: [f64; 2]| Place { floor_m: Some(floor_m), height_m };
    Setup {
        model: scenario.channel_model().unwrap(),
        array: 0,
        capabilities,
        prior: Prior::of_level(MismatchLevel::Rough),
        spots: SPOTS.map(place).to_vec(),
        verify: place(VERIFY),
        user: Some(0),
        unusable: Vec::new(),
    }
}

/// Runs a session to its end.
pub fn run(scenario: &Scenario, trace: &str, seed: u64, faults: &Faults) -> Run {
    let mut episode = Episode::new(scenario, Some(trace), seed, 0).unwrap();
    let capabilities = episode.capabilities().next().unwrap();
    let mut session = Session::new(setup(scenario, capabilities)).unwrap();
    let busy_s = drive(&mut session, &mut episode, faults, |session| session.stage() == Stage::Ended);
    let outcome = session.outcome().unwrap_or_else(|| panic!("no end: {:?}", session.progress())).clone();
    Run { outcome, unused: session.progress().unused, busy_s, scenario: scenario.clone(), seed }
}

/// Delivers reports and commands until `is_over`; returns the time at the places in s.
pub fn drive(session: &mut Session, episode: &mut Episode, faults: &Faults, is_over: impl Fn(&Session) -> bool) -> f64 {
    const REPEAT_NS: u64 = 100_000_000;
    let limit_ns = (3.0 * 4.0 * (STAY_S + WALK_S) * 1e9) as u64;
    let (mut sequence, mut angles, mut sent_ns) = (0, MirrorAngles::default(), 0);
    let (mut now_ns, mut busy_ns) = (0, 0);
    while !is_over(session) && now_ns < limit_ns {
        let before_ns = now_ns;
        let until_ns = session.next_wake(now_ns).min(sent_ns + REPEAT_NS).max(now_ns + 1);
        match episode.poll_event(until_ns) {
            Some((at, event)) => {
                now_ns = now_ns.max(at.room_ns);
                deliver(session, event, faults);
            }
            None => {
                now_ns = until_ns;
                episode.advance(now_ns);
            }
        }
        if !matches!(session.stage(), Stage::Await(_)) {
            busy_ns += now_ns - before_ns;
        }
        let next = session.next_command(now_ns);
        if next.is_some() || (now_ns >= sent_ns + REPEAT_NS && !angles.is_empty()) {
            angles = next.unwrap_or(angles);
            sequence += 1;
            sent_ns = now_ns;
            let narrow = |list: &[f64]| list.iter().map(|angle| *angle as f32).collect();
            let command = MirrorCommand {
                epoch: 1,
                sequence,
                answers: 0,
                time_ns: now_ns,
                validity_ms: 400,
                roll: narrow(&angles.roll),
                yaw: narrow(&angles.yaw),
            };
            episode.handle_command(0, Moment::simulated(now_ns), &command).unwrap();
        } else if angles.is_empty() {
            sent_ns = now_ns;
        }
    }
    busy_ns as f64 * 1e-9
}

fn deliver(session: &mut Session, event: Event, faults: &Faults) {
    match event {
        Event::Users(mut report) => {
            if let Some(tracker) = faults.tracker {
                for user in &mut report.users {
                    let [x, y] = tracker(user.position_m);
                    user.position_m[0] += x;
                    user.position_m[1] += y;
                }
            }
            session.handle_users(&report);
        }
        Event::Channel(report) => session.handle_channel(&report),
        _ => {}
    }
}

/// The errors of a run by the truth.
#[derive(Clone, Debug, Default)]
pub struct Errors {
    /// Root mean squares of roll and yaw in degrees at held-out places.
    pub pointing_deg: [f64; 2],
    /// Share of corrected mirrors with an error above half a degree at any of the places.
    pub failed: f64,
    /// Root mean square of the LED's coordinates in m.
    pub led_m: f64,
    /// Of the height of the frame in m.
    pub frame_m: f64,
    /// 95 % intervals that contain the truth, and all.
    pub covered: [usize; 2],
    /// Gain of all mirrors, aimed at held-out places by the result, over that with true aims.
    pub gain: f64,
    /// The same with nominal aims.
    pub nominal_gain: f64,
}

/// True offsets of roll and yaw in rad.
pub fn true_offsets(scenario: &Scenario, seed: u64) -> Vec<[f64; 2]> {
    let still = scenario.with_overrides(&["actuator.jitter_deg=0".to_owned()]).unwrap();
    let trace = walk(&[SPOTS[0]], "");
    let mut room = SimulatedRoom::new(&still, Some(&trace), seed).unwrap();
    room.advance(1_000_000_000);
    let (angles, measured) = (room.actuator(0).angles(), room.actuator(0).measured());
    (0..angles.len())
        .map(|mirror| [angles.roll[mirror] - measured.roll[mirror], angles.yaw[mirror] - measured.yaw[mirror]])
        .collect()
}

/// Compares a run with the truth.
pub fn judge(run: &Run) -> Errors {
    let Run { outcome, scenario, seed, .. } = run;
    let truth = true_room(scenario, *seed);
    let (model, nominal) = (truth.channel_model().unwrap(), scenario.channel_model().unwrap());
    let measured = outcome.measured_room(scenario, 0).channel_model().unwrap();
    let offsets = true_offsets(scenario, *seed);
    let calibration = outcome.calibration();
    let height_m = scenario.receiver.height_m;
    let mut errors = Errors::default();
    let mut places = Vec::new();
    for index in 0..40_u32 {
        // A low-discrepancy sequence over the square of 4 m.
        let share = |base: f64| (f64::from(index + 1) * base).fract() * 4.0 - 2.0;
        places.push(Vec3::new(share(0.754_877_666), share(0.569_840_29), height_m));
    }
    let corrected: Vec<usize> = [Verdict::Calibrated, Verdict::NeedsSpot]
        .into_iter()
        .flat_map(|verdict| outcome.mirrors_with(verdict))
        .collect();
    let (mut squares, mut failed, mut count) = ([0.0; 2], 0, 0.0);
    for mirror in &corrected {
        let mut worst: f64 = 0.0;
        for place in &places {
            let (wanted, aim) = (aim(&model, *mirror, place), aim(&measured, *mirror, place));
            for (axis, list) in [&calibration.roll, &calibration.yaw].into_iter().enumerate() {
                let command = list.gain[*mirror] * aim[axis] + list.offset_deg[*mirror].to_radians();
                let error = (command + offsets[*mirror][axis] - wanted[axis]).to_degrees();
                squares[axis] += error * error;
                worst = worst.max(error.abs());
            }
            count += 1.0;
        }
        failed += usize::from(worst > 0.5);
    }
    errors.pointing_deg = squares.map(|sum: f64| (sum / f64::max(count, 1.0)).sqrt());
    errors.failed = failed as f64 / corrected.len().max(1) as f64;
    let (mut sums, mut exact) = ([0.0; 2], 0.0);
    for place in &places {
        let gain = |angles: &dyn Fn(usize) -> [f64; 2]| -> f64 {
            let mut scene = heliostat_channel::Scene::new(&model, 1);
            scene.update(&model, &[*place], &[], &[false]);
            let all: Vec<[f64; 2]> = (0..offsets.len())
                .map(|mirror| [0, 1].map(|axis| angles(mirror)[axis] + offsets[mirror][axis]))
                .collect();
            let angles = MirrorAngles {
                roll: all.iter().map(|angles| angles[0]).collect(),
                yaw: all.iter().map(|angles| angles[1]).collect(),
            };
            let mut out = [0.0];
            scene.irs_gain(&model, &angles, &mut out);
            out[0]
        };
        sums[0] += gain(&|mirror| {
            let aim = aim(&measured, mirror, place);
            [
                calibration.roll.gain[mirror] * aim[0] + calibration.roll.offset_deg[mirror].to_radians(),
                calibration.yaw.gain[mirror] * aim[1] + calibration.yaw.offset_deg[mirror].to_radians(),
            ]
        });
        sums[1] += gain(&|mirror| aim(&nominal, mirror, place));
        exact += gain(&|mirror| {
            let aim = aim(&model, mirror, place);
            [aim[0] - offsets[mirror][0], aim[1] - offsets[mirror][1]]
        });
    }
    (errors.gain, errors.nominal_gain) = (sums[0] / exact, sums[1] / exact);
    let mut cover = |measured: &Measured, truth: f64| {
        let is_inside = (measured.value - truth).abs() < 1.96 * measured.deviation;
        errors.covered = [errors.covered[0] + usize::from(is_inside), errors.covered[1] + 1];
    };
    for mirror in &corrected {
        for axis in 0..2 {
            cover(&outcome.mirrors[*mirror].offset_deg[axis], offsets[*mirror][axis].to_degrees());
        }
    }
    let mut led_squares = 0.0;
    for (axis, measured) in outcome.leds_m[0].iter().enumerate() {
        cover(measured, truth.led.positions_m[0][axis]);
        led_squares += (measured.value - truth.led.positions_m[0][axis]).powi(2);
    }
    let raise_m = truth.room.height_m - scenario.room.height_m;
    cover(&outcome.raise_m, raise_m);
    cover(&outcome.semi_angle_deg, truth.led.half_power_semi_angle_deg);
    errors.led_m = (led_squares / 3.0).sqrt();
    errors.frame_m = (outcome.raise_m.value - raise_m).abs();
    errors
}

fn aim(model: &ChannelModel, mirror: usize, place: &Vec3) -> [f64; 2] {
    let normal = bisector(&model.mirrors.positions()[mirror], &model.leds[0].position, place).unwrap();
    model.mirrors.angles_of(mirror, &normal).into()
}
