//! Texts of TOML as values, and in words why a text is none.

use std::fmt;
use std::ops::Range;

use serde::de::{DeserializeOwned, Unexpected};
use toml::de::{DeTable, DeValue};

use crate::excerpt;
use crate::similar::hint;

/// The end of a message about a line that is no TOML.
const EXAMPLE: &str = "; expected TOML, for example `key = 1`";

/// Why a text of TOML is not what was expected: line, key, what was found and what was expected, in one line.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TomlError {
    line: Option<usize>,
    place: Option<usize>,
    key: Option<String>,
    message: String,
}

/// Reads a text of TOML.
///
/// ```
/// #[derive(Debug, serde::Deserialize)]
/// struct Board {
///     range_deg: f64,
/// }
///
/// let board: Board = heliostat_files::from_toml("range_deg = 5.0").expect("a board");
/// assert_eq!(board.range_deg, 5.0);
/// let error = heliostat_files::from_toml::<Board>("range_deg = \"five\"").expect_err("no number");
/// assert_eq!(error.to_string(), "line 1: range_deg: invalid type: string \"five\", expected a number");
/// ```
///
/// # Errors
/// [`TomlError`]: a text that is no TOML, or a key that is unknown, missing or of another type.
pub fn from_toml<T: DeserializeOwned>(text: &str) -> Result<T, TomlError> {
    toml::from_str(text).map_err(|error| TomlError::new(text, &error))
}

impl TomlError {
    fn new(text: &str, error: &toml::de::Error) -> Self {
        let mut message = in_words(error.message()).replace('\n', "; ");
        let line_at = |place: usize| Some(line_of(text, place));
        let span = error.span();
        let Ok(document) = DeTable::parse(text) else {
            let line = span.and_then(|span| line_at(span.start));
            let written = line.and_then(|line| text.lines().nth(line - 1));
            // The parser asks for quotation marks around the value that is not there.
            if written.is_some_and(|written| without_comment(written).ends_with('=')) {
                message = "expected a value after `=`".to_owned();
            }
            let written = written.map(|written| format!("`{}`: ", visible(written))).unwrap_or_default();
            return Self { line, place: None, key: None, message: format!("{written}{message}{EXAMPLE}") };
        };
        let (key, place) = refused_entry(document.get_ref(), span, error.message()).unzip();
        Self { line: place.and_then(line_at), place, key: key.as_deref().map(excerpt), message }
    }

    /// The line of the text, from 1, where one is refused.
    pub fn line(&self) -> Option<usize> {
        self.line
    }

    /// The place in bytes of the refused entry, in a text of TOML where one is refused.
    pub fn place(&self) -> Option<usize> {
        self.place
    }

    /// The same error of a text that no user has written: its lines mean nothing.
    #[must_use]
    pub fn without_line(self) -> Self {
        Self { line: None, place: None, ..self }
    }
}

impl fmt::Display for TomlError {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(line) = self.line {
            write!(formatter, "line {line}: ")?;
        }
        if let Some(key) = &self.key {
            write!(formatter, "{key}: ")?;
        }
        formatter.write_str(&self.message)
    }
}

impl std::error::Error for TomlError {}

/// A table, its name from the root, and the place where it begins.
type Named<'a, 'text> = (String, usize, &'a DeTable<'text>);

/// The name and the place of the entry that a message of the parser refuses. Where a key of a table decides about the
/// others, the parser names the place of the table alone, that of the list for a list of such tables, and of the text as
/// a whole an empty one.
fn refused_entry(root: &DeTable<'_>, span: Option<Range<usize>>, message: &str) -> Option<(String, usize)> {
    let Some(span) = span.filter(|span| !span.is_empty()) else { return refused_in(root, message) };
    if let Some((name, tables)) = tables_at(root, &span) {
        let mut entries = tables.iter().filter_map(|(name, start, table)| {
            let entry = refused_in(table, message).map(|(key, place)| (format!("{name}.{key}"), place));
            entry.or_else(|| is_lacking(table, message).then(|| (name.clone(), *start)))
        });
        // The message does not say which of several tables it refuses.
        let only = entries.next().filter(|_| entries.next().is_none());
        return only.or(Some((name, span.start)));
    }
    entry_at(root, span.start).map(|(key, _)| (key, span.start))
}

