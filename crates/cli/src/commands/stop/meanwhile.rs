//! The stops that are ordered while a re-arm searches for those in force: it releases none of them.

use std::sync::{Arc, Mutex};

use anyhow::Result;
use heliostat_bus::{Bus, Subscription};
use heliostat_proto::{EmergencyStop, Nanos, StopAction, StopName, decode};
use heliostat_service::locks::lock;

/// The orders that arrive after the begin of a command.
pub(super) struct Meanwhile {
    begun_ns: Nanos,
    orders: Arc<Mutex<Vec<EmergencyStop>>>,
    _subscriptions: Vec<Subscription>,
}

impl Meanwhile {
    /// Of a command that began at this time, over these sessions.
    ///
    /// # Errors
    /// A session is closed.
    pub fn over<'a>(begun_ns: Nanos, sessions: impl IntoIterator<Item = &'a Bus>) -> Result<Self> {
        let orders = Arc::<Mutex<Vec<EmergencyStop>>>::default();
        let mut subscriptions = Vec::new();
        for bus in sessions {
            let arrived = Arc::clone(&orders);
            subscriptions.push(bus.subscribe(&bus.room().stop(), move |payload| {
                lock(&arrived).extend(decode::<EmergencyStop>(payload));
            })?);
        }
        Ok(Self { begun_ns, orders, _subscriptions: subscriptions })
    }

    /// Whether this stop was ordered since. The repetition of an earlier one has the time of that order.
    pub fn has(&self, name: StopName) -> bool {
        let is_it = |order: &EmergencyStop| order.action == StopAction::Stop && order.name() == name;
        lock(&self.orders).iter().any(|order| is_it(order) && order.stamp.time_ns >= self.begun_ns)
    }
}

#[cfg(test)]
mod tests {
    use std::time::{Duration, Instant};

    use heliostat_bus::{BusConfig, Class, private_endpoint};
    use heliostat_proto::{Room, Stamp, encode};

    use super::*;

    #[test]
    fn a_stop_that_is_ordered_during_a_command_is_told_from_the_repetition_of_an_earlier_one() {
        let endpoint = private_endpoint().expect("a free endpoint");
        let config = BusConfig::new(Room::new("meanwhile").expect("a valid name"));
        let sender = Bus::open(&config.clone().listen_at(&endpoint)).expect("a session");
        let receiver = Bus::open(&config.connect_to(&endpoint)).expect("a session");
        let meanwhile = Meanwhile::over(100, [&receiver]).expect("a subscription");
        let stops = sender.publisher(&sender.room().stop(), Class::RealTimeBlock).expect("a publisher");
        let order = |source, time_ns, action| {
            let stamp = Stamp { source, sequence: 1, time_ns };
            let mut payload = Vec::new();
            let order = EmergencyStop { stamp, action, ..EmergencyStop::default() };
            encode(&order, &mut payload).expect("a valid message");
            stops.put(&payload).expect("an open session");
        };
        let name = |source| StopName { source, sequence: 1 };
        let begun = Instant::now();
        // The last one arrives after the others.
        while !meanwhile.has(name(9)) && begun.elapsed() < Duration::from_secs(60) {
            order(7, 99, StopAction::Stop);
            order(8, 101, StopAction::Rearm);
            order(9, 100, StopAction::Stop);
            std::thread::sleep(Duration::from_millis(10));
        }
        assert_eq!([7, 8, 9].map(|source| meanwhile.has(name(source))), [false, false, true]);
    }
}
