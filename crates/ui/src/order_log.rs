//! The orders of the page and their answers.
//!
//! An order is answered by the state of the process that received it, never by the click. Every
//! message of an order has a sequence number. A process that refuses it names the order in its last
//! problem, as [`order_name`](heliostat_proto::Stamp::order_name) writes it.

use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use serde::Serialize;

use crate::order::Order;
use crate::order_answer::{Answer, Published, Reported};

/// After this time without an answer, the page says that there is none.
const ANSWER_LIMIT: Duration = Duration::from_secs(5);
/// An order that took effect is shown this long.
const DONE_SHOWN: Duration = Duration::from_secs(5);
/// A refusal, or a missing answer, is shown this long unless a later order is sent.
const REFUSAL_SHOWN: Duration = Duration::from_secs(20);
/// Maximum number of orders that are kept.
const ENTRIES_MAX: usize = 16;

/// An order as the page shows it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct OrderFigures {
    /// Number of the order, as in the answer to its request.
    pub id: u64,
    /// The order in words.
    pub what: String,
    /// Its state.
    #[serde(flatten)]
    pub answer: Answer,
}

/// An order, from its request until it is no longer shown.
#[derive(Clone, Debug)]
struct Entry {
    id: u64,
    published: Published,
    answer: Answer,
    changed: Instant,
}

/// The last orders.
#[derive(Debug, Default)]
pub(crate) struct OrderLog {
    entries: Mutex<Vec<Entry>>,
}

impl OrderLog {
    /// Begins an order; returns its number.
    pub fn begin(&self, order: &Order, before: Reported) -> u64 {
        let mut entries = self.lock();
        let id = entries.last().map_or(1, |last| last.id + 1);
        if entries.len() >= ENTRIES_MAX {
            entries.remove(0);
        }
        let now = Instant::now();
        let published = Published { order: order.clone(), at: now, tag: String::new(), before };
        entries.push(Entry { id, published, answer: Answer::Sent, changed: now });
        id
    }

    /// Notes the name of a published order.
    pub fn published(&self, id: u64, tag: String) {
        self.change(id, |entry| entry.published.tag = tag);
    }

    /// Notes that an order was not sent, or reached no receiver.
    pub fn refused(&self, id: u64, reason: String) {
        self.change(id, |entry| entry.set(Answer::Refused(reason)));
    }

    /// Compares the orders with what the processes report, and returns those to show, newest first.
    pub fn review(&self, reported: &Reported) -> Vec<OrderFigures> {
        let mut entries = self.lock();
        for entry in entries.iter_mut().filter(|entry| entry.answer.is_open()) {
            let is_late = entry.published.at.elapsed() >= ANSWER_LIMIT;
            let silent = if is_late { Answer::Missing } else { Answer::Sent };
            let answer = entry.published.answer(reported).unwrap_or(silent);
            if answer != entry.answer {
                entry.set(answer);
            }
        }
        let newest = entries.last().map_or(0, |entry| entry.id);
        // An answered order is over when a later one was sent; the log of events keeps it.
        let is_superseded = |entry: &Entry| {
            let kind = std::mem::discriminant(&entry.published.order);
            let is_repeated = entries
                .iter()
                .any(|later| later.id > entry.id && std::mem::discriminant(&later.published.order) == kind);
            is_repeated || (entry.id < newest && !entry.answer.is_open())
        };
        let shown = entries.iter().rev().filter(|entry| match entry.answer {
            Answer::Sent => true,
            Answer::Done | Answer::StillStopped(_) => {
                entry.changed.elapsed() < DONE_SHOWN && entry.published.answer(reported).as_ref() == Some(&entry.answer)
            }
            Answer::Refused(_) | Answer::Missing | Answer::Absent => entry.changed.elapsed() < REFUSAL_SHOWN,
        });
        let shown = shown.filter(|entry| !is_superseded(entry));
        shown
            .map(|entry| OrderFigures {
                id: entry.id,
                what: entry.published.order.in_words(),
                answer: entry.answer.clone(),
            })
            .collect()
    }

    fn change(&self, id: u64, change: impl FnOnce(&mut Entry)) {
        if let Some(entry) = self.lock().iter_mut().find(|entry| entry.id == id) {
            change(entry);
        }
    }

    fn lock(&self) -> MutexGuard<'_, Vec<Entry>> {
        // Each change is complete before the lock is released.
        self.entries.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Entry {
    fn set(&mut self, answer: Answer) {
        self.answer = answer;
        self.changed = Instant::now();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_old_refusal_does_not_return_when_a_later_order_is_done() {
        let log = OrderLog::default();
        let refused = log.begin(&Order::Policy { name: "clairvoyant".into() }, Reported::default());
        log.refused(refused, "there is no such policy".into());
        let shown = |reported: &Reported| log.review(reported).into_iter().map(|order| order.what).collect::<Vec<_>>();
        assert_eq!(shown(&Reported::default()), ["policy clairvoyant"]);
        log.begin(&Order::Stop, Reported::default());
        let stopped = Reported { array_present: true, is_stopped: true, ..Reported::default() };
        assert_eq!(shown(&stopped), ["stop"]);
        // The stop is no longer in force, so its answer is not shown; the refusal stays away too.
        let released = Reported { array_present: true, ..Reported::default() };
        assert_eq!(shown(&released), Vec::<String>::new());
    }
}
