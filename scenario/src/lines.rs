//! The line of a scenario file on which a key is set.

/// The line of the file that sets `table.key`, counted from 1; `None` if no line does.
///
/// A missing subkey gives the line of its table. Text after a space in `key` is ignored.
pub(crate) fn line_of(text: &str, key: &str) -> Option<usize> {
    let document = toml::de::DeTable::parse(text).ok()?;
    let mut keys = key.split(' ').next()?.split('.');
    let first = keys.next()?;
    let mut found = document.get_ref().get_key_value(first)?;
    for key in keys {
        match found.1.get_ref().as_table().and_then(|table| table.get_key_value(key)) {
            Some(entry) => found = entry,
            None => break,
        }
    }
    Some(text[..found.0.span().start].matches('\n').count() + 1)
}
