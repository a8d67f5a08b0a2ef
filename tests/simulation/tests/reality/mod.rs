//! Measurements of real processes, from docs/faults.md, beside the ranges of the simulation.

/// Names of the compared columns, in their order on both pages.
const COLUMNS: [&str; 3] = ["gap", "lost", "recovery"];

/// Columns of docs/faults.md before these: fault and bound.
const BEFORE: usize = 2;

/// Digits that docs/faults.md does not show.
const ROUNDING: f64 = 0.5;

/// What a test of real processes measured.
pub struct Reality {
    /// What was done.
    pub action: String,
    /// The values of each column: one, or median and largest of several runs.
    values: [Vec<f64>; 3],
}

impl Reality {
    /// The row of a test.
    pub fn of(test: &str) -> Self {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/faults.md");
        let page = std::fs::read_to_string(path).expect("the page of faults");
        let row = page.lines().find(|line| line.ends_with(&format!("| `{test}` |")));
        let row = row.unwrap_or_else(|| panic!("docs/faults.md has no row {test}"));
        let cells: Vec<&str> = row.split(" | ").map(|cell| cell.trim_matches(['|', ' '])).collect();
        Self { action: cells[0].to_owned(), values: [0, 1, 2].map(|column| numbers(cells[BEFORE + column])) }
    }
}

/// Least and largest value of each column of a simulated fault.
pub struct Simulated([[f64; 2]; 3]);

impl Simulated {
    /// The row of a simulated fault on its page.
    pub fn of(page: &str, action: &str) -> Self {
        let row = page.lines().find_map(|line| line.strip_prefix(&format!("| {action} | ")));
        let row = row.unwrap_or_else(|| panic!("the page has no row: {action}"));
        let cells: Vec<Vec<f64>> = row.split(" | ").map(numbers).collect();
        Self([0, 1, 2].map(|column| {
            let values = || cells[column].iter().copied();
            [values().fold(f64::INFINITY, f64::min), values().fold(f64::NEG_INFINITY, f64::max)]
        }))
    }

    /// The columns in which a measurement lies outside.
    pub fn outside(&self, reality: &Reality) -> Vec<&'static str> {
        let is_outside = |column: &usize| {
            let [least, largest] = self.0[*column];
            reality.values[*column].iter().any(|value| *value < least - ROUNDING || *value > largest + ROUNDING)
        };
        (0..COLUMNS.len()).filter(is_outside).map(|column| COLUMNS[column]).collect()
    }

    /// Each measurement and the range, for the page.
    pub fn beside(&self, reality: &Reality) -> [String; 3] {
        [0, 1, 2].map(|column| {
            let values: Vec<String> = reality.values[column].iter().map(|value| format!("{value:.0}")).collect();
            let [least, largest] = self.0[column];
            format!("{}; {least:.0} to {largest:.0}", values.join(", "))
        })
    }
}

/// The numbers of a cell.
fn numbers(cell: &str) -> Vec<f64> {
    cell.split(|character: char| !character.is_ascii_digit() && character != '.')
        .filter_map(|part| part.parse().ok())
        .collect()
}

#[test]
fn a_measurement_outside_the_range_is_named_by_its_column() {
    let page = "| a fault | 10 / 12 / 20 / 31 | 0 / 0 / 1 / 2 | 0.4 / 5.0 / 9.0 / 10.9 |";
    let simulated = Simulated::of(page, "a fault");
    let reality = |values| Reality { action: String::new(), values };
    assert!(simulated.outside(&reality([vec![31.0, 10.0], vec![2.0], vec![11.0]])).is_empty());
    assert_eq!(simulated.outside(&reality([vec![12.0, 33.0], vec![0.0], vec![12.0]])), ["gap", "recovery"]);
    assert_eq!(numbers("57 (80)"), [57.0, 80.0]);
}
