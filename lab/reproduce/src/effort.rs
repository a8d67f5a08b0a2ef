//! The size of a run: full or quick.

/// The sizes of a run.
#[derive(Clone, Debug, PartialEq)]
pub struct Effort {
    /// Seeds of computations without training.
    pub seeds: u64,
    /// Seeds of each training run.
    pub training_seeds: u64,
    /// Episodes of each training run.
    pub episodes: usize,
    /// Evaluations of a learner after its start.
    pub evaluations: usize,
    /// Held-out states for the evaluation of learners.
    pub watched_states: usize,
    /// States for each seed, power and number of blocked users.
    pub states: usize,
    /// Optical powers in W.
    pub powers_w: Vec<f64>,
    /// Instants for each seed, delay and speed.
    pub instants: usize,
    /// Instants in closed loop for each seed and number of blocked users.
    pub loop_instants: usize,
    /// Timed decisions for each seed and each fast policy: enough for a 99th percentile.
    pub timed: usize,
    /// Timed decisions for each seed and each slow policy.
    pub timed_slow: usize,
    /// Evaluations of the metaheuristics for one decision.
    pub trials: u32,
    /// Distance between points of the map in cm.
    pub step_cm: f64,
}

impl Effort {
    /// The size of the documented run.
    pub fn full() -> Self {
        Self {
            seeds: 10,
            training_seeds: 3,
            episodes: 300,
            evaluations: 20,
            watched_states: 60,
            states: 20,
            powers_w: vec![1.0, 1.5, 2.0, 2.5, 3.0],
            instants: 200,
            loop_instants: 200,
            timed: 500,
            timed_slow: 50,
            trials: 2000,
            step_cm: 5.0,
        }
    }

    /// Whether nothing is smaller than in the documented run.
    pub fn is_full(&self) -> bool {
        let full = Self::full();
        let Self { seeds, training_seeds, episodes, .. } = *self;
        let others =
            Self { seeds: full.seeds, training_seeds: full.training_seeds, episodes: full.episodes, ..self.clone() };
        seeds >= full.seeds && training_seeds >= full.training_seeds && episodes >= full.episodes && others == full
    }

    /// A few minutes on two cores.
    pub fn quick() -> Self {
        Self {
            seeds: 2,
            training_seeds: 1,
            episodes: 25,
            evaluations: 3,
            watched_states: 20,
            states: 8,
            powers_w: vec![1.0, 2.0, 3.0],
            instants: 60,
            loop_instants: 40,
            timed: 100,
            timed_slow: 12,
            trials: 500,
            step_cm: 25.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn more_seeds_and_episodes_are_a_full_run_and_fewer_are_none() {
        assert!(Effort { episodes: 1000, training_seeds: 5, ..Effort::full() }.is_full());
        assert!(!Effort { episodes: 100, ..Effort::full() }.is_full());
        assert!(!Effort { states: 8, ..Effort::full() }.is_full());
        assert!(!Effort::quick().is_full());
    }
}
