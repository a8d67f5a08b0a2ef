//! The faults that the arrays of a room report, as one problem with what ends each of them.

use heliostat_proto::messages::fault;

use crate::causes::FAULTS;

/// What each fault is, and what ends it.
const ADVICE: [(u32, &str); 7] = [
    (fault::LINK, "a device does not answer: check its power and its cable; the driver connects again"),
    (fault::MIRROR, "mirrors do not follow their commands: check them, or release those that an order has jammed"),
    (fault::TEMPERATURE, "a temperature is outside its range: check the cooling of the device"),
    (fault::SUPPLY, "a voltage is outside its range: check the supply of the device"),
    (
        fault::CALIBRATION,
        "a calibration was refused, and the one in use is unchanged: heliostat calibrate apply FILE ends the fault",
    ),
    (fault::CLOCK, "a command came from the future: synchronise the clocks of controller and driver"),
    (fault::STOP, "a device has not executed its stop: cut its power"),
];

/// The note about faults of these names. A stop in force is a problem of its own, with the devices that have not
/// executed it.
pub(crate) fn faults_note(names: &[&str], is_stopped: bool) -> Option<String> {
    let of_stop = if is_stopped { fault::names(fault::STOP) } else { Vec::new() };
    let faults: Vec<String> =
        names.iter().filter(|name| !of_stop.contains(name)).map(|name| with_advice(name)).collect();
    (!faults.is_empty()).then(|| format!("{FAULTS}: {}", faults.join(", ")))
}

fn with_advice(name: &str) -> String {
    let advice = ADVICE.iter().find(|(bit, _)| fault::names(*bit).contains(&name));
    advice.map_or_else(|| name.to_owned(), |(_, advice)| format!("{name} ({advice})"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_fault_of_an_array_is_named_with_what_ends_it() {
        for (_, name) in fault::NAMES {
            let note = faults_note(&[name], false).expect("a note");
            assert!(note.starts_with(&format!("faults of the array: {name} (")) && note.ends_with(')'), "{note}");
        }
        for (fault, expected) in [("calibration", "calibrate apply FILE"), ("clock", "synchronise the clocks")] {
            let note = faults_note(&[fault], false).expect("a note");
            assert!(note.contains(expected), "{note}");
        }
        assert_eq!(faults_note(&[], false), None);
    }

    #[test]
    fn a_stop_that_is_shown_is_no_second_problem() {
        assert_eq!(faults_note(&["stop"], true), None);
        assert_eq!(faults_note(&["mirror", "stop"], true), faults_note(&["mirror"], false));
    }
}
