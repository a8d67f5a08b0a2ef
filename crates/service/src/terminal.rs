//! What a terminal takes: escape sequences, and colours among them.

use std::env::var_os;
use std::ffi::OsStr;
use std::io::IsTerminal;

/// Whether a stream is a terminal that takes escape sequences; one whose variable TERM is `dumb` takes none.
pub fn takes_escapes(stream: &impl IsTerminal) -> bool {
    stream.is_terminal() && is_capable(var_os("TERM").as_deref())
}

/// Whether a stream shows colours: it takes escape sequences, and the variable NO_COLOR is absent or empty.
pub fn shows_colours(stream: &impl IsTerminal) -> bool {
    takes_escapes(stream) && is_coloured(var_os("NO_COLOR").as_deref())
}

fn is_capable(term: Option<&OsStr>) -> bool {
    term.is_none_or(|term| term != "dumb")
}

fn is_coloured(no_color: Option<&OsStr>) -> bool {
    no_color.is_none_or(OsStr::is_empty)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_dumb_terminal_takes_no_escapes_and_no_color_refuses_colours() {
        let of = |text: &'static str| Some(OsStr::new(text));
        assert!(is_capable(None) && is_capable(of("xterm-256color")) && !is_capable(of("dumb")));
        assert!(is_coloured(None) && is_coloured(of("")) && !is_coloured(of("1")));
    }
}
