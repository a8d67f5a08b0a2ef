//! What came on each key, and what is known to be missing: each source counts its messages, so a gap shows.

use std::collections::BTreeMap;
use std::fmt;

use serde::Serialize;

use crate::heard::Origin;

/// What came on one key.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct StreamAccount {
    /// Payloads written.
    pub messages: u64,
    /// Their bytes.
    pub bytes: u64,
    /// Sources, one after the other; for commands, epochs.
    pub sources: u64,
    /// Messages that a source counted and that did not come.
    pub missing: u64,
    /// Messages that came after a later one of their source, or twice.
    pub out_of_order: u64,
    /// Payloads that are no message of the contract; they are written all the same.
    pub unreadable: u64,
}

/// What came on all keys.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Account {
    /// By key.
    pub streams: BTreeMap<String, StreamAccount>,
    /// Payloads that were heard and not written, because the disk was slower than the room for too long. They are among the missing
    /// as soon as a later message of their stream comes.
    pub shed: u64,
    #[serde(skip)]
    last: BTreeMap<String, Origin>,
}

impl Account {
    /// Counts a payload on a key; `origin` is nothing where it could not be read.
    pub fn count(&mut self, key: &str, bytes: usize, origin: Option<Origin>) {
        let stream = entry(&mut self.streams, key);
        stream.messages += 1;
        stream.bytes += bytes as u64;
        let Some(origin) = origin else {
            stream.unreadable += 1;
            return;
        };
        match self.last.get(key) {
            Some(last) if last.source == origin.source && origin.sequence <= last.sequence => {
                stream.out_of_order += 1;
                return;
            }
            Some(last) if last.source == origin.source => stream.missing += origin.sequence - last.sequence - 1,
            _ => stream.sources += 1,
        }
        *entry(&mut self.last, key) = origin;
    }

    /// Payloads written.
    pub fn messages(&self) -> u64 {
        self.streams.values().map(|stream| stream.messages).sum()
    }

    /// Messages known to be missing on any key.
    pub fn missing(&self) -> u64 {
        self.streams.values().map(|stream| stream.missing).sum()
    }
}

/// The entry of a key; the key is copied only the first time.
fn entry<'a, T: Default>(map: &'a mut BTreeMap<String, T>, key: &str) -> &'a mut T {
    if !map.contains_key(key) {
        map.insert(key.to_owned(), T::default());
    }
    map.get_mut(key).expect("it was just put there")
}

impl fmt::Display for Account {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let width = self.streams.keys().map(String::len).max().unwrap_or(0).max(6);
        write!(
            formatter,
            "{:<width$}{:>10}{:>12}{:>9}{:>9}{:>14}{:>12}",
            "stream", "messages", "bytes", "sources", "missing", "out of order", "unreadable"
        )?;
        for (key, stream) in &self.streams {
            let StreamAccount { messages, bytes, sources, missing, out_of_order, unreadable } = stream;
            write!(
                formatter,
                "\n{key:<width$}{messages:>10}{bytes:>12}{sources:>9}{missing:>9}{out_of_order:>14}{unreadable:>12}"
            )?;
        }
        if self.shed > 0 {
            write!(formatter, "\n{} messages were heard and not written: the disk was too slow", self.shed)?;
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
        // Joined at 5; 7 and 8 are lost; 9 comes twice; then another source begins anew, and 2 to 4 of it are lost.
        for (source, sequence) in [(1, 5), (1, 6), (1, 9), (1, 9), (1, 8), (2, 1), (2, 5)] {
            account.count("users", 10, Some(Origin { source, sequence, time_ns: 0 }));
        }
        account.count("users", 3, None);
        account.count("truth", 1, Some(Origin { source: 1, sequence: 100, time_ns: 0 }));
        let users = account.streams["users"];
        let wanted = StreamAccount { messages: 8, bytes: 73, sources: 2, missing: 5, out_of_order: 2, unreadable: 1 };
        assert_eq!(users, wanted);
        assert_eq!((account.messages(), account.missing()), (9, 5));
    }
}
