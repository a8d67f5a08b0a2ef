//! `heliostat-lab trace import`: reads a data set, chooses users, and fits them into a room.

use std::io::{BufRead, BufReader};
use std::path::PathBuf;

use anyhow::{Context, Result, anyhow, bail, ensure};
use clap::ValueEnum;
use heliostat_files::{foreign_text, open_file};
use heliostat_room::walks::formats::{ColumnMap, ReadError, Source, WalkFormat, read};
use heliostat_room::walks::placement::{Fit, place};
use heliostat_room::walks::plausibility::{is_mostly_refused, warnings};
use heliostat_room::walks::selection::{Choice, Presence, select};
use heliostat_room::walks::tracks::{Collected, Collector, Kept, Rectangle};
use heliostat_room::world::walker::Floor;
use heliostat_scenario::{DEFAULT_SCENARIO, Scenario, ScenarioArgs};
use heliostat_service::duration::{DurationError, seconds};
use heliostat_service::exit::UnusableInput;

use super::report::{ImportReport, print};
use super::written::write_trace;
use heliostat_service::whole_file;

/// Read pedestrians' walks from a data set, and write them as a recorded walk for a room.
///
/// The scenario's floor is the room: by default the walks are centred on it, and made smaller where
/// they do not fit. The scenario's users.count is the number of users. All of them are present from
/// the beginning to the end of the written walk. The report lists what was read, what was refused,
/// and how to use the file.
///
/// Formats: eth-ucy is obsmat.txt (frame id x z y vx vz vy) or text of "frame id x y". atc is a day
/// of the ATC shopping centre. experiment is text of "id frame x y z" in cm, as archives of experiments
/// with pedestrians have it. thor-magni is the file of a run of THÖR-MAGNI or THÖR, of which the helmets
/// are read. csv has a header with time, user, x, y (s, m) and optionally heading_deg, in any order;
/// --columns names others. Commas, semicolons, tabs and decimal commas are recognised. Data sets are not
/// included: obtain them from their authors, and observe their licences.
///
/// Warnings name what is unusual: speeds, intervals, extents, short tracks, many refused rows. The exit
/// status is 2 where more than half of the rows are refused.
#[derive(Debug, clap::Args)]
pub struct ImportArgs {
    /// The file of the data set
    file: PathBuf,
    /// Its format
    #[arg(long, value_enum)]
    format: WalkFormat,
    /// The room: a scenario file (TOML) or the name of a built-in scenario [default: hall; the report says so]
    #[arg(long, visible_alias = "room", value_name = "SCENARIO")]
    scenario: Option<String>,
    /// Override a key of the scenario, for example --set room.length_x_m=8 (repeatable)
    #[arg(long = "set", value_name = "TABLE.KEY=VALUE")]
    overrides: Vec<String>,
    /// The recorded walk to write (CSV); an existing file is not overwritten
    #[arg(long, value_name = "FILE.csv")]
    out: PathBuf,
    #[command(flatten)]
    reading: Reading,
    #[command(flatten)]
    choosing: Choosing,
    /// How the walks are scaled to the floor
    #[arg(long, value_enum, default_value = "shrink")]
    fit: Fit,
    /// Distance of the scaled walks from the walls in m
    #[arg(long, value_name = "M", default_value_t = 0.3, value_parser = not_negative, allow_negative_numbers = true)]
    margin_m: f64,
    /// Print the report as one JSON object
    #[arg(long)]
    json: bool,
}

