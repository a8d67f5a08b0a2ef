//! The direction in which a user faces: a discrete distribution over the circle.
//!
//! A walking user faces the direction of the walk. A standing user may face any way, which no
//! position report shows; the user's own body is then found by the light that it blocks.

use heliostat_channel::{Vec3, simd::with_widest_simd};
use serde::{Deserialize, Serialize};

use crate::belief::elementary::exp;

/// Headings of the distribution: every 10 degrees.
pub const HEADINGS: usize = 36;

/// A heading whose mean vector is shorter than this is unknown.
pub(crate) const HEADING_KNOWN: f64 = 0.3;

/// Rate per second at which a user turns to any other direction.
const TURNS_PER_S: f64 = 0.5;

/// A walk at this speed in m/s has a heading of concentration 1 (von Mises).
const SPEED_M_S: f64 = 0.15;

/// Largest concentration of a walk: a spread of 8 degrees.
const CONCENTRATION_MAX: f64 = 50.0;

/// A heading with less probability than this share of the uniform one is not examined.
const NEGLIGIBLE: f64 = 1e-3 / HEADINGS as f64;

/// Headings on each side of the most probable one that belong to the same direction: 50 degrees.
const NEAR: usize = 5;

/// The probability of each heading.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(into = "Vec<f64>", try_from = "Vec<f64>")]
pub struct Heading {
    probability: [f64; HEADINGS],
}

impl Default for Heading {
    /// No knowledge.
    fn default() -> Self {
        Self { probability: [1.0 / HEADINGS as f64; HEADINGS] }
    }
}

impl From<Heading> for Vec<f64> {
    fn from(heading: Heading) -> Self {
        heading.probability.to_vec()
    }
}

impl TryFrom<Vec<f64>> for Heading {
    type Error = &'static str;

    /// A recorded state may hold any numbers.
    fn try_from(values: Vec<f64>) -> Result<Self, Self::Error> {
        let is_sound = values.iter().all(|value| (0.0..=1.0).contains(value));
        let probability = values.try_into().ok().filter(|_| is_sound);
        Ok(Self { probability: probability.ok_or("a heading has 36 probabilities")? })
    }
}

impl Heading {
    /// The unit vector of a heading of the distribution.
    pub fn direction(index: usize) -> Vec3 {
        let (sine, cosine) = (index as f64 * std::f64::consts::TAU / HEADINGS as f64).sin_cos();
        Vec3::new(cosine, sine, 0.0)
    }

    /// Takes the estimated velocity in m/s, `elapsed_s` after the last one.
    pub fn handle_velocity(&mut self, elapsed_s: f64, [x, y]: [f64; 2], directions: &[Vec3; HEADINGS]) {
        let kept = (-TURNS_PER_S * elapsed_s).exp();
        let turned = (1.0 - kept) / HEADINGS as f64;
        let speed = x.hypot(y);
        let concentration = (speed / SPEED_M_S).powi(2).min(CONCENTRATION_MAX);
        let factor = if speed > 0.0 { concentration / speed } else { 0.0 };
        with_widest_simd(
            #[inline(always)]
            || {
                for (probability, direction) in self.probability.iter_mut().zip(directions) {
                    let alignment = factor * (x * direction.x + y * direction.y) - concentration;
                    *probability = (*probability * kept + turned) * exp(alignment);
                }
            },
        );
        self.normalise();
    }

    /// Multiplies by the likelihood of a measurement. Shape: [`HEADINGS`].
    pub fn handle_likelihood(&mut self, likelihood: &[f64; HEADINGS]) {
        self.probability.iter_mut().zip(likelihood).for_each(|(probability, factor)| *probability *= factor);
        self.normalise();
    }

    /// The probability of each heading.
    pub fn probabilities(&self) -> &[f64; HEADINGS] {
        &self.probability
    }

    /// The headings that are worth an examination, with their probability.
    pub fn possible(&self) -> impl Iterator<Item = (usize, f64)> {
        self.probability.iter().copied().enumerate().filter(|(_, probability)| *probability > NEGLIGIBLE)
    }

    /// Mean of the unit vectors: its length is 1 for a certain heading and 0 without knowledge.
    pub fn mean(&self, directions: &[Vec3; HEADINGS]) -> Vec3 {
        self.probability.iter().zip(directions).map(|(probability, direction)| *probability * direction).sum()
    }

    /// The unit vector of the mean direction; `None` while the heading is unknown.
    pub fn known(&self, directions: &[Vec3; HEADINGS]) -> Option<Vec3> {
        let mean = self.mean(directions);
        let length = mean.norm();
        (length > HEADING_KNOWN).then(|| mean / length)
    }

    /// The unit vector of the most probable direction: the mean of the headings near the most
    /// probable one.
    pub fn mode(&self, directions: &[Vec3; HEADINGS]) -> Vec3 {
        let by_probability = |one: &usize, other: &usize| self.probability[*one].total_cmp(&self.probability[*other]);
        let peak = (0..HEADINGS).max_by(by_probability).unwrap_or(0);
        let near = (HEADINGS - NEAR..=HEADINGS + NEAR).map(|offset| (peak + offset) % HEADINGS);
        near.map(|index| self.probability[index] * directions[index]).sum::<Vec3>().normalize()
    }

    fn normalise(&mut self) {
        let total: f64 = self.probability.iter().sum();
        if total > f64::MIN_POSITIVE {
            self.probability.iter_mut().for_each(|probability| *probability /= total);
        } else {
            *self = Self::default();
        }
    }
}

/// Standard deviation in rad of the heading of a fast walk.
pub(super) fn walk_spread_rad() -> f64 {
    CONCENTRATION_MAX.sqrt().recip()
}

/// The unit vectors of all headings.
pub fn directions() -> [Vec3; HEADINGS] {
    std::array::from_fn(Heading::direction)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_walk_shows_the_heading_and_standing_loses_it_slowly() {
        let directions = directions();
        let mut heading = Heading::default();
        assert!(heading.mean(&directions).norm() < 1e-12);
        for _ in 0..5 {
            heading.handle_velocity(0.1, [0.0, 1.0], &directions);
        }
        let walking = heading.mean(&directions);
        assert!(walking.y > 0.95 && walking.x.abs() < 1e-9, "{walking:?}");
        let mut last = walking.norm();
        for _ in 0..20 {
            heading.handle_velocity(0.1, [0.0, 0.0], &directions);
            let length = heading.mean(&directions).norm();
            assert!(length < last);
            last = length;
        }
        assert!((last / walking.norm() - (-1.0_f64).exp()).abs() < 1e-9, "{last}");
    }

    #[test]
    fn a_measurement_moves_the_heading_and_an_impossible_one_starts_again() {
        let directions = directions();
        let mut heading = Heading::default();
        let likelihood = std::array::from_fn(|index| if index == 9 { 1.0 } else { 0.01 });
        heading.handle_likelihood(&likelihood);
        let mean = heading.mean(&directions);
        assert!(mean.y > 0.7 && mean.x.abs() < 1e-9, "{mean:?}");
        heading.handle_likelihood(&[0.0; HEADINGS]);
        assert_eq!(heading, Heading::default());
    }
}
