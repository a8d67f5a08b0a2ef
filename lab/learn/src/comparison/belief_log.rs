//! The errors of the belief in an episode: predicted places and headings against the true ones.
//!
//! After each decision the log keeps what the controller believes about each user at the instant
//! for which it predicts, the middle of the command's time in force. The truth comes from a second
//! world of the same seed after the run, so that the measurement neither changes the run nor takes
//! part in its decision times. The same pairs of truth and belief make a picture of an episode.

use heliostat_channel::Vec3;
use heliostat_channel::floor_normal::{squared_distance, squared_radius};
use heliostat_core::belief::Estimate;
use heliostat_core::core::Controller;
use heliostat_room::world::World;
use heliostat_room::world::walker::Walker;

use super::tracked_user::TrackedUser;

/// Below this true speed in m/s a user stands.
const STANDING_M_S: f64 = 0.05;

/// What the controller believed about a user.
#[derive(Clone, Copy, Debug)]
struct Believed {
    user: u32,
    position: Vec3,
    /// Unit vector, or zero while unknown.
    heading: Vec3,
    estimate: Option<Estimate>,
}

/// The belief after each decision of an episode.
#[derive(Clone, Debug, Default)]
pub(super) struct BeliefLog {
    /// The predicted instant in ns, and the users.
    entries: Vec<(u64, Vec<Believed>)>,
}

/// The errors of one episode.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Errors {
    /// Distances on the floor from the predicted to the true place, in cm.
    pub place_cm: Vec<f64>,
    /// Angles between believed and true heading of users who walk, in degrees.
    pub walking_deg: Vec<f64>,
    /// The same of users who stand.
    pub standing_deg: Vec<f64>,
    /// 1 within the ellipse that should contain half of the true places, 0 outside it.
    pub within_50: Vec<f64>,
    /// The same for 95 %.
    pub within_95: Vec<f64>,
}

impl BeliefLog {
    /// Notes the belief after a decision at `now_ns`.
    pub fn note(&mut self, controller: &Controller, now_ns: u64) {
        let (observation, observer) = (controller.observation(), controller.observer());
        let lead_s = observer.lead_s();
        let reported_ns = controller.inbox().users().map_or(now_ns, |report| report.stamp.time_ns);
        let ahead_s = now_ns.saturating_sub(reported_ns) as f64 * 1e-9 + lead_s;
        let users = observation.ids.iter().zip(&observation.positions).enumerate().map(|(slot, (user, position))| {
            let heading = observer.heading(slot);
            let estimate = observer.belief().and_then(|belief| belief.estimate(*user, ahead_s));
            Believed { user: *user, position: *position, heading, estimate }
        });
        self.entries.push((now_ns + (lead_s * 1e9) as u64, users.collect()));
    }

    /// The errors of the predictions for instants from `from_ns` on, against a world at time 0.
    pub fn errors(&self, world: World, from_ns: u64) -> Errors {
        let mut errors = Errors::default();
        self.compare(world, from_ns, |_, believed, truth| errors.add(believed, truth));
        errors
    }

    /// The users that the filter predicted from `from_ns` on, beside a world at time 0.
    pub fn tracked(&self, world: World, from_ns: u64) -> Vec<TrackedUser> {
        let mut tracked = Vec::new();
        self.compare(world, from_ns, |at_ns, believed, truth| {
            let after_s = (at_ns - from_ns) as f64 * 1e-9;
            let Believed { user, heading, estimate: Some(estimate), .. } = believed else { return };
            tracked.push(TrackedUser::new((*user, after_s), (truth, estimate), heading));
        });
        tracked
    }

    /// Calls with each prediction from `from_ns` on: its instant, the belief and the truth.
    fn compare(&self, mut world: World, from_ns: u64, mut with: impl FnMut(u64, &Believed, &Walker)) {
        let mut now_ns = 0;
        for (at_ns, users) in self.entries.iter().filter(|(at_ns, _)| *at_ns >= from_ns) {
            world.step(at_ns.saturating_sub(now_ns) as f64 * 1e-9);
            now_ns = now_ns.max(*at_ns);
            for believed in users {
                // A user who has left meanwhile has no true place.
                let index = world.ids().iter().position(|id| *id == believed.user);
                if let Some(truth) = index.map(|index| &world.users()[index]) {
                    with(*at_ns, believed, truth);
                }
            }
        }
    }
}

impl Errors {
    fn add(&mut self, believed: &Believed, truth: &Walker) {
        let away = believed.position - truth.position;
        self.place_cm.push(100.0 * away.x.hypot(away.y));
        if believed.heading != Vec3::zeros() {
            let cos = believed.heading.x * truth.direction[0] + believed.heading.y * truth.direction[1];
            let error_deg = cos.clamp(-1.0, 1.0).acos().to_degrees();
            let stands = truth.velocity[0].hypot(truth.velocity[1]) < STANDING_M_S;
            if stands { self.standing_deg.push(error_deg) } else { self.walking_deg.push(error_deg) }
        }
        let away_m = [away.x, away.y];
        let squared = believed.estimate.and_then(|estimate| squared_distance(away_m, estimate.position_cov_m2));
        if let Some(squared) = squared {
            for (share, within) in [(0.5, &mut self.within_50), (0.95, &mut self.within_95)] {
                within.push(f64::from(u8::from(squared <= squared_radius(share))));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn estimate(position_cov_m2: [f64; 3]) -> Estimate {
        Estimate { position: Vec3::new(1.0, 2.0, 0.85), position_cov_m2, ..Estimate::default() }
    }

    fn truth(position: [f64; 2], direction: [f64; 2], speed: f64) -> Walker {
        let velocity = direction.map(|component| component * speed);
        Walker { position: Vec3::new(position[0], position[1], 0.9), direction, velocity }
    }

    #[test]
    fn errors_are_those_on_the_floor_and_standing_users_count_apart() {
        let believed = |heading: [f64; 2]| Believed {
            user: 3,
            position: Vec3::new(1.0, 2.0, 0.85),
            heading: Vec3::new(heading[0], heading[1], 0.0),
            estimate: Some(estimate([0.01, 0.0, 0.01])),
        };
        let mut errors = Errors::default();
        errors.add(&believed([1.0, 0.0]), &truth([1.03, 2.04], [0.0, 1.0], 1.0));
        errors.add(&believed([1.0, 0.0]), &truth([1.3, 2.0], [-1.0, 0.0], 0.04));
        errors.add(&Believed { estimate: None, ..believed([0.0, 0.0]) }, &truth([1.0, 2.0], [1.0, 0.0], 1.0));
        assert!(errors.place_cm.iter().zip([5.0, 30.0, 0.0]).all(|(found, expected)| (found - expected).abs() < 1e-9));
        assert_eq!((&errors.walking_deg[..], &errors.standing_deg[..]), (&[90.0][..], &[180.0][..]));
        assert_eq!((&errors.within_50[..], &errors.within_95[..]), (&[1.0, 0.0][..], &[1.0, 0.0][..]));
    }
}
