//! Checks of the keys of all mobility models.

use crate::check::{check_orientation, count, invalid, place, within};
use crate::error::ScenarioError;
use crate::mobility::{MobilityModel, SmoothRandom, SocialForce};
use crate::tables::{Room, Users};

/// Largest number of entries of `users.mixture`.
pub(crate) const SHARES_MAX: usize = 16;
/// Distance of the sum of all shares from 1 that rounding explains.
const SHARE_ROUNDING: f64 = 1e-6;

impl Users {
    /// Checks the keys of all mobility models.
    ///
    /// # Errors
    /// [`ScenarioError::Invalid`] for the first value outside its domain.
    pub(crate) fn check_mobility(&self, room: &Room) -> Result<(), ScenarioError> {
        within("users.pause_mean_s", self.pause_mean_s, 0.0..=1e4)?;
        within("users.heading_lag_s", self.heading_lag_s, 0.0..=60.0)?;
        within("users.random_direction.travel_time_mean_s", self.random_direction.travel_time_mean_s, 0.1..=1e4)?;
        let gauss_markov = &self.gauss_markov;
        within("users.gauss_markov.memory", gauss_markov.memory, 0.0..=0.9999)?;
        within("users.gauss_markov.interval_s", gauss_markov.interval_s, 0.02..=1e3)?;
        within("users.gauss_markov.direction_std_deg", gauss_markov.direction_std_deg, 0.0..=360.0)?;
        self.smooth_random.check()?;
        self.social_force.check()?;
        within("users.seated.turn_mean_s", self.seated.turn_mean_s, 0.1..=1e6)?;
        within("users.seated.spacing_m", self.seated.spacing_m, 0.0..=10.0)?;
        self.check_mixture()?;
        self.check_seats(room)
    }

    fn check_seats(&self, room: &Room) -> Result<(), ScenarioError> {
        let [x, y] = room.floor_m();
        let domains = [("x", x), ("y", y)];
        self.seats_m.iter().try_for_each(|seat| place("users.seats_m", seat, &domains))?;
        if self.seats_m.is_empty() {
            return Ok(());
        }
        // A user without a seat of its own would sit at a place drawn at random.
        count("users.seats_m (entries)", self.seats_m.len(), self.seated_least()..=1024)?;
        let is_taken = |(index, seat): &(usize, &[f64; 2])| self.seats_m[..*index].contains(*seat);
        match self.seats_m.iter().enumerate().find(is_taken) {
            Some((_, [x, y])) => invalid("users.seats_m", format!("[{x}, {y}]"), "expected each seat once"),
            None => Ok(()),
        }
    }

    /// Number of users who sit whatever the seed: the shares of a mixture leave it open.
    fn seated_least(&self) -> usize {
        let entries = self.mixture.iter().filter(|entry| entry.mobility == MobilityModel::Seated);
        match self.mobility {
            MobilityModel::Seated => self.count,
            MobilityModel::Mixture => entries.filter_map(|entry| entry.count).sum(),
            _ => 0,
        }
    }

    fn check_mixture(&self) -> Result<(), ScenarioError> {
        let least = usize::from(self.mobility == MobilityModel::Mixture);
        count("users.mixture (entries)", self.mixture.len(), least..=SHARES_MAX)?;
        for (index, entry) in self.mixture.iter().enumerate() {
            if let Some(orientation) = &entry.orientation {
                check_orientation(&format!("users.mixture.{index}.orientation"), orientation)?;
            }
            within("users.mixture (share)", entry.share, 0.0..=1.0)?;
            if entry.count.is_some() && entry.share != 0.0 {
                return invalid("users.mixture (share)", entry.share, "expected share or count, not both");
            }
            if entry.mobility == MobilityModel::Mixture {
                return invalid("users.mixture (mobility)", "mixture", "expected one of the other models");
            }
        }
        let counted: usize = self.mixture.iter().filter_map(|entry| entry.count).fold(0, usize::saturating_add);
        if counted > self.count {
            let expected = format!("expected at most users.count = {}", self.count);
            return invalid("users.mixture (sum of the counts)", counted, &expected);
        }
        let has_shares = self.mixture.iter().any(|entry| entry.count.is_none());
        let sum: f64 = self.mixture.iter().map(|entry| entry.share).sum();
        if has_shares && (sum - 1.0).abs() > SHARE_ROUNDING {
            return invalid("users.mixture (sum of the shares)", sum, "expected shares that add up to 1");
        }
        let are_all_counted = counted == self.count && self.arrivals.is_none();
        if !has_shares && !are_all_counted && self.mobility == MobilityModel::Mixture {
            let expected = "expected every user, or one more entry with share = 1 for the others";
            return invalid("users.mixture (sum of the counts)", counted, expected);
        }
        Ok(())
    }
}

impl SmoothRandom {
    fn check(&self) -> Result<(), ScenarioError> {
        within("users.smooth_random.acceleration_m_s2", self.acceleration_m_s2, 0.01..=100.0)?;
        within("users.smooth_random.deceleration_m_s2", self.deceleration_m_s2, 0.01..=100.0)?;
        within("users.smooth_random.turn_rate_deg_per_s", self.turn_rate_deg_per_s, 1.0..=3600.0)?;
        within("users.smooth_random.speed_change_mean_s", self.speed_change_mean_s, 0.1..=1e4)?;
        within("users.smooth_random.direction_change_mean_s", self.direction_change_mean_s, 0.1..=1e4)
    }
}

impl SocialForce {
    fn check(&self) -> Result<(), ScenarioError> {
        within("users.social_force.desired_speed_m_s", self.desired_speed_m_s, 0.01..=5.0)?;
        within("users.social_force.desired_speed_std_m_s", self.desired_speed_std_m_s, 0.0..=2.0)?;
        within("users.social_force.relaxation_s", self.relaxation_s, 0.05..=60.0)?;
        within("users.social_force.user_repulsion_m2_s2", self.user_repulsion_m2_s2, 0.0..=100.0)?;
        within("users.social_force.user_range_m", self.user_range_m, 0.05..=10.0)?;
        within("users.social_force.anticipation_s", self.anticipation_s, 0.0..=10.0)?;
        within("users.social_force.wall_repulsion_m2_s2", self.wall_repulsion_m2_s2, 0.0..=100.0)?;
        within("users.social_force.wall_range_m", self.wall_range_m, 0.05..=10.0)?;
        within("users.social_force.sight_deg", self.sight_deg, 0.0..=360.0)?;
        within("users.social_force.out_of_sight_weight", self.out_of_sight_weight, 0.0..=1.0)
    }
}