/// Which rows are used.
#[derive(Debug, clap::Args)]
struct Reading {
    /// Factor on all positions, for a file in other units: 0.01 for cm
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0, value_parser = positive, allow_negative_numbers = true)]
    scale: f64,
    /// Frames per second, where times are frame numbers [default: the usual step of eth-ucy is 0.4 s; an experiment
    /// names its rate]
    #[arg(long, value_name = "HZ", value_parser = positive, allow_negative_numbers = true)]
    frame_rate_hz: Option<f64>,
    /// Unit of the times of atc, thor-magni and csv
    #[arg(long, value_enum, default_value = "s", conflicts_with = "frame_rate_hz")]
    time_unit: TimeUnit,
    /// Columns of csv: names in the header, or numbers from 1 for a file without header, for example
    /// "time=Timestamp,user=Person ID,x=X,y=Y"
    #[arg(long, value_name = "COLUMN=NAME,...", value_parser = ColumnMap::parse)]
    columns: Option<ColumnMap>,
    /// Use rows from this time on, in s after the first row
    #[arg(long, value_name = "S", default_value_t = f64::NEG_INFINITY, hide_default_value = true, allow_negative_numbers = true)]
    from_s: f64,
    /// Use rows up to this time, in s after the first row
    #[arg(long, value_name = "S", default_value_t = f64::INFINITY, hide_default_value = true, allow_negative_numbers = true)]
    to_s: f64,
    /// Use positions in this rectangle, in m after --scale; a track ends where it leaves it
    #[arg(long, value_name = "X_MIN,Y_MIN,X_MAX,Y_MAX", value_parser = rectangle, allow_hyphen_values = true)]
    crop: Option<Rectangle>,
    /// A longer time without a position ends a track, in s
    #[arg(long, value_name = "S", default_value = "1", value_parser = duration_s, allow_negative_numbers = true)]
    max_gap_s: f64,
}

