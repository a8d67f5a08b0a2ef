//! Streams of random numbers: one for each purpose, so that one more draw changes no other stream.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

/// The generator of all random numbers.
pub(crate) type Rng = ChaCha8Rng;

/// What a stream is for.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Purpose {
    Setup,
    Plan,
    Network,
    Sources,
    Users,
    Attacks,
    Disk,
    Reports,
    Calibrations,
    Threads,
    Connections,
    Pauses,
}

/// The stream of a seed for a purpose.
pub(crate) fn stream(seed: u64, purpose: Purpose) -> Rng {
    let mut rng = Rng::seed_from_u64(seed);
    rng.set_stream(purpose as u64);
    rng
}
