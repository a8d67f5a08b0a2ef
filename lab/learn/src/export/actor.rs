//! The exported actor of the learners with one weight per user. The scaling of the features is in
//! the weights of the first layer.

use candle_core::Result;
use heliostat_core::observation::Summary;
use heliostat_core::policy::actor_file::{ActionKind, ObservationKind};

use super::dense::{self, Column, Form, Tail};
use crate::environment::features::{FEATURES, Layout};
use crate::networks::actor::{ACTOR_INPUTS, Actor};
use crate::networks::layers::Encoder;

/// Index of ln(1 + amplitude) among the inputs of the actor's network.
const AMPLITUDE: usize = FEATURES + 1;

/// Writes an actor as an ONNX file with the given metadata. A network that is applied to each user
/// reads one row for each, and serves any array and any number of users; a network over all slots
/// reads the observation vector.
///
/// # Errors
/// Errors of candle, when a parameter cannot be read.
pub fn export(actor: &Actor, metadata: &[(String, String)]) -> Result<Vec<u8>> {
    let of_user = columns(&actor.layout);
    let (observation, columns) = match actor.network.shape().encoder {
        Encoder::PerUser => (ObservationKind::Users, of_user),
        Encoder::Mlp => (ObservationKind::Flat, columns_of_vector(&actor.layout, &of_user)),
    };
    let form = Form { observation, action: ActionKind::Weights(actor.head), columns: &columns, metadata };
    dense::export(&actor.network, &form, Tail::Tanh(1.0))
}

/// The inputs of the network of one user that each column of the summary gives.
fn columns(layout: &Layout) -> Vec<Column> {
    let mut columns = vec![Vec::new(); Summary::COLUMNS];
    for (input, (column, factor)) in layout.sources().into_iter().enumerate() {
        columns[column].push((input, factor));
    }
    // The amplitude under actions of zero is that of the balanced weights.
    columns[Summary::LogBalanced as usize].push((AMPLITUDE, 1.0));
    columns
}

/// The inputs of the network of all slots that each value of the observation vector gives.
fn columns_of_vector(layout: &Layout, of_user: &[Column]) -> Vec<Column> {
    let mut columns = vec![Vec::new(); layout.encoder.len()];
    for (index, column) in of_user.iter().enumerate() {
        for (slot, place) in layout.encoder.column(index).enumerate() {
            columns[place] = column.iter().map(|(input, factor)| (slot * ACTOR_INPUTS + input, *factor)).collect();
        }
    }
    columns
}
