//! The figures that the page and the terminal show, computed from the latest message of every
//! topic.
//!
//! A simulated room publishes its true state and reference rates. A real room publishes positions
//! and measured gains: rates are then computed from the measured SINR, and there are no references. Without measured
//! gains the sum rate is that of the channel model.

mod counts;
mod rates;

use std::time::Instant;

use heliostat_channel::ChannelModel;
use heliostat_proto::array_keys::array_name;
use heliostat_proto::gauges::{CalibrationProgress, ServedLight, TrackerNoise};
use heliostat_proto::messages::fault;
use heliostat_proto::{MirrorTelemetry, NodeKind, NodeStatus, Quantiles};
use heliostat_service::printable::printable;
use serde::Serialize;

use crate::View;
use crate::array_faults::faults_note;
use crate::causes::{AND, NO_REPORT, folded, follows_from, follows_from_stop, of_stopped, without_figures};
use crate::controllers::{ControllerFigures, controller_name};
use crate::in_charge::InCharge;
use crate::latency::Histogram;
use crate::notes::is_of_standby;
use crate::scene::unusable_mirrors;
use crate::shown_room::Findings;
use crate::sums::{PastSum, SumFigures};
use crate::view::{EXPIRY, Received};
use counts::{Counting, counts};
use rates::{sum, users};

pub use rates::UserFigures;

/// Where the figures come from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Origin {
    /// The true state of a simulated room.
    Simulated,
    /// Reports of trackers and receivers of a real room.
    Real,
    /// No message arrived within [`EXPIRY`].
    #[default]
    NoData,
}

/// The mirror array.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct ArrayFigures {
    /// Its state; "no report" if none arrived recently. Of several arrays, the most serious state,
    /// then the arrays without recent telemetry.
    pub state: String,
    /// Number of arrays.
    pub arrays: usize,
    /// Number of mirrors.
    pub mirrors: usize,
    /// Names of the arrays without recent telemetry.
    pub silent: Vec<String>,
    /// Mirrors that do not follow commands, as the picture shows them.
    pub unusable: usize,
    /// Names of the faults.
    pub faults: Vec<&'static str>,
}

/// One process.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct NodeFigures {
    /// The kind of process; the driver of a later array has its index, as `driver-1`.
    pub node: String,
    /// Its source id, as 16 hexadecimal digits.
    pub source: String,
    /// Its state; "gone" if its last status is old.
    pub state: String,
    /// Its last problem; empty if its cause is gone.
    pub problem: String,
}

/// State of a process whose last status is old.
pub(crate) const GONE: &str = "gone";
/// The processes whose age [`Ages`] has, and the page itself.
const ROOM: &str = "room";
const ARRAY: &str = "array";
const CONTROLLER: &str = "controller";
const PAGE: &str = "page";

/// A distribution of times.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct TimeFigures {
    /// What is timed.
    pub name: &'static str,
    /// Whose status has it: `room` or `controller`, as in [`Ages`].
    pub of: &'static str,
    /// Quantiles in us; absent before the first time.
    pub us: Option<Quantiles>,
}

/// A counter since the start of its process.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Count {
    /// Name.
    pub name: String,
    /// Who counts: `room`, `array` or `controller`, as in [`Ages`], or `page`.
    pub of: &'static str,
    /// Value; absent before the first report of its process.
    pub value: Option<u64>,
    /// Whether a value above 0 is a problem.
    pub is_problem: bool,
    /// What it counts.
    pub meaning: &'static str,
    /// The process that counts, by its kind and its source; empty before its first status.
    pub process: String,
    /// For how many minutes this process had run at its last status; absent where it is unknown.
    pub minutes: Option<u64>,
}

/// Time since the last message of each process in s; absent before the first.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Ages {
    /// Users and rates: the true state of a simulated room, else the users' reports.
    pub room: Option<f64>,
    /// Telemetry of the array.
    pub array: Option<f64>,
    /// Status of the controller; that of a predecessor is none of a controller that has not reported yet.
    pub controller: Option<f64>,
    /// The same while this controller is in the room; absent for a calibration.
    pub present_controller: Option<f64>,
}

