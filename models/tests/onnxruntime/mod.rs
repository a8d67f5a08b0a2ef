//! Graphs that only ONNX Runtime runs.

use heliostat_core::observation::ObservationEncoder;
use heliostat_core::policy::actor_file::{ANGLES, ActorFile, INPUT_NAME, room_entries};
use heliostat_onnx::graph::{Ends, Graph};
use heliostat_scenario::Scenario;

/// A graph that is not dense: one operator on 0.25 in each output.
pub struct Operator(&'static str);

/// The sine of 0.25.
pub const SIN: Operator = Operator("Sin");

impl Operator {
    /// The actor for a room.
    pub fn actor(&self, scenario: &Scenario) -> ActorFile {
        let (mirrors, users_max) = (scenario.mirror_count(), 4);
        let encoder = ObservationEncoder::new(users_max, mirrors);
        let mut graph = Graph::default();
        let weights = graph.constant("weights", &[encoder.len(), 2 * mirrors], &vec![0.0; encoder.len() * 2 * mirrors]);
        let product = graph.node("MatMul", &[INPUT_NAME, &weights]);
        let quarter = graph.scalar(0.25);
        let sum = graph.node("Add", &[&product, &quarter]);
        graph.node(self.0, &[&sum]);
        let ends = Ends { name: "test", input: (INPUT_NAME, encoder.len()), output: (ANGLES, 2 * mirrors) };
        ActorFile { origin: "sin.onnx".into(), bytes: graph.finish(&ends, &room_entries(scenario, users_max)).into() }
    }
}
