//! What `heliostat stop` and `heliostat rearm` tell an operator, in words.

use std::time::Duration;

use anyhow::anyhow;
use heliostat_bus::BusArgs;
use heliostat_proto::StopName;
use heliostat_proto::reported_stops::RoomStop;
use heliostat_service::printable::printable;
use heliostat_ui::{StopSwitch, UNKNOWN_ARRAYS, UiError, still_stopped};

/// What becomes of a stop of which a problem is shown, and how to end it.
pub(super) const HELD: &str = "the stop is held: end with Ctrl-C";
/// What to do where further stops may hold the arrays.
pub(super) const LOOK_AND_REPEAT: &str =
    "look at `heliostat status`, and repeat the re-arm for the stops that it names";

/// A change of the confirmation of a held stop that was confirmed before.
pub(super) fn confirmation_in_words(is_confirmed: bool, open: impl FnOnce() -> String) -> String {
    match is_confirmed {
        true => "heliostat stop: every array confirms the stop again".to_owned(),
        false => format!("heliostat stop: not every array confirms the stop any longer: {}; {HELD}", open()),
    }
}

/// What is known of a stop on its way, array by array.
pub(super) fn given(bus: BusArgs) -> impl Fn(&StopSwitch) -> String + Send + 'static {
    move |switch| {
        let known = match switch.is_own_confirmed() {
            true => "every array that this command sees has confirmed the stop".to_owned(),
            false => format!(
                "the stop was given, and is not confirmed: {}. It may not have left, and is in force only where it arrived",
                open_in_words(switch)
            ),
        };
        format!("{known}{}", own_in_words(switch, &bus))
    }
}

/// The name of the stop of this command and what releases it, as a sentence that follows another one; empty before it
/// is given.
pub(super) fn own_in_words(switch: &StopSwitch, bus: &BusArgs) -> String {
    let words = |name| format!(". The stop is {name}; to release it: `{}`", release_of(name, bus));
    switch.own_name().map(words).unwrap_or_default()
}

/// What is open of the stops of the room, and which arrays have stopped.
pub(super) fn open_in_words(switch: &StopSwitch) -> String {
    let stopped: Vec<String> = switch.stopped_arrays().iter().map(usize::to_string).collect();
    let stopped = if stopped.is_empty() { "none".to_owned() } else { format!("array {}", stopped.join(", ")) };
    let stopped = [format!("stopped by their reports: {stopped}")];
    stopped.into_iter().chain(switch.problems()).collect::<Vec<_>>().join("; ")
}

/// An error of a stop; of an unconfirmed one with what this command cannot see, and with its name and its release in
/// words.
pub(super) fn with_reach(error: UiError, own: &str) -> anyhow::Error {
    match error {
        UiError::StopUnconfirmed { ref arrays, .. } => {
            let is_uncounted = arrays.iter().any(|open| open == UNKNOWN_ARRAYS);
            let count = if is_uncounted { ", or give their number: --arrays N" } else { "" };
            anyhow!(
                "{error}{count}. The stop was sent, and stays in force where it arrived; an array that returns later can \
                 get it then, and stop. Reports come only from the processes in --connect: with the endpoint of its \
                 driver, heliostat status shows what an array does{own}"
            )
        }
        error @ UiError::NoReceiver(_) => {
            anyhow!(
                "{error}. No array received the stop, and the mirrors go on moving; an array that connected during the wait \
                 may have it{own}"
            )
        }
        error => error.into(),
    }
}

/// An error of a release, with the stops that a controller holds for arrays that do not report, in the words of its state.
pub(super) fn with_held(error: anyhow::Error, held: Option<&str>) -> anyhow::Error {
    match held {
        Some(held) => anyhow!(
            "{error}. Commands are {held}: the controller still holds this, and stops an array that returns; repeat the re-arm \
             when it reports"
        ),
        None => error,
    }
}

/// Whether one of these stops stands for others that the array could not list: their holders repeat them.
pub(super) fn may_follow(released: &[RoomStop]) -> bool {
    released.iter().any(|stop| stop.stands_for_unlisted)
}

/// What a release has done, and what may hold the arrays after it.
pub(super) fn release_in_words(room: &str, took: Duration, released: &[RoomStop], held: &[RoomStop]) -> String {
    let further = || may_follow(released).then(|| format!("further stops may hold the arrays: {LOOK_AND_REPEAT}"));
    let took_ms = took.as_secs_f64() * 1e3;
    match still_stopped(held).or_else(further) {
        Some(rest) => {
            let (stops, are) = if released.len() == 1 { ("stop", "is") } else { ("stops", "are") };
            format!("the named {stops} of room {room} {are} released, confirmed after {took_ms:.1} ms; {rest}")
        }
        None => format!("the arrays of room {room} are released, confirmed after {took_ms:.1} ms"),
    }
}

