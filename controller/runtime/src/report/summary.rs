//! The final report of a controller, as one JSON object or as a table.

mod table;

use std::collections::BTreeMap;

use heliostat_core::{
    belief::{innovations::Innovations, light::LightWatch},
    capabilities::Unfit,
    core::{Controller, DegradedMode, Stage},
    policy::Tally,
    refusal::Stream,
    safety::Clipped,
    tenure::TenureEvent,
};
use heliostat_proto::{
    MirrorTelemetry, NodeStatus, Quantiles, Room,
    array_keys::array_name,
    gauges::{ServedLight, TrackerNoise},
};
use serde::{Deserialize, Serialize};

use super::stage_times::{PolicyTimes, StageTimes, quantiles_us};

/// The report on one run.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// The policy in charge at the end.
    pub policy: String,
    /// The inference engine of this policy, if it is learned.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub engine: Option<String>,
    /// The hash of its file, if it is learned.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub actor: Option<String>,
    /// The figures of each policy that was in charge.
    pub policies: BTreeMap<String, PolicySummary>,
    /// The epoch of the commands.
    pub epoch: u64,
    /// Decisions on position reports: commands, and decisions to send none.
    pub decisions: u64,
    /// Commands given.
    pub commands: u64,
    /// Decisions of more than 0.5 ms.
    pub over_budget: u64,
    /// The same, by the stage that took longest.
    pub over_budget_by: BTreeMap<String, u64>,
    /// From the entry of the callback to the end of the publication.
    pub decision_us: Quantiles,
    /// The same, stage by stage.
    pub stages_us: BTreeMap<String, Quantiles>,
    /// From the sampling of the positions to the decision.
    pub age_us: Quantiles,
    /// Decisions without the policy's own angles or on incomplete reports, by degraded mode.
    pub fallbacks: BTreeMap<String, u64>,
    /// Commands not sent, because an array is stopped, unfit or absent, or follows another controller.
    pub withheld: BTreeMap<String, u64>,
    /// Decisions on modelled gains in a room that has never reported gains.
    pub modelled: u64,
    /// Messages refused, by stream and reason.
    pub refused: BTreeMap<String, u64>,
    /// Users without a measured gain or without a place in the policy, one for each decision, and
    /// users whom an accepted report names with impossible values, one for each report.
    pub users: BTreeMap<String, u64>,
    /// Changes of the epoch or of the standby, by kind.
    pub epoch_events: BTreeMap<String, u64>,
    /// The array follows another controller: commands are withheld.
    pub standby: bool,
    /// Other controllers in the room from which statuses arrive, and calibrations; 16 at most.
    pub peers: u64,
    /// No other controller reports, although there was one that did not end in order.
    #[serde(default)]
    pub standby_missing: bool,
    /// Trackers and simulators in the room, by their liveliness tokens.
    #[serde(default)]
    pub trackers: u64,
    /// Emergency stops that withhold commands; a stop of several arrays counts for each.
    pub stops_held: u64,
    /// Why an array receives no commands, if it does not fit the scenario.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub unfit: Option<String>,
    /// Commands are sent, and no driver or simulator receives those to an array.
    pub driver_absent: bool,
    /// The room announces another geometry than that of this controller.
    pub geometry_differs: bool,
    /// Reports that did not arrive, by stream, from the gaps in their sequence numbers.
    pub missed: BTreeMap<String, u64>,
    /// Axis values that the limits changed.
    pub clipped: Clipped,
    /// From the last telemetry of the arrays; absent before the first.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub array: Option<ArraySummary>,
    /// Array by array, where a room has several.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub arrays: Vec<ArrayStanding>,
    /// The belief against the position reports; absent where `control.belief` names no filter.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub belief: Option<BeliefSummary>,
    /// The light of served users, of the mirrors and of each LED that was measured; empty for several rooms.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub light: Vec<ServedLight>,
    /// Sources that owned the room, in succession.
    pub sources: u64,
    /// Commands that the transport refused.
    pub unsent: u64,
    /// Position reports superseded by a newer one before a decision, and payloads dropped
    /// because too many waited.
    pub dropped: u64,
    /// Policy timeouts: status checks at which the policy had not returned for 0.1 s.
    pub unanswered: u64,
    /// Requests to the operating system, granted or not.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub machine: Vec<String>,
    /// Room by room, where there are several; the other fields are then their sums.
    #[serde(skip_serializing_if = "BTreeMap::is_empty", default)]
    pub rooms: BTreeMap<String, Summary>,
    /// The last problem; empty while there is none.
    pub last_problem: String,
}

