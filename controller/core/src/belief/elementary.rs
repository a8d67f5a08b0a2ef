//! Exponential function and logarithm in loops that vectorise, identical on every platform.
//!
//! The standard library's functions take one number per call, and their last bit differs between
//! platforms. The relative error here is below 1e-13.

use std::f64::consts::{LN_2, LOG2_E, SQRT_2};

/// Added to an integer below 2^51 in size, it leaves the integer in the lowest bits of the sum.
const ROUND: f64 = 6_755_399_441_055_744.0;

/// Bits of the mantissa.
const MANTISSA: u32 = 52;

/// The exponent of 1 in the bits of a number.
const EXPONENT_OF_ONE: u64 = 1023;

/// The smallest exponent of [`exp`]: below, it gives about 1e-304 in place of a smaller number.
const LEAST: f64 = -700.0;

/// e^x for x up to 700.
///
/// e^x = 2^k e^r with |r| <= ln 2 / 2, and the Taylor series of e^r.
#[inline(always)]
pub(super) fn exp(x: f64) -> f64 {
    let x = if x > LEAST { x } else { LEAST };
    let rounded = x * LOG2_E + ROUND;
    let rest = x - (rounded - ROUND) * LN_2;
    let power = f64::from_bits(rounded.to_bits().wrapping_add(EXPONENT_OF_ONE) << MANTISSA);
    let mut sum = 1.0;
    for divisor in [12.0, 11.0, 10.0, 9.0, 8.0, 7.0, 6.0, 5.0, 4.0, 3.0, 2.0, 1.0] {
        sum = 1.0 + sum * rest * (1.0 / divisor);
    }
    power * sum
}

/// ln x for a positive normal number.
///
/// ln x = k ln 2 + ln m with m from sqrt(1/2) to sqrt(2), and ln m = 2 artanh((m - 1) / (m + 1)).
#[inline(always)]
pub(super) fn ln(x: f64) -> f64 {
    let bits = x.to_bits();
    let mantissa = f64::from_bits(bits & ((1 << MANTISSA) - 1) | EXPONENT_OF_ONE << MANTISSA);
    let exponent = f64::from_bits(bits >> MANTISSA | ROUND.to_bits()) - ROUND - EXPONENT_OF_ONE as f64;
    let is_large = mantissa > SQRT_2;
    let mantissa = if is_large { 0.5 * mantissa } else { mantissa };
    let exponent = if is_large { exponent + 1.0 } else { exponent };
    let ratio = (mantissa - 1.0) / (mantissa + 1.0);
    let square = ratio * ratio;
    let mut sum = 0.0;
    for divisor in [17.0, 15.0, 13.0, 11.0, 9.0, 7.0, 5.0, 3.0, 1.0] {
        sum = sum * square + 1.0 / divisor;
    }
    exponent * LN_2 + 2.0 * ratio * sum
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_agree_with_the_standard_library() {
        for step in -14_000..200 {
            let x = f64::from(step) * 0.05 + 0.0123;
            if x > LEAST {
                assert!((exp(x) / x.exp() - 1.0).abs() < 1e-13, "exp({x}) = {}", exp(x));
                // Of a number near 1 the logarithm is small, and its absolute error counts.
                let (found, expected) = (ln(x.exp()), x.exp().ln());
                assert!((found - expected).abs() < 1e-13 * expected.abs().max(0.1), "ln(exp({x})) = {found}");
            }
        }
        assert!(exp(-1e9) < 1e-300 && exp(f64::NEG_INFINITY) < 1e-300);
        assert_eq!((exp(0.0), ln(1.0)), (1.0, 0.0));
    }
}
