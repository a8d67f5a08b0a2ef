//! The stops that a controller holds, in words.

use std::borrow::Cow;

use heliostat_proto::{NodeStatus, array_keys::array_name, clock_time, cut, stop_hold::HeldStop};

use super::Controller;
use crate::output::guard::describe_stop;

/// Stops in the state of a status.
const STOPS_SHOWN: usize = 3;

/// Characters of an operator's name and reason in it.
const STOP_CHARACTERS: usize = 30;

impl Controller {
    /// The stops that withhold commands, as long as a message may hold the text, empty for none; those of a part of the
    /// arrays with their names. Texts of operators pass `printable`.
    pub fn describe_stops(&self, printable: impl Fn(&str) -> Cow<'_, str>) -> String {
        let arrays = 0..self.arrays();
        let mut texts: Vec<(String, Vec<usize>)> = Vec::new();
        for array in arrays.clone() {
            for HeldStop { name, operator, reason, since_ns, .. } in self.stops(array) {
                let [operator, reason] = [operator, reason].map(|text| shortened(printable(text)));
                let text = format!("{} since {}", describe_stop(*name, &operator, &reason), clock_time(*since_ns));
                match texts.iter_mut().find(|(known, _)| *known == text) {
                    // Two stops of one array can have one text.
                    Some((_, arrays)) if arrays.contains(&array) => {}
                    Some((_, arrays)) => arrays.push(array),
                    None => texts.push((text, vec![array])),
                }
            }
        }
        let parts: Vec<String> = texts
            .into_iter()
            .take(STOPS_SHOWN)
            .map(|(text, held)| match held.len() == arrays.len() {
                true => text,
                false => {
                    let names: Vec<String> = held.iter().map(|array| array_name(*array)).collect();
                    format!("{text} from {}", names.join(" and "))
                }
            })
            .collect();
        if parts.is_empty() {
            return String::new();
        }
        cut(&format!("{}{}", NodeStatus::WITHHELD_BY, parts.join("; "))).to_owned()
    }
}

/// A text of another process, short enough for a status.
fn shortened(text: Cow<'_, str>) -> String {
    match text.char_indices().nth(STOP_CHARACTERS) {
        Some((end, _)) => format!("{}...", &text[..end]),
        None => text.into_owned(),
    }
}
