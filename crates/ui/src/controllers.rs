//! The controllers of a room: which one leads, which stand by, and how often they took over.

mod refusals;

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::time::{Duration, Instant};

use heliostat_proto::gauges::CalibrationProgress;
use heliostat_proto::{EPOCH_SLOTS, NodeKind, NodeStatus, SOURCES_MAX};
use heliostat_service::printable::printable;
use serde::Serialize;

use crate::expiry::EXPIRY;
use refusals::{DECISIONS, ReportCounts, refusal_in_words};

pub(crate) use refusals::refusal_of;

/// Counters of a controller's status: standby, its epoch, takeovers, and takeovers from a leader
/// that was not gone.
const STANDBY: &str = NodeStatus::STANDBY;
const EPOCH: &str = NodeStatus::EPOCH;
const TAKEOVERS: &str = "epoch:took-over";
const FALSE_TAKEOVERS: &str = "epoch:contested";

/// A status comes at least once a second: a token without one for this time shows a controller that is silent.
const REPORTS_WITHIN: Duration = Duration::from_secs(2);
/// A controller that hung when its connection expired is listed for this time. The alert on a missing standby fires then.
const REMEMBERED: Duration = Duration::from_secs(300);

/// What a controller does in its room.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Role {
    /// The array follows its commands, or an array reports and no other controller commands.
    #[default]
    Leads,
    /// A calibration: it commands in place of a controller.
    Calibrates,
    /// It commands, and no array reports: whether one follows it is unknown.
    Unheard,
    /// It does not stand by beside others, and no telemetry shows that the array follows it.
    Unfollowed,
    /// It withholds its commands: the array follows another one.
    StandsBy,
    /// Its status does not come, although it has not ended: it hangs, or the link to it is cut.
    Silent,
}

impl Role {
    /// Whether it commands, as far as is known: a controller that leads or is unheard, or a calibration.
    pub fn commands(self) -> bool {
        matches!(self, Self::Leads | Self::Calibrates | Self::Unheard)
    }

    /// The role in words, after the name of a controller.
    pub fn in_words(self) -> &'static str {
        match self {
            Self::Leads => "leads",
            Self::Calibrates => "calibrates",
            Self::Unheard => "commands, but no array reports",
            Self::Unfollowed => "is not followed",
            Self::StandsBy => "stands by",
            Self::Silent => "does not report",
        }
    }
}

/// One controller.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct ControllerFigures {
    /// Its source id, as 16 hexadecimal digits.
    pub name: String,
    /// The name of its host; empty where its status has none.
    pub host: String,
    /// What it does in its room.
    pub role: Role,
    /// The epoch of its commands; 0 before the first.
    pub epoch: u64,
    /// How often it took over since its start.
    pub takeovers: u64,
    /// How often the former leader was not gone then.
    pub false_takeovers: u64,
    /// Decisions on position reports since its start.
    pub decisions: u64,
    /// Whether it decided between its last two statuses: position reports reach it.
    pub is_deciding: bool,
    /// The arrays that it cannot command, because they do not fit its scenario, in words: "array", or their keys.
    pub unfit: String,
    /// Why it refused each position report between its last two statuses; empty where it accepted one, and without any.
    pub refuses: String,
}

impl fmt::Display for ControllerFigures {
    /// Name, host and role; of a leader also the arrays to which it sends no commands.
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let on = if self.host.is_empty() { "" } else { " on " };
        write!(formatter, "{}{on}{} {}", self.name, self.host, self.role.in_words())?;
        match (self.role, self.unfit.as_str()) {
            (Role::Leads, UNFIT_ARRAY) => formatter.write_str(", sends no commands"),
            (Role::Leads, unfit) if !unfit.is_empty() => write!(formatter, ", sends no commands to {unfit}"),
            _ => Ok(()),
        }
    }
}

/// The name of a controller with a source id.
pub fn controller_name(source: u64) -> String {
    format!("{source:016x}")
}

/// Of these statuses, the last one of the controller that leads, or else of a calibration or another controller. The
/// first array follows the commands of an epoch, if it reports.
pub fn leading(mut statuses: Vec<NodeStatus>, followed_epoch: Option<u64>) -> Option<NodeStatus> {
    let mut controllers = Controllers::default();
    statuses.iter().for_each(|status| controllers.take(status));
    let alive = statuses.iter().map(|status| (NodeKind::Controller.name(), status.stamp.source)).collect();
    let first = controllers.present(&alive, followed_epoch).into_iter().next()?;
    let last = statuses.iter().rposition(|status| controller_name(status.stamp.source) == first.name)?;
    Some(statuses.swap_remove(last))
}

