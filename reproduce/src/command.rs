//! The command line that makes a report, or one of its figures, again.
//!
//! What says where on this machine (`--out`, `--write-docs`) and how to print it is left out: a command is for whoever reads the report.

use crate::plan::Room;

/// The command that makes one figure in one room, and computes what is missing of it.
pub fn of_figure(id: &str, room: &Room) -> String {
    begun(id) + &room.flags
}

/// The command up to its flags.
pub(crate) fn begun(what: &str) -> String {
    format!("heliostat reproduce {what} --out DIR")
}

/// A word as a shell takes it back unchanged.
pub(crate) fn quoted(word: &str) -> String {
    let plain = |letter: char| letter.is_alphanumeric() || "-_./,=:+".contains(letter);
    if !word.is_empty() && word.chars().all(plain) { word.into() } else { format!("'{}'", word.replace('\'', r"'\''")) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_shell_takes_words_back_unchanged() {
        assert_eq!(["users.count=3", "a b=[1]", "it's"].map(quoted), ["users.count=3", "'a b=[1]'", r"'it'\''s'"]);
    }
}
