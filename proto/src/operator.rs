//! What operators order of a running system: changes in a simulated room, another policy.

use serde::{Deserialize, Serialize};

use crate::messages::Stamp;

/// A change in a simulated room; what is absent stays as it is. A real room has no such key.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SimulatorControl {
    /// Source, sequence, time.
    pub stamp: Stamp,
    /// The direct path of the first so many users is off, that of the others on.
    pub forced_users: Option<u32>,
    /// Transmitted optical power in W.
    pub power_w: Option<f32>,
    /// Slowest and fastest walking speed in m/s; 0 and 0 let everybody stand.
    pub speed_m_s: Option<[f32; 2]>,
    /// Faults of the mirrors, applied in this order.
    pub faults: Vec<MirrorFault>,
}

/// One fault, and the mirrors that it befalls.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MirrorFault {
    /// What goes wrong.
    pub fault: FaultKind,
    /// How long [`FaultKind::Offline`] and [`FaultKind::Reboot`] last, and how late [`FaultKind::Late`] makes
    /// commands, in s; without meaning for the others.
    pub seconds: f32,
    /// Where `mirrors` is empty: this share of all mirrors, from 0 to 1, rounded to a whole number of them.
    pub share: f32,
    /// Which mirrors the share draws; the same seed draws the same ones.
    pub seed: u64,
    /// Indices of the mirrors; empty where a share is drawn, or where the fault is of the whole array.
    pub mirrors: Vec<u32>,
}

/// What can go wrong with simulated mirrors.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum FaultKind {
    /// Nothing: heals the mirrors, of every fault but a late, offline or rebooting array.
    #[default]
    Healed,
    /// Both axes stay where they are.
    Stuck,
    /// Roll loses its drive and returns to 0.
    DeadRoll,
    /// Yaw loses its drive and returns to 0.
    DeadYaw,
    /// Roll turns the wrong way.
    FlippedRoll,
    /// Yaw turns the wrong way.
    FlippedYaw,
    /// The array does not answer for a while; its mirrors stay where they are.
    Offline,
    /// Every command reaches the mirrors so much later; 0 s ends it.
    Late,
    /// The array starts anew: its mirrors return to 0, and it does not answer for a while.
    Reboot,
}

impl FaultKind {
    /// All of them, in the order of their numbers.
    pub const ALL: [Self; 9] = [
        Self::Healed,
        Self::Stuck,
        Self::DeadRoll,
        Self::DeadYaw,
        Self::FlippedRoll,
        Self::FlippedYaw,
        Self::Offline,
        Self::Late,
        Self::Reboot,
    ];

    /// The name on command lines and in counters.
    pub fn name(self) -> &'static str {
        match self {
            Self::Healed => "healed",
            Self::Stuck => "stuck",
            Self::DeadRoll => "dead-roll",
            Self::DeadYaw => "dead-yaw",
            Self::FlippedRoll => "flipped-roll",
            Self::FlippedYaw => "flipped-yaw",
            Self::Offline => "offline",
            Self::Late => "late",
            Self::Reboot => "reboot",
        }
    }

    /// The fault with this name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|fault| fault.name() == name)
    }
}

/// What a running controller is to do differently.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ControllerControl {
    /// Source, sequence, time.
    pub stamp: Stamp,
    /// Name of the policy that decides from now on, as on the controller's command line.
    pub policy: String,
}
