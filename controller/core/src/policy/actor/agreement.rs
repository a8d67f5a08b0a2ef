//! The comparison of two evaluations of one network when it is loaded.
//!
//! An engine can hide NaN or compute an operator differently. Two independent evaluations then
//! differ on some observations.

use heliostat_onnx::{ModelProto, reference::Reference};
use heliostat_scenario::Scenario;
use prost::Message;

use super::{
    Actor,
    samples::{self, TIME_MAX_NS},
};
use crate::{
    observe::observation::Observation,
    policy::{
        actor_file::{ActorError, ActorFile, INPUT_NAME},
        proposal::TimeSource,
    },
};

/// Observations on which two evaluations are compared.
const OBSERVATIONS: usize = 64;
/// Outputs that differ by less count as equal, in rad, or relative to outputs above 1: both
/// evaluations round to f32, in another order.
const SAME: f32 = 1e-4;

/// The outputs of another evaluation for an input, or why it gives none.
type Evaluate<'a> = dyn FnMut(&[f32]) -> Result<Vec<f32>, String> + 'a;

/// Another evaluation of the same network.
struct Other<'a> {
    name: &'static str,
    evaluate: &'a mut Evaluate<'a>,
}

impl Actor {
    /// Compares the outputs with those of the same file on another engine, on 64 observations.
    ///
    /// # Errors
    /// [`ActorError::EnginesDisagree`] with the first output that differs.
    pub fn check_agrees_with(
        &mut self,
        other: &mut Self,
        scenario: &Scenario,
        monotonic_ns: TimeSource,
    ) -> Result<(), ActorError> {
        let name = other.network.engine();
        let evaluate = &mut |input: &[f32]| {
            other.network.input_mut().copy_from_slice(input);
            other.network.run().map(<[f32]>::to_vec).map_err(|error| error.to_string())
        };
        self.check_agreement(Other { name, evaluate }, scenario, monotonic_ns)
    }

    /// Compares the outputs with those of the reference evaluation, on 64 observations; not at all
    /// where the reference does not evaluate the file.
    ///
    /// # Errors
    /// [`ActorError::EnginesDisagree`] with the first output that differs.
    pub fn check_agrees_with_reference(
        &mut self,
        file: &ActorFile,
        scenario: &Scenario,
        monotonic_ns: TimeSource,
    ) -> Result<(), ActorError> {
        let parsed = ModelProto::decode(file.bytes.as_ref()).map_err(|error| error.to_string());
        let Ok(reference) = parsed.and_then(|file| Reference::new(&file)) else { return Ok(()) };
        if reference.run(INPUT_NAME, self.network.input_mut()).is_err() {
            return Ok(());
        }
        let evaluate = &mut |input: &[f32]| reference.run(INPUT_NAME, input);
        self.check_agreement(Other { name: "reference", evaluate }, scenario, monotonic_ns)
    }

    fn check_agreement(
        &mut self,
        other: Other<'_>,
        scenario: &Scenario,
        monotonic_ns: TimeSource,
    ) -> Result<(), ActorError> {
        // A room without a channel is refused elsewhere.
        let Ok(model) = scenario.channel_model() else { return Ok(()) };
        let mut observation = Observation::new(&model, scenario.users.count);
        let started_ns = monotonic_ns();
        let mut input = Vec::new();
        let (mut compared, mut differing, mut example) = (0, 0, None);
        while compared < OBSERVATIONS && monotonic_ns().saturating_sub(started_ns) <= TIME_MAX_NS {
            samples::observe(scenario, &model, compared, &mut observation);
            if self.encoder.encode(&model, &observation, self.network.input_mut()).is_err() {
                break;
            }
            input.clear();
            input.extend_from_slice(self.network.input_mut());
            compared += 1;
            let found = self.network.run().map_err(|error| error.to_string());
            let difference = difference(found, (other.evaluate)(&input));
            differing += usize::from(difference.is_some());
            example = example.or(difference);
        }
        match example {
            None => Ok(()),
            Some(example) => {
                let (origin, engines) = (self.info.origin().to_owned(), [self.network.engine(), other.name]);
                Err(ActorError::EnginesDisagree { origin, engines, differing, compared, example })
            }
        }
    }
}

/// The first difference of two outputs, or of an output and a failure.
fn difference(found: Result<&[f32], String>, other: Result<Vec<f32>, String>) -> Option<String> {
    let (found, other) = match (found, other) {
        (Ok(found), Ok(other)) => (found, other),
        (Err(_), Err(_)) => return None,
        (Err(error), Ok(_)) | (Ok(_), Err(error)) => return Some(format!("one gives none: {error}")),
    };
    if found.len() != other.len() {
        return Some(format!("{} and {} outputs", found.len(), other.len()));
    }
    let differs = |(found, other): (&f32, &f32)| {
        let allowed = SAME * other.abs().max(1.0);
        found.is_finite() != other.is_finite() || (found - other).abs() > allowed
    };
    let place = found.iter().zip(&other).position(differs)?;
    Some(format!("output {place}: {} and {}", found[place], other[place]))
}

#[cfg(test)]
mod tests {
    use super::difference;

    #[test]
    fn values_lengths_and_failures_differ_and_rounding_does_not() {
        let of = |found: &[f32], other: &[f32]| difference(Ok(found), Ok(other.to_vec()));
        assert_eq!(of(&[0.5, 200.0], &[0.500_05, 200.01]), None);
        assert!(of(&[0.5, 0.5], &[0.5, 0.5002]).is_some_and(|text| text.contains("output 1")));
        assert!(of(&[f32::NAN], &[0.5]).is_some() && of(&[f32::INFINITY], &[1.0]).is_some());
        assert!(of(&[f32::NAN], &[f32::NAN]).is_none());
        assert!(of(&[0.5], &[0.5, 0.5]).is_some());
        assert!(difference(Err("lost".into()), Ok(vec![])).is_some_and(|text| text.contains("lost")));
    }
}
