//! The orders of the page's buttons: checks them, and publishes them as messages of the contract.
//!
//! - Policy: the controller's control key.
//! - Power, blocked users, speed and mirror faults: the simulator's control key.
//! - Emergency stop and re-arm: keys of their own, see [`crate::stop_switch`].
//! - Killing or restarting the controller: no message. The program that started the processes
//!   receives a [`ProcessOrder`] over a channel, if there is one.

use std::sync::mpsc::Sender;
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Duration;

use heliostat_bus::{Bus, Token};
use heliostat_proto::{ControllerControl, FaultKind, MAX_USERS, MirrorFault, NodeKind, SimulatorControl};
use heliostat_service::locks::lock;
use heliostat_service::printable::printable;
use heliostat_service::source_id;

use crate::order::{Order, ProcessOrder};
use crate::order_answer::Reported;
use crate::order_log::{OrderFigures, OrderLog};
use crate::order_publisher::OrderPublisher;
use crate::rights::Rights;
use crate::stop_state::{StopFigures, StopState};
use crate::stop_switch::StopSwitch;
use crate::{UiError, View};

/// Longest wait for telemetry that confirms a stop; the stop is repeated until then.
const STOP_LIMIT: Duration = Duration::from_secs(2);
/// Reason in the stops and re-arms of the page.
const BUTTON: &str = "button";
/// Seed that selects the mirrors that stick; a fixed seed selects the same mirrors each time.
const STUCK_SEED: u64 = 1;
/// Highest optical power that the page may order, in W.
const POWER_MAX_W: f32 = 100.0;
/// Highest walking speed that the page may order, in m/s.
const SPEED_MAX_M_S: f32 = 10.0;

/// Sends orders into a room.
pub struct Operator {
    source: u64,
    rights: Rights,
    stop: StopSwitch,
    simulator: OrderPublisher,
    controller: OrderPublisher,
    processes: Option<Sender<ProcessOrder>>,
    log: OrderLog,
    stop_state: Mutex<StopState>,
    _token: Token,
}

impl Operator {
    /// An operator in the room of a session and its view. `processes` leads to the program that started the
    /// processes; `None` if they were started separately.
    ///
    /// # Errors
    /// [`UiError::Bus`] if the session is closed.
    pub fn new(bus: &Bus, view: &View, processes: Option<Sender<ProcessOrder>>) -> Result<Self, UiError> {
        let room = bus.room();
        let source = source_id::random();
        let operator = Self {
            source,
            rights: Rights::All,
            stop: StopSwitch::of(bus, "heliostat ui", Arc::clone(&view.stops))?,
            simulator: OrderPublisher::new(bus, "simulated room", &room.simulator_control())?,
            controller: OrderPublisher::new(bus, "controller", &room.controller_control())?,
            processes,
            log: OrderLog::default(),
            stop_state: Mutex::default(),
            _token: bus.announce(&room.alive(NodeKind::Viewer, source))?,
        };
        if operator.controls_processes() {
            view.advise_restart();
        }
        Ok(operator)
    }

    /// Refuses the orders that these rights exclude.
    #[must_use]
    pub fn with_rights(self, rights: Rights) -> Self {
        Self { rights, ..self }
    }

    /// The orders that this operator may give.
    pub(crate) fn rights(&self) -> Rights {
        self.rights
    }

    /// The random id of this operator in its messages.
    pub(crate) fn source(&self) -> u64 {
        self.source
    }

    /// Whether this operator can kill and restart the controller.
    pub fn controls_processes(&self) -> bool {
        self.processes.is_some()
    }

