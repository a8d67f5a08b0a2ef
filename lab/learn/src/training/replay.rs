//! The replay buffer: a ring of transitions in flat arrays.

use rand::{Rng, RngExt};

use super::store::{Persistent, Store};

/// Row lengths of a transition: `[state, action, rewards, next state]`.
pub type Widths = [usize; 4];

/// One transition: state, action, rewards, next state.
pub type Transition<'a> = [&'a [f32]; 4];

/// The last transitions, and the number from which learning begins.
#[derive(Clone, Debug, PartialEq)]
pub struct Replay {
    capacity: usize,
    needed: usize,
    widths: Widths,
    columns: [Vec<f32>; 4],
    length: usize,
    next: usize,
}

impl Replay {
    /// An empty buffer, ready when it holds `needed` transitions.
    pub fn new(capacity: usize, needed: usize, widths: Widths) -> Self {
        Self {
            capacity,
            needed,
            widths,
            columns: widths.map(|width| Vec::with_capacity(width * capacity)),
            length: 0,
            next: 0,
        }
    }

    /// Whether it holds enough transitions for an update.
    pub fn is_ready(&self) -> bool {
        self.length >= self.needed
    }

    /// Adds a transition. A full buffer drops its oldest one.
    ///
    /// # Panics
    /// A part has another length than [`Replay::new`] defines.
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

    /// Draws `count` transitions with replacement; each part is one flat array.
    ///
    /// # Panics
    /// The buffer is empty.
    pub fn sample(&self, count: usize, rng: &mut impl Rng) -> [Vec<f32>; 4] {
        let rows: Vec<usize> = (0..count).map(|_| rng.random_range(0..self.length)).collect();
        std::array::from_fn(|part| {
            let width = self.widths[part];
            rows.iter().flat_map(|row| &self.columns[part][row * width..][..width]).copied().collect()
        })
    }
}

impl Persistent for Replay {
    fn save(&self, name: &str, store: &mut Store) -> anyhow::Result<()> {
        for (index, column) in self.columns.iter().enumerate() {
            store.put_floats(&format!("{name}.{index}"), column)?;
        }
        store.put(&format!("{name}.next"), &self.next)
    }

    fn restore(&mut self, name: &str, store: &Store) -> anyhow::Result<()> {
        let [state, action, rewards, next] = [0, 1, 2, 3].map(|index| store.floats(&format!("{name}.{index}")));
        let columns = [state?, action?, rewards?, next?];
        let write: usize = store.get(&format!("{name}.next"))?;
        let length = columns[0].len() / self.widths[0];
        let fits = columns.iter().zip(self.widths).all(|(column, width)| column.len() == length * width);
        anyhow::ensure!(
            fits && length <= self.capacity && write < self.capacity,
            "{name} in the checkpoint has columns of {:?} values and writes at {write}: expected rows of {:?} values, at most {} of them",
            columns.map(|column| column.len()),
            self.widths,
            self.capacity
        );
        (self.columns, self.length, self.next) = (columns, length, write);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    fn filled(count: usize) -> Replay {
        let mut replay = Replay::new(3, 2, [2, 1, 1, 2]);
        for index in 0..count {
            let value = index as f32;
            replay.push([&[value, -value], &[value], &[10.0 * value], &[value + 1.0, 0.0]]);
        }
        replay
    }

    #[test]
    fn a_full_buffer_drops_its_oldest_transition() {
        let replay = filled(4);
        assert_eq!(replay.length, 3);
        let mut rewards = replay.columns[2].clone();
        rewards.sort_by(f32::total_cmp);
        assert_eq!(rewards, [10.0, 20.0, 30.0]);
    }

    #[test]
    fn the_rows_of_a_sample_come_from_one_transition() {
        let replay = filled(3);
        let [features, actions, rewards, next] = replay.sample(50, &mut ChaCha8Rng::seed_from_u64(1));
        for row in 0..50 {
            let value = actions[row];
            assert_eq!(features[2 * row..][..2], [value, -value]);
            assert_eq!(rewards[row], 10.0 * value);
            assert_eq!(next[2 * row], value + 1.0);
        }
        assert!(actions.iter().any(|value| *value != actions[0]));
    }

    #[test]
    fn the_buffer_is_ready_from_the_needed_number_on() {
        assert!(!filled(1).is_ready() && filled(2).is_ready());
    }

    #[test]
    fn a_restored_buffer_is_the_same_and_another_shape_is_refused() {
        let replay = filled(4);
        let mut store = Store::default();
        replay.save("replay", &mut store).expect("a stored buffer");
        let mut other = Replay::new(3, 2, [2, 1, 1, 2]);
        other.restore("replay", &store).expect("the same shape fits");
        assert_eq!(other, replay);
        assert!(Replay::new(3, 2, [3, 1, 1, 2]).restore("replay", &store).is_err());
        assert!(Replay::new(2, 2, [2, 1, 1, 2]).restore("replay", &store).is_err());
    }
}
