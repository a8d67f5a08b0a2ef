//! The keys of a scenario that have no effect on exact states.
//!
//! Training, held-out states and static tasks have neither reports nor a belief, and their mirrors
//! turn at once to the angles of an action.

use heliostat_channel::ChannelError;
use heliostat_core::belief::conditions::{Condition, small_range, unused_keys};
use heliostat_scenario::{Actuator, ActuatorProfile, Scenario, Streams, override_keys};

use crate::error::EnvironmentError;

/// Tables of which no key has an effect.
const TABLES: [&str; 2] = ["actuator", "streams"];

/// The keys of `control` that have an effect: the range of an axis, and the limits of a search.
const OF_CONTROL: [&str; 3] = ["range_deg", "search_evaluations", "search_time_us"];

/// Refuses overrides of the form `table.key=value` that have no effect on exact states.
///
/// # Errors
/// [`EnvironmentError::ClosedLoopOnly`] with the key of the first one.
pub fn check_overrides(overrides: impl IntoIterator<Item = impl AsRef<str>>) -> Result<(), EnvironmentError> {
    first_without_effect(overrides).map_or(Ok(()), |key| Err(EnvironmentError::ClosedLoopOnly(key)))
}

/// As [`check_overrides`], for training, which has no closed loop.
///
/// # Errors
/// [`EnvironmentError::NotInTraining`] with the key of the first one.
pub fn check_training(overrides: impl IntoIterator<Item = impl AsRef<str>>) -> Result<(), EnvironmentError> {
    first_without_effect(overrides).map_or(Ok(()), |key| Err(EnvironmentError::NotInTraining(key)))
}

fn first_without_effect(overrides: impl IntoIterator<Item = impl AsRef<str>>) -> Option<String> {
    let mut keys = overrides.into_iter().flat_map(|text| override_keys(text.as_ref()));
    keys.find(|key| !has_effect(key))
}

/// Whether a key, as `users.count`, has an effect on exact states.
fn has_effect(key: &str) -> bool {
    match key.split_once('.') {
        Some(("control", of_control)) => OF_CONTROL.contains(&of_control),
        Some((table, _)) => !TABLES.contains(&table),
        None => !TABLES.contains(&key),
    }
}

/// The conditions of a scenario with late, noisy or lost reports, or with slow or faulty mirrors, which
/// exact states do not have, that of places out of the range of the controller, and those of keys without effect in any
/// loop. The profile `mems` is none.
///
/// `of` names what uses the states, as `a static comparison`, and `advice` what to do for the faults.
///
/// # Errors
/// [`ChannelError`] where the scenario describes no channel.
pub fn conditions(scenario: &Scenario, of: &str, advice: &str) -> Result<Vec<Condition>, ChannelError> {
    // Exact mirrors have the range of the controller alone.
    let exact = Scenario { actuator: Actuator::default(), ..scenario.clone() };
    let out_of_range = small_range(&exact, &exact.channel_model()?);
    let found = [exact_reports(scenario, of, advice), exact_mirrors(scenario, of, advice), out_of_range];
    Ok(found.into_iter().flatten().chain(unused_keys(scenario)).collect())
}

/// The condition of a scenario with slow or faulty mirrors; `of` and `advice` as in [`conditions`].
fn exact_mirrors(Scenario { actuator, .. }: &Scenario, of: &str, advice: &str) -> Option<Condition> {
    let is_servo = actuator.profile == ActuatorProfile::Servo;
    let faults = [
        ("actuator.profile", is_servo.then_some(1.0)),
        ("actuator.natural_frequency_hz", actuator.natural_frequency_hz),
        ("actuator.low_pass_hz", actuator.low_pass_hz),
        ("actuator.slew_deg_per_s", actuator.slew_deg_per_s),
        ("actuator.resolution_bits", actuator.resolution_bits.map(f64::from)),
        ("actuator.delay_ms", actuator.delay_ms),
        ("actuator.stuck_share", actuator.stuck_share),
        ("actuator.offset_deg", actuator.offset_deg),
        ("actuator.scale_error_relative", actuator.scale_error_relative),
        ("actuator.hysteresis_deg", actuator.hysteresis_deg),
        ("actuator.drift_deg_per_sqrt_hour", actuator.drift_deg_per_sqrt_hour),
        ("actuator.jitter_deg", actuator.jitter_deg),
    ];
    let faults = faults.map(|(key, value)| (key, value.unwrap_or_default()));
    let consequence = format!("each mirror turns at once to the exact angle, so rates are higher; {advice}");
    without_faults("the model of slow or faulty mirrors", &faults, of, consequence)
}

