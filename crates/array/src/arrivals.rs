//! The bounded queue of messages for an array.

use std::collections::VecDeque;

use crate::content::Content;
use crate::moment::Moment;
use crate::watch::IsStop;

/// Capacity for stops, and for all other messages; beyond it the oldest is dropped.
const CAPACITY: usize = 256;

/// A received message.
#[derive(Clone, Debug)]
pub struct Arrival {
    /// When it arrived, before it was decoded.
    pub at: Moment,
    /// Its content.
    pub content: Content,
}

/// A bounded queue in which emergency stops have priority, and commands cannot displace them.
#[derive(Debug, Default)]
pub struct Arrivals {
    stops: VecDeque<Arrival>,
    others: VecDeque<Arrival>,
    dropped: u64,
    /// Whether the driver ends.
    is_ending: bool,
}

impl Arrivals {
    /// The driver ends: commands, waiting and later ones, are no messages. No telemetry would show what they moved.
    pub fn end(&mut self) {
        self.is_ending = true;
        self.others.retain(|queued| !queued.content.is_command());
    }

    /// Adds a message.
    pub fn push(&mut self, at: Moment, content: Content) {
        if self.is_ending && content.is_command() {
            return;
        }
        let target = if content.concerns_stops() { &mut self.stops } else { &mut self.others };
        let arrival = Arrival { at, content };
        if target.len() == CAPACITY {
            self.dropped += 1;
            // Undecodable payloads and re-arms on the key of the stop must not displace a stop.
            let least = target.iter().position(|queued| !queued.content.is_stop());
            match least {
                Some(index) => drop(target.remove(index)),
                None if arrival.content.concerns_stops() && !arrival.content.is_stop() => return,
                None => drop(target.pop_front()),
            }
        }
        target.push_back(arrival);
    }

    /// The next message, if any.
    pub fn pop(&mut self) -> Option<Arrival> {
        self.stops.pop_front().or_else(|| self.others.pop_front())
    }

    /// Whether a stop waits for which this holds.
    pub fn has_stop(&self, is_stop: IsStop<'_>) -> bool {
        self.stops.iter().any(|queued| queued.content.is_stop() && is_stop(&queued.content))
    }

    /// Whether no message waits.
    pub fn is_empty(&self) -> bool {
        self.stops.is_empty() && self.others.is_empty()
    }

    /// Messages that were dropped because the queue was full.
    pub fn dropped(&self) -> u64 {
        self.dropped
    }
}

#[cfg(test)]
mod tests {
    use heliostat_proto::{EmergencyStop, MirrorCommand, StopAction};

    use super::*;

    fn command() -> Content {
        Content::Command(Ok(MirrorCommand::default()))
    }

    #[test]
    fn keeps_order_drops_the_oldest_and_gives_stops_priority() {
        let mut queue = Arrivals::default();
        queue.push(Moment::simulated(0), command());
        queue.push(Moment::simulated(0), Content::Stop(Ok(EmergencyStop::default())));
        for i in 1..CAPACITY as u64 + 3 {
            queue.push(Moment::simulated(i), command());
        }
        assert_eq!(queue.dropped(), 3);
        assert!(matches!(queue.pop().unwrap().content, Content::Stop(_)));
        assert_eq!(queue.pop().unwrap().at, Moment::simulated(3));
    }

    #[test]
    fn an_ending_driver_gets_stops_and_no_command() {
        let mut queue = Arrivals::default();
        let stop = || Content::Stop(Ok(EmergencyStop::default()));
        queue.push(Moment::simulated(0), command());
        queue.push(Moment::simulated(1), stop());
        queue.end();
        queue.push(Moment::simulated(2), command());
        queue.push(Moment::simulated(3), stop());
        let all: Vec<Arrival> = std::iter::from_fn(|| queue.pop()).collect();
        assert!(all.len() == 2 && all.iter().all(|queued| queued.content.is_stop()), "{all:?}");
    }

    #[test]
    fn nothing_else_on_the_key_of_the_stop_displaces_a_stop() {
        let mut queue = Arrivals::default();
        queue.push(Moment::simulated(0), Content::Stop(Ok(EmergencyStop::default())));
        let rearm = EmergencyStop { action: StopAction::Rearm, ..EmergencyStop::default() };
        for i in 1..2 * CAPACITY as u64 {
            queue.push(Moment::simulated(i), Content::Stop(Ok(rearm.clone())));
        }
        assert_eq!(queue.pop().expect("a message").at, Moment::simulated(0), "the stop is first in the queue");
        for i in 0..=CAPACITY as u64 {
            queue.push(Moment::simulated(i), Content::Stop(Ok(EmergencyStop::default())));
        }
        queue.push(Moment::simulated(9), Content::Stop(Ok(rearm)));
        let all: Vec<Arrival> = std::iter::from_fn(|| queue.pop()).collect();
        assert!(
            all.len() == CAPACITY && all.iter().all(|queued| queued.content.is_stop()),
            "a queue of stops admits no re-arm"
        );
    }
}
