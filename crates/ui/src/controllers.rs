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
mod tests {
    use heliostat_proto::Stamp;

    use super::refusals::STALE_DECISIONS;
    use super::*;

    fn status(source: u64, counters: &[(&str, u64)]) -> NodeStatus {
        let stamp = Stamp { source, ..Stamp::default() };
        let counters = counters.iter().map(|(name, count)| ((*name).to_owned(), *count)).collect();
        NodeStatus { stamp, counters, ..NodeStatus::default() }
    }

    #[test]
    fn the_leader_is_first_and_one_that_has_left_is_gone() {
        let (mut controllers, name) = (Controllers::default(), NodeKind::Controller.name());
        controllers.take(&status(1, &[(STANDBY, 1), (TAKEOVERS, 1)]));
        controllers.take(&status(2, &[(STANDBY, 0), (TAKEOVERS, 3), (FALSE_TAKEOVERS, 2), ("host:host-a", 1)]));
        let present = controllers.present(&[(name, 1), (name, 2)].into(), None);
        let expected = ControllerFigures {
            name: "0000000000000002".into(),
            host: "host-a".into(),
            takeovers: 3,
            false_takeovers: 2,
            ..ControllerFigures::default()
        };
        assert_eq!((&present[0], present[1].role, present.len()), (&expected, Role::StandsBy, 2));
        let shown = [&present[0], &present[1]].map(ToString::to_string);
        assert_eq!(shown, ["0000000000000002 on host-a leads", "0000000000000001 stands by"]);
        assert_eq!(controllers.present(&[(name, 1)].into(), None).len(), 1);
    }

    #[test]
    fn a_leader_whose_array_does_not_fit_is_said_to_send_no_commands() {
        let shown = |role, unfit: &str| {
            ControllerFigures { name: "a1".into(), role, unfit: unfit.into(), ..ControllerFigures::default() }
                .to_string()
        };
        assert_eq!(shown(Role::Leads, &unfit_in_words(&[])), "a1 leads, sends no commands");
        assert_eq!(shown(Role::Leads, "mirrors-1"), "a1 leads, sends no commands to mirrors-1");
        assert_eq!([shown(Role::Leads, ""), shown(Role::StandsBy, "array")], ["a1 leads", "a1 stands by"]);
    }

    #[test]
    fn of_two_controllers_that_command_the_one_leads_whose_epoch_the_array_follows() {
        let (mut controllers, name) = (Controllers::default(), NodeKind::Controller.name());
        controllers.take(&status(1, &[(EPOCH, 900)]));
        let mut roles = |alive: &[u64], followed_epoch| -> Vec<(String, Role)> {
            controllers.take(&status(2, &[(EPOCH, 500)]));
            let alive = alive.iter().map(|source| (name, *source)).collect();
            let present = controllers.present(&alive, followed_epoch).into_iter();
            present.map(|one| (one.name[15..].to_owned(), one.role)).collect()
        };
        let of = |name: &str, role| (name.to_owned(), role);
        assert_eq!(roles(&[1, 2], Some(500)), [of("2", Role::Leads), of("1", Role::Unfollowed)]);
        let renewed = Some(500 + 3 * EPOCH_SLOTS);
        assert_eq!(roles(&[1, 2], renewed), [of("2", Role::Leads), of("1", Role::Unfollowed)]);
        assert_eq!(roles(&[1, 2], None), [of("1", Role::Unfollowed), of("2", Role::Unfollowed)]);
        assert_eq!(roles(&[1], Some(500)), [of("1", Role::Leads)], "no other one commands");
    }

    #[test]
    fn of_very_many_controllers_the_leader_and_the_first_of_the_others_are_shown() {
        let (mut controllers, name) = (Controllers::default(), NodeKind::Controller.name());
        (1..200).for_each(|source| controllers.take(&status(source, &[(STANDBY, 1)])));
        controllers.take(&status(500, &[]));
        let alive = (1..=500).map(|source| (name, source)).collect();
        let present = controllers.present(&alive, None);
        assert_eq!((present.len(), present[0].name.as_str()), (SOURCES_MAX, controller_name(500).as_str()));
    }

