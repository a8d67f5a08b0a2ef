//! The figures: for each its parts, what makes no sense, and how finished parts become a picture.
//!
//! A figure's file holds all that is particular to it. [`Kind`] is the list.

pub mod ber_snr;
pub mod inference;
pub mod map;
pub mod sum_rate_iterations;
pub mod sum_rate_power;

use anyhow::Result;
use heliostat_controller::policy::ActorSource;
use heliostat_scenario::{ChannelMode, Scenario};

use crate::command;
use crate::effort::Effort;
use crate::figure::{Figure, Series};
use crate::part::{Curve, Part};
use crate::statistics::over_seeds;
use crate::store::Finished;

/// A room in which figures are made.
#[derive(Clone, Debug)]
pub struct Room {
    /// Its name in the report: that of its scenario.
    pub name: String,
    /// The room.
    pub scenario: Scenario,
    /// Where the policy ddpg comes from there.
    pub actor: ActorSource,
    /// The flags of the command line on which figures in it depend.
    pub flags: String,
}

/// What all figures are made with.
#[derive(Clone, Debug)]
pub struct Plan {
    /// The sizes.
    pub effort: Effort,
    /// The first seed.
    pub first_seed: u64,
    /// Numbers of users whose direct path is off, for the power figure.
    pub blocked: Vec<usize>,
}

impl Plan {
    fn seeds(&self) -> std::ops::Range<u64> {
        self.first_seed..self.first_seed + self.effort.seeds
    }

    fn training_seeds(&self) -> std::ops::Range<u64> {
        self.first_seed..self.first_seed + self.effort.training_seeds
    }
}

/// A part with what it found.
pub type Done = (Part, Finished);

/// A figure, by the word on the command line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Fig4.
    SumRateIterations,
    /// Fig5.
    SumRatePower,
    /// Fig6.
    BerSnr,
    /// Section V.B.
    Inference,
    /// Our own.
    Map,
}

impl Kind {
    /// All figures, in the order of the report.
    pub const ALL: [Self; 5] = [Self::SumRateIterations, Self::SumRatePower, Self::BerSnr, Self::Inference, Self::Map];

    /// The word on the command line.
    pub fn id(self) -> &'static str {
        match self {
            Self::SumRateIterations => sum_rate_iterations::ID,
            Self::SumRatePower => sum_rate_power::ID,
            Self::BerSnr => ber_snr::ID,
            Self::Inference => inference::ID,
            Self::Map => map::ID,
        }
    }

    /// Its parts in a room.
    ///
    /// # Errors
    /// What is wrong with the room or the plan, and what to do about it: told before any part is computed.
    pub fn parts(self, room: &Room, plan: &Plan) -> Result<Vec<Part>> {
        match self {
            Self::SumRateIterations => sum_rate_iterations::parts(room, plan),
            Self::SumRatePower => sum_rate_power::parts(room, plan),
            Self::BerSnr => Ok(ber_snr::parts(room, plan)),
            Self::Inference => inference::parts(room, plan),
            Self::Map => map::parts(room, plan),
        }
    }

    /// Why the figure makes no sense under a room's equations, if so.
    pub fn pointless(self, room: &Room) -> Option<String> {
        match self {
            Self::BerSnr if room.scenario.channel.mode != ChannelMode::Specular => Some(ber_snr::POINTLESS.into()),
            _ => None,
        }
    }

    /// The figure from its finished parts.
    pub fn figure(self, room: &Room, done: &[Done]) -> Figure {
        let figure = match self {
            Self::SumRateIterations => sum_rate_iterations::figure(room, done),
            Self::SumRatePower => sum_rate_power::figure(room, done),
            Self::BerSnr => ber_snr::figure(room, done),
            Self::Inference => inference::figure(room, done),
            Self::Map => map::figure(room, done),
        };
        let overloaded = done.iter().any(|(_, finished)| finished.origin.overload().is_some());
        Figure { command: command::of_figure(self.id(), room), overloaded, ..figure }
    }
}

/// Groups in the order in which they first appear.
fn groups(done: &[Done]) -> Vec<&str> {
    let mut groups: Vec<&str> = Vec::new();
    for curve in curves(done) {
        if !groups.contains(&curve.group.as_str()) {
            groups.push(&curve.group);
        }
    }
    groups
}

/// The mean series over seeds of each name of a group, in the order of `names`.
fn series(done: &[Done], group: &str, names: &[&str]) -> Vec<Series> {
    let of_name = |name: &&str| {
        let same: Vec<&Curve> = curves(done).filter(|curve| curve.group == group && curve.name == *name).collect();
        over_seeds(name, &same)
    };
    names.iter().filter_map(of_name).collect()
}

fn curves(done: &[Done]) -> impl Iterator<Item = &Curve> {
    done.iter().flat_map(|(_, finished)| &finished.measured.curves)
}

/// How many different seeds there are.
fn seeds(done: &[Done]) -> usize {
    let mut seeds: Vec<u64> = done.iter().map(|(part, _)| part.seed).collect();
    seeds.sort_unstable();
    seeds.dedup();
    seeds.len()
}

/// How an interval came about, for captions.
fn intervals(done: &[Done]) -> String {
    match seeds(done) {
        1 => "One seed, so no intervals.".into(),
        seeds => format!("Means over {seeds} seeds; bands are 95 % intervals of the mean over seeds (Student's t)."),
    }
}
