//! Recorded walks in place of the random walk: a CSV text with the header `time,user,x,y`.
//!
//! Times are in s, users count from 0, positions are in m in the room frame. Between two samples of
//! a user the position is interpolated linearly; before the first and after the last sample it is
//! constant. At its latest time the recording repeats: all users jump back to their first
//! positions.
//!
//! A user faces the direction of the last section that was walked at 0.05 m/s or more: a slower
//! motion is the noise of a tracker, or a step of a user who stands.

use thiserror::Error;

use crate::world::walker::{Floor, Walker};

/// What is wrong with a recorded walk.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum TraceError {
    /// The first line that is neither empty nor a comment is not the header.
    #[error("line {line}: invalid header `{found}`: expected `time,user,x,y`")]
    Header {
        /// Line number, from 1.
        line: usize,
        /// The line as it stands.
        found: String,
    },
    /// A line has another number of columns than four.
    #[error("line {line}: number of columns {found}: expected 4 (time,user,x,y)")]
    Columns {
        /// Line number, from 1.
        line: usize,
        /// Columns in it.
        found: usize,
    },
    /// A column holds no finite number.
    #[error("line {line}: invalid {column} `{found}`: expected a finite number, for `user` a whole one")]
    Value {
        /// Line number, from 1.
        line: usize,
        /// Name of the column.
        column: &'static str,
        /// The text in the column.
        found: String,
    },
    /// A user beyond the number in the scenario.
    #[error("line {line}: unknown user {user}: expected 0 to {last}, the users of the scenario")]
    User {
        /// Line number, from 1.
        line: usize,
        /// The user named there.
        user: usize,
        /// The last user of the scenario.
        last: usize,
    },
    /// A position outside the room.
    #[error(
        "line {line}: ({x}, {y}) is outside the room: expected a point within {length_x_m} m x {length_y_m} m, \
         centred on the origin"
    )]
    Outside {
        /// Line number, from 1.
        line: usize,
        /// x in m.
        x: f64,
        /// y in m.
        y: f64,
        /// Extent of the room along x in m.
        length_x_m: f64,
        /// Extent of the room along y in m.
        length_y_m: f64,
    },
    /// The samples of a user are not in order of time.
    #[error("line {line}: time {time} of user {user} is not after {previous}: expected ascending times for each user")]
    Order {
        /// Line number, from 1.
        line: usize,
        /// The user.
        user: usize,
        /// Time in s.
        time: f64,
        /// Time of the sample before it, in s.
        previous: f64,
    },
    /// A user has no sample.
    #[error("user {user} has no sample: expected at least one for each user (users.count = {users})")]
    Missing {
        /// The user.
        user: usize,
        /// How many users the scenario has.
        users: usize,
    },
    /// All samples are of one time, so there is no walk.
    #[error(
        "all samples are of the time {time} s: expected at least two times; users who stand still need no recording, \
         only users.speed_min_m_s = 0 and users.speed_max_m_s = 0"
    )]
    OneTime {
        /// The time in s.
        time: f64,
    },
}

/// Speed in m/s from which on a motion shows the direction in which a user faces.
const WALKING_M_S: f64 = 0.05;

/// Largest number of problems that are listed.
const PROBLEMS_MAX: usize = 50;

#[derive(Clone, Copy, Debug)]
struct Sample {
    time: f64,
    at: [f64; 2],
    /// Unit vector in which the user faces from here to the next sample; `None` before the first
    /// walk.
    facing: Option<[f64; 2]>,
}

/// A recorded walk and its playback position.
#[derive(Clone, Debug)]
pub struct Trace {
    users: Vec<Vec<Sample>>,
    start: f64,
    duration: f64,
    time: f64,
}

