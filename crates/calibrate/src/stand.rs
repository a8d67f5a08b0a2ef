//! Where the hand-held receiver stands, from the reports of the tracker and of the direct light.

use std::collections::VecDeque;

use heliostat_proto::Nanos;

/// Fewest reports, and shortest time in ns, that show whether the receiver stands. A walk must show
/// against the noise of the tracker.
const RECENT: usize = 20;
const RECENT_NS: Nanos = 2_000_000_000;

/// Reports that show that the receiver has left its place.
const LEAVING: usize = 4;

/// Distance in m by which the mean of those reports must differ, beyond their noise.
const LEFT_M: f64 = 0.12;

/// Distance in m between the means of the earlier and the later reports of a receiver that stands.
const STILL_M: f64 = 0.03;

/// Standard deviations of a mean that count as noise.
const NOISE_FACTOR: f64 = 3.5;

/// A direct gain below this share of the usual one: a body is in the path.
const BLOCKED_SHARE: f64 = 0.6;

/// The receiver at one place.
#[derive(Clone, Debug, Default)]
pub struct Stand {
    recent: VecDeque<(Nanos, [f64; 2])>,
    /// Count, sum and sum of squares of the positions while it stands.
    count: f64,
    sum: [f64; 2],
    /// Where it began to stand; sums of squares are about this point.
    origin: [f64; 2],
    square: [f64; 2],
    velocity_square: f64,
    /// Positions without their velocity.
    unknown: f64,
    direct: Vec<f64>,
    is_standing: bool,
}

/// A change of the receiver's state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Moved {
    /// It stands here.
    Stands([f64; 2]),
    /// It has left; readings from this time on are not from its place.
    Left(Nanos),
}

impl Stand {
    /// Notes a position in m and a velocity in m/s, both in the wall frame.
    pub fn handle_position(&mut self, time_ns: Nanos, at: [f64; 2], velocity: [f64; 2]) -> Option<Moved> {
        self.recent.push_back((time_ns, at));
        let is_old = |recent: &VecDeque<(Nanos, [f64; 2])>| {
            recent.len() > RECENT
                && recent.get(1).is_some_and(|(second, _)| time_ns.saturating_sub(*second) >= RECENT_NS)
        };
        while is_old(&self.recent) {
            self.recent.pop_front();
        }
        if self.is_standing {
            let from = self.recent.len().saturating_sub(LEAVING);
            let late = mean(self.recent.iter().skip(from));
            let noise = NOISE_FACTOR * self.noise_m() / (LEAVING as f64).sqrt();
            if distance(late, self.mean()) > LEFT_M + noise {
                let since = self.recent[from].0;
                *self = Self { recent: std::mem::take(&mut self.recent), ..Self::default() };
                self.recent.clear();
                return Some(Moved::Left(since));
            }
            self.add(at, velocity);
            return None;
        }
        let begun_ns = self.recent.front().map_or(time_ns, |(first, _)| *first);
        if self.recent.len() < RECENT || time_ns.saturating_sub(begun_ns) < RECENT_NS {
            return None;
        }
        let half = self.recent.len() / 2;
        let (early, late) = (mean(self.recent.iter().take(half)), mean(self.recent.iter().skip(half)));
        // The noise from differences of neighbours, which a walk hardly changes.
        let pairs = self.recent.iter().zip(self.recent.iter().skip(1));
        let squares: f64 = pairs.map(|((_, a), (_, b))| distance(*a, *b).powi(2)).sum();
        let noise = (squares / (4.0 * (self.recent.len() - 1) as f64)).sqrt();
        if distance(early, late) > STILL_M + NOISE_FACTOR * noise * (2.0 / half as f64).sqrt() {
            return None;
        }
        self.is_standing = true;
        // The earlier half can hold the last steps of the walk.
        self.recent.drain(..half);
        self.origin = mean(self.recent.iter());
        for (_, at) in self.recent.clone() {
            self.add(at, [0.0; 2]);
        }
        self.unknown = self.count;
        Some(Moved::Stands(self.mean()))
    }

    /// Notes a direct gain while the receiver stands; whether the path is as clear as usual.
    pub fn handle_direct(&mut self, gain: f64) -> bool {
        let usual = self.direct_gain();
        if self.direct.len() >= 5 && gain < BLOCKED_SHARE * usual {
            // If most are so, the gains so far were those of a moment.
            if self.direct.len() < 50 {
                self.direct.push(gain);
            }
            return false;
        }
        self.direct.push(gain);
        true
    }