/// All figures at one instant.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Figures {
    /// Time since the view opened, in s.
    pub time_s: f64,
    /// How old the figures are.
    pub ages_s: Ages,
    /// Where the figures come from.
    pub origin: Origin,
    /// Number of the tick.
    pub tick: u64,
    /// Policy in use; empty without a controller.
    pub policy: String,
    /// The hash of the network of this policy; absent for one that is not learned.
    pub network: Option<String>,
    /// Whether a controller is in the room.
    pub controller_alive: bool,
    /// Whether an array accepts commands of a controller or a calibration that this viewer does not see.
    pub controller_unseen: bool,
    /// What the mirrors follow.
    pub in_charge: InCharge,
    /// The users.
    pub users: Vec<UserFigures>,
    /// Sum rates; absent without messages, and where those of some users are unknown. Where no receiver reports gains,
    /// those of the channel model.
    pub sum_mbps: Option<SumFigures>,
    /// The name of the sum rate; it says where the channel model gives it.
    pub sum_name: &'static str,
    /// The mirror array.
    pub array: ArrayFigures,
    /// The controllers in the room, the leader first, and those that hung when their connection expired.
    pub controllers: Vec<ControllerFigures>,
    /// The processes.
    pub nodes: Vec<NodeFigures>,
    /// Decision, loop and age.
    pub times: Vec<TimeFigures>,
    /// Histogram of the decision times of the last 30 s; empty before the first report of a controller.
    pub latency: Histogram,
    /// Why many of these decisions took longer than the budget, as far as their stages show it.
    pub late: Option<String>,
    /// Counters of decisions, commands and problems.
    pub counts: Vec<Count>,
    /// Optical power in W, if the room reports it.
    pub power_w: Option<f64>,
    /// Mirrors that the room jams by order, if it reports them.
    pub jammed: Option<u64>,
    /// Highest walking speed in m/s, if the room reports it.
    pub speed_m_s: Option<f64>,
    /// The noise of the tracker, if the controller learns it.
    pub tracker_noise: Option<TrackerNoise>,
    /// The light of served users, if the controller compares it with the expected one.
    pub light: Vec<ServedLight>,
    /// How far a calibration is, if one commands the mirrors in place of a controller.
    pub calibration: Option<String>,
    /// The hash of the drawn geometry, as in the plan: another one needs another plan.
    pub geometry: String,
    /// What is wrong in the room and lasts, with what to do and what follows from it.
    pub notes: Vec<String>,
    /// What differs in the room without a fault.
    pub remarks: Vec<String>,
}

impl View {
    /// The current figures. Their sum rates are kept for the [`history`](Self::history).
    pub fn figures(&self) -> Figures {
        let (room, Findings { mut notes, remarks }) = (self.shown_room(), self.findings());
        let is_stopped = self.stops.room().is_held();
        let modelled = self.modelled_sum();
        let (geometry, model) = (room.id.clone(), &room.model);
        let mut received = self.received();
        let telemetry = received.arrays.joint(&model.mirrors);
        let silent: Vec<String> =
            received.arrays.silent(model.mirrors.arrays().len()).into_iter().map(array_name).collect();
        let (origin, tick, users) = users(model, &received);
        let unusable = unusable_mirrors(&received, &room).len();
        let array = array(model, unusable, silent, telemetry.as_ref());
        notes.extend(faults_note(&array.faults, is_stopped));
        let controller = received.fresh_status(NodeKind::Controller.name());
        let room = received.fresh_status(NodeKind::SimNode.name());
        // Counters and times count since the start of their process. They stay when it is silent, and the
        // page shows their age.
        let last = |node: NodeKind| received.statuses.get(node.name()).map(|(_, status)| status);
        let [last_controller, last_room] = [NodeKind::Controller, NodeKind::SimNode].map(last);
        let last_controller = last_controller.filter(|_| !received.awaits_controller());
        let gauge = |name: &str| room.and_then(|room| room.gauge(name));
        let sum_mbps = sum(&received, &users, modelled);
        let figures = Figures {
            time_s: self.opened.elapsed().as_secs_f64(),
            origin,
            tick,
            policy: controller.map(|controller| shown(&controller.policy)).unwrap_or_default(),
            network: controller.and_then(NodeStatus::actor).map(shown),
            controller_alive: received.is_controller_alive(),
            controller_unseen: received.is_controller_unseen(),
            in_charge: received.in_charge(),
            sum_mbps,
            sum_name: sum_mbps.unwrap_or_default().name(),
            users,
            array,
            controllers: received.present_controllers(),
            nodes: received
                .statuses
                .iter()
                .map(|(name, (at, status))| without_known(node(&received, name, *at, status), &notes, is_stopped))
                .collect(),
            ages_s: ages(&received),
            times: vec![
                time("decision", CONTROLLER, last_controller),
                time("loop", ROOM, last_room),
                time("age", CONTROLLER, last_controller),
            ],
            latency: received.decision_times(),
            late: received.latency.late(),
            counts: counts(&Counting {
                controller: last_controller,
                room: last_room,
                driver: telemetry.as_ref().and_then(|telemetry| driver(&received, telemetry)),
                array: telemetry.as_ref(),
                unreadable: received.unreadable,
                viewed_for: self.opened.elapsed(),
            }),
            power_w: gauge("power_w"),
            jammed: gauge("faulty_mirrors").map(|count| count as u64),
            speed_m_s: gauge("speed_max_m_s"),
            tracker_noise: last_controller.and_then(TrackerNoise::of),
            light: last_controller.map(ServedLight::all_of).unwrap_or_default(),
            calibration: controller.and_then(CalibrationProgress::of).map(|progress| progress.to_string()),
            geometry,
            // What a process says is compared with all notes, also with those that a demo leaves out.
            notes: folded(self.as_shown(notes)),
            remarks,
        };
        if let Some(sum) = sum_mbps {
            let InCharge { name, idle } = &figures.in_charge;
            received.keep_sum(PastSum { sum, name: name.clone(), idle: !idle.is_empty() });
        }
        figures
    }

