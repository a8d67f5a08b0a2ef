//! Which mirrors do not go where they are told: a stuck mirror, an axis without drive, one that turns the wrong way.
//!
//! Only hardware that measures can be judged. An axis fails a look when it is further from its command than the tolerance and has not
//! come nearer to where it was told to go since the look before. One that fails every look for longer than the patience is unusable,
//! until it has gone to a command a good way off and stayed there as long.

use heliostat_channel::MirrorAngles;
use heliostat_proto::{AxisLimits, Capabilities};

/// Smallest error that counts, in rad: half a degree, a fifth of the light of an aimed mirror.
const TOLERANCE_MIN_RAD: f64 = 0.5 * std::f64::consts::PI / 180.0;

/// Shortest time of failing that counts, in ns.
const PATIENCE_MIN_NS: u64 = 300_000_000;

/// Judges the mirrors of an array from look to look.
#[derive(Clone, Debug)]
pub(crate) struct Follow {
    tolerance_rad: f64,
    patience_ns: u64,
    /// Roll of every mirror, then yaw of every mirror.
    axes: Vec<Axis>,
}

#[derive(Clone, Copy, Debug, Default)]
struct Axis {
    commanded: f64,
    measured: f64,
    /// When the run of failing looks began; for an unusable axis, of good ones.
    since_ns: Option<u64>,
    /// Where it stood when it was found unusable.
    unusable_at: Option<f64>,
}

impl Follow {
    pub fn new(capabilities: &Capabilities) -> Self {
        let axes = [capabilities.roll, capabilities.yaw];
        let largest = |value: fn(&AxisLimits) -> f32| f64::from(axes.iter().map(value).fold(0.0, f32::max));
        let settling_ns = (4e9 * largest(|axis| axis.settling_s)) as u64;
        Self {
            tolerance_rad: TOLERANCE_MIN_RAD.max(4.0 * largest(|axis| axis.resolution_rad)),
            patience_ns: PATIENCE_MIN_NS + settling_ns,
            axes: vec![Axis::default(); 2 * capabilities.mirrors()],
        }
    }

    /// Compares where the mirrors are with where they were told to go.
    pub fn look(&mut self, now_ns: u64, commanded: &MirrorAngles, measured: &MirrorAngles) {
        let (tolerance_rad, patience_ns) = (self.tolerance_rad, self.patience_ns);
        let commanded = commanded.roll.iter().chain(&commanded.yaw);
        let measured = measured.roll.iter().chain(&measured.yaw);
        for (axis, (&commanded, &measured)) in self.axes.iter_mut().zip(commanded.zip(measured)) {
            axis.look(now_ns, (commanded, measured), tolerance_rad, patience_ns);
        }
    }

    /// Forgets runs of looks, where none could be made for a while.
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
    fn look(&mut self, now_ns: u64, (commanded, measured): (f64, f64), tolerance_rad: f64, patience_ns: u64) {
        let near = (commanded - measured).abs() <= tolerance_rad;
        let turned = measured - self.measured;
        let towards = |target: f64| turned * (target - self.measured).signum() > 0.25 * tolerance_rad;
        let approaches = towards(self.commanded) || towards(commanded);
        let counts = match self.unusable_at {
            None => !near && !approaches,
            Some(stood) => near && (measured - stood).abs() > 2.0 * tolerance_rad,
        };
        (self.commanded, self.measured) = (commanded, measured);
        if !counts {
            self.since_ns = None;
            return;
        }
        let since_ns = *self.since_ns.get_or_insert(now_ns);
        if now_ns.saturating_sub(since_ns) > patience_ns {
            self.unusable_at = if self.unusable_at.is_none() { Some(measured) } else { None };
            self.since_ns = None;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LOOK_NS: u64 = 50_000_000;

    fn follow() -> Follow {
        Follow::new(&Capabilities { rows: 1, columns: 1, ..Capabilities::default() })
    }

    /// Looks at one mirror whose roll is told `commanded(look)` and found at `measured(look)`; gives the verdict after each.
    fn verdicts(follow: &mut Follow, looks: u64, at: impl Fn(f64) -> (f64, f64)) -> Vec<bool> {
        let look = |index: u64| {
            let (commanded, measured) = at(index as f64);
            let angles = |roll: f64| MirrorAngles { roll: vec![roll], yaw: vec![0.0] };
            follow.look(index * LOOK_NS, &angles(commanded), &angles(measured));
            follow.is_unusable(0)
        };
        (0..looks).map(look).collect()
    }

    #[test]
    fn stuck_dead_and_flipped_axes_are_found_and_lagging_ones_are_not() {
        let sweep = |look: f64| 0.5 * (0.2 * look).sin();
        assert!(verdicts(&mut follow(), 40, |look| (0.3, 0.1 + 0.0 * look))[39], "stuck");
        assert!(verdicts(&mut follow(), 40, |_| (0.3, 0.0))[39], "dead");
        assert!(verdicts(&mut follow(), 40, |look| (0.3 + 0.001 * look, -0.3 - 0.001 * look))[39], "flipped");
        let lagging = verdicts(&mut follow(), 400, |look| (sweep(look), sweep(look - 4.0)));
        assert!(!lagging.contains(&true), "a slow mirror follows late, but it follows");
        assert!(!verdicts(&mut follow(), 40, |_| (0.3, 0.295)).contains(&true), "within tolerance");
        assert!(!verdicts(&mut follow(), 6, |_| (0.3, 0.0)).contains(&true), "not at once");
    }

    #[test]
    fn a_mirror_is_usable_again_once_it_has_gone_where_it_was_told() {
        let mut follow = follow();
        let stuck = verdicts(&mut follow, 100, |look| {
            let commanded = if look < 50.0 { 0.3 } else { 0.1 };
            (commanded, if look < 80.0 { 0.1 } else { commanded })
        });
        assert!(stuck[49] && stuck[79], "a command that happens to be where it is stuck proves nothing");
        let healed = verdicts(&mut follow, 40, |_| (-0.2, -0.2));
        assert!(!healed[39]);
    }
}
