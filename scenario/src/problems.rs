//! All problems of a scenario file at once, for a check before a run.
//!
//! After each problem the check removes the refused key from the text, so that its default applies,
//! and continues.

use std::ops::Range;

use toml::de::{DeTable, DeValue};

use crate::error::ScenarioError;
use crate::scenario::Scenario;

/// Largest number of problems that are listed.
const PROBLEMS_MAX: usize = 50;

/// The result of a check.
#[derive(Clone, Debug)]
pub struct Checked {
    /// What cannot be used, in the order in which it was found.
    pub problems: Vec<ScenarioError>,
    /// The scenario, with defaults in place of the refused keys; `None` where the rest of the text
    /// cannot be read.
    pub scenario: Option<Scenario>,
}

impl Scenario {
    /// Checks the text of a file, and continues after each problem.
    pub fn check_all(text: &str) -> Checked {
        let mut text = text.to_owned();
        let mut problems = Vec::new();
        loop {
            let problem = match Self::from_toml(&text) {
                Ok(scenario) => return Checked { problems, scenario: Some(scenario) },
                Err(problem) => problem,
            };
            let refused = entry_of(&text, &problem);
            problems.push(problem);
            let rest = refused.map(|entry| without(&text, entry)).filter(|rest| DeTable::parse(rest).is_ok());
            match rest {
                Some(rest) if problems.len() < PROBLEMS_MAX => text = rest,
                _ => return Checked { problems, scenario: None },
            }
        }
    }
}

/// Where the text sets the key that a problem names.
fn entry_of(text: &str, problem: &ScenarioError) -> Option<Range<usize>> {
    match problem {
        ScenarioError::Invalid { key, .. } => by_name(text, key),
        ScenarioError::Renamed { found, .. } => by_name(text, found),
        ScenarioError::Parse { .. } => {
            let place = toml::from_str::<Scenario>(text).err()?.span()?.start;
            let document = DeTable::parse(text).ok()?;
            by_place(document.get_ref(), place)
        }
        _ => None,
    }
}

/// The entry of `table.key`; text after a space is ignored.
fn by_name(text: &str, name: &str) -> Option<Range<usize>> {
    let document = DeTable::parse(text).ok()?;
    let mut table = document.get_ref();
    let mut keys = name.split(' ').next()?.split('.').peekable();
    loop {
        let (key, value) = table.get_key_value(keys.next()?)?;
        match value.get_ref() {
            DeValue::Table(inner) if keys.peek().is_some() => table = inner,
            _ => return Some(key.span().start..value.span().end.max(key.span().end)),
        }
    }
}

/// The innermost entry of a table around a place in the text.
fn by_place(table: &DeTable<'_>, place: usize) -> Option<Range<usize>> {
    table.iter().find_map(|(key, value)| {
        if let DeValue::Table(inner) = value.get_ref()
            && let Some(found) = by_place(inner, place)
        {
            return Some(found);
        }
        let entry = key.span().start..value.span().end.max(key.span().end);
        entry.contains(&place).then_some(entry)
    })
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

    fn problems(text: &str) -> Vec<String> {
        Scenario::check_all(text).problems.iter().map(ToString::to_string).collect()
    }

    #[test]
    fn every_problem_is_listed_with_its_line() {
        let text = "[mirrors]\nreflectivity = 2\nrwos = 3\n\n[users]\ncount = 99 # many\nspeed_max_m_s = \"fast\"\n\n\
                    [light]\npower = 1\n\n[control]\nvalidity_ms = 0\n";
        let found = problems(text);
        assert_eq!(found.len(), 6, "{found:#?}");
        for expected in [
            "line 2: mirrors.reflectivity",
            "rwos",
            "line 6: users.count",
            "speed_max_m_s",
            "light",
            "line 13: control.validity_ms",
        ] {
            assert_eq!(found.iter().filter(|text| text.contains(expected)).count(), 1, "{expected}: {found:#?}");
        }
        assert!(Scenario::check_all(text).scenario.is_some());
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
}