    /// Checks an order and sends it; returns its number. The state of its receiver is the answer, see
    /// [`Operator::answers`].
    ///
    /// # Errors
    /// - [`UiError::InvalidOrder`] if a value is outside its domain; nothing was sent.
    /// - [`UiError::NoRight`] if its rights exclude the order; nothing was sent.
    /// - [`UiError::NoProcessControl`] if the processes were started separately.
    /// - [`UiError::NoReceiver`] if the order was published without a subscriber.
    /// - [`UiError::NotStopped`] for a re-arm of an array that reports no stop.
    /// - [`UiError::StopUnconfirmed`] for a stop that not every array confirmed.
    /// - [`UiError::Bus`] if the session is closed.
    pub fn send(&self, order: &Order, view: &View) -> Result<u64, UiError> {
        let id = self.log.begin(order, self.reported(view));
        let permitted = self.rights.check(order).and_then(|()| order.check());
        let sent = permitted.and_then(|()| self.publish(order, id));
        if let Err(error) = &sent {
            let is_answered = match error {
                // The arrays can confirm a stop at any later time.
                UiError::StopUnconfirmed { .. } => true,
                // The log answers that no array is present.
                UiError::NoReceiver(_) => {
                    matches!(order, Order::Stop | Order::Rearm { .. }) && !view.reported().array_present
                }
                _ => false,
            };
            if !is_answered {
                self.log.refused(id, error.to_string());
            }
        }
        sent.map(|()| id)
    }

    /// The last orders and their answers, newest first.
    pub fn answers(&self, view: &View) -> Vec<OrderFigures> {
        self.log.review(&self.reported(view))
    }

    /// All kept orders with their last [`answers`](Self::answers), newest first: the log of events has those too that
    /// the page no longer shows.
    pub(crate) fn kept(&self) -> Vec<OrderFigures> {
        self.log.all()
    }

    /// The emergency stop, as far as the arrays confirmed it. Held stops are repeated when that is due.
    pub fn stop_figures(&self) -> StopFigures {
        self.stop.repeat();
        self.stop_state().update(&self.stop.room_stops())
    }

    /// What the processes and arrays report, as far as it answers orders.
    fn reported(&self, view: &View) -> Reported {
        let room = self.stop.room_stops();
        Reported { is_stopped: room.is_confirmed(), held_stops: room.stops, ..view.reported() }
    }

    fn stop_state(&self) -> MutexGuard<'_, StopState> {
        // Each change is complete before the lock is released.
        lock(&self.stop_state)
    }

    fn publish(&self, order: &Order, id: u64) -> Result<(), UiError> {
        match order {
            Order::Policy { name } => self.controller.publish(self.source, |stamp| {
                self.log.published(id, stamp.order_name());
                ControllerControl { stamp, policy: name.clone() }
            }),
            Order::Power { watts } => self.control_simulator(id, |control| control.power_w = Some(*watts)),
            Order::Blocked { users } => self.control_simulator(id, |control| control.forced_users = Some(*users)),
            Order::Speed { max_m_s } => {
                self.control_simulator(id, |control| control.speed_m_s = Some([max_m_s / 20.0, *max_m_s]))
            }
            Order::Stick { share } => self.set_fault(id, FaultKind::Stuck, *share),
            Order::Release {} => self.set_fault(id, FaultKind::Healed, 1.0),
            Order::Stop => self.stop.stop_and_confirm(BUTTON, STOP_LIMIT).map(drop),
            Order::Rearm { stops } => {
                let names: Vec<_> = stops.iter().map(|stop| stop.0).collect();
                self.stop.rearm(&names, BUTTON)
            }
            Order::KillController {} => self.control_processes(ProcessOrder::KillController, "kill the controller"),
            Order::RestartController {} => {
                self.control_processes(ProcessOrder::RestartController, "restart the controller")
            }
        }
    }

    fn control_simulator(&self, id: u64, set: impl FnOnce(&mut SimulatorControl)) -> Result<(), UiError> {
        self.simulator.publish(self.source, |stamp| {
            self.log.published(id, stamp.order_name());
            let mut control = SimulatorControl { stamp, ..SimulatorControl::default() };
            set(&mut control);
            control
        })
    }

    fn set_fault(&self, id: u64, fault: FaultKind, share: f32) -> Result<(), UiError> {
        let fault = MirrorFault { fault, share, seed: STUCK_SEED, ..MirrorFault::default() };
        self.control_simulator(id, |control| control.faults.push(fault))
    }

    fn control_processes(&self, order: ProcessOrder, action: &'static str) -> Result<(), UiError> {
        // The program that receives process orders may be ending.
        let is_sent = self.processes.as_ref().is_some_and(|processes| processes.send(order).is_ok());
        if is_sent { Ok(()) } else { Err(UiError::NoProcessControl(action)) }
    }
}

