//! The replay buffer: a ring of transitions in flat arrays.

use rand::{Rng, RngExt};

/// What one transition holds, as row lengths: `[features, logits, rewards, next features]`.
pub type Widths = [usize; 4];

/// One transition, borrowed: the state's features, the action's logits, the reward of each user, the next state's features.
pub type Transition<'a> = [&'a [f32]; 4];

/// A ring of the last transitions.
#[derive(Clone, Debug, PartialEq)]
pub struct Replay {
    capacity: usize,
    widths: Widths,
    columns: [Vec<f32>; 4],
    length: usize,
    next: usize,
}

impl Replay {
    /// An empty buffer.
    pub fn new(capacity: usize, widths: Widths) -> Self {
        Self { capacity, widths, columns: widths.map(|width| Vec::with_capacity(width * capacity)), length: 0, next: 0 }
    }

    /// Transitions held.
    pub fn len(&self) -> usize {
        self.length
    }

    /// Whether it holds none.
    pub fn is_empty(&self) -> bool {
        self.length == 0
    }

    /// Adds a transition; the oldest gives way when the buffer is full.
    ///
    /// # Panics
    /// When a part has another length than the buffer was made for.
    pub fn push(&mut self, transition: Transition<'_>) {
        for ((column, part), width) in self.columns.iter_mut().zip(transition).zip(self.widths) {
            assert_eq!(part.len(), width, "a transition part has the wrong length");
            if self.length < self.capacity {
                column.extend_from_slice(part);
            } else {
                column[self.next * width..][..width].copy_from_slice(part);
            }
        }
        self.length = (self.length + 1).min(self.capacity);
        self.next = (self.next + 1) % self.capacity;
    }

    /// Draws `count` transitions with replacement; each part comes as one flat array.
    ///
    /// # Panics
    /// When the buffer is empty.
    pub fn sample(&self, count: usize, rng: &mut impl Rng) -> [Vec<f32>; 4] {
        let rows: Vec<usize> = (0..count).map(|_| rng.random_range(0..self.length)).collect();
        std::array::from_fn(|part| {
            let width = self.widths[part];
            rows.iter().flat_map(|row| &self.columns[part][row * width..][..width]).copied().collect()
        })
    }

    /// The four columns and the place of the next write, for a checkpoint.
    pub fn state(&self) -> (&[Vec<f32>; 4], usize) {
        (&self.columns, self.next)
    }

    /// Takes the place of a state that [`Replay::state`] gave.
    ///
    /// # Errors
    /// A message when the columns do not fit this buffer.
    pub fn restore(&mut self, columns: [Vec<f32>; 4], next: usize) -> Result<(), String> {
        let length = columns[0].len() / self.widths[0];
        let fits = columns.iter().zip(self.widths).all(|(column, width)| column.len() == length * width);
        if !fits || length > self.capacity || next >= self.capacity {
            let found = columns.map(|column| column.len());
            return Err(format!(
                "replay does not fit: rows of {:?} up to {}, found lengths {found:?}, next {next}",
                self.widths, self.capacity
            ));
        }
        (self.columns, self.length, self.next) = (columns, length, next);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    fn filled(count: usize) -> Replay {
        let mut replay = Replay::new(3, [2, 1, 1, 2]);
        for index in 0..count {
            let value = index as f32;
            replay.push([&[value, -value], &[value], &[10.0 * value], &[value + 1.0, 0.0]]);
        }
        replay
    }

    #[test]
    fn the_oldest_transition_gives_way() {
        let replay = filled(4);
        assert_eq!(replay.len(), 3);
        let mut rewards = replay.state().0[2].clone();
        rewards.sort_by(f32::total_cmp);
        assert_eq!(rewards, [10.0, 20.0, 30.0]);
    }

    #[test]
    fn parts_of_a_sample_belong_together() {
        let replay = filled(3);
        let [features, logits, rewards, next] = replay.sample(50, &mut ChaCha8Rng::seed_from_u64(1));
        for row in 0..50 {
            let value = logits[row];
            assert_eq!(features[2 * row..][..2], [value, -value]);
            assert_eq!(rewards[row], 10.0 * value);
            assert_eq!(next[2 * row], value + 1.0);
        }
        assert!(logits.iter().any(|value| *value != logits[0]));
    }

    #[test]
    fn a_restored_buffer_is_the_same_and_another_shape_is_refused() {
        let replay = filled(4);
        let (columns, next) = replay.state();
        let mut other = Replay::new(3, [2, 1, 1, 2]);
        other.restore(columns.clone(), next).expect("the same shape fits");
        assert_eq!(other, replay);
        let mut narrow = Replay::new(3, [3, 1, 1, 2]);
        assert!(narrow.restore(columns.clone(), next).is_err());
    }
}
