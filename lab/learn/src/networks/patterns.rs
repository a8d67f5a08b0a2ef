//! Smooth patterns of angles over the array: the cosine modes that the critic and the exploration
//! of `ddpg-basis` use.

use std::f64::consts::PI;

use candle_core::{Device, Result, Tensor};

/// The lowest two-dimensional cosine modes over the grid of mirrors, for roll and for yaw.
///
/// Mode (i, j) at row r and column c is n_i n_j cos(pi i (r + 1/2) / rows) cos(pi j (c + 1/2) /
/// columns), with n_0 = 1 and n_i = sqrt 2 otherwise. Each mode has a mean square of 1, and modes
/// are orthogonal.
#[derive(Clone, Debug)]
pub struct Basis {
    /// (2 modes, 2 mirrors): the patterns of roll act on roll, those of yaw on yaw.
    patterns: Tensor,
    modes: usize,
}

impl Basis {
    /// The modes (i, j) with i below min(`order`, rows) and j below min(`order`, columns).
    ///
    /// # Errors
    /// Those of candle.
    pub fn new(rows: usize, columns: usize, order: usize) -> Result<Self> {
        let wave = |index: usize, place: usize, extent: usize| {
            let norm = if index == 0 { 1.0 } else { 2.0_f64.sqrt() };
            norm * (PI * index as f64 * (place as f64 + 0.5) / extent as f64).cos()
        };
        let (mirrors, mut patterns) = (rows * columns, Vec::new());
        let modes = order.min(rows) * order.min(columns);
        for axis in 0..2 {
            for (i, j) in (0..order.min(rows)).flat_map(|i| (0..order.min(columns)).map(move |j| (i, j))) {
                let mode = (0..mirrors).map(|m| (wave(i, m / columns, rows) * wave(j, m % columns, columns)) as f32);
                let zeros = |count: usize| std::iter::repeat_n(0.0, count);
                patterns.extend(zeros(axis * mirrors).chain(mode).chain(zeros((1 - axis) * mirrors)));
            }
        }
        Ok(Self { patterns: Tensor::from_vec(patterns, (2 * modes, 2 * mirrors), &Device::Cpu)?, modes: 2 * modes })
    }

    /// Number of patterns, of roll and of yaw together.
    pub fn modes(&self) -> usize {
        self.modes
    }

    /// The coefficient of each pattern in actions: (batch, 2 mirrors) to (batch, modes).
    ///
    /// # Errors
    /// Those of candle.
    pub fn project(&self, action: &Tensor) -> Result<Tensor> {
        let mirrors = self.patterns.dim(1)? / 2;
        action.matmul(&self.patterns.t()?)? / mirrors as f64
    }

    /// The sum of the patterns with these coefficients: one component for each angle.
    ///
    /// # Errors
    /// Those of candle.
    pub fn sum(&self, coefficients: &[f32]) -> Result<Vec<f32>> {
        let coefficients = Tensor::from_slice(coefficients, (1, self.modes), &Device::Cpu)?;
        coefficients.matmul(&self.patterns)?.squeeze(0)?.to_vec1()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn patterns_are_orthogonal_and_have_the_same_norm() {
        let basis = Basis::new(4, 5, 3).expect("a basis");
        assert_eq!(basis.modes(), 18);
        for mode in 0..18 {
            let coefficients: Vec<f32> = (0..18).map(|index| if index == mode { 0.7 } else { 0.0 }).collect();
            let action = basis.sum(&coefficients).expect("a sum");
            let action = Tensor::from_vec(action, (1, 40), &Device::Cpu).expect("an action");
            let found =
                basis.project(&action).and_then(|found| found.squeeze(0)?.to_vec1::<f32>()).expect("coefficients");
            assert!(
                found.iter().zip(&coefficients).all(|(found, expected)| (found - expected).abs() < 1e-5),
                "{found:?}"
            );
        }
    }

    #[test]
    fn an_array_has_no_more_patterns_than_mirrors() {
        assert_eq!(Basis::new(2, 3, 5).expect("a basis").modes(), 12);
    }
}