impl Order {
    /// The order in words, for the page.
    pub(crate) fn in_words(&self) -> String {
        match self {
            Self::Policy { name } => format!("policy {}", printable(name)),
            Self::Power { watts } => format!("optical power {watts} W"),
            Self::Blocked { users: 0 } => "block no direct path".into(),
            Self::Blocked { users: 1 } => "block the direct path of 1 user".into(),
            Self::Blocked { users } => format!("block the direct path of {users} users"),
            Self::Speed { max_m_s } => format!("walking speed {max_m_s} m/s"),
            Self::Stick { share } => format!("jam {:.0} % of the mirrors", share * 100.0),
            Self::Release {} => "release the jammed mirrors".into(),
            Self::Stop => "stop".into(),
            Self::Rearm { .. } => "re-arm".into(),
            Self::KillController {} => "kill the controller".into(),
            Self::RestartController {} => "restart the controller".into(),
        }
    }

    /// Checks every value against its domain. The receiver checks it again with its own limits.
    fn check(&self) -> Result<(), UiError> {
        let invalid = |name, value: String, expected: String| Err(UiError::InvalidOrder { name, value, expected });
        match self {
            Self::Policy { name } if name.is_empty() || name.len() > 64 => {
                invalid("policy", format!("{name:.70}"), "the name of a policy, 1 to 64 bytes".into())
            }
            Self::Power { watts } if !(*watts > 0.0 && *watts <= POWER_MAX_W) => {
                invalid("power", format!("{watts} W"), format!("more than 0 and at most {POWER_MAX_W} W"))
            }
            Self::Blocked { users } if *users as usize > MAX_USERS => {
                invalid("number of blocked users", users.to_string(), format!("at most {MAX_USERS}"))
            }
            Self::Speed { max_m_s } if !(0.0..=SPEED_MAX_M_S).contains(max_m_s) => {
                invalid("speed", format!("{max_m_s} m/s"), format!("0 to {SPEED_MAX_M_S} m/s"))
            }
            Self::Stick { share } if !(*share > 0.0 && *share <= 1.0) => {
                invalid("share of mirrors", share.to_string(), "more than 0 and at most 1".into())
            }
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn orders_are_parsed_strictly_and_their_values_are_checked() {
        let parse = |text: &str| serde_json::from_str::<Order>(text);
        assert_eq!(parse(r#"{"order":"power","watts":1.5}"#).expect("an order"), Order::Power { watts: 1.5 });
        assert_eq!(parse(r#"{"order":"kill-controller"}"#).expect("an order"), Order::KillController {});
        assert_eq!(parse(r#"{"order":"restart-controller"}"#).expect("an order"), Order::RestartController {});
        assert!(parse(r#"{"order":"power","watts":1.5,"volts":3}"#).is_err());
        for order in [r#""kill-controller""#, r#""restart-controller""#, r#""release""#, r#""rearm","stops":[]"#] {
            assert!(parse(&format!(r#"{{"order":{order}}}"#)).is_ok(), "{order}");
            assert!(parse(&format!(r#"{{"order":{order},"volts":3}}"#)).is_err(), "{order}");
        }
        assert_eq!(parse(r#"{"order":"stop","volts":3}"#).expect("every stop is obeyed"), Order::Stop);
        assert!(parse(r#"{"order":"explode"}"#).is_err());
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