/// What is known of a controller.
#[derive(Debug)]
struct Known {
    /// When its last status arrived, or its token where none has.
    at: Instant,
    figures: ControllerFigures,
    reports: ReportCounts,
    /// The hash of its scenario; empty where no status states one.
    scenario: String,
    has_reported: bool,
    /// Whether its token ended while it was silent: its connection expired.
    is_lost: bool,
}

impl Known {
    fn is_silent(&self) -> bool {
        self.at.elapsed() >= if self.has_reported { EXPIRY } else { REPORTS_WITHIN }
    }

    /// Whether it is kept without a token.
    fn is_remembered(&self) -> bool {
        self.at.elapsed() < if self.is_lost { REMEMBERED } else { EXPIRY }
    }
}

/// The only array of a room, where it is unfit.
const UNFIT_ARRAY: &str = "array";

fn unfit_in_words(keys: &[&str]) -> String {
    if keys.is_empty() { UNFIT_ARRAY.into() } else { printable(&keys.join(" and ")).into_owned() }
}

/// The controllers of a room, by their source.
#[derive(Debug, Default)]
pub(crate) struct Controllers(BTreeMap<u64, Known>);

impl Controllers {
    /// Notes the token of a controller.
    pub fn join(&mut self, source: u64) {
        if let Some(known) = self.0.get_mut(&source) {
            known.is_lost = false;
            return;
        }
        let figures = ControllerFigures { name: controller_name(source), ..ControllerFigures::default() };
        let (at, scenario) = (Instant::now(), String::new());
        let reports = ReportCounts::default();
        self.0.insert(source, Known { at, figures, reports, scenario, has_reported: false, is_lost: false });
    }

    /// Notes the end of the token of a controller. One that ends reports shortly before or after that; one that hangs
    /// has been silent when its connection expires.
    pub fn leave(&mut self, source: u64) {
        if let Some(known) = self.0.get_mut(&source) {
            known.is_lost = known.has_reported && known.is_silent();
        }
    }

