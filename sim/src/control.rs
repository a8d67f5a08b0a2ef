//! Changes that an operator orders of a running simulated room: what is sound is applied, the rest refused by name.

use heliostat_proto::{FaultKind, MirrorFault, SimulatorControl};
use thiserror::Error;

use crate::actuator::AxisFault;
use crate::mobility::MobilityError;
use crate::random::{self, Purpose};
use crate::room::SimulatedRoom;

/// Why a part of an order is not followed.
#[derive(Debug, Error)]
pub enum Refusal {
    /// More users than there are.
    #[error("{found} users were to be forced into shadow: the room has {present}")]
    Users {
        /// Users wanted in shadow.
        found: u32,
        /// Users in the room.
        present: usize,
    },
    /// No power at all.
    #[error("a transmitted power of {found} W: wanted more than 0 W")]
    Power {
        /// The power in W.
        found: f32,
    },
    /// Speeds that no walk has.
    #[error(transparent)]
    Speed(#[from] MobilityError),
    /// A mirror that does not exist.
    #[error("a fault of mirror {found}: the array has mirrors 0 to {last}")]
    Mirror {
        /// The index.
        found: u32,
        /// The highest that there is.
        last: usize,
    },
    /// Time is not real in lockstep: the same seed has to give the same run.
    #[error("a room in lockstep takes no orders: its seed decides all of the run")]
    Lockstep,
}

impl Refusal {
    /// The name under which it is counted.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Users { .. } => "users",
            Self::Power { .. } => "power",
            Self::Speed(_) => "speed",
            Self::Mirror { .. } => "mirror",
            Self::Lockstep => "lockstep",
        }
    }
}

/// Applies an order; gives what of it was refused.
pub fn apply(room: &mut SimulatedRoom, order: &SimulatorControl) -> Vec<Refusal> {
    let mut refused = Vec::new();
    if let Some(found) = order.forced_users {
        let present = room.world().users().len();
        match usize::try_from(found) {
            Ok(users) if users <= present => room.world_mut().set_forced(users),
            _ => refused.push(Refusal::Users { found, present }),
        }
    }
    if let Some(found) = order.power_w
        && !room.world_mut().set_power(f64::from(found))
    {
        refused.push(Refusal::Power { found });
    }
    if let Some([min, max]) = order.speed_m_s {
        refused.extend(room.world_mut().set_speed(f64::from(min), f64::from(max)).err().map(Refusal::Speed));
    }
    for fault in &order.faults {
        refused.extend(befall(room, fault).err());
    }
    refused
}

/// Lets one fault befall the mirrors.
fn befall(room: &mut SimulatedRoom, fault: &MirrorFault) -> Result<(), Refusal> {
    let mirrors = room.angles().roll.len();
    if let Some(found) = fault.mirrors.iter().copied().find(|index| *index as usize >= mirrors) {
        return Err(Refusal::Mirror { found, last: mirrors - 1 });
    }
    let seconds = f64::from(fault.seconds);
    let actuator = room.actuator_mut();
    match fault.fault {
        FaultKind::Offline => actuator.go_offline(seconds),
        FaultKind::Late => actuator.set_lateness(seconds),
        FaultKind::Reboot => actuator.reboot(seconds),
        of_axes => {
            for mirror in selected(fault, mirrors) {
                let (roll, yaw) = actuator.fault(mirror);
                let (roll, yaw) = match of_axes {
                    FaultKind::Stuck => (AxisFault::Stuck, AxisFault::Stuck),
                    FaultKind::DeadRoll => (AxisFault::Dead, yaw),
                    FaultKind::DeadYaw => (roll, AxisFault::Dead),
                    FaultKind::FlippedRoll => (AxisFault::Flipped, yaw),
                    FaultKind::FlippedYaw => (roll, AxisFault::Flipped),
                    _ => (AxisFault::None, AxisFault::None),
                };
                actuator.set_fault(mirror, roll, yaw);
            }
        }
    }
    Ok(())
}

/// The mirrors that a fault is about: those listed, or else a share drawn without repetition.
fn selected(fault: &MirrorFault, mirrors: usize) -> Vec<usize> {
    if !fault.mirrors.is_empty() {
        return fault.mirrors.iter().map(|index| *index as usize).collect();
    }
    drawn_share(f64::from(fault.share), fault.seed, mirrors)
}

