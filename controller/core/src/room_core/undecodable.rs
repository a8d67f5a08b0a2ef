//! Payloads that do not decode, of the keys that are no streams of reports.
//!
//! CONTRACT.md, section 2: each of them is refused and counted.

use std::collections::BTreeMap;

use heliostat_proto::{CodecError, Message, array_keys::array_name, decode};

use super::input::InputKey;
use crate::input::refusal::Refusal;

/// Counters of payloads that do not decode.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct UndecodableCounts {
    /// By topic and reason.
    counts: BTreeMap<(&'static str, &'static str), u64>,
    /// What the last one was.
    last: Option<String>,
}

impl UndecodableCounts {
    /// All payloads together.
    pub fn total(&self) -> u64 {
        self.counts.values().sum()
    }

    /// Every counter, as "topic:reason".
    pub fn named(&self) -> impl Iterator<Item = (String, u64)> {
        self.counts.iter().map(|((topic, reason), count)| (format!("{topic}:{reason}"), *count))
    }

    /// The topic of the last payload and its error.
    pub fn last(&self) -> Option<&str> {
        self.last.as_deref()
    }

    /// The message of a payload; `None` where it does not decode, which is then counted.
    pub(super) fn decode<M: Message>(&mut self, key: InputKey, payload: &[u8]) -> Option<M> {
        decode(payload).map_err(|error| self.count(key, &error)).ok()
    }

    fn count(&mut self, key: InputKey, error: &CodecError) {
        let (topic, array) = match key {
            InputKey::Capabilities(array) => ("capabilities", Some(array)),
            InputKey::Stops(array) => ("stops", Some(array)),
            InputKey::Safety(array) => ("safety", Some(array)),
            InputKey::Stop => ("stop", None),
            InputKey::Geometry => ("geometry", None),
            InputKey::Report(channel) => (channel.stream.name(), None),
        };
        *self.counts.entry((topic, Refusal::from(error).name())).or_default() += 1;
        let of = array.map_or(String::new(), |array| format!(" of {}", array_name(array)));
        self.last = Some(format!("{topic}{of}: {error}"));
    }
}

#[cfg(test)]
mod tests {
    use heliostat_proto::{Capabilities, EmergencyStop, encode};

    use super::*;

    #[test]
    fn payloads_that_do_not_decode_are_counted_by_topic_and_reason() {
        let mut counts = UndecodableCounts::default();
        let mut payload = Vec::new();
        encode(&EmergencyStop::default(), &mut payload).expect("a valid message");
        assert!(counts.decode::<EmergencyStop>(InputKey::Stop, &payload).is_some());
        assert_eq!(counts, UndecodableCounts::default());
        for cut in [1, 2] {
            assert!(counts.decode::<EmergencyStop>(InputKey::Stop, &payload[..payload.len() - cut]).is_none());
        }
        assert!(counts.decode::<Capabilities>(InputKey::Capabilities(1), &payload).is_none());
        let named: Vec<_> = counts.named().collect();
        assert_eq!(named, [("capabilities:wrong-kind".into(), 1), ("stop:truncated".into(), 2)]);
        assert_eq!(counts.total(), 3);
        assert!(counts.last().is_some_and(|last| last.starts_with("capabilities of mirrors-1: ")), "{counts:?}");
    }
}
