//! Rows of the published formats of pedestrian data sets.
//!
//! | format | rows | units |
//! | --- | --- | --- |
//! | ETH/UCY | `frame id x z y vx vz vy` (obsmat.txt) or `frame id x y` | m |
//! | experiment | `id frame x y z` or `id frame x y`, with the frame rate in a comment | cm, or m where a comment names `x/m` |
//! | ATC | `time,id,x,y,z,velocity,motion angle,facing angle`, no header | s, mm, rad |
//! | THÖR-MAGNI, THÖR | metadata, then a row of column names with `Frame`, `Time`, `Helmet_1 Centroid_X` | s, mm |
//! | CSV | a header with `time`, `user`, `x`, `y` and optionally `heading_deg`, or other columns by a [`ColumnMap`] | s, m, degrees |
//!
//! Cells are separated by commas, semicolons, tabs or white space, as the first row shows. A number may have a decimal
//! comma where commas do not separate cells.
//!
//! Sources: Pellegrini et al., You'll never walk alone, ICCV 2009, README of the data set; Lerner
//! et al., Crowds by example, 2007, in the form `frame id x y` of later work; Brscic et al.,
//! Pedestrian tracking in large public spaces using 3-D range sensors, 2013, page of the data set;
//! Schreiter et al., THÖR-MAGNI, 2024, with the tools of its authors (thor-magni-tools); Rudenko et
//! al., THÖR, 2020; trajectories of the data archive of experiments on pedestrian dynamics
//! (Forschungszentrum Jülich).

mod columns;
mod frames;
mod thor_magni;

use std::io::{BufRead, Error, ErrorKind, Read};

use heliostat_files::CARRIAGE_RETURNS;
use thiserror::Error;

use self::columns::Columns;
pub use self::columns::{Column, ColumnMap};
use self::frames::Layout;
use self::thor_magni::Bodies;
use crate::walks::dialect::Separator;
use crate::walks::rows::{Receive, Row, RowRefusal, number, refusal};

/// Rows before the row of column names of THÖR-MAGNI, at most; published files have 16.
const METADATA_ROWS_MAX: usize = 64;

/// Longest line in bytes; a row of THÖR-MAGNI has some 2000.
const LINE_BYTES_MAX: u64 = 1 << 20;

/// Comments that are kept, in bytes; the head of an experiment has some 300.
const COMMENT_BYTES_MAX: usize = 1 << 16;

/// A published format.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum WalkFormat {
    /// ETH and UCY: obsmat.txt, or frame id x y.
    EthUcy,
    /// ATC shopping centre: one file for each day.
    Atc,
    /// Experiments with pedestrians: id frame x y z in cm, or in m where a comment names x/m.
    Experiment,
    /// THÖR-MAGNI or THÖR: one file for each run.
    ThorMagni,
    /// CSV with a header of time, user, x, y and optionally heading_deg, in any order.
    Csv,
}

/// How a text is read.
#[derive(Clone, Debug, PartialEq)]
pub struct Source {
    /// Its format.
    pub format: WalkFormat,
    /// Frames a second, where times count frames; `None`: the usual step of ETH/UCY is 0.4 s, an
    /// experiment names its rate.
    pub frame_rate_hz: Option<f64>,
    /// Seconds of one unit of time, for formats with times.
    pub time_unit_s: f64,
    /// The columns of [`WalkFormat::Csv`].
    pub columns: ColumnMap,
}

impl Source {
    /// A format with its usual units and columns.
    pub fn of(format: WalkFormat) -> Self {
        Self { format, frame_rate_hz: None, time_unit_s: 1.0, columns: ColumnMap::default() }
    }
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
    /// A column is not in the header.
    #[error(
        "line {line}: missing column {missing}: expected the header time,user,x,y[,heading_deg]; the columns found \
         are {found}"
    )]
    Header {
        /// Line of the header.
        line: u64,
        /// The first missing column.
        missing: String,
        /// The names found.
        found: String,
    },
    /// Two columns have the name of a column that is used.
    #[error(
        "line {line}: two columns have the name {name}: expected one; rename one of them, or name it by its number"
    )]
    SameName {
        /// Line of the header.
        line: u64,
        /// The name.
        name: String,
    },
    /// The lines end with a carriage return alone.
    #[error("line {line}: {CARRIAGE_RETURNS}")]
    CarriageReturns {
        /// Line, from 1, by line feeds.
        line: u64,
    },
    /// Times count frames, and the frame rate is not known.
    #[error("the frame rate is not known: expected a comment such as `# framerate: 16`")]
    FrameRate,
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
pub fn read(source: &Source, input: impl BufRead, receive: Receive<'_>) -> Result<(), ReadError> {
    let frame_s = source.frame_rate_hz.map(|rate| 1.0 / rate);
    let unit_s = frame_s.unwrap_or(source.time_unit_s);
    let mut in_seconds = |row: Result<Row, RowRefusal>| {
        receive(row.map(|row| Row { time_s: row.time_s * unit_s, ..row }));
    };
    match source.format {
        WalkFormat::EthUcy => frames::read(Layout::EthUcy, frame_s, input, receive),
        WalkFormat::Experiment => frames::read(Layout::Experiment, frame_s, input, receive),
        WalkFormat::Atc => read_atc(input, &mut in_seconds),
        WalkFormat::ThorMagni => read_thor_magni(input, &mut in_seconds),
        WalkFormat::Csv => read_csv(&source.columns, input, &mut in_seconds),
    }
}

