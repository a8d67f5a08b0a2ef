//! What a flag that takes a number expects, in words.

use std::any::TypeId;
use std::error::Error;
use std::num::{ParseFloatError, ParseIntError};

use clap::builder::ValueParser;
use clap::error::{ContextKind, ContextValue, ErrorKind};
use clap::{Arg, Command};

/// What stands between a value and its bounds in a refusal of the parser.
const BEYOND: &str = " is not in ";

/// The same error; where a number is refused, with the numbers that the flag takes.
pub fn with_expected_numbers(error: clap::Error, command: &Command) -> clap::Error {
    let Some(refusal) = refusal(&error, command) else { return error };
    let message = format!("{refusal}\n\nFor more information, try '--help'.\n");
    clap::Error::raw(ErrorKind::ValueValidation, message).with_cmd(command)
}

/// The refusal of a number; `None` for another error, and for a parser that states itself what it expects.
fn refusal(error: &clap::Error, command: &Command) -> Option<String> {
    let cause = error.source().filter(|_| error.kind() == ErrorKind::ValueValidation)?;
    let is_unread = cause.is::<ParseIntError>() || cause.is::<ParseFloatError>();
    if !is_unread && !cause.to_string().contains(BEYOND) {
        return None;
    }
    let text = |kind| match error.get(kind) {
        Some(ContextValue::String(text)) => Some(text),
        _ => None,
    };
    let (flag, value) = (text(ContextKind::InvalidArg)?, text(ContextKind::InvalidValue)?);
    let argument = command.get_arguments().find(|argument| is_named(argument, flag))?;
    Some(format!("invalid value '{value}' for '{flag}': expected {}", expected(argument.get_value_parser())?))
}

/// Whether a text such as `--seed <N>` or `<N>` names an argument.
fn is_named(argument: &Arg, text: &str) -> bool {
    let long = text.strip_prefix("--").and_then(|rest| rest.split([' ', '=', '[']).next());
    long.map_or_else(|| argument.to_string() == text, |long| argument.get_long() == Some(long))
}

/// The numbers that a parser takes; `None` for a parser of something else.
fn expected(parser: &ValueParser) -> Option<String> {
    let takes = |id: TypeId| parser.type_id() == id;
    if takes(TypeId::of::<f64>()) || takes(TypeId::of::<f32>()) {
        return Some("a number, for example 2.5".into());
    }
    let types = [
        (TypeId::of::<u8>(), 0, u64::from(u8::MAX)),
        (TypeId::of::<u16>(), 0, u64::from(u16::MAX)),
        (TypeId::of::<u32>(), 0, u64::from(u32::MAX)),
        (TypeId::of::<u64>(), 0, u64::MAX),
        (TypeId::of::<usize>(), 0, usize::MAX as u64),
        (TypeId::of::<i32>(), i64::from(i32::MIN), i32::MAX as u64),
        (TypeId::of::<i64>(), i64::MIN, i64::MAX as u64),
    ];
    let (_, low, high) = types.into_iter().find(|(id, ..)| takes(*id))?;
    let (low, high) = bounds(parser).unwrap_or_else(|| (low.to_string(), high.to_string()));
    Some(format!("a whole number from {low} to {high}"))
}

/// The bounds of a parser, which it states only where it refuses a number beyond them.
fn bounds(parser: &ValueParser) -> Option<(String, String)> {
    let probe = |number: String| {
        let flag = Arg::new("number").long("number").value_parser(parser.clone());
        let refused = Command::new("probe").no_binary_name(true).arg(flag).try_get_matches_from([number]).err()?;
        let text = refused.source()?.to_string();
        let (_, bounds) = text.split_once(BEYOND)?;
        let (low, high) = bounds.split_once("..")?;
        Some((low.to_owned(), high.trim_start_matches('=').to_owned()))
    };
    [i64::MAX, 0].into_iter().find_map(|number| probe(format!("--number={number}")))
}

#[cfg(test)]
mod tests {
    use clap::value_parser;

    use super::*;

    #[test]
    fn a_parser_of_numbers_names_its_bounds() {
        let parsers: [(ValueParser, &str); 7] = [
            (value_parser!(u32).range(1..=10_000).into(), "a whole number from 1 to 10000"),
            (value_parser!(u16).range(1..).into(), "a whole number from 1 to 65535"),
            (value_parser!(u8).into(), "a whole number from 0 to 255"),
            (value_parser!(u64).range(1..=1000).into(), "a whole number from 1 to 1000"),
            (value_parser!(u64).range(1..).into(), "a whole number from 1 to 18446744073709551615"),
            (value_parser!(u64).into(), "a whole number from 0 to 18446744073709551615"),
            (value_parser!(f64).into(), "a number, for example 2.5"),
        ];
        for (parser, words) in parsers {
            assert_eq!(expected(&parser).as_deref(), Some(words), "{parser:?}");
        }
        assert_eq!(expected(Arg::new("text").get_value_parser()), None);
    }
}