/// The command that releases these stops, for an operator who has just stopped the room.
pub(super) fn release_command(stops: &[RoomStop], bus: &BusArgs) -> String {
    let flag = match stops {
        [stop] => return format!("to release: {}", release_of(stop.name, bus)),
        _ => "--stop NAME for one of them, or --all",
    };
    format!("to release: {}", bus.command("heliostat rearm", flag))
}

/// The command that releases one stop.
fn release_of(name: StopName, bus: &BusArgs) -> String {
    bus.command("heliostat rearm", &format!("--stop {name}"))
}

/// A text, with one line for each stop, which begins with what it is.
pub(super) fn with_stops(text: String, what: &str, stops: &[RoomStop]) -> String {
    let line = |RoomStop { name, operator, reason, .. }: &RoomStop| {
        let (operator, reason) = (printable(operator), printable(reason));
        let by = if operator.is_empty() { String::new() } else { format!(" of \"{operator}\"") };
        format!("{what}: {name}{by}: \"{reason}\"")
    };
    let lines: Vec<String> = [text].into_iter().chain(stops.iter().map(line)).collect();
    lines.join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stop_in_a_room_of_unknown_size_names_the_flag_for_it() {
        let text = |arrays: &[&str]| {
            let arrays = arrays.iter().map(|open| (*open).to_owned()).collect();
            with_reach(UiError::StopUnconfirmed { waited: Duration::from_secs(5), arrays }, "").to_string()
        };
        assert!(text(&[UNKNOWN_ARRAYS]).contains("or give their number: --arrays N. The stop was sent"));
        assert!(text(&[]).contains("an array that returns later can get it then, and stop"));
        assert!(!text(&["array 0 does not answer: cut its power"]).contains("--arrays"));
    }

    /// A stop without sender.
    fn stop(stands_for_unlisted: bool) -> RoomStop {
        RoomStop {
            name: StopName::default(),
            operator: String::new(),
            reason: "no record".to_owned(),
            arrays: vec![0],
            known: Duration::ZERO,
            stands_for_unlisted,
        }
    }

    #[test]
    fn a_stop_names_the_command_that_releases_it_and_a_release_what_it_released() {
        let stop = stop(false);
        let bus = BusArgs::default();
        let one = release_command(std::slice::from_ref(&stop), &bus);
        assert_eq!(one, "to release: heliostat rearm --stop 0000000000000000/0");
        let several = release_command(&[stop.clone(), stop.clone()], &bus);
        assert_eq!(several, "to release: heliostat rearm --stop NAME for one of them, or --all");
        let released = with_stops("done".to_owned(), "released", &[stop]);
        assert_eq!(released, "done\nreleased: 0000000000000000/0: \"no record\"");
    }

    #[test]
    fn a_release_of_a_stop_that_stands_for_others_is_not_called_the_release_of_the_arrays() {
        let words = |unlisted| release_in_words("lab", Duration::from_millis(5), &[stop(unlisted)], &[]);
        assert_eq!(words(false), "the arrays of room lab are released, confirmed after 5.0 ms");
        let unlisted = words(true);
        assert!(unlisted.starts_with("the named stop of room lab is released, confirmed after 5.0 ms"), "{unlisted}");
        assert!(unlisted.contains("further stops may hold the arrays: look at `heliostat status`"), "{unlisted}");
    }

    #[test]
    fn a_rearm_without_an_array_names_the_stop_that_the_controller_still_holds() {
        let text = |held| with_held(UiError::NoReceiver("array").into(), held).to_string();
        let held = text(Some("withheld by the stop of bea"));
        assert!(held.starts_with("no array received the order: "), "{held}");
        assert!(held.contains(". Commands are withheld by the stop of bea: the controller still holds this"), "{held}");
        assert_eq!(text(None), UiError::NoReceiver("array").to_string());
    }

    #[test]
    fn a_stop_that_is_not_confirmed_names_itself_and_the_command_that_releases_it() {
        let switch = StopSwitch::new("ann");
        assert_eq!(own_in_words(&switch, &BusArgs::default()), "", "before it is given");
        // It reaches no array, and one that connects may get it.
        let refused = switch.stop("smoke").expect_err("there is no array");
        let own = own_in_words(&switch, &BusArgs::default());
        let name = switch.own_name().expect("it was given");
        assert_eq!(own, format!(". The stop is {name}; to release it: `heliostat rearm --stop {name}`"));
        let unconfirmed = UiError::StopUnconfirmed { waited: Duration::from_secs(5), arrays: Vec::new() };
        for error in [refused, unconfirmed] {
            let text = with_reach(error, &own).to_string();
            assert!(text.ends_with(&own), "{text}");
        }
        assert!(given(BusArgs::default())(&switch).ends_with(&own));
    }

    #[test]
    fn a_stop_that_no_array_received_was_published_all_the_same() {
        let text = with_reach(UiError::NoReceiver("array"), "").to_string();
        assert!(text.ends_with("an array that connected during the wait may have it"), "{text}");
    }
}
