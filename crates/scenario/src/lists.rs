//! The text of a scenario and its lists: too long ones are refused before they are read, and lists in place of tables.

use heliostat_channel::{arrays::ARRAYS_MAX, receiver::BRANCHES_MAX};
use toml::{Table, Value};

use crate::error::ScenarioError;
use crate::mobility_check::SHARES_MAX;
use crate::scenario::Scenario;

/// Longest text in bytes: 20 times the longest built-in scenario.
const TEXT_MAX: usize = 256 << 10;

/// The lists of tables: name, key of an error, and most tables.
const LISTS: [(&str, &str, usize); 3] = [
    ("mirrors", "mirrors (arrays)", ARRAYS_MAX),
    ("receiver.branches", "receiver.branches", BRANCHES_MAX),
    ("users.mixture", "users.mixture (entries)", SHARES_MAX),
];

/// Refuses a text that is longer than a scenario, and more headers `[[name]]` than the list may have tables: the check
/// of each key and table would take minutes.
///
/// # Errors
/// [`ScenarioError::Invalid`] with the length of the text, or the number of tables and the line of the first that is
/// too many.
pub(crate) fn refuse_long(text: &str) -> Result<(), ScenarioError> {
    if text.len() > TEXT_MAX {
        return Err(ScenarioError::Invalid {
            key: "scenario (bytes)".into(),
            value: text.len().to_string(),
            expected: format!("expected at most {TEXT_MAX}; a recorded walk is a file of its own, see users.trace"),
            line: None,
        });
    }
    for (name, key, most) in LISTS {
        let mut headers = text.lines().enumerate().filter(|(_, line)| header(line) == Some(name));
        if let Some((index, _)) = headers.nth(most) {
            return Err(ScenarioError::Invalid {
                key: key.into(),
                value: (most + 1 + headers.count()).to_string(),
                expected: format!("expected at most {most}"),
                line: Some(index + 1),
            });
        }
    }
    Ok(())
}

/// The name in a line `[[name]]`.
fn header(line: &str) -> Option<&str> {
    Some(line.trim_start().strip_prefix("[[")?.split_once("]]")?.0.trim())
}

/// Refuses a list in place of a table, which the parser would read as the table's values in their order.
///
/// # Errors
/// [`ScenarioError::Invalid`] for the first such key, without its line.
pub(crate) fn refuse_in_place_of_tables(table: &Table) -> Result<(), ScenarioError> {
    let known = Table::try_from(Scenario::default()).expect("every table of a scenario has a TOML form");
    match list_for_table(table, &known) {
        None => Ok(()),
        Some(key) => Err(ScenarioError::Invalid {
            expected: format!("expected a table [{key}]"),
            key,
            value: "a list".into(),
            line: None,
        }),
    }
}

/// The first key whose value is a list and whose default is a table. Only `mirrors` can be both.
fn list_for_table(found: &Table, known: &Table) -> Option<String> {
    found.iter().find_map(|(name, value)| match (value, known.get(name)?) {
        (Value::Array(_), Value::Table(_)) if name != "mirrors" => Some(name.clone()),
        (Value::Table(inner), Value::Table(known)) => Some(format!("{name}.{}", list_for_table(inner, known)?)),
        _ => None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn problems(text: &str) -> Vec<String> {
        Scenario::check_all(text).problems.iter().map(ToString::to_string).collect()
    }

    #[test]
    fn a_list_that_is_too_long_is_one_problem_with_the_number_of_its_tables() {
        let text = format!("# many\n{}[room]\nheight_m = -1\n", " [[ mirrors ]] # one\nrows = 2\n".repeat(100));
        assert_eq!(problems(&text), ["line 34: mirrors (arrays) = 100: expected at most 16"]);
        let error = Scenario::from_toml(&text).expect_err("too many").to_string();
        assert_eq!(error, "line 34: mirrors (arrays) = 100: expected at most 16");
        let mixture = format!("[users]\nmobility = \"mixture\"\n{}", "[[users.mixture]]\nshare = 0.1\n".repeat(17));
        assert_eq!(problems(&mixture), ["line 35: users.mixture (entries) = 17: expected at most 16"]);
    }

    #[test]
    fn a_text_that_is_longer_than_a_scenario_is_one_problem() {
        let keys: String = (0..200_000).map(|number| format!("key{number} = 1\n")).collect();
        let found = problems(&keys);
        assert_eq!(found.len(), 1, "{}", found.len());
        assert!(found[0].starts_with(&format!("scenario (bytes) = {}: expected at most 262144", keys.len())));
        let error = Scenario::from_toml(&keys).expect_err("too long").to_string();
        assert!(error.starts_with("scenario (bytes) = "), "{error}");
    }

    #[test]
    fn a_message_quotes_a_part_of_a_long_name_or_value() {
        let long = "x".repeat(100_000);
        for text in [
            format!("{long} = 1\n"),
            format!("[users]\n{long} = 1\n"),
            format!("[users]\nmobility = \"{long}\"\n"),
            format!("[users]\ncount = \"{long}\"\n"),
        ] {
            let error = Scenario::from_toml(&text).expect_err("refused").to_string();
            let found = problems(&text);
            for message in found.iter().chain([&error]) {
                assert!(message.len() < 5_000, "{} bytes", message.len());
            }
            assert!(error.contains("expected"), "{error}");
        }
        let overridden = Scenario::default().with_overrides(&[format!("users.count={long}")]);
        let error = overridden.expect_err("refused").to_string();
        assert!(error.ends_with("x...: expected an integer from 1 to 64") && error.len() < 5_000, "{error}");
    }

    #[test]
    fn a_list_in_place_of_a_table_is_refused() {
        let text = "led = []\n[streams]\npositions = [1]\n[mirrors]\nrows = 4\n";
        let expected = [
            "line 1: led = a list: expected a table [led]",
            "line 3: streams.positions = a list: expected a table [streams.positions]",
        ];
        assert_eq!(problems(text), expected);
        let overridden = Scenario::default().with_overrides(&["led=[]"]);
        assert!(overridden.is_err_and(|error| error.to_string().contains("expected a table [led]")));
        assert_eq!(problems("[[mirrors]]\nrows = 4\n"), [""; 0]);
    }
}
