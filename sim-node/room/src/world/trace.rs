//! Recorded walks in place of the random walk: a CSV text with the header `time,user,x,y`, or
//! `time,user,x,y,heading_deg`.
//!
//! Times are in s, users count from 0, positions are in m in the room frame. Between two samples of
//! a user the position is interpolated linearly; before the first and after the last sample it is
//! constant. At its latest time the recording repeats: all users jump back to their first
//! positions. No user is faster than a position report may say, [`SPEED_MAX_M_S`].
//!
//! With headings, in degrees from +x towards +y, a user faces as recorded, and turns along the
//! shortest arc between two samples. Without them a user faces the direction of the last section
//! that was walked at 0.05 m/s or more: a slower motion is the noise of a tracker, or a step of a
//! user who stands.

use std::f64::consts::{PI, TAU};

use heliostat_files::excerpt;
use heliostat_proto::SPEED_MAX_M_S;
use heliostat_scenario::WALKING_M_S;
use thiserror::Error;

use crate::walks::rows::hint;
use crate::world::walker::{Floor, Walker};

/// What is wrong with a recorded walk.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum TraceError {
    /// The first line that is neither empty nor a comment is not the header.
    #[error(
        "line {line}: invalid header `{}`: expected `time,user,x,y` or `time,user,x,y,heading_deg`; \
         `heliostat-lab trace import --format csv` makes such a file from other columns and separators",
        found.escape_debug()
    )]
    Header {
        /// Line number, from 1.
        line: usize,
        /// The beginning of the line.
        found: String,
    },
    /// A line has another number of columns than the header.
    #[error("line {line}: number of columns {found}: expected {expected}, as in the header")]
    Columns {
        /// Line number, from 1.
        line: usize,
        /// Columns in it.
        found: usize,
        /// Columns of the header.
        expected: usize,
    },
    /// A column holds no finite number.
    #[error(
        "line {line}: invalid {column} `{found}`: expected a finite number, for `user` a whole one{}",
        hint(column, found)
    )]
    Value {
        /// Line number, from 1.
        line: usize,
        /// Name of the column.
        column: &'static str,
        /// The beginning of the text in the column.
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
    #[error(
        "line {line}: time {time} of user {user} is not after {previous}: expected ascending times for each user; \
         sort the rows by time"
    )]
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
    /// A user moves faster than a position report may say.
    #[error(
        "line {line}: user {user} moves {distance_m:.3} m within {time_s:.3e} s: expected at most {} m/s; \
         check the times, which are in s, and the positions, which are in m",
        SPEED_MAX_M_S
    )]
    Speed {
        /// Line number, from 1.
        line: usize,
        /// The user.
        user: usize,
        /// Distance from the sample before it in m.
        distance_m: f64,
        /// Time since the sample before it in s.
        time_s: f64,
    },
    /// There is no line.
    #[error("the file is empty: expected the header time,user,x,y[,heading_deg], then samples of each user")]
    Empty,
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

/// The columns; the last one is optional.
const COLUMNS: [&str; 5] = ["time", "user", "x", "y", "heading_deg"];

/// Largest number of problems that are listed.
const PROBLEMS_MAX: usize = 50;

/// A line of samples.
#[derive(Clone, Copy, Debug)]
struct Line<'a> {
    line: usize,
    row: &'a str,
    /// Columns of the header.
    columns: usize,
}

#[derive(Clone, Copy, Debug)]
struct Sample {
    time: f64,
    at: [f64; 2],
    /// Recorded heading in rad.
    heading: Option<f64>,
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
            let facing = recorded_direction(last.as_ref(), samples.get(next), now);
            walker.direction = facing.or(last.and_then(|last| last.facing)).unwrap_or(walker.direction);
        }
    }
}

/// The direction of the recorded heading at a time between two samples, as a unit vector; `None`
/// without headings.
fn recorded_direction(last: Option<&Sample>, next: Option<&Sample>, now: f64) -> Option<[f64; 2]> {
    let heading = match (last, next) {
        (Some(a), Some(b)) => {
            let (from, to) = a.heading.zip(b.heading)?;
            let turn = (to - from + PI).rem_euclid(TAU) - PI;
            from + turn * (now - a.time) / (b.time - a.time)
        }
        (only, first) => only.or(first)?.heading?,
    };
    Some([heading.cos(), heading.sin()])
}

