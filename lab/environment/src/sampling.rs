//! The samples of a room: in closed loop at the sampling times of an episode, else in its one state.

use heliostat_channel::MirrorAngles;
use heliostat_room::World;

use crate::closed_loop::ClosedLoop;
use crate::episodes::HeldOutEpisode;
use crate::error::EnvironmentError;
use crate::score::Sample;

/// The samples of an episode that runs.
#[derive(Clone, Debug)]
pub struct Sampling {
    instants_ns: Vec<u64>,
    /// The sampling times and those at which outages are observed: a room moves in the same parts
    /// as in a comparison, so that it is the same bit for bit.
    looks_ns: Vec<u64>,
    next: usize,
    samples: Vec<Sample>,
}

impl Sampling {
    /// Before the only action in a state of a static comparison, which has no sampling times.
    pub(crate) fn of_state() -> Self {
        Self { instants_ns: Vec::new(), looks_ns: Vec::new(), next: 0, samples: Vec::new() }
    }

    /// Takes the sample of the only action in a state; the users have walked on before a later one.
    pub(crate) fn sample_state(&mut self, world: &World, angles: &MirrorAngles) {
        if self.samples.is_empty() {
            self.samples.push(Sample::of(world, angles));
        }
    }

    /// Before the first sampling time of an episode.
    pub fn new(episode: &HeldOutEpisode) -> Self {
        let (instants_ns, looks_ns) = (episode.instants_ns.clone(), episode.looks_ns());
        Self { instants_ns, looks_ns, next: 0, samples: Vec::new() }
    }

    /// The samples so far.
    pub fn samples(&self) -> &[Sample] {
        &self.samples
    }

    /// Whether all sampling times have passed; in a state, always.
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
                self.samples.push(Sample::of(inner.room().world(), inner.room().angles()));
            }
            self.next += 1;
        }
        Ok(now_ns)
    }
}
