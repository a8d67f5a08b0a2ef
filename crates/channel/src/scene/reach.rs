//! Steering gains within the mechanical range of the mirrors.

use std::ops::{Range, RangeInclusive};

use super::Scene;
use crate::aiming::bisect;
use crate::model::{ChannelModel, Mode};
use crate::simd::with_widest_simd;
use crate::specular::Plate;
use crate::trig::BLOCK;

impl Scene {
    /// Sets the steering gains to zero for mirrors that cannot be aimed at a user within these
    /// ranges, until the next update.
    ///
    /// The required angles are those of [`decode`](crate::decode::decode) by the law of reflection.
    /// An angle outside its range is clamped; the steering gain stays if the ray from the centre of
    /// the LED still reaches the user. In paper mode the call has no effect, since no pair has
    /// angles of its own.
    ///
    /// `roll`, `yaw`: mechanical, in radians.
    pub fn restrict_to_range(&mut self, model: &ChannelModel, roll: &RangeInclusive<f64>, yaw: &RangeInclusive<f64>) {
        self.restrict_array_to_range(model, 0..self.mirrors, [roll, yaw]);
    }

    /// The same for some of the mirrors, for example those of an array. `ranges`: roll, then yaw.
    pub fn restrict_array_to_range(
        &mut self,
        model: &ChannelModel,
        mirrors: Range<usize>,
        ranges: [&RangeInclusive<f64>; 2],
    ) {
        if model.mode != Mode::Specular {
            return;
        }
        with_widest_simd(
            #[inline(always)]
            || self.restrict(model, &mirrors, ranges),
        );
    }

    #[inline(always)]
    fn restrict(&mut self, model: &ChannelModel, mirrors: &Range<usize>, [roll, yaw]: [&RangeInclusive<f64>; 2]) {
        let clamp = |angle: f64, range: &RangeInclusive<f64>| angle.clamp(*range.start(), *range.end());
        for user in 0..self.users {
            let (led, position) = (model.leds[self.serving[user]].position, self.positions[user]);
            let target = [0, 1, 2].map(|axis| [position[axis]; BLOCK]);
            let pairs = user * self.mirrors..(user + 1) * self.mirrors;
            let rows = self.steering_gain[pairs.clone()].chunks_mut(BLOCK).zip(self.can_aim[pairs].chunks_mut(BLOCK));
            for (index, (gains, can_aim)) in rows.enumerate() {
                let first = index * BLOCK;
                if first >= mirrors.end || first + BLOCK <= mirrors.start {
                    continue;
                }
                let (rolls, yaws) =
                    bisect(&model.mirrors, index, model.directions_to_led(self.serving[user], index), &target);
                let within = |lane: usize| roll.contains(&rolls[lane]) && yaw.contains(&yaws[lane]);
                for lane in (0..gains.len()).filter(|lane| !within(*lane) && mirrors.contains(&(first + *lane))) {
                    let plate =
                        Plate::of(&model.mirrors, first + lane, clamp(rolls[lane], roll), clamp(yaws[lane], yaw));
                    if plate.path(&led, &position).is_none() {
                        gains[lane] = 0.0;
                        can_aim[lane] = false;
                    }
                }
            }
        }
    }
}