/// Sets the direction of movement in which a user faces at each sample.
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
    // Editors and spreadsheets write a byte order mark.
    let text = text.trim_start_matches('\u{feff}');
    let lines = text.lines().enumerate().map(|(index, row)| (index + 1, row.trim()));
    let mut rows = lines.filter(|(_, row)| !row.is_empty() && !row.starts_with('#'));
    let mut columns = COLUMNS.len() - 1;
    let Some((line, row)) = rows.next() else {
        report(TraceError::Empty);
        return samples;
    };
    let names: Vec<&str> = row.split(',').map(str::trim).collect();
    let is_header = names == COLUMNS || names == COLUMNS[..columns];
    if is_header {
        columns = names.len();
    } else if !report(TraceError::Header { line, found: excerpt(row) }) {
        return samples;
    }
    let mut is_complete = true;
    for (line, row) in rows {
        if let Err(problem) = add_row(Line { line, row, columns }, floor, &mut samples) {
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
fn add_row(text: Line<'_>, floor: &Floor, samples: &mut [Vec<Sample>]) -> Result<(), TraceError> {
    let line = text.line;
    let (user, sample) = parse_row(text, floor)?;
    let last = samples.len().saturating_sub(1);
    let list = samples.get_mut(user).ok_or(TraceError::User { line, user, last })?;
    if let Some(previous) = list.last() {
        check_after(previous, &sample, (line, user))?;
    }
    list.push(sample);
    Ok(())
}

/// Checks that the sample of this line follows the previous one of its user, at a possible speed.
fn check_after(previous: &Sample, sample: &Sample, (line, user): (usize, usize)) -> Result<(), TraceError> {
    if previous.time >= sample.time {
        return Err(TraceError::Order { line, user, time: sample.time, previous: previous.time });
    }
    let distance_m = (sample.at[0] - previous.at[0]).hypot(sample.at[1] - previous.at[1]);
    let time_s = sample.time - previous.time;
    if distance_m / time_s > SPEED_MAX_M_S {
        return Err(TraceError::Speed { line, user, distance_m, time_s });
    }
    Ok(())
}

fn between(a: &Sample, b: &Sample, now: f64) -> ([f64; 2], [f64; 2]) {
    let span = b.time - a.time;
    let velocity = [(b.at[0] - a.at[0]) / span, (b.at[1] - a.at[1]) / span];
    let since = now - a.time;
    ([a.at[0] + velocity[0] * since, a.at[1] + velocity[1] * since], velocity)
}

fn parse_row(text: Line<'_>, floor: &Floor) -> Result<(usize, Sample), TraceError> {
    let Line { line, row, columns: expected } = text;
    let columns: Vec<&str> = row.split(',').map(str::trim).collect();
    let (&[time, user, x, y], heading) = match columns.split_first_chunk::<4>() {
        Some((first, rest)) if columns.len() == expected => (first, rest.first()),
        _ => return Err(TraceError::Columns { line, found: columns.len(), expected }),
    };
    let number = |column, text: &str| {
        let value = text.parse::<f64>().ok().filter(|value| value.is_finite());
        value.ok_or_else(|| TraceError::Value { line, column, found: excerpt(text) })
    };
    let user = user.parse().map_err(|_| TraceError::Value { line, column: "user", found: excerpt(user) })?;
    let (time, x, y) = (number("time", time)?, number("x", x)?, number("y", y)?);
    let heading = heading.map(|text| number(COLUMNS[4], text)).transpose()?;
    if !floor.contains(x, y) {
        let (length_x_m, length_y_m) = (floor.length_x_m, floor.length_y_m);
        return Err(TraceError::Outside { line, x, y, length_x_m, length_y_m });
    }
    let heading = heading.map(|degrees| (degrees % 360.0).to_radians());
    Ok((user, Sample { time, at: [x, y], heading, facing: None }))
}

#[cfg(test)]
mod tests;
