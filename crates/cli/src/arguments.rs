//! The command line as arguments of a command, with advice where a scenario or a file is given without its flag, or a
//! flag by the name that other programs use, and with the numbers that a flag takes where it refuses one.
//!
//! A command with `--json` that fails, is refused or is interrupted also prints `{"error": "…"}`, where it has printed
//! no object.

mod numbers;

use std::ffi::OsString;
use std::process::ExitCode;

use clap::builder::StyledStr;
use clap::error::{ContextKind, ContextValue, ErrorKind};
use clap::{Command, CommandFactory, Parser};
use heliostat_scenario::BUILTIN_NAMES;
use heliostat_service::process::allow_files;
use heliostat_service::{exit, outln, output};

/// Flags of other programs, and those that a command may have for the same purpose.
static USUAL: [(&[&str], &[&str]); 5] = [
    (&["--port", "-p"], &["ui-port", "listen", "connect"]),
    (&["--host", "--bind", "--address", "--url", "--endpoint"], &["ui-listen", "listen", "connect"]),
    (&["--duration", "--time"], &["seconds"]),
    (&["--output", "--file", "-o"], &["out"]),
    (&["--no-browser", "--headless"], &["no-ui"]),
];

/// Runs a program whose commands are those of `C`, prints its error, and gives its exit code.
pub fn run<C: CommandFactory>(program: &str, command: impl FnOnce() -> anyhow::Result<()>) -> ExitCode {
    output::also_report_error(print_object::<C>);
    exit::run(program, command)
}

/// The arguments of a program, with enough open files for its command; it ends where they cannot be used, and where they
/// ask for help.
///
/// # Errors
/// The help text cannot be written, or too few open files are allowed.
pub fn parsed<C: Parser>() -> anyhow::Result<C> {
    let arguments: anyhow::Result<C> = C::try_parse().or_else(|error| {
        let program = C::command();
        let command = chosen(&program, std::env::args_os());
        let error = with_flag_advice(with_file_advice(error, command), command);
        let error = numbers::with_expected_numbers(error, command);
        if error.use_stderr() {
            // There is nowhere else to report that standard error is closed.
            drop(error.print());
            print_object::<C>(&reason(&error));
        } else {
            output::flushed(error.print())?;
        }
        std::process::exit(error.exit_code())
    });
    arguments.and_then(|arguments| allow_files().map(|()| arguments))
}

/// Prints an error as an object, where the command line asks for JSON and no object is the last output.
fn print_object<C: CommandFactory>(error: &str) {
    let program = C::command();
    if asks_for_json(chosen(&program, std::env::args_os()), std::env::args_os()) && !output::ends_with_object() {
        // The error itself is on standard error.
        drop(outln!("{}", serde_json::json!({ "error": error })));
    }
}

/// Whether the words of a command line ask its command for JSON.
fn asks_for_json(command: &Command, words: impl IntoIterator<Item = OsString>) -> bool {
    let has_flag = command.get_arguments().any(|argument| argument.get_long() == Some("json"));
    has_flag && words.into_iter().take_while(|word| *word != "--").any(|word| word == "--json")
}

