//! The command line as arguments of a command, with advice where a scenario is given without its flag.

use clap::Parser;
use clap::builder::StyledStr;
use clap::error::{ContextKind, ContextValue, ErrorKind};
use heliostat_scenario::BUILTIN_NAMES;

/// The arguments of a program; it ends where they cannot be used.
pub fn parsed<C: Parser>() -> C {
    C::try_parse().unwrap_or_else(|error| with_scenario_advice(error).exit())
}

/// The same error; where a name or a file of a scenario is not expected, with the flag that takes it.
fn with_scenario_advice(mut error: clap::Error) -> clap::Error {
    if error.kind() == ErrorKind::UnknownArgument
        && let Some(ContextValue::String(word)) = error.get(ContextKind::InvalidArg)
        && (BUILTIN_NAMES.contains(&word.as_str()) || word.ends_with(".toml"))
    {
        let advice = StyledStr::from(format!("a scenario is given as '--scenario {word}'"));
        error.insert(ContextKind::Suggested, ContextValue::StyledStrs(vec![advice]));
    }
    error
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scenario_without_its_flag_is_refused_with_the_flag() {
        let refused = |words: &[&str]| {
            let error = crate::cli::Cli::try_parse_from(words).expect_err("it is refused");
            with_scenario_advice(error).to_string()
        };
        for scenario in ["hall", "my/room.toml"] {
            let text = refused(&["heliostat", "demo", scenario]);
            assert!(text.contains(&format!("tip: a scenario is given as '--scenario {scenario}'")), "{text}");
        }
        let other = refused(&["heliostat", "demo", "kitchen"]);
        assert!(other.contains("unexpected argument 'kitchen'") && !other.contains("--scenario"), "{other}");
    }
}