    #[test]
    fn a_controller_in_the_room_has_a_place_beside_very_many_others() {
        let (mut controllers, alive) = (Controllers::default(), [(NodeKind::Controller.name(), 500)].into());
        for source in 1..=500 {
            if controllers.has_place(source, &alive) {
                controllers.take(&status(source, &[]));
            }
        }
        assert_eq!((controllers.0.len(), controllers.0.contains_key(&500)), (SOURCES_MAX + 1, true));
    }

    #[test]
    fn of_several_statuses_that_of_the_leader_is_chosen_by_the_followed_epoch() {
        let statuses = |standby| vec![status(1, &[(EPOCH, 900)]), status(2, &[(EPOCH, 500), (STANDBY, standby)])];
        let chosen = |statuses, followed_epoch| leading(statuses, followed_epoch).map(|status| status.stamp.source);
        assert_eq!([Some(900), Some(500)].map(|epoch| chosen(statuses(0), epoch)), [Some(1), Some(2)]);
        assert_eq!(chosen(statuses(1), Some(500)), Some(1), "the other one stands by");
        assert_eq!(chosen(vec![status(2, &[(STANDBY, 1)])], None), Some(2), "none leads");
        assert_eq!(chosen(Vec::new(), None), None);
    }

    #[test]
    fn a_calibration_has_a_role_of_its_own_beside_the_controller_that_stands_by() {
        let (mut controllers, name) = (Controllers::default(), NodeKind::Controller.name());
        controllers.take(&status(1, &[(STANDBY, 1), (EPOCH, 400)]));
        let gauges = CalibrationProgress::default().gauges().map(|(name, value)| (name.to_owned(), value)).to_vec();
        controllers.take(&NodeStatus { gauges, ..status(2, &[(EPOCH, 500)]) });
        let roles = |controllers: &Controllers, followed_epoch| -> Vec<Role> {
            let present = controllers.present(&[(name, 1), (name, 2)].into(), followed_epoch);
            present.into_iter().map(|one| one.role).collect()
        };
        assert_eq!(roles(&controllers, Some(500)), [Role::Calibrates, Role::StandsBy]);
        controllers.take(&status(1, &[(EPOCH, 600)]));
        assert_eq!(roles(&controllers, Some(600)), [Role::Leads, Role::Unfollowed], "its lead is taken");
    }

    #[test]
    fn an_epoch_of_a_process_without_a_status_shows_that_another_one_commands() {
        let (mut controllers, name) = (Controllers::default(), NodeKind::Controller.name());
        let alive: BTreeSet<_> = [(name, 1)].into();
        controllers.take(&status(1, &[(STANDBY, 1), (EPOCH, 3 * EPOCH_SLOTS + 1)]));
        let unseen = |controllers: &Controllers, epoch| controllers.follow_unseen(&alive, Some(epoch));
        assert!(unseen(&controllers, 4 * EPOCH_SLOTS + 2));
        assert!(!unseen(&controllers, 4 * EPOCH_SLOTS + 1), "its own next epoch");
        assert!(!controllers.follow_unseen(&alive, None) && !unseen(&controllers, 0));
        let with_token = [(name, 1), (name, 2)].into();
        assert!(!controllers.follow_unseen(&with_token, Some(4 * EPOCH_SLOTS + 2)), "it is seen, and silent");
        controllers.take(&status(2, &[]));
        assert!(!unseen(&controllers, 4 * EPOCH_SLOTS + 2), "it has just left");
        let mut leads = Controllers::default();
        leads.take(&status(1, &[]));
        assert!(!unseen(&leads, 4 * EPOCH_SLOTS + 2));
    }

