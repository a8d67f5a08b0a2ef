//! Counts of the received messages by key, and of the missing ones: each source numbers its
//! messages, so a gap is visible.

use std::collections::BTreeMap;
use std::fmt;

use heliostat_proto::Stamp;
use serde::Serialize;

/// Counts for one key.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct StreamAccount {
    /// Payloads written.
    pub messages: u64,
    /// Size of the written payloads in bytes.
    pub bytes: u64,
    /// Sources that published on the key; for commands, epochs.
    pub sources: u64,
    /// Messages that a source numbered and that did not arrive.
    pub missing: u64,
    /// Messages that arrived after a later one of their source, or twice.
    pub out_of_order: u64,
    /// Payloads that are not a message of the contract; they are written too.
    pub unreadable: u64,
}

/// Counts for all keys.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Account {
    /// By key.
    pub streams: BTreeMap<String, StreamAccount>,
    /// Payloads that were received and dropped, because the queue to the disk was full. They count
    /// as missing when a later message of their stream arrives.
    pub dropped: u64,
    /// The last number of each source of a key, the source that was heard last at the end.
    #[serde(skip)]
    last: BTreeMap<String, Vec<Stamp>>,
}

/// Sources of a key whose last number is kept.
const SOURCES_MAX: usize = 64;

/// Characters of a key that the table shows: a file can hold one of megabytes. Those of the contract are shorter.
const SHOWN_MAX: usize = 128;

impl Account {
    /// Counts a payload on a key; `origin` is `None` if the payload could not be decoded.
    pub fn count(&mut self, key: &str, bytes: usize, origin: Option<Stamp>) {
        let stream = entry(&mut self.streams, key);
        stream.messages += 1;
        stream.bytes += bytes as u64;
        let Some(origin) = origin else {
            stream.unreadable += 1;
            return;
        };
        let known = entry(&mut self.last, key);
        match known.iter().rposition(|last| last.source == origin.source) {
            Some(index) if origin.sequence <= known[index].sequence => {
                stream.out_of_order += 1;
                return;
            }
            // A sender can name any number.
            Some(index) => {
                let missing = origin.sequence - known.remove(index).sequence - 1;
                stream.missing = stream.missing.saturating_add(missing);
            }
            None => stream.sources += 1,
        }
        if known.len() == SOURCES_MAX {
            known.remove(0);
        }
        known.push(origin);
    }

    /// Payloads written.
    pub fn messages(&self) -> u64 {
        self.streams.values().map(|stream| stream.messages).sum()
    }

    /// Messages known to be missing on any key.
    pub fn missing(&self) -> u64 {
        self.streams.values().map(|stream| stream.missing).fold(0, u64::saturating_add)
    }
}

/// The entry of a key; the key is copied only the first time.
fn entry<'a, T: Default>(map: &'a mut BTreeMap<String, T>, key: &str) -> &'a mut T {
    if !map.contains_key(key) {
        map.insert(key.to_owned(), T::default());
    }
    map.get_mut(key).expect("inserted above")
}

impl fmt::Display for Account {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let shown = |key: &str| key.chars().take(SHOWN_MAX).collect::<String>();
        let width = self.streams.keys().map(|key| shown(key).len()).max().unwrap_or(0).max(6);
        write!(
            formatter,
            "{:<width$}{:>10}{:>12}{:>9}{:>9}{:>14}{:>12}",
            "stream", "messages", "bytes", "sources", "missing", "out of order", "unreadable"
        )?;
        for (key, stream) in &self.streams {
            let StreamAccount { messages, bytes, sources, missing, out_of_order, unreadable } = stream;
            write!(
                formatter,
                "\n{:<width$}{messages:>10}{bytes:>12}{sources:>9}{missing:>9}{out_of_order:>14}{unreadable:>12}",
                shown(key)
            )?;
        }
        if self.dropped > 0 {
            write!(formatter, "\nreceived and dropped messages: {}, the disk was too slow", self.dropped)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gaps_are_counted_by_source() {
        let mut account = Account::default();
        // Joined at 5; 7 and 8 are lost; 9 comes twice; another source begins meanwhile at 1, and its 2
        // to 4 are lost.
        for (source, sequence) in [(1, 5), (1, 6), (2, 1), (1, 9), (1, 9), (2, 5), (1, 8)] {
            account.count("users", 10, Some(Stamp { source, sequence, time_ns: 0 }));
        }
        account.count("users", 3, None);
        account.count("truth", 1, Some(Stamp { source: 1, sequence: 100, time_ns: 0 }));
        let users = account.streams["users"];
        let expected = StreamAccount { messages: 8, bytes: 73, sources: 2, missing: 5, out_of_order: 2, unreadable: 1 };
        assert_eq!(users, expected);
        assert_eq!((account.messages(), account.missing()), (9, 5));
    }

    #[test]
    fn numbers_and_keys_of_any_size_are_counted_and_shown() {
        let mut account = Account::default();
        for (source, key) in [(1, "stop".to_owned()), (2, "stop".to_owned()), (1, "k".repeat(70_000))] {
            for sequence in [1, u64::MAX] {
                account.count(&key, 1, Some(Stamp { source, sequence, time_ns: 0 }));
            }
        }
        assert_eq!((account.streams["stop"].missing, account.missing()), (u64::MAX, u64::MAX));
        let shown = account.to_string();
        let lines: Vec<usize> = shown.lines().map(str::len).collect();
        assert_eq!(lines.len(), 3, "{shown}");
        assert!(lines.iter().all(|length| *length < 300), "{lines:?}");
    }
}
