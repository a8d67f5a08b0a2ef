//! The data of a figure, independent of its drawing: panels of series with units, intervals and the
//! paper's values.

use serde::{Deserialize, Serialize};

/// A figure in one room.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Figure {
    /// The id of the figure on the command line.
    pub id: String,
    /// The name of the room's scenario.
    pub room: String,
    /// The title.
    pub title: String,
    /// The method, and how to read the figure.
    pub caption: Vec<String>,
    /// The command that reproduces it.
    #[serde(skip_serializing_if = "String::is_empty", default)]
    pub command: String,
    /// Whether the load of the machine exceeded its cores during a part, so that times may be too
    /// long.
    #[serde(skip_serializing_if = "std::ops::Not::not", default)]
    pub overloaded: bool,
    /// The horizontal axis.
    pub x: Axis,
    /// The vertical axis.
    pub y: Axis,
    /// The panels.
    pub panels: Vec<Panel>,
    /// Ratios of curves for each seed, which are stated and not drawn.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub ratios: Vec<Series>,
}

/// An axis.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Axis {
    /// The quantity with its unit.
    pub label: String,
    /// Whether it is logarithmic.
    pub log: bool,
    /// The range, if it is not that of the data.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub range: Option<[f64; 2]>,
    /// The smallest and the largest value that the quantity can have, at which intervals are cut; from 0
    /// if absent, as for rates, shares and times.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub bounds: Option<[f64; 2]>,
    /// The categories in place of numbers, the first one at 1; none on an axis of numbers.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub names: Vec<String>,
}

impl Axis {
    /// An end of the interval of a value, cut at the bounds of the quantity.
    pub fn cut(&self, value: f64, end: f64) -> f64 {
        let [low, high] = self.bounds.unwrap_or([0.0, f64::INFINITY]);
        if (low..=high).contains(&value) { end.clamp(low, high) } else { end }
    }

    /// A linear axis over the data.
    pub fn linear(label: &str) -> Self {
        Self { label: label.into(), ..Self::default() }
    }

    /// A logarithmic axis over a range.
    pub fn log(label: &str, range: [f64; 2]) -> Self {
        Self { label: label.into(), log: true, range: Some(range), ..Self::default() }
    }

    /// An axis of categories, the first one at 1.
    pub fn categories(label: &str, names: Vec<String>) -> Self {
        Self { range: Some([0.5, names.len() as f64 + 0.5]), names, ..Self::linear(label) }
    }

    /// The category at a position; none beside them, and on an axis of numbers.
    pub fn category(&self, position: f64) -> Option<&str> {
        let nearest = position.round();
        let is_one = nearest >= 1.0 && (position - nearest).abs() < 1e-6;
        self.names.get((nearest as usize).wrapping_sub(1)).filter(|_| is_one).map(String::as_str)
    }
}

/// One pair of axes.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Panel {
    /// The title.
    pub title: String,
    /// The curves, each named by its policy or condition.
    pub series: Vec<Series>,
    /// The values of the paper.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub quoted: Vec<Quoted>,
    /// Values over the floor, under the curves.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub floor: Option<Floor>,
}

/// A curve; its name determines its colour, so that a policy has the same colour in every figure.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Series {
    /// The policy or condition.
    pub name: String,
    /// In the order of x.
    pub points: Vec<Point>,
}

impl Series {
    /// The point at `x`.
    pub fn at(&self, x: f64) -> Option<&Point> {
        self.points.iter().find(|point| (point.x - x).abs() <= 1e-9 * x.abs().max(1.0))
    }
}

/// A value at one position of the horizontal axis.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Point {
    /// The position.
    pub x: f64,
    /// The mean.
    pub y: f64,
    /// Half the width of the 95 % interval of the mean; none for a single value.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub ci95: Option<f64>,
    /// The same along x, if x is measured.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub x_ci95: Option<f64>,
}

/// A value that the paper states: a point, or a line where one coordinate is not given.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Quoted {
    /// The horizontal coordinate, if given.
    pub x: Option<f64>,
    /// The vertical coordinate, if given.
    pub y: Option<f64>,
    /// Its name.
    pub text: String,
}

/// Values over the floor, row by row from the smallest y.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Floor {
    /// The quantity with the unit.
    pub label: String,
    /// Cells along x.
    pub columns: usize,
    /// Cells along y.
    pub rows: usize,
    /// Half the room's extent along x and y in m.
    pub half_m: [f64; 2],
    /// One value for each cell, at its centre.
    pub values: Vec<f64>,
}

impl Floor {
    /// The centre of a cell.
    pub fn centre(&self, column: usize, row: usize) -> [f64; 2] {
        let place = |index: usize, count: usize, half: f64| half * ((2 * index + 1) as f64 / count as f64 - 1.0);
        [place(column, self.columns, self.half_m[0]), place(row, self.rows, self.half_m[1])]
    }

    /// The smallest and the largest value.
    pub fn range(&self) -> [f64; 2] {
        let wider = |[low, high]: [f64; 2], value: &f64| [low.min(*value), high.max(*value)];
        self.values.iter().fold([f64::INFINITY, f64::NEG_INFINITY], wider)
    }

    /// The mean value.
    pub fn mean(&self) -> f64 {
        self.values.iter().sum::<f64>() / self.values.len() as f64
    }
}

impl Figure {
    /// The names of all series, each once, in the order in which they first appear.
    pub fn names(&self) -> Vec<&str> {
        let mut names: Vec<&str> = Vec::new();
        for series in self.panels.iter().flat_map(|panel| &panel.series) {
            if !names.contains(&series.name.as_str()) {
                names.push(&series.name);
            }
        }
        names
    }

    /// The series with this name in the panel with this title.
    pub fn series(&self, panel: &str, name: &str) -> Option<&Series> {
        let panel = self.panels.iter().find(|candidate| candidate.title == panel)?;
        panel.series.iter().find(|series| series.name == name)
    }

    /// File name without extension.
    pub fn stem(&self) -> String {
        format!("{}-{}", self.id, self.room)
    }

    /// Smallest and largest value of all floors.
    pub fn floor_range(&self) -> Option<[f64; 2]> {
        let ranges = self.panels.iter().filter_map(|panel| panel.floor.as_ref()).map(Floor::range);
        ranges.reduce(|one, other| [one[0].min(other[0]), one[1].max(other[1])])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_category_is_at_its_number_and_has_half_a_step_on_each_side() {
        let axis = Axis::categories("combining", ["best", "equal-gain"].map(String::from).into());
        let found = [0.0, 0.5, 1.0, 1.5, 2.0, 3.0].map(|position| axis.category(position));
        assert_eq!((found, axis.range), ([None, None, Some("best"), None, Some("equal-gain"), None], Some([0.5, 2.5])));
        assert_eq!(Axis::linear("users").category(1.0), None);
    }

    #[test]
    fn panels_are_found_by_their_complete_title() {
        let series = Series { name: "2 m/s".into(), points: Vec::new() };
        let panel = |title: &str| Panel { title: title.into(), series: vec![series.clone()], ..Panel::default() };
        let figure = Figure { panels: vec![panel("100 + 100 ms, predicted")], ..Figure::default() };
        assert_eq!(figure.series("100 + 100 ms", "2 m/s"), None);
        assert_eq!(figure.series("100 + 100 ms, predicted", "2 m/s"), Some(&series));
    }
}
