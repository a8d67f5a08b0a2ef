//! The exported file compared with the learner's forward pass and the channel's decoder.

use heliostat_channel::MirrorAngles;
use heliostat_core::policy::actor_file::{ActorFile, room_entries};
use heliostat_core::policy::{Actor as Served, Policy};
use heliostat_learn::environment::{Environment, Rooms};
use heliostat_learn::export::actor::export;
use heliostat_learn::learners::ddpg::{Ddpg, Settings};
use heliostat_learn::networks::actor::{Actor, States};
use heliostat_learn::networks::assign;
use heliostat_scenario::{ChannelMode, Scenario};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Two scores of one mirror that differ by less than this, relative to the larger, may be ordered
/// either way in f32 and f64.
const NEAR_TIE: f64 = 1e-5;

/// Largest share of the served mirrors that may be near ties.
const NEAR_TIES_MAX: f64 = 1e-3;

const OBSERVATIONS: usize = 1000;

fn tuned(scenario: &Scenario) -> Settings {
    Settings::tuned(5, scenario.channel.mode)
}

/// An actor whose actions spread over [-1, 1], as those of a trained one.
fn spread_actor(scenario: &Scenario, settings: Settings) -> Actor {
    let mut rng = ChaCha8Rng::seed_from_u64(settings.run.seed);
    let learner = Ddpg::new(scenario, settings, &mut rng).expect("valid settings");
    let actor = learner.actor().clone();
    let head = actor.network.layer("head");
    assign(&head.weight, &(head.weight.detach() * 300.0).expect("a product")).expect("the same shape");
    actor
}

fn served(actor: &Actor, scenario: &Scenario) -> Served {
    let bytes = export(actor, &room_entries(scenario, actor.layout.slots())).expect("an exported actor");
    let file = ActorFile { origin: "the exported actor".into(), bytes: bytes.into() };
    heliostat_models::load_actor(&file, scenario).expect("the engine takes the graph")
}

/// Whether the two best scores of a mirror are too close to be ordered safely.
fn near_tie(weights: &[f32], steering: impl Fn(usize) -> f32) -> bool {
    let mut scores: Vec<f64> =
        weights.iter().enumerate().map(|(slot, weight)| f64::from(*weight) * f64::from(steering(slot))).collect();
    scores.sort_by(|a, b| b.total_cmp(a));
    scores[0] > 0.0 && scores[0] - scores[1] < NEAR_TIE * scores[0]
}

/// The largest difference in angle over all mirrors except near ties, and the share of near ties.
fn compare(scenario: &Scenario, settings: Settings) -> (f64, f64) {
    let actor = spread_actor(scenario, settings);
    let mut served = served(&actor, scenario);
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    let mirrors = scenario.mirror_count();
    let mut got = MirrorAngles::flat(mirrors);
    let (mut worst, mut ties) = (0.0_f64, 0);
    for _ in 0..OBSERVATIONS {
        let room = Rooms::Randomised.draw(scenario, &mut rng);
        let environment = Environment::new(&room, None, rng.random()).expect("a valid room");
        let vector = environment.vector();
        let actions = actor.actions(&States::row(actor.layout, vector)).expect("actions");
        assert!(actions.iter().all(|action| action.is_finite()), "expected finite actions, found {actions:?}");
        let expected = actor.decode(&environment, &actions);
        served.act(environment.model(), environment.observation(), &mut got).expect("angles");
        let weights = actor.head.weights(actor.layout.encoder, vector, &actions).collect::<Vec<f32>>();
        for mirror in 0..mirrors {
            let steering = |slot: usize| vector[actor.layout.encoder.steering_amplitude()][slot * mirrors + mirror];
            if scenario.channel.mode == ChannelMode::Specular && near_tie(&weights, steering) {
                ties += 1;
                continue;
            }
            let roll = (expected.roll[mirror] - got.roll[mirror]).abs();
            let yaw = (expected.yaw[mirror] - got.yaw[mirror]).abs();
            worst = worst.max(roll).max(yaw);
        }
    }
    (worst, f64::from(ties) / (OBSERVATIONS * mirrors) as f64)
}

fn check(scenario: &Scenario, settings: Settings) {
    let (worst, ties) = compare(scenario, settings);
    assert!(worst < 1e-5, "angles differ by up to {worst} rad");
    assert!(ties < NEAR_TIES_MAX, "{ties} of the mirrors are near ties");
}

#[test]
fn specular_file_matches_the_learners_forward_pass() {
    let scenario = Scenario::builtin("specular").expect("built in");
    check(&scenario, tuned(&scenario));
}

#[test]
fn specular_file_of_the_plain_network_matches_the_learners_forward_pass() {
    check(&Scenario::builtin("specular").expect("built in"), Settings::paper(5));
}

#[test]
fn paper_file_matches_the_learners_forward_pass() {
    let scenario = Scenario::builtin("paper").expect("built in");
    check(&scenario, tuned(&scenario));
}

#[test]
fn files_for_other_walls_and_arrays_match_too() {
    for (name, wall) in [("specular", "+x"), ("specular", "-x"), ("specular", "-y"), ("paper", "-x"), ("paper", "-y")] {
        let overrides = ["mirrors.rows=3".into(), "mirrors.columns=4".into(), format!("mirrors.wall={wall}")];
        let scenario = Scenario::builtin(name).and_then(|scenario| scenario.with_overrides(&overrides));
        let scenario = scenario.expect("a valid scenario");
        check(&scenario, tuned(&scenario));
    }
}

#[test]
fn the_actions_do_not_depend_on_the_order_of_users() {
    let scenario = Scenario::builtin("specular").expect("built in");
    let actor = spread_actor(&scenario, tuned(&scenario));
    let environment = Environment::new(&scenario, None, 3).expect("a valid room");
    let slots = actor.layout.slots();
    let state = &States::row(actor.layout, environment.vector());
    let features = state.len() / slots - scenario.mirror_count();
    let (head, tail) = state.split_at(slots * features);
    let swap = |rows: &[f32], width: usize| -> Vec<f32> {
        let order = [3, 1, 2, 0].into_iter().chain(4..slots);
        order.flat_map(|slot| rows[slot * width..][..width].to_vec()).collect()
    };
    let swapped = [swap(head, features), swap(tail, scenario.mirror_count())].concat();
    let before = actor.actions(state).expect("actions");
    let after = actor.actions(&swapped).expect("actions");
    assert!((before[0] - before[3]).abs() > 1e-3, "users 0 and 3 must differ for the test to be valid");
    for (slot, other) in [(0, 3), (1, 1), (2, 2), (3, 0)] {
        assert!((before[slot] - after[other]).abs() < 1e-5, "slot {slot}: {} and {}", before[slot], after[other]);
    }
}
