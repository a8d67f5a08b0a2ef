//! The emergency stops of a room in words, for the page and the command line.

use std::time::Duration;

use heliostat_proto::reported_stops::{ReportedStops, RoomStop, Standing};
use heliostat_proto::{Nanos, StopName, clock_time};
use heliostat_service::printable::printable;

/// Most processes that one text names: tokens and statuses can name any number of them.
const NAMED_MAX: usize = 8;

/// What is open where no process announces the geometry of the room.
pub const UNKNOWN_ARRAYS: &str = "no process announces how many arrays the room has, and one that was not seen can move: connect to its controller or router";

/// What an operator has to know of an array that gives no answer to a re-arm: the re-arm can reach it later.
const MAY_BE_RELEASED: &str = "has not confirmed: it may be released when it answers again; cut its power before you go near it, or stop it again";

/// What an operator has to know of an array; `None` where nothing is open.
pub(crate) fn problem(array: usize, standing: &Standing) -> Option<String> {
    Some(match standing {
        Standing::Free | Standing::Stopped => return None,
        Standing::Silent => format!("array {array} does not answer: cut its power"),
        Standing::Moving => format!("array {array} has not latched the stop: cut its power"),
        Standing::Latched { problem } if problem.is_empty() => {
            format!("array {array} has latched the stop, but its device has not executed it: cut its power")
        }
        Standing::Latched { problem } => format!(
            "array {array} has latched the stop, but its device has not executed it ({}): cut its power",
            printable(problem)
        ),
        Standing::Shared { drivers, open, problem } => {
            let sources = sources_in_words(open);
            let (named, have, their) = match open.len() {
                1 => ("the one of source", "has", "its"),
                _ => ("the ones of sources", "have", "their"),
            };
            let why = if problem.is_empty() { String::new() } else { format!(" ({})", printable(problem)) };
            format!(
                "array {array} has {drivers} drivers, and {named} {sources} {have} not confirmed the stop{why}: cut {their} power"
            )
        }
        Standing::Lost { drivers, since_ns } => {
            let (lost, their) = (lost_in_words(drivers, *since_ns), if drivers.len() == 1 { "its" } else { "their" });
            format!("array {array} is not confirmed: {lost}; {their} mirrors may still move: cut the power")
        }
        Standing::Unknown => format!(
            "array {array} has latched the stop; its driver does not report whether the device executed it: check its mirrors"
        ),
    })
}

/// The sources of processes: the first ones, and how many more there are.
pub(crate) fn sources_in_words(sources: &[u64]) -> String {
    let named: Vec<String> = sources.iter().take(NAMED_MAX).map(|source| format!("{source:016x}")).collect();
    let more = sources.len().saturating_sub(NAMED_MAX);
    let rest = if more > 0 { format!(" and {more} more") } else { String::new() };
    format!("{}{rest}", named.join(", "))
}

/// That these drivers of one array are lost, and since when, where a controller reports it.
fn lost_in_words(drivers: &[u64], since_ns: Option<Nanos>) -> String {
    let sources = sources_in_words(drivers);
    let (named, were, they) = if drivers.len() == 1 { ("driver", "was", "it") } else { ("drivers", "were", "they") };
    let lost = format!("{named} {sources} {were} lost before {they} answered");
    since_ns.map_or(lost, |since_ns| format!("{named} {sources} {were} lost at {}", clock_time(since_ns)))
}

/// What an operator has to know of lost drivers of an array, after a release.
pub(crate) fn unreleased_lost((array, standing): &(usize, Standing)) -> Option<String> {
    let Standing::Lost { drivers, since_ns } = standing else { return None };
    let (lost, their) = (lost_in_words(drivers, *since_ns), if drivers.len() == 1 { "its" } else { "their" });
    Some(format!(
        "array {array}: {lost}, without a confirmation of the release: {their} mirrors may stand, or still move"
    ))
}

/// What an operator has to know of lost drivers of an array that another driver serves, while no stop is held.
pub(crate) fn lost_beside_another((array, standing): &(usize, Standing)) -> Option<String> {
    let Standing::Lost { drivers, since_ns } = standing else { return None };
    let lost = lost_in_words(drivers, *since_ns);
    let until = if drivers.len() == 1 { "it returns" } else { "they return" };
    Some(format!(
        "{lost}, and another driver serves array {array}: a stop stays unconfirmed until {until}, or until its release"
    ))
}

