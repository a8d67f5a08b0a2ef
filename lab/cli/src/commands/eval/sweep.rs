//! Several values of one or two scenario keys: `users.count=1..10`, `noise.variance_a2=2e-15,6.5e-15,2e-14`,
//! `led.positions_m=[[0,0,3]],[[1,0,3],[-1,0,3]]`.

use std::str::FromStr;

use heliostat_scenario::Scenario;

/// Largest number of values: each is a comparison of its own.
const VALUES_MAX: usize = 1000;

/// A key and its values, in order.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Sweep {
    key: String,
    values: Vec<String>,
}

impl Sweep {
    /// The key, as `table.key`.
    pub fn key(&self) -> &str {
        &self.key
    }

    /// The values as text.
    pub fn values(&self) -> &[String] {
        &self.values
    }
}

/// The points of one sweep, or of each combination of two.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Grid<'a> {
    sweeps: &'a [Sweep],
    /// One value for each key; the last key changes fastest.
    points: Vec<Vec<&'a str>>,
}

/// The points of which the figures are subtracted from those of a sweep, one for each of its points.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Bases<'a> {
    /// The key along which they are the first; `None`: the first point of all.
    pub key: Option<&'a str>,
    /// In words.
    pub name: String,
    /// Their indices.
    pub points: Vec<usize>,
}

/// A point of a sweep as changes to a scenario.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Change {
    /// Overrides of the form `table.key=value`.
    pub overrides: Vec<String>,
    /// The point has no mirrors, which no scenario describes.
    pub without_mirrors: bool,
}

impl<'a> Grid<'a> {
    /// `None` without a sweep.
    ///
    /// # Errors
    /// More than two sweeps, two of one key, or too many points.
    pub fn new(sweeps: &'a [Sweep]) -> Result<Option<Self>, String> {
        let Some((first, others)) = sweeps.split_first() else { return Ok(None) };
        if others.len() > 1 {
            return Err(format!(
                "--sweep is given {} times: expected at most two keys; run the command for each value of the others, \
                 with --set",
                sweeps.len()
            ));
        }
        if others.iter().any(|other| other.key == first.key) {
            return Err(format!(
                "--sweep {} is given twice: expected another key, or all values in one list",
                first.key
            ));
        }
        let seconds: Vec<Option<&str>> = match others {
            [other] => other.values.iter().map(|value| Some(value.as_str())).collect(),
            _ => vec![None],
        };
        let of_first = |value: &'a String| seconds.iter().map(move |other| [Some(value.as_str()), *other]);
        let points: Vec<Vec<&str>> =
            first.values.iter().flat_map(of_first).map(|point| point.into_iter().flatten().collect()).collect();
        if points.len() > VALUES_MAX {
            return Err(format!("--sweep has {} combinations: expected at most {VALUES_MAX}", points.len()));
        }
        Ok(Some(Self { sweeps, points }))
    }

    /// The keys, one or two.
    pub fn keys(&self) -> impl Iterator<Item = &'a str> {
        self.sweeps.iter().map(Sweep::key)
    }

    /// The values of each key.
    pub fn sweeps(&self) -> &'a [Sweep] {
        self.sweeps
    }

    /// The values of the keys at each point.
    pub fn points(&self) -> &[Vec<&'a str>] {
        &self.points
    }

    /// What is subtracted from the figures of the points: those of the first point, and with two keys also those of the
    /// point with the first value of one key and the same value of the other.
    pub fn bases(&self) -> Vec<Bases<'a>> {
        let first = Bases { key: None, name: self.name(&self.points[0]), points: vec![0; self.points.len()] };
        let keys = (0..self.sweeps.len()).filter(|_| self.sweeps.len() > 1);
        std::iter::once(first).chain(keys.map(|key| self.bases_along(key))).collect()
    }

    fn bases_along(&self, key: usize) -> Bases<'a> {
        let sweep = &self.sweeps[key];
        // How far two neighbours along the key are apart, as the last key changes fastest.
        let stride: usize = self.sweeps[key + 1..].iter().map(|later| later.values.len()).product();
        let base = |index: usize| index - index / stride % sweep.values.len() * stride;
        let others: Vec<&str> = self.keys().filter(|other| *other != sweep.key()).collect();
        Bases {
            key: Some(sweep.key()),
            name: format!("{} = {} with the same {}", sweep.key(), sweep.values[0], others.join(", ")),
            points: (0..self.points.len()).map(base).collect(),
        }
    }

    /// The changes to the scenario at each point. A room of 0 rows or columns of mirrors has none.
    pub fn changes(&self) -> impl Iterator<Item = Change> {
        self.points.iter().map(|point| {
            let mut without_mirrors = false;
            let overrides = self.keys().zip(point).map(|(key, value)| {
                let is_none = is_without_mirrors(key, value);
                without_mirrors |= is_none;
                format!("{key}={}", if is_none { "1" } else { value })
            });
            let overrides = overrides.collect();
            Change { overrides, without_mirrors }
        })
    }

    /// Refuses a term of the noise in a room whose noise is given as a sum, before the work starts.
    ///
    /// # Errors
    /// The key, why it has no effect, and what to do.
    pub fn check_noise(&self, room: &Scenario) -> Result<(), String> {
        let is_term = |key: &&str| key.strip_prefix("noise.").is_some_and(|term| term != "variance_a2");
        match self.keys().find(is_term).filter(|_| room.noise.variance_a2.is_some()) {
            None => Ok(()),
            Some(key) => Err(format!(
                "--sweep {key}: no effect, because noise.variance_a2 replaces the sum of the terms: sweep \
                 noise.variance_a2 without {key}, or give a scenario file without noise.variance_a2"
            )),
        }
    }

    /// The keys whose values change nothing: points that differ in such a key alone have equal `figures`, which
    /// are given for each point.
    pub fn without_effect<F: PartialEq>(&self, figures: &[F]) -> Vec<&'a str> {
        let points = || self.points.iter().zip(figures);
        let changes = |index: usize| {
            let differs_in_it = |one: &[&str], other: &[&str]| {
                (0..one.len()).all(|position| (one[position] != other[position]) == (position == index))
            };
            let mut pairs = points().flat_map(|one| points().map(move |other| (one, other)));
            pairs.any(|((one, before), (other, after))| differs_in_it(one, other) && before != after)
        };
        let has_values = |sweep: &Sweep| sweep.values.len() > 1;
        let sweeps = self.sweeps.iter().enumerate();
        sweeps.filter(|(index, sweep)| has_values(sweep) && !changes(*index)).map(|(_, sweep)| sweep.key()).collect()
    }

    /// A point in words, as `users.count = 3, led.power_w = 2`.
    pub fn name(&self, point: &[&str]) -> String {
        self.keys().zip(point).map(|(key, value)| format!("{key} = {value}")).collect::<Vec<_>>().join(", ")
    }
}

