//! The effect of a calibration: the sum rate of the same decisions on the same states, with the
//! mounting of the mirrors.

use heliostat_array::Kit;
use heliostat_array::calibration_file::CalibrationFile;
use heliostat_array::moment::Moment;
use heliostat_channel::MirrorAngles;
use heliostat_proto::{MirrorCommand, Stamp};
use heliostat_room::World;
use heliostat_room::mirrors::SimulatedMirrors;
use heliostat_scenario::Scenario;

use crate::comparison::{EvaluatedPolicy, evaluator::Evaluator};
use crate::evaluation::held_out::held_out_world;

/// Time from a command to the evaluation of the mirrors in ns, longer than a servo needs.
const SETTLED_NS: u64 = 2_000_000_000;

/// Validity of a command in ms: longer than that time.
const VALIDITY_MS: u32 = 3000;

/// States of a room, and the angles that a policy commands in each.
pub struct Evaluation {
    states: Vec<(World, MirrorAngles)>,
    evaluator: Evaluator,
}

impl Evaluation {
    /// `count` held-out states of one set.
    ///
    /// # Errors
    /// The scenario describes no room, or the policy cannot be built for it.
    pub fn new(scenario: &Scenario, evaluated: &EvaluatedPolicy, set: u64, count: usize) -> anyhow::Result<Self> {
        let trace = scenario.read_trace()?;
        let state = |index: usize| {
            let world = held_out_world(scenario, trace.as_deref(), set, index as u64)?;
            let angles = evaluated.angles(scenario, &world)?;
            anyhow::Ok((world, angles))
        };
        let states = (0..count).map(state).collect::<anyhow::Result<_>>()?;
        Ok(Self { states, evaluator: Evaluator::new(scenario.channel_model()?, scenario.min_rate_bps()) })
    }

    /// Mean sum rate in Mbit/s with the array of a scenario with one array, as its index in its
    /// room and a seed mount it, with or without corrections.
    ///
    /// # Errors
    /// The array refuses the corrections or a command.
    pub fn sum_rate_mbps(
        &mut self,
        scenario: &Scenario,
        (index, seed): (usize, u64),
        corrections: Option<&CalibrationFile>,
    ) -> anyhow::Result<f64> {
        let array = &self.evaluator.model().mirrors.arrays()[0];
        let mirrors = SimulatedMirrors::new(&scenario.actuator, array, seed, index as u32);
        let mut kit = Kit::new(mirrors);
        let mut now_ns = SETTLED_NS;
        kit.advance(Moment::simulated(now_ns));
        if let Some(corrections) = corrections {
            kit.handle_calibration(
                Moment::simulated(now_ns),
                &corrections.message(Stamp { sequence: 1, ..Stamp::default() }),
            )?;
        }
        let mut sum = 0.0;
        for (index, (world, angles)) in self.states.iter().enumerate() {
            let narrowed = |list: &[f64]| list.iter().map(|angle| *angle as f32).collect();
            let command = MirrorCommand {
                epoch: 1,
                sequence: index as u64 + 1,
                time_ns: now_ns,
                validity_ms: VALIDITY_MS,
                roll: narrowed(&angles.roll),
                yaw: narrowed(&angles.yaw),
                ..MirrorCommand::default()
            };
            kit.handle_command(Moment::simulated(now_ns), &command)?;
            now_ns += SETTLED_NS;
            kit.device_mut().advance(now_ns);
            sum += self.evaluator.evaluate(world.scene(), kit.device().actuator().angles()).sum_rate_mbps;
        }
        Ok(sum / self.states.len() as f64)
    }
}
