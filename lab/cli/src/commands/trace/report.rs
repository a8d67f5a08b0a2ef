//! What `heliostat-lab trace import` read, chose and wrote, as text or JSON.

use anyhow::Result;
use heliostat_files::shell_word;
use heliostat_room::walks::figures::{SpeedFigures, bounds, duration_s, rate_hz, speeds};
use heliostat_room::walks::placement::Placement;
use heliostat_room::walks::selection::{Presence, Selected};
use heliostat_room::walks::tracks::{Collected, Track};
use heliostat_service::counted::counted;
use serde_json::{Value, json};

use heliostat_service::outln;

/// Refused rows that the text lists; JSON lists all that are named.
const REFUSALS_SHOWN: usize = 10;

/// Below this factor the report advises a crop: walks at a third of their speed are not walks.
const SLOW: f64 = 1.0 / 3.0;

/// The report of an import.
pub(super) struct ImportReport {
    pub file: String,
    pub out: String,
    pub scenario: String,
    /// Whether no flag has named the room.
    pub is_default_room: bool,
    pub overrides: Vec<String>,
    pub collected: Collected,
    /// What is unusual about the file.
    pub warnings: Vec<String>,
    pub presence: Presence,
    pub selected: Selected,
    /// The users' tracks before they were placed.
    pub recorded: Vec<Track>,
    pub placement: Placement,
}

/// Prints the report.
pub(super) fn print(report: &ImportReport, json: bool) -> Result<()> {
    if json {
        return Ok(outln!("{}", json_of(report))?);
    }
    print_read(&report.file, &report.collected)?;
    for warning in &report.warnings {
        outln!("  warning     {warning}")?;
    }
    print_selected(report)?;
    outln!("wrote {}; use it with:", report.out)?;
    Ok(outln!("  {}", usage(report))?)
}

fn print_read(file: &str, collected: &Collected) -> Result<()> {
    let (counts, tracks) = (collected.counts, &collected.tracks);
    outln!("read {file}")?;
    outln!(
        "  positions   {} used, {} outside the time range, {} outside the crop; {} refused",
        counts.kept,
        counts.out_of_range,
        counts.cropped,
        counted(counts.refused as usize, "row")
    )?;
    for refusal in collected.refusals.iter().take(REFUSALS_SHOWN) {
        outln!("  refused     line {}: {}", refusal.line, refusal.reason.escape_debug())?;
    }
    if counts.refused > REFUSALS_SHOWN as u64 {
        outln!("  refused     and {} more; --json lists them", counts.refused - REFUSALS_SHOWN as u64)?;
    }
    outln!("  pedestrians      {} in {}", collected.pedestrians, counted(tracks.len(), "track"))?;
    let rate = rate_hz(tracks).map_or(String::new(), |rate| format!(", {rate:.2} positions a second"));
    outln!("  duration    {:.2} s{rate}", duration_s(tracks))?;
    if let Some(area) = bounds(tracks) {
        let ([x_min, y_min], [x_max, y_max]) = (area.min_m, area.max_m);
        outln!("  area        x {x_min:.2} to {x_max:.2} m, y {y_min:.2} to {y_max:.2} m")?;
    }
    Ok(outln!("  speed       {}", speed_text(speeds(tracks)))?)
}

fn print_selected(report: &ImportReport) -> Result<()> {
    let Selected { users, starts_s, duration_s } = &report.selected;
    outln!("selected")?;
    let default = if report.is_default_room { " (default, --scenario names another one)" } else { "" };
    outln!("  room        {}{default}", report.scenario)?;
    let from_s = starts_s[0] - report.collected.first_s;
    match report.presence {
        Presence::Together => outln!("  users       {}, together from {from_s:.2} s after the first row", users.len())?,
        Presence::Longest => {
            outln!("  users       {}, each from a time of its own, so they did not meet", users.len())?
        }
    }
    outln!("  pedestrians      {}", pedestrians(report).join(", ").escape_debug())?;
    let samples: usize = users.iter().map(|user| user.points.len()).sum();
    let headings = if has_headings(users) { "recorded headings" } else { "headings from movement" };
    outln!("  duration    {duration_s:.2} s, {}, {headings}", counted(samples, "position"))?;
    let Placement { factor: [x, y], centre_m } = report.placement;
    outln!("  scale       x {x:.3}, y {y:.3}; ({:.2}, {:.2}) is the middle of the room", centre_m[0], centre_m[1])?;
    outln!("  speed       {} as recorded", speed_text(speeds(&report.recorded)))?;
    outln!("  speed       {} in the room", speed_text(speeds(users)))?;
    if x.min(y) < SLOW {
        outln!("  note        speeds shrink with the walks: --crop chooses an area of the size of the room")?;
    }
    Ok(())
}

fn has_headings(users: &[Track]) -> bool {
    users.iter().flat_map(|user| &user.points).all(|point| point.heading_rad.is_some())
}

fn pedestrians(report: &ImportReport) -> Vec<&str> {
    report.selected.users.iter().map(|user| user.pedestrian.as_str()).collect()
}

fn speed_text(figures: Option<SpeedFigures>) -> String {
    figures.map_or("not known: the tracks are too short".into(), |SpeedFigures { median_m_s, p95_m_s }| {
        format!("median {median_m_s:.2} m/s, 95th percentile {p95_m_s:.2} m/s")
    })
}

/// A command that plays the walk, as a shell reads it.
fn usage(report: &ImportReport) -> String {
    let sets: String = report.overrides.iter().map(|set| format!(" --set {}", shell_word(set))).collect();
    let (scenario, users) = (shell_word(&report.scenario), report.selected.users.len());
    let trace = shell_word(&format!("users.trace={}", report.out));
    format!("heliostat demo --scenario {scenario}{sets} --set users.count={users} --set {trace}")
}

fn json_of(report: &ImportReport) -> Value {
    let Collected { tracks, counts, first_s, pedestrians: pedestrians_read, refusals, intervals_s: _ } =
        &report.collected;
    let starts_s: Vec<f64> = report.selected.starts_s.iter().map(|start_s| start_s - first_s).collect();
    let speed = |figures: Option<SpeedFigures>| {
        figures.map(|speeds| json!({ "median_m_s": speeds.median_m_s, "p95_m_s": speeds.p95_m_s }))
    };
    let refused: Vec<Value> =
        refusals.iter().map(|refusal| json!({ "line": refusal.line, "reason": refusal.reason })).collect();
    json!({
        "file": report.file,
        "read": {
            "positions": counts.kept,
            "out_of_range": counts.out_of_range,
            "cropped": counts.cropped,
            "refused_rows": counts.refused,
            "refused": refused,
            "pedestrians": pedestrians_read,
            "tracks": tracks.len(),
            "duration_s": duration_s(tracks),
            "rate_hz": rate_hz(tracks),
            "area_m": bounds(tracks).map(|area| json!({ "min": area.min_m, "max": area.max_m })),
            "speed": speed(speeds(tracks)),
            "warnings": report.warnings,
        },
        "selected": {
            "room": report.scenario,
            "is_default_room": report.is_default_room,
            "users": report.selected.users.len(),
            "pedestrians": pedestrians(report),
            "starts_s": starts_s,
            "duration_s": report.selected.duration_s,
            "has_headings": has_headings(&report.selected.users),
            "factor": report.placement.factor,
            "centre_m": report.placement.centre_m,
            "speed_recorded": speed(speeds(&report.recorded)),
            "speed_in_room": speed(speeds(&report.selected.users)),
        },
        "out": report.out,
        "use": usage(report),
    })
}
