//! Replaces the policy while the controller runs, by order of an operator.
//!
//! The order arrives on a thread of the bus, which puts it into a short queue. A thread of its own
//! builds the policy and warms it up. It then holds the decision loop for the exchange of one
//! pointer, between two decisions. An unknown policy, or one that does not fit the room, is refused
//! with a specific error, and the present policy continues.

use std::{
    sync::{
        Arc, Mutex,
        mpsc::{self, Receiver, SyncSender},
    },
    time::{Duration, Instant},
};

use clap::ValueEnum;
use heliostat_bus::{Bus, Subscription};
use heliostat_core::{
    core::WARM_UP_RUNS,
    policy::{Finding, Policy, PolicyKind, warm_up},
};
use heliostat_models::{ActorSource, build_tried};
use heliostat_proto::{ControllerControl, decode};
use heliostat_scenario::{Scenario, similar};
use heliostat_service::locks::lock;

use super::decision_loop::DecisionLoop;
use crate::report::stage_times::StageTimes;

/// Orders that wait while a policy is being built; further orders are refused.
const WAITING_MAX: usize = 4;

/// Maximum duration of a start-up warm-up, which then ends before [`WARM_UP_RUNS`].
const WARM_UP_MAX: Duration = Duration::from_secs(2);

/// One item for each run of a start-up warm-up that begins now.
pub fn warm_up_runs() -> impl Iterator {
    let started = Instant::now();
    (0..WARM_UP_RUNS).take_while(move |_| started.elapsed() < WARM_UP_MAX)
}

/// Counters of orders.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct SwapCounters {
    /// Policies replaced.
    pub replaced: u64,
    /// Orders refused.
    pub refused: u64,
    /// The last refusal.
    pub last_refusal: Option<String>,
    /// Warnings of the trials of learned policies.
    pub warnings: u64,
    /// The last of them.
    pub last_warning: Option<String>,
}

/// Builds policies for the room of a scenario.
pub struct PolicyBuilder {
    /// The room.
    pub scenario: Scenario,
    /// The policy of the command line and the source of its actor; other policies use built-in
    /// actors.
    pub configured: (PolicyKind, ActorSource),
}

impl PolicyBuilder {
    /// Builds a policy by its name on the command line, and warms it up.
    ///
    /// # Errors
    /// Why the name is unknown, or the policy does not fit the room.
    pub fn build(&self, name: &str) -> Result<(Box<dyn Policy>, Vec<Finding>), String> {
        let kind = PolicyKind::from_str(name, false).map_err(|_| unknown(name))?;
        let (configured, source) = &self.configured;
        let source = if kind == *configured { source } else { &ActorSource::Shipped };
        let tried = build_tried(kind, &self.scenario, source);
        let (mut policy, findings) = tried.map_err(|error| error.to_string())?;
        let model = self.scenario.channel_model().map_err(|error| error.to_string())?;
        warm_up(&mut [policy.as_mut()], &model, self.scenario.users.count, warm_up_runs());
        Ok((policy, findings))
    }
}

fn unknown(name: &str) -> String {
    let names: Vec<String> = PolicyKind::value_variants().iter().map(|kind| kind.name()).collect();
    let (known, hint) = (names.join(", "), similar::hint(name, names.iter().map(String::as_str)));
    format!("there is no policy \"{name:.64}\": expected one of {known}{hint}")
}

/// Replaces the policy of one decision loop.
#[derive(Clone)]
pub struct PolicySwap {
    decision_loop: Arc<Mutex<DecisionLoop>>,
    counters: Arc<Mutex<SwapCounters>>,
}

impl PolicySwap {
    /// Subscribes to the orders of a room, until the subscription is dropped.
    ///
    /// # Errors
    /// If the session is closed, or a thread cannot be started.
    pub fn subscribe(
        bus: &Bus,
        decision_loop: &Arc<Mutex<DecisionLoop>>,
        builder: PolicyBuilder,
    ) -> anyhow::Result<(Self, Subscription)> {
        let swap = Self { decision_loop: Arc::clone(decision_loop), counters: Arc::default() };
        let (sender, orders) = mpsc::sync_channel(WAITING_MAX);
        let on_arrival = swap.clone();
        let subscription = bus.subscribe(&bus.room().controller_control(), move |payload| {
            if let Err(refusal) = enqueue(payload, &sender) {
                on_arrival.refuse(refusal);
            }
        })?;
        let worker = swap.clone();
        // The thread ends with the subscription, which owns the sending end of its queue.
        std::thread::Builder::new().name("policies".into()).spawn(move || worker.run(&orders, &builder))?;
        Ok((swap, subscription))
    }

    /// Counters since the start.
    pub fn counters(&self) -> SwapCounters {
        lock(&self.counters).clone()
    }

    fn run(&self, orders: &Receiver<ControllerControl>, builder: &PolicyBuilder) {
        for order in orders {
            let name = &order.policy;
            match builder.build(name) {
                Ok((policy, findings)) => {
                    self.report(findings);
                    let fresh = StageTimes::default();
                    let former = lock(&self.decision_loop).replace_policy(policy, fresh);
                    lock(&self.counters).replaced += 1;
                    tracing::info!(policy = name, "policy replaced");
                    // Dropped without the lock, because that may take long.
                    drop(former);
                }
                Err(refusal) => {
                    self.refuse(format!("{}: policy {name:.64} refused: {refusal}", order.stamp.order_name()))
                }
            }
        }
    }

    /// Logs the notes of a policy's trial, and passes the warnings to the status report, which logs
    /// them.
    pub fn report(&self, findings: Vec<Finding>) {
        for finding in findings {
            match finding {
                Finding::Note(note) => tracing::info!("{note}"),
                Finding::Warning(warning) => {
                    let mut counters = lock(&self.counters);
                    counters.warnings += 1;
                    counters.last_warning = Some(warning);
                }
            }
        }
    }

    fn refuse(&self, refusal: String) {
        let mut counters = lock(&self.counters);
        counters.refused += 1;
        counters.last_refusal = Some(refusal);
    }
}

/// Passes an order on to the thread that builds.
fn enqueue(payload: &[u8], orders: &SyncSender<ControllerControl>) -> Result<(), String> {
    let order: ControllerControl = decode(payload).map_err(|error| format!("controller/control: {error}"))?;
    let name = order.stamp.order_name();
    orders.try_send(order).map_err(|_| format!("{name}: refused, because {WAITING_MAX} policies wait already"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_known_policy_is_built_and_an_unknown_one_is_refused_with_its_name() {
        let configured = (PolicyKind::Ddpg, ActorSource::Shipped);
        let builder = PolicyBuilder { scenario: Scenario::default(), configured };
        assert_eq!(builder.build("greedy").expect("it is there").0.name(), "greedy");
        let refusal = builder.build("clairvoyant").err().expect("no such policy");
        assert!(refusal.contains("\"clairvoyant\"") && refusal.contains("fixed-point"), "{refusal}");
        let misspelt = builder.build("gready").err().expect("no such policy");
        assert!(misspelt.ends_with("; a similar name exists: greedy"), "{misspelt}");
    }
}
