//! The command line as arguments of a command, with advice where a scenario is given without its flag, or a
//! flag by the name that other programs use.

use std::ffi::OsString;

use clap::builder::StyledStr;
use clap::error::{ContextKind, ContextValue, ErrorKind};
use clap::{Command, Parser};
use heliostat_scenario::BUILTIN_NAMES;

/// Flags of other programs, and those that a command may have for the same purpose.
static USUAL: [(&[&str], &[&str]); 5] = [
    (&["--port", "-p"], &["ui-port", "listen", "connect"]),
    (&["--host", "--bind", "--address", "--url", "--endpoint"], &["ui-listen", "listen", "connect"]),
    (&["--duration", "--time"], &["seconds"]),
    (&["--output", "--file", "-o"], &["out"]),
    (&["--no-browser", "--headless"], &["no-ui"]),
];

/// The arguments of a program; it ends where they cannot be used.
pub fn parsed<C: Parser>() -> C {
    C::try_parse().unwrap_or_else(|error| {
        let program = C::command();
        let command = chosen(&program, std::env::args_os());
        with_flag_advice(with_scenario_advice(error, command), command).exit()
    })
}

/// The command of a program that the words of a command line choose.
fn chosen(program: &Command, words: impl IntoIterator<Item = OsString>) -> &Command {
    words.into_iter().skip(1).fold(program, |command, word| command.find_subcommand(word).unwrap_or(command))
}

/// The same error; where a flag has another name here, with the flags of the command for that purpose.
fn with_flag_advice(mut error: clap::Error, command: &Command) -> clap::Error {
    let unknown = match error.get(ContextKind::InvalidArg) {
        Some(ContextValue::String(word)) if error.kind() == ErrorKind::UnknownArgument => word.as_str(),
        _ => return error,
    };
    let Some((_, flags)) = USUAL.iter().find(|(names, _)| names.contains(&unknown)) else { return error };
    let advice = |flag: &&str| {
        let argument = command.get_arguments().find(|argument| argument.get_long() == Some(*flag))?;
        let help = argument.get_help().map(ToString::to_string).unwrap_or_default();
        let purpose = help.split([';', '(']).next().unwrap_or_default().trim_end();
        Some(StyledStr::from(format!("'--{flag}': {purpose}")))
    };
    let advice: Vec<StyledStr> = flags.iter().filter_map(advice).collect();
    if !advice.is_empty() {
        error.remove(ContextKind::SuggestedArg);
        error.insert(ContextKind::Suggested, ContextValue::StyledStrs(advice));
    }
    error
}

/// The same error; where a name or a file of a scenario is not expected, with the flag of the command that takes it.
fn with_scenario_advice(mut error: clap::Error, command: &Command) -> clap::Error {
    // A command that has commands of its own takes the word for one of them.
    let refused = [ContextKind::InvalidArg, ContextKind::InvalidSubcommand];
    let is_scenario = |word: &&String| BUILTIN_NAMES.contains(&word.as_str()) || word.ends_with(".toml");
    let word = refused.into_iter().find_map(|kind| match error.get(kind) {
        Some(ContextValue::String(word)) => Some(word).filter(is_scenario).cloned(),
        _ => None,
    });
    if let Some(word) = word
        && command.get_arguments().any(|argument| argument.get_long() == Some("scenario"))
    {
        let advice = StyledStr::from(format!("a scenario is given as '--scenario {word}'"));
        error.insert(ContextKind::Suggested, ContextValue::StyledStrs(vec![advice]));
    }
    error
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    use super::*;

    #[test]
    fn a_flag_of_another_name_is_refused_with_those_of_the_command_for_its_purpose() {
        let refused = |words: &[&str]| {
            let program = crate::cli::Cli::command();
            let error = crate::cli::Cli::try_parse_from(words).expect_err("it is refused");
            with_flag_advice(error, chosen(&program, words.iter().map(OsString::from))).to_string()
        };
        let page = refused(&["heliostat", "ui", "--port", "8080"]);
        for flag in ["tip: '--ui-port': Port of the page\n", "tip: '--listen': Endpoint at which to listen\n"] {
            assert!(page.contains(flag), "{page}");
        }
        // The most similar name has another purpose.
        let recorder = refused(&["heliostat", "record", "--out", "a.mcap", "--port", "7447"]);
        assert!(recorder.contains("'--listen'") && !recorder.contains("'--out'"), "{recorder}");
        let stop = refused(&["heliostat", "driver", "check", "--port", "7447"]);
        assert!(stop.contains("'--connect'") && !stop.contains("'--ui-port'"), "{stop}");
        let other = refused(&["heliostat", "ui", "--xyz"]);
        assert!(!other.contains("tip:"), "{other}");
    }

    #[test]
    fn a_scenario_without_its_flag_is_refused_with_the_flag() {
        let refused = |words: &[&str]| {
            let program = crate::cli::Cli::command();
            let error = crate::cli::Cli::try_parse_from(words).expect_err("it is refused");
            with_scenario_advice(error, chosen(&program, words.iter().map(OsString::from))).to_string()
        };
        for scenario in ["hall", "my/room.toml"] {
            let tip = format!("tip: a scenario is given as '--scenario {scenario}'");
            for before in [vec!["demo"], vec!["calibrate"], vec!["calibrate", "--out", "wall.toml"]] {
                let words: Vec<&str> = ["heliostat"].into_iter().chain(before).chain([scenario]).collect();
                let text = refused(&words);
                assert!(text.contains(&tip), "{text}");
            }
        }
        let other = refused(&["heliostat", "demo", "kitchen"]);
        assert!(other.contains("unexpected argument 'kitchen'") && !other.contains("--scenario"), "{other}");
        let without_flag = refused(&["heliostat", "status", "hall"]);
        assert!(!without_flag.contains("--scenario"), "{without_flag}");
    }
}
