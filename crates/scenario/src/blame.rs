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

fn at<'a>(table: &'a Table, path: &Path) -> Option<&'a Value> {
    let (last, tables) = path.split_last()?;
    let mut table = table;
    for name in tables {
        table = table.get(name)?.as_table()?;
    }
    table.get(last)
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
}