/// Which users, for how long.
#[derive(Debug, clap::Args)]
struct Choosing {
    /// Number of users [default: users.count of the scenario]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1000))]
    users: Option<u32>,
    /// Which pedestrians become users
    #[arg(long, value_enum, default_value = "together")]
    select: Presence,
    /// Duration of the walk in s [default: as long as all users are present]
    #[arg(long, value_name = "S", value_parser = duration_s, allow_negative_numbers = true)]
    duration_s: Option<f64>,
    /// Resample at this rate [default: the recorded times]
    #[arg(long, value_name = "HZ", value_parser = rate, allow_negative_numbers = true)]
    rate_hz: Option<f64>,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum TimeUnit {
    /// Seconds
    S,
    /// Milliseconds
    Ms,
    /// Microseconds
    Us,
    /// Nanoseconds
    Ns,
}

/// Reads, chooses, places, writes, and prints the report.
pub fn run(args: &ImportArgs) -> Result<()> {
    let unusable = || UnusableInput::new(format!("{} cannot be imported", args.file.display()));
    let scenario = scenario(args)?;
    let floor = Floor { length_x_m: scenario.room.length_x_m, length_y_m: scenario.room.length_y_m };
    whole_file::check_distinct([("the data set", Some(&args.file)), ("--out", Some(&args.out))])?;
    whole_file::check_new(&args.out)?;
    let collected = collect(args).with_context(unusable)?;
    let choice = choice(args, &scenario);
    let warnings = warnings(&collected);
    let mut selected = select(&collected.tracks, &choice)
        .map_err(|error| {
            let causes: String = warnings.iter().map(|warning| format!("; {warning}")).collect();
            let units = if warnings.is_empty() { "" } else { ", --time-unit, --frame-rate-hz or --scale" };
            let advice = "choose fewer --users, --select longest, or another --max-gap-s or --crop";
            anyhow!("{error}{causes}: {advice}{units}")
        })
        .with_context(unusable)?;
    let recorded = selected.users.clone();
    let placement = place(&mut selected.users, &floor, args.fit, args.margin_m)
        .map_err(|error| anyhow!("{error}: choose another --fit, --crop, --scale or --margin-m"))
        .with_context(unusable)?;
    write_trace(&selected.users, &floor, &args.out)?;
    let report = ImportReport {
        file: args.file.display().to_string(),
        out: args.out.display().to_string(),
        scenario: named(args).to_owned(),
        is_default_room: args.scenario.is_none(),
        overrides: args.overrides.clone(),
        collected,
        warnings,
        presence: choice.presence,
        selected,
        recorded,
        placement,
    };
    print(&report, args.json)
}

/// The scenario of the room by its name or file.
fn named(args: &ImportArgs) -> &str {
    args.scenario.as_deref().unwrap_or(DEFAULT_SCENARIO)
}

fn scenario(args: &ImportArgs) -> Result<Scenario> {
    let (scenario, overrides) = (named(args).to_owned(), args.overrides.clone());
    Ok(ScenarioArgs { scenario, overrides, seed: None }.load_arrays()?)
}

fn collect(args: &ImportArgs) -> Result<Collected> {
    let reading = &args.reading;
    let kept = Kept {
        scale: reading.scale,
        from_s: reading.from_s,
        to_s: reading.to_s,
        crop: reading.crop,
        max_gap_s: reading.max_gap_s,
        ..Kept::default()
    };
    let mut collector = Collector::new(kept);
    let source = Source {
        format: args.format,
        frame_rate_hz: reading.frame_rate_hz,
        time_unit_s: reading.time_unit.seconds(),
        columns: reading.columns.clone().unwrap_or_default(),
    };
    ensure!(
        reading.columns.is_none() || source.format == WalkFormat::Csv,
        "--columns was given: expected the format csv, because the other formats have fixed columns"
    );
    let mut input = BufReader::new(open_file(&args.file)?);
    if let Some(what) = foreign_text(input.fill_buf()?) {
        bail!("the file {what}");
    }
    read(&source, input, &mut |row| collector.add(row)).map_err(advised)?;
    let collected = collector.finish();
    let counts = collected.counts;
    ensure!(
        counts.beyond == 0,
        "too many positions: expected at most {}; choose a time range with --from-s and --to-s, or a --crop",
        kept.positions_max
    );
    let first = collected.refusals.first().map_or(String::new(), |refusal| {
        format!("; refused rows: {}, the first in line {}: {}", counts.refused, refusal.line, refusal.reason)
    });
    let left_out = counts.out_of_range + counts.cropped;
    ensure!(counts.kept > 0, "no position is left: {left_out} outside the time range or the crop{first}");
    ensure!(!is_mostly_refused(&collected), "most rows are refused: expected rows of the format{first}");
    Ok(collected)
}

/// The error with the flag that helps.
fn advised(error: ReadError) -> anyhow::Error {
    match error {
        ReadError::Header { .. } => anyhow!("{error}: name them with --columns time=NAME,user=NAME,x=NAME,y=NAME"),
        ReadError::FrameRate => anyhow!("{error}, or give --frame-rate-hz"),
        ReadError::SameName { .. } => anyhow!("{error} with --columns, for example --columns x=3"),
        other => other.into(),
    }
}

fn choice(args: &ImportArgs, scenario: &Scenario) -> Choice {
    Choice {
        users: args.choosing.users.map_or(scenario.users.count, |users| users as usize),
        presence: args.choosing.select,
        duration_s: args.choosing.duration_s,
        rate_hz: args.choosing.rate_hz,
    }
}

impl TimeUnit {
    fn seconds(self) -> f64 {
        match self {
            Self::S => 1.0,
            Self::Ms => 1e-3,
            Self::Us => 1e-6,
            Self::Ns => 1e-9,
        }
    }
}

fn number(text: &str, expected: &str, is_valid: impl Fn(f64) -> bool) -> Result<f64, String> {
    text.parse().ok().filter(|value| is_valid(*value)).ok_or_else(|| format!("expected {expected}"))
}

fn duration_s(text: &str) -> Result<f64, DurationError> {
    seconds(text).map(|duration| duration.as_secs_f64())
}

fn positive(text: &str) -> Result<f64, String> {
    number(text, "a number above 0", |value| value > 0.0 && value.is_finite())
}

fn not_negative(text: &str) -> Result<f64, String> {
    number(text, "a number of 0 or more", |value| value >= 0.0 && value.is_finite())
}

fn rate(text: &str) -> Result<f64, String> {
    number(text, "0.1 to 1000", |value| (0.1..=1000.0).contains(&value))
}

fn rectangle(text: &str) -> Result<Rectangle, String> {
    let numbers: Option<Vec<f64>> = text.split(',').map(|part| part.trim().parse().ok()).collect();
    match numbers.as_deref() {
        Some(&[x_min, y_min, x_max, y_max]) if x_min < x_max && y_min < y_max => {
            Ok(Rectangle { min_m: [x_min, y_min], max_m: [x_max, y_max] })
        }
        _ => Err("expected four numbers X_MIN,Y_MIN,X_MAX,Y_MAX with X_MIN < X_MAX and Y_MIN < Y_MAX".into()),
    }
}