    /// Sum rates of the last 90 s: time since the view opened in s, then those of that instant.
    pub fn history(&self) -> Vec<(f64, PastSum)> {
        let since = |at: Instant| at.saturating_duration_since(self.opened).as_secs_f64();
        self.received().history.iter().map(|(at, past)| (since(*at), past.clone())).collect()
    }
}

/// The figures of all arrays: their number of unusable mirrors, and the names of the arrays without
/// telemetry.
fn array(
    model: &ChannelModel,
    unusable: usize,
    silent: Vec<String>,
    telemetry: Option<&MirrorTelemetry>,
) -> ArrayFigures {
    let (arrays, mirrors) = (model.mirrors.arrays().len(), model.mirrors.len());
    let Some(telemetry) = telemetry else {
        return ArrayFigures { state: NO_REPORT.into(), arrays, mirrors, silent, ..ArrayFigures::default() };
    };
    let state = telemetry.state.name();
    // An array knows its mirrors; the room that is shown can be another one.
    let mirrors = if telemetry.roll_commanded.is_empty() { mirrors } else { telemetry.roll_commanded.len() };
    ArrayFigures {
        state: if silent.is_empty() { state.into() } else { format!("{state}, {NO_REPORT} of {}", silent.join(AND)) },
        arrays,
        mirrors,
        silent,
        unusable,
        faults: fault::names(telemetry.faults),
    }
}

/// The last status of the process that moves the mirrors of this telemetry. Several drivers have no common one.
fn driver<'a>(received: &'a Received, telemetry: &MirrorTelemetry) -> Option<&'a NodeStatus> {
    let is_driver = |status: &NodeStatus| matches!(status.node, NodeKind::Driver | NodeKind::SimNode);
    let mut drivers = received.statuses.values().map(|(_, status)| status).filter(|status| is_driver(status));
    let first = drivers.next().filter(|first| first.stamp.source == telemetry.stamp.source)?;
    drivers.next().is_none().then_some(first)
}

fn node(received: &Received, name: &str, at: Instant, status: &NodeStatus) -> NodeFigures {
    let (node, source) = (name.to_owned(), controller_name(status.stamp.source));
    // What a process said that has left is no present problem.
    if at.elapsed() >= EXPIRY {
        return NodeFigures { node, source, state: GONE.into(), problem: String::new() };
    }
    let problem = received.problems.current(name, status.stamp.source);
    NodeFigures { node, source, state: shown(&status.state), problem: shown(problem) }
}

/// The figures of a process without a problem that a note states too, with other advice behind its
/// colon, or that follows from a note, or from the emergency stop of a stopped room.
fn without_known(mut node: NodeFigures, notes: &[String], is_stopped: bool) -> NodeFigures {
    let fault = |text: &str| without_figures(text.split(": ").next().unwrap_or_default());
    let of_node = fault(&node.problem);
    let is_noted = notes.iter().any(|note| of_node.starts_with(&fault(note))) || follows_from(notes, &node.problem);
    let is_of_standby = is_of_standby(notes, &node.source, &node.problem);
    if is_noted || is_of_standby || (is_stopped && follows_from_stop(&node.problem)) {
        node.problem.clear();
    }
    if let Some(problem) = of_stopped(&node.problem, is_stopped) {
        node.problem = problem.into();
    }
    node
}

impl Figures {
    /// Without what a process said of a stop: the last status before a release still has it as its problem.
    pub(crate) fn after_release(mut self) -> Self {
        self.nodes.iter_mut().filter(|node| follows_from_stop(&node.problem)).for_each(|node| node.problem.clear());
        self
    }
}

