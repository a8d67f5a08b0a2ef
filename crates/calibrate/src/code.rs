//! Coded groups: several mirrors are lit at a time, in as many patterns as the group has mirrors.
//!
//! Pattern i of a group of n = 2^k - 1 mirrors lights mirror j if i AND j has an odd number of ones,
//! both counted from 1. So each pattern lights (n + 1) / 2 mirrors, and the patterns are the rows of a
//! symmetric S-matrix (M. Harwit and N. J. A. Sloane, Hadamard Transform Optics, 1979). Its inverse
//! 2 / (n + 1) (2 S - J), with the matrix J of ones, gives the light of each mirror.
//!
//! Each mirror is lit in half of the readings, so the receiver's own noise has 4 n / (n + 1)^2 of its
//! variance. A common error of the dark level is divided by (n + 1) / 2. Noise in proportion to the light
//! grows, because each reading has the light of many mirrors.

/// The sizes of groups, in rising order; a group of one is a single mirror. Two of the largest
/// are within the mirrors that take turns, so one is lit while the reports of another are on their way.
pub const SIZES: [usize; 5] = [1, 3, 7, 15, 31];

/// Mean gain of the probes as a share of the largest gain: most are at the edges, at half of it.
const PROBE_SHARE: f64 = 0.5;

/// Whether a pattern lights a mirror of its group, both counted from 0.
pub fn is_lit(pattern: usize, slot: usize) -> bool {
    ((pattern + 1) & (slot + 1)).count_ones() % 2 == 1
}

/// The light of each mirror, from the readings of all patterns of a group.
pub fn decoded(readings: &[f64]) -> Vec<f64> {
    let scale = 2.0 / (readings.len() + 1) as f64;
    let signed = |slot: usize| {
        let patterns = readings.iter().enumerate();
        patterns.map(|(pattern, reading)| if is_lit(pattern, slot) { *reading } else { -reading }).sum::<f64>()
    };
    (0..readings.len()).map(|slot| scale * signed(slot)).collect()
}

/// Standard deviation of the decoded light of a dark mirror, in a group of this size. `relative`, `own`: the noise
/// of a reading in proportion to its gain, and that of the receiver as a gain. `peak`: the largest gain of a mirror.
pub fn deviation(size: usize, (relative, own): (f64, f64), peak: f64) -> f64 {
    if size <= 1 {
        return own;
    }
    let count = size as f64;
    let of_others = count.sqrt() * relative * PROBE_SHARE * peak;
    (2.0 * count.sqrt() / (count + 1.0) * own).hypot(of_others)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn readings_without_noise_give_the_light_of_each_mirror() {
        for size in SIZES {
            let light: Vec<f64> = (0..size).map(|slot| 1.0 + 0.3 * slot as f64).collect();
            let sum = |pattern: usize| (0..size).filter(|slot| is_lit(pattern, *slot)).map(|slot| light[slot]).sum();
            let readings: Vec<f64> = (0..size).map(sum).collect();
            for (found, light) in decoded(&readings).iter().zip(&light) {
                assert!((found - light).abs() < 1e-12, "{size} mirrors: {found} and {light}");
            }
        }
    }

    #[test]
    fn the_receivers_own_noise_and_an_error_of_the_dark_level_fall_with_the_size() {
        for size in SIZES {
            let weights = |pattern: usize| {
                let mut one = vec![0.0; size];
                one[pattern] = 1.0;
                decoded(&one)
            };
            let count = size as f64;
            for slot in 0..size {
                let variance: f64 = (0..size).map(|pattern| weights(pattern)[slot].powi(2)).sum();
                assert!((variance - 4.0 * count / (count + 1.0).powi(2)).abs() < 1e-12, "{size} mirrors");
                assert!((variance.sqrt() - deviation(size, (0.0, 1.0), 1.0)).abs() < 1e-12, "{size} mirrors");
                let of_level = decoded(&vec![1.0; size])[slot];
                assert!((of_level - 2.0 / (count + 1.0)).abs() < 1e-12, "{size} mirrors");
            }
        }
    }

    #[test]
    fn noise_in_proportion_to_the_light_grows_with_the_size() {
        // All mirrors of a group at half of their largest gain.
        for size in SIZES.into_iter().skip(1) {
            let count = size as f64;
            let reading = 0.05 * 0.5 * (count + 1.0) / 2.0;
            let variance = count * (2.0 / (count + 1.0) * reading).powi(2);
            assert!((deviation(size, (0.05, 0.0), 1.0) - variance.sqrt()).abs() < 1e-12, "{size} mirrors");
        }
    }
}
