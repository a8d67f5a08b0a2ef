//! Where a promise of a policy does not hold in a room.

use heliostat_scenario::Scenario;

use super::PolicyKind;
use crate::{belief::conditions::Condition, observe::observation::USERS_CAPACITY};

impl PolicyKind {
    /// What a policy does not do in a valid scenario, in the form of the
    /// [conditions](crate::belief::conditions) of the belief.
    pub fn conditions(self, scenario: &Scenario) -> Vec<Condition> {
        let mut found = Vec::new();
        let name = self.name();
        if self.is_ended_by_clock(scenario) {
            found.push(Condition {
                method: format!("the promise of equal runs of {name}"),
                because: format!("control.search_time_us = {}", scenario.control.search_time_us),
                consequence:
                    "the search ends by the clock, so a faster or idle machine gives higher rates; set it to 0".into(),
            });
        }
        let users = &scenario.users;
        let most = users.arrivals.as_ref().map_or(users.count, |arrivals| arrivals.max_users);
        if self.is_learned() && !self.fits_any_array() && most > USERS_CAPACITY {
            found.push(Condition {
                method: format!("the service of every user by {name}"),
                because: format!("up to {most} users, and an actor of {USERS_CAPACITY} slots"),
                consequence: "the users with the smallest minimum rates get no mirrors; choose ddpg or fixed-point"
                    .into(),
            });
        }
        found
    }

    /// Whether the clock ends the search of the policy in a scenario, so that the speed of the machine changes its
    /// angles.
    pub fn is_ended_by_clock(self, scenario: &Scenario) -> bool {
        matches!(self, Self::SineCosine | Self::Pso) && scenario.control.search_time_us > 0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_promise_that_does_not_hold_is_named_with_its_cause() {
        let of = |kind: PolicyKind, overrides: &[&str]| {
            kind.conditions(&Scenario::builtin("hall").unwrap().with_overrides(overrides).unwrap())
        };
        assert!(of(PolicyKind::FixedPoint, &["users.count=12"]).is_empty());
        assert!(of(PolicyKind::Ddpg, &["users.count=12"]).is_empty(), "one row of the network for each user");
        for (kind, change, part) in [
            (PolicyKind::Pso, "control.search_time_us=400", "control.search_time_us = 400"),
            (PolicyKind::DdpgRaw, "users.count=12", "12 users"),
        ] {
            let found = of(kind, &[change]);
            assert!(found.len() == 1 && found[0].to_string().contains(part), "{change}: {found:?}");
        }
        assert!(of(PolicyKind::Pso, &["control.search_time_us=0"]).is_empty());
    }
}
