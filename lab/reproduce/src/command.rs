//! The command line that reproduces a figure. Local paths (`--out`, `--write-docs`) and output
//! options are omitted.

use crate::plan::Room;

/// The command that reproduces one figure in one room.
pub fn of_figure(id: &str, room: &Room) -> String {
    begun(id) + &room.flags
}

/// The command up to its flags.
pub(crate) fn begun(what: &str) -> String {
    format!("heliostat-lab reproduce {what} --out DIR")
}

/// A word quoted for a shell. A pair of braces without content is literal in every shell.
pub fn quoted(word: &str) -> String {
    let plain = |letter: char| letter.is_alphanumeric() || "-_./,=:+".contains(letter);
    if !word.is_empty() && word.replace("{}", "").chars().all(plain) {
        word.into()
    } else {
        format!("'{}'", word.replace('\'', r"'\''"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_are_quoted_for_a_shell() {
        let words = ["users.count=3", "a b=[1]", "it's", "users.orientation={}", "{a,b}"];
        let expected = ["users.count=3", "'a b=[1]'", r"'it'\''s'", "users.orientation={}", "'{a,b}'"];
        assert_eq!(words.map(quoted), expected);
    }
}
