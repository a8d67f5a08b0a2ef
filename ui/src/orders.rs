//! What a button does: an order, checked, and sent as a message of the contract.
//!
//! Policy, power, people, speed and mirror faults travel as operators' messages, the stop under its own key. To kill or revive a process
//! is no message: it is an [`Errand`] for whoever started it, where there is one.

use std::sync::Mutex;
use std::sync::PoisonError;
use std::sync::mpsc::Sender;
use std::thread;
use std::time::{Duration, Instant};

use heliostat_bus::{Bus, Class, Publisher, Token};
use heliostat_proto::{
    ControllerControl, EmergencyStop, FaultKind, MAX_USERS, Message, MirrorFault, NodeKind, SimulatorControl, Stamp,
    StopAction, codec,
};
use heliostat_service::{clock::utc_ns, source_id};
use serde::Deserialize;

use crate::UiError;

/// Whoever has just joined is found within this time.
const HEARD_WITHIN: Duration = Duration::from_secs(1);
const HEARD_EVERY: Duration = Duration::from_millis(20);
/// Which mirrors stick: another seed would be other ones.
const STUCK_SEED: u64 = 1;
/// Most that the page asks of a lamp, in W.
const POWER_MAX_W: f32 = 100.0;
/// Most that the page asks of people, in m/s.
const SPEED_MAX_M_S: f32 = 10.0;

/// What somebody ordered.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(tag = "order", rename_all = "kebab-case", deny_unknown_fields)]
pub enum Order {
    /// Let another policy decide.
    Policy {
        /// As on the controller's command line.
        name: String,
    },
    /// Change the optical power.
    Power {
        /// In W, more than 0.
        watts: f32,
    },
    /// Switch the direct path of the first so many users off, and that of the others on.
    Blocked {
        /// How many.
        users: u32,
    },
    /// Let people walk faster or slower; 0 lets them stand.
    Speed {
        /// Fastest speed of a leg in m/s; the slowest is a twentieth of it.
        max_m_s: f32,
    },
    /// Let some of the mirrors stick where they are.
    Stick {
        /// Share of all mirrors, above 0 and at most 1.
        share: f32,
    },
    /// Let all mirrors follow again.
    Release,
    /// Emergency stop.
    Stop,
    /// End of the emergency stop.
    Rearm,
    /// Kill the controller's process.
    KillController,
    /// Start a new controller.
    ReviveController,
}

/// What only the process that started the others can do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Errand {
    /// Kill the controller, without a warning.
    KillController,
    /// Start a controller where there is none.
    ReviveController,
}

/// Sends orders into a room.
pub struct Operator {
    source: u64,
    stop: Line,
    simulator: Line,
    controller: Line,
    errands: Option<Sender<Errand>>,
    _token: Token,
}

/// A publisher that counts.
struct Line {
    /// Who is to hear it.
    hearer: &'static str,
    publisher: Publisher,
    sequence: Mutex<u64>,
}

impl Operator {
    /// An operator in the room of a session; `errands` goes to whoever owns the processes, where somebody does.
    ///
    /// # Errors
    /// [`UiError::Bus`] where the session is closed.
    pub fn new(bus: &Bus, errands: Option<Sender<Errand>>) -> Result<Self, UiError> {
        let room = bus.room();
        let source = source_id::random();
        let line = |hearer, key: &str| {
            let publisher = bus.publisher(key, Class::Order)?;
            Ok::<_, UiError>(Line { hearer, publisher, sequence: Mutex::new(0) })
        };
        Ok(Self {
            source,
            stop: line("array", &room.stop())?,
            simulator: line("simulated room", &room.simulator_control())?,
            controller: line("controller", &room.controller_control())?,
            errands,
            _token: bus.announce(&room.alive(NodeKind::Viewer, source))?,
        })
    }

    /// Whether somebody kills and revives on order.
    pub fn owns_processes(&self) -> bool {
        self.errands.is_some()
    }

    /// Checks an order and sends it. Whether it takes effect shows in the topics.
    ///
    /// # Errors
    /// [`UiError::Order`] for an order without sense, [`UiError::NotOwned`] where nobody can carry it out, [`UiError::Unheard`] where it was
    /// sent and nobody was there to hear it, [`UiError::Bus`] where the session is closed.
    pub fn send(&self, order: &Order) -> Result<(), UiError> {
        order.check()?;
        match order {
            Order::Policy { name } => {
                self.controller.say(self.source, |stamp| ControllerControl { stamp, policy: name.clone() })
            }
            Order::Power { watts } => self.change(|control| control.power_w = Some(*watts)),
            Order::Blocked { users } => self.change(|control| control.forced_users = Some(*users)),
            Order::Speed { max_m_s } => self.change(|control| control.speed_m_s = Some([max_m_s / 20.0, *max_m_s])),
            Order::Stick { share } => self.befall(FaultKind::Stuck, *share),
            Order::Release => self.befall(FaultKind::Healed, 1.0),
            Order::Stop => self.halt(StopAction::Stop),
            Order::Rearm => self.halt(StopAction::Rearm),
            Order::KillController => self.run(Errand::KillController, "kill the controller"),
            Order::ReviveController => self.run(Errand::ReviveController, "revive the controller"),
        }
    }

