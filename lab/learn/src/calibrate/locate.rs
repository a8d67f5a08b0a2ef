//! The search for a mirror's light: from readings of a detector to the angles at which the light is
//! centred on it.

/// Steps of a scan on each side of its middle.
const STEPS: i32 = 6;

/// Half the length of the first scans and of the later ones, in half widths of the lit region.
const WIDE: f64 = 2.0;
const NARROW: f64 = 1.5;

/// Distance between two points of the search in half widths of the lit region: at least one point
/// is well inside it.
const SEARCH_STEP: f64 = 1.2;

/// Share of the expected gain above which the light counts as found.
const FOUND: f64 = 0.4;

/// An array, and detectors at known positions.
pub trait Instrument {
    /// The gain of one mirror at a detector when its drive is commanded to these angles (roll and
    /// yaw in rad) and every other mirror is turned away. Dimensionless.
    fn read(&mut self, mirror: usize, spot: usize, angles: [f64; 2]) -> f64;
}

/// A mirror and a detector, with the expected light.
#[derive(Clone, Copy, Debug)]
pub struct Pair {
    /// Index of the mirror.
    pub mirror: usize,
    /// Index of the detector.
    pub spot: usize,
    /// Roll and yaw by the law of reflection in rad.
    pub aim: [f64; 2],
    /// Error of roll and of yaw at which the light leaves the detector, in rad.
    pub half_width: [f64; 2],
    /// The gain at the aim. Dimensionless.
    pub gain: f64,
}

/// Searches for the light around `start`, the nearest points first, up to `most` rad away on each
/// axis.
pub fn find(instrument: &mut dyn Instrument, pair: &Pair, start: [f64; 2], most: f64) -> Option<[f64; 2]> {
    let step = pair.half_width.map(|half| SEARCH_STEP * half);
    let [rolls, yaws] = step.map(|step| (most / step).ceil() as i32);
    let mut points: Vec<[f64; 2]> = (-rolls..=rolls)
        .flat_map(|roll| (-yaws..=yaws).map(move |yaw| [f64::from(roll) * step[0], f64::from(yaw) * step[1]]))
        .collect();
    points.sort_by(|a, b| a[0].hypot(a[1]).total_cmp(&b[0].hypot(b[1])));
    points
        .into_iter()
        .map(|off| [start[0] + off[0], start[1] + off[1]])
        .find(|point| instrument.read(pair.mirror, pair.spot, *point) > FOUND * pair.gain)
}

/// The angles at which the light is centred on the detector, from angles at which the detector is
/// lit.
///
/// Along one axis, then the other: sum(x g(x)) / sum(g(x)) over a scan of angles x with gains g.
/// After a first pass the result is the mean of scans in both directions, so that hysteresis
/// cancels.
pub fn centre(instrument: &mut dyn Instrument, pair: &Pair, start: [f64; 2]) -> [f64; 2] {
    let mut at = start;
    let mut pass = |length: f64, direction: f64| {
        for axis in [1, 0] {
            at[axis] = centroid(instrument, pair, at, (axis, direction * length * pair.half_width[axis]));
        }
        at
    };
    pass(WIDE, 1.0);
    let (up, down) = (pass(NARROW, 1.0), pass(NARROW, -1.0));
    [0.5 * (up[0] + down[0]), 0.5 * (up[1] + down[1])]
}

/// The centroid along one axis of a scan that ends `reach` from its middle; the middle without
/// light.
fn centroid(instrument: &mut dyn Instrument, pair: &Pair, middle: [f64; 2], (axis, reach): (usize, f64)) -> f64 {
    let (mut sum, mut moment) = (0.0, 0.0);
    for step in -STEPS..=STEPS {
        let shift = reach * f64::from(step) / f64::from(STEPS);
        let mut angles = middle;
        angles[axis] += shift;
        let gain = instrument.read(pair.mirror, pair.spot, angles);
        sum += gain;
        moment += gain * shift;
    }
    let off = if sum > 0.0 { moment / sum } else { 0.0 };
    middle[axis] + off.clamp(-reach.abs(), reach.abs())
}

/// Least squares of drive angles over true angles: drive = gain * true + offset, in rad; one entry
/// for each detector.
///
/// With fewer than three detectors, or a standard deviation of the true angles below `spread` rad,
/// the gain is 1.
pub fn fit(truth: &[f64], drive: &[f64], spread: f64) -> (f64, f64) {
    let count = truth.len() as f64;
    let mean = |values: &[f64]| values.iter().sum::<f64>() / count;
    let (mean_truth, mean_drive) = (mean(truth), mean(drive));
    let square: f64 = truth.iter().map(|truth| (truth - mean_truth).powi(2)).sum();
    let product: f64 = truth.iter().zip(drive).map(|(truth, drive)| (truth - mean_truth) * (drive - mean_drive)).sum();
    let fits = truth.len() >= 3 && square > count * spread * spread;
    let gain = if fits { product / square } else { 1.0 };
    (gain, mean_drive - gain * mean_truth)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A lit rectangle with a displaced centre, and a drive with backlash.
    struct Lobe {
        centre: [f64; 2],
        half: [f64; 2],
        play: f64,
        held: [f64; 2],
    }

    impl Instrument for Lobe {
        fn read(&mut self, _: usize, _: usize, angles: [f64; 2]) -> f64 {
            for (held, commanded) in self.held.iter_mut().zip(angles) {
                *held = held.clamp(commanded - 0.5 * self.play, commanded + 0.5 * self.play);
            }
            let lit = |axis: usize| {
                let off: f64 = (self.held[axis] - self.centre[axis]).abs();
                // Soft edges, as from a panel of finite size.
                ((self.half[axis] - off) / (0.4 * self.half[axis]) + 0.5).clamp(0.0, 1.0)
            };
            1e-7 * lit(0) * lit(1)
        }
    }

    const PAIR: Pair = Pair { mirror: 0, spot: 0, aim: [0.1, -0.2], half_width: [0.015, 0.04], gain: 1e-7 };

    #[test]
    fn the_centre_is_found_from_afar_and_hysteresis_cancels() {
        for (off, play) in [([0.05, -0.08], 0.0), ([-0.03, 0.06], 0.0), ([0.02, 0.02], 0.004)] {
            let centre_of = [PAIR.aim[0] + off[0], PAIR.aim[1] + off[1]];
            let mut lobe = Lobe { centre: centre_of, half: PAIR.half_width, play, held: PAIR.aim };
            let start = find(&mut lobe, &PAIR, PAIR.aim, 0.1).expect("the light is within the search");
            let found = centre(&mut lobe, &PAIR, start);
            assert!((found[0] - centre_of[0]).abs() < 6e-4 && (found[1] - centre_of[1]).abs() < 6e-4, "{found:?}");
        }
        let mut far = Lobe { centre: [0.5, 0.5], half: PAIR.half_width, play: 0.0, held: PAIR.aim };
        assert_eq!(find(&mut far, &PAIR, PAIR.aim, 0.1), None);
    }

    #[test]
    fn a_line_is_fitted_where_the_spots_lie_apart_and_an_offset_else() {
        let truth = [-0.2, 0.0, 0.1, 0.3];
        let drive = truth.map(|angle| 1.02 * angle - 0.01);
        let (gain, offset) = fit(&truth, &drive, 0.05);
        assert!((gain - 1.02).abs() < 1e-12 && (offset + 0.01).abs() < 1e-12);
        assert_eq!(fit(&truth[..2], &drive[..2], 0.05).0, 1.0);
        assert_eq!(fit(&[0.1, 0.11, 0.12], &[0.2, 0.2, 0.2], 0.05).0, 1.0);
    }
}
