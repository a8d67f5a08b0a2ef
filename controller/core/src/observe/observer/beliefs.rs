//! The belief about the users of the last decision, as a message for viewers.

use heliostat_channel::{Body, ChannelModel, Vec3, blockage, blockage::Cylinder};
use heliostat_proto::{BeliefReport, Nanos, Obstacle, UserBelief};

use super::Observer;
use crate::{
    belief::{Belief, Estimate, heading::HEADINGS},
    input::inbox::Inbox,
    observe::observation::Observation,
};

impl Observer {
    /// Fills a report with the belief by which `observation` was made at `now`; its stamp is the
    /// caller's. False, without a change, where there is no belief or no position report. Does not
    /// allocate in a report with memory for all users.
    pub fn report_beliefs(
        &self,
        model: &ChannelModel,
        inbox: &Inbox,
        (observation, now): (&Observation, Nanos),
        report: &mut BeliefReport,
    ) -> bool {
        let (Some(users), Some(belief)) = (inbox.users(), &self.belief) else { return false };
        let age_s = super::age_s(users, now);
        let ahead_s = self.lead.ahead_s(age_s);
        report.tick = users.tick;
        report.holds_ns = users.stamp.time_ns.saturating_add((ahead_s.max(0.0) * 1e9).round() as Nanos);
        report.users.clear();
        for user in &observation.ids {
            let Some(estimate) = self.estimate(*user, age_s) else { continue };
            let heading = estimate.heading;
            report.users.push(UserBelief {
                user: *user,
                heading_rad: heading.y.atan2(heading.x) as f32,
                heading_certainty: heading.norm().min(1.0) as f32,
                blocked_probability: (1.0 - estimate.direct_clear).clamp(0.0, 1.0) as f32,
                ..of_estimate(&estimate)
            });
        }
        let bodies = Bodies { belief, shape: self.body.as_ref(), obstacles: surveyed(inbox) };
        let measured = inbox.channel(now).filter(|_| belief.knows_obstacles());
        for index in 0..report.users.len() {
            let UserBelief { user, blocked_probability, .. } = report.users[index];
            let is_blocked = |slot: usize| observation.scene.los_blocked().get(slot).is_some_and(|blocked| *blocked);
            let uncovered = 1.0 - blocked_probability;
            let clear = match measured.is_some_and(|channel| channel.users.iter().any(|entry| entry.user == user)) {
                // Where all obstacles are reported, the last measurement decides.
                true if observation.ids.iter().position(|id| *id == user).is_some_and(is_blocked) => 0.0,
                true => uncovered,
                false => uncovered * bodies.clear(model, &report.users, index) as f32,
            };
            report.users[index].blocked_probability = (1.0 - clear).clamp(0.0, 1.0);
        }
        true
    }
}

/// The surveyed obstacles.
fn surveyed(inbox: &Inbox) -> &[Obstacle] {
    inbox.obstacles().map_or(&[], |report| &report.obstacles)
}

/// What blocks direct paths besides unreported obstacles.
struct Bodies<'a> {
    belief: &'a Belief,
    shape: Option<&'a Body>,
    obstacles: &'a [Obstacle],
}

impl Bodies<'_> {
    /// Probability that the direct path from some LED to the user of this index is clear past all bodies
    /// and surveyed obstacles, over all headings of all users. The headings of different users are
    /// taken as independent, and so are the paths from different LEDs at one heading of the user.
    fn clear(&self, model: &ChannelModel, users: &[UserBelief], index: usize) -> f64 {
        let at = position(&users[index]);
        let Some(probabilities) = self.belief.heading_distribution(users[index].user) else { return 1.0 };
        let mut blocked = [1.0; HEADINGS];
        for led in &model.leds {
            let by_others = 1.0 - self.clear_past_others(&led.position, users, index);
            for (heading, blocked) in blocked.iter_mut().enumerate() {
                let own = self.shape.map(|shape| shape.behind(&at, self.belief.direction(heading)));
                let by_own = own.is_some_and(|own| blockage::blocks(&own, &led.position, &at));
                *blocked *= if by_own { 1.0 } else { by_others };
            }
        }
        probabilities.iter().zip(blocked).map(|(probability, blocked)| probability * (1.0 - blocked)).sum()
    }

    /// Probability that surveyed obstacles and the bodies of other users leave the path from an LED to a
    /// user clear.
    fn clear_past_others(&self, led: &Vec3, users: &[UserBelief], index: usize) -> f64 {
        let at = position(&users[index]);
        if self.obstacles.iter().any(|obstacle| blockage::blocks(&Cylinder::from(obstacle), led, &at)) {
            return 0.0;
        }
        let Some(shape) = self.shape else { return 1.0 };
        let others = users.iter().enumerate().filter(|(other, _)| *other != index).map(|(_, other)| other);
        let blocks = |body: &Cylinder| blockage::blocks(body, led, &at);
        // A body of any heading is within this cylinder.
        let near = others.filter(|other| blocks(&shape.around(&position(other))));
        near.filter_map(|other| Some((position(other), self.belief.heading_distribution(other.user)?)))
            .map(|(place, heading)| {
                let clear = |heading: &usize| !blocks(&shape.behind(&place, self.belief.direction(*heading)));
                let indices = (0..heading.len()).filter(clear);
                indices.map(|index| heading[index]).sum::<f64>()
            })
            .product()
    }
}

fn position(user: &UserBelief) -> Vec3 {
    Vec3::from_iterator(user.position_m.map(f64::from))
}

/// Place, velocity and covariance. The covariance is cut to the bound of the contract, which
/// rounding to f32 can exceed.
fn of_estimate(estimate: &Estimate) -> UserBelief {
    let Estimate { position, velocity, position_cov_m2: [xx, xy, yy], .. } = estimate;
    let (xx_m2, yy_m2) = (xx.max(0.0) as f32, yy.max(0.0) as f32);
    let most = (f64::from(xx_m2) * f64::from(yy_m2)).sqrt();
    UserBelief {
        position_m: [position.x as f32, position.y as f32, position.z as f32],
        velocity_m_s: [velocity.x as f32, velocity.y as f32],
        xx_m2,
        xy_m2: xy.clamp(-most, most) as f32,
        yy_m2,
        ..UserBelief::default()
    }
}