/// The name of the table or the list at this place, and the table or those of the list. The place of `[table]` is that
/// of its header, and the place of a list of `[[tables]]` that of the first header.
fn tables_at<'a, 'text>(table: &'a DeTable<'text>, span: &Range<usize>) -> Option<(String, Vec<Named<'a, 'text>>)> {
    let below = |name: &str, inner: &'a DeTable<'text>| {
        let (rest, tables) = tables_at(inner, span)?;
        let named = |rest: String| format!("{name}.{rest}");
        Some((named(rest), tables.into_iter().map(|(rest, start, table)| (named(rest), start, table)).collect()))
    };
    table.iter().find_map(|(key, value)| {
        let (name, is_here) = (key.get_ref().to_string(), value.span() == *span);
        match value.get_ref() {
            DeValue::Table(inner) if is_here => Some((name.clone(), vec![(name, span.start, inner)])),
            DeValue::Table(inner) => below(&name, inner),
            DeValue::Array(items) => {
                let tables = items.iter().enumerate().filter_map(|(index, item)| {
                    Some((format!("{name}.{index}"), item.span().start, item.get_ref().as_table()?))
                });
                let mut tables: Vec<Named<'_, '_>> = tables.collect();
                if is_here {
                    return Some((name, tables));
                }
                let here = tables.iter().position(|(_, start, _)| *start == span.start);
                match here {
                    Some(here) => Some((tables[here].0.clone(), vec![tables.swap_remove(here)])),
                    None => tables.iter().find_map(|(name, _, inner)| below(name, inner)),
                }
            }
            _ => None,
        }
    })
}

/// Whether a table lacks the entry that a message of the parser misses.
fn is_lacking(table: &DeTable<'_>, message: &str) -> bool {
    let missing = message.strip_prefix("missing field `").and_then(|rest| rest.split('`').next());
    missing.is_some_and(|missing| table.iter().all(|(key, _)| key.get_ref() != missing))
}

/// The entry of a table that a message of the parser refuses, by its name or its value, and its place; `None` where
/// several have this value, because the message does not say which of them it refuses.
fn refused_in(table: &DeTable<'_>, message: &str) -> Option<(String, usize)> {
    let unknown = message.strip_prefix("unknown field `").and_then(|rest| rest.split('`').next());
    let value = message.strip_prefix("invalid type: ").or_else(|| message.strip_prefix("invalid value: "));
    let value = value.and_then(|rest| Some(rest.rsplit_once(", expected ")?.0));
    let is_refused = |key: &str, found: &DeValue<'_>| {
        unknown == Some(key) || (value.is_some() && described(found).as_deref() == value)
    };
    let mut entries = table.iter().filter(|(key, found)| is_refused(key.get_ref(), found.get_ref()));
    let (key, _) = entries.next()?;
    entries.next().is_none().then(|| (key.get_ref().to_string(), key.span().start))
}

/// A value in the words of the parser.
fn described(value: &DeValue<'_>) -> Option<String> {
    let found = match value {
        DeValue::String(text) => Unexpected::Str(text),
        DeValue::Integer(number) => Unexpected::Signed(i64::from_str_radix(number.as_str(), number.radix()).ok()?),
        DeValue::Float(number) => Unexpected::Float(number.as_str().parse().ok()?),
        DeValue::Boolean(is_so) => Unexpected::Bool(*is_so),
        DeValue::Array(_) => Unexpected::Seq,
        DeValue::Table(_) => Unexpected::Map,
        DeValue::Datetime(_) => return None,
    };
    Some(found.to_string())
}

/// The line of a place in a text, from 1. The place is that of any byte, also within a letter or beyond the end.
pub fn line_of(text: &str, place: usize) -> usize {
    text.bytes().take(place).filter(|byte| *byte == b'\n').count() + 1
}

/// The innermost entry of a table around a place in the text, with its name from the root.
pub fn entry_at(table: &DeTable<'_>, place: usize) -> Option<(String, Range<usize>)> {
    table.iter().find_map(|(key, value)| {
        if let DeValue::Table(inner) = value.get_ref()
            && let Some((name, found)) = entry_at(inner, place)
        {
            return Some((format!("{}.{name}", key.get_ref()), found));
        }
        let entry = key.span().start..value.span().end.max(key.span().end);
        if entry.contains(&place) {
            return Some((key.get_ref().to_string(), entry));
        }
        // The tables of `[[key]]` are outside the entry of the key.
        let tables = value.get_ref().as_array()?.iter().enumerate();
        tables.filter_map(|(index, item)| Some((index, item.get_ref().as_table()?))).find_map(|(index, inner)| {
            entry_at(inner, place).map(|(name, found)| (format!("{}.{index}.{name}", key.get_ref()), found))
        })
    })
}

