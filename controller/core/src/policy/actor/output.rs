//! Turns the output of a network into mirror angles, by the action kind of its file.

use heliostat_channel::{
    ChannelModel,
    mirrors::{MirrorAngles, copy_widened},
};
use heliostat_scenario::Scenario;

use crate::{
    output::safety::check_finite,
    policy::{
        actor_file::{ActionKind, ActorError, ActorInfo, ActorProblem},
        codewords::codewords,
        proposal::{PolicyError, PolicyResult},
        weights::{Head, Seen},
    },
};

/// The decoder of one actor; its buffers are reused.
pub enum Output {
    /// Angles of all mirrors.
    Angles,
    /// An action for each slot, and a buffer for the weights.
    Weights(Head, Vec<f64>),
    /// A value for each codeword.
    Codebook(Vec<MirrorAngles>),
}

impl Output {
    /// The decoder for the file of an actor in a room.
    ///
    /// # Errors
    /// The scenario describes no channel, so that it has no codebook.
    pub fn new(info: &ActorInfo, scenario: &Scenario) -> Result<Self, ActorError> {
        Ok(match info.action {
            ActionKind::Angles => Self::Angles,
            ActionKind::Weights(head) => Self::Weights(head, Vec::with_capacity(info.users_max)),
            ActionKind::Codebook => {
                let no_channel = |error: heliostat_channel::ChannelError| {
                    info.refused(ActorProblem::Engine { message: format!("the room has no codebook: {error}") })
                };
                let model = scenario.channel_model().map_err(no_channel)?;
                Self::Codebook(codewords(scenario, &model))
            }
        })
    }

    /// Writes the angles for the output of a network.
    ///
    /// # Errors
    /// The output has another length, or a value that is not finite.
    pub fn decode(
        &mut self,
        model: &ChannelModel,
        seen: Seen<'_>,
        values: &[f32],
        out: &mut MirrorAngles,
    ) -> PolicyResult {
        match self {
            Self::Angles => split_angles(values, out),
            Self::Weights(head, weights) => {
                check_output(values, seen.encoder.users_max())?;
                head.decode(model, seen, values, weights, out);
                Ok(())
            }
            Self::Codebook(codewords) => {
                check_output(values, codewords.len())?;
                let larger = |best: usize, next: usize| if values[next] > values[best] { next } else { best };
                out.copy_from(&codewords[(1..values.len()).fold(0, larger)]);
                Ok(())
            }
        }
    }
}

/// Roll of each mirror, then yaw of each.
pub fn split_angles(values: &[f32], out: &mut MirrorAngles) -> PolicyResult {
    let mirrors = out.roll.len();
    check_length(values, 2 * mirrors)?;
    copy_widened(&values[..mirrors], &mut out.roll);
    copy_widened(&values[mirrors..], &mut out.yaw);
    Ok(check_finite(out)?)
}

/// Checks the length, and that all values are finite: the decoder would hide one that is not.
fn check_output(values: &[f32], expected: usize) -> PolicyResult {
    check_length(values, expected)?;
    match values.iter().position(|value| !value.is_finite()) {
        None => Ok(()),
        Some(place) => Err(PolicyError::Inference {
            message: format!("output {place} of the network is {}, expected a finite value", values[place]),
        }),
    }
}

fn check_length(values: &[f32], expected: usize) -> PolicyResult {
    if values.len() == expected {
        return Ok(());
    }
    let message = format!("the output of the network has a length of {}, expected {expected}", values.len());
    Err(PolicyError::Inference { message })
}
