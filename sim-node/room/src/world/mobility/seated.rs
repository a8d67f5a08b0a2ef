//! A user at a fixed place, who turns to a direction drawn uniformly at exponential times.

use heliostat_scenario::Seated as Settings;

use crate::random::{self, RoomRng};
use crate::world::mobility::motion::{Motion, draw_direction};

/// One seated user.
#[derive(Clone, Debug)]
pub struct Seated {
    at: [f64; 2],
    facing: [f64; 2],
    turn_mean_s: f64,
    /// Time until the next turn in s.
    left_s: f64,
    rng: RoomRng,
}

impl Seated {
    /// A user at a place; the generator belongs to this user.
    pub fn new(settings: &Settings, at: [f64; 2], mut rng: RoomRng) -> Self {
        let facing = draw_direction(&mut rng);
        let left_s = random::exponential(&mut rng, settings.turn_mean_s);
        Self { at, facing, turn_mean_s: settings.turn_mean_s, left_s, rng }
    }

    /// Sits on for `dt_s` seconds, over as many turns as that takes.
    pub fn step(&mut self, dt_s: f64) {
        self.left_s -= dt_s;
        while self.left_s <= 0.0 {
            self.facing = draw_direction(&mut self.rng);
            self.left_s += random::exponential(&mut self.rng, self.turn_mean_s);
        }
    }

    /// Where the user is now.
    pub fn motion(&self) -> Motion {
        Motion::standing(self.at, self.facing)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Purpose, stream};

    #[test]
    fn a_seated_user_stays_and_turns_at_the_mean_rate() {
        let settings = Settings { turn_mean_s: 2.0, ..Settings::default() };
        let mut user = Seated::new(&settings, [1.0, -0.5], stream(1, Purpose::Walk, 0));
        let mut turns = 0;
        for _ in 0..100_000 {
            let before = user.motion();
            user.step(0.02);
            assert_eq!((user.motion().at, user.motion().velocity), ([1.0, -0.5], [0.0; 2]));
            turns += usize::from(user.motion().facing != before.facing);
        }
        // 2000 s with a turn every 2 s.
        assert!((900..1100).contains(&turns), "{turns}");
    }
}