/// A line without its comment. A sign of number within a text counts as one too.
fn without_comment(line: &str) -> &str {
    line.split('#').next().unwrap_or_default().trim()
}

/// The beginning of a line. What is neither a letter nor of ASCII is escaped: an editor writes quotation marks and spaces
/// that look like those of TOML.
fn visible(line: &str) -> String {
    let shown = |letter: char| match letter {
        ' '..='~' => letter.to_string(),
        _ if letter.is_alphanumeric() => letter.to_string(),
        _ => letter.escape_default().to_string(),
    };
    excerpt(line.trim()).chars().map(shown).collect()
}

/// A message of the parser with words in place of the names of Rust's types, with the known name that an unknown one
/// resembles, and with the beginnings of long names and values.
fn in_words(message: &str) -> String {
    let lines = message.split('\n').map(|line| with_similar_name(&without_struct(&cut_quotes(line))));
    let message = &lines.collect::<Vec<_>>().join("\n");
    // TOML has no larger integer.
    let largest = "a whole number from 0 to 9223372036854775807";
    let whole = [
        ("usize", largest),
        ("u64", largest),
        ("u32", "a whole number from 0 to 4294967295"),
        ("u16", "a whole number from 0 to 65535"),
        ("u8", "a whole number from 0 to 255"),
        ("i64", "a whole number"),
        ("i32", "a whole number"),
    ];
    let real = ["f64", "f32"].map(|name| (name, "a number"));
    let lists = [("a sequence", "a list"), ("an array of length", "numbers in a list of length")];
    let named = whole.into_iter().chain(real).chain(lists);
    let expected = named.map(|(name, words)| (format!("expected {name}"), format!("expected {words}")));
    // The parser passes a date on as a table.
    let found = [("map", "a table or a date"), ("sequence", "a list")];
    let found = found.map(|(name, words)| (format!("invalid type: {name}, "), format!("invalid type: {words}, ")));
    let large = ["i128", "u128"].map(|name| (format!("` as {name}, "), "`, ".to_owned()));
    let words = expected.chain(found).chain(large);
    words.fold(message.to_owned(), |text, (name, words)| text.replace(&name, &words))
}

/// A line with the beginning of each long part between quotation marks.
fn cut_quotes(line: &str) -> String {
    let cut = |part: &str| part.split('"').map(excerpt).collect::<Vec<_>>().join("\"");
    line.split('`').map(cut).collect::<Vec<_>>().join("`")
}

/// A line with "a table" in place of the name of a struct.
fn without_struct(line: &str) -> String {
    let Some((reason, named)) = line.split_once("expected struct ") else { return line.to_owned() };
    format!("{reason}expected a table{}", named.trim_start_matches(char::is_alphanumeric))
}

/// A line about an unknown name, followed by the known one that it resembles.
fn with_similar_name(line: &str) -> String {
    let mut names = line.split('`').skip(1).step_by(2);
    let is_about_name = line.starts_with("unknown ") && line.contains(", expected ");
    let hint = names.next().filter(|_| is_about_name).map(|unknown| hint(unknown, names)).unwrap_or_default();
    format!("{line}{hint}")
}

#[cfg(test)]
mod tests {
    use serde::Deserialize;

    use super::*;

    #[derive(Debug, Deserialize)]
    #[serde(deny_unknown_fields)]
    #[allow(dead_code, reason = "only the refusals matter")]
    struct File {
        rows: usize,
        #[serde(default)]
        boards: Vec<Board>,
        #[serde(default)]
        axis: Option<Axis>,
    }

    #[derive(Debug, Deserialize)]
    #[serde(tag = "kind", rename_all = "kebab-case", deny_unknown_fields)]
    #[allow(dead_code, reason = "only the refusals matter")]
    enum Board {
        Servo { address: String, range_deg: f64, mirrors: Vec<usize> },
    }

