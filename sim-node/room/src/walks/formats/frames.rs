//! Texts without a header whose rows count frames: ETH/UCY, and experiments with pedestrians.

use std::collections::HashMap;
use std::io::BufRead;

use crate::walks::dialect::Separator;
use crate::walks::formats::{Lines, ReadError};
use crate::walks::rows::{Receive, Row, RowRefusal, number, refusal};

/// Interval of the usual annotations of ETH/UCY in s (2.5 Hz).
const ANNOTATION_INTERVAL_S: f64 = 0.4;

/// Largest number of rows, which are in memory until the step of the frames is known.
const ROWS_MAX: usize = 5_000_000;

/// The order of the columns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Layout {
    /// `frame id x z y vx vz vy` or `frame id x y`, in m.
    EthUcy,
    /// `id frame x y` or `id frame x y z`, in cm unless a comment names `x/m`.
    Experiment,
}

/// Reads all rows; `seconds` is the time of one frame, where it is known.
pub(super) fn read(
    layout: Layout,
    seconds: Option<f64>,
    input: impl BufRead,
    receive: Receive<'_>,
) -> Result<(), ReadError> {
    let (mut lines, mut rows, mut separator) = (Lines::new(input), Vec::new(), None);
    while let Some((line, text)) = lines.next()? {
        if rows.len() == ROWS_MAX {
            let expected = format!("at most {ROWS_MAX}, as a file of frames has");
            return Err(ReadError::Long { line, what: "too many rows", expected });
        }
        let separator = *separator.get_or_insert_with(|| match Separator::of(text) {
            // Published files mix tabs and spaces.
            Separator::Tab => Separator::Whitespace,
            other => other,
        });
        rows.push(layout.row(line, &separator.cells(text)));
    }
    if rows.is_empty() {
        return Err(ReadError::Empty);
    }
    let comments = &lines.comments;
    let seconds = match layout {
        Layout::EthUcy => seconds.unwrap_or_else(|| ANNOTATION_INTERVAL_S / usual_step(&rows)),
        Layout::Experiment => {
            seconds.or_else(|| frame_rate_hz(comments).map(|rate| 1.0 / rate)).ok_or(ReadError::FrameRate)?
        }
    };
    let metres = if layout == Layout::Experiment && !comments.contains("x/m") { 0.01 } else { 1.0 };
    for row in rows {
        receive(row.map(|row| Row { time_s: row.time_s * seconds, at_m: row.at_m.map(|at| at * metres), ..row }));
    }
    Ok(())
}

impl Layout {
    /// A row, with the frame number as its time.
    fn row(self, line: u64, cells: &[&str]) -> Result<Row, RowRefusal> {
        let [frame, pedestrian, x, y] = match (self, cells) {
            (Self::EthUcy, &[frame, pedestrian, x, _, y, _, _, _] | &[frame, pedestrian, x, y])
            | (Self::Experiment, &[pedestrian, frame, x, y, _] | &[pedestrian, frame, x, y]) => {
                [frame, pedestrian, x, y]
            }
            _ => return Err(refusal(line, self.wrong_number(cells.len()))),
        };
        let time_s = number(line, "frame", frame)?;
        // Published files write the ids as floating-point numbers.
        let pedestrian = number(line, "id", pedestrian)?.to_string();
        Ok(Row { line, time_s, pedestrian, at_m: [number(line, "x", x)?, number(line, "y", y)?], heading_rad: None })
    }

    fn wrong_number(self, found: usize) -> String {
        match (self, found) {
            (Self::EthUcy, 5) => "number of columns 5: expected 8 (obsmat.txt) or 4 (frame id x y); five columns are \
                                  the layout id frame x y z of the format experiment"
                .into(),
            (Self::EthUcy, _) => format!("number of columns {found}: expected 8 (obsmat.txt) or 4 (frame id x y)"),
            (Self::Experiment, _) => {
                format!("number of columns {found}: expected 5 (id frame x y z) or 4 (id frame x y)")
            }
        }
    }
}

/// The most frequent difference between two successive frames of one pedestrian, the smallest of
/// several; 1 where no pedestrian has two frames.
fn usual_step(rows: &[Result<Row, RowRefusal>]) -> f64 {
    let (mut last, mut counts): (HashMap<&str, f64>, HashMap<u64, usize>) = (HashMap::new(), HashMap::new());
    for row in rows.iter().flatten() {
        let step = last.insert(&row.pedestrian, row.time_s).map_or(0.0, |before| row.time_s - before);
        if step > 0.0 {
            *counts.entry(step.to_bits()).or_default() += 1;
        }
    }
    let steps = counts.into_iter().map(|(bits, count)| (f64::from_bits(bits), count));
    let usual = steps.max_by(|(a, count_a), (b, count_b)| count_a.cmp(count_b).then(b.total_cmp(a)));
    usual.map_or(1.0, |(step, _)| step)
}

/// The number behind `framerate` in the comments, as experiments write it.
fn frame_rate_hz(comments: &str) -> Option<f64> {
    let text = comments.to_lowercase();
    let rest = ["framerate", "frame rate", "frame_rate", "fps"].iter().find_map(|name| text.split_once(name))?.1;
    let rest = rest.trim_start_matches(|mark: char| !mark.is_ascii_digit() && mark != '\n');
    let end = rest.find(|mark: char| !mark.is_ascii_digit() && mark != '.').unwrap_or(rest.len());
    rest[..end].parse().ok().filter(|rate| *rate > 0.0)
}
