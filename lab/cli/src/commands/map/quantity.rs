//! The quantities of a map.

use clap::ValueEnum;

/// A quantity over the floor.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum Quantity {
    /// Rate with the bandwidth share of one user, in Mbit/s
    Rate,
    /// SINR in dB
    Sinr,
    /// Whether the minimum rate (of the first user) is met
    Coverage,
}

impl Quantity {
    /// The name with the unit.
    pub fn label(self) -> &'static str {
        match self {
            Self::Rate => "rate (Mbit/s)",
            Self::Sinr => "SINR (dB)",
            Self::Coverage => "minimum rate met (1) or not (0)",
        }
    }
}
