//! All problems of a scenario file at once, for a check before a run.
//!
//! After each problem the check removes the refused key from the text, so that its default applies,
//! and continues.

use std::fmt;
use std::ops::Range;

use heliostat_files::toml_text::entry_at;
use toml::de::{DeTable, DeValue};

use crate::blame::refused_key;
use crate::error::ScenarioError;
use crate::lists::refuse_long;
use crate::scenario::Scenario;

/// Largest number of problems that are listed.
const PROBLEMS_MAX: usize = 50;

/// After so many bytes the check begins no further pass: each problem needs one. The longest built-in scenario is read
/// [`PROBLEMS_MAX`] times.
const READ_MAX: usize = 1 << 20;

/// The last line of a check that ends at such a bound.
const UNFINISHED: &str = "the rest of the file is not checked: correct these problems, and check it again";

/// A problem of a scenario file: the line, and in one line of text what was wrong and expected.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Problem {
    /// The line of the file, from 1, if one line sets the refused value.
    pub line: Option<usize>,
    /// The message, which begins with the line.
    pub text: String,
}

impl fmt::Display for Problem {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(&self.text)
    }
}

/// The result of a check.
#[derive(Clone, Debug)]
pub struct Checked {
    /// What cannot be used, in the order of the lines; last what belongs to no line.
    pub problems: Vec<Problem>,
    /// The scenario, with defaults in place of the refused keys; `None` where the rest of the text
    /// cannot be read.
    pub scenario: Option<Scenario>,
    /// The tables of the refused keys, as "users".
    pub refused_tables: Vec<String>,
}

impl Scenario {
    /// Checks the text of a file, and continues after each problem.
    pub fn check_all(text: &str) -> Checked {
        if let Err(error) = refuse_long(text) {
            let line = if let ScenarioError::Invalid { line, .. } = &error { *line } else { None };
            return checked(vec![Problem { line, text: error.to_string() }], None, Vec::new());
        }
        let mut text = text.to_owned();
        let (mut problems, mut refused_tables) = (Vec::new(), Vec::new());
        let mut removed: Vec<String> = Vec::new();
        let mut read = 0;
        loop {
            read += text.len();
            let error = match Self::from_toml(&text) {
                Ok(scenario) => return checked(problems, Some(scenario), refused_tables),
                Err(error) => error,
            };
            let (problem, refused) = examined(&text, &error);
            let key = refused_key(&error).unwrap_or_default();
            if !is_of_list(key) || !removed.iter().any(|other| list_of(other) == list_of(key)) {
                problems.push(problem);
            }
            removed.push(key.to_owned());
            refused_tables.extend(refused.as_ref().and_then(|entry| table_of(&text, entry.start)));
            let rest = refused.map(|entry| without(&text, entry)).filter(|rest| DeTable::parse(rest).is_ok());
            match rest {
                Some(rest) if removed.len() < PROBLEMS_MAX && read < READ_MAX => text = rest,
                rest => {
                    problems.extend(rest.map(|_| Problem { line: None, text: UNFINISHED.into() }));
                    return checked(problems, None, refused_tables);
                }
            }
        }
    }
}

impl Scenario {
    /// Checks the text of a file together with overrides of the form `table.key=value`. A key that an
    /// override replaces is no problem of the file.
    pub fn check_all_with<S: AsRef<str>>(text: &str, overrides: &[S]) -> Checked {
        let error = match Self::from_toml_with(text, overrides) {
            _ if overrides.is_empty() => return Self::check_all(text),
            Ok(scenario) => return checked(Vec::new(), Some(scenario), Vec::new()),
            Err(error) => error,
        };
        let replaced = |text: String, set: &S| {
            let set = set.as_ref();
            let name = set.split_once('=').map_or(set, |(key, _)| key).trim();
            let rest = by_name(&text, name).map(|entry| without(&text, entry));
            rest.filter(|rest| DeTable::parse(rest).is_ok()).unwrap_or(text)
        };
        let of_file = Self::check_all(&overrides.iter().fold(text.to_owned(), replaced));
        if !of_file.problems.is_empty() {
            return of_file;
        }
        let problem = Problem { line: None, text: error.to_string() };
        checked(vec![problem], of_file.scenario, of_file.refused_tables)
    }
}

/// The key of a list in the key of a problem, as "users.mixture" in "users.mixture (entries)".
fn list_of(key: &str) -> &str {
    key.split(' ').next().unwrap_or(key)
}

/// Whether the problem is that of a complete list. It follows from the removal of an entry, too.
fn is_of_list(key: &str) -> bool {
    key.ends_with(" (entries)") || key.contains(" (sum of ")
}

