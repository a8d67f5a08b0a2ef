//! The figures that page and terminal show alike, composed from the latest of every topic.
//!
//! A simulated room tells its truth and its yardsticks. A real one tells positions and measured light: rates are then computed
//! from the measured SINR, and nobody knows what other mirrors would have given.

use std::time::Instant;

use heliostat_proto::messages::fault;
use heliostat_proto::{ArrayState, MirrorTelemetry, NodeKind, NodeStatus, Quantiles};
use serde::Serialize;

use crate::View;
use crate::latency::Histogram;
use crate::view::{Heard, PATIENCE};

/// Where the figures come from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Origin {
    /// The truth of a simulated room.
    Simulated,
    /// Reports of trackers and receivers.
    Measured,
    /// Nothing came for a while.
    #[default]
    Silent,
}

/// One user.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct UserFigures {
    /// Number of the user.
    pub user: u32,
    /// Where the detector is in m.
    pub position_m: [f32; 3],
    /// Whether the direct path is off.
    pub blocked: bool,
    /// Whether it is off by order.
    pub forced: bool,
    /// Rate in Mbit/s.
    pub rate_mbps: f32,
    /// The rate that the user needs, in Mbit/s.
    pub need_mbps: f32,
}

impl UserFigures {
    /// Whether the user has what they need.
    pub fn is_met(&self) -> bool {
        self.rate_mbps >= self.need_mbps
    }
}

/// Sum rates of the same moment in Mbit/s; what nobody can know is absent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct SumFigures {
    /// As the mirrors stand.
    pub policy: f64,
    /// Without mirrors.
    pub no_irs: Option<f64>,
    /// With all mirrors flat.
    pub flat: Option<f64>,
    /// At the best angles that meet the needs.
    pub oracle: Option<f64>,
}

/// The mirror array.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct ArrayFigures {
    /// What it does, in a word; "silent" where it says nothing.
    pub state: &'static str,
    /// Number of mirrors.
    pub mirrors: usize,
    /// Mirrors known not to follow: as the driver finds, or as the simulator says that it broke.
    pub unusable: usize,
    /// Names of the faults.
    pub faults: Vec<&'static str>,
}

/// One process.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct NodeFigures {
    /// What sort.
    pub node: &'static str,
    /// What it says that it does; "gone" where it says nothing any more.
    pub state: String,
    /// The last thing that went wrong; empty while nothing did.
    pub problem: String,
}

/// A distribution of times.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct TimeFigures {
    /// Of what.
    pub name: &'static str,
    /// In us; absent before the first.
    pub us: Option<Quantiles>,
}

/// Something counted since the start of whoever counts it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Count {
    /// What.
    pub name: String,
    /// How often.
    pub value: u64,
    /// Whether anything but 0 deserves a look.
    pub trouble: bool,
}

/// Everything at a glance.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Figures {
    /// Time since the view opened, in s.
    pub time_s: f64,
    /// Where the figures come from.
    pub origin: Origin,
    /// Number of the tick.
    pub tick: u64,
    /// Policy in use; empty where no controller says.
    pub policy: String,
    /// Whether a controller is in the room.
    pub controller_alive: bool,
    /// The users.
    pub users: Vec<UserFigures>,
    /// Sum rates; absent in a silent room.
    pub sum_mbps: Option<SumFigures>,
    /// The mirror array.
    pub array: ArrayFigures,
    /// The processes.
    pub nodes: Vec<NodeFigures>,
    /// Decision, loop and age.
    pub times: Vec<TimeFigures>,
    /// Decisions of the last half minute by how long they took.
    pub latency: Histogram,
    /// Misses, fallbacks, faults.
    pub counts: Vec<Count>,
    /// Optical power in W, where the room says.
    pub power_w: Option<f64>,
    /// Fastest walking speed in m/s, where the room says.
    pub speed_m_s: Option<f64>,
}

impl View {
    /// The figures of this moment.
    pub fn figures(&self) -> Figures {
        let heard = self.heard();
        let (origin, tick, users) = self.users(&heard);
        let controller = fresh_status(&heard, NodeKind::Controller);
        let room = fresh_status(&heard, NodeKind::SimNode);
        let gauge = |name: &str| {
            let gauges = room.map_or(&[][..], |room| &room.gauges);
            gauges.iter().find(|(gauge, _)| gauge == name).map(|(_, value)| *value)
        };
        Figures {
            time_s: self.opened.elapsed().as_secs_f64(),
            origin,
            tick,
            policy: controller.map(|controller| controller.policy.clone()).unwrap_or_default(),
            controller_alive: heard.alive.iter().any(|(node, _)| *node == NodeKind::Controller.name()),
            sum_mbps: sum(&heard, &users),
            users,
            array: self.array(&heard, gauge("faulty_mirrors").unwrap_or(0.0) as usize),
            nodes: heard.statuses.values().map(|(at, status)| node(*at, status)).collect(),
            times: vec![time("decision", controller), time("loop", room), time("age", controller)],
            latency: heard.latency.histogram(),
            counts: counts(controller, room, Heard::fresh(&heard.telemetry), heard.unreadable),
            power_w: gauge("power_w"),
            speed_m_s: gauge("speed_max_m_s"),
        }
    }

    /// Sum rates of the last minute and a half: time since the view opened in s, then Mbit/s as in [`SumFigures`].
    pub fn history(&self) -> Vec<(f64, SumFigures)> {
        let since = |at: Instant| at.saturating_duration_since(self.opened).as_secs_f64();
        self.heard().history.iter().map(|sample| (since(sample.at), sum_of(&sample.sum))).collect()
    }