    #[test]
    fn a_standby_that_hangs_stays_listed_as_silent_until_another_one_joins() {
        let (mut controllers, name) = (Controllers::default(), NodeKind::Controller.name());
        let roles = |controllers: &Controllers, alive: &[u64]| -> Vec<Role> {
            let alive = alive.iter().map(|source| (name, *source)).collect();
            controllers.present(&alive, None).into_iter().map(|one| one.role).collect()
        };
        controllers.join(2);
        controllers.take(&status(2, &[(STANDBY, 1)]));
        controllers.age(EXPIRY);
        controllers.join(1);
        controllers.take(&status(1, &[]));
        assert_eq!(roles(&controllers, &[1, 2]), [Role::Leads, Role::Silent], "its token remains");
        let forget = |controllers: &mut Controllers, alive: &[u64]| {
            controllers.forget(&alive.iter().map(|source| (name, *source)).collect());
        };
        forget(&mut controllers, &[1, 2]);
        controllers.leave(2);
        forget(&mut controllers, &[1]);
        assert_eq!(roles(&controllers, &[1]), [Role::Leads, Role::Silent], "its connection has expired");
        controllers.join(5);
        let gauges = CalibrationProgress::default().gauges().map(|(name, value)| (name.to_owned(), value)).to_vec();
        controllers.take(&NodeStatus { gauges, ..status(5, &[]) });
        controllers.leave(5);
        assert_eq!(roles(&controllers, &[1]), [Role::Leads, Role::Silent], "a calibration takes no place");
        controllers.join(3);
        controllers.take(&status(3, &[(STANDBY, 1)]));
        assert_eq!(roles(&controllers, &[1, 3]), [Role::Leads, Role::StandsBy], "another one stands by");
        controllers.leave(3);
        assert_eq!(roles(&controllers, &[1]), [Role::Leads], "it has ended");
    }

    #[test]
    fn a_token_without_a_status_is_a_controller_that_does_not_report() {
        let (mut controllers, name) = (Controllers::default(), NodeKind::Controller.name());
        let alive: BTreeSet<_> = [(name, 7)].into();
        controllers.join(7);
        assert!(controllers.present(&alive, None).is_empty(), "it has just started");
        controllers.age(REPORTS_WITHIN);
        let shown: Vec<String> = controllers.present(&alive, None).iter().map(ToString::to_string).collect();
        assert_eq!(shown, ["0000000000000007 does not report"]);
        controllers.leave(7);
        assert!(controllers.present(&BTreeSet::new(), None).is_empty(), "it never reported here");
    }

    #[test]
    fn a_controller_refuses_the_reports_while_it_refuses_each_one() {
        let (mut controllers, name) = (Controllers::default(), NodeKind::Controller.name());
        let mut refuses = |decisions, stale, [from_future, of_stale]: [u64; 2], last_problem: &str| {
            let counters = [
                (STANDBY, 1),
                (DECISIONS, decisions),
                (STALE_DECISIONS, stale),
                ("refused:users:from-future", from_future),
                ("refused:users:stale", of_stale),
            ];
            controllers.take(&NodeStatus { last_problem: last_problem.into(), ..status(1, &counters) });
            controllers.present(&[(name, 1)].into(), None)[0].refuses.clone()
        };
        let ahead = "users refused: a report is 5.0 s ahead of this controller's clock; check the clocks of both";
        let reason = "a report is 5.0 s ahead of this controller's clock; check the clocks of both";
        assert_eq!(refuses(0, 0, [40, 0], ahead), "", "the refusals may be old");
        assert_eq!(refuses(0, 0, [50, 0], ahead), reason);
        assert_eq!(refuses(0, 0, [60, 0], "withheld by the stop of ann"), "from-future", "its problem is another one");
        assert_eq!(refuses(0, 0, [60, 0], ahead), "", "none came");
        assert_eq!(refuses(9, 9, [60, 9], "users refused: a report is 5.0 s old"), "a report is 5.0 s old");
        assert_eq!(refuses(20, 10, [60, 10], ""), "", "it has accepted some");
    }

    #[test]
    fn a_controller_is_deciding_while_its_decisions_rise() {
        let (mut controllers, name) = (Controllers::default(), NodeKind::Controller.name());
        let mut after = |decisions| {
            controllers.take(&status(1, &[(DECISIONS, decisions)]));
            controllers.present(&[(name, 1)].into(), None)[0].is_deciding
        };
        assert_eq!([after(20), after(40), after(40)], [false, true, false]);
    }
}
