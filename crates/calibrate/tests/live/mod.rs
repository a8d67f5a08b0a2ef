//! A calibration against the simulated room in virtual time.

use std::fmt::Write;

use heliostat_array::moment::Moment;
use heliostat_calibrate::{Outcome, Place, Prior, Session, Setup, Stage};
use heliostat_channel::MirrorAngles;
use heliostat_proto::{Capabilities, MirrorCommand};
use heliostat_room::episode::{Episode, Event};
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
