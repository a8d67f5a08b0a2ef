//! Several values of a scenario key: `users.count=1..10`, `noise.variance_a2=2e-15,6.5e-15,2e-14`.

use std::str::FromStr;

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

    /// The changes to the scenario, one for each value.
    pub fn overrides(&self) -> impl Iterator<Item = String> {
        self.values.iter().map(|value| format!("{}={value}", self.key))
    }
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
            None => values.split(',').map(|value| value.trim().to_owned()).collect(),
        };
        if values.len() > VALUES_MAX {
            return Err(format!("too many values: expected at most {VALUES_MAX}"));
        }
        if key.trim().is_empty() || values.is_empty() || values.iter().any(String::is_empty) {
            return Err(expected.into());
        }
        Ok(Self { key: key.trim().into(), values })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_hold_both_ends_and_lists_keep_their_order() {
        let sweep: Sweep = "users.count=1..4".parse().expect("a range");
        assert_eq!((sweep.key(), sweep.values().len()), ("users.count", 4));
        assert_eq!(sweep.overrides().last().as_deref(), Some("users.count=4"));
        let sweep: Sweep = "noise.variance_a2=6.5e-15, 2e-15".parse().expect("a list");
        assert_eq!(sweep.values(), ["6.5e-15", "2e-15"]);
        assert_eq!("seed=1..1000".parse::<Sweep>().expect("a range").values().len(), 1000);
        assert!("seed=0..4294967295".parse::<Sweep>().expect_err("too many").contains("at most 1000"));
        for text in ["users.count", "=1..3", "users.count=3..1", "users.count=1,,2", "users.count=a..b"] {
            assert!(text.parse::<Sweep>().is_err(), "{text}");
        }
    }
}
