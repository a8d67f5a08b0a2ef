//! The columns of a text with a header, or of one whose columns are given by number.

use heliostat_files::excerpt;

use crate::walks::formats::ReadError;
use crate::walks::rows::{Row, RowRefusal, number, refusal};

/// The columns that a walk needs, in the order of [`Columns::places`].
const REQUIRED: [&str; 4] = ["time", "user", "x", "y"];

/// Where one column stands.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Column {
    /// Under a name in the header.
    Name(String),
    /// At a place, from 1.
    Number(usize),
}

/// Which column of a text holds what; an entry that is missing has its usual name.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ColumnMap(Vec<(&'static str, Column)>);

impl ColumnMap {
    /// Reads `time=NAME,user=NAME,x=NAME,y=NAME,heading_deg=NAME`, with a number in place of a name
    /// where the text has no header.
    ///
    /// # Errors
    /// What was found and what is expected.
    pub fn parse(text: &str) -> Result<Self, String> {
        let expected = "expected time=COLUMN,user=COLUMN,x=COLUMN,y=COLUMN[,heading_deg=COLUMN], each a name in the \
                        header or a number from 1";
        let mut entries = Vec::new();
        for entry in text.split(',') {
            let (role, column) = entry.split_once('=').ok_or_else(|| format!("`{entry}`: {expected}"))?;
            let roles = REQUIRED.into_iter().chain(["heading_deg"]);
            let role = roles.into_iter().find(|known| *known == role.trim());
            let role = role.ok_or_else(|| format!("`{entry}`: {expected}"))?;
            let column = match column.trim() {
                "" | "0" => return Err(format!("`{entry}`: {expected}")),
                name => name.parse().map_or_else(|_| Column::Name(name.to_owned()), Column::Number),
            };
            if entries.iter().any(|(known, _)| *known == role) {
                return Err(format!("{role} is given twice: {expected}"));
            }
            entries.push((role, column));
        }
        Ok(Self(entries))
    }

    fn of(&self, role: &'static str) -> Column {
        let entry = self.0.iter().find(|(known, _)| *known == role);
        entry.map_or_else(|| Column::Name(role.to_owned()), |(_, column)| column.clone())
    }

    /// Whether no column has a name, so that the text needs no header.
    pub(super) fn is_by_number(&self) -> bool {
        REQUIRED.iter().all(|role| matches!(self.of(role), Column::Number(_)))
    }
}

/// Places of the columns of a text.
pub(super) struct Columns {
    /// Time, user, x, y.
    places: [usize; 4],
    heading_deg: Option<usize>,
    count: usize,
}

impl Columns {
    /// Finds the columns in the first row.
    pub(super) fn of(line: u64, row: &[&str], map: &ColumnMap) -> Result<Self, ReadError> {
        let named = REQUIRED.into_iter().chain(["heading_deg"]).filter_map(|role| match map.of(role) {
            Column::Name(name) => Some(name),
            Column::Number(_) => None,
        });
        for name in named {
            if row.iter().filter(|found| **found == name).count() > 1 {
                return Err(ReadError::SameName { line, name });
            }
        }
        let find = |role: &'static str| match map.of(role) {
            Column::Name(name) => row.iter().position(|found| **found == *name).ok_or(name),
            Column::Number(place) => {
                (place <= row.len()).then_some(place - 1).ok_or_else(|| format!("number {place} ({role})"))
            }
        };
        let missing = |missing: String| ReadError::Header {
            line,
            missing,
            found: excerpt(&row.iter().map(|name| format!("`{}`", name.escape_debug())).collect::<Vec<_>>().join(", ")),
        };
        let is_mapped = map.0.iter().any(|(role, _)| *role == "heading_deg");
        let heading_deg = match find("heading_deg") {
            Ok(place) => Some(place),
            Err(name) if is_mapped => return Err(missing(name)),
            Err(_) => None,
        };
        let mut places = [0; 4];
        for (place, role) in places.iter_mut().zip(REQUIRED) {
            *place = find(role).map_err(missing)?;
        }
        Ok(Self { places, heading_deg, count: row.len() })
    }

    pub(super) fn row(&self, line: u64, cells: &[&str]) -> Result<Row, RowRefusal> {
        let (found, expected) = (cells.len(), self.count);
        if found != expected {
            return Err(refusal(line, format!("number of columns {found}: expected {expected}, as in the first row")));
        }
        let [time, user, x, y] = self.places.map(|place| cells[place]);
        let heading = self.heading_deg.map(|place| number(line, "heading_deg", cells[place])).transpose()?;
        Ok(Row {
            line,
            time_s: number(line, "time", time)?,
            pedestrian: user.to_owned(),
            at_m: [number(line, "x", x)?, number(line, "y", y)?],
            heading_rad: heading.map(f64::to_radians),
        })
    }
}
