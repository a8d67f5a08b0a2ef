//! `heliostat stop` and `heliostat rearm`: the emergency stop from the command line.

mod meanwhile;
mod order;
mod words;

use std::fmt::Display;
use std::time::{Duration, Instant};

use anyhow::{Result, anyhow, bail, ensure};
use heliostat_bus::{AccessRole, BusArgs, BusConfig, BusError, Identity, KeyError};
use heliostat_proto::reported_stops::RoomStop;
use heliostat_proto::{Room, StopName};
use heliostat_service::clock::utc_ns;
use heliostat_service::{EndArgs, duration, exit, output};
use heliostat_ui::{Rights, StopLabel, StopSwitch, UiError, still_stopped, stop_in_words};
use serde_json::json;

use super::join::Unconnected;
use order::{Order, Purpose, operator_name};
use words::{
    HELD, LOOK_AND_REPEAT, Release, confirmation_in_words, given, may_follow, open_in_words, own_first, own_in_words,
    release_in_words, stopped_in_words, with_reach, with_releases, with_rooms, with_state, with_stops,
};

/// Time between two looks at a held stop.
const HOLD_INTERVAL: Duration = Duration::from_millis(50);
/// Time after which a change of the confirmation of a held stop is shown: a late report is none.
const SETTLED: Duration = Duration::from_secs(1);

/// Stop all mirrors of a room at once, and wait until every array confirms it.
///
/// An array confirms that its device has executed the stop. Every array of the announced geometry has to,
/// and every array that was seen. Where several drivers serve one array, each has to confirm. Otherwise the
/// exit status is 1, and the message names what is open and what to do: cut the power of an array that does
/// not answer.
///
/// The exit status is 1 too in four other cases. No process announces how many arrays the room has: connect
/// to its controller or router, or give --arrays. A driver does not report whether its device executed the
/// stop. A driver left before the stop, and a controller reports this: its return or a release ends it. An
/// array has stopped and does not record the stop: the message states what a restart of its driver does.
///
/// With --hold the command notes all this and goes on. It states when every array has confirmed the stop, and
/// when one no longer does. Its status is 1 at its end, also after Ctrl-C, if not
/// every array has confirmed the stop by then. A stop that is interrupted during its first wait names what is
/// confirmed.
///
/// The result names every stop in force, that of this command first; `heliostat rearm --stop` takes such a name.
///
/// The stop stays in force, also over a restart of the driver, until an operator releases it with
/// `heliostat rearm`. Connect to the process that drives the mirrors, to one that is connected to it, or to
/// their router.
#[derive(Debug, clap::Args)]
pub struct StopArgs {
    #[command(flatten)]
    order: OrderArgs,
    /// Number of arrays of the room, where no controller or simulator announces it
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(1..=16))]
    arrays: Option<u8>,
    /// Do not end: repeat the stop to each array that has not reported it, also when it returns after
    /// minutes, until it is released
    #[arg(long)]
    hold: bool,
    #[command(flatten)]
    end: EndArgs,
}

/// Release an emergency stop of a room, and wait until the arrays confirm it.
///
/// The re-arm names the stop, so it releases no other one. With several stops in force, name one, or
/// release each with --all. When the last one is released, the mirrors park; then they follow the next
/// valid command.
///
/// An array with more stops than it can list has one stop without sender for the others. After its release
/// the holders of the others repeat them: the exit status is 1 if one of them stops an array at once, and
/// otherwise the result says that further stops may follow.
#[derive(Debug, clap::Args)]
pub struct RearmArgs {
    #[command(flatten)]
    order: OrderArgs,
    /// Name of the stop, as `heliostat stop` and `heliostat status` print it
    #[arg(long, value_name = "SOURCE/SEQUENCE", conflicts_with = "all")]
    stop: Option<StopLabel>,
    /// Release every stop that is in force, each by its name
    #[arg(long)]
    all: bool,
}