/// Whether a value of a key means a room without mirrors, which no scenario describes.
pub fn is_without_mirrors(key: &str, value: &str) -> bool {
    matches!(key, "mirrors.rows" | "mirrors.columns") && value == "0"
}

impl FromStr for Sweep {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let expected = "expected table.key=FIRST..LAST of whole numbers, or table.key=A,B,C";
        let (key, values) = text.split_once('=').ok_or(expected)?;
        let values: Vec<String> = match values.split_once("..") {
            Some((first, last)) => {
                let number = |text: &str| text.trim_start_matches('=').parse::<u32>().map_err(|_| expected);
                let range = number(first)?..=number(last)?;
                range.take(VALUES_MAX + 1).map(|value| value.to_string()).collect()
            }
            None => listed(values),
        };
        if values.len() > VALUES_MAX {
            return Err(format!("too many values: expected at most {VALUES_MAX}"));
        }
        if key.trim().is_empty() || values.is_empty() || values.iter().any(String::is_empty) {
            return Err(expected.into());
        }
        if let Some(twice) =
            values.iter().enumerate().find_map(|(index, value)| values[..index].contains(value).then_some(value))
        {
            return Err(format!("{} = {twice} is given twice: expected different values", key.trim()));
        }
        Ok(Self { key: key.trim().into(), values })
    }
}

