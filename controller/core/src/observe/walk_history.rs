//! The input of a policy that predicts where users will be: one row for each user of the last
//! reports about it, and the Gauss-Markov prediction that the policy corrects.
//!
//! # The Gauss-Markov prediction
//! A velocity v with the mean w and the time constant T is expected to be w + (v - w) exp(-t / T)
//! after a time t. Over the lead L the user then moves by
//!
//! w L + (v - w) T (1 - exp(-L / T)).
//!
//! Here v is the velocity of the last report, w the mean over the history, and L the time from the
//! sampling of the report to the middle of the command's time in force. T follows from a memory of
//! 0.75 over 1 s, as the walks `gauss-markov` of a scenario have it. Source: Liang and Haas,
//! Predictive distance-based mobility management for PCS networks, IEEE INFOCOM 1999.
//!
//! # Layout of a row, version 1
//! Vectors are in the room's axes. Values of an absent report are 0.
//!
//! | values | meaning |
//! | --- | --- |
//! | [`REPORTS`] x 6 | reports, the oldest first: place less that of the last report in m (2), velocity in m/s (2), age against the last report in s, 1 for a present report |
//! | 1 | the lead in s |
//! | 4 | distances in m from the place of the last report to the walls -x, +x, -y, +y, at most [`WALL_MAX_M`] |

use heliostat_proto::{MAX_USERS, Nanos, UserReport, UserState};
use serde::{Deserialize, Serialize};

/// Version of the rows; a network made for another version is refused.
pub const WALK_VERSION: u32 = 1;

/// Reports that a row holds: one second at 10 reports/s.
pub const REPORTS: usize = 10;

/// Values of a report in a row.
pub const REPORT_VALUES: usize = 6;

/// Index of the lead in a row; the distances to the walls follow.
pub const LEAD: usize = REPORTS * REPORT_VALUES;

/// Length of a row.
pub const WALK_VALUES: usize = LEAD + 5;

/// Numbers of a network for each user: the correction of the displacement in m along x and y.
pub const DISPLACEMENT_VALUES: usize = 2;

/// A wall farther away than this counts as being at this distance.
pub const WALL_MAX_M: f64 = 1.0;

/// Correlation of the velocity over [`MEMORY_INTERVAL_S`].
const MEMORY: f64 = 0.75;

/// The time in s over which the velocity has the correlation [`MEMORY`].
const MEMORY_INTERVAL_S: f64 = 1.0;

/// One reported state of a user.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
struct Reported {
    time_ns: Nanos,
    position_m: [f64; 2],
    velocity_m_s: [f64; 2],
}

/// The last reports about one user.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
struct Walk {
    user: u32,
    /// Number of present reports.
    count: usize,
    /// The oldest first; the last `count` are present.
    reports: [Reported; REPORTS],
}

/// The state of the history, as a recording holds it.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct WalkMemory {
    walks: Vec<Walk>,
}

/// The last reports about all users, and the rows of the last observation. Its buffers are
/// allocated once.
#[derive(Clone, Debug)]
pub struct WalkHistory {
    walks: Vec<Walk>,
    former: Vec<Walk>,
    rows: Vec<[f32; WALK_VALUES]>,
    /// Row by row: place of the last report, and the Gauss-Markov displacement, in m.
    origins: Vec<[[f64; 2]; 2]>,
    /// Row by row; empty where no prediction was given.
    places: Vec<[f64; 2]>,
}

impl Default for WalkHistory {
    fn default() -> Self {
        Self {
            walks: Vec::with_capacity(MAX_USERS),
            former: Vec::with_capacity(MAX_USERS),
            rows: Vec::with_capacity(MAX_USERS),
            origins: Vec::with_capacity(MAX_USERS),
            places: Vec::with_capacity(MAX_USERS),
        }
    }
}