#[derive(Debug, clap::Args)]
struct OrderArgs {
    #[command(flatten)]
    bus: BusArgs,
    /// Reason, which the array reports
    #[arg(long, value_name = "TEXT", default_value = "command line")]
    reason: String,
    /// Name of the operator, which the array reports; without it, the name of the user by $USER, or "operator"
    #[arg(long, value_name = "NAME", value_parser = operator_name)]
    operator: Option<String>,
    /// Longest wait in seconds for the confirmation, with the search for the stops; a connection is awaited for at most 2 s
    #[arg(long, value_name = "N", default_value = "5", value_parser = duration::seconds, allow_negative_numbers = true)]
    timeout: Duration,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

/// Runs `heliostat stop`.
pub fn stop(args: StopArgs) -> Result<()> {
    let OrderArgs { reason, timeout, .. } = &args.order;
    let begun = Instant::now();
    let order = Order::new(Purpose::Stop, args.order.operator.as_deref(), args.order.timeout);
    // Nothing keeps a stop that is held from being sent.
    let end = args.hold.then(|| args.end.stop());
    // Every role may stop the array, so any certificate of the folder serves.
    let config = args.order.config_of_any_role()?;
    let rights = Rights::of(config.identity.as_ref().map(Identity::role), &config.room);
    let release = Release::new(&args.order.bus, rights);
    match &end {
        None => order.end_with_a_word(given(release.clone())),
        Some(Ok(end)) => order.end_at(end.clone(), given(release.clone())),
        // It shows when the stop is held.
        Some(Err(_)) => {}
    }
    let joined = if args.hold { order.join_and_wait(config) } else { order.join_at_once(config) };
    let (switch, room) = (&order.switch, joined?);
    if let Some(arrays) = args.arrays {
        switch.expect(arrays.into());
    }
    let joined = begun.elapsed();
    order.note_sent();
    let stopped = switch.stop_and_confirm(reason, *timeout).map(|took| joined + took);
    let stopped = stopped.map_err(|error| {
        let (unrecorded, open) = (switch.unrecorded(timeout.saturating_sub(begun.elapsed())), open_of(&error));
        let known = unconfirmed_to_json(&room, switch, &open, &unrecorded);
        let reported = [vec![stopped_in_words(&switch.stopped_arrays())], unrecorded].concat();
        let error = with_reach(error, &reported, &own_in_words(switch, &release));
        let error = with_rooms(error, order.absent_room());
        // The result of a stop that is held is that of its end.
        if args.hold { error } else { args.order.failed(error, known) }
    });
    note_unverified(switch);
    let Some(end) = end else {
        let unrecorded = args.order.report(&room, switch, (stopped?, begun), &release, false)?;
        let closed = order.close();
        ensure!(unrecorded.is_empty(), "{}", unrecorded.join("; "));
        return Ok(closed?);
    };
    // Before the notes: a signal that answers them ends the stop as one that is held.
    order.note_held();
    let note = |error: &dyn Display| output::note(format_args!("heliostat stop: {error}; {HELD}"));
    let report = |took| match args.order.report(&room, switch, (took, begun), &release, true) {
        Ok(unrecorded) => unrecorded.into_iter().for_each(output::note),
        Err(error) => note(&error),
    };
    match &stopped {
        Ok(took) => report(*took),
        Err(error) => note(error),
    }
    let end = end?;
    let until = args.end.seconds.map(|seconds| Instant::now() + seconds);
    let mut was_confirmed = stopped.is_ok();
    // What the last line said, and since when it is not so.
    let (mut is_shown, mut differs_since) = (was_confirmed, None::<Instant>);
    while switch.is_own_held() && !end.wait_for(HOLD_INTERVAL) && until.is_none_or(|until| Instant::now() < until) {
        switch.repeat();
        let is_confirmed = switch.is_own_confirmed();
        if is_confirmed && !was_confirmed {
            report(begun.elapsed());
            (was_confirmed, is_shown) = (true, true);
        }
        if is_confirmed == is_shown {
            differs_since = None;
        } else if differs_since.get_or_insert_with(Instant::now).elapsed() >= SETTLED {
            is_shown = is_confirmed;
            output::note(confirmation_in_words(is_confirmed, || open_in_words(switch)));
        }
    }
    let (is_held, is_confirmed) = (switch.is_own_held(), switch.is_own_confirmed());
    if is_confirmed && !was_confirmed {
        report(begun.elapsed());
        was_confirmed = true;
    }
    if !is_held {
        let rest = still_stopped(&switch.known_stops()).map_or_else(String::new, |rest| format!("; {rest}"));
        output::note(format_args!("heliostat stop: the stop is released{rest}"));
    } else if was_confirmed && !is_confirmed {
        output::note(
            "heliostat stop: the stop is no longer held, and not every array confirms it now: look at `heliostat status`, or \
             cut the power",
        );
    }
    let open = if is_held { open_in_words(switch) } else { "another operator has released the stop".to_owned() };
    let failed = (!was_confirmed).then(|| {
        let unrecorded = switch.unrecorded(Duration::ZERO);
        let lines: Vec<String> = switch.problems().into_iter().filter(|line| !unrecorded.contains(line)).collect();
        let known = unconfirmed_to_json(&room, switch, &lines, &unrecorded);
        let error =
            anyhow!("not every array has confirmed the stop: {open}; look at `heliostat status`, or cut the power");
        args.order.failed(error, known)
    });
    let closed = order.close();
    match failed {
        Some(error) => Err(error),
        None => Ok(closed?),
    }
}

/// Runs `heliostat rearm`.
pub fn rearm(args: RearmArgs) -> Result<()> {
    let OrderArgs { reason, timeout, .. } = &args.order;
    let begun_ns = utc_ns();
    let order = Order::new(Purpose::Rearm, args.order.operator.as_deref(), args.order.timeout);
    order
        .end_with_a_word(|_| "the release was sent, and is not confirmed: it takes effect where it arrived".to_owned());
    let room = order.join_widely(args.order.bus.config_or_connect(&[AccessRole::Operator])?)?;
    let release = Release::new(&args.order.bus, Rights::All);
    let switch = &order.switch;
    let begun = Instant::now();
    let meanwhile = order.meanwhile(begun_ns)?;
    let failed = |error: anyhow::Error, named: &[RoomStop], open: &[String]| {
        let mut result = to_json(&room, "unknown", None, [named, &switch.known_stops()]);
        result["open"] = json!(open);
        result["lost"] = json!(switch.unreleased_lost());
        args.order.failed(error, result)
    };
    let stops = switch.stops(*timeout);
    let known: Vec<StopName> = stops.iter().map(|stop| stop.name).collect();
    // The operator has not seen them when the command began.
    let is_later = |stop: &RoomStop| args.stop.is_none() && meanwhile.has(stop.name);
    let (later, stops): (Vec<_>, Vec<_>) = stops.into_iter().partition(is_later);
    if let (true, Some(rest), [first, ..]) = (stops.is_empty(), still_stopped(&later), &later[..]) {
        let again = release.of_stop(first.name);
        let error = anyhow!("{rest}, ordered during this command. Nothing was sent. To release it: `{again}`");
        return Err(failed(error, &[], &[]));
    }
    let named: Vec<RoomStop> = match (&args.stop, args.all) {
        (Some(StopLabel(name)), _) => {
            let found: Vec<_> = stops.into_iter().filter(|stop| stop.name == *name).collect();
            if found.is_empty() {
                let error = anyhow!("the stop {name} is not in force; nothing was sent");
                let error = with_state(error, switch.held_by_controller().as_deref(), &switch.lost_devices());
                return Err(failed(error, &[], &[]));
            }
            found
        }
        (None, false) if stops.len() > 1 => {
            let several = UiError::SeveralStops { stops: stops.iter().map(stop_in_words).collect() };
            let error = anyhow!("{several}: `{}`, or `{}`", release.of_stop(stops[0].name), release.of_all());
            return Err(failed(error, &[], &[]));
        }
        _ => stops,
    };
    let names: Vec<StopName> = named.iter().map(|stop| stop.name).collect();
    // A controller forgets them at the release.
    let lost = switch.unreleased_lost();
    order.note_sent();
    let released = switch.rearm_and_confirm(&names, reason, timeout.saturating_sub(begun.elapsed()));
    note_unverified(switch);
    let took = released.map_err(|error| {
        let open = open_of(&error);
        let error = match error {
            // The search for the stops is a part of the wait.
            UiError::RearmUnconfirmed { arrays, .. } => UiError::RearmUnconfirmed { waited: *timeout, arrays },
            error => error,
        };
        let error = with_state(error.into(), switch.held_by_controller().as_deref(), &switch.lost_devices());
        failed(with_rooms(error, order.absent_room()), &named, &open)
    })?;
    lost.iter().for_each(output::note);
    switch.lost_devices().into_iter().for_each(output::note);
    let left = timeout.saturating_sub(begun.elapsed());
    let further = if may_follow(&named) { switch.further_stops(&known, left) } else { Vec::new() };
    let rest = still_stopped(&further).map(|rest| format!("{rest}; {LOOK_AND_REPEAT}"));
    let written = args.order.report_release(&room, took, [&named, &switch.known_stops()], &lost, rest.as_deref());
    let closed = order.close();
    if let Some(rest) = rest {
        bail!(rest);
    }
    written?;
    Ok(closed?)
}

/// Names the arrays that two processes drive: the reports of one hide those of the other. Names the controllers that
/// may have lost drivers without a report of it.
fn note_unverified(switch: &StopSwitch) {
    switch.shared_arrays().into_iter().chain(switch.unheard_controllers()).for_each(output::note);
}

impl OrderArgs {
    /// The configuration with the first role of the folder whose files can be used, the operator's before others.
    fn config_of_any_role(&self) -> Result<BusConfig> {
        let mut unusable = None;
        for role in [&[AccessRole::Operator], &AccessRole::ALL[..]].concat() {
            match self.bus.config_or_connect(&[role]) {
                Ok(config) => {
                    if let Some(problem) = unusable {
                        output::note(format_args!("{problem}; the stop has the certificate of {role}"));
                    }
                    return Ok(config);
                }
                Err(BusError::Keys(KeyError::NoRole { .. })) => {}
                Err(error) => unusable = unusable.or(Some(error)),
            }
        }
        match unusable {
            Some(error) => Err(exit::unusable(Purpose::Stop.unsent(&Unconnected::advised(error)))),
            None => Ok(self.bus.config_or_connect(&AccessRole::ALL)?),
        }
    }