/// The lines of a text that are neither empty nor comments.
struct Lines<R> {
    input: R,
    text: String,
    line: u64,
    /// The comments so far.
    comments: String,
}

impl<R: BufRead> Lines<R> {
    fn new(input: R) -> Self {
        Self { input, text: String::new(), line: 0, comments: String::new() }
    }

    /// The next line with its number from 1; `None` at the end.
    fn next(&mut self) -> Result<Option<(u64, &str)>, ReadError> {
        loop {
            self.text.clear();
            match self.input.by_ref().take(LINE_BYTES_MAX).read_line(&mut self.text) {
                Ok(0) => return Ok(None),
                Ok(_) => self.line += 1,
                Err(error) if error.kind() == ErrorKind::InvalidData => {
                    let text = format!(
                        "line {} is not UTF-8: expected a text in UTF-8; save it again in this encoding",
                        self.line + 1
                    );
                    return Err(ReadError::Text(text));
                }
                Err(error) => return Err(error.into()),
            }
            if bare(&self.text).contains('\r') {
                return Err(ReadError::CarriageReturns { line: self.line });
            }
            if self.text.len() as u64 == LINE_BYTES_MAX {
                let expected = format!("less than {} KiB, as a text file has", LINE_BYTES_MAX >> 10);
                return Err(ReadError::Long { line: self.line, what: "the line does not end", expected });
            }
            let trimmed = bare(&self.text);
            if !trimmed.trim().is_empty() && !trimmed.starts_with('#') {
                break;
            }
            if self.comments.len() + trimmed.len() < COMMENT_BYTES_MAX {
                self.comments.push_str(trimmed);
                self.comments.push('\n');
            }
        }
        Ok(Some((self.line, bare(&self.text))))
    }
}

/// A line without its end, the spaces around it and the byte order mark of an editor. A tab at the
/// end is an empty cell.
fn bare(line: &str) -> &str {
    line.trim_start_matches('\u{feff}').trim_end_matches(['\r', '\n']).trim_matches(' ')
}

fn read_atc(input: impl BufRead, receive: Receive<'_>) -> Result<(), ReadError> {
    let (mut lines, mut separator) = (Lines::new(input), None);
    while let Some((line, text)) = lines.next()? {
        let separator = *separator.get_or_insert_with(|| match Separator::of(text) {
            // Eight columns with white space are the layout of ETH/UCY.
            Separator::Whitespace => Separator::Comma,
            other => other,
        });
        receive(atc_row(line, &separator.cells(text)));
    }
    if separator.is_none() { Err(ReadError::Empty) } else { Ok(()) }
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
    let (mut bodies, mut separator) = (None, Separator::Comma);
    for _ in 0..METADATA_ROWS_MAX {
        let Some((line, text)) = lines.next()? else { break };
        separator = Separator::of(text);
        let names = separator.cells(text);
        if names.contains(&"Time") && names.contains(&"Frame") {
            bodies = Some(Bodies::of(&names).ok_or_else(|| missing(line, "Helmet_1 Centroid_X"))?);
            break;
        }
    }
    let bodies = bodies.ok_or_else(|| missing(lines.line.max(1), "Time"))?;
    let mut is_empty = true;
    while let Some((line, text)) = lines.next()? {
        is_empty = false;
        bodies.rows(line, &separator.cells(text), receive);
    }
    if is_empty { Err(ReadError::Empty) } else { Ok(()) }
}

fn missing(line: u64, name: &str) -> ReadError {
    let expected = "a row of column names with Frame, Time, and Centroid_X and Centroid_Y or markers of a helmet";
    ReadError::Columns { line, missing: name.to_owned(), expected }
}

fn read_csv(map: &ColumnMap, input: impl BufRead, receive: Receive<'_>) -> Result<(), ReadError> {
    let mut lines = Lines::new(input);
    let Some((line, first)) = lines.next()? else { return Err(ReadError::Empty) };
    let separator = Separator::of(first);
    let first = separator.cells(first);
    let (columns, mut is_empty) = (Columns::of(line, &first, map)?, true);
    if map.is_by_number() {
        is_empty = false;
        receive(columns.row(line, &first));
    }
    while let Some((line, text)) = lines.next()? {
        is_empty = false;
        receive(columns.row(line, &separator.cells(text)));
    }
    if is_empty { Err(ReadError::Empty) } else { Ok(()) }
}

#[cfg(test)]
mod tests;
