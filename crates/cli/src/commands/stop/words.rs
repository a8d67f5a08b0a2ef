//! What `heliostat stop` and `heliostat rearm` tell an operator, in words.

use std::time::Duration;

use anyhow::anyhow;
use heliostat_bus::BusArgs;
use heliostat_proto::StopName;
use heliostat_proto::reported_stops::RoomStop;
use heliostat_service::duration::in_seconds;
use heliostat_service::printable::printable;
use heliostat_ui::{Rights, StopSwitch, UNKNOWN_ARRAYS, UiError, still_stopped};

/// What becomes of a stop of which a problem is shown, and how to end it.
pub(super) const HELD: &str = "the stop is held: end with Ctrl-C";
/// What to do where further stops may hold the arrays.
pub(super) const LOOK_AND_REPEAT: &str =
    "look at `heliostat status`, and repeat the re-arm for the stops that it names";

/// What becomes of a stop that is not confirmed.
const SENT: &str = "The stop was sent, and stays in force where it arrived. An array that returns later can get it then, \
                    and stop.\nWith the endpoint of its driver in --connect, `heliostat status` shows what an array does.";

/// A change of the confirmation of a held stop that was confirmed before.
pub(super) fn confirmation_in_words(is_confirmed: bool, open: impl FnOnce() -> String) -> String {
    match is_confirmed {
        true => "heliostat stop: every array confirms the stop again".to_owned(),
        false => format!("heliostat stop: not every array confirms the stop any longer: {}; {HELD}", open()),
    }
}

/// The commands that release stops of the room, for an operator to copy.
#[derive(Clone, Debug)]
pub(super) struct Release {
    bus: BusArgs,
    rights: Rights,
}

impl Release {
    /// Of an operator who has joined with these flags, by a certificate with these rights.
    pub fn new(bus: &BusArgs, rights: Rights) -> Self {
        Self { bus: bus.clone(), rights }
    }

    /// The command for one stop.
    pub fn of_stop(&self, name: StopName) -> String {
        self.command(&format!("--stop {name}"))
    }

    /// The command for all stops.
    pub fn of_all(&self) -> String {
        self.command("--all")
    }

    fn command(&self, flag: &str) -> String {
        self.bus.command("heliostat rearm", flag)
    }

    /// What the command needs beside its flags, behind it; empty for what the certificate of this process permits.
    fn needs(&self) -> &'static str {
        match self.rights {
            Rights::All => "",
            Rights::StopOnly => ", with the keys of an operator",
        }
    }

    /// A line with the command for each of these stops, and for all where there are several.
    fn lines(&self, stops: &[RoomStop]) -> String {
        let needs = self.needs();
        let one = |stop: &RoomStop| format!("to release: {}{needs}", self.of_stop(stop.name));
        let all = (stops.len() > 1).then(|| format!("to release all: {}{needs}", self.of_all()));
        stops.iter().map(one).chain(all).collect::<Vec<_>>().join("\n")
    }
}

/// What is known of a stop on its way, array by array.
pub(super) fn given(release: Release) -> impl Fn(&StopSwitch) -> String + Send + 'static {
    move |switch| {
        let known = match switch.is_own_confirmed() {
            true => "every array that this command sees has confirmed the stop".to_owned(),
            false => format!(
                "the stop was given, and is not confirmed: {}. It may not have left, and is in force only where it arrived",
                open_in_words(switch)
            ),
        };
        let own = own_in_words(switch, &release);
        if own.is_empty() { known } else { format!("{known}. {own}") }
    }
}

/// The name of the stop of this command and what releases it, as a sentence; empty before it is given.
pub(super) fn own_in_words(switch: &StopSwitch, release: &Release) -> String {
    let words = |name| format!("The stop is {name}; to release it: `{}`{}", release.of_stop(name), release.needs());
    switch.own_name().map(words).unwrap_or_default()
}

/// What is open of the stops of the room, and which arrays have stopped.
pub(super) fn open_in_words(switch: &StopSwitch) -> String {
    let stopped = [stopped_in_words(&switch.stopped_arrays())];
    stopped.into_iter().chain(switch.problems()).collect::<Vec<_>>().join("; ")
}

/// Which arrays have stopped.
pub(super) fn stopped_in_words(stopped: &[usize]) -> String {
    let stopped: Vec<String> = stopped.iter().map(usize::to_string).collect();
    let stopped = if stopped.is_empty() { "none".to_owned() } else { format!("array {}", stopped.join(", ")) };
    format!("stopped by their reports: {stopped}")
}

