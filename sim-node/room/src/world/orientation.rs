//! How the users hold their receivers: random angles with measured distributions.
//!
//! The normal of a device is tilted towards the face of its user. The polar angle between normal
//! and vertical, and the deviation of the azimuth from the direction towards the face, are those of
//! a user who sits or stands (Laplace) or who walks (normal).
//!
//! Each angle follows a stationary Gaussian process z of variance 1 with the autocorrelation
//! 0.05^(lag / coherence time). The quantile function of the distribution gives the angle. A user
//! who starts or stops walking keeps z; the distribution changes over the coherence time.
//!
//! The processes have a value every [`NODE_S`] seconds. These nodes depend on the seed and the
//! walk, and not on the steps of the room. Between two nodes z is interpolated and scaled to
//! variance 1.
//!
//! Source: Soltani, Purwita, Zeng, Haas and Safari, "Modeling the random orientation of mobile
//! devices: measurement, analysis and LiFi use case", IEEE Trans. Commun. 67(3), 2019: the
//! distributions, and the autoregressive process with its threshold of 0.05.

use std::f64::consts::{FRAC_1_SQRT_2, FRAC_PI_2, PI};

use heliostat_channel::Orientation;
use heliostat_scenario::{OrientationModel, UserOrientation, Users};

use crate::random::{self, Purpose, RoomRng};
use crate::world::walker::Walker;

/// Time between two nodes of the processes in s.
pub const NODE_S: f64 = 0.005;

/// Quantile of a Laplace distribution of mean 0 at the probability of a standard normal number.
///
/// sign(z) (std / sqrt 2) (-ln(2 Phi(-|z|))), with the distribution function Phi of the standard
/// normal distribution. Units: those of `std`.
fn laplace(std: f64, z: f64) -> f64 {
    let both_tails = libm::erfc(z.abs() * FRAC_1_SQRT_2);
    (-std * FRAC_1_SQRT_2 * both_tails.ln()).copysign(z)
}

/// The distributions of a user's angles in radians.
#[derive(Clone, Copy, Debug)]
struct Distribution {
    polar_mean: f64,
    polar_std: f64,
    azimuth_std: f64,
    /// Autocorrelation from one node to the next.
    correlation: f64,
    /// Standard deviation of what is new at a node: sqrt(1 - correlation^2).
    innovation: f64,
}

/// The distributions of one table.
#[derive(Clone, Copy, Debug)]
struct Distributions {
    sitting: Distribution,
    walking: Distribution,
    walking_from_m_s: f64,
}

impl Distributions {
    fn new(table: &UserOrientation) -> Self {
        let correlation = |coherence_s: f64| UserOrientation::AT_COHERENCE_TIME.powf(NODE_S / coherence_s);
        let innovation = |coherence_s: f64| (1.0 - correlation(coherence_s).powi(2)).sqrt();
        Self {
            sitting: Distribution {
                polar_mean: table.sitting_polar_mean_deg.to_radians(),
                polar_std: table.sitting_polar_std_deg.to_radians(),
                azimuth_std: table.sitting_azimuth_std_deg.to_radians(),
                correlation: correlation(table.sitting_coherence_s),
                innovation: innovation(table.sitting_coherence_s),
            },
            walking: Distribution {
                polar_mean: table.walking_polar_mean_deg.to_radians(),
                polar_std: table.walking_polar_std_deg.to_radians(),
                azimuth_std: table.walking_azimuth_std_deg.to_radians(),
                correlation: correlation(table.walking_coherence_s),
                innovation: innovation(table.walking_coherence_s),
            },
            walking_from_m_s: table.walking_from_m_s,
        }
    }

    fn is_walking(&self, walker: &Walker) -> bool {
        let [x, y] = walker.velocity;
        x * x + y * y >= self.walking_from_m_s * self.walking_from_m_s && [x, y] != [0.0; 2]
    }

    fn of(&self, walking: bool) -> &Distribution {
        if walking { &self.walking } else { &self.sitting }
    }

    /// Polar angle and deviation of the azimuth in radians; a device never faces down.
    fn angles(&self, node: &Node) -> [f64; 2] {
        let (sitting, walking) = (&self.sitting, &self.walking);
        let walks = [walking.polar_mean + walking.polar_std * node.polar, walking.azimuth_std * node.azimuth];
        // The quantiles of a Laplace distribution take most of the time, and a user who walks needs
        // none.
        let [polar, azimuth] = if node.walking == 1.0 {
            walks
        } else {
            let sits = [
                sitting.polar_mean + laplace(sitting.polar_std, node.polar),
                laplace(sitting.azimuth_std, node.azimuth),
            ];
            [0, 1].map(|angle| sits[angle] + node.walking * (walks[angle] - sits[angle]))
        };
        [polar.clamp(0.0, FRAC_PI_2), azimuth]
    }
}

/// The processes of one user at one time.
#[derive(Clone, Copy, Debug)]
struct Node {
    /// Standard normal number of the polar angle.
    polar: f64,
    /// Standard normal number of the azimuth.
    azimuth: f64,
    /// Share of the distribution of a user who walks, from 0 to 1.
    walking: f64,
}

/// The processes of one user between two nodes.
#[derive(Clone, Debug)]
struct Process {
    distributions: Distributions,
    rng: RoomRng,
    last: Node,
    next: Node,
    /// Autocorrelation from the last node to the next.
    correlation: f64,
}

