//! Rows of the published formats of pedestrian data sets.
//!
//! | format | rows | units |
//! | --- | --- | --- |
//! | ETH/UCY | `frame id x z y vx vz vy` (obsmat.txt) or `frame id x y`, separated by white space | m |
//! | ATC | `time,id,x,y,z,velocity,motion angle,facing angle`, no header | s, mm, rad |
//! | THÖR-MAGNI | metadata, then a row of column names with `Frame`, `Time`, `Helmet_1 Centroid_X` | s, mm |
//! | CSV | a header with `time`, `user`, `x`, `y` and optionally `heading_deg` | s, m, degrees |
//!
//! Sources: Pellegrini et al., You'll never walk alone, ICCV 2009, README of the data set; Lerner
//! et al., Crowds by example, 2007, in the form `frame id x y` of later work; Brscic et al.,
//! Pedestrian tracking in large public spaces using 3-D range sensors, 2013, page of the data set;
//! Schreiter et al., THÖR-MAGNI, 2024, with the tools of its authors (thor-magni-tools).

mod thor_magni;

use std::io::{BufRead, Error, Read};

use thiserror::Error;

use self::thor_magni::Bodies;
use crate::walks::rows::{Receive, Row, RowRefusal, number, refusal};

/// Interval of the usual annotations of ETH/UCY in s (2.5 Hz).
const ANNOTATION_INTERVAL_S: f64 = 0.4;

/// Rows before the row of column names of THÖR-MAGNI, at most; published files have 16.
const METADATA_ROWS_MAX: usize = 64;

/// Longest line in bytes; a row of THÖR-MAGNI has some 2000.
const LINE_BYTES_MAX: u64 = 1 << 20;

/// Largest number of rows of ETH/UCY, which are in memory until the step of the frames is known.
const FRAME_ROWS_MAX: usize = 5_000_000;

/// A published format.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WalkFormat {
    /// ETH and UCY: `obsmat.txt`, or `frame id x y`.
    EthUcy,
    /// ATC: one file for each day.
    Atc,
    /// THÖR-MAGNI: one file for each run.
    ThorMagni,
    /// A CSV with headings.
    Csv,
}

/// How a text is read.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Source {
    /// Its format.
    pub format: WalkFormat,
    /// Frames a second of the frame numbers of ETH/UCY; `None`: their smallest step is 0.4 s.
    pub frame_rate_hz: Option<f64>,
}

/// Why a text cannot be read at all.
#[derive(Debug, Error)]
pub enum ReadError {
    /// The operating system refuses, or the text is not UTF-8.
    #[error("{0}")]
    Text(String),
    /// The text has no row.
    #[error("the file has no rows: expected positions of pedestrians")]
    Empty,
    /// The text is too long for its format.
    #[error("line {line}: {what}: expected {expected}")]
    Long {
        /// Line, from 1.
        line: u64,
        /// What is too long.
        what: &'static str,
        /// The bound.
        expected: String,
    },
    /// The column names do not fit the format.
    #[error("line {line}: missing column {missing}: expected {expected}")]
    Columns {
        /// Line of the column names.
        line: u64,
        /// The first missing name.
        missing: String,
        /// The names that the format requires.
        expected: &'static str,
    },
}

impl From<Error> for ReadError {
    fn from(error: Error) -> Self {
        Self::Text(error.to_string())
    }
}

/// Reads all rows of a text, in the order of the file.
///
/// # Errors
/// [`ReadError`] where the text as a whole cannot be read; a refused row is passed to `receive`.
pub fn read(source: Source, input: impl BufRead, receive: Receive<'_>) -> Result<(), ReadError> {
    match source.format {
        WalkFormat::EthUcy => read_eth_ucy(source.frame_rate_hz, input, receive),
        WalkFormat::Atc => read_atc(input, receive),
        WalkFormat::ThorMagni => read_thor_magni(input, receive),
        WalkFormat::Csv => read_csv(input, receive),
    }
}

