//! Names what the user wrote where a value contradicts a default that the user did not write.

use toml::{Table, Value};

use crate::error::ScenarioError;
use crate::scenario::Scenario;

/// A key as its parts.
type Path = Vec<String>;

/// In the text of an error, before the key that was refused where another one is named.
const MISFIT: &str = "it does not fit ";

/// The same error about the written key that causes it: for a refused default, the value whose removal
/// ends the refusal. An error about a written key, or one without such a cause, is unchanged.
///
/// `table` is the complete text with `written` among its keys.
pub(crate) fn of_written(error: ScenarioError, table: &Table, written: &[Path]) -> ScenarioError {
    let ScenarioError::Invalid { key, value, expected, line } = error else { return error };
    let refused: Path = key.split(' ').next().unwrap_or(&key).split('.').map(String::from).collect();
    let is_written = written.iter().any(|path| path.starts_with(&refused) || refused.starts_with(path));
    let mut causes = written.iter().filter(|path| !is_written && is_cause(table, path, &key));
    let Some((first, found)) = causes.next().and_then(|path| Some((path, at(table, path)?))) else {
        return ScenarioError::Invalid { key, value, expected, line };
    };
    let others: Vec<String> = causes.map(|path| path.join(".")).collect();
    let together = if others.is_empty() { String::new() } else { format!(", together with {}", others.join(", ")) };
    ScenarioError::Invalid {
        key: first.join("."),
        value: found.to_string(),
        expected: format!("{MISFIT}{key} = {value}{together}: {expected}; change it, or set {key} too"),
        line: None,
    }
}

/// The same error with the domain of the key, for a written value of another type, as `users.count=nan`. An error about
/// a key without a domain of numbers is unchanged.
///
/// `table` is the complete text with `written` among its keys.
pub(crate) fn of_type(error: ScenarioError, table: &Table, written: &[Path]) -> ScenarioError {
    let refused = written.iter().find_map(|path| Some((path, at(table, path)?, domain(table, path)?)));
    let Some((path, found, expected)) = refused else { return error };
    ScenarioError::Invalid { key: path.join("."), value: found.to_string(), expected, line: None }
}

/// What the check of a key expects, by trying numbers; `None` where each is accepted, or refused for another reason.
fn domain(table: &Table, path: &Path) -> Option<String> {
    let probes = [0, i64::from(u8::MAX), i64::from(u16::MAX), i64::from(u32::MAX), i64::MAX];
    probes.into_iter().find_map(|probe| {
        let mut probed = table.clone();
        *at_mut(&mut probed, path)? = Value::Integer(probe);
        match probed.try_into::<Scenario>().ok()?.check() {
            Err(ScenarioError::Invalid { key, expected, .. }) if key == path.join(".") => Some(expected),
            _ => None,
        }
    })
}

/// The key that was refused, which is not always the one that an error names.
pub(crate) fn refused_key(error: &ScenarioError) -> Option<&str> {
    let ScenarioError::Invalid { key, expected, .. } = error else { return None };
    let of_misfit = expected.strip_prefix(MISFIT).and_then(|rest| Some(rest.split_once(" = ")?.0));
    Some(of_misfit.unwrap_or(key))
}

/// Whether the refusal of a key ends without a written one.
fn is_cause(table: &Table, path: &Path, refused: &str) -> bool {
    let mut rest = table.clone();
    if remove(&mut rest, path).is_none() {
        return false;
    }
    let Ok(scenario) = rest.try_into::<Scenario>() else { return false };
    match scenario.check() {
        Ok(()) => true,
        Err(ScenarioError::Invalid { key, .. }) => key != refused,
        Err(_) => false,
    }
}

/// A value by its keys; a number selects one of several tables.
fn at<'a>(table: &'a Table, path: &Path) -> Option<&'a Value> {
    let (first, names) = path.split_first()?;
    names.iter().try_fold(table.get(first)?, |value, name| match value {
        Value::Array(entries) => entries.get(name.parse::<usize>().ok()?),
        value => value.as_table()?.get(name),
    })
}

fn at_mut<'a>(table: &'a mut Table, path: &Path) -> Option<&'a mut Value> {
    let (first, names) = path.split_first()?;
    names.iter().try_fold(table.get_mut(first)?, |value, name| match value {
        Value::Array(entries) => entries.get_mut(name.parse::<usize>().ok()?),
        value => value.as_table_mut()?.get_mut(name),
    })
}

