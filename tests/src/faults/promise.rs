//! What the contract and the architecture promise about the effect of a fault.

use std::fmt;

use heliostat_proto::ArrayState;

use crate::faults::effect::Effect;

/// Validity of a command and time to parking in the rooms of the campaign, in ms: the defaults.
const VALIDITY_MS: f64 = 200.0;
const PARK_AFTER_MS: f64 = 1000.0;

/// The bound on the effect of a fault.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Promise {
    /// The array never parks and never stops.
    Follows,
    /// The array follows again within this time after the end of the fault, in s. It may hold or
    /// park meanwhile.
    FollowsAgain(f64),
    /// The array holds, parks, and follows again within this time after the end of the fault, in s.
    ParksThenFollows(f64),
    /// The array stops, accepts no command, and follows within this time after the re-arm, in s.
    StopsThenFollows(f64),
}

impl Promise {
    /// What of the promise the effect breaks.
    ///
    /// # Errors
    /// The difference between effect and promise.
    pub fn check(self, effect: &Effect) -> Result<(), String> {
        let reported = |state| effect.states.contains(&state);
        let (must, must_not, recovery_max_s): (&[_], &[_], _) = match self {
            Self::Follows => (&[], &[ArrayState::Parked, ArrayState::Stopped, ArrayState::Fault], f64::INFINITY),
            Self::FollowsAgain(seconds) => (&[], &[ArrayState::Stopped], seconds),
            Self::ParksThenFollows(seconds) => {
                (&[ArrayState::Holding, ArrayState::Parked], &[ArrayState::Stopped], seconds)
            }
            Self::StopsThenFollows(seconds) => (&[ArrayState::Stopped], &[], seconds),
        };
        let problem = if let Some(missing) = must.iter().find(|state| !reported(**state)) {
            format!("the array was never {}", missing.name())
        } else if let Some(found) = must_not.iter().find(|state| reported(**state)) {
            format!("the array was {}", found.name())
        } else if self == Self::Follows && effect.gap_ms >= VALIDITY_MS + PARK_AFTER_MS {
            format!("no command for {:.0} ms", effect.gap_ms)
        } else if effect.recovery_ms > recovery_max_s * 1e3 {
            format!("the first command came {:.0} ms after the end of the fault", effect.recovery_ms)
        } else {
            return Ok(());
        };
        Err(format!("{problem}; expected: {self}; effect: {effect:?}"))
    }
}

impl fmt::Display for Promise {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Follows => write!(f, "never parks: gap below {:.0} ms", VALIDITY_MS + PARK_AFTER_MS),
            Self::FollowsAgain(seconds) => write!(f, "follows again within {seconds} s"),
            Self::ParksThenFollows(seconds) => write!(
                f,
                "holds after {VALIDITY_MS:.0} ms, parks after {PARK_AFTER_MS:.0} ms more, follows again within {seconds} s"
            ),
            Self::StopsThenFollows(seconds) => {
                write!(f, "stops, follows within {seconds} s after the re-arm")
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ArrayState::{Following, Holding, Parked, Stopped};

    fn effect(states: &[ArrayState], gap_ms: f64, recovery_ms: f64) -> Effect {
        Effect { gap_ms, lost: 0, recovery_ms, states: states.to_vec(), counted: Vec::new() }
    }

    #[test]
    fn each_promise_can_be_broken() {
        let kept = |promise: Promise, effect: &Effect| promise.check(effect).is_ok();
        let brief = effect(&[Following, Holding, Following], 300.0, 5.0);
        let long = effect(&[Following, Holding, Parked, Following], 3000.0, 900.0);
        let stopped = effect(&[Following, Stopped, Parked, Following], 800.0, 20.0);
        assert!(kept(Promise::Follows, &brief) && !kept(Promise::Follows, &long));
        assert!(!kept(Promise::Follows, &effect(&[Following], 1300.0, 5.0)));
        assert!(kept(Promise::ParksThenFollows(1.0), &long) && !kept(Promise::ParksThenFollows(0.5), &long));
        assert!(!kept(Promise::ParksThenFollows(1.0), &brief));
        assert!(kept(Promise::FollowsAgain(1.0), &long) && !kept(Promise::FollowsAgain(1.0), &stopped));
        assert!(kept(Promise::StopsThenFollows(1.0), &stopped) && !kept(Promise::StopsThenFollows(1.0), &long));
    }
}
