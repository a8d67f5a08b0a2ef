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
    value.ok_or_else(|| {
        let (text, hint) = (excerpt(text), hint(column, text));
        refusal(line, format!("invalid {column} `{text}`: expected a finite number{hint}"))
    })
}

/// What a cell is that holds no number, and what to do.
pub(crate) fn hint(column: &str, text: &str) -> &'static str {
    let begins_with_digit = text.starts_with(|letter: char| letter.is_ascii_digit());
    if text.eq_ignore_ascii_case(column) {
        "; the header stands here again: import joined files one by one"
    } else if begins_with_digit && text.contains([':', '/', '-']) {
        "; write a date or a time of day as seconds"
    } else {
        ""
    }
}