fn checked(mut problems: Vec<Problem>, scenario: Option<Scenario>, refused_tables: Vec<String>) -> Checked {
    problems.sort_by_key(|problem| problem.line.unwrap_or(usize::MAX));
    // A problem in one of several tables remains until its own table is removed.
    problems.dedup();
    Checked { problems, scenario, refused_tables }
}

/// The problem that an error describes, and where the text sets the key.
fn examined(text: &str, error: &ScenarioError) -> (Problem, Option<Range<usize>>) {
    match error {
        ScenarioError::Invalid { key: name, line, .. } | ScenarioError::Renamed { found: name, line, .. } => {
            (Problem { line: *line, text: error.to_string() }, by_name(text, name))
        }
        ScenarioError::Parse { reason, .. } => (
            Problem { line: reason.line(), text: reason.to_string() },
            reason.place().and_then(|place| at(text, place)),
        ),
        _ => (Problem { line: None, text: error.to_string() }, None),
    }
}

/// The innermost entry around a place.
fn at(text: &str, place: usize) -> Option<Range<usize>> {
    let document = DeTable::parse(text).ok()?;
    entry_at(document.get_ref(), place).map(|(_, entry)| entry)
}

/// The entry of `table.key`; text after a space is ignored.
fn by_name(text: &str, name: &str) -> Option<Range<usize>> {
    let document = DeTable::parse(text).ok()?;
    let mut table = document.get_ref();
    let mut keys = name.split(' ').next()?.split('.').peekable();
    loop {
        let (key, value) = table.get_key_value(keys.next()?)?;
        let mut selected = value.get_ref();
        // A number selects one of several tables.
        if let DeValue::Array(tables) = selected
            && let Some(index) = keys.next_if(|key| key.parse::<usize>().is_ok())
        {
            selected = tables.get(index.parse::<usize>().ok()?)?.get_ref();
        }
        match selected {
            DeValue::Table(inner) if keys.peek().is_some() => table = inner,
            _ => return Some(key.span().start..value.span().end.max(key.span().end)),
        }
    }
}

/// The top-level table of a place in the text.
fn table_of(text: &str, place: usize) -> Option<String> {
    let document = DeTable::parse(text).ok()?;
    let holds = |value: &DeValue<'_>| matches!(value, DeValue::Table(inner) if entry_at(inner, place).is_some());
    document.get_ref().iter().find(|(_, value)| holds(value.get_ref())).map(|(key, _)| key.get_ref().to_string())
}