impl Trace {
    /// Parses a recorded walk of exactly `users` users.
    ///
    /// Lines that are empty or begin with `#` are skipped.
    ///
    /// # Errors
    /// [`TraceError`], with the line.
    pub fn parse(text: &str, users: usize, floor: &Floor) -> Result<Self, TraceError> {
        let mut first = None;
        let samples = read(text, users, floor, &mut |problem| {
            first = Some(problem);
            false
        });
        match first {
            Some(problem) => Err(problem),
            None => Ok(Self::of(samples)),
        }
    }

    /// All problems of a recorded walk, at most 50 of them.
    pub fn problems(text: &str, users: usize, floor: &Floor) -> Vec<TraceError> {
        let mut problems = Vec::new();
        read(text, users, floor, &mut |problem| {
            problems.push(problem);
            problems.len() < PROBLEMS_MAX
        });
        problems
    }

    fn of(mut users: Vec<Vec<Sample>>) -> Self {
        let [start, end] = times(&users);
        users.iter_mut().for_each(|samples| face(samples));
        Self { users, start, duration: end - start, time: 0.0 }
    }

    /// Advances the playback by `dt_s` seconds.
    pub fn step(&mut self, dt_s: f64) {
        if self.duration > 0.0 {
            self.time = (self.time + dt_s) % self.duration;
        }
    }

    /// Duration of the recording in s.
    pub fn duration_s(&self) -> f64 {
        self.duration
    }

    /// Continues at this time in s after the first sample; the recording repeats before and after.
    pub fn seek(&mut self, time_s: f64) {
        if self.duration > 0.0 {
            self.time = time_s.rem_euclid(self.duration);
        }
    }

    /// Writes the users' positions, headings and velocities.
    ///
    /// Heights do not change, nor does the heading of a user who has not walked yet.
    pub fn write(&self, walkers: &mut [Walker]) {
        let now = self.start + self.time;
        for (samples, walker) in self.users.iter().zip(walkers) {
            let next = samples.partition_point(|sample| sample.time <= now);
            let last = next.checked_sub(1).map(|index| samples[index]);
            let (at, velocity) = match (last, samples.get(next)) {
                (Some(a), Some(b)) => between(&a, b, now),
                (Some(only), None) => (only.at, [0.0, 0.0]),
                (None, Some(first)) => (first.at, [0.0, 0.0]),
                (None, None) => unreachable!("every user has a sample"),
            };
            walker.position.x = at[0];
            walker.position.y = at[1];
            walker.velocity = velocity;
            walker.direction = last.and_then(|last| last.facing).unwrap_or(walker.direction);
        }
    }
}

/// Sets the direction in which a user faces at each sample.
fn face(samples: &mut [Sample]) {
    let mut facing = None;
    for index in 0..samples.len() {
        if let Some(next) = samples.get(index + 1) {
            let (_, [u, v]) = between(&samples[index], next, next.time);
            let speed = (u * u + v * v).sqrt();
            if speed >= WALKING_M_S {
                facing = Some([u / speed, v / speed]);
            }
        }
        samples[index].facing = facing;
    }
}

/// The first and the last time of all samples in s.
fn times(users: &[Vec<Sample>]) -> [f64; 2] {
    let times = || users.iter().flatten().map(|sample| sample.time);
    [times().fold(f64::INFINITY, f64::min), times().fold(f64::NEG_INFINITY, f64::max)]
}

/// Reads the samples of each user, and reports each problem; stops where `report` returns false.
fn read(text: &str, users: usize, floor: &Floor, report: &mut dyn FnMut(TraceError) -> bool) -> Vec<Vec<Sample>> {
    let mut samples: Vec<Vec<Sample>> = vec![Vec::new(); users];
    let lines = text.lines().enumerate().map(|(index, row)| (index + 1, row.trim()));
    let mut rows = lines.filter(|(_, row)| !row.is_empty() && !row.starts_with('#'));
    if let Some((line, row)) = rows.next()
        && row.split(',').map(str::trim).ne(["time", "user", "x", "y"])
        && !report(TraceError::Header { line, found: row.to_owned() })
    {
        return samples;
    }
    let mut is_complete = true;
    for (line, row) in rows {
        if let Err(problem) = add_row(line, row, floor, &mut samples) {
            is_complete = false;
            if !report(problem) {
                return samples;
            }
        }
    }
    for user in (0..users).filter(|user| samples[*user].is_empty()) {
        // A refused line may have been the user's only one.
        if is_complete && !report(TraceError::Missing { user, users }) {
            return samples;
        }
    }
    let [start, end] = times(&samples);
    if is_complete && start == end {
        report(TraceError::OneTime { time: start });
    }
    samples
}

