//! Which orders the certificate of a page permits.

use heliostat_bus::AccessRole;
use heliostat_proto::Room;

use crate::UiError;
use crate::order::Order;

/// What a page without an operator's rights can do, and what its other buttons need.
const STOP_ONLY: &str =
    "with the certificate of a viewer only the stop button acts; the others need that of an operator";

/// The orders that a page may give.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Rights {
    /// Every order, as without keys.
    #[default]
    All,
    /// The emergency stop alone.
    StopOnly,
}

impl Rights {
    /// The rights of a page in a room, by the role of its certificate; `None` for a page without keys.
    pub fn of(role: Option<AccessRole>, room: &Room) -> Self {
        let gives_orders = |role: AccessRole| role.publishes(room).contains(&room.controller_control());
        if role.is_none_or(gives_orders) { Self::All } else { Self::StopOnly }
    }

    /// Why only the stop button acts; `None` if the others do too.
    pub fn limit(self) -> Option<&'static str> {
        match self {
            Self::All => None,
            Self::StopOnly => Some(STOP_ONLY),
        }
    }

    /// Refuses an order whose message the room would drop. An order about processes is no message.
    ///
    /// # Errors
    /// [`UiError::NoRight`], with the [limit](Self::limit).
    pub(crate) fn check(self, order: &Order) -> Result<(), UiError> {
        match (self.limit(), order) {
            (None, _) | (_, Order::Stop | Order::KillController {} | Order::RestartController {}) => Ok(()),
            (Some(limit), _) => Err(UiError::NoRight(limit)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_viewer_may_stop_and_gives_no_other_order() {
        let room = Room::new("studio").expect("a room");
        let of = |role| Rights::of(role, &room);
        assert_eq!([None, Some(AccessRole::Operator)].map(of), [Rights::All; 2]);
        let viewer = of(Some(AccessRole::Viewer));
        assert_eq!(viewer, Rights::StopOnly);
        assert!(viewer.check(&Order::Stop).is_ok());
        for order in [Order::Rearm { stops: Vec::new() }, Order::Release {}, Order::Power { watts: 1.0 }] {
            let refusal = viewer.check(&order).expect_err("no right").to_string();
            assert!(refusal.starts_with(STOP_ONLY), "{refusal}");
            assert!(Rights::All.check(&order).is_ok(), "{order:?}");
        }
    }
}
