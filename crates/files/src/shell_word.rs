//! Words of commands that a message prints for a shell.

/// A word as a shell reads it: in quotation marks where it holds a space or another letter with a meaning. A pair of
/// braces without content is literal in every shell.
///
/// ```
/// use heliostat_files::shell_word;
///
/// assert_eq!(shell_word("rooms/hall.toml"), "rooms/hall.toml");
/// assert_eq!(shell_word("my room.toml"), "'my room.toml'");
/// ```
pub fn shell_word(word: &str) -> String {
    let is_plain = |letter: char| letter.is_alphanumeric() || "-_./=,:+@%".contains(letter);
    if !word.is_empty() && word.replace("{}", "").chars().all(is_plain) {
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
        let words = ["users.count=3", "a b=[1]", "it's", "users.orientation={}", "{a,b}", ""];
        let expected = ["users.count=3", "'a b=[1]'", r"'it'\''s'", "users.orientation={}", "'{a,b}'", "''"];
        assert_eq!(words.map(shell_word), expected);
    }
}