/// As [`exact_mirrors`], for late, noisy or lost reports.
fn exact_reports(Scenario { streams, .. }: &Scenario, of: &str, advice: &str) -> Option<Condition> {
    let Streams { positions, channel, .. } = streams;
    let faults = [
        ("streams.positions.latency_ms", positions.latency_ms),
        ("streams.positions.noise_m", positions.noise_m),
        ("streams.positions.velocity_noise_m_s", positions.velocity_noise_m_s),
        ("streams.positions.loss", positions.loss),
        ("streams.channel.latency_ms", channel.latency_ms),
        ("streams.channel.noise_relative", channel.noise_relative),
        ("streams.channel.noise_gain", channel.noise_gain),
        ("streams.channel.resolution_bits", f64::from(channel.resolution_bits)),
        ("streams.channel.loss", channel.loss),
    ];
    let consequence = format!("policies know the true state, so rates are higher; {advice}");
    without_faults("the model of late, noisy and lost reports", &faults, of, consequence)
}

/// The condition that a model has no effect, where a key of it with its value is above zero.
fn without_faults(model: &str, faults: &[(&str, f64)], of: &str, consequence: String) -> Option<Condition> {
    let keys: Vec<&str> = faults.iter().filter(|(_, value)| *value > 0.0).map(|(key, _)| *key).collect();
    let because = format!("{of}, and {}", keys.join(", "));
    (!keys.is_empty()).then(|| Condition { method: model.into(), because, consequence })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn overrides_of_reports_belief_and_moving_mirrors_are_refused_by_key() {
        let of = |text: &str| check_overrides([text]).map_err(|error| error.to_string());
        for text in ["actuator.stuck_share=1", "streams.positions.latency_ms = 5", "control.belief=none", "streams={}"]
        {
            let key = text.split('=').next().unwrap_or_default().trim();
            assert!(
                of(text).is_err_and(|message| message.starts_with(key) && message.contains("--closed-loop")),
                "{text}"
            );
        }
        let refusal = of(r#"control={range_deg=30, belief="none"}"#).expect_err("no effect");
        assert!(refusal.starts_with("control.belief: no effect"), "{refusal}");
        for text in [
            "control={range_deg=30}",
            "users.count=3",
            "control.range_deg=30",
            "control.search_time_us=0",
            "seed=3",
            "mirrors.rows=2",
        ] {
            assert_eq!(of(text), Ok(()), "{text}");
        }
    }

    #[test]
    fn training_names_no_closed_loop() {
        let refusal = check_training(["actuator.stuck_share=1"]).expect_err("no effect").to_string();
        assert!(refusal.starts_with("actuator.stuck_share: no effect on training"), "{refusal}");
        assert!(!refusal.contains("--closed-loop"), "{refusal}");
    }

    #[test]
    fn faults_of_mirrors_that_are_set_above_zero_are_a_condition() {
        let of = |text: &str| {
            let scenario = Scenario::from_toml(text).expect("a room");
            exact_mirrors(&scenario, "training", "measure it").map(|condition| condition.to_string())
        };
        let found = of("[actuator]\nstuck_share = 0.5\noffset_deg = 0.0\n").expect("a condition");
        assert!(found.contains("training, and actuator.stuck_share: ") && found.ends_with("; measure it"), "{found}");
        let found = of("[actuator]\nprofile = \"servo\"\ndelay_ms = 40.0\nresolution_bits = 0\n").expect("a condition");
        assert!(found.contains("training, and actuator.profile, actuator.delay_ms: "), "{found}");
        assert_eq!([of(""), of("[actuator]\nprofile = \"mems\"\n")], [None, None]);
    }

    #[test]
    fn late_noisy_and_lost_reports_and_a_small_range_of_the_controller_are_conditions() {
        let of = |text: &str| {
            let scenario = Scenario::from_toml(text).expect("a room");
            conditions(&scenario, "a static comparison", "measure it")
                .expect("a channel")
                .iter()
                .map(Condition::to_string)
                .collect::<Vec<_>>()
        };
        let found =
            of("[actuator]\nstuck_share = 0.5\n[streams.positions]\nloss = 0.1\n[streams.channel]\nlatency_ms = 5.0\n");
        assert!(found[0].contains("and streams.positions.loss, streams.channel.latency_ms: "), "{found:?}");
        assert!(found.len() == 2 && found[1].contains("and actuator.stuck_share: "), "{found:?}");
        assert_eq!(of(""), Vec::<String>::new());
        let found = of("[control]\nrange_deg = 12.0\n[actuator]\nrange_deg = 5.0\n");
        let coarse = of("[streams.channel]\nresolution_bits = 4\nfull_scale_gain = 2e-6\n");
        assert!(coarse.len() == 1 && coarse[0].contains("and streams.channel.resolution_bits: "), "{coarse:?}");
        let seats = of("[users]\nseats_m = [[1.0, 1.0]]\n");
        assert!(seats.len() == 1 && seats[0].starts_with("users.seats_m does not apply: "), "{seats:?}");
        let range = "control.range_deg = 12.0, within which mirrors reach 91 % of the floor: ";
        assert!(found.len() == 1 && found[0].contains(range), "{found:?}");
    }
}