/// What an operator has to know after a re-arm of an array that reports that a device does not answer.
pub(crate) fn lost_device(array: usize) -> String {
    format!(
        "array {array} reports that a device does not answer (fault link): its mirrors do not follow until it answers; \
         check its cable and its power, and the journal of its driver"
    )
}

/// What an operator has to know of controllers that have not reported which drivers they have lost.
pub(crate) fn unheard(controllers: &[u64]) -> Option<String> {
    let (named, have, they) = match controllers.len() {
        0 => return None,
        1 => ("controller", "has", "it has"),
        _ => ("controllers", "have", "they have"),
    };
    let sources = sources_in_words(controllers);
    Some(format!(
        "{named} {sources} {have} not reported which drivers {they} lost: mirrors of a driver that left before may move"
    ))
}

/// The arrays that have stopped and do not record the stop, in words.
pub(crate) fn unrecorded(problems: impl IntoIterator<Item = (usize, String)>) -> Vec<String> {
    let line = |(array, problem): (usize, String)| {
        format!("array {array} has stopped, but the stop is not recorded: {}", printable(&problem))
    };
    problems.into_iter().map(line).collect()
}

/// A stop in words: its name, its operator, its reason and its arrays.
pub fn stop_in_words(RoomStop { name, operator, reason, arrays, .. }: &RoomStop) -> String {
    let arrays: Vec<String> = arrays.iter().map(usize::to_string).collect();
    let (operator, reason) = (printable(operator), printable(reason));
    let by = if operator.is_empty() { String::new() } else { format!(" of {operator}") };
    format!("{name}{by} (\"{reason}\") at array {}", arrays.join(", "))
}

/// What keeps the mirrors stopped after a release, by the stops that are held then; `None` without one.
pub fn still_stopped(held: &[RoomStop]) -> Option<String> {
    let held: Vec<String> = held.iter().map(stop_in_words).collect();
    (!held.is_empty()).then(|| format!("the mirrors stay stopped by {}", held.join("; ")))
}

/// What an operator has to know of stops that a controller holds and no array reports, by the words of its state.
pub(crate) fn held_in_words(held: &str) -> String {
    format!(
        "no array here reports a stop, and commands are {held}: the controller stops arrays that return; cut the power of \
         those that do not report"
    )
}

/// What is open of a release of stops, array by array.
pub(crate) fn unreleased(seen: &ReportedStops, names: &[StopName], now: Duration) -> Vec<String> {
    let unnamed = seen.unnamed(now);
    let of_unnamed =
        unnamed.iter().map(|array| (*array, format!("array {array} knows no names of stops: release all with --all")));
    let holding = seen.holding(names, now).into_iter().filter(|(array, _)| !unnamed.contains(array));
    let of_holding = holding.map(|(array, reports)| match reports {
        true => (array, format!("array {array} has not reported the release: it may have released the stop, and move")),
        false => (array, format!("array {array} {MAY_BE_RELEASED}")),
    });
    let mut open: Vec<(usize, String)> = of_unnamed.chain(of_holding).collect();
    open.sort();
    open.into_iter().map(|(_, text)| text).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_text_names_the_first_of_many_lost_drivers_and_the_number_of_the_others() {
        let words = |drivers: u64| {
            problem(0, &Standing::Lost { drivers: (1..=drivers).collect(), since_ns: None }).expect("a problem")
        };
        assert!(words(8).contains(", 0000000000000008 were lost before they answered"), "{}", words(8));
        assert!(words(9).contains(", 0000000000000008 and 1 more were lost before they answered"), "{}", words(9));
        assert!(words(16_384).len() < 400, "{}", words(16_384));
    }

    #[test]
    fn a_control_character_of_a_reason_is_escaped_once() {
        let stop = RoomStop {
            name: StopName { source: 1, sequence: 2 },
            operator: "ann".into(),
            reason: "smoke\nfire".into(),
            arrays: vec![0],
            known: Duration::ZERO,
            stands_for_unlisted: false,
        };
        let words = stop_in_words(&stop);
        assert!(words.contains("of ann (\"smoke\\u000afire\") at array 0"), "{words}");
    }
}
