//! Overrides of the form `table.key=value`, as `--set` takes them.

use crate::error::ScenarioError;

/// Sets one `table.key=value` in a table; a value that is not TOML is a string.
///
/// # Errors
/// [`ScenarioError::Override`] for another form, or for a key below a value that is no table. One of
/// several tables is selected by its index from 0, as in `mirrors.1.rows=4`; [`ScenarioError::NoSuchEntry`]
/// for one that the list does not have.
pub(crate) fn apply(table: &mut toml::Table, text: &str) -> Result<(), ScenarioError> {
    let refused = || ScenarioError::Override { text: text.into() };
    let (path, value) = text.split_once('=').ok_or_else(refused)?;
    let value = value_of(value);
    let keys: Vec<&str> = path.trim().split('.').collect();
    let (last, keys) = keys.split_last().filter(|(last, _)| !last.is_empty()).ok_or_else(refused)?;
    let (mut table, mut depth) = (table, 0);
    while let Some(key) = keys.get(depth) {
        depth += 1;
        // A number selects one of several tables.
        let index = keys.get(depth).and_then(|key| key.parse::<usize>().ok());
        let list = &keys[..depth];
        let missing = |index, count| ScenarioError::NoSuchEntry { list: list.join("."), index, count };
        if let (Some(index), None) = (index, table.get(*key)) {
            return Err(missing(index, 0));
        }
        let entry = match table.entry(*key).or_insert_with(|| toml::Value::Table(toml::Table::new())) {
            toml::Value::Array(entries) => {
                let (index, count) = (index.ok_or_else(refused)?, entries.len());
                depth += 1;
                entries.get_mut(index).ok_or_else(|| missing(index, count))?
            }
            entry => entry,
        };
        table = entry.as_table_mut().ok_or_else(refused)?;
    }
    // An integer is accepted for a key that holds a floating-point number.
    let value = match (table.get(*last), value) {
        (Some(toml::Value::Float(_)), toml::Value::Integer(whole)) => toml::Value::Float(whole as f64),
        (_, value) => value,
    };
    table.insert((*last).into(), value);
    Ok(())
}

/// The keys that an override writes: of `control={belief="none"}` the key `control.belief`.
pub fn override_keys(text: &str) -> Vec<String> {
    let (path, value) = text.split_once('=').unwrap_or((text, ""));
    let path = path.trim();
    match value_of(value) {
        toml::Value::Table(table) if !table.is_empty() => table.keys().map(|key| format!("{path}.{key}")).collect(),
        _ => vec![path.to_owned()],
    }
}

/// A value of TOML, or a string.
fn value_of(text: &str) -> toml::Value {
    let text = text.trim();
    toml::from_str::<toml::Table>(&format!("value = {text}"))
        .ok()
        .and_then(|mut parsed| parsed.remove("value"))
        .unwrap_or_else(|| toml::Value::String(text.into()))
}