/// The lines of a text that are neither empty nor comments.
struct Lines<R> {
    input: R,
    text: String,
    line: u64,
}

impl<R: BufRead> Lines<R> {
    fn new(input: R) -> Self {
        Self { input, text: String::new(), line: 0 }
    }

    /// The next line with its number from 1; `None` at the end.
    fn next(&mut self) -> Result<Option<(u64, &str)>, ReadError> {
        loop {
            self.text.clear();
            if self.input.by_ref().take(LINE_BYTES_MAX).read_line(&mut self.text)? == 0 {
                return Ok(None);
            }
            self.line += 1;
            if self.text.len() as u64 == LINE_BYTES_MAX {
                let expected = format!("less than {} KiB, as a text file has", LINE_BYTES_MAX >> 10);
                return Err(ReadError::Long { line: self.line, what: "the line does not end", expected });
            }
            let trimmed = self.text.trim_start_matches('\u{feff}').trim();
            if !trimmed.is_empty() && !trimmed.starts_with('#') {
                break;
            }
        }
        Ok(Some((self.line, self.text.trim_start_matches('\u{feff}').trim())))
    }
}

/// The cells of a line, without white space and quotation marks around them.
fn cells(text: &str) -> Vec<&str> {
    text.split(',').map(|cell| cell.trim().trim_matches('"')).collect()
}

fn read_eth_ucy(frame_rate_hz: Option<f64>, input: impl BufRead, receive: Receive<'_>) -> Result<(), ReadError> {
    // The step of the frame numbers is known after the last row.
    let (mut lines, mut rows) = (Lines::new(input), Vec::new());
    while let Some((line, text)) = lines.next()? {
        if rows.len() == FRAME_ROWS_MAX {
            let expected = format!("at most {FRAME_ROWS_MAX}, as a file of ETH/UCY has");
            return Err(ReadError::Long { line, what: "too many rows", expected });
        }
        rows.push(eth_ucy_row(line, &text.split_whitespace().collect::<Vec<_>>()));
    }
    if rows.is_empty() {
        return Err(ReadError::Empty);
    }
    let seconds = match frame_rate_hz {
        Some(rate_hz) => 1.0 / rate_hz,
        None => ANNOTATION_INTERVAL_S / smallest_step(rows.iter().flatten().map(|row| row.time_s).collect()),
    };
    for row in rows {
        receive(row.map(|row| Row { time_s: row.time_s * seconds, ..row }));
    }
    Ok(())
}

/// A row of ETH/UCY, with the frame number as its time.
fn eth_ucy_row(line: u64, cells: &[&str]) -> Result<Row, RowRefusal> {
    let (frame, pedestrian, x, y) = match cells {
        [frame, pedestrian, x, _, y, _, _, _] | [frame, pedestrian, x, y] => (frame, pedestrian, x, y),
        _ => {
            let found = cells.len();
            return Err(refusal(
                line,
                format!("number of columns {found}: expected 8 (obsmat.txt) or 4 (frame id x y)"),
            ));
        }
    };
    let time_s = number(line, "frame", frame)?;
    // Published files write the ids as floating-point numbers.
    let pedestrian = number(line, "id", pedestrian)?.to_string();
    Ok(Row { line, time_s, pedestrian, at_m: [number(line, "x", x)?, number(line, "y", y)?], heading_rad: None })
}

/// The smallest difference between two of the frame numbers; 1 where all are equal.
fn smallest_step(mut frames: Vec<f64>) -> f64 {
    frames.sort_by(f64::total_cmp);
    let steps = frames.windows(2).map(|pair| pair[1] - pair[0]).filter(|step| *step > 0.0);
    let smallest = steps.fold(f64::INFINITY, f64::min);
    if smallest.is_finite() { smallest } else { 1.0 }
}

fn read_atc(input: impl BufRead, receive: Receive<'_>) -> Result<(), ReadError> {
    let (mut lines, mut is_empty) = (Lines::new(input), true);
    while let Some((line, text)) = lines.next()? {
        is_empty = false;
        receive(atc_row(line, &cells(text)));
    }
    if is_empty { Err(ReadError::Empty) } else { Ok(()) }
}

