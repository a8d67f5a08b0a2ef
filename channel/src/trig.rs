//! Sines and cosines of many angles at once, the same on every platform.
//!
//! The sine of the standard library is one call an angle, which no compiler can vectorise, and its last bit differs between
//! platforms. Here both are polynomials of half the angle, good to 4e-16 for angles within 90 degrees, which is all that a
//! mirror can do. A block with any other angle falls back on the standard library.

use std::f64::consts::FRAC_PI_2;

/// How many mirrors are treated together. 100 mirrors waste 12 lanes of 112, and one array of this length fits a few registers.
pub(crate) const BLOCK: usize = 16;

/// One value for each mirror of a block.
pub(crate) type Lanes = [f64; BLOCK];

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

/// Sine and cosine of an angle within 90 degrees: Taylor series of half of it, then the double-angle formulas.
///
/// At 45 degrees the first terms left out are below 1e-17.
#[inline(always)]
fn small_sin_cos(angle: f64) -> (f64, f64) {
    let half = 0.5 * angle;
    let square = half * half;
    let sine = half * series(square, &[6.0, 20.0, 42.0, 72.0, 110.0, 156.0, 210.0, 272.0]);
    let cosine = series(square, &[2.0, 12.0, 30.0, 56.0, 90.0, 132.0, 182.0, 240.0]);
    (2.0 * sine * cosine, 1.0 - 2.0 * sine * sine)
}

/// 1 - x/a (1 - x/b (1 - x/c ...)): the alternating series whose terms have these successive ratios.
#[inline(always)]
fn series(x: f64, ratios: &[f64; 8]) -> f64 {
    let mut sum = 1.0;
    for index in (0..8).rev() {
        // The reciprocal of a constant is folded; a division here would cost more than all the rest.
        sum = 1.0 - x * (1.0 / ratios[index]) * sum;
    }
    sum
}

/// Arcus tangents of a block of numbers, in radians.
///
/// Three times the half of the angle by tan(a/2) = t / (1 + sqrt(1 + t^2)), which leaves at most 11.25 degrees, then the Taylor series. Good to
/// 1e-15; an infinite tangent gives the 90 degrees that it stands for.
#[inline(always)]
pub(crate) fn atan(tangents: &Lanes) -> Lanes {
    let mut angles = [0.0; BLOCK];
    for lane in 0..BLOCK {
        // Beyond this the square would overflow, and the angle is 90 degrees to the last bit.
        let mut tangent = tangents[lane].clamp(-1e150, 1e150);
        for _ in 0..3 {
            tangent /= 1.0 + (1.0 + tangent * tangent).sqrt();
        }
        let square = tangent * tangent;
        let mut sum = 0.0;
        for index in (0..12).rev() {
            let sign = if index % 2 == 0 { 1.0 } else { -1.0 };
            sum = sum * square + sign * (1.0 / (2 * index + 1) as f64);
        }
        angles[lane] = 8.0 * tangent * sum;
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
            let angle = atan(&[tangent; BLOCK])[5];
            assert!((angle - tangent.atan()).abs() < 1e-15, "atan {tangent}: {angle} {}", tangent.atan());
        }
        for endless in [f64::INFINITY, f64::MAX, -f64::INFINITY] {
            assert!((atan(&[endless; BLOCK])[0] - endless.atan()).abs() < 1e-15);
        }
        let wide = [2.5; BLOCK];
        assert_eq!(sin_cos(&wide).0[3], 2.5_f64.sin());
    }
}
