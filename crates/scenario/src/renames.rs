//! Renamed keys and values of scenario files: one table for refusals and for recordings.
//!
//! A scenario file with an old name is refused, and the message states the new name. A recording
//! contains the effective scenario of its time, so its reader replaces old names by new ones.
//!
//! To rename a key, change the field and add an entry to [`RENAMES`].

use crate::error::ScenarioError;

/// One renamed key or value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rename {
    /// A key or a table, as a path such as `table.key`. A path does not enter arrays.
    Key {
        /// The old path.
        old: &'static str,
        /// The new path.
        new: &'static str,
    },
    /// A string value of a key.
    Value {
        /// The path of the key, by its new name.
        key: &'static str,
        /// The old value.
        old: &'static str,
        /// The new value.
        new: &'static str,
    },
}

/// All renamed keys and values of scenario files.
pub const RENAMES: &[Rename] = &[
    Rename::Key { old: "control.prediction", new: "control.belief" },
    Rename::Key { old: "users.smooth_turn", new: "users.smooth_random" },
    Rename::Key { old: "users.random_direction.leg_mean_s", new: "users.random_direction.travel_time_mean_s" },
    Rename::Value { key: "users.mobility", old: "smooth-turn", new: "smooth-random" },
];

/// Values that were removed, each with the value that replaces it in a recording. A scenario file
/// with one is refused by the check of the key.
pub(crate) const REMOVED: &[Rename] = &[
    Rename::Value { key: "control.when_unanswered", old: "last-good", new: "hold" },
    Rename::Value { key: "control.when_unanswered", old: "park", new: "hold" },
];

/// A table of renames, applied to the parsed text of a scenario.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Renames<'a>(pub &'a [Rename]);

impl Renames<'_> {
    /// Refuses a table that contains an old key or an old value.
    ///
    /// # Errors
    /// [`ScenarioError::Renamed`] for the first old name, without its line.
    pub fn refuse(self, table: &toml::Table) -> Result<(), ScenarioError> {
        let refused = |found: String, expected: String| Err(ScenarioError::Renamed { found, expected, line: None });
        for rename in self.0 {
            match *rename {
                Rename::Key { old, new } if get(table, old).is_some() => {
                    return refused(old.into(), new.into());
                }
                Rename::Value { key, old, new } if has_value(table, key, old) => {
                    return refused(format!("{key} = \"{old}\""), format!("{key} = \"{new}\""));
                }
                _ => {}
            }
        }
        Ok(())
    }

    /// Replaces old keys, then old values. A new key that is present keeps its value.
    pub fn apply(self, table: &mut toml::Table) {
        for rename in self.0 {
            if let Rename::Key { old, new } = *rename
                && let Some(value) = take(table, old)
            {
                insert(table, new, value);
            }
        }
        for rename in self.0 {
            if let Rename::Value { key, old, new } = *rename
                && has_value(table, key, old)
            {
                take(table, key);
                insert(table, key, new.into());
            }
        }
    }
}

fn has_value(table: &toml::Table, key: &str, value: &str) -> bool {
    get(table, key).and_then(toml::Value::as_str) == Some(value)
}

fn get<'a>(table: &'a toml::Table, path: &str) -> Option<&'a toml::Value> {
    match path.split_once('.') {
        Some((first, rest)) => get(table.get(first)?.as_table()?, rest),
        None => table.get(path),
    }
}

/// Removes a value, and the tables of its path that become empty.
fn take(table: &mut toml::Table, path: &str) -> Option<toml::Value> {
    let Some((first, rest)) = path.split_once('.') else {
        return table.remove(path);
    };
    let inner = table.get_mut(first)?.as_table_mut()?;
    let value = take(inner, rest);
    if value.is_some() && inner.is_empty() {
        table.remove(first);
    }
    value
}

/// Inserts a value, unless the key is present or a part of the path is not a table.
fn insert(table: &mut toml::Table, path: &str, value: toml::Value) {
    match path.split_once('.') {
        Some((first, rest)) => {
            let entry = table.entry(first).or_insert_with(|| toml::Value::Table(toml::Table::new()));
            if let Some(inner) = entry.as_table_mut() {
                insert(inner, rest, value);
            }
        }
        None => {
            table.entry(path).or_insert(value);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TABLE: Renames<'static> = Renames(&[
        Rename::Key { old: "control.when_mute", new: "control.when_silent" },
        Rename::Key { old: "people.count", new: "users.count" },
        Rename::Value { key: "control.when_silent", old: "freeze", new: "hold" },
    ]);

    fn table(text: &str) -> toml::Table {
        toml::from_str(text).expect("TOML")
    }

    fn refusal(text: &str) -> String {
        TABLE.refuse(&table(text)).expect_err("an old name").to_string()
    }

    #[test]
    fn an_old_key_is_refused_and_the_message_states_the_new_key() {
        assert_eq!(
            refusal("[control]\nwhen_mute = \"park\"\n"),
            "control.when_mute was renamed: expected control.when_silent"
        );
        assert_eq!(refusal("people.count = 3"), "people.count was renamed: expected users.count");
    }

    #[test]
    fn an_old_value_is_refused_and_the_message_states_the_new_value() {
        assert_eq!(
            refusal("[control]\nwhen_silent = \"freeze\"\n"),
            "control.when_silent = \"freeze\" was renamed: expected control.when_silent = \"hold\""
        );
    }

    #[test]
    fn new_names_are_accepted() {
        let text = "name = \"freeze\"\n[control]\nwhen_silent = \"hold\"\n[users]\ncount = 3\n";
        assert_eq!(TABLE.refuse(&table(text)), Ok(()));
        let mut unchanged = table(text);
        TABLE.apply(&mut unchanged);
        assert_eq!(unchanged, table(text));
    }

    #[test]
    fn old_names_of_a_recording_become_new_ones() {
        let mut found = table("[people]\ncount = 3\n[control]\nwhen_mute = \"freeze\"\nx = 1\n");
        TABLE.apply(&mut found);
        let expected = table("[users]\ncount = 3\n[control]\nwhen_silent = \"hold\"\nx = 1\n");
        assert_eq!(found, expected);
    }

    #[test]
    fn a_new_key_has_priority_over_an_old_one() {
        let mut found = table("[control]\nwhen_mute = \"park\"\nwhen_silent = \"hold\"\n");
        TABLE.apply(&mut found);
        assert_eq!(found, table("[control]\nwhen_silent = \"hold\"\n"));
    }
}
