//! The path of a command through the drive electronics: delay, range, quantisation and hysteresis.
//!
//! Hysteresis is the play operator. A command u moves the held target w to min(max(w, u - h/2), u +
//! h/2) for a loop of width h. So an axis comes to rest h/2 short of its command from either side,
//! and a reversal of less than h has no effect. The result depends only on the order of the
//! commands.

use std::collections::VecDeque;

use heliostat_channel::mirrors::MirrorAngles;
use heliostat_scenario::ActuatorParameters;

/// Largest number of angles in the commands that have not taken effect, 256 MiB: a long delay must
/// not fill the memory.
const PENDING_ANGLES_MAX: usize = 1 << 25;

/// A command that has not taken effect yet.
#[derive(Clone, Debug)]
struct Pending {
    effective_at: f64,
    targets: Vec<f64>,
}

/// The drive of an array: commands go in, targets for the axes come out.
#[derive(Clone, Debug)]
pub(super) struct Drive {
    range_rad: f64,
    resolution_bits: Option<u32>,
    delay_s: f64,
    hysteresis_rad: f64,
    /// Added to the delay, in s.
    delay_fault_s: f64,
    pending: VecDeque<Pending>,
    /// Lists of commands that have taken effect, for reuse: no call allocates in the steady state.
    spare: Vec<Vec<f64>>,
    /// Roll of every mirror, then yaw of every mirror, in rad.
    targets: Vec<f64>,
}

impl Drive {
    /// A drive for `axes` axes, all with target 0.
    pub fn new(parameters: &ActuatorParameters, axes: usize) -> Self {
        Self {
            range_rad: parameters.range_rad,
            resolution_bits: parameters.resolution_bits,
            delay_s: parameters.delay_s,
            hysteresis_rad: parameters.hysteresis_rad,
            delay_fault_s: 0.0,
            pending: VecDeque::new(),
            spare: Vec::new(),
            targets: vec![0.0; axes],
        }
    }

    /// Accepts a command at `time_s`; [`Drive::take_effect`] applies it after the delay. A drive
    /// with too many commands that have not taken effect ignores it.
    pub fn command(&mut self, time_s: f64, angles: &MirrorAngles) {
        if self.pending.len() * self.targets.len() >= PENDING_ANGLES_MAX {
            return;
        }
        let mut targets = self.spare.pop().unwrap_or_default();
        targets.clone_from(self.pending.back().map_or(&self.targets, |last| &last.targets));
        let mirrors = targets.len() / 2;
        let (roll, yaw) = targets.split_at_mut(mirrors);
        for (list, commanded) in [(roll, &angles.roll), (yaw, &angles.yaw)] {
            for (target, &angle) in list.iter_mut().zip(commanded) {
                *target = reachable(angle, self.range_rad, self.resolution_bits);
            }
        }
        // A drive keeps the order of its commands, also when its delay has become shorter.
        let earliest = self.pending.back().map_or(0.0, |last| last.effective_at);
        let effective_at = (time_s + self.delay_s + self.delay_fault_s).max(earliest);
        self.pending.push_back(Pending { effective_at, targets });
    }

    /// The time in s at which the next command takes effect.
    pub fn next_effective_s(&self) -> Option<f64> {
        self.pending.front().map(|next| next.effective_at)
    }

    /// Applies the commands whose delay has passed at `time_s` to the targets.
    pub fn take_effect(&mut self, time_s: f64) {
        while self.next_effective_s().is_some_and(|effective_at| effective_at <= time_s) {
            if let Some(next) = self.pending.pop_front() {
                let half = 0.5 * self.hysteresis_rad;
                for (held, commanded) in self.targets.iter_mut().zip(&next.targets) {
                    *held = held.clamp(commanded - half, commanded + half);
                }
                self.spare.push(next.targets);
            }
        }
    }

    /// Drops the commands that have not taken effect.
    pub fn drop_pending(&mut self) {
        self.pending.clear();
    }

    /// Delays later commands by so many seconds more.
    pub fn set_delay_fault(&mut self, seconds: f64) {
        self.delay_fault_s = seconds;
    }

    /// The targets in rad: roll of every mirror, then yaw of every mirror.
    pub fn targets(&self) -> &[f64] {
        &self.targets
    }

    /// The same, to be changed without a command.
    pub fn targets_mut(&mut self) -> &mut [f64] {
        &mut self.targets
    }
}

/// The nearest angle that the drive can be set to: within the range, on the converter's grid.
///
/// A converter of n bits has 2^n codes from -range to one step below +range, so that 0 is a code.
fn reachable(angle: f64, range_rad: f64, resolution_bits: Option<u32>) -> f64 {
    let bounded = angle.clamp(-range_rad, range_rad);
    match resolution_bits {
        Some(bits) => {
            let half = (1_u64 << (bits.min(52) - 1)) as f64;
            (bounded / range_rad * half).round().clamp(-half, half - 1.0) * range_rad / half
        }
        None => bounded,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantisation_has_two_to_the_bits_codes_with_zero_among_them() {
        let mut codes: Vec<f64> = (-100..=100).map(|i| reachable(f64::from(i) / 100.0, 1.0, Some(3))).collect();
        codes.dedup();
        assert_eq!(codes, [-1.0, -0.75, -0.5, -0.25, 0.0, 0.25, 0.5, 0.75]);
    }
}