impl Process {
    /// A process in its stationary regime.
    fn new(distributions: Distributions, mut rng: RoomRng, walking: bool) -> Self {
        let [polar, azimuth] = random::normal_pair(&mut rng);
        let first = Node { polar, azimuth, walking: f64::from(u8::from(walking)) };
        let mut process = Self { distributions, rng, last: first, next: first, correlation: 1.0 };
        process.pass_node(walking);
        process
    }

    /// The next node becomes the last one.
    fn pass_node(&mut self, walking: bool) {
        self.last = self.next;
        let &Distribution { correlation: kept, innovation: drawn, .. } = self.distributions.of(walking);
        self.correlation = kept;
        let target = f64::from(u8::from(walking));
        let [polar, azimuth] = random::normal_pair(&mut self.rng);
        self.next = Node {
            polar: kept * self.last.polar + drawn * polar,
            azimuth: kept * self.last.azimuth + drawn * azimuth,
            walking: target + kept * (self.last.walking - target),
        };
    }

    /// The processes at a share of the time from the last node to the next.
    fn at(&self, share: f64) -> Node {
        let rest = 1.0 - share;
        let deviation = (rest * rest + share * share + 2.0 * rest * share * self.correlation).sqrt();
        let between = |last: f64, next: f64| (rest * last + share * next) / deviation;
        Node {
            polar: between(self.last.polar, self.next.polar),
            azimuth: between(self.last.azimuth, self.next.azimuth),
            walking: rest * self.last.walking + share * self.next.walking,
        }
    }
}

/// The orientations of all users, in the order of entry.
#[derive(Clone, Debug)]
pub struct Orientations {
    /// The distributions of users without an entry in a mixture; `None`: their receivers face up.
    room: Option<Distributions>,
    /// Those of the users of each entry of the mixture.
    entries: Vec<Option<Distributions>>,
    /// Whether some users hold their receivers at random angles.
    is_measured: bool,
    seed: u64,
    /// Number of nodes that have passed.
    passed: u64,
    /// Of each user; `None`: the receiver faces up.
    processes: Vec<Option<Process>>,
    held: Vec<Orientation>,
}

impl Orientations {
    /// The orientations of a scenario, without users.
    pub fn new(users: &Users) -> Self {
        let distributions = |table: &Option<UserOrientation>| {
            let measured = table.as_ref().filter(|table| table.model == OrientationModel::Measured);
            measured.map(Distributions::new)
        };
        let room = distributions(&users.orientation);
        // The table of an entry replaces that of the room.
        let of_entry = |own: &Option<UserOrientation>| if own.is_some() { distributions(own) } else { room };
        Self {
            room,
            entries: users.mixture.iter().map(|entry| of_entry(&entry.orientation)).collect(),
            is_measured: users.orientations().iter().any(|(_, held)| held.is_some()),
            seed: 0,
            passed: 0,
            processes: Vec::new(),
            held: Vec::new(),
        }
    }

    /// Restarts at time 0 with these users; makes room for `most` users in all. `entry_of` is the index of
    /// the entry of a user in the mixture.
    pub fn begin(&mut self, seed: u64, walkers: &[Walker], most: usize, entry_of: impl Fn(u32) -> Option<usize>) {
        (self.seed, self.passed) = (seed, 0);
        self.processes.clear();
        self.held.reserve(most.saturating_sub(self.held.len()));
        self.processes.reserve(most);
        for (id, walker) in walkers.iter().enumerate() {
            let id = id as u32;
            let process = self.process(id, entry_of(id), |distributions| distributions.is_walking(walker));
            self.processes.push(process);
        }
    }

    /// A user enters after the others, walking, with the process of its number; `entry` is the index of its
    /// entry in the mixture.
    pub fn enter(&mut self, id: u32, entry: Option<usize>) {
        let process = self.process(id, entry, |_| true);
        self.processes.push(process);
    }

    /// The process of a user; `None` for a receiver that faces up.
    fn process(
        &self,
        id: u32,
        entry: Option<usize>,
        is_walking: impl FnOnce(&Distributions) -> bool,
    ) -> Option<Process> {
        let distributions = entry.map_or(self.room, |entry| self.entries[entry])?;
        let rng = random::stream(self.seed, Purpose::Orientation, id);
        Some(Process::new(distributions, rng, is_walking(&distributions)))
    }

    /// The user at this index leaves.
    pub fn leave(&mut self, index: usize) {
        self.processes.remove(index);
    }

    /// Time of the next node in s since the start; `None` where every receiver faces up.
    pub fn next_node_s(&self) -> Option<f64> {
        self.is_measured.then(|| (self.passed + 1) as f64 * NODE_S)
    }

    /// Passes the next node, at which the users have these velocities.
    pub fn pass_node(&mut self, walkers: &[Walker]) {
        self.passed += 1;
        for (process, walker) in self.processes.iter_mut().zip(walkers) {
            if let Some(process) = process {
                process.pass_node(process.distributions.is_walking(walker));
            }
        }
    }

    /// Computes the orientations at a time in s between the last node and the next.
    pub fn hold(&mut self, time_s: f64, walkers: &[Walker]) {
        let share = (time_s / NODE_S - self.passed as f64).clamp(0.0, 1.0);
        let of_user = |(process, walker): (&Option<Process>, &Walker)| {
            process.as_ref().map_or(Orientation::UPRIGHT, |process| {
                let [polar, azimuth] = process.distributions.angles(&process.at(share));
                Orientation::from_polar_azimuth(polar, walker.heading() + PI + azimuth)
            })
        };
        self.held.clear();
        self.held.extend(self.processes.iter().zip(walkers).map(of_user));
    }

    /// The orientation of each user's receiver.
    pub fn held(&self) -> &[Orientation] {
        &self.held
    }
}
