//! Changes that an operator orders in a running simulated room: valid parts are applied, the others
//! refused with a specific error.

use heliostat_proto::{FaultKind, MirrorFault, SimulatorControl};
use thiserror::Error;

use crate::mirrors::fault::{AxisFault, drawn_share};
use crate::room::SimulatedRoom;
use crate::world::mobility::MobilityError;

/// Why a part of an order is refused.
#[derive(Debug, Error)]
pub enum OrderRefusal {
    /// More users than the room has.
    #[error("forced_users {found} is too large: expected at most {present}, the users in the room")]
    Users {
        /// Users whose direct path was to be off.
        found: u32,
        /// Users in the room.
        present: usize,
    },
    /// A power that is not positive.
    #[error("invalid transmitted power {found} W: expected more than 0 W")]
    Power {
        /// The power in W.
        found: f32,
    },
    /// Speeds that are not valid.
    #[error(transparent)]
    Speed(#[from] MobilityError),
    /// A mirror that does not exist.
    #[error("unknown mirror {found} in a fault: expected 0 to {last}")]
    Mirror {
        /// The index.
        found: u32,
        /// The highest index of the array.
        last: usize,
    },
    /// In lockstep the same seed must give the same run.
    #[error("a room in lockstep accepts no orders, because its seed determines the run: start it without --lockstep")]
    Lockstep,
}

impl OrderRefusal {
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

/// Applies an order; returns the parts that were refused.
pub fn apply(room: &mut SimulatedRoom, order: &SimulatorControl) -> Vec<OrderRefusal> {
    let mut refused = Vec::new();
    if let Some(found) = order.forced_users {
        let present = room.world().users().len();
        match usize::try_from(found) {
            Ok(users) if users <= present => room.world_mut().set_forced(users),
            _ => refused.push(OrderRefusal::Users { found, present }),
        }
    }
    if let Some(found) = order.power_w
        && !room.world_mut().set_power(f64::from(found))
    {
        refused.push(OrderRefusal::Power { found });
    }
    if let Some([min, max]) = order.speed_m_s {
        refused.extend(room.world_mut().set_speed(f64::from(min), f64::from(max)).err().map(OrderRefusal::Speed));
    }
    for fault in &order.faults {
        refused.extend(apply_fault(room, fault).err());
    }
    refused
}

/// Applies one fault to its mirrors.
fn apply_fault(room: &mut SimulatedRoom, fault: &MirrorFault) -> Result<(), OrderRefusal> {
    let mirrors = room.angles().roll.len();
    if let Some(found) = fault.mirrors.iter().copied().find(|index| *index as usize >= mirrors) {
        return Err(OrderRefusal::Mirror { found, last: mirrors - 1 });
    }
    let seconds = f64::from(fault.seconds);
    let actuator = room.actuator_mut();
    match fault.fault {
        FaultKind::Offline => actuator.go_offline(seconds),
        FaultKind::Late => actuator.set_delay_fault(seconds),
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

/// The mirrors of a fault: those listed, or else a share drawn without repetition.
fn selected(fault: &MirrorFault, mirrors: usize) -> Vec<usize> {
    if !fault.mirrors.is_empty() {
        return fault.mirrors.iter().map(|index| *index as usize).collect();
    }
    drawn_share(f64::from(fault.share), fault.seed, mirrors)
}

#[cfg(test)]
mod tests {
    use super::*;
    use heliostat_scenario::Scenario;

    fn room() -> SimulatedRoom {
        SimulatedRoom::new(&Scenario::builtin("specular").unwrap(), None, 1).unwrap()
    }

    fn names(refused: &[OrderRefusal]) -> Vec<&'static str> {
        refused.iter().map(OrderRefusal::name).collect()
    }

    #[test]
    fn valid_parts_are_applied_and_the_others_refused_by_name() {
        let mut room = room();
        let valid = SimulatorControl {
            forced_users: Some(3),
            power_w: Some(1.5),
            speed_m_s: Some([0.5, 1.0]),
            ..SimulatorControl::default()
        };
        assert!(apply(&mut room, &valid).is_empty());
        assert_eq!(room.world().forced().iter().filter(|forced| **forced).count(), 3);
        assert_eq!(room.world().model().budget.power_w, 1.5);
        assert_eq!(room.world().speeds_m_s(), [0.5, 1.0]);
        let unknown_mirror = MirrorFault { mirrors: vec![3, 100], ..MirrorFault::default() };
        let invalid = SimulatorControl {
            forced_users: Some(6),
            power_w: Some(0.0),
            speed_m_s: Some([0.0, 1.0]),
            faults: vec![unknown_mirror],
            ..SimulatorControl::default()
        };
        assert_eq!(names(&apply(&mut room, &invalid)), ["users", "power", "speed", "mirror"]);
        assert_eq!(room.world().forced().iter().filter(|forced| **forced).count(), 3);
        assert_eq!((room.world().model().budget.power_w, room.world().speeds_m_s()), (1.5, [0.5, 1.0]));
    }

    #[test]
    fn a_fault_without_a_list_has_a_drawn_share_of_the_mirrors() {
        let fault = MirrorFault { share: 0.3, seed: 3, ..MirrorFault::default() };
        assert_eq!(selected(&fault, 100), drawn_share(f64::from(0.3_f32), 3, 100));
        let scenario = Scenario::builtin("specular").unwrap();
        let scenario = scenario.with_overrides(&["actuator.stuck_share=0.3".into()]).unwrap();
        assert_eq!(SimulatedRoom::new(&scenario, None, 1).unwrap().actuator().faulty_mirrors(), 30);
    }

    #[test]
    fn faults_apply_to_their_axes_and_can_be_healed() {
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
