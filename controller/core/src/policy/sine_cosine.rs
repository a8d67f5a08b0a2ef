//! The sine cosine algorithm (Mirjalili, Knowledge-Based Systems 96, 2016), used in the literature
//! on mirror arrays.
//!
//! Every coordinate x of every candidate swings around the best candidate's p,
//!
//! ```text
//! x <- x + r1 sin(r2) |r3 p - x|   or   x + r1 cos(r2) |r3 p - x|,   each with probability 1/2,
//! ```
//!
//! with r2 uniform in [0, 2 pi], r3 in [0, 2], and r1 falling from 2 to 0 as the budget is spent.
//! Differences from the source: the budget is counted in trials or in time instead of rounds, and
//! one candidate starts at the present angles. The module `metaheuristic` has both.

use std::f64::consts::TAU;

use heliostat_channel::mirrors::MirrorAngles;
use heliostat_scenario::Scenario;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::metaheuristic::{Round, Rule, Search};
use super::proposal::TimeSource;

/// r1 at the start, as in the source.
const FIRST_REACH: f64 = 2.0;

/// The sine cosine algorithm on the angles of all mirrors, with the budget and the seed of a scenario.
pub(super) fn sine_cosine(scenario: &Scenario, monotonic_ns: TimeSource) -> Search<Swing> {
    Search::new("sine-cosine", scenario, monotonic_ns, |_| Swing)
}

/// Has no memory.
pub(super) struct Swing;

impl Rule for Swing {
    fn begin(&mut self, _: &[MirrorAngles], _: &[f64]) {}

    fn step(&mut self, place: &mut MirrorAngles, round: &Round<'_>, generator: &mut ChaCha8Rng) {
        let reach = FIRST_REACH * (1.0 - round.spent);
        for (angle, best) in place.axes_mut().zip(round.best.axes()) {
            let (sin, cos) = generator.random_range(0.0..TAU).sin_cos();
            let distance = (generator.random_range(0.0..2.0) * best - *angle).abs();
            *angle += reach * distance * if generator.random_bool(0.5) { sin } else { cos };
        }
    }

    fn evaluated(&mut self, _: usize, _: &MirrorAngles, _: f64) {}
}
