//! The figures: the parts of each, the rooms where it does not apply, and the figure from finished
//! parts.
//!
//! The file of a figure holds all its specifics. [`Kind`] lists the figures.

pub mod ber_snr;
pub mod finished_parts;
pub mod inference;
pub mod map;
pub mod outage;
pub mod sum_rate_iterations;
pub mod sum_rate_power;

use anyhow::{Context, Result};
use heliostat_scenario::ChannelMode;

use crate::command;
use crate::figure::Figure;
use crate::job::Job;
use crate::part::{Measured, Part};
use crate::plan::{Plan, Room};
use finished_parts::Done;

/// A figure by its id on the command line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Fig4.
    SumRateIterations,
    /// Fig5.
    SumRatePower,
    /// Fig6.
    BerSnr,
    /// Section V.B of the paper.
    Inference,
    /// Not in the paper.
    Outage,
    /// Not in the paper.
    Map,
}

impl Kind {
    /// All figures, in the order of the report.
    pub const ALL: [Self; 6] =
        [Self::SumRateIterations, Self::SumRatePower, Self::BerSnr, Self::Inference, Self::Outage, Self::Map];

    /// The id on the command line.
    pub fn id(self) -> &'static str {
        match self {
            Self::SumRateIterations => sum_rate_iterations::ID,
            Self::SumRatePower => sum_rate_power::ID,
            Self::BerSnr => ber_snr::ID,
            Self::Inference => inference::ID,
            Self::Outage => outage::ID,
            Self::Map => map::ID,
        }
    }

    /// Its parts in a room.
    ///
    /// # Errors
    /// An invalid room or plan, reported before any part is computed.
    pub fn parts(self, room: &Room, plan: &Plan) -> Result<Vec<Part>> {
        match self {
            Self::SumRateIterations => sum_rate_iterations::parts(room, plan),
            Self::SumRatePower => sum_rate_power::parts(room, plan),
            Self::BerSnr => Ok(ber_snr::parts(room, plan)),
            Self::Inference => inference::parts(room, plan),
            Self::Outage => outage::parts(room, plan),
            Self::Map => map::parts(room, plan),
        }
    }

    /// Whether the paper has a statement about it.
    pub fn is_in_the_paper(self) -> bool {
        !matches!(self, Self::Outage | Self::Map)
    }

    /// The reason why the figure does not apply to a room, if so.
    pub fn not_applicable(self, room: &Room) -> Option<String> {
        match self {
            Self::BerSnr if room.scenario.channel.mode != ChannelMode::Specular => Some(ber_snr::NOT_APPLICABLE.into()),
            _ => None,
        }
    }

    /// The figure from its finished parts.
    pub fn figure(self, room: &Room, done: &[Done]) -> Figure {
        let figure = match self {
            Self::SumRateIterations => sum_rate_iterations::figure(done),
            Self::SumRatePower => sum_rate_power::figure(room, done),
            Self::BerSnr => ber_snr::figure(done),
            Self::Inference => inference::figure(room, done),
            Self::Outage => outage::figure(done),
            Self::Map => map::figure(room, done),
        };
        let overloaded = done.iter().any(|(_, finished)| finished.origin.overload().is_some());
        let command = command::of_figure(self.id(), room);
        Figure { id: self.id().into(), room: room.name.clone(), command, overloaded, ..figure }
    }
}

/// Computes a part.
///
/// # Errors
/// The error of the computation, with the label of the part.
pub fn compute(part: &Part) -> Result<Measured> {
    let scenario = part.scenario();
    let measured = match &part.job {
        Job::Learning(job) => job.run(&scenario),
        Job::Baselines(job) => job.run(&scenario),
        Job::Power(job) => job.run(&scenario, &part.actor),
        Job::Aim(job) => job.run(&scenario, &part.actor),
        Job::Timing(job) => job.run(&scenario, &part.actor),
        Job::Outage(job) => job.run(&scenario, &part.actor),
        Job::Map(job) => job.run(&scenario, &part.actor),
    };
    measured.with_context(|| part.label())
}
