//! Fig. 6: bit error rate against SNR for several walking speeds, with mirrors aimed at delayed
//! user positions.
//!
//! One user without direct path walks. Position reports have an interval and a latency; the
//! controller aims all mirrors, which have slew, settling, quantisation and jitter. The reference
//! SNR is that of perfect aim. The error rate is the mean over time of Q(sqrt(SNR_ref SINR / SINR
//! at perfect aim)), where the quotient is (H / H_ref)^2.

use anyhow::Result;
use heliostat_channel::link::ber_ook;
use heliostat_learn::comparison::{EvaluatedPolicy, kept_sinr};
use heliostat_models::ActorSource;
use heliostat_scenario::{Actuator, ActuatorProfile, Belief, MinRate, Scenario};

use super::finished_parts::{Done, groups, intervals, series};
use crate::figure::{Axis, Figure, Panel, Quoted};
use crate::job::{Aim, Job};
use crate::part::{Curve, Measured, Part};
use crate::plan::{Plan, Room};

/// The id on the command line.
pub const ID: &str = "ber-snr";

/// The reason why the figure does not apply to the paper's equations.
pub const NOT_APPLICABLE: &str = "equations (2) and (3) spread a mirror's light over the whole room, so a small aiming error loses nothing and the error \
                              rate does not depend on the speed; only the law of reflection (mode specular) has a spot that can miss a user";

/// Interval and latency of the reports in ms, and whether the controller predicts.
const DELAYS: [(f64, f64, bool); 5] =
    [(20.0, 20.0, false), (50.0, 50.0, false), (100.0, 100.0, false), (200.0, 200.0, false), (100.0, 100.0, true)];

/// Walking speeds in m/s.
pub const SPEEDS_M_S: [f64; 5] = [0.0, 0.5, 1.0, 1.5, 2.0];

/// The SNR at which the paper states error rates, in dB.
pub const QUOTED_SNR_DB: f64 = 15.0;

/// The delay whose error rates are nearest to the paper's.
pub const NEAREST_DELAY: &str = "100 + 100 ms";

/// The largest SNR shown, in dB.
pub const SNR_MAX_DB: f64 = 30.0;

/// The group of a delay's curves.
fn group((interval_ms, latency_ms, prediction): (f64, f64, bool)) -> String {
    format!("{interval_ms} + {latency_ms} ms{}", if prediction { ", predicted" } else { "" })
}

/// The name of a speed's curve.
pub fn speed_name(speed_m_s: f64) -> String {
    format!("{speed_m_s} m/s")
}

pub(super) fn parts(room: &Room, plan: &Plan) -> Vec<Part> {
    let instants = plan.effort.instants;
    let part = |delay: (f64, f64, bool), seed: u64| {
        let job = Job::Aim(Aim { interval_ms: delay.0, latency_ms: delay.1, prediction: delay.2, instants });
        let cost_s = SPEEDS_M_S.len() as f64 * instants as f64 * (1.5e-3 + 0.18 / delay.0);
        room.part([ID, env!("HELIOSTAT_CODE_BER_SNR")], (group(delay), seed), job, cost_s)
    };
    DELAYS.iter().flat_map(|delay| plan.seeds().map(move |seed| part(*delay, seed))).collect()
}

impl Aim {
    /// The room with one user without direct path, reports of this interval and latency, and MEMS
    /// actuators.
    fn room(&self, scenario: &Scenario, speed_m_s: f64) -> Scenario {
        let mut room = scenario.clone();
        room.users.count = 1;
        room.users.min_rate_mbps = MinRate::All(0.0);
        (room.users.speed_min_m_s, room.users.speed_max_m_s) = (speed_m_s, speed_m_s);
        room.blockage.forced_users = 1;
        room.blockage.bodies = false;
        room.blockage.obstacles_per_m2 = 0.0;
        room.actuator = Actuator { profile: ActuatorProfile::Mems, ..Actuator::default() };
        room.control.range_deg = room.actuator.parameters().range_rad.to_degrees();
        room.streams.positions.rate_hz = 1e3 / self.interval_ms;
        room.streams.positions.latency_ms = self.latency_ms;
        room.streams.channel.rate_hz = room.streams.positions.rate_hz;
        room.streams.channel.latency_ms = self.latency_ms;
        // A command is valid until the next one.
        room.control.validity_ms = room.control.validity_ms.max(4.0 * self.interval_ms);
        room.control.belief = if self.prediction { Belief::ConstantVelocity } else { Belief::None };
        room
    }

    /// The error rate at each SNR, for each speed.
    pub(crate) fn run(&self, scenario: &Scenario, actor: &ActorSource) -> Result<Measured> {
        let evaluated = EvaluatedPolicy::parse("ddpg", actor)?;
        let mut curves = Vec::new();
        for speed_m_s in SPEEDS_M_S {
            let kept = kept_sinr(&self.room(scenario, speed_m_s), &evaluated, self.instants)?;
            let error_rate = |snr_db: f64| {
                let snr = 10_f64.powf(snr_db / 10.0);
                kept.iter().map(|kept| ber_ook(snr * kept)).sum::<f64>() / kept.len() as f64
            };
            let points = (0..=SNR_MAX_DB as u32).map(|snr_db| [f64::from(snr_db), error_rate(f64::from(snr_db))]);
            let group = group((self.interval_ms, self.latency_ms, self.prediction));
            curves.push(Curve { group, name: speed_name(speed_m_s), points: points.collect() });
        }
        Ok(Measured { curves, ..Measured::default() })
    }
}

pub(super) fn figure(done: &[Done]) -> Figure {
    let names: Vec<String> = SPEEDS_M_S.iter().map(|speed| speed_name(*speed)).collect();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let panel = |delay: &str| Panel {
        title: delay.to_owned(),
        series: series(done, delay, &names),
        quoted: [1e-4, 1e-1]
            .map(|rate| Quoted { x: Some(QUOTED_SNR_DB), y: Some(rate), text: format!("paper: {rate:.0e}") })
            .into(),
        floor: None,
    };
    let instants = done.iter().find_map(|(part, _)| match &part.job {
        Job::Aim(job) => Some(job.instants),
        _ => None,
    });
    Figure {
        title: "Bit error rate against SNR, by walking speed".into(),
        caption: vec![
            "Each panel names the interval of the position reports and their latency. Mirrors are aimed at the reported position: one user without direct path, all mirrors, \
             `mems` actuators (slew, settling, quantisation, jitter). The paper states neither interval nor latency."
                .into(),
            "The SNR is the one at perfect aim. The error rate is that of on-off keying, Q(sqrt(SNR (H / H at perfect aim)^2)), averaged over time. At 15 dB a \
             perfect aim gives 9.4e-9, so an error rate of 1e-4 means that the light misses the detector for part of the time."
                .into(),
            format!("{} Each seed is one walk with {} instants a speed.", intervals(done), instants.unwrap_or(0)),
        ],
        x: Axis::linear("SNR at perfect aim (dB)"),
        y: Axis::log("bit error rate", [1e-9, 1.0]),
        panels: groups(done).into_iter().map(panel).collect(),
        ..Figure::default()
    }
}
