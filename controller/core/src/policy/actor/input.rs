//! Fills the input of a network from an observation, by the observation kind of its file.

use heliostat_channel::ChannelModel;
use heliostat_proto::MAX_USERS;
use heliostat_scenario::Scenario;

use crate::{
    observe::{
        angle_state::AngleState,
        codeword_state::CodewordState,
        observation::{EncodeError, Observation, ObservationEncoder, Summary},
        selection::Selection,
        target_user::{Cells, TargetUser},
    },
    policy::{
        actor_file::{ActorInfo, ObservationKind},
        codewords::coordinates,
        engine::Network,
        proposal::PolicyResult,
        weights::Seen,
    },
};

/// The encoder of one actor; its buffers are reused.
pub struct Input {
    kind: Kind,
    /// The layout of the vector; with one slot for each user where the network has one row for each.
    encoder: ObservationEncoder,
    /// The users in the slots, which later choices depend on.
    pub selection: Selection,
    /// Index in the observation of each slot's user.
    chosen: Vec<usize>,
    /// The observation vector.
    vector: Vec<f32>,
}

enum Kind {
    Flat,
    Users,
    Paper(AngleState),
    Codewords(CodewordState, Vec<[f32; 2]>),
    Cell(TargetUser, Cells),
}

impl Input {
    /// The encoder for the file of an actor in a room.
    pub fn new(info: &ActorInfo, scenario: &Scenario) -> Self {
        let kind = match info.observation {
            ObservationKind::Flat => Kind::Flat,
            ObservationKind::Users => Kind::Users,
            ObservationKind::Paper => {
                let has_angles = info.columns != AngleState::of(scenario, false).inputs();
                Kind::Paper(AngleState::of(scenario, has_angles))
            }
            ObservationKind::Codewords => {
                Kind::Codewords(CodewordState::of(scenario), coordinates(scenario.channel.mode))
            }
            ObservationKind::Cell => Kind::Cell(TargetUser::of(scenario), Cells::of(scenario, info.columns.isqrt())),
        };
        let encoder = ObservationEncoder::new(info.users_max, scenario.mirror_count());
        Self {
            vector: vec![0.0; encoder.len()],
            selection: Selection::new(encoder.users_max()),
            chosen: Vec::with_capacity(MAX_USERS),
            encoder,
            kind,
        }
    }

    /// The largest number of rows of the network.
    pub fn rows_max(&self) -> usize {
        match &self.kind {
            Kind::Users => MAX_USERS,
            Kind::Codewords(_, coordinates) => coordinates.len(),
            Kind::Flat | Kind::Paper(_) | Kind::Cell(..) => 1,
        }
    }

    /// Writes the input of a network. Does not allocate up to the largest number of users so far.
    ///
    /// # Errors
    /// The observation does not fit the file.
    pub fn encode(
        &mut self,
        model: &ChannelModel,
        observation: &Observation,
        network: &mut dyn Network,
    ) -> PolicyResult {
        self.chosen.clear();
        if matches!(self.kind, Kind::Users) {
            let (users, capacity) = (observation.users(), self.selection.users_max());
            if users > capacity {
                return Err(EncodeError::Users { users, capacity }.into());
            }
            self.encoder = ObservationEncoder::new(users, self.encoder.mirrors());
            self.vector.resize(self.encoder.len(), 0.0);
            self.chosen.extend(0..users);
        } else {
            self.chosen.extend_from_slice(self.selection.choose(observation));
        }
        self.encoder.encode_users(model, observation, self.chosen.iter().copied(), &mut self.vector)?;
        network.set_rows(if matches!(self.kind, Kind::Users) { self.chosen.len() } else { self.rows_max() })?;
        self.write(network.input_mut());
        Ok(())
    }

    /// The observation in which the network's outputs are actions.
    pub fn seen<'a>(&'a self, observation: &'a Observation) -> Seen<'a> {
        Seen { observation, chosen: &self.chosen, encoder: self.encoder, vector: &self.vector }
    }

    /// Writes the rows of the network from the vector.
    fn write(&self, out: &mut [f32]) {
        match &self.kind {
            Kind::Flat => out.copy_from_slice(&self.vector),
            Kind::Users => {
                let (rows, _) = out.as_chunks_mut::<{ Summary::COLUMNS }>();
                for column in 0..Summary::COLUMNS {
                    let values = &self.vector[self.encoder.column(column)];
                    rows.iter_mut().zip(values).for_each(|(row, value)| row[column] = *value);
                }
            }
            Kind::Paper(state) => state.write(&self.vector, out),
            Kind::Codewords(state, coordinates) => {
                let (inputs, columns) = (state.inputs(), out.len() / coordinates.len());
                for (row, position) in out.chunks_exact_mut(columns).zip(coordinates) {
                    row[inputs..].copy_from_slice(position);
                }
                state.write(&self.vector, &mut out[..inputs]);
                for row in 1..coordinates.len() {
                    out.copy_within(..inputs, row * columns);
                }
            }
            Kind::Cell(target_user, cells) => {
                out.fill(0.0);
                out[cells.cell(target_user.position(&self.vector))] = 1.0;
            }
        }
    }
}