/// The values between commas; commas within brackets or quotation marks belong to a value.
fn listed(text: &str) -> Vec<String> {
    let (mut depth, mut is_quoted) = (0_usize, false);
    let parts = text.split(|character| {
        match character {
            '"' => is_quoted = !is_quoted,
            '[' | '{' if !is_quoted => depth += 1,
            ']' | '}' if !is_quoted => depth = depth.saturating_sub(1),
            _ => {}
        }
        character == ',' && depth == 0 && !is_quoted
    });
    parts.map(|value| value.trim().to_owned()).collect()
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn ranges_hold_both_ends_and_lists_keep_their_order() {
        let sweep: Sweep = "users.count=1..4".parse().expect("a range");
        assert_eq!((sweep.key(), sweep.values().len()), ("users.count", 4));
        assert_eq!(sweep.values().last().map(String::as_str), Some("4"));
        let sweep: Sweep = "noise.variance_a2=6.5e-15, 2e-15".parse().expect("a list");
        assert_eq!(sweep.values(), ["6.5e-15", "2e-15"]);
        let sweep: Sweep = "led.positions_m=[[0,0,3]],[[1,0,3],[-1,0,3]]".parse().expect("a list of lists");
        assert_eq!(sweep.values(), ["[[0,0,3]]", "[[1,0,3],[-1,0,3]]"]);
        assert_eq!("seed=1..1000".parse::<Sweep>().expect("a range").values().len(), 1000);
        assert!("seed=0..4294967295".parse::<Sweep>().expect_err("too many").contains("at most 1000"));
        for text in ["users.count", "=1..3", "users.count=3..1", "users.count=1,,2", "users.count=a..b"] {
            assert!(text.parse::<Sweep>().is_err(), "{text}");
        }
    }

    fn sweeps(texts: &[&str]) -> Vec<Sweep> {
        texts.iter().map(|text| text.parse().expect("a sweep")).collect()
    }

    #[test]
    fn a_key_of_which_no_value_changes_a_figure_is_without_effect() {
        let two = sweeps(&["name=a,b", "users.count=1..2"]);
        let grid = Grid::new(&two).expect("two keys").expect("a sweep");
        assert_eq!(grid.without_effect(&[5, 7, 5, 7]), ["name"]);
        assert_eq!(grid.without_effect(&[5, 7, 5, 8]), [""; 0]);
        assert_eq!(grid.without_effect(&[5, 5, 5, 5]), ["name", "users.count"]);
        let single = sweeps(&["users.count=3"]);
        let grid = Grid::new(&single).expect("a key").expect("a sweep");
        assert_eq!(grid.without_effect(&[5]), [""; 0], "one value shows nothing");
    }

    #[test]
    fn the_points_of_two_keys_are_compared_with_the_first_one_and_along_each_key() {
        let two = sweeps(&["led.power_w=1,2", "users.count=1..3"]);
        let bases = Grid::new(&two).expect("two keys").expect("a sweep").bases();
        let found: Vec<_> = bases.iter().map(|bases| (bases.key, bases.points.as_slice())).collect();
        assert_eq!(
            found,
            [
                (None, &[0; 6][..]),
                (Some("led.power_w"), &[0, 1, 2, 0, 1, 2]),
                (Some("users.count"), &[0, 0, 0, 3, 3, 3]),
            ]
        );
        assert_eq!(bases[0].name, "led.power_w = 1, users.count = 1");
        assert_eq!(bases[2].name, "users.count = 1 with the same led.power_w");
        let one = sweeps(&["users.count=1..3"]);
        assert_eq!(Grid::new(&one).expect("a key").expect("a sweep").bases().len(), 1);
    }

    #[test]
    fn two_keys_of_the_noise_are_swept_together_unless_one_replaces_the_other() {
        let hall = Scenario::builtin("hall").expect("a built-in one");
        let checked = |texts: &[&str]| {
            let two = sweeps(texts);
            let grid = Grid::new(&two).expect("two keys").expect("a sweep");
            let room = |change: Change| hall.with_overrides(&change.overrides).expect("a valid point");
            let rooms: Vec<Scenario> = grid.changes().map(room).collect();
            let each: BTreeSet<String> = rooms.iter().map(Scenario::to_toml).collect();
            assert_eq!(each.len(), 4, "each point is a room of its own: {texts:?}");
            grid.check_noise(&rooms[0])
        };
        for texts in [
            ["streams.positions.noise_m=0,0.05", "streams.channel.noise_relative=0,0.1"],
            ["streams.positions.noise_m=0,0.05", "streams.positions.velocity_noise_m_s=0,0.1"],
            ["noise.background_shot_a2_per_hz=1e-22,2e-22", "noise.thermal_a2_per_hz=1e-24,2e-24"],
            ["noise.variance_a2=2e-15,6.5e-15", "streams.positions.noise_m=0,0.05"],
        ] {
            assert_eq!(checked(&texts), Ok(()));
        }
        let refusal = checked(&["noise.variance_a2=2e-15,6.5e-15", "noise.thermal_a2_per_hz=1e-24,2e-24"]);
        let refusal = refusal.expect_err("the sum replaces its terms");
        assert!(
            refusal.starts_with("--sweep noise.thermal_a2_per_hz: no effect, because noise.variance_a2"),
            "{refusal}"
        );
    }

    #[test]
    fn two_keys_give_each_combination_and_a_room_may_have_no_mirrors() {
        let two = sweeps(&["mirrors.rows=0,2", "users.count=1..3"]);
        let grid = Grid::new(&two).expect("two keys").expect("a sweep");
        assert_eq!(grid.points().len(), 6);
        assert_eq!(grid.name(&grid.points()[5]), "mirrors.rows = 2, users.count = 3");
        let changes: Vec<Change> = grid.changes().collect();
        assert_eq!((changes[1].overrides[0].as_str(), changes[1].without_mirrors), ("mirrors.rows=1", true));
        assert_eq!((changes[3].overrides[0].as_str(), changes[3].without_mirrors), ("mirrors.rows=2", false));
        assert_eq!(Grid::new(&[]), Ok(None));
        for (texts, part) in [
            (&["a.b=1", "a.b=2"][..], "given twice"),
            (&["a.b=1", "a.c=2", "a.d=3"], "at most two keys"),
            (&["a.b=1..40", "a.c=1..40"], "1600 combinations"),
        ] {
            let refused = Grid::new(&sweeps(texts)).expect_err("refused");
            assert!(refused.contains(part), "{refused}");
        }
    }
}