/// The text without an entry; the numbers of the lines stay.
fn without(text: &str, entry: Range<usize>) -> String {
    let line_start = text[..entry.start].rfind('\n').map_or(0, |end| end + 1);
    let is_header = text[line_start..entry.start].trim_start().starts_with('[');
    let range = if is_header {
        // A table that is refused: to the next header.
        let next = text[entry.start..].find("\n[").map_or(text.len(), |end| entry.start + end);
        line_start..next
    } else {
        entry
    };
    let blank: String = text[range.clone()].chars().filter(|letter| *letter == '\n').collect();
    [&text[..range.start], &blank, &text[range.end..]].concat()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::builtin::BUILTIN_NAMES;

    fn problems(text: &str) -> Vec<String> {
        Scenario::check_all(text).problems.iter().map(ToString::to_string).collect()
    }

    #[test]
    fn a_line_that_is_no_toml_is_quoted_with_what_an_editor_hides() {
        for (text, expected) in [
            ("[room]\nlength_x_m = 5,0\n", "line 2: `length_x_m = 5,0`: "),
            ("{\"users\": 3}\n", "line 1: `{\"users\": 3}`: "),
            ("name = \u{201c}Büro\u{201d}\n", "line 1: `name = \\u{201c}Büro\\u{201d}`: "),
            ("[users]\n\tcount\u{a0}= 3\n", "line 2: `count\\u{a0}= 3`: "),
            ("seed = 1\nseed = 2\n", "line 2: `seed = 2`: duplicate key"),
        ] {
            let found = problems(text);
            let ends = "; expected TOML, for example `key = 1`";
            assert!(found[0].starts_with(expected) && found[0].ends_with(ends), "{expected}: {found:?}");
        }
    }

    #[test]
    fn a_name_is_one_line() {
        let found = problems("name = \"a\\nb\"\n");
        assert_eq!(found, ["line 1: name = a\\nb: expected 1 to 64 characters in one line"]);
    }

    #[test]
    fn every_problem_is_listed_with_its_line() {
        let text = "[mirrors]\nreflectivity = 2\nrwos = 3\n\n[users]\ncount = 99 # many\nspeed_max_m_s = \"fast\"\n\n\
                    [light]\npower = 1\n\n[control]\nvalidity_ms = 0\n";
        let found = problems(text);
        assert_eq!(found.len(), 6, "{found:#?}");
        // In the order of the lines, and all in the same style.
        let expected = [
            "line 2: mirrors.reflectivity = 2: expected",
            "line 3: mirrors.rwos: unknown field `rwos`, expected",
            "line 6: users.count = 99: expected",
            "line 7: users.speed_max_m_s: invalid type: string \"fast\", expected",
            "line 9: light",
            "line 13: control.validity_ms = 0: expected",
        ];
        for (found, expected) in found.iter().zip(expected) {
            assert!(found.starts_with(expected) && !found.contains('\n'), "{expected}: {found}");
        }
        let checked = Scenario::check_all(text);
        assert!(checked.scenario.is_some());
        let users = checked.refused_tables.iter().filter(|table| *table == "users").count();
        assert_eq!(users, 2, "{:?}", checked.refused_tables);
    }

    #[test]
    fn a_list_without_its_refused_entries_is_no_problem() {
        let mixture = |shares: [f64; 2]| {
            let of = |share| format!("[[users.mixture]]\nmobility = \"random-waypoint\"\nshare = {share}\n");
            problems(&format!("[users]\nmobility = \"mixture\"\n{}", shares.map(of).concat()))
        };
        assert_eq!(mixture([0.4, 0.6]), [""; 0]);
        let sum = mixture([0.9, 0.3]);
        assert!(sum.len() == 1 && sum[0].contains("(sum of the shares) = 1.2"), "{sum:#?}");
        let each = mixture([2.0, 3.0]);
        assert!(each.len() == 2 && each.iter().all(|text| text.contains("(share) = ")), "{each:#?}");
    }

    #[test]
    fn the_check_ends_for_text_that_cannot_be_repaired() {
        for text in
            ["[users\ncount = 3\n", "users = { count = 99 }\n", "name = \"\"\nled = 3\n[mirrors]\nrows = 1000\n"]
        {
            assert!(!problems(text).is_empty(), "{text}");
        }
        assert!(problems("[users]\ncount = 3\n").is_empty());
    }

    #[test]
    fn the_passes_over_a_long_text_are_bounded_and_a_built_in_scenario_has_all_of_them() {
        let keys: String = (0..20_000).map(|number| format!("k{number} = 1\n")).collect();
        let found = problems(&format!("[room]\n{keys}"));
        let passes = found.len() - 1;
        assert!(passes > 0 && passes <= READ_MAX.div_ceil(keys.len()), "{passes} passes over {} bytes", keys.len());
        assert_eq!(found.last().map(String::as_str), Some(UNFINISHED));
        for name in BUILTIN_NAMES {
            let length = Scenario::builtin_text(name).expect("built in").len();
            assert!(length * PROBLEMS_MAX <= READ_MAX, "{name} has {length} bytes");
        }
    }

    #[test]
    fn an_override_repairs_or_breaks_a_file() {
        let texts = |text: &str, overrides: &[&str]| {
            let problems = Scenario::check_all_with(text, overrides).problems;
            problems.iter().map(ToString::to_string).collect::<Vec<_>>()
        };
        let (sound, broken) = ("[users]\ncount = 3\n", "[users]\ncount = 99\n[room]\nheight_m = -1\n");
        assert!(texts(sound, &["users.count=5"]).is_empty());
        let of_override = texts(sound, &["users.count=99"]);
        assert!(of_override.len() == 1 && of_override[0].starts_with("users.count = 99"), "{of_override:?}");
        let of_file = texts(broken, &["users.count=5"]);
        assert!(of_file.len() == 1 && of_file[0].starts_with("line 4: room.height_m"), "{of_file:?}");
        assert!(texts(broken, &["users.count=5", "room.height_m=3"]).is_empty());
        let malformed = texts(sound, &["users.count"]);
        assert!(malformed.len() == 1 && malformed[0].contains("users.count"), "{malformed:?}");
        for (refused, reason) in [
            ("streams.channel.leds=all", "expected one of `none`, `serving`, `gains`"),
            ("mismatch.unknown_leds_m=[[0,0]]", "invalid length 2, expected numbers in a list of length 3"),
            ("led.positions_m=[9,0,2]", "expected numbers in a list of length 3"),
            ("receiver.branches=[1]", "expected a table"),
            ("users.count=many", "expected an integer from 1 to 64"),
            ("seed=18446744073709551615", "expected a whole number from 0 to 9223372036854775807"),
        ] {
            let problems = texts(sound, &[refused]);
            assert!(problems.len() == 1 && problems[0].contains(reason), "{refused}: {problems:?}");
        }
    }
}
