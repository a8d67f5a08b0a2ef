//! The orders of the page and their answers.
//!
//! An order is answered by the state of the process that received it, never by the click. Every
//! message of an order has a sequence number. A process that refuses it names the order in its last
//! problem, as [`order_name`](heliostat_proto::Stamp::order_name) writes it.

use std::sync::{Mutex, MutexGuard};
use std::time::{Duration, Instant};

use heliostat_service::locks::lock;
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
    /// The order and its answer in words.
    pub text: String,
    /// Its state.
    #[serde(flatten)]
    pub answer: Answer,
}

impl OrderFigures {
    pub(crate) fn new(id: u64, what: String, answer: Answer) -> Self {
        Self { id, text: format!("{what}: {}", answer.in_words()), what, answer }
    }
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
        let newest = entries.last().map_or(0, |entry| entry.id);
        let subjects: Vec<&str> = entries.iter().map(|entry| entry.published.order.subject()).collect();
        let are_replaced: Vec<bool> =
            (0..subjects.len()).map(|index| subjects[index + 1..].contains(&subjects[index])).collect();
        for (entry, is_replaced) in entries.iter_mut().zip(&are_replaced) {
            // What a later order caused, or a fault, is no late answer to this one.
            let may_be_answered = !is_replaced && (entry.id == newest || entry.changed.elapsed() < REFUSAL_SHOWN);
            if entry.answer != Answer::Sent && !(entry.answer.is_open() && may_be_answered) {
                continue;
            }
            let silent = match (entry.published.at.elapsed() >= ANSWER_LIMIT, is_replaced) {
                (false, _) => Answer::Sent,
                (true, false) => Answer::Missing,
                (true, true) => Answer::Replaced,
            };
            // An array that has returned is still to confirm it: that no array has confirmed it stays the answer.
            let open = if entry.answer == Answer::Absent { Answer::Absent } else { silent };
            let answer = entry.published.answer(reported).unwrap_or(open);
            if answer != entry.answer {
                entry.set(answer);
            }
        }
        // An answered order is over when a later one was sent; the log of events keeps it.
        let is_superseded =
            |entry: &Entry, is_replaced: bool| is_replaced || (entry.id < newest && !entry.answer.is_open());
        let shown = entries.iter().zip(&are_replaced).rev().filter(|(entry, _)| match entry.answer {
            Answer::Sent => true,
            Answer::Done | Answer::StillStopped(_) => {
                entry.changed.elapsed() < DONE_SHOWN && entry.published.answer(reported).as_ref() == Some(&entry.answer)
            }
            Answer::Refused(_) | Answer::Missing | Answer::Absent => entry.changed.elapsed() < REFUSAL_SHOWN,
            Answer::Replaced => false,
        });
        shown
            .filter(|(entry, is_replaced)| !is_superseded(entry, **is_replaced))
            .map(|(entry, _)| entry.figures())
            .collect()
    }

    /// All kept orders for the log of events, newest first, with their answers at the last review. An array that is
    /// absent for less than [`ANSWER_LIMIT`] can still return and confirm: its order has no answer yet.
    pub fn all(&self) -> Vec<OrderFigures> {
        let in_log = |entry: &Entry| {
            let is_early = entry.answer == Answer::Absent && entry.published.at.elapsed() < ANSWER_LIMIT;
            let answer = if is_early { Answer::Sent } else { entry.answer.clone() };
            OrderFigures::new(entry.id, entry.published.order.in_words(), answer)
        };
        self.lock().iter().rev().map(in_log).collect()
    }

    fn change(&self, id: u64, change: impl FnOnce(&mut Entry)) {
        if let Some(entry) = self.lock().iter_mut().find(|entry| entry.id == id) {
            change(entry);
        }
    }

    fn lock(&self) -> MutexGuard<'_, Vec<Entry>> {
        // Each change is complete before the lock is released.
        lock(&self.entries)
    }
}

impl Entry {
    fn set(&mut self, answer: Answer) {
        self.answer = answer;
        self.changed = Instant::now();
    }

    fn figures(&self) -> OrderFigures {
        OrderFigures::new(self.id, self.published.order.in_words(), self.answer.clone())
    }
}

#[cfg(test)]
mod tests {
    use heliostat_proto::NodeStatus;

    use super::*;

    /// What a simulator reports that blocks the direct paths of so many users.
    fn blocked(users: f64) -> Reported {
        let gauges = [("forced_users", users), ("faulty_mirrors", 9.0)].map(|(name, value)| (name.to_owned(), value));
        let status = NodeStatus { gauges: gauges.to_vec(), ..NodeStatus::default() };
        Reported { simulator: Some((Instant::now() + Duration::from_millis(1), status)), ..Reported::default() }
    }

    fn answers(log: &OrderLog) -> Vec<Answer> {
        log.all().into_iter().map(|order| order.answer).collect()
    }

    #[test]
    fn an_order_keeps_its_answer_for_the_log_when_a_later_one_was_sent_before_it() {
        let log = OrderLog::default();
        log.begin(&Order::Blocked { users: 5 }, Reported::default());
        log.begin(&Order::Stick { share: 0.25 }, Reported::default());
        let shown = log.review(&blocked(5.0));
        assert_eq!(shown.iter().map(|order| order.id).collect::<Vec<_>>(), [2], "the page shows the newest one");
        assert_eq!(answers(&log), [Answer::Done, Answer::Done]);
    }

    #[test]
    fn an_order_that_a_later_one_replaced_before_an_answer_is_not_without_one() {
        let log = OrderLog::default();
        for users in [5, 0] {
            log.begin(&Order::Blocked { users }, Reported::default());
        }
        log.review(&blocked(0.0));
        assert_eq!(answers(&log), [Answer::Done, Answer::Sent], "its answer can still come");
        log.lock()[0].published.at -= ANSWER_LIMIT;
        log.review(&blocked(0.0));
        assert_eq!(answers(&log), [Answer::Done, Answer::Replaced]);
    }

    #[test]
    fn a_stop_that_an_absent_array_confirms_soon_has_one_answer_in_the_log() {
        let log = OrderLog::default();
        log.begin(&Order::Stop, Reported::default());
        let shown = log.review(&Reported::default());
        assert_eq!(shown[0].answer, Answer::Absent, "the page shows it at once");
        assert_eq!(answers(&log), [Answer::Sent]);
        log.review(&Reported { array_present: true, is_stopped: true, ..Reported::default() });
        assert_eq!(answers(&log), [Answer::Done]);
    }

    #[test]
    fn an_array_that_returns_to_a_stop_confirms_it_without_another_open_answer() {
        let log = OrderLog::default();
        log.begin(&Order::Stop, Reported::default());
        log.lock()[0].published.at -= ANSWER_LIMIT;
        log.review(&Reported::default());
        assert_eq!(answers(&log), [Answer::Absent]);
        let returned = Reported { array_present: true, ..Reported::default() };
        log.review(&returned);
        assert_eq!(answers(&log), [Answer::Absent], "it has not confirmed the stop yet");
        log.review(&Reported { is_stopped: true, ..returned });
        assert_eq!(answers(&log), [Answer::Done]);
    }

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
