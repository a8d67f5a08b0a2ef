//! Faults of single mirrors, and the random choice of the mirrors that have them.

use crate::random::{self, Purpose};

/// The fault of one axis.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum AxisFault {
    /// The axis follows its commands.
    #[default]
    None,
    /// The axis does not move.
    Stuck,
    /// The axis has no drive and returns to 0.
    Dead,
    /// The axis turns in the wrong direction.
    Flipped,
}

impl AxisFault {
    /// The angle to which a faulty axis at `angle` turns when its command is `target`.
    pub(super) fn faulty_target(self, target: f64, angle: f64) -> f64 {
        match self {
            Self::None => target,
            Self::Stuck => angle,
            Self::Dead => 0.0,
            Self::Flipped => -target,
        }
    }
}

/// A share of the mirrors, drawn without repetition.
pub fn drawn_share(share: f64, seed: u64, mirrors: usize) -> Vec<usize> {
    let mut rng = random::stream(seed, Purpose::Faults, 0);
    let mut order: Vec<usize> = (0..mirrors).collect();
    let count = (share * mirrors as f64).round() as usize;
    for position in 0..count {
        let other = position + (random::uniform(&mut rng) * (mirrors - position) as f64) as usize;
        order.swap(position, other);
    }
    order.truncate(count);
    order
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_share_has_its_size_and_is_the_same_for_the_same_seed() {
        let draw = |share, seed| drawn_share(share, seed, 100);
        let mut all = draw(1.0, 3);
        all.sort_unstable();
        assert_eq!(all, (0..100).collect::<Vec<_>>());
        assert_eq!(draw(0.3, 3).len(), 30);
        assert_eq!(draw(0.3, 3), draw(0.3, 3));
        assert_ne!(draw(0.3, 3), draw(0.3, 4));
        assert_eq!(draw(0.0, 3), Vec::<usize>::new());
    }
}
