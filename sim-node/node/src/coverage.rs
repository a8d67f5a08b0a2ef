//! How often the true place of a user lies within the ellipses of a controller's belief.
//!
//! The simulator compares, because it alone knows the truth; no truth reaches a controller. A belief
//! holds for a time shortly after its decision. It is compared with the true place at that time, on
//! a straight line between two samples of the room.

use std::collections::VecDeque;

use heliostat_channel::floor_normal::{squared_distance, squared_radius};
use heliostat_proto::{BeliefReport, Nanos};
use heliostat_room::world::World;

/// Probabilities of the ellipses.
pub(crate) const PROBABILITIES: [f64; 2] = [0.5, 0.95];

/// Samples of the room that are kept: a belief arrives within a small part of them.
const SAMPLES: usize = 64;

/// Beliefs that wait for the room to reach their time.
const WAITING: usize = 64;

/// The true places at a time.
#[derive(Clone, Debug, Default)]
struct Sample {
    time_ns: Nanos,
    users: Vec<(u32, [f64; 2])>,
}

/// Counts since the start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Covered {
    /// Believed places that were compared.
    pub places: u64,
    /// Those whose ellipse held the true place, by [`PROBABILITIES`].
    pub inside: [u64; PROBABILITIES.len()],
}

/// Compares beliefs with the room.
#[derive(Debug, Default)]
pub(crate) struct Coverage {
    samples: VecDeque<Sample>,
    waiting: VecDeque<BeliefReport>,
    covered: Covered,
}

impl Coverage {
    pub fn covered(&self) -> Covered {
        self.covered
    }

    /// Takes the room at `now`, and the beliefs that have arrived since the last call.
    pub fn update(&mut self, now_ns: Nanos, world: &World, arrived: Vec<BeliefReport>) {
        let mut sample =
            if self.samples.len() < SAMPLES { Sample::default() } else { self.samples.pop_front().unwrap_or_default() };
        sample.time_ns = now_ns;
        sample.users.clear();
        let places = world.positions().iter().map(|place| [place.x, place.y]);
        sample.users.extend(world.ids().iter().copied().zip(places));
        self.samples.push_back(sample);
        self.waiting.extend(arrived);
        self.waiting.drain(..self.waiting.len().saturating_sub(WAITING));
        while let Some(at) = self.waiting.iter().position(|belief| belief.holds_ns <= now_ns) {
            if let Some(belief) = self.waiting.remove(at) {
                self.compare(&belief);
            }
        }
    }

    fn compare(&mut self, belief: &BeliefReport) {
        let later = self.samples.partition_point(|sample| sample.time_ns < belief.holds_ns);
        let (Some(before), Some(after)) =
            (later.checked_sub(1).map(|index| &self.samples[index]), self.samples.get(later))
        else {
            return;
        };
        // A clock that steps back leaves samples out of order.
        if !(before.time_ns..=after.time_ns).contains(&belief.holds_ns) || before.time_ns == after.time_ns {
            return;
        }
        let part = (belief.holds_ns - before.time_ns) as f64 / (after.time_ns - before.time_ns) as f64;
        for user in &belief.users {
            let place = |sample: &Sample| sample.users.iter().find(|(id, _)| *id == user.user).map(|(_, place)| *place);
            let (Some(from), Some(to)) = (place(before), place(after)) else { continue };
            let truth = [0, 1].map(|axis| from[axis] + part * (to[axis] - from[axis]));
            self.covered.places += 1;
            let covariance_m2 = [user.xx_m2, user.xy_m2, user.yy_m2].map(f64::from);
            let away_m = [0, 1].map(|axis| truth[axis] - f64::from(user.position_m[axis]));
            let Some(squared) = squared_distance(away_m, covariance_m2) else { continue };
            for (count, probability) in self.covered.inside.iter_mut().zip(PROBABILITIES) {
                *count += u64::from(squared <= squared_radius(probability));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use heliostat_proto::UserBelief;

    use super::*;

    fn coverage(times_ms: &[u64]) -> Coverage {
        let sample = |ms: &u64| Sample { time_ns: ms * 1_000_000, users: vec![(3, [1e-3 * *ms as f64, 0.0])] };
        Coverage { samples: times_ms.iter().map(sample).collect(), ..Coverage::default() }
    }

    fn belief(holds_ms: u64, x_m: f32, variance_m2: f32) -> BeliefReport {
        let user = UserBelief {
            user: 3,
            position_m: [x_m, 0.0, 0.9],
            xx_m2: variance_m2,
            yy_m2: 1.0,
            ..UserBelief::default()
        };
        BeliefReport { holds_ns: holds_ms * 1_000_000, users: vec![user], ..BeliefReport::default() }
    }

    #[test]
    fn a_belief_is_compared_with_the_place_at_its_own_time() {
        let mut coverage = coverage(&[1000, 1010, 1020]);
        // At 1.015 s the user is at 1.015 m: 0, 1.5 and 3 standard deviations away.
        for (x_m, inside) in [(1.015, [1, 1]), (1.030, [1, 2]), (1.045, [1, 2])] {
            coverage.compare(&belief(1015, x_m, 1e-4));
            assert_eq!(coverage.covered().inside, inside, "{x_m}");
        }
        assert_eq!(coverage.covered().places, 3);
    }

    #[test]
    fn beliefs_beyond_the_samples_and_of_absent_users_do_not_count() {
        let mut coverage = coverage(&[1000, 1010]);
        coverage.compare(&belief(990, 1.0, 1e-4));
        coverage.compare(&belief(1011, 1.0, 1e-4));
        coverage.samples[1].users.clear();
        coverage.compare(&belief(1005, 1.005, 1e-4));
        assert_eq!(coverage.covered(), Covered::default());
    }
}
