//! Filling the tables of a scene: who serves whom, what is blocked, what each mirror can give.

use super::Scene;
use super::legs::mark_visible;
use crate::Vec3;
use crate::blockage::{Cylinder, blocks};
use crate::los::unit_gain;
use crate::model::ChannelModel;
use crate::wide::widest;

impl Scene {
    /// Recomputes blockage of each leg, direct gains and the steering table for these positions.
    ///
    /// `users`: positions of the receivers in m, shape K. `blockers`: every cylinder in the room, the users' own bodies among them.
    /// `forced`: whether the direct path of each user is off whatever stands there, shape K. A leg runs from the centre of the panel over the centre of the
    /// mirror to the detector.
    ///
    /// # Panics
    /// When `users` or `forced` has not one entry a user, or the model is not the one (or the like) that the scene was made for.
    pub fn update(&mut self, model: &ChannelModel, users: &[Vec3], blockers: &[Cylinder], forced: &[bool]) {
        assert_eq!(forced.len(), self.users, "one flag a user");
        assert_eq!(model.mirrors.len(), self.mirrors, "the scene was made for another array");
        assert_eq!(model.receiver.branches.len(), self.branches, "the scene was made for another receiver");
        assert_eq!(model.leds.len() * self.mirrors, self.led_leg.len(), "the scene was made for other LEDs");
        self.positions.copy_from_slice(users);
        widest(
            #[inline(always)]
            || {
                for (led, legs) in self.led_leg.chunks_exact_mut(self.mirrors).enumerate() {
                    mark_visible(legs, &model.mirrors, &model.leds[led].position, blockers);
                }
                for (user, forced) in forced.iter().enumerate() {
                    self.update_user(model, blockers, user, *forced);
                }
            },
        );
    }

    #[inline(always)]
    fn update_user(&mut self, model: &ChannelModel, blockers: &[Cylinder], user: usize, forced: bool) {
        let position = self.positions[user];
        let pairs = user * self.mirrors..(user + 1) * self.mirrors;
        mark_visible(&mut self.leg_visible[pairs.clone()], &model.mirrors, &position, blockers);
        let led = self.choose_led(model, blockers, user, forced);
        self.serving[user] = led;
        self.direct(model, user, led);
        let blocked = forced || is_blocked(model, blockers, led, &position);
        self.los_blocked[user] = blocked;
        let branches = user * self.branches..(user + 1) * self.branches;
        if blocked {
            self.los_branch[branches.clone()].fill(0.0);
        } else {
            self.los_branch[branches.clone()].copy_from_slice(&self.los_clear[branches.clone()]);
        }
        self.los_gain[user] = self.combining.combine(&self.los_branch[branches]);
        let legs = &self.led_leg[led * self.mirrors..(led + 1) * self.mirrors];
        self.leg_visible[pairs].iter_mut().zip(legs).for_each(|(both, leg)| *both &= leg);
        self.steer(model, user, led);
    }

    /// The LED with the largest clear direct gain, or the one whose light the array can bring most of.
    fn choose_led(&mut self, model: &ChannelModel, blockers: &[Cylinder], user: usize, forced: bool) -> usize {
        if model.leds.len() == 1 {
            return 0;
        }
        let branches = user * self.branches..(user + 1) * self.branches;
        let mut best = (0, 0.0, 0.0);
        for led in 0..model.leds.len() {
            self.direct(model, user, led);
            let clear = !forced && !is_blocked(model, blockers, led, &self.positions[user]);
            let direct = if clear { self.combining.combine(&self.los_clear[branches.clone()]) } else { 0.0 };
            self.steer(model, user, led);
            let legs = &self.led_leg[led * self.mirrors..(led + 1) * self.mirrors];
            let row = &self.steering_gain[user * self.mirrors..(user + 1) * self.mirrors];
            let steered: f64 = row.iter().zip(legs).filter(|(_, leg)| **leg).map(|(gain, _)| gain).sum();
            if (direct, steered) > (best.1, best.2) {
                best = (led, direct, steered);
            }
        }
        best.0
    }

    /// Writes the direct gain of each branch with nothing in the way.
    #[inline(always)]
    fn direct(&mut self, model: &ChannelModel, user: usize, led: usize) {
        let panel = &model.panels[led];
        let clear = &mut self.los_clear[user * self.branches..(user + 1) * self.branches];
        for (out, detector) in clear.iter_mut().zip(&model.detectors) {
            let branch = (&detector.normal, detector.fov_cosine);
            let gain = |point| unit_gain(point, panel.order, branch, &self.positions[user]);
            *out = panel.front * detector.concentrator_gain * panel.points.iter().map(gain).sum::<f64>();
        }
    }
}

fn is_blocked(model: &ChannelModel, blockers: &[Cylinder], led: usize, user: &Vec3) -> bool {
    blockers.iter().any(|blocker| blocks(blocker, &model.leds[led].position, user))
}