/// Adds the sample of a row to its user.
fn add_row(line: usize, row: &str, floor: &Floor, samples: &mut [Vec<Sample>]) -> Result<(), TraceError> {
    let (user, sample) = parse_row(line, row, floor)?;
    let last = samples.len().saturating_sub(1);
    let list = samples.get_mut(user).ok_or(TraceError::User { line, user, last })?;
    if let Some(previous) = list.last().filter(|previous| previous.time >= sample.time) {
        return Err(TraceError::Order { line, user, time: sample.time, previous: previous.time });
    }
    list.push(sample);
    Ok(())
}

fn between(a: &Sample, b: &Sample, now: f64) -> ([f64; 2], [f64; 2]) {
    let span = b.time - a.time;
    let velocity = [(b.at[0] - a.at[0]) / span, (b.at[1] - a.at[1]) / span];
    let since = now - a.time;
    ([a.at[0] + velocity[0] * since, a.at[1] + velocity[1] * since], velocity)
}

fn parse_row(line: usize, row: &str, floor: &Floor) -> Result<(usize, Sample), TraceError> {
    let columns: Vec<&str> = row.split(',').map(str::trim).collect();
    let &[time, user, x, y] = columns.as_slice() else {
        return Err(TraceError::Columns { line, found: columns.len() });
    };
    let number = |column, text: &str| {
        let value = text.parse::<f64>().ok().filter(|value| value.is_finite());
        value.ok_or_else(|| TraceError::Value { line, column, found: text.to_owned() })
    };
    let user = user.parse().map_err(|_| TraceError::Value { line, column: "user", found: user.to_owned() })?;
    let (time, x, y) = (number("time", time)?, number("x", x)?, number("y", y)?);
    if !floor.contains(x, y) {
        let (length_x_m, length_y_m) = (floor.length_x_m, floor.length_y_m);
        return Err(TraceError::Outside { line, x, y, length_x_m, length_y_m });
    }
    Ok((user, Sample { time, at: [x, y], facing: None }))
}

#[cfg(test)]
mod tests {
    use heliostat_channel::Vec3;

    use super::*;

    const FLOOR: Floor = Floor { length_x_m: 5.0, length_y_m: 5.0 };
    const TWO: &str = "time,user,x,y\n# a comment\n10,0,0,0\n10, 1, 1, 1\n\n12,0,2,0\n14,0,2,2\n";

    fn at(trace: &Trace) -> Vec<Walker> {
        let mut out =
            vec![Walker { position: Vec3::new(9.0, 9.0, 0.85), direction: [0.0, 1.0], velocity: [9.0, 9.0] }; 2];
        trace.write(&mut out);
        out
    }

    #[test]
    fn interpolates_holds_and_repeats() {
        let mut trace = Trace::parse(TWO, 2, &FLOOR).unwrap();
        assert_eq!(at(&trace)[0].position, Vec3::new(0.0, 0.0, 0.85));
        trace.step(0.5);
        let now = at(&trace);
        assert_eq!((now[0].position, now[0].velocity), (Vec3::new(0.5, 0.0, 0.85), [1.0, 0.0]));
        assert_eq!(now[0].direction, [1.0, 0.0]);
        // User 1 has one sample: it stands still and keeps its heading.
        assert_eq!((now[1].position, now[1].velocity), (Vec3::new(1.0, 1.0, 0.85), [0.0, 0.0]));
        assert_eq!(now[1].direction, [0.0, 1.0]);
        trace.step(2.5);
        assert_eq!(at(&trace)[0].position, Vec3::new(2.0, 1.0, 0.85));
        trace.step(1.0 + 4.0 + 0.25);
        assert_eq!(at(&trace)[0].position, Vec3::new(0.25, 0.0, 0.85));
    }

