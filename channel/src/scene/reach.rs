//! Which mirrors can be aimed at whom within the range of their axes.

use std::ops::RangeInclusive;

use super::Scene;
use crate::decode::bisect;
use crate::model::{ChannelModel, Mode};
use crate::trig::BLOCK;

impl Scene {
    /// Takes each pair of a mirror and a user out of what can be decided at which the mirror would have to turn beyond these ranges, until
    /// the next update. Its light may still stray there.
    ///
    /// The angles are those of the law of reflection, which [`decode`](crate::decode::decode) would give; under the paper's equations no pair
    /// has an angle of its own, and nothing changes. `roll`, `yaw`: mechanical, in rad.
    pub fn keep_in_reach(&mut self, model: &ChannelModel, roll: &RangeInclusive<f64>, yaw: &RangeInclusive<f64>) {
        if model.mode != Mode::Specular {
            return;
        }
        for user in 0..self.users {
            let led = model.leds[self.serving[user]].position;
            let from = [0, 1, 2].map(|axis| [led[axis]; BLOCK]);
            let to = [0, 1, 2].map(|axis| [self.positions[user][axis]; BLOCK]);
            let row = &mut self.steering_gain[user * self.mirrors..(user + 1) * self.mirrors];
            for (index, gains) in row.chunks_mut(BLOCK).enumerate() {
                let (rolls, yaws) = bisect(&model.mirrors, index * BLOCK, &from, &to);
                for (lane, gain) in gains.iter_mut().enumerate() {
                    let reached = roll.contains(&rolls[lane]) && yaw.contains(&yaws[lane]);
                    *gain = if reached { *gain } else { 0.0 };
                }
            }
        }
    }
}
