//! `heliostat-lab trace export`: the users' positions of a recording as a recorded walk.

use std::io::Read;
use std::path::PathBuf;

use anyhow::{Context, Result, ensure};
use heliostat_files::shell_word;
use heliostat_proto::{Nanos, NodeKind, Room, RoomGeometry, RoomTruth, SPEED_MAX_M_S, UserReport, decode};
use heliostat_record::file::{self, Reading};
use heliostat_room::walks::figures;
use heliostat_room::walks::rows::Row;
use heliostat_room::walks::text::APART_S;
use heliostat_room::walks::tracks::{Collected, Collector, Kept, Track, TrackPoint};
use heliostat_room::world::walker::Floor;
use heliostat_scenario::Scenario;
use heliostat_service::counted::counted;
use heliostat_service::exit::UnusableInput;
use serde_json::json;

use super::written::write_trace;
use heliostat_service::outln;
use heliostat_service::whole_file;

/// Largest speed in m/s between two positions: below that of a recorded walk by more than the rounding of its text.
const SPEED_M_S: f64 = 0.8 * SPEED_MAX_M_S;

/// Write the users' positions of a recording as a recorded walk.
///
/// The positions are the true ones with headings, where a simulated room published them, else the
/// reported ones, with the noise of the tracker. Users are numbered from 0 in the order of their
/// numbers in the recording. A user who enters or leaves stands still before and after: `heliostat
/// trace import --format csv --fit none` selects users who are present throughout.
#[derive(Debug, clap::Args)]
pub struct ExportArgs {
    /// The recording (MCAP)
    recording: PathBuf,
    /// The recorded walk to write (CSV); an existing file is not overwritten
    #[arg(long, value_name = "FILE.csv")]
    out: PathBuf,
    /// Print the report as one JSON object
    #[arg(long)]
    json: bool,
}

/// The users of a recording.
struct Recorded {
    /// Whether the positions are the true ones.
    is_true: bool,
    users: Vec<Track>,
    /// Positions whose time was not after the one before, or too close to it.
    refused: u64,
    /// Positions to which their user can only have jumped.
    jumps: usize,
    floor: Floor,
}

/// Reads the recording, writes the walk, and prints what it holds.
pub fn run(args: &ExportArgs) -> Result<()> {
    let unusable = || UnusableInput::new(format!("{} cannot be exported", args.recording.display()));
    whole_file::check_distinct([("the recording", Some(&args.recording)), ("--out", Some(&args.out))])?;
    whole_file::check_new(&args.out)?;
    let recorded = file::open(&args.recording).map_err(Into::into).and_then(users).with_context(unusable)?;
    write_trace(&recorded.users, &recorded.floor, &args.out)?;
    print(args, &recorded)
}

fn print(args: &ExportArgs, recorded: &Recorded) -> Result<()> {
    let Recorded { is_true, users, refused, jumps, .. } = recorded;
    let (out, count, duration_s) = (args.out.display().to_string(), users.len(), figures::duration_s(users));
    let usage = format!("--set users.count={count} --set {}", shell_word(&format!("users.trace={out}")));
    let samples: usize = users.iter().map(|user| user.points.len()).sum();
    if args.json {
        let of_user = |user: &Track| json!({ "user": user.pedestrian, "from_s": user.start_s(), "to_s": user.end_s(), "positions": user.points.len() });
        let pedestrians: Vec<_> = users.iter().map(of_user).collect();
        let positions = if *is_true { "true" } else { "reported" };
        let report = json!({
            "positions": positions, "samples": samples, "refused": refused, "jumps": jumps, "duration_s": duration_s,
            "users": pedestrians, "out": out, "use": usage,
        });
        return Ok(outln!("{report}")?);
    }
    let kind = if *is_true { "true positions with headings" } else { "reported positions, with the tracker's noise" };
    outln!("{}: {kind}: {samples} of {} over {duration_s:.2} s", args.recording.display(), counted(count, "user"))?;
    if *refused > 0 {
        outln!("left out: {refused} positions whose time is not at least {APART_S} s after the one before")?;
    }
    if *jumps > 0 {
        outln!("left out: {jumps} positions to which a user jumped, as at the end of a walk that repeats")?;
    }
    for (number, user) in users.iter().enumerate().filter(|(_, user)| user.duration_s() < 0.99 * duration_s) {
        let (pedestrian, from_s, to_s) = (&user.pedestrian, user.start_s(), user.end_s());
        outln!(
            "user {number} (number {pedestrian}) is present from {from_s:.2} to {to_s:.2} s only, and stands still else"
        )?;
    }
    Ok(outln!("wrote {out}; use it in the same scenario with: {usage}")?)
}