/// An error of a stop, in lines. An unconfirmed one has one line for each array, then what the arrays report beside
/// that, what this command cannot see, and its name and its release.
pub(super) fn with_reach(error: UiError, reported: &[String], own: &str) -> anyhow::Error {
    let mut lines: Vec<String> = match error {
        UiError::StopUnconfirmed { waited, arrays } if !arrays.is_empty() => {
            let open = |open: String| match open == UNKNOWN_ARRAYS {
                true => format!("{open}, or give their number: --arrays N"),
                false => open,
            };
            let head = format!("the stop is not confirmed after {}:", in_seconds(waited));
            let open = arrays.into_iter().map(open).chain(reported.iter().cloned());
            [head].into_iter().chain(open).chain([SENT.to_owned()]).collect()
        }
        error @ UiError::StopUnconfirmed { .. } => vec![error.to_string(), SENT.to_owned()],
        UiError::NoReceiver(receiver) => vec![format!(
            "no {receiver} received the stop: check --room and --connect. To stop the mirrors now, cut their power. An \
             array that connected during the wait may have it"
        )],
        error => return error.into(),
    };
    if !own.is_empty() {
        lines.push(own.to_owned());
    }
    anyhow!(lines.join("\n"))
}

/// An error of a release, with the stops that a controller holds for arrays that do not report, in the words of its state,
/// and with the arrays that report that a device does not answer.
pub(super) fn with_state(error: anyhow::Error, held: Option<&str>, lost_devices: &[String]) -> anyhow::Error {
    let held = held.map(|held| {
        format!(
            ". Commands are {held}: the controller still holds this, and stops an array that returns; repeat the re-arm \
             when it reports"
        )
    });
    let lost = lost_devices.iter().map(|lost| format!("; {lost}"));
    anyhow!("{error}{}", held.into_iter().chain(lost).collect::<String>())
}

/// An error of an order, with a last line about the rooms that are there where its own has no process.
pub(super) fn with_rooms(error: anyhow::Error, absent: Option<String>) -> anyhow::Error {
    match absent {
        Some(absent) => anyhow!("{error:#}\n{absent}"),
        None => error,
    }
}

/// Whether one of these stops stands for others that the array could not list: their holders repeat them.
pub(super) fn may_follow(released: &[RoomStop]) -> bool {
    released.iter().any(|stop| stop.stands_for_unlisted)
}