/// The figures of one policy while it was in charge.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PolicySummary {
    /// Its counts.
    #[serde(flatten)]
    pub tally: Tally,
    /// From the entry of the callback to the end of the publication.
    pub decision_us: Quantiles,
}

/// One room's part of a report.
#[derive(Clone, Copy)]
pub struct RoomReport<'a> {
    /// The room.
    pub room: &'a Room,
    /// The source id of its controller.
    pub source: u64,
    /// The name of this machine; empty if there is none.
    pub host: &'a str,
    /// Its report.
    pub summary: &'a Summary,
    /// Its times since the start.
    pub times: &'a StageTimes,
    /// The decision times of each of its policies.
    pub policy_times: &'a PolicyTimes,
}

/// Whether one of several arrays is commanded.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ArrayStanding {
    /// The array, by the part of its keys.
    pub name: String,
    /// Whether the last decision gave it a command.
    pub commanded: bool,
    /// The epoch of the commands to it.
    pub epoch: u64,
    /// Commands are sent, and no driver or simulator receives those to this array.
    pub driver_absent: bool,
    /// It receives no commands, because it does not fit the scenario.
    #[serde(default)]
    pub unfit: bool,
}

impl ArrayStanding {
    fn of(controller: &Controller, array: usize) -> Self {
        let (name, epoch) = (array_name(array), controller.tenure(array).epoch());
        let (commanded, unfit) = (controller.is_commanded(array), controller.unfit_of(array).is_some());
        Self { name, commanded, epoch, driver_absent: false, unfit }
    }
}

/// The state of the arrays by their telemetry.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ArraySummary {
    /// Bits of [`heliostat_proto::messages::fault`].
    pub faults: u32,
    /// Mirrors that do not follow commands.
    pub unusable: u64,
    /// Commands that it has refused since its start.
    pub refused: u64,
}

impl ArraySummary {
    /// The sum of all arrays; `None` without telemetry.
    fn of<'a>(telemetry: impl Iterator<Item = &'a MirrorTelemetry>) -> Option<Self> {
        let one = |telemetry: &MirrorTelemetry| Self {
            faults: telemetry.faults,
            unusable: telemetry.unusable.len() as u64,
            refused: telemetry.counters.refused(),
        };
        telemetry.map(one).reduce(|here, there| Self {
            faults: here.faults | there.faults,
            unusable: here.unusable + there.unusable,
            refused: here.refused + there.refused,
        })
    }
}

/// How well the predictions of the belief agreed with the position reports, and their noise.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct BeliefSummary {
    /// Reported positions of known users.
    pub reports: u64,
    /// Mean normalised innovation squared of these positions; 2 if the belief's covariance is right.
    pub innovation_mean: f64,
    /// The noise of the tracker; absent from the sum of several rooms, since each has its own.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub noise: Option<TrackerNoise>,
}

impl BeliefSummary {
    fn of(controller: &Controller) -> Option<Self> {
        let noise_of = |of: Innovations| controller.tracker_noise().filter(|_| of.count > 0);
        controller.innovations().map(|of| Self { noise: noise_of(of), ..Self::mean(of) })
    }

    fn mean(Innovations { count, sum }: Innovations) -> Self {
        Self { reports: count, innovation_mean: sum / count.max(1) as f64, noise: None }
    }

