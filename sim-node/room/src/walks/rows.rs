//! One position of one pedestrian in a file, or the reason for which a row cannot be used.

use heliostat_files::excerpt;

/// One position of one pedestrian.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// Line in the file, from 1.
    pub line: u64,
    /// Time in s.
    pub time_s: f64,
    /// Name of the pedestrian in the file.
    pub pedestrian: String,
    /// Position in m, in the frame of the file.
    pub at_m: [f64; 2],
    /// Direction in which the pedestrian faces, in rad from +x towards +y.
    pub heading_rad: Option<f64>,
}

/// A row that cannot be used.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RowRefusal {
    /// Line in the file, from 1.
    pub line: u64,
    /// What is wrong, and what was expected.
    pub reason: String,
}

/// Receives each row, or the reason for which it cannot be used.
pub type Receive<'a> = &'a mut dyn FnMut(Result<Row, RowRefusal>);

/// Refuses a row.
pub(super) fn refusal(line: u64, reason: String) -> RowRefusal {
    RowRefusal { line, reason }
}

/// A finite number in a cell, with a point or a comma as decimal mark.
pub(super) fn number(line: u64, column: &str, text: &str) -> Result<f64, RowRefusal> {
    let with_point = || text.replacen(',', ".", 1).parse::<f64>().ok();
    let value = text.parse::<f64>().ok().or_else(with_point).filter(|value| value.is_finite());
    value.ok_or_else(|| refusal(line, format!("invalid {column} `{}`: expected a finite number", excerpt(text))))
}
