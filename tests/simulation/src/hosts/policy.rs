//! The policy of a controller, which faults make fail.

use std::sync::Arc;
use std::sync::atomic::{AtomicU8, Ordering};

use heliostat_channel::{ChannelModel, MirrorAngles};
use heliostat_core::observation::Observation;
use heliostat_core::policy::{
    DenseEngine, Fixed, Policy, PolicyError, PolicyKind, PolicyMemory, PolicyResult, Resources, build,
};

use crate::plan::{PolicyChoice, PolicyFault};
use crate::room::Room;

/// The fault of a policy that its controller owns.
#[derive(Clone, Debug, Default)]
pub(crate) struct PolicySwitch(Arc<AtomicU8>);

impl PolicySwitch {
    /// Sets the fault that is in force.
    pub fn set(&self, fault: Option<PolicyFault>) {
        self.0.store(fault.map_or(0, |fault| fault as u8 + 1), Ordering::Relaxed);
    }
}

/// A policy with a switch.
struct Switched {
    policy: Box<dyn Policy>,
    switch: PolicySwitch,
}

impl Policy for Switched {
    fn name(&self) -> &str {
        self.policy.name()
    }

    fn act(&mut self, model: &ChannelModel, observation: &Observation, out: &mut MirrorAngles) -> PolicyResult {
        self.policy.act(model, observation, out)?;
        match self.switch.0.load(Ordering::Relaxed) {
            0 => Ok(()),
            fault if fault == PolicyFault::NotFinite as u8 + 1 => {
                out.roll[0] = f64::NAN;
                Ok(())
            }
            _ => Err(PolicyError::Inference { message: "a fault of the simulation".into() }),
        }
    }

    fn users_max(&self) -> usize {
        self.policy.users_max()
    }

    fn memory(&self) -> PolicyMemory {
        self.policy.memory()
    }

    fn restore(&mut self, memory: &PolicyMemory) {
        self.policy.restore(memory);
    }
}

/// The policy of a room, with a switch.
pub(crate) fn policy(room: &Room, switch: &PolicySwitch) -> Box<dyn Policy> {
    let resources = Resources { actor: None, engine: &DenseEngine, monotonic_ns: || 0 };
    let built = |kind| {
        build(kind, &room.scenario, &resources)
            .unwrap_or_else(|error| panic!("the policy {kind:?} cannot be built: {error}"))
    };
    let policy = match room.policy {
        PolicyChoice::Nearest => built(PolicyKind::Nearest),
        PolicyChoice::FixedPoint => built(PolicyKind::FixedPoint),
        PolicyChoice::Flat => Box::new(Fixed::flat(room.scenario.mirror_count())),
    };
    Box::new(Switched { policy, switch: switch.clone() })
}