    /// The summary of both, by their numbers of reports.
    fn with(self, other: Self) -> Self {
        let sum = |summary: Self| summary.innovation_mean * summary.reports as f64;
        Self::mean(Innovations { count: self.reports + other.reports, sum: sum(self) + sum(other) })
    }
}

impl Summary {
    /// The counter of capabilities and safety reports of an array that is not followed, as "stream:reason".
    pub const FOREIGN_ARRAY: &'static str = "array:foreign-source";
    /// The counters of users.
    pub const USERS: [&'static str; 3] = ["left-out", "unmeasured", "unserved"];

    /// The counters of the core; [`Summary::add_times`] adds the times.
    pub fn of(controller: &Controller) -> Self {
        let counters = controller.counters();
        let arrays = 0..controller.arrays();
        let is_any_fit = arrays.clone().any(|array| controller.unfit_of(array).is_none());
        let foreign = (Self::FOREIGN_ARRAY.to_string(), counters.foreign_arrays);
        let users = [controller.inbox().refused().left_out(), counters.unmeasured_users, counters.unserved_users];
        let refused = controller.inbox().refused().named().chain([foreign]);
        let degraded = DegradedMode::ALL.map(|mode| (mode.name(), counters.degraded(mode)));
        let (withheld, fallbacks): (Vec<_>, Vec<_>) =
            degraded.into_iter().partition(|(mode, _)| NodeStatus::WITHHELD.contains(mode));
        Self {
            policy: controller.policy().name().into(),
            engine: controller.policy().engine().map(str::to_owned),
            actor: controller.policy().file_hash().map(str::to_owned),
            policies: controller
                .tallies()
                .iter()
                .map(|(name, tally)| (name.clone(), PolicySummary { tally: *tally, ..PolicySummary::default() }))
                .collect(),
            epoch: controller.epoch(),
            decisions: counters.decisions,
            commands: counters.commands,
            fallbacks: nonzero(fallbacks),
            withheld: nonzero(withheld),
            modelled: counters.modelled,
            refused: nonzero(refused),
            users: nonzero(Self::USERS.into_iter().zip(users)),
            epoch_events: nonzero(TenureEvent::ALL.map(|event| (event.name(), counters.tenure(event)))),
            standby: arrays.clone().any(|array| controller.tenure(array).is_standing_by()),
            peers: controller.tenure(0).peers().len() as u64,
            stops_held: arrays.clone().map(|array| controller.stops(array).len() as u64).sum(),
            unfit: controller.unfit().map(describe_unfit),
            missed: Stream::ALL.map(|stream| (stream.name().into(), controller.inbox().missed(stream))).into(),
            clipped: counters.clipped,
            array: ArraySummary::of(arrays.clone().filter_map(|array| controller.inbox().telemetry(array))),
            arrays: arrays
                .filter(|_| controller.arrays() > 1)
                .map(|array| ArrayStanding::of(controller, array))
                .collect(),
            belief: BeliefSummary::of(controller),
            // The light that another scenario would bring says nothing about the room.
            light: controller.light().filter(|_| is_any_fit).map(served_light).unwrap_or_default(),
            sources: controller.inbox().sources(),
            ..Self::default()
        }
    }

    /// Whether no array receives commands, because none fits the scenario.
    pub fn is_entirely_unfit(&self) -> bool {
        self.unfit.is_some() && self.arrays.iter().all(|array| array.unfit)
    }

    /// The report on all rooms, from the report and the times of each.
    pub fn of_rooms(rooms: &[RoomReport<'_>]) -> Self {
        if let [room] = rooms {
            return room.summary.clone();
        }
        let (mut all, mut times, mut policy_times) = (Self::default(), StageTimes::default(), PolicyTimes::default());
        for room in rooms {
            all.add(room.summary);
            times.absorb(&mut room.times.clone());
            policy_times.add_all(room.policy_times);
            all.rooms.insert(room.room.to_string(), room.summary.clone());
        }
        all.add_times(&times, &policy_times);
        all
    }

    /// Adds another room's counts.
    fn add(&mut self, other: &Self) {
        self.policy.clone_from(&other.policy);
        self.engine.clone_from(&other.engine);
        self.actor.clone_from(&other.actor);
        self.epoch = self.epoch.max(other.epoch);
        for (here, there) in [
            (&mut self.decisions, other.decisions),
            (&mut self.commands, other.commands),
            (&mut self.modelled, other.modelled),
            (&mut self.unsent, other.unsent),
            (&mut self.dropped, other.dropped),
            (&mut self.unanswered, other.unanswered),
            (&mut self.sources, other.sources),
        ] {
            *here += there;
        }
        for (here, there) in [
            (&mut self.fallbacks, &other.fallbacks),
            (&mut self.withheld, &other.withheld),
            (&mut self.refused, &other.refused),
            (&mut self.missed, &other.missed),
            (&mut self.users, &other.users),
            (&mut self.epoch_events, &other.epoch_events),
        ] {
            there.iter().for_each(|(name, count)| *here.entry(name.clone()).or_default() += count);
        }
        self.clipped += other.clipped;
        for (name, policy) in &other.policies {
            self.policies.entry(name.clone()).or_default().tally += policy.tally;
        }
        self.belief = match (self.belief, other.belief) {
            (Some(here), Some(there)) => Some(here.with(there)),
            (here, there) => here.or(there),
        };
        self.standby |= other.standby;
        self.peers += other.peers;
        self.standby_missing |= other.standby_missing;
        self.trackers += other.trackers;
        self.stops_held += other.stops_held;
        self.driver_absent |= other.driver_absent;
        self.geometry_differs |= other.geometry_differs;
        if other.unfit.is_some() {
            self.unfit.clone_from(&other.unfit);
        }
        if !other.last_problem.is_empty() {
            self.last_problem.clone_from(&other.last_problem);
        }
    }

    /// Sets which arrays have no driver, by index.
    pub fn set_without_driver(&mut self, without_driver: &[usize]) {
        self.driver_absent = !without_driver.is_empty();
        for (index, array) in self.arrays.iter_mut().enumerate() {
            array.driver_absent = without_driver.contains(&index);
        }
    }

    /// Adds the times.
    pub fn add_times(&mut self, times: &StageTimes, policy_times: &PolicyTimes) {
        for (name, policy) in &mut self.policies {
            policy.decision_us = policy_times.decision_us(name);
        }
        self.over_budget = times.over_budget();
        self.over_budget_by = nonzero(Stage::ALL.map(|stage| (stage.name(), times.over_budget_by(stage))));
        self.decision_us = quantiles_us(times.decision());
        self.stages_us = Stage::ALL.map(|stage| (stage.name().to_string(), quantiles_us(times.stage(stage)))).into();
        self.age_us = quantiles_us(times.age());
    }
}

/// The light of which enough was measured to show a loss.
fn served_light(watch: &LightWatch) -> Vec<ServedLight> {
    let leds = watch.leds().iter().enumerate().map(|(index, level)| (format!("led-{index}"), level));
    let all = [("mirrors".to_owned(), watch.mirrors())].into_iter().chain(leds);
    let measured = all.filter(|(_, level)| level.is_known());
    let light = measured.map(|(of, level)| {
        let off_since_s = level.off_since_ns().map(|since_ns| since_ns as f64 * 1e-9);
        ServedLight { of, ratio: level.ratio(), off_since_s }
    });
    light.collect()
}

/// The counts above zero, by name.
fn nonzero(counts: impl IntoIterator<Item = (impl Into<String>, u64)>) -> BTreeMap<String, u64> {
    counts.into_iter().filter(|(_, count)| *count > 0).map(|(name, count)| (name.into(), count)).collect()
}

/// The mismatch, and the flag of the controller's command line that accepts it, where there is one.
pub fn describe_unfit(unfit: &Unfit) -> String {
    let advice = match unfit {
        Unfit::Shape { .. } => "",
        Unfit::Range { .. } => ", or accept the range with --accept-small-range",
        Unfit::PaperAngles => ", or send them all the same with --force-paper-angles",
    };
    format!("{unfit}{advice}")
}

#[cfg(test)]
mod tests {
    use heliostat_core::{core::Timing, policy::Fixed};
    use heliostat_proto::Capabilities;
    use heliostat_scenario::Scenario;

    use super::*;

    #[test]
    fn the_report_leaves_out_counts_of_zero() {
        let scenario = Scenario::builtin("specular").expect("a built-in scenario");
        let policy = Box::new(Fixed::flat(scenario.mirror_count()));
        let mut controller = Controller::new(&scenario, scenario.channel_model().expect("valid"), policy, 1);
        let Summary { fallbacks, refused, users, epoch_events, .. } = Summary::of(&controller);
        assert_eq!([fallbacks, refused, users, epoch_events], [const { BTreeMap::new() }; 4]);
        // Without a position report there is nothing to observe.
        controller.poll_command(0, Timing::InTime, &mut |_| {});
        let summary = Summary::of(&controller);
        assert_eq!(summary.fallbacks, BTreeMap::from([("held".to_owned(), 1)]));
        assert!(summary.to_string().contains("\nfallbacks: held 1\nrefused: none\n"), "{summary}");
    }

    #[test]
    fn the_table_has_no_figure_of_what_was_not_counted() {
        let policies = BTreeMap::from([("nearest".to_owned(), PolicySummary::default())]);
        let rooms = BTreeMap::from([("a".to_owned(), Summary::default())]);
        let belief = Some(BeliefSummary { reports: 0, innovation_mean: 0.0, noise: None });
        let text = Summary { policies, rooms, belief, ..Summary::default() }.to_string();
        let row = text.lines().find(|line| line.starts_with("nearest")).expect("a row of the policy");
        assert!(row.split_whitespace().rev().take(2).eq(["-", "-"]), "{text}");
        assert!(text.ends_with("\nroom a: decisions 0") && !text.contains("innovation"), "{text}");
    }

    #[test]
    fn one_unfit_array_of_two_leaves_the_other_one_commanded() {
        let two = "[users]\ncount = 3\n[[mirrors]]\nrows = 2\ncolumns = 2\n[[mirrors]]\nrows = 2\ncolumns = 3\nwall = \"-x\"\n";
        let scenario = Scenario::from_toml(two).expect("a valid scenario");
        let policy = Box::new(Fixed::flat(scenario.mirror_count()));
        let mut controller = Controller::new(&scenario, scenario.channel_model().expect("valid"), policy, 1);
        let mut examine = |array| {
            controller.handle_capabilities(array, &Capabilities::default(), Err(Unfit::PaperAngles));
            let summary = Summary::of(&controller);
            assert!(summary.unfit.is_some());
            (summary.arrays.iter().map(|array| array.unfit).collect::<Vec<_>>(), summary.is_entirely_unfit())
        };
        assert_eq!(examine(1), (vec![false, true], false));
        assert_eq!(examine(0), (vec![true, true], true));
    }

    #[test]
    fn each_mode_that_is_no_fallback_is_a_mode_of_the_controller() {
        let modes = DegradedMode::ALL.map(DegradedMode::name);
        assert!(NodeStatus::WITHHELD.iter().all(|mode| modes.contains(mode)), "{modes:?}");
    }

    #[test]
    fn withheld_commands_have_their_own_line() {
        let withheld = BTreeMap::from([("withheld".to_owned(), 124)]);
        let summary = Summary { withheld, ..Summary::default() }.to_string();
        assert!(summary.contains("\nfallbacks: none\ncommands not sent: withheld 124\nrefused: none\n"), "{summary}");
    }
}