impl WalkHistory {
    /// Takes an accepted position report. A user who is absent from it is forgotten.
    pub fn handle_users(&mut self, report: &UserReport) {
        std::mem::swap(&mut self.walks, &mut self.former);
        self.walks.clear();
        for user in report.users.iter().take(MAX_USERS) {
            let known = self.former.iter().find(|walk| walk.user == user.user).copied();
            let mut walk = known.unwrap_or(Walk { user: user.user, count: 0, reports: Default::default() });
            walk.push(report.stamp.time_ns, user);
            self.walks.push(walk);
        }
    }

    /// Forgets these users, since their numbers belong to others now.
    pub fn forget_users(&mut self, users: &[u32]) {
        self.walks.retain(|walk| !users.contains(&walk.user));
    }

    /// Forgets all users, since another source reports from now on.
    pub fn forget(&mut self) {
        self.walks.clear();
    }

    /// Starts the rows of an observation.
    pub(super) fn begin(&mut self) {
        self.rows.clear();
        self.origins.clear();
        self.places.clear();
    }

    /// Adds the row of the next user, for a time in s after the last report, in a room with these
    /// half lengths in m. The row of an unknown user stays at `position_m`.
    pub(super) fn add(&mut self, (user, position_m): (u32, [f64; 2]), lead_s: f64, half_room_m: [f64; 2]) {
        let mut row = [0.0; WALK_VALUES];
        let walk = self.walks.iter().find(|walk| walk.user == user);
        let last = walk.map_or(position_m, |walk| walk.last().position_m);
        if let Some(walk) = walk {
            walk.write(&mut row[..LEAD]);
        }
        row[LEAD] = lead_s as f32;
        let [[left, right], [back, front]] = [0, 1].map(|axis: usize| {
            [last[axis] + half_room_m[axis], half_room_m[axis] - last[axis]]
                .map(|distance_m| distance_m.clamp(0.0, WALL_MAX_M) as f32)
        });
        row[LEAD + 1..].copy_from_slice(&[left, right, back, front]);
        self.rows.push(row);
        self.origins.push([last, walk.map_or([0.0; 2], |walk| walk.displacement_m(lead_s))]);
    }

    /// The rows of the last observation. Shape: K * [`WALK_VALUES`].
    pub fn rows(&self) -> &[[f32; WALK_VALUES]] {
        &self.rows
    }

    /// The place that the Gauss-Markov prediction gives for each row, in m, which a network
    /// corrects. Shape: K * 2.
    pub fn expected_m(&self) -> impl ExactSizeIterator<Item = [f64; 2]> {
        self.origins.iter().map(|[[x, y], [dx, dy]]| [x + dx, y + dy])
    }

    /// The place of the last report of each row, in m. Shape: K * 2.
    pub fn reported_m(&self) -> impl ExactSizeIterator<Item = [f64; 2]> {
        self.origins.iter().map(|[last, _]| *last)
    }

    /// Adds the outputs of a network to the Gauss-Markov predictions of all users. Shape of
    /// `outputs`: K * [`DISPLACEMENT_VALUES`], row-major. Other lengths leave the users without a
    /// prediction.
    pub fn predict(&mut self, outputs: &[f32]) {
        let (rows, rest) = outputs.as_chunks::<DISPLACEMENT_VALUES>();
        self.places.clear();
        if rows.len() == self.rows.len() && rest.is_empty() {
            let Self { origins, places, .. } = self;
            let add = |([[x, y], [dx, dy]], [more_x, more_y]): (&[[f64; 2]; 2], &[f32; 2])| {
                [x + dx + f64::from(*more_x), y + dy + f64::from(*more_y)]
            };
            places.extend(origins.iter().zip(rows).map(add));
        }
    }

    /// The predicted place of each row in m; empty without a prediction.
    pub(super) fn places_m(&self) -> &[[f64; 2]] {
        &self.places
    }

    /// The present state.
    pub fn memory(&self) -> WalkMemory {
        WalkMemory { walks: self.walks.clone() }
    }

    /// Replaces the state; false where it is none.
    pub fn restore(&mut self, memory: &WalkMemory) -> bool {
        let is_sound = memory.walks.len() <= MAX_USERS && memory.walks.iter().all(Walk::is_sound);
        if is_sound {
            self.walks.clear();
            self.walks.extend_from_slice(&memory.walks);
        }
        is_sound
    }
}

