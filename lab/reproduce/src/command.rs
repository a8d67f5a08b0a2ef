//! The command line that reproduces a figure. Local paths (`--out`, `--write-docs`) and output
//! options are omitted.

pub use heliostat_learn::train::quoted;

use crate::plan::Room;

/// The command that reproduces one figure in one room.
pub fn of_figure(id: &str, room: &Room) -> String {
    begun(id) + &room.flags
}

/// The command up to its flags.
pub(crate) fn begun(what: &str) -> String {
    format!("heliostat-lab reproduce {what} --out DIR")
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
