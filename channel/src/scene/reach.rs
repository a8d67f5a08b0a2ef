//! Which mirrors can light whom within the range of their axes.

use std::ops::RangeInclusive;

use super::Scene;
use crate::decode::{bisect, towards};
use crate::model::{ChannelModel, Mode};
use crate::specular::Plate;
use crate::trig::BLOCK;

impl Scene {
    /// Takes each pair of a mirror and a user out of what can be decided whose light would not arrive with the angles cut to these ranges, until
    /// the next update. Its light may still stray there.
    ///
    /// The angles are those of the law of reflection, which [`decode`](crate::decode::decode) would give. Where they are cut, light arrives if the ray from the
    /// middle of the LED over the mirror does. Under the paper's equations no pair has an angle of its own, and nothing changes.
    /// `roll`, `yaw`: mechanical, in rad.
    pub fn keep_in_reach(&mut self, model: &ChannelModel, roll: &RangeInclusive<f64>, yaw: &RangeInclusive<f64>) {
        if model.mode != Mode::Specular {
            return;
        }
        let cut = |angle: f64, range: &RangeInclusive<f64>| angle.clamp(*range.start(), *range.end());
        for user in 0..self.users {
            let (led, position) = (model.leds[self.serving[user]].position, self.positions[user]);
            let target = [0, 1, 2].map(|axis| [position[axis]; BLOCK]);
            let row = &mut self.steering_gain[user * self.mirrors..(user + 1) * self.mirrors];
            for (index, gains) in row.chunks_mut(BLOCK).enumerate() {
                let first = index * BLOCK;
                let (rolls, yaws) = bisect(&model.mirrors, index, towards(model, self.serving[user], index), &target);
                let within = |lane: usize| roll.contains(&rolls[lane]) && yaw.contains(&yaws[lane]);
                for lane in (0..gains.len()).filter(|lane| !within(*lane)) {
                    let plate = Plate::of(&model.mirrors, first + lane, cut(rolls[lane], roll), cut(yaws[lane], yaw));
                    if plate.path(&led, &position).is_none() {
                        gains[lane] = 0.0;
                    }
                }
            }
        }
    }
}