fn atc_row(line: u64, cells: &[&str]) -> Result<Row, RowRefusal> {
    let &[time, pedestrian, x, y, _, _, _, facing] = cells else {
        let found = cells.len();
        let expected = "time, pedestrian id, x, y, z, velocity, angle of motion, facing angle";
        return Err(refusal(line, format!("number of columns {found}: expected 8 ({expected})")));
    };
    let at_mm = [number(line, "x", x)?, number(line, "y", y)?];
    Ok(Row {
        line,
        time_s: number(line, "time", time)?,
        pedestrian: pedestrian.to_owned(),
        at_m: at_mm.map(|mm| mm / 1000.0),
        heading_rad: Some(number(line, "facing angle", facing)?),
    })
}

fn read_thor_magni(input: impl BufRead, receive: Receive<'_>) -> Result<(), ReadError> {
    let mut lines = Lines::new(input);
    let mut bodies = None;
    for _ in 0..METADATA_ROWS_MAX {
        let Some((line, text)) = lines.next()? else { break };
        let names = cells(text);
        if names.contains(&"Time") && names.contains(&"Frame") {
            bodies = Some(Bodies::of(&names).ok_or_else(|| missing(line, "Helmet_1 Centroid_X"))?);
            break;
        }
    }
    let bodies = bodies.ok_or_else(|| missing(lines.line.max(1), "Time"))?;
    let mut is_empty = true;
    while let Some((line, text)) = lines.next()? {
        is_empty = false;
        bodies.rows(line, &cells(text), receive);
    }
    if is_empty { Err(ReadError::Empty) } else { Ok(()) }
}

fn missing(line: u64, name: &str) -> ReadError {
    let expected = "a row of column names with Frame, Time, and Centroid_X and Centroid_Y or markers of a helmet";
    ReadError::Columns { line, missing: name.to_owned(), expected }
}

/// Places of the columns of a CSV with headings.
struct CsvColumns {
    time: usize,
    user: usize,
    x: usize,
    y: usize,
    heading_deg: Option<usize>,
}

impl CsvColumns {
    fn of(line: u64, header: &[&str]) -> Result<Self, ReadError> {
        let find = |name: &str| header.iter().position(|found| *found == name);
        let required = |name: &str| {
            find(name).ok_or_else(|| ReadError::Columns {
                line,
                missing: name.to_owned(),
                expected: "the header time,user,x,y[,heading_deg]",
            })
        };
        Ok(Self {
            time: required("time")?,
            user: required("user")?,
            x: required("x")?,
            y: required("y")?,
            heading_deg: find("heading_deg"),
        })
    }

    fn row(&self, line: u64, columns: usize, cells: &[&str]) -> Result<Row, RowRefusal> {
        let found = cells.len();
        if found != columns {
            return Err(refusal(line, format!("number of columns {found}: expected {columns}, as in the header")));
        }
        let heading = self.heading_deg.map(|index| number(line, "heading_deg", cells[index])).transpose()?;
        Ok(Row {
            line,
            time_s: number(line, "time", cells[self.time])?,
            pedestrian: cells[self.user].to_owned(),
            at_m: [number(line, "x", cells[self.x])?, number(line, "y", cells[self.y])?],
            heading_rad: heading.map(f64::to_radians),
        })
    }
}

fn read_csv(input: impl BufRead, receive: Receive<'_>) -> Result<(), ReadError> {
    let mut lines = Lines::new(input);
    let Some((line, header)) = lines.next()? else { return Err(ReadError::Empty) };
    let header = cells(header);
    let (columns, count, mut is_empty) = (CsvColumns::of(line, &header)?, header.len(), true);
    while let Some((line, text)) = lines.next()? {
        is_empty = false;
        receive(columns.row(line, count, &cells(text)));
    }
    if is_empty { Err(ReadError::Empty) } else { Ok(()) }
}

#[cfg(test)]
mod tests;