    /// The next direct gains count as the first ones.
    pub fn forget_direct(&mut self) {
        self.direct.clear();
    }

    /// Whether it stands.
    pub fn is_standing(&self) -> bool {
        self.is_standing
    }

    /// Mean position in m.
    pub fn mean(&self) -> [f64; 2] {
        self.sum.map(|sum| sum / self.count.max(1.0))
    }

    /// Mean of the latest positions in m, whether or not it stands; `None` before the first.
    pub fn latest(&self) -> Option<[f64; 2]> {
        let from = self.recent.len().saturating_sub(LEAVING);
        (!self.recent.is_empty()).then(|| mean(self.recent.iter().skip(from)))
    }

    /// Number of positions of the mean.
    pub fn count(&self) -> f64 {
        self.count
    }

    /// Standard deviation of a reported coordinate in m.
    pub fn noise_m(&self) -> f64 {
        let mean = self.mean();
        let variance =
            [0, 1].map(|axis| self.square[axis] / self.count.max(1.0) - (mean[axis] - self.origin[axis]).powi(2));
        let unbiased = self.count / (self.count - 1.0).max(1.0);
        (0.5 * (variance[0] + variance[1]) * unbiased).max(0.0).sqrt()
    }

    /// Standard deviation of a reported velocity in m/s.
    pub fn velocity_noise_m_s(&self) -> f64 {
        (0.5 * self.velocity_square / (self.count - self.unknown).max(1.0)).sqrt()
    }

    /// Median of the direct gain; 0 where it is blocked.
    pub fn direct_gain(&self) -> f64 {
        median(&self.direct)
    }

    /// Number of direct gains.
    pub fn direct_count(&self) -> usize {
        self.direct.len()
    }

    /// Standard deviation of a direct gain, relative; `None` where it is not known.
    pub fn direct_noise(&self) -> Option<f64> {
        let usual = self.direct_gain();
        if usual <= 0.0 || self.direct.len() < 8 {
            return None;
        }
        let clear: Vec<f64> = self.direct.iter().copied().filter(|gain| *gain > BLOCKED_SHARE * usual).collect();
        let mean = clear.iter().sum::<f64>() / clear.len() as f64;
        let squares: f64 = clear.iter().map(|gain| (gain - mean).powi(2)).sum();
        Some((squares / (clear.len() - 1).max(1) as f64).sqrt() / mean)
    }

    fn add(&mut self, at: [f64; 2], velocity: [f64; 2]) {
        self.count += 1.0;
        self.velocity_square += velocity[0].powi(2) + velocity[1].powi(2);
        for (axis, at) in at.into_iter().enumerate() {
            self.sum[axis] += at;
            self.square[axis] += (at - self.origin[axis]).powi(2);
        }
    }
}

/// The median; 0 of nothing.
pub fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied().unwrap_or(0.0)
}

/// Distance of two places in m.
pub fn distance(a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

fn mean<'a>(places: impl Iterator<Item = &'a (Nanos, [f64; 2])>) -> [f64; 2] {
    let (mut sum, mut count) = ([0.0; 2], 0.0);
    for (_, at) in places {
        sum = [sum[0] + at[0], sum[1] + at[1]];
        count += 1.0;
    }
    sum.map(|sum| sum / f64::max(count, 1.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A deterministic noise of about 0.05 m.
    fn noise(index: u64) -> f64 {
        0.17 * ((index.wrapping_mul(2_654_435_761) % 1000) as f64 / 1000.0 - 0.5)
    }

    #[test]
    fn a_receiver_stands_walks_away_and_stands_again() {
        let mut stand = Stand::default();
        let mut changes = Vec::new();
        for index in 0..400_u64 {
            // It walks at 1 m/s from (0, 0) to (2, 0) between the reports 200 and 220, at 10 Hz.
            let x = (index.clamp(200, 220) - 200) as f64 * 0.1;
            let at = [x + noise(2 * index), noise(2 * index + 1)];
            if let Some(moved) = stand.handle_position(index * 100_000_000, at, [0.0; 2]) {
                changes.push((index, moved));
            }
        }
        let [(first, Moved::Stands(_)), (left, Moved::Left(since)), (again, Moved::Stands(at))] = changes[..] else {
            panic!("{changes:?}");
        };
        assert!(first < 40 && (200..210).contains(&left) && again >= 220, "{changes:?}");
        assert!(since >= 195 * 100_000_000, "{since}");
        assert!((at[0] - 2.0).abs() < 0.1, "{at:?}");
        assert!((stand.noise_m() - 0.05).abs() < 0.01, "{}", stand.noise_m());
    }
}