    /// The same error; as JSON it is printed in this object, beside what is known of the stops and the arrays.
    fn failed(&self, error: anyhow::Error, mut known: serde_json::Value) -> anyhow::Error {
        if self.json {
            known["error"] = json!(format!("{error:#}"));
            // The error itself is on standard error.
            drop(output::outcome(known));
        }
        error
    }

    /// Prints that every array is stopped, with the stops in force; returns the arrays that do not record the stop.
    fn report(
        &self,
        room: &Room,
        switch: &StopSwitch,
        (took, begun): (Duration, Instant),
        release: &Release,
        is_held: bool,
    ) -> Result<Vec<String>> {
        let stops = &switch.known_stops()[..];
        let own = switch.own_name();
        let find_unrecorded = || switch.unrecorded(self.timeout.saturating_sub(begun.elapsed()));
        let (written, unrecorded) = if self.json {
            let unrecorded = find_unrecorded();
            let mut result = to_json(room, "stopped", Some(took), [&own_first(stops, own).0, stops]);
            result["unrecorded"] = json!(unrecorded);
            // A command that holds the stop goes on.
            if !unrecorded.is_empty() && !is_held {
                result["error"] = json!(unrecorded.join("; "));
            }
            (output::outcome(result), unrecorded)
        } else {
            let (room, took_ms) = (room.name(), took.as_secs_f64() * 1e3);
            let text = format!("the arrays of room {room} are stopped, confirmed after {took_ms:.1} ms");
            // Before the wait for the records.
            (output::outcome(with_releases(text, stops, own, release)), find_unrecorded())
        };
        // An array that does not record its stop is the more serious failure.
        if unrecorded.is_empty() {
            written?;
        }
        Ok(unrecorded)
    }