    fn change(&self, set: impl FnOnce(&mut SimulatorControl)) -> Result<(), UiError> {
        self.simulator.say(self.source, |stamp| {
            let mut control = SimulatorControl { stamp, ..SimulatorControl::default() };
            set(&mut control);
            control
        })
    }

    fn befall(&self, fault: FaultKind, share: f32) -> Result<(), UiError> {
        let fault = MirrorFault { fault, share, seed: STUCK_SEED, ..MirrorFault::default() };
        self.change(|control| control.faults.push(fault))
    }

    fn halt(&self, action: StopAction) -> Result<(), UiError> {
        self.stop.say(self.source, |stamp| EmergencyStop {
            stamp,
            action,
            operator: "heliostat ui".into(),
            reason: "button".into(),
        })
    }

    fn run(&self, errand: Errand, what: &'static str) -> Result<(), UiError> {
        // Who owned the processes may be about to end.
        let sent = self.errands.as_ref().is_some_and(|errands| errands.send(errand).is_ok());
        if sent { Ok(()) } else { Err(UiError::NotOwned(what)) }
    }
}

impl Line {
    /// Waits a little for somebody who hears, then sends in any case.
    fn say<M: Message>(&self, source: u64, message: impl FnOnce(Stamp) -> M) -> Result<(), UiError> {
        let heard = self.is_heard()?;
        // Held while publishing, so that numbers go out in order.
        let mut sequence = self.sequence.lock().unwrap_or_else(PoisonError::into_inner);
        *sequence += 1;
        let mut payload = Vec::new();
        codec::encode(&message(Stamp { source, sequence: *sequence, time_ns: utc_ns() }), &mut payload)?;
        self.publisher.put(&payload)?;
        if heard { Ok(()) } else { Err(UiError::Unheard(self.hearer)) }
    }

    fn is_heard(&self) -> Result<bool, UiError> {
        let given_up = Instant::now() + HEARD_WITHIN;
        loop {
            let heard = self.publisher.is_heard()?;
            if heard || Instant::now() >= given_up {
                return Ok(heard);
            }
            thread::sleep(HEARD_EVERY);
        }
    }
}

impl Order {
    /// Whether the order has sense; whoever obeys it checks it against their own limits.
    fn check(&self) -> Result<(), UiError> {
        let refuse = |what, value: String, wanted| Err(UiError::Order { what, value, wanted });
        match self {
            Self::Policy { name } if name.is_empty() || name.len() > 64 => {
                refuse("policy", format!("{name:.70}"), "the name of a policy")
            }
            Self::Power { watts } if !(*watts > 0.0 && *watts <= POWER_MAX_W) => {
                refuse("power", format!("{watts} W"), "more than 0 and at most 100 W")
            }
            Self::Blocked { users } if *users as usize > MAX_USERS => {
                refuse("blocked users", users.to_string(), "at most 64")
            }
            Self::Speed { max_m_s } if !(0.0..=SPEED_MAX_M_S).contains(max_m_s) => {
                refuse("speed", format!("{max_m_s} m/s"), "0 to 10 m/s")
            }
            Self::Stick { share } if !(*share > 0.0 && *share <= 1.0) => {
                refuse("share of mirrors", share.to_string(), "more than 0 and at most 1")
            }
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn orders_are_read_by_name_and_checked() {
        let read = |text: &str| serde_json::from_str::<Order>(text);
        assert_eq!(read(r#"{"order":"power","watts":1.5}"#).expect("an order"), Order::Power { watts: 1.5 });
        assert_eq!(read(r#"{"order":"kill-controller"}"#).expect("an order"), Order::KillController);
        assert!(read(r#"{"order":"power","watts":1.5,"volts":3}"#).is_err());
        assert!(read(r#"{"order":"explode"}"#).is_err());
        for bad in [
            Order::Power { watts: 0.0 },
            Order::Power { watts: f32::NAN },
            Order::Blocked { users: 65 },
            Order::Speed { max_m_s: -1.0 },
            Order::Stick { share: 1.5 },
            Order::Policy { name: String::new() },
        ] {
            assert!(bad.check().is_err(), "{bad:?}");
        }
        assert!(Order::Speed { max_m_s: 0.0 }.check().is_ok());
    }
}