/// What a release has done, and what may hold the arrays after it.
pub(super) fn release_in_words(room: &str, took: Duration, released: &[RoomStop], held: &[RoomStop]) -> String {
    if released.is_empty() && held.is_empty() {
        return format!(
            "no stop of room {room} was in force by name; the release is confirmed after {:.1} ms",
            took.as_secs_f64() * 1e3
        );
    }
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

/// A text, with the stops in force, that of this order first, and the commands that release them.
pub(super) fn with_releases(text: String, stops: &[RoomStop], own: Option<StopName>, release: &Release) -> String {
    let (own, others) = own_first(stops, own);
    let text = with_stops(with_stops(text, "the stop", &own), "another stop", &others);
    format!("{text}\n{}", release.lines(&[own, others].concat()))
}

/// The stop of this order, and the others.
pub(super) fn own_first(stops: &[RoomStop], own: Option<StopName>) -> (Vec<RoomStop>, Vec<RoomStop>) {
    stops.iter().cloned().partition(|stop| Some(stop.name) == own)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stop_in_a_room_of_unknown_size_names_the_flag_for_it() {
        let text = |arrays: &[&str]| {
            let arrays = arrays.iter().map(|open| (*open).to_owned()).collect();
            with_reach(UiError::StopUnconfirmed { waited: Duration::from_secs(5), arrays }, &[], "").to_string()
        };
        assert!(text(&[UNKNOWN_ARRAYS]).contains("or give their number: --arrays N\nThe stop was sent"));
        assert!(text(&[]).contains("array that returns later can get it then, and stop"));
        assert!(!text(&["array 0 does not answer: cut its power"]).contains("--arrays"));
    }

    #[test]
    fn each_array_that_has_not_confirmed_has_a_line_of_its_own() {
        let open = [0, 1].map(|array| format!("array {array} does not answer: cut its power"));
        let error = UiError::StopUnconfirmed { waited: Duration::from_secs(5), arrays: open.to_vec() };
        let reported =
            [stopped_in_words(&[2, 3]), "array 2 has stopped, but the stop is not recorded: full".to_owned()];
        let text = with_reach(error, &reported, "The stop is 3/4").to_string();
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines[0], "the stop is not confirmed after 5 s:");
        assert_eq!(lines[1..3], open);
        assert_eq!(lines[3..5], ["stopped by their reports: array 2, 3", reported[1].as_str()]);
        assert_eq!(lines.last(), Some(&"The stop is 3/4"));
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
        let release = Release::new(&BusArgs::default(), Rights::All);
        let one = release.lines(std::slice::from_ref(&stop));
        assert_eq!(one, "to release: heliostat rearm --stop 0000000000000000/0");
        let other = RoomStop { name: StopName { source: 3, sequence: 4 }, ..stop.clone() };
        let several = with_releases("done".to_owned(), &[stop.clone(), other.clone()], Some(other.name), &release);
        let expected = "done\n\
                        the stop: 0000000000000003/4: \"no record\"\n\
                        another stop: 0000000000000000/0: \"no record\"\n\
                        to release: heliostat rearm --stop 0000000000000003/4\n\
                        to release: heliostat rearm --stop 0000000000000000/0\n\
                        to release all: heliostat rearm --all";
        assert_eq!(several, expected);
        let released = with_stops("done".to_owned(), "released", &[stop]);
        assert_eq!(released, "done\nreleased: 0000000000000000/0: \"no record\"");
    }

    #[test]
    fn a_viewer_is_told_that_a_release_needs_the_keys_of_an_operator() {
        let release = Release::new(&BusArgs::default(), Rights::StopOnly);
        let line = release.lines(&[stop(false)]);
        assert_eq!(line, "to release: heliostat rearm --stop 0000000000000000/0, with the keys of an operator");
        let switch = StopSwitch::new("ann");
        switch.stop("smoke").expect_err("there is no array");
        let own = own_in_words(&switch, &release);
        assert!(own.ends_with("`, with the keys of an operator"), "{own}");
    }

    #[test]
    fn a_release_says_whether_a_stop_was_in_force_and_which_device_does_not_answer() {
        let words = |released: &[RoomStop]| release_in_words("lab", Duration::from_millis(5), released, &[]);
        assert_eq!(words(&[]), "no stop of room lab was in force by name; the release is confirmed after 5.0 ms");
        assert_eq!(words(&[stop(false)]), "the arrays of room lab are released, confirmed after 5.0 ms");
        let lost = ["array 0 reports that a device does not answer".to_owned()];
        let refused = with_state(UiError::NotStopped.into(), None, &lost).to_string();
        assert_eq!(refused, format!("{}; {}", UiError::NotStopped, lost[0]));
    }

    #[test]
    fn the_tutorial_of_an_own_room_has_the_answer_of_its_first_release() {
        let guide = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/tutorials/own-room.md");
        let guide = std::fs::read_to_string(guide).expect("the guide");
        let first = RoomStop { reason: "the last state is unknown: there is no FILE".to_owned(), ..stop(false) };
        let stops = std::slice::from_ref(&first);
        let answer = with_stops(release_in_words("own", Duration::ZERO, stops, &[]), "released", stops);
        assert!(guide.contains(&answer.replace("0.0 ms", "TIME ms")), "{answer}");
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
        let text = |held| with_state(UiError::NoReceiver("array").into(), held, &[]).to_string();
        let held = text(Some("withheld by the stop of bea"));
        assert!(held.starts_with("no array received the order: "), "{held}");
        assert!(held.contains(". Commands are withheld by the stop of bea: the controller still holds this"), "{held}");
        let absent = with_rooms(UiError::NoReceiver("array").into(), Some("room lba has no process here".to_owned()));
        assert!(absent.to_string().ends_with("or start one\nroom lba has no process here"), "{absent}");
        assert_eq!(text(None), UiError::NoReceiver("array").to_string());
    }

    #[test]
    fn a_stop_that_is_not_confirmed_names_itself_and_the_command_that_releases_it() {
        let (switch, release) = (StopSwitch::new("ann"), Release::new(&BusArgs::default(), Rights::All));
        assert_eq!(own_in_words(&switch, &release), "", "before it is given");
        // It reaches no array, and one that connects may get it.
        let refused = switch.stop("smoke").expect_err("there is no array");
        let own = own_in_words(&switch, &release);
        let name = switch.own_name().expect("it was given");
        assert_eq!(own, format!("The stop is {name}; to release it: `heliostat rearm --stop {name}`"));
        let unconfirmed = UiError::StopUnconfirmed { waited: Duration::from_secs(5), arrays: Vec::new() };
        for error in [refused, unconfirmed] {
            let text = with_reach(error, &[], &own).to_string();
            assert!(text.ends_with(&own), "{text}");
        }
        assert!(given(release)(&switch).ends_with(&own));
    }

    #[test]
    fn a_stop_that_no_array_received_was_published_all_the_same() {
        let text = with_reach(UiError::NoReceiver("array"), &[], "").to_string();
        assert!(text.ends_with("An array that connected during the wait may have it"), "{text}");
        assert!(!text.contains("start one"), "{text}");
    }
}
