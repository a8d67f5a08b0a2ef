//! Another policy while the controller runs, by order of an operator.
//!
//! The order arrives on a thread of the bus, which only passes it on. A thread of its own builds the policy and lets it decide for an
//! invented room until it is warm; the desk is then held for the exchange of one pointer, between two decisions. What is
//! unknown or does not fit is refused by name, and the policy that decides goes on deciding.

use std::sync::{
    Arc, Mutex,
    mpsc::{self, Receiver, SyncSender},
};

use clap::ValueEnum;
use heliostat_bus::{Bus, Subscription};
use heliostat_channel::ChannelModel;
use heliostat_proto::{ControllerControl, decode};
use heliostat_scenario::Scenario;

use crate::{desk::Desk, intake::lock, post::warm_up_runs};
use heliostat_decide::{
    core::warm_up,
    policy::{Policy, PolicyKind},
};
use heliostat_engine::ActorSource;

/// Orders that wait while a policy is being built; whoever presses faster is refused.
const WAITING_MAX: usize = 4;

/// Orders that came, and what became of them.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ControlAccount {
    /// Policies exchanged.
    pub switched: u64,
    /// Orders refused.
    pub refused: u64,
    /// Why the last one was.
    pub last_refusal: Option<String>,
}

/// Builds policies for the room of a scenario.
pub struct Workshop {
    /// The room.
    pub scenario: Scenario,
    /// Its optics.
    pub model: ChannelModel,
    /// A policy whose actor is not the built-in one, and where that comes from; those of all others are.
    pub own: (PolicyKind, ActorSource),
}

/// Listens in the room of a session on behalf of a desk, until the subscription is dropped.
///
/// # Errors
/// Where the session is closed, or no thread can be had.
pub fn listen(bus: &Bus, desk: &Arc<Mutex<Desk>>, workshop: Workshop) -> anyhow::Result<Subscription> {
    let (sender, orders) = mpsc::sync_channel(WAITING_MAX);
    let at_arrival = Arc::clone(desk);
    let subscription = bus.subscribe(&bus.room().controller_control(), move |payload| {
        if let Err(refusal) = take(payload, &sender) {
            refuse(&at_arrival, refusal);
        }
    })?;
    let desk = Arc::clone(desk);
    // It ends with the subscription, which holds the other end of its queue.
    std::thread::Builder::new().name("policies".into()).spawn(move || obey(&orders, &desk, &workshop))?;
    Ok(subscription)
}

impl Workshop {
    /// A policy by its name on the command line, ready to decide.
    ///
    /// # Errors
    /// What is wrong with the name, or why the policy does not fit the room.
    pub fn build(&self, name: &str) -> Result<Box<dyn Policy>, String> {
        let kind = PolicyKind::from_str(name, false).map_err(|_| unknown(name))?;
        let (own, source) = &self.own;
        let source = if kind == *own { source } else { &ActorSource::Shipped };
        let mut policy = heliostat_engine::build(kind, &self.scenario, source).map_err(|error| error.to_string())?;
        warm_up(&mut [policy.as_mut()], &self.model, self.scenario.users.count, warm_up_runs());
        Ok(policy)
    }
}

fn unknown(name: &str) -> String {
    let values = PolicyKind::value_variants().iter().filter_map(ValueEnum::to_possible_value);
    let known = values.map(|value| value.get_name().to_owned()).collect::<Vec<_>>().join(", ");
    format!("there is no policy \"{name:.64}\"; wanted one of {known}")
}

/// Passes an order on to the thread that builds.
fn take(payload: &[u8], orders: &SyncSender<String>) -> Result<(), String> {
    let order: ControllerControl = decode(payload).map_err(|error| format!("controller/control: {error}"))?;
    orders.try_send(order.policy).map_err(|_| "too many policies ordered at once; the last order is dropped".to_owned())
}

fn obey(orders: &Receiver<String>, desk: &Mutex<Desk>, workshop: &Workshop) {
    for name in orders {
        match workshop.build(&name) {
            Ok(policy) => {
                let mut held = lock(desk);
                let retired = held.controller.replace_policy(policy);
                held.control.switched += 1;
                drop(held);
                tracing::info!(policy = name, "switched");
                // Only here, where nobody waits.
                drop(retired);
            }
            Err(refusal) => refuse(desk, format!("policy {name:.64} refused: {refusal}")),
        }
    }
}

fn refuse(desk: &Mutex<Desk>, refusal: String) {
    let mut desk = lock(desk);
    desk.control.refused += 1;
    desk.control.last_refusal = Some(refusal);
}

#[cfg(test)]
mod tests {
    use super::*;

    fn workshop(scenario: Scenario) -> Workshop {
        let model = scenario.channel_model().expect("a built-in scenario");
        Workshop { scenario, model, own: (PolicyKind::Ddpg, ActorSource::Shipped) }
    }

    #[test]
    fn a_policy_is_built_by_its_name_and_others_are_refused_by_theirs() {
        let workshop = workshop(Scenario::default());
        assert_eq!(workshop.build("greedy").expect("it is there").name(), "greedy");
        let refusal = workshop.build("clairvoyant").err().expect("no such policy");
        assert!(refusal.contains("\"clairvoyant\"") && refusal.contains("fixed-point"), "{refusal}");
    }

    #[test]
    fn a_policy_that_does_not_fit_the_room_says_so() {
        let mut scenario = Scenario::default();
        (scenario.mirrors.rows, scenario.mirrors.columns) = (6, 9);
        let refusal = workshop(scenario).build("ddpg").err().expect("no file for 6 x 9 mirrors");
        assert!(refusal.contains("6x9"), "{refusal}");
    }
}