    #[test]
    fn a_user_who_creeps_keeps_the_direction_of_the_last_walk() {
        // A walk along x, then a tracker's noise of some millimetres, then a walk along -y.
        let text = "time,user,x,y\n0,0,0,0\n1,0,1,0\n2,0,1.01,0.02\n3,0,1,-0.01\n4,0,1,-0.51\n";
        let mut trace = Trace::parse(text, 1, &FLOOR).unwrap();
        let mut facing = |time_s| {
            trace.seek(time_s);
            let mut walkers = [Walker { position: Vec3::zeros(), direction: [0.0, 1.0], velocity: [0.0, 0.0] }];
            trace.write(&mut walkers);
            walkers[0].direction
        };
        for (time_s, expected) in [(0.5, [1.0, 0.0]), (1.5, [1.0, 0.0]), (2.5, [1.0, 0.0]), (3.5, [0.0, -1.0])] {
            assert_eq!(facing(time_s), expected, "after {time_s} s");
        }
        // A place in the recording is found from both sides.
        assert_eq!((facing(-0.5), trace.duration_s()), ([0.0, -1.0], 4.0));
    }

    #[test]
    fn a_recording_of_one_row_is_refused_with_what_is_expected() {
        let error = |text: &str, users| Trace::parse(text, users, &FLOOR).unwrap_err().to_string();
        for (rows, users) in [("3,0,1,1\n", 1), ("3,0,1,1\n3,1,0,0\n", 2)] {
            let text = error(&format!("time,user,x,y\n{rows}"), users);
            assert!(text.contains("time 3 s") && text.contains("at least two times"), "{text}");
        }
        assert!(error("time,user,x,y\n", 1).contains("user 0 has no sample"));
    }

    #[test]
    fn all_problems_of_a_recording_are_listed() {
        let text = "time,user,x,y\n0,0,9,0\n0,1,1,1\n1,1,a,1\n0,1,1,1\n2,7,0,0\n";
        let lines: Vec<String> = Trace::problems(text, 2, &FLOOR).iter().map(ToString::to_string).collect();
        assert_eq!(lines.len(), 4, "{lines:?}");
        for (line, number) in lines.iter().zip([2, 4, 5, 6]) {
            assert!(line.starts_with(&format!("line {number}: ")), "{line}");
        }
        assert!(Trace::problems(TWO, 2, &FLOOR).is_empty());
    }

    #[test]
    fn errors_name_the_line() {
        let error = |body: &str| Trace::parse(&format!("time,user,x,y\n{body}"), 2, &FLOOR).unwrap_err().to_string();
        assert!(error("0,0,1").contains("line 2: number of columns 3"));
        assert!(error("0,0,1,1\n0,0,x,1").contains("line 3: invalid x `x`"));
        assert!(error("0,0,1,NaN").contains("line 2: invalid y `NaN`"));
        assert!(error("0,-1,1,1").contains("line 2: invalid user `-1`"));
        assert!(error("0,2,1,1").contains("line 2: unknown user 2: expected 0 to 1"));
        assert!(error("0,0,2.6,1").contains("line 2: (2.6, 1) is outside"));
        assert!(error("1,0,1,1\n1,0,1,1").contains("line 3: time 1 of user 0 is not after 1"));
        assert!(error("1,0,1,1").contains("user 1 has no sample"));
        assert!(
            Trace::parse("t,u,x,y\n", 1, &FLOOR).unwrap_err().to_string().contains("line 1: invalid header `t,u,x,y`")
        );
    }
}