/// The true positions of a recording, or else the reported ones.
fn users<R: Read>(mut reading: Reading<R>) -> Result<Recorded> {
    let header = reading.header().clone();
    let room = Room::new(&header.room)?;
    let mut positions = Positions::default();
    let mut geometry = None;
    while let Some(entry) = reading.entry()? {
        if entry.topic == room.truth() {
            positions.add_truth(&decode(&entry.data)?);
        } else if entry.topic == room.users() {
            positions.add_report(&decode(&entry.data)?);
        } else if entry.topic == room.geometry(NodeKind::SimNode) {
            geometry = Some(decode::<RoomGeometry>(&entry.data)?.scenario);
        }
    }
    let scenario = Scenario::from_recorded_toml(geometry.as_ref().unwrap_or(&header.scenario))?;
    let floor = Floor { length_x_m: scenario.room.length_x_m, length_y_m: scenario.room.length_y_m };
    let (is_true, collected) = positions.finish();
    let mut users = collected.tracks;
    users.sort_by_key(|user| user.pedestrian.parse::<u32>().ok());
    let start_s = users.iter().map(Track::start_s).fold(f64::INFINITY, f64::min);
    users.iter_mut().flat_map(|user| &mut user.points).for_each(|point| point.time_s -= start_s);
    let jumps: usize = users.iter_mut().map(|user| leave_out_jumps(&mut user.points)).sum();
    ensure!(!users.is_empty(), "it holds no positions of users: expected a recording of a room with users");
    ensure!(figures::duration_s(&users) > 0.0, "it holds positions of one time only: expected a longer recording");
    ensure!(collected.counts.beyond == 0, "it holds too many positions: expected a shorter recording");
    Ok(Recorded { is_true, users, refused: collected.counts.refused, jumps, floor })
}

/// Leaves out the positions after a jump until a user could have walked there; how many.
fn leave_out_jumps(points: &mut Vec<TrackPoint>) -> usize {
    let count = points.len();
    let mut last: Option<(f64, [f64; 2])> = None;
    points.retain(|point| {
        let [x, y] = point.at_m;
        let is_walk = last.is_none_or(|(time_s, [from_x, from_y])| {
            (x - from_x).hypot(y - from_y) <= SPEED_M_S * (point.time_s - time_s)
        });
        if is_walk {
            last = Some((point.time_s, point.at_m));
        }
        is_walk
    });
    count - points.len()
}

/// Positions by user, from both kinds of messages.
struct Positions {
    first_ns: Option<Nanos>,
    messages: u64,
    truth: Collector,
    reports: Collector,
}

impl Default for Positions {
    fn default() -> Self {
        let kept = Kept { max_gap_s: f64::INFINITY, ..Kept::default() };
        Self { first_ns: None, messages: 0, truth: Collector::new(kept), reports: Collector::new(kept) }
    }
}

impl Positions {
    fn add_truth(&mut self, truth: &RoomTruth) {
        let time_s = self.time_s(truth.stamp.time_ns);
        for user in &truth.users {
            let heading_rad = Some(f64::from(user.heading_rad));
            self.truth.add(Ok(self.row(time_s, user.user, user.position_m, heading_rad)));
        }
    }

    fn add_report(&mut self, report: &UserReport) {
        let time_s = self.time_s(report.stamp.time_ns);
        for user in &report.users {
            self.reports.add(Ok(self.row(time_s, user.user, user.position_m, None)));
        }
    }

    /// Time in s after the first message; the difference of two times in ns is exact.
    fn time_s(&mut self, time_ns: Nanos) -> f64 {
        self.messages += 1;
        let first_ns = *self.first_ns.get_or_insert(time_ns);
        (i128::from(time_ns) - i128::from(first_ns)) as f64 / 1e9
    }

    fn row(&self, time_s: f64, user: u32, [x, y, _]: [f32; 3], heading_rad: Option<f64>) -> Row {
        Row { line: self.messages, time_s, pedestrian: user.to_string(), at_m: [x, y].map(f64::from), heading_rad }
    }

    /// Whether there are true positions, and these or the reported ones.
    fn finish(self) -> (bool, Collected) {
        let truth = self.truth.finish();
        if truth.tracks.is_empty() { (false, self.reports.finish()) } else { (true, truth) }
    }
}

#[cfg(test)]
mod tests;
