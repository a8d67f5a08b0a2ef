//! A model of the rules for stops, epochs and ownership: every order of events in a small room.
//!
//! [stateright](https://docs.rs/stateright) visits every state that the model can reach. The model
//! runs the real code: the kit of `heliostat-array` with its latch and bounds, and the tenure of
//! `heliostat-core` and the hold of stops of `heliostat-proto`. [`stops`] models two arrays. Only clocks, network and operators are abstract:
//!
//! - Two controllers start, crash and start again, with a right clock or one a day ahead.
//! - One array crashes and starts again; only the record of its latch survives.
//! - Two operators stop and re-arm; the clock of one is an hour ahead.
//! - The network loses, delays, reorders and repeats messages.
//! - One attacker sends one message.
//!
//! Budgets bound each of these, so the number of states is finite.
//!
//! | property | means |
//! | --- | --- |
//! | [`STOPPED`] | from a stop until an operator's re-arm mirrors do not move, also over a restart |
//! | [`ONE_LEADER`] | an array never obeys two controllers in one epoch |
//! | [`NO_LOCKOUT`] | from every state, a single controller with a right clock is obeyed again |
//!
//! Tests break one rule each and show that the model finds it.

mod events;
mod model;
mod parts;
mod room;
mod stops;

use events::Budgets;
use model::{Model, NO_LOCKOUT, ONE_LEADER, STOPPED};
use stateright::{Checker, HasDiscoveries, Model as _};

/// Threads of a check.
const THREADS: usize = 2;

/// The property for which the model finds a counterexample, if there is one.
fn broken(model: Model, property: &'static str) -> Option<String> {
    let finish = HasDiscoveries::AnyOf([property].into());
    let checker = model.checker().threads(THREADS).finish_when(finish).spawn_bfs().join();
    let path = checker.discovery(property)?;
    Some(path.into_actions().iter().map(|action| format!("{action:?}\n")).collect())
}

/// Checks all properties in every state.
fn holds(budgets: Budgets) {
    let model = Model { budgets, ..Model::default() };
    let checker = model.checker().threads(THREADS).spawn_bfs().join();
    eprintln!("{} states, depth {}", checker.unique_state_count(), checker.max_depth());
    checker.assert_properties();
}

#[test]
fn no_order_of_stops_and_restarts_moves_a_stopped_array() {
    let once = Budgets { stops: 1, rearms: 1, array_crashes: 1, lost: 1, rounds: 5, ..Budgets::default() };
    holds(once);
    holds(Budgets { stops: 2, rearms: 2, held: 1, repeated: 1, rounds: 2, ..once });
}

#[test]
fn no_order_of_starts_and_crashes_gives_an_epoch_to_two_controllers_or_locks_one_out() {
    let once = Budgets { crashes: 1, starts: 1, lost: 1, ..Budgets::default() };
    holds(Budgets { lost: 2, rounds: 12, ..once });
    holds(Budgets { crashes: 2, starts: 2, held: 1, repeated: 1, rounds: 4, ..once });
}

#[test]
fn no_message_of_an_attacker_moves_a_stopped_array_or_locks_a_controller_out() {
    holds(Budgets { attacks: 1, stops: 1, rearms: 1, starts: 1, crashes: 1, rounds: 5, ..Budgets::default() });
}

#[test]
fn a_restart_that_forgets_the_latch_is_found() {
    let budgets = Budgets { stops: 1, array_crashes: 1, rounds: 3, ..Budgets::default() };
    let path = broken(Model { budgets, forgets_latch: true, ..Model::default() }, STOPPED);
    assert!(path.is_some_and(|path| path.contains("StartArray")), "a stopped array moves after its restart");
}

#[test]
fn controllers_that_share_their_epochs_are_found() {
    let budgets = Budgets { lost: 1, rounds: 4, ..Budgets::default() };
    let path = broken(Model { budgets, shares_epochs: true, ..Model::default() }, ONE_LEADER);
    assert!(path.is_some(), "both are obeyed in one epoch");
}

#[test]
fn controllers_that_keep_their_epoch_are_found() {
    let budgets = Budgets { attacks: 1, rounds: 4, ..Budgets::default() };
    let path = broken(Model { budgets, keeps_epoch: true, ..Model::default() }, NO_LOCKOUT);
    assert!(path.is_some_and(|path| path.contains("Attack")), "one message locks every controller out");
}
