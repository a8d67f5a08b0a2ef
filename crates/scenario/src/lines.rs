//! The line of a scenario file on which a key is set.

use heliostat_files::toml_text;

/// The line of the file that sets `table.key`, counted from 1; `None` if no line does.
///
/// A missing subkey gives the line of its table. Text after a space in `key` is ignored.
pub(crate) fn line_of(text: &str, key: &str) -> Option<usize> {
    let document = toml::de::DeTable::parse(text).ok()?;
    let mut keys = key.split(' ').next()?.split('.');
    let first = keys.next()?;
    let mut found = document.get_ref().get_key_value(first)?;
    while let Some(mut key) = keys.next() {
        let mut value = found.1.get_ref();
        // A number selects one of several tables.
        if let Some(tables) = value.as_array() {
            let Some(item) = key.parse().ok().and_then(|index: usize| tables.get(index)) else { break };
            let Some(next) = keys.next() else { break };
            (value, key) = (item.get_ref(), next);
        }
        match value.as_table().and_then(|table| table.get_key_value(key)) {
            Some(entry) => found = entry,
            None => break,
        }
    }
    Some(toml_text::line_of(text, found.0.span().start))
}
