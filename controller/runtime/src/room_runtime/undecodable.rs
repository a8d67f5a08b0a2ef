//! Payloads that do not decode, of the topics that the decision loop does not receive.
//!
//! CONTRACT.md, section 2: each of them is refused and counted.

use std::{
    collections::BTreeMap,
    sync::{Arc, Mutex},
};

use heliostat_core::refusal::Refusal;
use heliostat_proto::{CodecError, Message, array_keys::array_name, decode};

use super::locks::lock;

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

    fn count(&mut self, topic: &'static str, array: Option<usize>, error: &CodecError) {
        *self.counts.entry((topic, Refusal::from(error).name())).or_default() += 1;
        let of = array.map_or(String::new(), |array| format!(" of {}", array_name(array)));
        self.last = Some(format!("{topic}{of}: {error}"));
    }
}

/// Decodes payloads, and counts those that do not decode. Clones share their counters.
#[derive(Clone, Debug, Default)]
pub struct Decoder(Arc<Mutex<UndecodableCounts>>);

impl Decoder {
    /// The message of a payload of a topic, and of an array if the topic is one of an array; `None`
    /// where it does not decode, which is then counted.
    pub fn decode<M: Message>(&self, topic: &'static str, array: Option<usize>, payload: &[u8]) -> Option<M> {
        decode(payload).map_err(|error| lock(&self.0).count(topic, array, &error)).ok()
    }

    /// The counters so far.
    pub fn counts(&self) -> UndecodableCounts {
        lock(&self.0).clone()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use heliostat_proto::{Capabilities, EmergencyStop, encode};

    #[test]
    fn payloads_that_do_not_decode_are_counted_by_topic_and_reason() {
        let decoder = Decoder::default();
        let mut payload = Vec::new();
        encode(&EmergencyStop::default(), &mut payload).expect("a valid message");
        assert!(decoder.decode::<EmergencyStop>("stop", None, &payload).is_some());
        assert_eq!(decoder.counts(), UndecodableCounts::default());
        for cut in [1, 2] {
            assert!(decoder.decode::<EmergencyStop>("stop", None, &payload[..payload.len() - cut]).is_none());
        }
        assert!(decoder.decode::<Capabilities>("capabilities", Some(1), &payload).is_none());
        let counts = decoder.clone().counts();
        let named: Vec<_> = counts.named().collect();
        assert_eq!(named, [("capabilities:wrong-kind".into(), 1), ("stop:truncated".into(), 2)]);
        assert_eq!(counts.total(), 3);
        assert!(counts.last().is_some_and(|last| last.starts_with("capabilities of mirrors-1: ")), "{counts:?}");
    }
}