    fn users(&self, heard: &Heard) -> (Origin, u64, Vec<UserFigures>) {
        if let Some(truth) = Heard::fresh(&heard.truth) {
            let user = |user: &heliostat_proto::TruthUser| UserFigures {
                user: user.user,
                position_m: user.position_m,
                blocked: user.los_blocked,
                forced: user.forced,
                rate_mbps: user.rate_bps * 1e-6,
                need_mbps: user.min_rate_bps * 1e-6,
            };
            return (Origin::Simulated, truth.tick, truth.users.iter().map(user).collect());
        }
        let Some(report) = Heard::fresh(&heard.users) else { return (Origin::Silent, 0, Vec::new()) };
        let channel = Heard::fresh(&heard.channel).map_or(&[][..], |report| &report.users);
        let user = |user: &heliostat_proto::UserState| {
            let light = channel.iter().find(|light| light.user == user.user);
            let rate = |sinr: f32| self.model.budget.rate_bps(f64::from(sinr), report.users.len());
            UserFigures {
                user: user.user,
                position_m: user.position_m,
                blocked: light.is_some_and(|light| light.los_gain == 0.0),
                forced: false,
                rate_mbps: light.map_or(0.0, |light| rate(light.sinr) * 1e-6) as f32,
                need_mbps: user.min_rate_bps * 1e-6,
            }
        };
        (Origin::Measured, report.tick, report.users.iter().map(user).collect())
    }

    fn array(&self, heard: &Heard, faulty: usize) -> ArrayFigures {
        let mirrors = self.model.mirrors.len();
        let Some(telemetry) = Heard::fresh(&heard.telemetry) else {
            return ArrayFigures { state: "silent", mirrors, ..ArrayFigures::default() };
        };
        ArrayFigures {
            state: state_name(telemetry.state),
            mirrors,
            unusable: telemetry.unusable.len().max(faulty),
            faults: fault_names(telemetry.faults),
        }
    }
}

fn fresh_status(heard: &Heard, node: NodeKind) -> Option<&NodeStatus> {
    heard.statuses.get(node.name()).filter(|(at, _)| at.elapsed() < PATIENCE).map(|(_, status)| status)
}

fn sum(heard: &Heard, users: &[UserFigures]) -> Option<SumFigures> {
    if let Some(truth) = Heard::fresh(&heard.truth) {
        return Some(sum_of(&truth.sum_rate_bps));
    }
    let policy = users.iter().map(|user| f64::from(user.rate_mbps)).sum();
    (!users.is_empty()).then_some(SumFigures { policy, ..SumFigures::default() })
}

fn sum_of(sum: &heliostat_proto::SumRates) -> SumFigures {
    let mbps = |bps: f64| Some(bps * 1e-6);
    SumFigures { policy: sum.policy * 1e-6, no_irs: mbps(sum.no_irs), flat: mbps(sum.flat), oracle: mbps(sum.oracle) }
}

fn node(at: Instant, status: &NodeStatus) -> NodeFigures {
    let state = if at.elapsed() < PATIENCE { status.state.clone() } else { "gone".into() };
    NodeFigures { node: status.node.name(), state, problem: status.last_problem.clone() }
}

fn time(name: &'static str, status: Option<&NodeStatus>) -> TimeFigures {
    let found = status.and_then(|status| status.timings.iter().find(|(timing, _)| timing == name));
    TimeFigures { name, us: found.map(|(_, us)| *us).filter(|us| us.count > 0) }
}

fn counts(
    controller: Option<&NodeStatus>,
    room: Option<&NodeStatus>,
    array: Option<&MirrorTelemetry>,
    unreadable: u64,
) -> Vec<Count> {
    let of = |status: Option<&NodeStatus>, wanted: &str| {
        let counters = status.map_or(&[][..], |status| &status.counters);
        let matching = counters.iter().filter(|(name, _)| match wanted.strip_suffix('*') {
            Some(start) => name.starts_with(start),
            None => name == wanted,
        });
        matching.map(|(_, count)| count).sum::<u64>()
    };
    let (commands, refused) = array.map_or((0, 0), |array| (array.counters.accepted, array.counters.refused()));
    let all = [
        ("decisions", of(controller, "decisions"), false),
        ("commands", commands, false),
        ("over 0.5 ms", of(controller, "over_budget"), true),
        ("ticks lost", of(room, "lost_ticks"), true),
        ("ticks late", of(room, "late_ticks"), true),
        ("fallbacks", of(controller, "fallback:*"), true),
        ("reports refused", of(controller, "refused:*"), true),
        ("commands refused", refused, true),
        ("unreadable", unreadable, true),
    ];
    all.map(|(name, value, trouble)| Count { name: name.into(), value, trouble }).into()
}

fn state_name(state: ArrayState) -> &'static str {
    match state {
        ArrayState::Parked => "parked",
        ArrayState::Following => "following",
        ArrayState::Holding => "holding",
        ArrayState::Stopped => "stopped",
        ArrayState::Fault => "fault",
    }
}

fn fault_names(bits: u32) -> Vec<&'static str> {
    let names = [
        (fault::LINK, "link"),
        (fault::MIRROR, "mirror"),
        (fault::TEMPERATURE, "temperature"),
        (fault::SUPPLY, "supply"),
        (fault::CALIBRATION, "calibration"),
        (fault::CLOCK, "clock"),
    ];
    names.into_iter().filter(|(bit, _)| bits & bit != 0).map(|(_, name)| name).collect()
}