    /// Forgets the controllers that have left.
    pub fn forget(&mut self, alive: &BTreeSet<(&'static str, u64)>) {
        let is_alive = |source: &u64| alive.contains(&(NodeKind::Controller.name(), *source));
        self.0.retain(|source, known| known.is_remembered() || is_alive(source));
    }

    /// Whether the status of a controller has a place: each one that is in the room, and so many others.
    pub fn has_place(&self, source: u64, alive: &BTreeSet<(&'static str, u64)>) -> bool {
        let is_alive = |source: &u64| alive.contains(&(NodeKind::Controller.name(), *source));
        let strangers = || self.0.keys().copied().filter(|known| !is_alive(known)).count();
        self.0.contains_key(&source) || is_alive(&source) || strangers() < SOURCES_MAX
    }

    /// Notes the status of a controller.
    pub fn take(&mut self, status: &NodeStatus) {
        let source = status.stamp.source;
        let count = |name| status.counter(name).unwrap_or_default();
        let decisions = count(DECISIONS);
        let before = self.0.get(&source).filter(|known| known.has_reported && !known.is_silent());
        let is_deciding = before.is_some_and(|before| decisions > before.figures.decisions);
        let reports = ReportCounts::of(status);
        let is_refusing = before.is_some_and(|before| reports.are_refused_since(before.reports));
        let role = match (count(STANDBY) > 0, CalibrationProgress::of(status)) {
            (true, _) => Role::StandsBy,
            (false, Some(_)) => Role::Calibrates,
            (false, None) => Role::Leads,
        };
        let figures = ControllerFigures {
            name: controller_name(source),
            host: printable(status.host().unwrap_or_default()).into_owned(),
            role,
            epoch: count(EPOCH),
            takeovers: count(TAKEOVERS),
            false_takeovers: count(FALSE_TAKEOVERS),
            decisions,
            is_deciding,
            unfit: status.unfit_arrays().map(|keys| unfit_in_words(&keys)).unwrap_or_default(),
            refuses: if is_refusing { refusal_in_words(status) } else { String::new() },
        };
        let is_new = self.0.get(&source).is_none_or(|known| !known.has_reported);
        if is_new && role != Role::Calibrates {
            self.replace_lost();
        }
        let (at, scenario) = (Instant::now(), status.scenario.clone());
        self.0.insert(source, Known { at, figures, reports, scenario, has_reported: true, is_lost: false });
    }

    /// A new controller takes the place of the one that was lost first. A calibration takes none.
    fn replace_lost(&mut self) {
        let lost = self.0.iter().filter(|(_, known)| known.is_lost);
        if let Some(source) = lost.min_by_key(|(_, known)| known.at).map(|(source, _)| *source) {
            self.0.remove(&source);
        }
    }

    /// Whether a status of a controller has arrived.
    pub fn has_reported(&self, source: u64) -> bool {
        self.0.get(&source).is_some_and(|known| known.has_reported)
    }

    /// The hash of the scenario of a controller; empty where it is unknown.
    pub fn scenario(&self, source: u64) -> &str {
        self.0.get(&source).map_or("", |known| &known.scenario)
    }

    /// The controllers that are in the room, the leader first, and those that were lost, [`SOURCES_MAX`] at most. The first
    /// array follows the commands of an epoch, if it reports.
    pub fn present(
        &self,
        alive: &BTreeSet<(&'static str, u64)>,
        followed_epoch: Option<u64>,
    ) -> Vec<ControllerFigures> {
        let is_alive = |source: &u64| alive.contains(&(NodeKind::Controller.name(), *source));
        let shown = |(source, known): (&u64, &Known)| {
            let figures = &known.figures;
            if (known.is_lost && known.is_remembered()) || (is_alive(source) && known.is_silent()) {
                let (role, is_deciding, [unfit, refuses]) = (Role::Silent, false, [const { String::new() }; 2]);
                return Some(ControllerFigures { role, is_deciding, unfit, refuses, ..figures.clone() });
            }
            (is_alive(source) && known.has_reported).then(|| figures.clone())
        };
        let mut figures: Vec<_> = self.0.iter().filter_map(shown).collect();
        // During a stop, a controller that starts again finds no array that follows another one: it does not
        // stand by, although its epoch is not the followed one.
        if figures.iter().filter(|one| one.role.commands()).count() > 1 {
            // A renewed epoch is in the telemetry before it is in the status, and keeps the remainder of its controller.
            let slot = followed_epoch.map(|epoch| epoch % EPOCH_SLOTS);
            let is_followed = |one: &ControllerFigures| one.epoch > 0 && Some(one.epoch % EPOCH_SLOTS) == slot;
            for one in figures.iter_mut().filter(|one| one.role.commands() && !is_followed(one)) {
                one.role = Role::Unfollowed;
            }
        }
        figures.sort_by_key(|figures| figures.role);
        figures.truncate(SOURCES_MAX);
        figures
    }

    /// Whether each controller in the room stands by, and the followed epoch is of a process of which neither a
    /// recent status nor a token is seen. An epoch has the remainder of its sender's source.
    pub fn follow_unseen(&self, alive: &BTreeSet<(&'static str, u64)>, followed_epoch: Option<u64>) -> bool {
        let mut present = self.present(alive, followed_epoch);
        present.retain(|one| one.role != Role::Silent);
        let stand_by = !present.is_empty() && present.iter().all(|one| one.role == Role::StandsBy);
        let Some(slot) = followed_epoch.filter(|epoch| *epoch > 0).map(|epoch| epoch % EPOCH_SLOTS) else {
            return false;
        };
        let is_of = |source: u64, one: &ControllerFigures| {
            source % EPOCH_SLOTS == slot || (one.epoch > 0 && one.epoch % EPOCH_SLOTS == slot)
        };
        let is_recent = |known: &Known| known.has_reported && known.at.elapsed() < EXPIRY;
        let is_seen = self.0.iter().any(|(source, known)| is_recent(known) && is_of(*source, &known.figures));
        let is_of_token =
            |(node, source): &(&str, u64)| *node == NodeKind::Controller.name() && source % EPOCH_SLOTS == slot;
        stand_by && !is_seen && !alive.iter().any(is_of_token)
    }

    /// Lets the statuses and tokens arrive that much earlier.
    #[cfg(test)]
    pub fn age(&mut self, by: Duration) {
        self.0.values_mut().for_each(|known| known.at -= by);
    }
}

#[cfg(test)]
mod tests;