fn ages(received: &Received) -> Ages {
    let age = |at: Instant| at.elapsed().as_secs_f64();
    let controller = received.statuses.get(NodeKind::Controller.name()).filter(|_| !received.awaits_controller());
    let is_present = |status: &NodeStatus| {
        received.alive.contains(&(NodeKind::Controller.name(), status.stamp.source))
            && CalibrationProgress::of(status).is_none()
    };
    Ages {
        room: received.reported_at().map(age),
        array: received.arrays.at().map(age),
        controller: controller.map(|(at, _)| age(*at)),
        present_controller: controller.filter(|(_, status)| is_present(status)).map(|(at, _)| age(*at)),
    }
}

/// A text of a message, as the terminal and the page may show it.
fn shown(text: &str) -> String {
    printable(text).into_owned()
}

fn time(name: &'static str, of: &'static str, status: Option<&NodeStatus>) -> TimeFigures {
    let found = status.and_then(|status| status.timings.iter().find(|(timing, _)| timing == name));
    TimeFigures { name, of, us: found.map(|(_, us)| *us).filter(|us| us.count > 0) }
}

#[cfg(test)]
mod tests {
    use heliostat_proto::Stamp;

    use super::*;

    #[test]
    fn a_problem_that_a_note_states_too_is_not_repeated() {
        let notes = ["LED 0 brings 0.61 of the expected light: look for an LED that was dimmed".to_owned()];
        let left = |problem: &str| {
            without_known(NodeFigures { problem: problem.into(), ..NodeFigures::default() }, &notes, false).problem
        };
        assert_eq!(left("LED 0 brings 0.60 of the expected light since 06:00:00 UTC: look for an LED"), "");
        for other in ["LED 1 brings 0.60 of the expected light since 06:00:00 UTC: look for an LED", "users refused"] {
            assert_eq!(left(other), other);
        }
    }

    #[test]
    fn a_problem_that_follows_from_a_stop_is_not_repeated_while_the_stop_is_shown() {
        let left = |problem: &str, is_stopped| {
            without_known(NodeFigures { problem: problem.into(), ..NodeFigures::default() }, &[], is_stopped).problem
        };
        let of_stop = "withheld by the stop of ann";
        assert_eq!([left(of_stop, true), left(of_stop, false)], ["", of_stop]);
        let commanded = "command: an emergency stop is latched: re-arm the array first";
        assert!(left(commanded, true).starts_with("commands still arrive at the stopped array"), "another sender");
        assert_eq!(left(commanded, false), "", "over with the release");
        assert_eq!(left("the device does not answer", true), "the device does not answer");
    }

    #[test]
    fn a_problem_of_the_status_before_a_release_is_not_shown_after_it() {
        let problems = ["withheld by the stop of ann", "the device does not answer"];
        let nodes = problems.map(|problem| NodeFigures { problem: problem.into(), ..NodeFigures::default() }).to_vec();
        let shown = Figures { nodes, ..Figures::default() }.after_release().nodes;
        assert_eq!([&shown[0].problem, &shown[1].problem], ["", problems[1]]);
    }

    #[test]
    fn a_process_that_has_left_has_no_present_problem() {
        let mut received = Received::default();
        let status = NodeStatus { last_problem: "the device does not answer".into(), ..NodeStatus::default() };
        received.problems.take("driver", &status, |_| true);
        let problem = |at| node(&received, "driver", at, &status).problem;
        let now = Instant::now();
        assert_eq!([problem(now), problem(now - EXPIRY)], [status.last_problem.as_str(), ""]);
    }

    #[test]
    fn only_a_controller_that_is_in_the_room_and_no_calibration_can_hang() {
        let (mut received, name) = (Received::default(), NodeKind::Controller.name());
        let has_age = |received: &Received| {
            let ages = ages(received);
            (ages.controller.is_some(), ages.present_controller.is_some())
        };
        received.alive.insert((name, 8));
        received.statuses.insert(name.into(), (Instant::now(), NodeStatus::default()));
        assert_eq!(has_age(&received), (false, false), "its source has left, and another one has just started");
        let other = NodeStatus { stamp: Stamp { source: 8, ..Stamp::default() }, ..NodeStatus::default() };
        received.controllers.take(&other);
        assert_eq!(has_age(&received), (true, false), "a standby, whose status follows");
        received.alive.insert((name, NodeStatus::default().stamp.source));
        assert_eq!(has_age(&received), (true, true));
        let gauges = CalibrationProgress::default().gauges().map(|(name, value)| (name.to_owned(), value)).to_vec();
        received.statuses.insert(name.into(), (Instant::now(), NodeStatus { gauges, ..NodeStatus::default() }));
        assert_eq!(has_age(&received), (true, false), "a calibration");
    }
}
