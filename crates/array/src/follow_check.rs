//! Detection of mirrors that do not follow their commands: stuck, without drive, or turning in the
//! wrong direction.
//!
//! Only hardware that measures can be checked. An axis fails a check when its error is above the
//! tolerance and it has not approached its target since the previous check. An axis that fails
//! every check for longer than the timeout is unusable. An unusable axis recovers when its error
//! stays within tolerance for longer than the timeout. It must also be over two tolerances from the
//! angle where it failed.

use heliostat_channel::MirrorAngles;
use heliostat_proto::{AxisLimits, Capabilities};

/// Smallest tolerance in rad (half a degree): an aimed mirror then loses a fifth of its light.
const TOLERANCE_MIN_RAD: f64 = 0.5 * std::f64::consts::PI / 180.0;

/// Shortest timeout in ns.
const TIMEOUT_MIN_NS: u64 = 300_000_000;

/// Checks the mirrors of an array, measurement by measurement.
#[derive(Clone, Debug)]
pub(crate) struct FollowCheck {
    tolerance_rad: f64,
    timeout_ns: u64,
    /// Roll of every mirror, then yaw of every mirror.
    axes: Vec<Axis>,
}

#[derive(Clone, Copy, Debug, Default)]
struct Axis {
    commanded: f64,
    measured: f64,
    /// Start of the current run of checks that could change the state.
    since_ns: Option<u64>,
    /// The angle at which it was found unusable.
    unusable_at: Option<f64>,
}

impl FollowCheck {
    pub fn new(capabilities: &Capabilities) -> Self {
        let axes = [capabilities.roll, capabilities.yaw];
        let largest = |value: fn(&AxisLimits) -> f32| f64::from(axes.iter().map(value).fold(0.0, f32::max));
        let settling_ns = (4e9 * largest(|axis| axis.settling_s)) as u64;
        Self {
            tolerance_rad: TOLERANCE_MIN_RAD.max(4.0 * largest(|axis| axis.resolution_rad)),
            timeout_ns: TIMEOUT_MIN_NS + settling_ns,
            axes: vec![Axis::default(); 2 * capabilities.mirrors()],
        }
    }

    /// Compares the measured angles with the commanded ones.
    pub fn update(&mut self, now_ns: u64, commanded: &MirrorAngles, measured: &MirrorAngles) {
        let (tolerance_rad, timeout_ns) = (self.tolerance_rad, self.timeout_ns);
        for (axis, (&commanded, &measured)) in self.axes.iter_mut().zip(commanded.axes().zip(measured.axes())) {
            axis.update(now_ns, (commanded, measured), tolerance_rad, timeout_ns);
        }
    }

    /// Ends all runs of checks, because no measurement is possible for a while, or the mirrors are stopped.
    pub fn pause(&mut self) {
        self.axes.iter_mut().for_each(|axis| axis.since_ns = None);
    }

    /// Whether a mirror does not follow.
    pub fn is_unusable(&self, mirror: usize) -> bool {
        let mirrors = self.axes.len() / 2;
        [mirror, mirrors + mirror].into_iter().any(|axis| self.axes[axis].unusable_at.is_some())
    }
}

impl Axis {
    fn update(&mut self, now_ns: u64, (commanded, measured): (f64, f64), tolerance_rad: f64, timeout_ns: u64) {
        let near = (commanded - measured).abs() <= tolerance_rad;
        let turned = measured - self.measured;
        let towards = |target: f64| turned * (target - self.measured).signum() > 0.25 * tolerance_rad;
        let approaches = towards(self.commanded) || towards(commanded);
        let counts = match self.unusable_at {
            None => !near && !approaches,
            Some(unusable_at) => near && (measured - unusable_at).abs() > 2.0 * tolerance_rad,
        };
        (self.commanded, self.measured) = (commanded, measured);
        if !counts {
            self.since_ns = None;
            return;
        }
        let since_ns = *self.since_ns.get_or_insert(now_ns);
        if now_ns.saturating_sub(since_ns) > timeout_ns {
            self.unusable_at = if self.unusable_at.is_none() { Some(measured) } else { None };
            self.since_ns = None;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CHECK_NS: u64 = 50_000_000;

    fn one_mirror() -> FollowCheck {
        FollowCheck::new(&Capabilities { rows: 1, columns: 1, ..Capabilities::default() })
    }

    /// Checks one mirror; `at` returns its commanded and measured roll for each check. Returns
    /// whether it is unusable after each.
    fn verdicts(mirror: &mut FollowCheck, checks: u64, at: impl Fn(f64) -> (f64, f64)) -> Vec<bool> {
        let check = |index: u64| {
            let (commanded, measured) = at(index as f64);
            let angles = |roll: f64| MirrorAngles { roll: vec![roll], yaw: vec![0.0] };
            mirror.update(index * CHECK_NS, &angles(commanded), &angles(measured));
            mirror.is_unusable(0)
        };
        (0..checks).map(check).collect()
    }

    #[test]
    fn stuck_dead_and_flipped_axes_are_found_and_lagging_ones_are_not() {
        let sweep = |check: f64| 0.5 * (0.2 * check).sin();
        assert!(verdicts(&mut one_mirror(), 40, |check| (0.3, 0.1 + 0.0 * check))[39], "stuck");
        assert!(verdicts(&mut one_mirror(), 40, |_| (0.3, 0.0))[39], "dead");
        assert!(verdicts(&mut one_mirror(), 40, |check| (0.3 + 0.001 * check, -0.3 - 0.001 * check))[39], "flipped");
        let lagging = verdicts(&mut one_mirror(), 400, |check| (sweep(check), sweep(check - 4.0)));
        assert!(!lagging.contains(&true), "a slow mirror follows with a delay, and is usable");
        assert!(!verdicts(&mut one_mirror(), 40, |_| (0.3, 0.295)).contains(&true), "within tolerance");
        assert!(!verdicts(&mut one_mirror(), 6, |_| (0.3, 0.0)).contains(&true), "not at once");
    }

    #[test]
    fn a_mirror_is_usable_again_after_it_followed_a_command() {
        let mut mirror = one_mirror();
        let stuck = verdicts(&mut mirror, 100, |check| {
            let commanded = if check < 50.0 { 0.3 } else { 0.1 };
            (commanded, if check < 80.0 { 0.1 } else { commanded })
        });
        assert!(stuck[49] && stuck[79], "a command to the angle at which it is stuck is no evidence");
        let healed = verdicts(&mut mirror, 40, |_| (-0.2, -0.2));
        assert!(!healed[39]);
    }
}
