//! What the network of an actor reads and gives; its metadata names both.

use heliostat_proto::{MAX_USERS, named};

use super::{ANGLES, key};
use crate::{
    observe::{
        codeword_state::POSITION,
        observation::{ObservationEncoder, Summary, USERS_CAPACITY},
    },
    policy::weights::Head,
};

named! {
    /// What a network reads.
    pub enum ObservationKind {
        /// The observation vector: \[1, n\]. Files without the entry have this one.
        Flat = "flat",
        /// The columns of [`Summary`] of each user, unscaled: \[rows, 11\].
        Users = "users",
        /// The state of [`AngleState`](crate::angle_state::AngleState): \[1, 60\], or \[1, 60 + 2 M\]
        /// with the current angles.
        Paper = "paper",
        /// The state of [`CodewordState`](crate::codeword_state::CodewordState), and the coordinates of
        /// each of C codewords: \[C, 64\].
        Codewords = "codewords",
        /// The cell of the target user, one-hot: \[1, cells\].
        Cell = "cell",
    }
}

impl ObservationKind {
    /// Whether the file serves any array and room of its mode.
    pub fn fits_any_array(self) -> bool {
        self == Self::Users
    }

    /// The kinds of action that can follow.
    pub fn actions(self) -> &'static [&'static str] {
        match self {
            Self::Flat | Self::Paper => &[ANGLES, WEIGHTS],
            Self::Users => &[WEIGHTS],
            Self::Codewords | Self::Cell => &[CODEBOOK],
        }
    }

    /// Values of a row of the input that this kind admits, for a file of the given size.
    pub(super) fn columns(self, users_max: usize, mirrors: usize) -> Columns {
        let users = ObservationEncoder::new(users_max, mirrors).min_rate().end;
        match self {
            Self::Flat => Columns::Of(vec![ObservationEncoder::new(users_max, mirrors).len()]),
            Self::Users => Columns::Of(vec![Summary::COLUMNS]),
            Self::Paper => Columns::Of(vec![users, users + 2 * mirrors]),
            Self::Codewords => Columns::Of(vec![users + 2 * POSITION]),
            Self::Cell => Columns::Square,
        }
    }

    /// The number of users whom a file of this kind serves; `None` where its metadata has it.
    pub(super) fn users_max(self) -> Option<usize> {
        match self {
            Self::Flat => None,
            Self::Users => Some(MAX_USERS),
            Self::Paper | Self::Codewords | Self::Cell => Some(USERS_CAPACITY),
        }
    }
}

/// The lengths of a row that fit.
pub(super) enum Columns {
    /// One of these.
    Of(Vec<usize>),
    /// Any square number.
    Square,
}

impl Columns {
    pub fn admit(&self, found: usize) -> bool {
        match self {
            Self::Of(lengths) => lengths.contains(&found),
            Self::Square => found > 0 && found.isqrt().pow(2) == found,
        }
    }

    /// As in "1370" or "60 or 260".
    pub fn text(&self) -> String {
        match self {
            Self::Of(lengths) => lengths.iter().map(usize::to_string).collect::<Vec<_>>().join(" or "),
            Self::Square => "cells, a square number".into(),
        }
    }
}

/// The action of a network that gives one weight for each user.
pub const WEIGHTS: &str = "weights";
/// The action of a network that values codewords.
pub const CODEBOOK: &str = "codebook";

/// What a network gives.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ActionKind {
    /// Roll of each mirror, then yaw of each, in rad: \[1, 2 M\].
    Angles,
    /// An action in [-1, 1] for each user or slot: \[rows, 1\] or \[1, slots\].
    Weights(Head),
    /// A value for each codeword: \[C, 1\] or \[1, C\]. The largest wins, the first of equal ones.
    Codebook,
}

impl ActionKind {
    /// The name in the metadata; files without the entry are [`Self::Angles`].
    pub fn name(self) -> &'static str {
        match self {
            Self::Angles => ANGLES,
            Self::Weights(_) => WEIGHTS,
            Self::Codebook => CODEBOOK,
        }
    }

    /// The name of the network's only output.
    pub fn output(self) -> &'static str {
        match self {
            Self::Angles => ANGLES,
            Self::Weights(_) => WEIGHTS,
            Self::Codebook => "values",
        }
    }

    /// The metadata of this kind.
    pub fn entries(self) -> Vec<(String, String)> {
        let entry = |key: &str, value: &str| (key.to_owned(), value.to_owned());
        let mut entries = vec![entry(key::ACTION, self.name())];
        if let Self::Weights(Head { baseline_weight, range }) = self {
            entries.push(entry(key::BASELINE_WEIGHT, baseline_weight.name()));
            entries.push(entry(key::WEIGHT_RANGE, &range.to_string()));
        }
        entries
    }
}