    #[derive(Debug, Deserialize)]
    #[serde(deny_unknown_fields)]
    #[allow(dead_code, reason = "only the refusals matter")]
    struct Axis {
        gain: Vec<f64>,
    }

    fn refusal(text: &str) -> String {
        from_toml::<File>(text).expect_err("refused").to_string()
    }

    #[test]
    fn a_refused_value_is_named_with_its_line_and_its_key_and_in_words() {
        for (text, expected) in [
            (
                "rows = 1.5",
                "line 1: rows: invalid type: floating point `1.5`, expected a whole number from 0 to 9223372036854775807",
            ),
            ("rows = 2026-01-02", "line 1: rows: invalid type: a table or a date, expected a whole number from 0 to "),
            ("rows = [1]", "line 1: rows: invalid type: a list, expected a whole number from 0 to "),
            (
                "rows = 99999999999999999999",
                "line 1: rows: invalid type: integer `99999999999999999999`, expected a whole number from 0 to ",
            ),
            (
                "rows = 1\n[axis]\ngain = [1.0, \"x\"]",
                "line 3: axis.gain: invalid type: string \"x\", expected a number",
            ),
            (
                "rows = 1\nrow = 2",
                "line 2: row: unknown field `row`, expected one of `rows`, `boards`, `axis`; a similar name exists: rows",
            ),
            ("rows = 1\n[axis]\n", "line 2: axis: missing field `gain`"),
            ("boards = []", "missing field `rows`"),
            ("rows = 1\ncolumns 3", "line 2: `columns 3`: "),
            ("rows = \ncolumns = 3", "line 1: `rows =`: expected a value after `=`; expected TOML, for example"),
            ("columns = 3\nrows = # of mirrors", "line 2: `rows = # of mirrors`: expected a value after `=`"),
        ] {
            let found = refusal(text);
            assert!(found.starts_with(expected), "{found}");
            assert!(!found.contains('\n'), "{found}");
        }
        let error = from_toml::<File>("rows = 1\nrow = 2").expect_err("refused");
        assert_eq!((error.line(), error.place()), (Some(2), Some(9)));
        assert!(error.without_line().to_string().starts_with("row: unknown field `row`"));
    }

    #[test]
    fn a_place_within_a_letter_or_beyond_the_end_has_a_line() {
        assert_eq!([0, 2, 3, 4, 99].map(|place| line_of("\u{e9}\nb\n", place)), [1, 1, 2, 2, 3]);
        for text in ["\u{201c}", "rows = \u{201c}1\u{201d}", "rows = 1\u{e9}\n", "rows = 1\n\u{e9} = [\u{e9}"] {
            assert!(!refusal(text).contains('\n'), "{text}");
        }
    }

    #[test]
    fn a_refused_value_of_a_table_whose_kind_decides_is_named_as_any_other() {
        let board = |lines: &str| {
            let first = "[[boards]]\nkind = \"servo\"\naddress = \"a\"\nrange_deg = 1.0\nmirrors = [0]\n";
            refusal(&format!("rows = 1\n{first}[[boards]]\nkind = \"servo\"\n{lines}"))
        };
        let number = "line 10: boards.1.range_deg: invalid type: string \"five\", expected a number";
        assert_eq!(board("address = \"b\"\nrange_deg = \"five\"\nmirrors = [1]"), number);
        assert_eq!(
            board("range_deg = 1\naddress = 5\nmirrors = [1]"),
            "line 10: boards.1.address: invalid type: integer `5`, expected a string"
        );
        // The message does not say which 5 it refuses, and the parser not in which table.
        assert_eq!(
            board("range_deg = 5\naddress = 5\nmirrors = [1]"),
            "line 2: boards: invalid type: integer `5`, expected a string"
        );
        assert!(board("range = 5.0").starts_with("line 9: boards.1.range: unknown field `range`, expected one of "));
        assert_eq!(board("address = \"b\"\nmirrors = [1]"), "line 7: boards.1: missing field `range_deg`");
        let inline = refusal("rows = 1\nboards = [{ kind = \"servo\", address = \"b\", mirrors = 3 }]");
        assert!(inline.starts_with("line 2: boards.0.mirrors: invalid type: integer `3`, expected a list"), "{inline}");
    }
}
