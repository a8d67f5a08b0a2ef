//! The channel in tensors compared with the channel itself: values, and gradients by finite
//! differences.

use candle_core::{Device, Tensor, Var};
use heliostat_channel::decode;
use heliostat_channel::mirrors::MirrorAngles;
use heliostat_core::observation::Summary;
use heliostat_learn::environment::features::{Head, Layout};
use heliostat_learn::environment::{Environment, Reward, RewardForm, Rooms};
use heliostat_learn::learners::analytic::{Channel, Settings};
use heliostat_scenario::Scenario;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

const REWARD: Reward = Reward { form: RewardForm::Shortfall, lambda: 10.0, margin: 1.5 };

struct Bench {
    scenario: Scenario,
    layout: Layout,
    head: Head,
}

impl Bench {
    fn new(mode: &str) -> Self {
        let overrides = ["mirrors.rows=4", "mirrors.columns=5"];
        let scenario = Scenario::builtin(mode).and_then(|scenario| scenario.with_overrides(&overrides));
        let scenario = scenario.expect("a valid scenario");
        let head = Settings::new(1, scenario.channel.mode).head;
        Self { layout: Layout::of(&scenario), head, scenario }
    }

    fn rooms(&self, count: usize) -> Vec<(Environment, Vec<f64>)> {
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        let mut room = || {
            let room = Rooms::Randomised.draw(&self.scenario, &mut rng);
            let environment = Environment::new(&room, None, rng.random()).expect("a valid room");
            let actions = (0..environment.users()).map(|_| rng.random_range(-0.9..0.9)).collect();
            (environment, actions)
        };
        (0..count).map(|_| room()).collect()
    }

    /// The mean of the users' parts of the reward by decoder and channel, in bit/s/Hz of a user's
    /// band.
    fn truth(&self, room: &Environment, actions: &[f64]) -> f64 {
        let (model, seen) = (room.model(), room.observation());
        let balanced = &room.vector()[self.layout.encoder.column(Summary::LogWeight as usize)];
        let weight =
            |(action, balanced): (&f64, &f32)| (f64::from(self.head.range) * action + f64::from(*balanced)).exp();
        let weights: Vec<f64> = actions.iter().zip(balanced).map(weight).collect();
        let mut angles = MirrorAngles::flat(seen.mirrors());
        decode::decode(model, &seen.scene, &weights, &mut angles);
        let mut rates = vec![0.0; seen.users()];
        seen.scene.rates_bps(model, &angles, &mut rates);
        let parts = rates
            .iter()
            .zip(&seen.min_rate_bps)
            .map(|(rate, min_rate)| rate - REWARD.lambda * (REWARD.margin * min_rate - rate).max(0.0));
        parts.sum::<f64>() / model.budget.bandwidth_hz
    }

    /// The mean in tensors, with its gradient with respect to the actions.
    fn found(&self, room: Environment, actions: &[f64], exponent: f64) -> (f64, Vec<f32>) {
        let mut slots = vec![0.0_f32; self.layout.slots()];
        slots.iter_mut().zip(actions).for_each(|(slot, action)| *slot = *action as f32);
        let variable = Var::from_slice(&slots, (1, slots.len()), &Device::Cpu).expect("actions");
        let channel = Channel::new(&[room], self.layout).expect("a channel");
        let amplitude = channel.amplitude(&variable, self.head, exponent).expect("amplitudes");
        let reward: Tensor = channel.reward(&amplitude, REWARD).and_then(|reward| reward.sum_all()).expect("a reward");
        let gradients = reward.backward().expect("gradients");
        let gradient = gradients.get(&variable).and_then(|all| all.flatten_all().ok()?.to_vec1().ok());
        (f64::from(reward.to_scalar::<f32>().expect("a number")), gradient.expect("its gradient"))
    }
}

#[test]
fn the_tensors_of_the_papers_channel_match_values_and_gradients() {
    let bench = Bench::new("paper-calibrated");
    let mut compared = 0;
    for (room, actions) in bench.rooms(30) {
        let truth = |actions: &[f64]| bench.truth(&room, actions);
        let expected = truth(&actions);
        let slopes: Vec<[f64; 2]> = (0..actions.len())
            .map(|user| {
                let moved = |by: f64| {
                    let mut moved = actions.clone();
                    moved[user] += by;
                    truth(&moved)
                };
                [1e-4, 1e-5].map(|step| (moved(step) - moved(-step)) / (2.0 * step))
            })
            .collect();
        let (found, gradient) = bench.found(room, &actions, 8.0);
        assert!((found - expected).abs() < 1e-4 * expected.abs().max(1.0), "{found} for {expected}");
        for (slope, found) in slopes.iter().zip(&gradient) {
            // At a kink of the reward two step sizes give two slopes.
            if (slope[0] - slope[1]).abs() < 1e-4 {
                assert!((f64::from(*found) - slope[1]).abs() < 1e-3, "{found} for {slope:?}");
                compared += 1;
            }
        }
        assert!(gradient[actions.len()..].iter().all(|value| *value == 0.0));
    }
    assert!(compared > 100, "{compared} slopes compared");
}

#[test]
fn the_softened_choice_converges_to_the_true_decoder() {
    let bench = Bench::new("specular");
    for (room, actions) in bench.rooms(30) {
        let expected = bench.truth(&room, &actions);
        let (found, _) = bench.found(room, &actions, 4000.0);
        assert!((found - expected).abs() < 2e-3 * expected.abs().max(1.0), "{found} for {expected}");
    }
}

#[test]
fn the_gradient_of_the_softened_choice_matches_finite_differences() {
    let bench = Bench::new("specular");
    let mut compared = 0;
    for index in 0..20 {
        let again = || bench.rooms(20).swap_remove(index);
        let (room, actions) = again();
        let (_, gradient) = bench.found(room, &actions, 8.0);
        for user in 0..actions.len() {
            let moved = |by: f64| {
                let mut moved = actions.clone();
                moved[user] += by;
                bench.found(again().0, &moved, 8.0).0
            };
            let [wide, narrow] = [4e-3, 2e-3].map(|step| (moved(step) - moved(-step)) / (2.0 * step));
            if (wide - narrow).abs() < 0.02 * (1.0 + narrow.abs()) {
                let found = f64::from(gradient[user]);
                assert!((found - narrow).abs() < 0.03 * (1.0 + narrow.abs()), "{found} for {narrow}");
                compared += 1;
            }
        }
    }
    assert!(compared > 60, "{compared} slopes compared");
}
