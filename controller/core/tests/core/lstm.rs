//! The policy that predicts places by the last reports.

use heliostat_core::{
    core::{Controller, DegradedMode},
    policy::{PolicyKind, actor_file::key},
};
use heliostat_scenario::Scenario;

use crate::support::{ActorRecipe, Room, build_with, controller, scenario};

fn running(scenario: &Scenario, kind: PolicyKind, recipe: &ActorRecipe, ticks: u64) -> Controller {
    let mut controller = controller(scenario, build_with(kind, scenario, &recipe.file()).unwrap());
    let mut room = Room::new(scenario);
    (1..=ticks).for_each(|tick| drop(room.tick(&mut controller, tick).command()));
    assert_eq!(controller.counters().degraded(DegradedMode::PolicyFailed), 0);
    controller
}

/// The observed places in m after some ticks.
fn places(scenario: &Scenario, kind: PolicyKind, recipe: &ActorRecipe) -> Vec<[f64; 2]> {
    let controller = running(scenario, kind, recipe, 20);
    controller.observation().positions.iter().map(|position| [position.x, position.y]).collect()
}

/// The largest distance along an axis between places and others that are moved by this.
fn apart(places: &[[f64; 2]], others: &[[f64; 2]], moved: [f64; 2]) -> f64 {
    assert_eq!(places.len(), others.len());
    let pairs = places.iter().flatten().zip(others.iter().flat_map(|[x, y]| [x + moved[0], y + moved[1]]));
    pairs.map(|(one, other)| (one - other).abs()).fold(0.0, f64::max)
}

#[test]
fn outputs_move_the_users_from_the_gauss_markov_prediction_with_every_belief() {
    let none = ActorRecipe::displacements([0.0; 2]);
    let steady = scenario(&["control.belief=\"constant-velocity\""]);
    let expected = places(&steady, PolicyKind::Greedy, &none);
    for belief in ["none", "constant-velocity", "filter"] {
        let room = scenario(&[&format!("control.belief=\"{belief}\"")]);
        let unmoved = places(&room, PolicyKind::Lstm, &none);
        // The lead is short, and the velocity turns slowly.
        assert!(apart(&unmoved, &expected, [0.0; 2]) < 2e-3, "{belief}: {unmoved:?} for {expected:?}");
        let moved = places(&room, PolicyKind::Lstm, &ActorRecipe::displacements([0.25, -0.125]));
        assert!(apart(&moved, &unmoved, [0.25, -0.125]) < 1e-6, "{belief}: {moved:?} for {unmoved:?}");
        // The file decides under the name of another learned policy.
        assert_eq!(places(&room, PolicyKind::Ddpg, &ActorRecipe::displacements([0.25, -0.125])), moved);
    }
}

#[test]
fn no_user_is_predicted_to_leave_the_room() {
    let room = scenario(&["control.belief=\"none\""]);
    let far = places(&room, PolicyKind::Lstm, &ActorRecipe::displacements([90.0, -90.0]));
    assert!(far.iter().all(|place| *place == [2.5, -2.5]), "{far:?}");
}

#[test]
fn commands_follow_the_predicted_places_and_another_policy_the_belief() {
    let room = scenario(&["control.belief=\"none\""]);
    let recipe = ActorRecipe::displacements([0.6, 0.3]);
    let angles = |controller: &Controller| controller.observation().angles.roll.clone();
    let mut predicting = running(&room, PolicyKind::Lstm, &recipe, 20);
    let reported = running(&room, PolicyKind::Greedy, &recipe, 20);
    assert_ne!(angles(&predicting), angles(&reported));
    predicting.replace_policy(build_with(PolicyKind::Greedy, &room, &recipe.file()).unwrap());
    let mut rest = Room { sequence: 1000, ..Room::new(&room) };
    rest.tick(&mut predicting, 21).command();
    let same = running(&room, PolicyKind::Greedy, &recipe, 21);
    assert_eq!(predicting.observation().positions, same.observation().positions);
}

#[test]
fn a_policy_that_replaces_another_predicts_from_the_next_report_on() {
    let room = scenario(&["control.belief=\"none\""]);
    let recipe = ActorRecipe::displacements([0.6, 0.3]);
    let mut replaced = running(&room, PolicyKind::Greedy, &recipe, 20);
    replaced.replace_policy(build_with(PolicyKind::Lstm, &room, &recipe.file()).unwrap());
    let mut rest = Room { sequence: 1000, ..Room::new(&room) };
    rest.tick(&mut replaced, 21).command();
    let reported = running(&room, PolicyKind::Greedy, &recipe, 21);
    let moved = replaced.observation().positions[0] - reported.observation().positions[0];
    assert!((moved.x - 0.6).abs() < 0.02 && (moved.y - 0.3).abs() < 0.02, "{moved:?}");
}

#[test]
fn files_of_another_kind_are_refused_with_advice() {
    let room = scenario(&[]);
    let fitting = || ActorRecipe::displacements([0.0; 2]);
    let cases = [
        (fitting().with_metadata(key::OBSERVATION_VERSION, "4"), "observation version \"4\", expected 1"),
        (ActorRecipe::compact([0.0; 3]), "the action \"compact\", expected \"displacements\""),
        (ActorRecipe { output_name: "angles", ..fitting() }, "expected exactly one, \"displacements\" (f32 [rows, 2])"),
        (ActorRecipe::fitting(&room), "heliostat train lstm"),
        (ActorRecipe::displacements([f32::NAN; 2]), "not finite"),
    ];
    for (recipe, words) in cases {
        let text = build_with(PolicyKind::Lstm, &room, &recipe.file()).err().expect("a refusal").to_string();
        assert!(text.contains("test.onnx") && text.contains(words), "{text}");
    }
}
