//! Changes that an operator orders in a running simulated room: valid parts are applied, the others
//! refused with a specific error.

use std::ops::RangeInclusive;

use heliostat_proto::{FaultKind, MirrorFault, SimulatorControl};
use heliostat_scenario::{POWER_W, SPEED_M_S};
use thiserror::Error;

use crate::mirrors::actuator::Actuator;
use crate::mirrors::fault::{AxisFault, drawn_share};
use crate::room::SimulatedRoom;

/// Time in s for which an array can be offline or restart.
const OUTAGE_S: RangeInclusive<f64> = 0.0..=3600.0;
/// Additional delay of commands in s, as long as the longest delay of an actuator.
const DELAY_S: RangeInclusive<f64> = 0.0..=10.0;

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
    /// A power outside its domain.
    #[error("invalid transmitted power {found} W: expected {} to {} W", POWER_W.start(), POWER_W.end())]
    Power {
        /// The power in W.
        found: f32,
    },
    /// Speeds outside their domain.
    #[error(
        "invalid speeds {min} to {max} m/s: expected {} to {} m/s, the minimum first, or both 0 for users who stand still",
        SPEED_M_S.start(), SPEED_M_S.end()
    )]
    Speed {
        /// Minimum speed in m/s.
        min: f32,
        /// Maximum speed in m/s.
        max: f32,
    },
    /// A duration outside its domain.
    #[error(
        "invalid duration {found} s of the fault {}: expected {} to {} s",
        fault.name(), expected.start(), expected.end()
    )]
    Duration {
        /// The fault.
        fault: FaultKind,
        /// The duration in s.
        found: f32,
        /// The durations of such a fault in s.
        expected: RangeInclusive<f64>,
    },
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
            Self::Speed { .. } => "speed",
            Self::Duration { .. } => "duration",
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
        && !(within(&POWER_W, found) && room.world_mut().set_power(f64::from(found)))
    {
        refused.push(OrderRefusal::Power { found });
    }
    if let Some([min, max]) = order.speed_m_s {
        let walking = within(&SPEED_M_S, min) && within(&SPEED_M_S, max);
        let valid = walking || [min, max] == [0.0, 0.0];
        if !valid || room.world_mut().set_speed(f64::from(min), f64::from(max)).is_err() {
            refused.push(OrderRefusal::Speed { min, max });
        }
    }
    for fault in &order.faults {
        refused.extend(apply_fault(room, fault).err());
    }
    refused
}

/// Applies one fault to its mirrors, which have the index of the room.
fn apply_fault(room: &mut SimulatedRoom, fault: &MirrorFault) -> Result<(), OrderRefusal> {
    let mirrors = room.angles().roll.len();
    if let Some(found) = fault.mirrors.iter().copied().find(|index| *index as usize >= mirrors) {
        return Err(OrderRefusal::Mirror { found, last: mirrors - 1 });
    }
    let selected = selected(fault, mirrors);
    let seconds = match fault.fault {
        FaultKind::Offline | FaultKind::Reboot => duration_s(fault, OUTAGE_S)?,
        FaultKind::Late => duration_s(fault, DELAY_S)?,
        _ => 0.0,
    };
    let ranges: Vec<_> = room.world().model().mirrors.ranges().map(|(_, mirrors)| mirrors).collect();
    for (array, mirrors) in ranges.into_iter().enumerate() {
        let own = selected.iter().filter(|mirror| mirrors.contains(mirror)).map(|mirror| mirror - mirrors.start);
        apply_to_array(room.actuator_mut(array), fault.fault, seconds, &own.collect::<Vec<_>>());
    }
    Ok(())
}

