//! How much is computed: the whole, or a smoke run.

/// The sizes of a run.
#[derive(Clone, Debug, PartialEq)]
pub struct Effort {
    /// Seeds of what does not train.
    pub seeds: u64,
    /// Seeds of each training run.
    pub training_seeds: u64,
    /// Episodes of each training run.
    pub episodes: usize,
    /// How many times a learner is judged after its beginning.
    pub judgements: usize,
    /// Held-out states on which learners are judged.
    pub watched_states: usize,
    /// States of each seed, power and number of blocked users.
    pub states: usize,
    /// Optical powers in W.
    pub powers_w: Vec<f64>,
    /// Instants of each seed, delay and speed.
    pub instants: usize,
    /// Decisions that are timed of each seed and each policy that is fast: enough for a 99th percentile.
    pub timed: usize,
    /// The same of each policy that is slow.
    pub timed_slow: usize,
    /// Trials of the metaheuristics for one decision.
    pub trials: u32,
    /// Distance between points of the map in cm.
    pub step_cm: f64,
}

impl Effort {
    /// What the documented figures are made with.
    pub fn full() -> Self {
        Self {
            seeds: 10,
            training_seeds: 3,
            episodes: 300,
            judgements: 20,
            watched_states: 60,
            states: 20,
            powers_w: vec![1.0, 1.5, 2.0, 2.5, 3.0],
            instants: 200,
            timed: 500,
            timed_slow: 50,
            trials: 2000,
            step_cm: 5.0,
        }
    }

    /// A few minutes on two cores.
    pub fn quick() -> Self {
        Self {
            seeds: 2,
            training_seeds: 1,
            episodes: 25,
            judgements: 3,
            watched_states: 20,
            states: 8,
            powers_w: vec![1.0, 2.0, 3.0],
            instants: 60,
            timed: 100,
            timed_slow: 12,
            trials: 500,
            step_cm: 25.0,
        }
    }
}