fn remove(table: &mut Table, path: &Path) -> Option<Value> {
    let (last, tables) = path.split_last()?;
    let mut table = table;
    for name in tables {
        table = table.get_mut(name)?.as_table_mut()?;
    }
    table.remove(last)
}

/// The keys with values of a table; an array of tables counts as one value.
pub(crate) fn keys(table: &Table) -> Vec<Path> {
    let mut found = Vec::new();
    for (name, value) in table {
        match value {
            Value::Table(inner) => found.extend(keys(inner).into_iter().map(|mut path| {
                path.insert(0, name.clone());
                path
            })),
            _ => found.push(vec![name.clone()]),
        }
    }
    found
}

/// The key of an override `table.key=value`.
pub(crate) fn key_of_override(text: &str) -> Path {
    let key = text.split_once('=').map_or(text, |(key, _)| key);
    key.trim().split('.').map(|part| part.trim().to_owned()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_refused_default_is_blamed_on_the_key_that_was_written() {
        for (text, line, key, refused) in [
            ("[users]\ncount = 2\n[room]\nheight_m = 1.5\n", 4, "room.height_m = 1.5", "led.positions_m"),
            ("[room]\nlength_x_m = 150\nlength_y_m = 150\n", 2, "room.length_x_m = 150", "blockage.obstacles_per_m2"),
            ("[users]\ncount = 2\nspeed_max_m_s = 0.05\n", 3, "users.speed_max_m_s = 0.05", ""),
            ("[blockage]\nobstacle_height_m = 9\n", 2, "blockage.obstacle_height_m = 9", ""),
        ] {
            let error = Scenario::from_toml(text).expect_err(text).to_string();
            assert!(error.starts_with(&format!("line {line}: {key}: ")) && error.contains(refused), "{error}");
            let all = Scenario::check_all(text).problems;
            assert!(all[0].to_string().contains(key), "{all:?}");
        }
    }

    #[test]
    fn keys_of_a_built_in_scenario_are_not_blamed_for_an_override() {
        let text = Scenario::builtin_text("hall").expect("built in");
        let of = |overrides: &[&str]| Scenario::from_toml_with(text, overrides).expect_err("refused").to_string();
        let error = of(&["users.count=3", "room.height_m=1.5"]);
        assert!(error.starts_with("room.height_m = 1.5: it does not fit "), "{error}");
        let error = of(&["users.count=99"]);
        assert!(error.starts_with("users.count = 99: expected"), "{error}");
        // Two written keys that contradict each other stay as they are.
        let error = of(&["users.count=2", "blockage.forced_users=3"]);
        assert!(error.starts_with("blockage.forced_users = 3: expected"), "{error}");
    }

    #[test]
    fn a_value_of_another_type_is_refused_with_the_domain_of_its_key() {
        let of = |overrides: &[&str]| {
            let text = Scenario::builtin_text("hall").expect("built in");
            Scenario::from_toml_with(text, overrides).expect_err("refused").to_string()
        };
        for (refused, message) in [
            ("users.count=nan", "users.count = nan: expected an integer from 1 to 64"),
            ("users.count=-1", "users.count = -1: expected an integer from 1 to 64"),
            ("users.count=2.5", "users.count = 2.5: expected an integer from 1 to 64"),
            ("users.count=many", "users.count = \"many\": expected an integer from 1 to 64"),
            ("room.height_m=high", "room.height_m = \"high\": expected a number from 0.5 to 50"),
        ] {
            assert_eq!(of(&[refused]), message);
            assert_eq!(of(&["users.speed_max_m_s=1", refused]), message, "beside a value that is accepted");
        }
        let of_array =
            Scenario::from_toml_with("[[mirrors]]\nrows = 4\n[[mirrors]]\nrows = 4\n", &["mirrors.1.rows=nan"]);
        let of_array = of_array.expect_err("refused").to_string();
        assert!(of_array.starts_with("mirrors.1.rows = nan: expected an integer from "), "{of_array}");
        let of_name = of(&["users.mobility=3"]);
        assert!(!of_name.contains("integer from"), "{of_name}");
    }
}
