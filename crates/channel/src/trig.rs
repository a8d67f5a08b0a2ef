//! Sines, cosines and arc tangents of a block of angles, identical on every platform.
//!
//! The standard library's sine takes one angle per call, which prevents vectorisation, and its last
//! bit differs between platforms. Here sine and cosine are polynomials of half the angle, with an
//! error of at most 4e-16 within +-90 degrees: the range of a mirror. A block with a larger angle
//! uses the standard library.

use std::f64::consts::{FRAC_PI_2, FRAC_PI_4};

/// Number of mirrors per block: one array of this length fits a few vector registers, and 100
/// mirrors leave 12 lanes unused.
pub(crate) const BLOCK: usize = 16;

/// One value for each mirror of a block.
pub(crate) type Lanes = [f64; BLOCK];

/// sqrt(2) - 1
const TAN_22_5: f64 = std::f64::consts::SQRT_2 - 1.0;
/// sqrt(2) + 1
const TAN_67_5: f64 = std::f64::consts::SQRT_2 + 1.0;

/// Splits a list into blocks; the last entry is repeated, so that every block is full.
pub(crate) fn in_blocks(values: impl Iterator<Item = f64>) -> Vec<Lanes> {
    let values: Vec<f64> = values.collect();
    values.chunks(BLOCK).map(|chunk| std::array::from_fn(|lane| chunk[lane.min(chunk.len() - 1)])).collect()
}

/// Sines and cosines of a block of angles in radians.
#[inline(always)]
pub(crate) fn sin_cos(angles: &Lanes) -> (Lanes, Lanes) {
    let (mut sines, mut cosines) = ([0.0; BLOCK], [0.0; BLOCK]);
    if angles.iter().all(|angle| angle.abs() <= FRAC_PI_2) {
        for lane in 0..BLOCK {
            (sines[lane], cosines[lane]) = small_sin_cos(angles[lane]);
        }
    } else {
        for lane in 0..BLOCK {
            (sines[lane], cosines[lane]) = angles[lane].sin_cos();
        }
    }
    (sines, cosines)
}

/// Sine and cosine of an angle within +-90 degrees: Taylor series of half the angle, then the
/// double-angle formulas.
///
/// At a half angle of 45 degrees the first omitted terms are below 1e-17.
#[inline(always)]
fn small_sin_cos(angle: f64) -> (f64, f64) {
    let half = 0.5 * angle;
    let square = half * half;
    let sine = half * series(square, &[6.0, 20.0, 42.0, 72.0, 110.0, 156.0, 210.0, 272.0]);
    let cosine = series(square, &[2.0, 12.0, 30.0, 56.0, 90.0, 132.0, 182.0, 240.0]);
    (2.0 * sine * cosine, 1.0 - 2.0 * sine * sine)
}

/// 1 - x/a (1 - x/b (1 - x/c ...)): the alternating series whose terms have these successive
/// ratios.
#[inline(always)]
fn series(x: f64, ratios: &[f64; 8]) -> f64 {
    let mut sum = 1.0;
    for index in (0..8).rev() {
        // The compiler folds the reciprocal of a constant; a division would cost more than the rest
        // of the loop.
        sum = 1.0 - x * (1.0 / ratios[index]) * sum;
    }
    sum
}

/// Arc tangents of the quotients of two blocks of numbers, in radians; zero where both numbers are
/// zero.
///
/// The argument is reduced so that the Taylor series has a tangent of at most 22.5 degrees:
/// relative to 0 degrees below 22.5 degrees, to 45 degrees below 67.5 degrees, and to 90 degrees
/// above. The error is at most 1e-15; a denominator of zero gives +-90 degrees.
#[inline(always)]
pub(crate) fn atan_of_quotient(above: &Lanes, below: &Lanes) -> Lanes {
    let (mut bases, mut tangents, mut squares) = ([0.0; BLOCK], [0.0; BLOCK], [0.0; BLOCK]);
    for lane in 0..BLOCK {
        let (rise, run) = (above[lane].abs(), below[lane].abs());
        let steep = rise > TAN_67_5 * run;
        let slanted = rise > TAN_22_5 * run;
        let (base, above_rest) = if slanted { (FRAC_PI_4, rise - run) } else { (0.0, rise) };
        let below_rest = if slanted { rise + run } else { run };
        let (base, above_rest) = if steep { (FRAC_PI_2, -run) } else { (base, above_rest) };
        let below_rest = if steep { rise } else { below_rest };
        bases[lane] = base;
        tangents[lane] = above_rest / if below_rest == 0.0 { 1.0 } else { below_rest };
        squares[lane] = tangents[lane] * tangents[lane];
    }
    // Term by term for all lanes, since within a lane each term depends on the one before.
    let mut sums = [0.0; BLOCK];
    for index in (0..20).rev() {
        let sign = if index % 2 == 0 { 1.0 } else { -1.0 };
        for lane in 0..BLOCK {
            sums[lane] = sums[lane] * squares[lane] + sign * (1.0 / (2 * index + 1) as f64);
        }
    }
    let mut angles = [0.0; BLOCK];
    for lane in 0..BLOCK {
        let angle = bases[lane] + tangents[lane] * sums[lane];
        let signs = (above[lane].to_bits() ^ below[lane].to_bits()) & (1 << 63);
        angles[lane] = f64::from_bits(angle.to_bits() ^ signs);
    }
    angles
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn agrees_with_the_standard_library() {
        for step in -2000..=2000 {
            let angle = f64::from(step) / 2000.0 * FRAC_PI_2;
            let (sine, cosine) = small_sin_cos(angle);
            assert!((sine - angle.sin()).abs() < 4e-16, "sin {angle}");
            assert!((cosine - angle.cos()).abs() < 4e-16, "cos {angle}");
        }
        for step in -2000..=2000 {
            let tangent = f64::from(step) * 0.01 * f64::from(step).abs();
            for below in [1.0, -0.37, 250.0] {
                let angle = atan_of_quotient(&[tangent * below; BLOCK], &[below; BLOCK])[5];
                assert!((angle - tangent.atan()).abs() < 1e-15, "atan {tangent}: {angle} {}", tangent.atan());
            }
        }
        for step in -10_000..=10_000 {
            let angle = f64::from(step) * 1e-4 * FRAC_PI_2;
            let found = atan_of_quotient(&[angle.sin(); BLOCK], &[angle.cos(); BLOCK])[0];
            assert!((found - angle).abs() < 1e-15, "{angle}: {found}");
        }
        for (above, below, angle) in [(0.0, 0.0, 0.0), (2.0, 0.0, FRAC_PI_2), (-2.0, 0.0, -FRAC_PI_2), (0.0, -3.0, 0.0)]
        {
            assert_eq!(atan_of_quotient(&[above; BLOCK], &[below; BLOCK])[7], angle, "{above} / {below}");
        }
        let wide = [2.5; BLOCK];
        assert_eq!(sin_cos(&wide).0[3], 2.5_f64.sin());
    }
}