impl Walk {
    fn push(&mut self, time_ns: Nanos, user: &UserState) {
        let [x, y, _] = user.position_m.map(f64::from);
        let elapsed_s = time_ns.saturating_sub(self.last().time_ns) as f64 * 1e-9;
        let mut velocity_m_s = user.velocity_m_s.map(f64::from);
        // A tracker that does not measure the velocity reports zeros.
        if user.velocity_m_s == [0.0; 2] && self.count > 0 && elapsed_s > 0.0 {
            let [last_x, last_y] = self.last().position_m;
            velocity_m_s = [(x - last_x) / elapsed_s, (y - last_y) / elapsed_s];
        }
        self.reports.rotate_left(1);
        self.reports[REPORTS - 1] = Reported { time_ns, position_m: [x, y], velocity_m_s };
        self.count = (self.count + 1).min(REPORTS);
    }

    fn present(&self) -> &[Reported] {
        &self.reports[REPORTS - self.count..]
    }

    fn last(&self) -> &Reported {
        &self.reports[REPORTS - 1]
    }

    /// Writes the reports; the values of absent ones stay.
    fn write(&self, values: &mut [f32]) {
        let last = self.last();
        let (slots, _) = values.as_chunks_mut::<REPORT_VALUES>();
        for (slot, report) in slots[REPORTS - self.count..].iter_mut().zip(self.present()) {
            let [x, y] = [0, 1].map(|axis: usize| report.position_m[axis] - last.position_m[axis]);
            let [u, v] = report.velocity_m_s;
            let age_s = last.time_ns.saturating_sub(report.time_ns) as f64 * 1e-9;
            *slot = [x, y, u, v, age_s, 1.0].map(|value| value as f32);
        }
    }

    /// The Gauss-Markov prediction; the [module](self) has the equation.
    fn displacement_m(&self, lead_s: f64) -> [f64; 2] {
        let constant_s = -MEMORY_INTERVAL_S / MEMORY.ln();
        let kept_s = constant_s * (1.0 - (-lead_s / constant_s).exp());
        [0, 1].map(|axis: usize| {
            let sum: f64 = self.present().iter().map(|report| report.velocity_m_s[axis]).sum();
            let mean = sum / self.count.max(1) as f64;
            mean * lead_s + (self.last().velocity_m_s[axis] - mean) * kept_s
        })
    }