/// A share of the mirrors, drawn without repetition.
pub(crate) fn drawn_share(share: f64, seed: u64, mirrors: usize) -> Vec<usize> {
    let mut rng = random::stream(seed, Purpose::Faults, 0);
    let mut order: Vec<usize> = (0..mirrors).collect();
    let count = (share * mirrors as f64).round() as usize;
    for place in 0..count {
        let other = place + (random::uniform(&mut rng) * (mirrors - place) as f64) as usize;
        order.swap(place, other);
    }
    order.truncate(count);
    order
}

#[cfg(test)]
mod tests {
    use super::*;
    use heliostat_scenario::Scenario;

    fn room() -> SimulatedRoom {
        SimulatedRoom::new(&Scenario::builtin("specular").unwrap(), None, 1).unwrap()
    }

    fn names(refused: &[Refusal]) -> Vec<&'static str> {
        refused.iter().map(Refusal::name).collect()
    }

    #[test]
    fn what_is_sound_is_applied_and_the_rest_named() {
        let mut room = room();
        let sound = SimulatorControl {
            forced_users: Some(3),
            power_w: Some(1.5),
            speed_m_s: Some([0.5, 1.0]),
            ..SimulatorControl::default()
        };
        assert!(apply(&mut room, &sound).is_empty());
        assert_eq!(room.world().forced().iter().filter(|forced| **forced).count(), 3);
        assert_eq!(room.world().model().budget.power_w, 1.5);
        assert_eq!(room.world().speeds_m_s(), [0.5, 1.0]);
        let stranger = MirrorFault { mirrors: vec![3, 100], ..MirrorFault::default() };
        let unsound = SimulatorControl {
            forced_users: Some(6),
            power_w: Some(0.0),
            speed_m_s: Some([0.0, 1.0]),
            faults: vec![stranger],
            ..SimulatorControl::default()
        };
        assert_eq!(names(&apply(&mut room, &unsound)), ["users", "power", "speed", "mirror"]);
        assert_eq!(room.world().forced().iter().filter(|forced| **forced).count(), 3);
        assert_eq!((room.world().model().budget.power_w, room.world().speeds_m_s()), (1.5, [0.5, 1.0]));
    }

    #[test]
    fn a_share_draws_as_many_mirrors_the_same_for_the_same_seed() {
        let draw = |share, seed| selected(&MirrorFault { share, seed, ..MirrorFault::default() }, 100);
        let mut all = draw(1.0, 3);
        all.sort_unstable();
        assert_eq!(all, (0..100).collect::<Vec<_>>());
        assert_eq!(draw(0.3, 3).len(), 30);
        assert_eq!(draw(0.3, 3), draw(0.3, 3));
        assert_ne!(draw(0.3, 3), draw(0.3, 4));
        assert_eq!(draw(0.0, 3), Vec::<usize>::new());
        let scenario = Scenario::builtin("specular").unwrap();
        let scenario = scenario.with_overrides(&["actuator.stuck_share=0.3".into()]).unwrap();
        assert_eq!(SimulatedRoom::new(&scenario, None, 1).unwrap().actuator().faulty_mirrors(), 30);
    }

    #[test]
    fn faults_befall_their_axes_and_are_healed() {
        let mut room = room();
        let mut order = |fault, mirrors: &[u32]| {
            let fault = MirrorFault { fault, mirrors: mirrors.to_vec(), ..MirrorFault::default() };
            assert!(apply(&mut room, &SimulatorControl { faults: vec![fault], ..Default::default() }).is_empty());
            (room.actuator().fault(1), room.actuator().faulty_mirrors())
        };
        assert_eq!(order(FaultKind::DeadRoll, &[1]), ((AxisFault::Dead, AxisFault::None), 1));
        assert_eq!(order(FaultKind::FlippedYaw, &[1, 2]), ((AxisFault::Dead, AxisFault::Flipped), 2));
        assert_eq!(order(FaultKind::Stuck, &[1]), ((AxisFault::Stuck, AxisFault::Stuck), 2));
        assert_eq!(order(FaultKind::Healed, &[1, 2]), ((AxisFault::None, AxisFault::None), 0));
    }
}
