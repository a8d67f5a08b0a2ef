//! Text from a message or a file, made safe for a terminal.
//!
//! A terminal executes escape sequences. They clear the screen, set its title, or show other text
//! than the one that was sent. Everything that this crate prints or logs passes [`printable`] or
//! [`printable_lines`]. Both write a control character as its JSON escape, so that JSON stays valid.

use std::borrow::Cow;
use std::fmt::Write;

/// A text on one line: control characters, line ends and changes of the writing direction are
/// escaped.
///
/// ```
/// use heliostat_service::printable::printable;
///
/// assert_eq!(printable("lab\u{1b}[2J\nstopped"), "lab\\u001b[2J\\u000astopped");
/// assert_eq!(printable("Wände"), "Wände");
/// ```
pub fn printable(text: &str) -> Cow<'_, str> {
    escaped(text, is_unsafe)
}

/// A text of several lines: as [`printable`], but line ends stay.
pub fn printable_lines(text: &str) -> Cow<'_, str> {
    escaped(text, |character| character != '\n' && is_unsafe(character))
}

/// Control characters of ASCII and ISO 8859-1, line separators, and marks that reverse text.
fn is_unsafe(character: char) -> bool {
    character.is_control()
        || matches!(character, '\u{61c}' | '\u{200e}' | '\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}')
}

fn escaped(text: &str, is_unsafe: impl Fn(char) -> bool) -> Cow<'_, str> {
    if !text.contains(&is_unsafe) {
        return Cow::Borrowed(text);
    }
    let mut out = String::with_capacity(text.len() + 16);
    for character in text.chars() {
        if is_unsafe(character) {
            write!(out, "\\u{:04x}", u32::from(character)).expect("writing to a string cannot fail");
        } else {
            out.push(character);
        }
    }
    Cow::Owned(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_control_character_and_no_change_of_direction_passes() {
        for code in 0..=0x2100 {
            let Some(character) = char::from_u32(code) else { continue };
            let text = format!("a{character}b");
            let passed = printable(&text) == text;
            let invisible = character.is_control() || (0x2028..=0x202e).contains(&code);
            assert!(!(passed && invisible), "{code:x}");
            assert!(passed || printable(&text) == format!("a\\u{code:04x}b"), "{code:x}");
        }
        assert_eq!(printable_lines("a\n\tb\r\n"), "a\n\\u0009b\\u000d\n");
    }
}
