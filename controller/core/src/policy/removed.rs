//! What this program had and has no longer, so that each name gets one sentence with what to use.

use std::{ffi::OsStr, fmt, marker::PhantomData};

use clap::{
    Arg, Command, ValueEnum,
    builder::{EnumValueParser, PossibleValue, TypedValueParser},
    error::ErrorKind,
};

/// A policy, a form of action or a form of observation that was removed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Removed {
    /// "policy", "action" or "observation".
    what: &'static str,
    name: &'static str,
    instead: &'static str,
}

/// Where the reason is documented.
const REASON: &str = "docs/learning.md";

const BY_MODEL: &str = "use fixed-point, or greedy for the highest ratio";

const BY_SB3: &str = "train an actor with Stable-Baselines3 (docs/python.md) and give its file, or use ddpg";

const REMOVED: [Removed; 12] = [
    policy("residual", BY_MODEL),
    policy("lstm", BY_MODEL),
    policy("td3", BY_SB3),
    policy("sac", BY_SB3),
    policy("ppo", BY_SB3),
    policy("ddpg-basis", "use ddpg, or ddpg-raw for the algorithm of the paper"),
    policy("mirror-codebook", "use greedy"),
    action("compact"),
    action("corrections"),
    action("displacements"),
    action("basis"),
    Removed { what: "observation", name: "evidence", instead: "use belief" },
];

const fn policy(name: &'static str, instead: &'static str) -> Removed {
    Removed { what: "policy", name, instead }
}

const fn action(name: &'static str) -> Removed {
    Removed { what: "action", name, instead: "use weights or angles" }
}

/// What was removed under this name; `None` for a name that the program has, or never had.
pub fn removed(name: &str) -> Option<Removed> {
    REMOVED.into_iter().find(|removed| removed.name == name)
}

impl Removed {
    /// That the thing was removed, and where the reason is documented.
    pub fn fact(&self) -> String {
        format!("{} {} was removed ({REASON})", self.what, self.name)
    }
}

impl fmt::Display for Removed {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "the {}: {}", self.fact(), self.instead)
    }
}

/// Reads a name on a command line. The name of something removed is refused with what to use.
#[derive(Clone, Debug)]
pub struct NameParser<T>(PhantomData<T>);

impl<T> Default for NameParser<T> {
    fn default() -> Self {
        Self(PhantomData)
    }
}

impl<T: ValueEnum + Clone + Send + Sync + 'static> TypedValueParser for NameParser<T> {
    type Value = T;

    fn parse_ref(&self, command: &Command, argument: Option<&Arg>, value: &OsStr) -> Result<T, clap::Error> {
        match value.to_str().and_then(removed) {
            Some(removed) => Err(command.clone().error(ErrorKind::InvalidValue, removed)),
            None => EnumValueParser::<T>::new().parse_ref(command, argument, value),
        }
    }

    fn possible_values(&self) -> Option<Box<dyn Iterator<Item = PossibleValue> + '_>> {
        Some(Box::new(T::value_variants().iter().filter_map(ValueEnum::to_possible_value)))
    }
}