    fn is_sound(&self) -> bool {
        let is_finite =
            |report: &Reported| report.position_m.iter().chain(&report.velocity_m_s).all(|value| value.is_finite());
        (1..=REPORTS).contains(&self.count) && self.reports.iter().all(is_finite)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use heliostat_proto::Stamp;

    const HALF_ROOM_M: [f64; 2] = [2.5, 2.0];

    /// Reports each 0.1 s about users who stand at the origin at the first one and have these
    /// velocities.
    fn walked(reports: u64, velocities_m_s: &[[f32; 2]]) -> WalkHistory {
        let mut history = WalkHistory::default();
        for index in 0..reports {
            let stamp = Stamp { source: 1, sequence: index + 1, time_ns: index * 100_000_000 };
            let user = |(user, velocity): (usize, &[f32; 2])| UserState {
                user: user as u32,
                position_m: [0.1 * index as f32 * velocity[0], 0.1 * index as f32 * velocity[1], 1.0],
                velocity_m_s: *velocity,
                ..UserState::default()
            };
            let users = velocities_m_s.iter().enumerate().map(user).collect();
            history.handle_users(&UserReport { stamp, tick: index + 1, users });
        }
        history
    }

    fn row(history: &mut WalkHistory, user: u32) -> [f32; WALK_VALUES] {
        history.begin();
        history.add((user, [0.0; 2]), 0.25, HALF_ROOM_M);
        history.rows()[0]
    }

    fn near(one: &[f32], other: &[f32]) -> bool {
        one.len() == other.len() && one.iter().zip(other).all(|(one, other)| (one - other).abs() < 1e-5)
    }

    #[test]
    fn a_row_holds_the_reports_the_lead_and_the_walls() {
        let mut history = walked(13, &[[0.5, 0.0], [0.0, -1.0]]);
        let found = row(&mut history, 1);
        assert!(near(&found[..6], &[0.0, 0.9, 0.0, -1.0, 0.9, 1.0]), "{:?}", &found[..6]);
        assert!(near(&found[LEAD - 6..LEAD], &[0.0, 0.0, 0.0, -1.0, 0.0, 1.0]));
        // The last place is (0, -1.2).
        assert!(near(&found[LEAD..], &[0.25, 1.0, 1.0, 0.8, 1.0]), "{:?}", &found[LEAD..]);
    }

    #[test]
    fn absent_reports_are_zero_and_a_user_who_left_starts_again() {
        let mut history = walked(3, &[[0.5, 0.0], [0.0, -1.0]]);
        assert!(row(&mut history, 1)[..LEAD - 18].iter().all(|value| *value == 0.0));
        let stamp = Stamp { source: 1, sequence: 9, time_ns: 900_000_000 };
        let only = |user| vec![UserState { user, ..UserState::default() }];
        history.handle_users(&UserReport { stamp, tick: 9, users: only(0) });
        history.handle_users(&UserReport { stamp, tick: 10, users: only(1) });
        let found = row(&mut history, 1);
        assert!(found[..LEAD - 6].iter().all(|value| *value == 0.0) && found[LEAD - 1] == 1.0);
        assert!(row(&mut history, 7)[..LEAD].iter().all(|value| *value == 0.0), "an unknown user");
    }

    #[test]
    fn a_number_that_another_user_got_starts_again() {
        let mut history = walked(3, &[[0.5, 0.0], [0.0, -1.0]]);
        history.forget_users(&[1, 9]);
        let stamp = Stamp { source: 1, sequence: 9, time_ns: 300_000_000 };
        let users = [0, 1].map(|user| UserState { user, ..UserState::default() }).into();
        history.handle_users(&UserReport { stamp, tick: 9, users });
        let reports = |history: &mut WalkHistory, user| row(history, user)[5..LEAD].iter().step_by(6).sum::<f32>();
        assert_eq!([0, 1].map(|user| reports(&mut history, user)), [4.0, 1.0]);
    }

    #[test]
    fn a_constant_velocity_continues_and_a_new_one_returns_to_the_mean() {
        let mut history = walked(12, &[[0.8, -0.4]]);
        row(&mut history, 0);
        let [x, y] = history.expected_m().next().unwrap();
        let [last_x, last_y] = history.reported_m().next().unwrap();
        assert!((x - last_x - 0.2).abs() < 1e-6 && (y - last_y + 0.1).abs() < 1e-6, "{x} {y}");
        let turned = UserState { velocity_m_s: [0.0, 1.0], ..UserState::default() };
        let stamp = Stamp { source: 1, sequence: 99, time_ns: 1_200_000_000 };
        history.handle_users(&UserReport { stamp, tick: 99, users: vec![turned] });
        row(&mut history, 0);
        // Of the mean 0.9 * 0.8 the factor 1 - (T / L) (1 - exp(-L / T)) is left.
        let [x, _] = history.expected_m().next().unwrap();
        let constant_s = -1.0 / 0.75_f64.ln();
        let expected = 0.72 * (0.25 - constant_s * (1.0 - (-0.25 / constant_s).exp()));
        assert!((x - expected).abs() < 1e-6, "{x} for {expected}");
    }

    #[test]
    fn outputs_move_the_expected_place_and_those_of_another_length_do_not_count() {
        let mut history = walked(12, &[[0.8, -0.4]]);
        row(&mut history, 0);
        let [x, y] = history.expected_m().next().unwrap();
        history.predict(&[0.5, -0.25]);
        assert_eq!(history.places_m(), [[x + 0.5, y - 0.25]]);
        history.predict(&[0.5]);
        assert!(history.places_m().is_empty());
    }
}