/// Applies a fault to some mirrors of an array, or to all of it.
fn apply_to_array(actuator: &mut Actuator, fault: FaultKind, seconds: f64, mirrors: &[usize]) {
    match fault {
        FaultKind::Offline => actuator.go_offline(seconds),
        FaultKind::Late => actuator.set_delay_fault(seconds),
        FaultKind::Reboot => actuator.reboot(seconds),
        FaultKind::Stuck => actuator.set_faults(mirrors, |_| (AxisFault::Stuck, AxisFault::Stuck)),
        FaultKind::DeadRoll => actuator.set_faults(mirrors, |(_, yaw)| (AxisFault::Dead, yaw)),
        FaultKind::DeadYaw => actuator.set_faults(mirrors, |(roll, _)| (roll, AxisFault::Dead)),
        FaultKind::FlippedRoll => actuator.set_faults(mirrors, |(_, yaw)| (AxisFault::Flipped, yaw)),
        FaultKind::FlippedYaw => actuator.set_faults(mirrors, |(roll, _)| (roll, AxisFault::Flipped)),
        FaultKind::Healed => actuator.set_faults(mirrors, |_| (AxisFault::None, AxisFault::None)),
    }
}

/// The duration of a fault in s.
fn duration_s(fault: &MirrorFault, expected: RangeInclusive<f64>) -> Result<f64, OrderRefusal> {
    let found = fault.seconds;
    let refusal = OrderRefusal::Duration { fault: fault.fault, found, expected: expected.clone() };
    within(&expected, found).then_some(f64::from(found)).ok_or(refusal)
}

/// Whether a number of a message lies in a domain. The ends are rounded as the number is.
fn within(domain: &RangeInclusive<f64>, found: f32) -> bool {
    (*domain.start() as f32..=*domain.end() as f32).contains(&found)
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
    fn values_outside_their_domain_are_refused_and_the_other_fields_are_applied() {
        let late = |seconds| MirrorFault { fault: FaultKind::Late, seconds, ..MirrorFault::default() };
        let reboot = |seconds| MirrorFault { fault: FaultKind::Reboot, seconds, ..MirrorFault::default() };
        let order = |power_w, speed_m_s, faults| SimulatorControl {
            forced_users: Some(1),
            power_w: Some(power_w),
            speed_m_s: Some(speed_m_s),
            faults,
            ..SimulatorControl::default()
        };
        let domain = order(0.01, [0.001, 50.0], vec![late(10.0), reboot(3600.0)]);
        assert!(apply(&mut room(), &domain).is_empty());
        for beyond in [
            order(3e38, [1.0, 1e9], vec![late(10.1), reboot(1e30)]),
            order(10_001.0, [1e-30, 1.0], vec![late(f32::MAX), reboot(3601.0)]),
        ] {
            let mut room = room();
            assert_eq!(names(&apply(&mut room, &beyond)), ["power", "speed", "duration", "duration"]);
            assert_eq!(room.world().forced().iter().filter(|forced| **forced).count(), 1);
            assert!(!room.actuator(0).is_offline());
        }
    }

    #[test]
    fn a_fault_without_a_list_has_a_drawn_share_of_the_mirrors() {
        let fault = MirrorFault { share: 0.3, seed: 3, ..MirrorFault::default() };
        assert_eq!(selected(&fault, 100), drawn_share(f64::from(0.3_f32), 3, 100));
        let scenario = Scenario::builtin("specular").unwrap();
        let scenario = scenario.with_overrides(&["actuator.stuck_share=0.3"]).unwrap();
        assert_eq!(SimulatedRoom::new(&scenario, None, 1).unwrap().faulty_mirrors(), 30);
    }

    #[test]
    fn faults_apply_to_their_axes_and_can_be_healed() {
        let mut room = room();
        let mut order = |fault, mirrors: &[u32]| {
            let fault = MirrorFault { fault, mirrors: mirrors.to_vec(), ..MirrorFault::default() };
            assert!(apply(&mut room, &SimulatorControl { faults: vec![fault], ..Default::default() }).is_empty());
            (room.actuator(0).fault(1), room.faulty_mirrors())
        };
        assert_eq!(order(FaultKind::DeadRoll, &[1]), ((AxisFault::Dead, AxisFault::None), 1));
        assert_eq!(order(FaultKind::FlippedYaw, &[1, 2]), ((AxisFault::Dead, AxisFault::Flipped), 2));
        assert_eq!(order(FaultKind::Stuck, &[1]), ((AxisFault::Stuck, AxisFault::Stuck), 2));
        assert_eq!(order(FaultKind::Healed, &[1, 2]), ((AxisFault::None, AxisFault::None), 0));
    }
}
