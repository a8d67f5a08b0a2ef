//! Seeded random numbers: one independent stream for each purpose, so that a change of one setting
//! does not change the rest.
//!
//! Uniform numbers use exact arithmetic on the generator's bits, so walks and obstacles are the
//! same on every platform. Normal numbers use the platform's logarithm.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// The generator of all random numbers in the room.
pub type RoomRng = ChaCha8Rng;

/// The purpose of a stream of random numbers, with the upper half of the stream number: never reused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Purpose {
    /// The walk of one user.
    Walk = 1,
    /// The positions of the obstacles.
    Obstacles = 2,
    /// Calibration offsets, drift and jitter of the mirrors.
    Actuator = 3,
    /// Measurement noise of positions and velocities.
    PositionNoise = 4,
    /// Measurement noise of channel gains.
    ChannelNoise = 5,
    /// The mirrors that have a fault.
    Faults = 6,
    /// Measurement noise during calibration of an array.
    CalibrationNoise = 7,
    /// When users enter, and how long they stay.
    Arrivals = 8,
    /// The difference between the true equipment and the nominal one.
    Mismatch = 9,
    /// The difference between the true body of a user and the nominal one.
    Body = 10,
    /// The fixed tilt of the receiver of a user.
    ReceiverTilt = 14,
    /// How one user holds the receiver.
    Orientation = 11,
    /// Measurement noise of orientations.
    OrientationNoise = 12,
    /// Which users of a mixture have which mobility model.
    MobilityModel = 13,
    /// Measurement noise of the receivers that does not depend on the gain.
    ReceiverNoise = 15,
    /// Which position reports are lost.
    PositionLoss = 16,
    /// Which channel reports are lost.
    ChannelLoss = 17,
    /// Measurement noise of the gains of each branch.
    BranchNoise = 18,
    /// Measurement noise of the branches that does not depend on the gain.
    BranchReceiverNoise = 19,
    /// Measurement noise of the gains of each LED.
    LedNoise = 20,
    /// Measurement noise of the LEDs that does not depend on the gain.
    LedReceiverNoise = 21,
}

/// The generator of one purpose; `index` distinguishes instances of the same purpose, such as
/// users.
pub fn stream(seed: u64, purpose: Purpose, index: u32) -> RoomRng {
    let mut rng = RoomRng::seed_from_u64(seed);
    rng.set_stream((purpose as u64) << 32 | u64::from(index));
    rng
}

/// A number in [0, 1), uniform over the multiples of 2^-53.
pub fn uniform(rng: &mut RoomRng) -> f64 {
    (rng.next_u64() >> 11) as f64 * (1.0 / (1_u64 << 53) as f64)
}

/// A number in [low, high), uniform.
pub fn uniform_in(rng: &mut RoomRng, low: f64, high: f64) -> f64 {
    low + (high - low) * uniform(rng)
}

/// A number with an exponential distribution of this mean.
pub fn exponential(rng: &mut RoomRng, mean: f64) -> f64 {
    -mean * (1.0 - uniform(rng)).ln()
}

/// A normal number of mean 0 and standard deviation 1: the first of a pair.
pub fn normal(rng: &mut RoomRng) -> f64 {
    normal_pair(rng)[0]
}

/// Two independent normal numbers of mean 0 and standard deviation 1 (Marsaglia's polar method).
pub fn normal_pair(rng: &mut RoomRng) -> [f64; 2] {
    loop {
        let u = 2.0 * uniform(rng) - 1.0;
        let v = 2.0 * uniform(rng) - 1.0;
        let square = u * u + v * v;
        if square > 0.0 && square < 1.0 {
            let radius = (-2.0 * square.ln() / square).sqrt();
            return [u * radius, v * radius];
        }
    }
}

/// A Poisson number with this mean: the number of unit-rate exponential gaps that fit into it.
pub fn poisson(rng: &mut RoomRng, mean: f64) -> usize {
    let mut count = 0;
    let mut sum = 0.0;
    loop {
        sum -= (1.0 - uniform(rng)).ln();
        if sum > mean {
            return count;
        }
        count += 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn moments(mut draw: impl FnMut() -> f64) -> (f64, f64) {
        let n = 200_000;
        let (mut sum, mut squares) = (0.0, 0.0);
        for _ in 0..n {
            let value = draw();
            sum += value;
            squares += value * value;
        }
        let mean = sum / n as f64;
        (mean, squares / n as f64 - mean * mean)
    }

    #[test]
    fn streams_differ_by_purpose_and_index_and_repeat_by_seed() {
        let first = |seed, purpose, index| stream(seed, purpose, index).next_u64();
        assert_eq!(first(7, Purpose::Walk, 0), first(7, Purpose::Walk, 0));
        assert_ne!(first(7, Purpose::Walk, 0), first(7, Purpose::Walk, 1));
        assert_ne!(first(7, Purpose::Walk, 0), first(7, Purpose::Obstacles, 0));
        assert_ne!(first(7, Purpose::Walk, 0), first(8, Purpose::Walk, 0));
    }

    #[test]
    fn distributions_have_their_moments() {
        let mut rng = stream(1, Purpose::Actuator, 0);
        let (mean, variance) = moments(|| uniform(&mut rng));
        assert!((mean - 0.5).abs() < 5e-3 && (variance - 1.0 / 12.0).abs() < 2e-3);
        let (mean, variance) = moments(|| normal(&mut rng));
        assert!(mean.abs() < 0.01 && (variance - 1.0).abs() < 0.02, "{mean} {variance}");
        let (mean, variance) = moments(|| normal_pair(&mut rng)[1]);
        assert!(mean.abs() < 0.01 && (variance - 1.0).abs() < 0.02, "{mean} {variance}");
        let (mean, variance) = moments(|| normal_pair(&mut rng).iter().product());
        assert!(mean.abs() < 0.01 && (variance - 1.0).abs() < 0.02, "{mean} {variance}");
        let (mean, variance) = moments(|| poisson(&mut rng, 2.5) as f64);
        assert!((mean - 2.5).abs() < 0.02 && (variance - 2.5).abs() < 0.05, "{mean} {variance}");
    }
}