    /// Prints that stops are released, and what the arrays report to hold after that; as JSON also the lost drivers.
    fn report_release(
        &self,
        room: &Room,
        took: Duration,
        [released, held]: [&[RoomStop]; 2],
        lost: &[String],
        error: Option<&str>,
    ) -> Result<()> {
        let text = if self.json {
            let array = match (held.is_empty(), may_follow(released)) {
                (false, _) => "stopped",
                (true, true) => "unknown",
                (true, false) => "released",
            };
            let mut result = to_json(room, array, Some(took), [released, held]);
            result["lost"] = json!(lost);
            if let Some(error) = error {
                result["error"] = json!(error);
            }
            result.to_string()
        } else {
            with_stops(release_in_words(room.name(), took, released, held), "released", released)
        };
        Ok(output::outcome(text)?)
    }
}

/// What is known of a stop that is not confirmed: what is open, the arrays that have stopped, and those that do not
/// record the stop.
fn unconfirmed_to_json(room: &Room, switch: &StopSwitch, open: &[String], unrecorded: &[String]) -> serde_json::Value {
    let stops = switch.known_stops();
    let (mut own, _) = own_first(&stops, switch.own_name());
    if own.is_empty() {
        // No array is seen, and one that connected during the wait may have it.
        own.extend(switch.own_order().map(|order| RoomStop {
            name: order.name(),
            operator: order.operator,
            reason: order.reason,
            arrays: Vec::new(),
            known: Duration::ZERO,
            stands_for_unlisted: false,
        }));
    }
    let mut result = to_json(room, "unknown", None, [&own, &stops]);
    result["open"] = json!(open);
    result["stopped"] = json!(switch.stopped_arrays());
    result["unrecorded"] = json!(unrecorded);
    result
}

/// What is open of an order that is not confirmed, array by array.
fn open_of(error: &UiError) -> Vec<String> {
    match error {
        UiError::StopUnconfirmed { arrays, .. } | UiError::RearmUnconfirmed { arrays, .. } => arrays.clone(),
        _ => Vec::new(),
    }
}

/// The result of an order about these stops, with those in force after it. An order that is not confirmed has no time.
fn to_json(room: &Room, array: &str, took: Option<Duration>, [of_order, held]: [&[RoomStop]; 2]) -> serde_json::Value {
    json!({
        "room": room.name(),
        "array": array,
        "confirmed_after_ms": took.map(|took| took.as_secs_f64() * 1e3),
        "stops": of_order.iter().map(as_json).collect::<Vec<_>>(),
        "in_force": held.iter().map(as_json).collect::<Vec<_>>(),
    })
}

fn as_json(RoomStop { name, operator, reason, .. }: &RoomStop) -> serde_json::Value {
    json!({
        "source": format!("{:016x}", name.source),
        "sequence": name.sequence,
        "operator": operator,
        "reason": reason,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stop_that_no_array_received_is_named_in_its_object() {
        let (room, switch) = (Room::new("lab").expect("a valid name"), StopSwitch::new("ann"));
        let refused = switch.stop("smoke").expect_err("there is no array");
        let name = switch.own_name().expect("it was given");
        let object = unconfirmed_to_json(&room, &switch, &open_of(&refused), &[]);
        assert_eq!(object["stops"][0]["source"], format!("{:016x}", name.source));
        assert_eq!((&object["stops"][0]["operator"], &object["stops"][0]["reason"]), (&"ann".into(), &"smoke".into()));
        assert_eq!((&object["array"], &object["confirmed_after_ms"]), (&"unknown".into(), &serde_json::Value::Null));
        let arrays = vec!["array 0 does not answer".to_owned()];
        let unconfirmed = UiError::StopUnconfirmed { waited: Duration::ZERO, arrays: arrays.clone() };
        assert_eq!(open_of(&unconfirmed), arrays);
    }
}
