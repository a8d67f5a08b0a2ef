//! The rates of a room in closed loop at the sampling times of an episode.

use heliostat_channel::MirrorAngles;
use heliostat_channel::link::jain;
use heliostat_room::World;

use crate::closed_loop::ClosedLoop;
use crate::episodes::HeldOutEpisode;
use crate::error::EnvironmentError;
use crate::held_out::met;

/// The evaluation of angles at one time, with the true users and equipment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sampled {
    /// sum_k R_k in Mbit/s; 0 without users.
    pub sum_rate_mbps: f64,
    /// Share of users whose minimum rate is met; NaN without users.
    pub met: f64,
    /// Jain's fairness index of the rates; NaN without users.
    pub jain: f64,
}

impl Sampled {
    /// The evaluation of angles in the present state of a world.
    pub fn of(world: &World, angles: &MirrorAngles) -> Self {
        let mut rates_bps = vec![0.0; world.scene().users()];
        world.scene().rates_bps(world.model(), angles, &mut rates_bps);
        let sum_rate_mbps = 1e-6 * rates_bps.iter().sum::<f64>();
        let jain = if rates_bps.is_empty() { f64::NAN } else { jain(&rates_bps) };
        Self { sum_rate_mbps, met: met(&rates_bps, world.min_rate_bps()), jain }
    }
}

/// The samples of an episode that runs.
#[derive(Clone, Debug)]
pub struct Sampling {
    instants_ns: Vec<u64>,
    /// The sampling times and those at which outages are observed: a room moves in the same parts
    /// as in a comparison, so that it is the same bit for bit.
    looks_ns: Vec<u64>,
    next: usize,
    samples: Vec<Sampled>,
}

impl Sampling {
    /// Before the first sampling time of an episode.
    pub fn new(episode: &HeldOutEpisode) -> Self {
        let (instants_ns, looks_ns) = (episode.instants_ns.clone(), episode.looks_ns());
        Self { instants_ns, looks_ns, next: 0, samples: Vec::new() }
    }

    /// The samples so far.
    pub fn samples(&self) -> &[Sampled] {
        &self.samples
    }

    /// Whether all sampling times have passed.
    pub fn is_over(&self) -> bool {
        self.next == self.looks_ns.len()
    }

    /// Advances to the next decision, or to the last sampling time, and takes the samples until
    /// then. Returns the time of the room in ns.
    ///
    /// # Errors
    /// As [`ClosedLoop::next_decision_by`].
    pub(crate) fn advance(&mut self, inner: &mut ClosedLoop, now_ns: u64) -> Result<u64, EnvironmentError> {
        let mut now_ns = now_ns;
        while let Some(look_ns) = self.looks_ns.get(self.next) {
            if let Some(at) = inner.next_decision_by(*look_ns)? {
                return Ok(at.room_ns);
            }
            inner.advance(*look_ns);
            now_ns = *look_ns;
            if self.instants_ns.binary_search(look_ns).is_ok() {
                self.samples.push(Sampled::of(inner.room().world(), inner.room().angles()));
            }
            self.next += 1;
        }
        Ok(now_ns)
    }
}