/// The refusal of a command line in one line, without its usage and the note on help.
fn reason(error: &clap::Error) -> String {
    let text = error.render().to_string();
    let ends = ["\n\nUsage:", "\n\nFor more information"].into_iter().filter_map(|part| text.find(part));
    let text = &text[..ends.min().unwrap_or(text.len())];
    let words: Vec<&str> = text.strip_prefix("error: ").unwrap_or(text).split_whitespace().collect();
    words.join(" ")
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

/// The same error; where a name or a file of a scenario, or a file of an array, is not expected, with the flag of the
/// command that takes it.
fn with_file_advice(mut error: clap::Error, command: &Command) -> clap::Error {
    // A command that has commands of its own takes the word for one of them.
    let refused = [ContextKind::InvalidArg, ContextKind::InvalidSubcommand];
    let word = refused.into_iter().find_map(|kind| match error.get(kind) {
        Some(ContextValue::String(word)) => Some(word.clone()),
        _ => None,
    });
    let Some(word) = word else { return error };
    let is_file = word.ends_with(".toml");
    let is_scenario = is_file || BUILTIN_NAMES.contains(&word.as_str());
    let takes = |flag: &str| command.get_arguments().any(|argument| argument.get_long() == Some(flag));
    let flags = [("scenario", "a scenario", is_scenario), ("config", "the file of an array", is_file)];
    if let Some((flag, named, _)) = flags.into_iter().find(|(flag, _, is_given)| *is_given && takes(flag)) {
        let advice = StyledStr::from(format!("{named} is given as '--{flag} {word}'"));
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

    fn words(given: &[&str]) -> Vec<OsString> {
        given.iter().map(OsString::from).collect()
    }

    #[test]
    fn each_number_that_a_flag_refuses_is_answered_with_those_that_it_takes() {
        let refused = |given: &[&str]| {
            let program = crate::cli::Cli::command();
            let error = crate::cli::Cli::try_parse_from(given).expect_err("it is refused");
            numbers::with_expected_numbers(error, chosen(&program, words(given))).to_string()
        };
        let whole = "expected a whole number from";
        for (flags, expected) in [
            (
                ["sim-node", "--seed", "x"],
                "error: invalid value 'x' for '--seed <SEED>': expected a whole number from 0 to ",
            ),
            (["sim-node", "--lockstep", "0"], "'0' for '--lockstep <TICKS>': expected a whole number from 1 to "),
            (["doctor", "--port", "99999"], "'99999' for '--port <PORT>': expected a whole number from 1 to 65535"),
            (["replay", "--rate", "x"], "for '--rate <N>': "),
        ] {
            let text = refused(&[&["heliostat"], &flags[..]].concat());
            assert!(text.contains(expected) && !text.contains("invalid digit"), "{flags:?}: {text}");
            assert!(text.contains("\n\nFor more information, try '--help'.\n"), "{flags:?}: {text}");
        }
        let other = refused(&["heliostat", "demo", "--seconds", "x"]);
        assert!(other.contains("invalid duration \"x\": expected seconds") && !other.contains(whole), "{other}");
    }

    /// Flags are found by their parsers, so that a new one is among them.
    #[test]
    fn no_flag_of_a_number_answers_with_the_words_of_a_parser() {
        fn check(command: &Command, path: &str, count: &mut usize) {
            for argument in command.get_arguments().filter(|argument| argument.get_long().is_some()) {
                let alone = clap::Arg::new("alone").long("alone").value_parser(argument.get_value_parser().clone());
                let alone = Command::new("alone").no_binary_name(true).arg(alone);
                let Err(error) = alone.clone().try_get_matches_from(["--alone=x"]) else { continue };
                let text = numbers::with_expected_numbers(error, &alone).to_string();
                *count += usize::from(text.contains("expected a whole number from"));
                for words in ["invalid digit", "invalid float", "is not in "] {
                    assert!(!text.contains(words), "{path} {argument}: {text}");
                }
            }
            for command in command.get_subcommands() {
                check(command, &format!("{path} {}", command.get_name()), count);
            }
        }
        let mut count = 0;
        check(&crate::cli::Cli::command(), "heliostat", &mut count);
        assert!(count >= 10, "only {count} flags of whole numbers");
    }

    #[test]
    fn json_is_asked_for_by_the_flag_of_the_command_before_the_words_of_another_process() {
        let program = crate::cli::Cli::command();
        for (given, expected) in [
            (&["heliostat", "link", "--json"][..], true),
            (&["heliostat", "link"], false),
            (&["heliostat", "keys", "show", "--json"], true),
            (&["heliostat", "ui", "--json"], false),
            (&["heliostat", "link", "--", "--json"], false),
        ] {
            assert_eq!(asks_for_json(chosen(&program, words(given)), words(given)), expected, "{given:?}");
        }
        let refused = crate::cli::Cli::try_parse_from(["heliostat", "link", "--xyz"]).expect_err("it is refused");
        let reason = reason(&refused);
        assert!(reason.starts_with("unexpected argument '--xyz' found") && !reason.contains("Usage"), "{reason}");
    }

    #[test]
    fn a_file_without_its_flag_is_refused_with_the_flag() {
        let refused = |words: &[&str]| {
            let program = crate::cli::Cli::command();
            let error = crate::cli::Cli::try_parse_from(words).expect_err("it is refused");
            with_file_advice(error, chosen(&program, words.iter().map(OsString::from))).to_string()
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
        let array = refused(&["heliostat", "driver", "run", "array.toml"]);
        assert!(array.contains("tip: the file of an array is given as '--config array.toml'"), "{array}");
    }
}
