//! The state of a room at one instant, for an operator: who leads, what the arrays do, and what is wrong.

mod stop_lines;

use std::fmt;

use heliostat_proto::ArrayState;
use heliostat_service::counted::counted;
use serde::Serialize;

use crate::View;
use crate::causes::{ALL_STAND_BY, NO_CONTROLLER_SEEN, NO_REPORTS, UNKNOWN_LEADER, causes_and_others, folded};
use crate::controllers::{ControllerFigures, Role};
use crate::figures::{Figures, NodeFigures, Origin, UserFigures};
use crate::notes::{AGAIN, UNSEEN_CONTROLLER, UNSEEN_REPORTS, simulator_silent};
use crate::terminal::texts::{stops, time, why_without_rates};
use crate::view::NO_GEOMETRY;

/// The state of a room.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct RoomStatus {
    /// The room.
    pub room: String,
    /// Whether nothing is wrong.
    pub is_healthy: bool,
    /// What is wrong.
    pub problems: Vec<String>,
    /// Emergency stops, and what each array does about them.
    pub stops: Vec<String>,
    /// The stops in force, each with its name and its operator.
    #[serde(skip)]
    in_force: Vec<String>,
    /// Position reports a second.
    pub reports_per_s: f64,
    /// The figures of the page.
    pub figures: Figures,
}

impl RoomStatus {
    /// The state that a view shows.
    pub fn new(room: &str, view: &View) -> Self {
        let of_stops = view.stops.room();
        let mut status = Self {
            room: room.to_owned(),
            stops: stops(&of_stops),
            in_force: stop_lines::in_force(&of_stops),
            reports_per_s: view.reports_per_s(),
            figures: view.figures(),
            ..Self::default()
        };
        status.figures.remarks.extend(view.stops.remarks());
        if let Some(lost) = view.notes_without_router() {
            status.problems = lost;
            return status;
        }
        let (unseen, missing) = {
            let received = view.received();
            let silent = received.has_silent_simulator().then(simulator_silent);
            (received.unseen(), received.others_missing().map(str::to_owned).or(silent))
        };
        status.add_cause(missing.as_deref());
        status.problems = unseen.map_or_else(|| status.found(), |unseen| status.of_unseen_room(unseen));
        status.is_healthy = status.problems.is_empty();
        status
    }

    /// Adds a note from which others follow: this command ends before a view states it.
    fn add_cause(&mut self, cause: Option<&str>) {
        let notes = &mut self.figures.notes;
        if let Some(cause) = cause.filter(|cause| !notes.iter().any(|note| note.starts_with(cause))) {
            notes.insert(0, cause.to_owned());
        }
    }

    /// The notes about the room, without those about what this viewer shows.
    fn notes(&self) -> impl Iterator<Item = &String> {
        // The last one follows from the controllers.
        let left_out = [NO_GEOMETRY, UNSEEN_REPORTS, UNSEEN_CONTROLLER];
        let is_of_viewer = move |note: &&String| left_out.iter().any(|start| note.starts_with(start));
        self.figures.notes.iter().filter(move |note| !is_of_viewer(note))
    }

    /// What is wrong where no process of the room is seen: one problem, from which each missing process follows.
    fn of_unseen_room(&self, unseen: String) -> Vec<String> {
        let others: Vec<String> = self.notes().filter(|note| **note != unseen).cloned().collect();
        [unseen].into_iter().chain(others).collect()
    }

    fn found(&self) -> Vec<String> {
        let Figures { controllers, array, nodes, .. } = &self.figures;
        let of_node = |NodeFigures { node, problem, .. }: &NodeFigures| {
            (!problem.is_empty() && !self.is_of_stops(problem)).then(|| format!("{node}: {problem}"))
        };
        // The problems of the processes have that of the controller that commands.
        let unfit = controllers.iter().filter(|one| !one.unfit.is_empty() && !one.role.commands()).map(|one| {
            let (name, unfit) = (&one.name, &one.unfit);
            format!(
                "controller {name} cannot take over {unfit}: it does not fit its scenario; its journal has the reason"
            )
        });
        // The problem of the displayed controller can have it.
        let is_named = |name: &str| nodes.iter().any(|node| node.problem.contains(name));
        let silent = controllers.iter().filter(|one| one.role == Role::Silent && !is_named(&one.name)).map(|one| {
            format!(
                "controller {} does not report, although it has not left: it hangs, or the link to it is cut",
                one.name
            )
        });
        let has = |role| controllers.iter().any(|one| one.role == role);
        let leads = match controllers.iter().filter(|one| one.role != Role::Silent).count() {
            0 if self.figures.controller_unseen => Some(UNSEEN_CONTROLLER.to_owned()),
            // Each is named as silent.
            0 if has(Role::Silent) => None,
            0 => Some(format!("{NO_CONTROLLER_SEEN}, or connect to its endpoint or router too")),
            _ if controllers.iter().any(|one| one.role.commands()) => None,
            // Which one the array follows shows after the release.
            _ if self.is_stopped() => None,
            _ if has(Role::Unfollowed) => Some(UNKNOWN_LEADER.to_owned()),
            _ if array.state == ArrayState::Following.name() => Some(
                "no controller that reaches this viewer leads: connect to the one that the array follows, or to the router of the room, too".to_owned(),
            ),
            _ => Some(ALL_STAND_BY.to_owned()),
        };
        let reports = (self.reports_per_s == 0.0 && self.deciding().is_none()).then(|| {
            // A controller that has decided has seen the process that reports.
            let again = if controllers.iter().any(|one| one.decisions > 0) { AGAIN } else { "" };
            format!("{NO_REPORTS}: start the tracker or the simulator{again}, or connect to its endpoint or router too")
        });
        let found = reports.into_iter().chain(leads).chain(self.array_problem());
        let of_nodes = nodes.iter().filter_map(of_node);
        // The cause before what follows from it.
        let (causes, notes) = causes_and_others(self.notes().cloned());
        let others = self.stops.iter().cloned().chain(of_nodes).chain(unfit).chain(silent).chain(notes);
        folded(causes.into_iter().chain(found).chain(others).collect())
    }

    /// The number of decisions of a controller that decides on position reports, if one does.
    fn deciding(&self) -> Option<u64> {
        self.figures.controllers.iter().find(|one| one.is_deciding).map(|one| one.decisions)
    }

    /// The position reports that reach this process, and those that reach the controller alone.
    fn report_line(&self) -> String {
        match self.deciding().filter(|_| self.reports_per_s == 0.0) {
            Some(count) => format!("none reach this command; the controller decides on them ({count} decisions)"),
            None => format!("{:.1} a second", self.reports_per_s),
        }
    }

    /// Whether any array reports.
    fn is_array_seen(&self) -> bool {
        self.figures.array.silent.len() < self.figures.array.arrays
    }
}

impl fmt::Display for RoomStatus {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Figures { policy, controllers, array, users, sum_mbps, times, .. } = &self.figures;
        let verdict = if self.is_healthy { "healthy".into() } else { counted(self.problems.len(), "problem") };
        writeln!(formatter, "room {}: {verdict}", self.room)?;
        let or_none = |text: String| if text.is_empty() { "none".to_owned() } else { text };
        let controllers: Vec<String> = controllers.iter().map(ToString::to_string).collect();
        // Without reports, whose line says so, both are unknown.
        let are_users_seen = self.figures.origin != Origin::NoData;
        let users = if are_users_seen { users_line(users) } else { "unknown".into() };
        let unknown = || match are_users_seen {
            true => format!("unknown: {}", why_without_rates(&self.figures)),
            false => "unknown".into(),
        };
        let rate = sum_mbps.map_or_else(unknown, |sum| {
            let mark = if sum.is_modelled { ", modelled: no receiver reports gains" } else { "" };
            format!("{:.1} Mbit/s{mark}", sum.policy)
        });
        let decision = times.first().map(|decision| (time(decision, |us| us.p50), time(decision, |us| us.p99)));
        let (p50, p99) = decision.unwrap_or_default();
        // Of each controller: the counts of one that has left are not those of the room.
        let has_taken_over = |one: &&ControllerFigures| one.takeovers + one.false_takeovers > 0;
        let count = |one: &ControllerFigures| format!("{} {} (false {})", one.name, one.takeovers, one.false_takeovers);
        let takeovers: Vec<String> = self.figures.controllers.iter().filter(has_taken_over).map(count).collect();
        let takeovers = (!takeovers.is_empty()).then(|| ("takeovers", takeovers.join(", ")));
        let controllers = ("controllers", or_none(controllers.join(", ")));
        let calibration = self.figures.calibration.as_ref();
        let calibration = calibration.map(|progress| ("calibration", format!("commands the mirrors: {progress}")));
        let lines = [
            ("policy", or_none(policy.clone())),
            (
                "array",
                if self.is_array_seen() {
                    format!("{}, {} mirrors, {} unusable", self.array_state(), array.mirrors, array.unusable)
                } else {
                    array.state.clone()
                },
            ),
            ("stops", self.stop_line()),
            ("reports", self.report_line()),
            ("users", users),
            ("sum rate", rate),
            ("decision", format!("p50 {p50}, p99 {p99}")),
        ];
        for (name, value) in [controllers].into_iter().chain(calibration).chain(takeovers).chain(lines) {
            writeln!(formatter, "{name:<12} {value}")?;
        }
        self.problems.iter().try_for_each(|problem| writeln!(formatter, "problem      {problem}"))?;
        self.figures.remarks.iter().try_for_each(|remark| writeln!(formatter, "no fault     {remark}"))
    }
}

/// How many users there are, have no direct path, and are below their minimum rate, as far as it is known.
fn users_line(users: &[UserFigures]) -> String {
    if users.is_empty() {
        return "0".into();
    }
    let count = |known: fn(&UserFigures) -> Option<bool>, what: &str| {
        let is_such: Vec<bool> = users.iter().filter_map(known).collect();
        let such = is_such.iter().filter(|is_such| **is_such).count();
        match users.len() - is_such.len() {
            0 => format!("{such} {what}"),
            unknown if unknown == users.len() => format!("unknown {what}"),
            unknown => format!("{such} {what} ({unknown} unknown)"),
        }
    };
    let blocked = count(|user| user.blocked, "without a direct path");
    let below = count(|user| user.is_rate_known.then(|| !user.is_met()), "below the minimum rate");
    format!("{}, {blocked}, {below}", users.len())
}

#[cfg(test)]
mod tests {
    use crate::array_faults::faults_note;
    use crate::causes::OTHERS_MISSING;
    use crate::figures::ArrayFigures;
    use crate::notes::room_unseen;
    use crate::sums::SumFigures;

    use super::*;

    #[test]
    fn a_room_is_healthy_only_with_reports_a_leader_and_an_array_that_follows() {
        let controller = |role| ControllerFigures { role, ..ControllerFigures::default() };
        let array = ArrayFigures { state: "following".into(), ..ArrayFigures::default() };
        let figures = |controllers| Figures { controllers, array: array.clone(), ..Figures::default() };
        let found = |figures| RoomStatus { reports_per_s: 20.0, figures, ..RoomStatus::default() }.found();
        assert_eq!(found(figures(vec![controller(Role::Leads), controller(Role::StandsBy)])), [""; 0]);
        let stands_by = || figures(vec![controller(Role::StandsBy)]);
        assert!(found(stands_by())[0].starts_with("no controller that reaches this viewer leads: connect"));
        let holding = ArrayFigures { state: "holding".into(), ..ArrayFigures::default() };
        let unled = found(Figures { array: holding, ..stands_by() });
        assert_eq!(unled, ["no controller leads: each stands by; it causes: the array does not follow"]);
        let unfollowed = found(figures(vec![controller(Role::Unfollowed); 2]));
        assert_eq!(unfollowed, ["no controller leads: no telemetry shows which one the array follows"]);
        let calibrated = figures(vec![controller(Role::Calibrates), controller(Role::StandsBy)]);
        assert_eq!(found(calibrated), [""; 0], "a calibration commands in place of the leader");
        let absent = ArrayFigures { state: "no report".into(), ..ArrayFigures::default() };
        let absent = Figures { array: absent, ..figures(vec![controller(Role::Unheard)]) };
        let absent = RoomStatus { reports_per_s: 20.0, figures: absent, ..RoomStatus::default() };
        assert_eq!(absent.found(), ["the array does not follow: no report"], "one problem, of the array");
        assert!(absent.to_string().contains(" commands, but no array reports\n"), "{absent}");
        let json = serde_json::to_value(&absent).expect("numbers, texts and lists");
        assert_eq!(json["figures"]["controllers"][0]["role"], "unheard");
        let parked = ArrayFigures { state: "parked".into(), faults: vec!["link"], ..ArrayFigures::default() };
        let link = faults_note(&parked.faults, false).expect("a note");
        let parked = Figures { array: parked, notes: vec![link.clone()], ..figures(vec![controller(Role::Leads)]) };
        assert_eq!(found(parked), ["the array does not follow: parked", link.as_str()]);
        // A simulator whose true state arrives, and no position report.
        let silent = Figures { origin: Origin::Simulated, ..figures(vec![controller(Role::Leads)]) };
        let silent = RoomStatus { figures: silent, ..RoomStatus::default() }.found();
        assert!(silent.len() == 1 && silent[0].starts_with("no position reports: "), "{silent:?}");
        assert!(found(figures(Vec::new()))[0].starts_with("no controller: "));
        for notes in [Vec::new(), vec![UNSEEN_CONTROLLER.to_owned()]] {
            let unseen = Figures { controller_unseen: true, notes, ..figures(Vec::new()) };
            assert_eq!(found(unseen), [UNSEEN_CONTROLLER]);
        }
    }

    #[test]
    fn the_line_of_the_sum_rate_says_why_it_is_unknown() {
        let shown = |origin| {
            let figures = Figures { origin, ..Figures::default() };
            RoomStatus { figures, ..RoomStatus::default() }.to_string()
        };
        let measured = shown(Origin::Real);
        assert!(measured.contains("\nsum rate     unknown: no measured gains\n"), "{measured}");
        let sum = SumFigures { policy: 121.0, is_modelled: true, ..SumFigures::default() };
        let figures = Figures { origin: Origin::Real, sum_mbps: Some(sum), ..Figures::default() };
        let modelled = RoomStatus { figures, ..RoomStatus::default() }.to_string();
        assert!(modelled.contains("\nsum rate     121.0 Mbit/s, modelled: no receiver reports gains\n"), "{modelled}");
        let silent = shown(Origin::NoData);
        assert!(silent.contains("\nusers        unknown\nsum rate     unknown\n"), "{silent}");
    }

    #[test]
    fn a_note_about_the_picture_is_no_problem_of_the_room() {
        let notes = vec![format!("{NO_GEOMETRY}: the picture shows another"), "two drivers serve one array".into()];
        let figures = Figures { notes, ..Figures::default() };
        let found = RoomStatus { figures, ..RoomStatus::default() }.found();
        assert!(!found.iter().any(|problem| problem.contains("picture")), "{found:?}");
        assert_eq!(found.last().map(String::as_str), Some("two drivers serve one array"));
    }

    #[test]
    fn a_difference_of_geometries_is_the_first_problem() {
        let differ = "room and controller differ: room.height_m is 2.8 in the room and 4.0 in the controller c1";
        let figures = Figures { notes: vec!["another note".to_owned(), differ.to_owned()], ..Figures::default() };
        let found = RoomStatus { figures, ..RoomStatus::default() }.found();
        assert_eq!(
            [found.first(), found.last()].map(|found| found.map(String::as_str)),
            [Some(differ), Some("another note")]
        );
    }

    #[test]
    fn a_cut_link_is_named_once_before_the_processes_that_are_missing() {
        let controllers = vec![ControllerFigures { role: Role::StandsBy, ..ControllerFigures::default() }];
        let array = ArrayFigures { state: "no report".into(), ..ArrayFigures::default() };
        let figures = Figures { controllers, array, notes: vec!["another note".into()], ..Figures::default() };
        let mut status = RoomStatus { figures, ..RoomStatus::default() };
        status.add_cause(None);
        assert!(status.found()[0].starts_with("no position reports: "), "{:?}", status.found());
        status.add_cause(Some(OTHERS_MISSING));
        status.add_cause(Some(OTHERS_MISSING));
        let found = status.found();
        let line =
            format!("{OTHERS_MISSING}; it causes: no position reports, no controller leads, the array does not follow");
        assert_eq!(found, [line.as_str(), "another note"]);
    }

    #[test]
    fn a_simulator_that_hangs_is_one_problem() {
        let controllers = vec![ControllerFigures { role: Role::Unheard, ..ControllerFigures::default() }];
        let array = ArrayFigures { state: "no report".into(), ..ArrayFigures::default() };
        let figures = Figures { controllers, array, ..Figures::default() };
        let mut status = RoomStatus { figures, ..RoomStatus::default() };
        assert_eq!(status.found().len(), 2);
        status.add_cause(Some(&simulator_silent()));
        let line = format!("{}; it causes: no position reports, the array does not follow", simulator_silent());
        assert_eq!(status.found(), [line]);
    }

    #[test]
    fn a_tracker_that_a_controller_has_seen_may_hang() {
        let found = |decisions| {
            let controllers = vec![ControllerFigures { decisions, ..ControllerFigures::default() }];
            RoomStatus { figures: Figures { controllers, ..Figures::default() }, ..RoomStatus::default() }.found()
        };
        let start = "no position reports: start the tracker or the simulator";
        let connect = ", or connect to its endpoint or router too";
        assert_eq!(found(0)[0], format!("{start}{connect}"));
        assert_eq!(found(9)[0], format!("{start}{AGAIN}{connect}"));
    }

    #[test]
    fn a_remark_is_shown_and_is_no_problem() {
        let figures = |remarks| Figures { remarks, ..Figures::default() };
        let status = |figures| RoomStatus { figures, ..RoomStatus::default() };
        let (without, with) = (status(figures(Vec::new())), status(figures(vec!["a measured room".to_owned()])));
        assert_eq!(without.found(), with.found());
        assert!(with.to_string().ends_with("no fault     a measured room\n"), "{with}");
    }

    #[test]
    fn a_room_of_which_nothing_is_seen_has_one_problem_that_names_the_room() {
        let notes = vec![room_unseen(None), format!("{NO_GEOMETRY}: the picture shows another"), "refused".to_owned()];
        let figures = Figures { notes, ..Figures::default() };
        let problems = RoomStatus { figures, ..RoomStatus::default() }.of_unseen_room(room_unseen(None));
        assert_eq!(problems, [room_unseen(None), "refused".to_owned()]);
        assert!(problems[0].contains("check --room and --connect"), "{problems:?}");
    }

    #[test]
    fn a_standby_of_another_geometry_is_a_problem() {
        let standby = |unfit: &str| ControllerFigures {
            name: "b".into(),
            role: Role::StandsBy,
            unfit: unfit.into(),
            ..Default::default()
        };
        let found = |unfit| {
            let array = ArrayFigures { state: "following".into(), ..ArrayFigures::default() };
            let controllers = vec![ControllerFigures::default(), standby(unfit)];
            let figures = Figures { controllers, array, ..Figures::default() };
            RoomStatus { reports_per_s: 20.0, figures, ..RoomStatus::default() }.found()
        };
        assert_eq!(found(""), [""; 0]);
        let found = found("mirrors-1");
        assert!(found.len() == 1 && found[0].starts_with("controller b cannot take over mirrors-1: "), "{found:?}");
    }

    #[test]
    fn a_controller_that_does_not_report_is_listed_and_is_one_problem() {
        let one = |name: &str, role| ControllerFigures { name: name.into(), role, ..ControllerFigures::default() };
        let status = |controllers, problem: &str| {
            let array = ArrayFigures { state: "following".into(), ..ArrayFigures::default() };
            let node = NodeFigures { node: "controller".into(), problem: problem.into(), ..NodeFigures::default() };
            let figures = Figures { controllers, array, nodes: vec![node], ..Figures::default() };
            RoomStatus { reports_per_s: 20.0, figures, ..RoomStatus::default() }
        };
        let standby = |problem| status(vec![one("a1", Role::Leads), one("b2", Role::Silent)], problem);
        let found = standby("").found();
        assert!(found.len() == 1 && found[0].starts_with("controller b2 does not report, although"), "{found:?}");
        assert!(standby("").to_string().contains("controllers  a1 leads, b2 does not report\n"), "{}", standby(""));
        let json = serde_json::to_value(standby("")).expect("numbers, texts and lists");
        assert_eq!(json["figures"]["controllers"][1]["role"], "silent");
        let problem = "no status from controller b2 for 5 s";
        assert_eq!(standby(problem).found(), [format!("controller: {problem}")], "the leader names it too");
        let alone = status(vec![one("b2", Role::Silent)], "").found();
        assert!(alone.len() == 1 && alone[0].starts_with("controller b2 does not report"), "{alone:?}");
    }

    #[test]
    fn reports_that_reach_the_controller_alone_are_no_problem() {
        let status = |is_deciding| {
            let leader = ControllerFigures { decisions: 40, is_deciding, ..ControllerFigures::default() };
            let array = ArrayFigures { state: "following".into(), ..ArrayFigures::default() };
            let notes = vec![format!("{UNSEEN_REPORTS}: connect")];
            let figures = Figures { controllers: vec![leader], array, notes, ..Figures::default() };
            RoomStatus { figures, ..RoomStatus::default() }
        };
        assert_eq!(status(true).found(), [""; 0]);
        let line = "reports      none reach this command; the controller decides on them (40 decisions)";
        assert!(status(true).to_string().contains(line), "{}", status(true));
        assert!(status(false).found()[0].starts_with("no position reports: "));
    }

    #[test]
    fn a_calibration_that_commands_is_named_with_its_progress() {
        let one = ControllerFigures { role: Role::Calibrates, name: "940fe16".into(), ..ControllerFigures::default() };
        let array = ArrayFigures { state: "following".into(), ..ArrayFigures::default() };
        let calibration = Some("spot 1 of 3, 57 of 100 mirrors located".into());
        let figures = Figures { controllers: vec![one], array, calibration, ..Figures::default() };
        let status = RoomStatus { reports_per_s: 20.0, figures, ..RoomStatus::default() };
        assert_eq!(status.found(), [""; 0]);
        let lines = "controllers  940fe16 calibrates\n\
                     calibration  commands the mirrors: spot 1 of 3, 57 of 100 mirrors located\n";
        assert!(status.to_string().contains(lines), "{status}");
        let json = serde_json::to_value(&status).expect("numbers, texts and lists");
        assert_eq!(json["figures"]["controllers"][0]["role"], "calibrates");
    }

    #[test]
    fn what_no_receiver_reports_of_the_users_is_unknown() {
        let user = |blocked, is_rate_known| UserFigures {
            blocked,
            is_rate_known,
            min_rate_mbps: 1.0,
            ..UserFigures::default()
        };
        let (known, unknown) = (user(Some(true), true), user(None, false));
        assert_eq!(
            users_line(&[unknown.clone(), unknown.clone()]),
            "2, unknown without a direct path, unknown below the minimum rate"
        );
        assert_eq!(
            users_line(&[known.clone(), unknown]),
            "2, 1 without a direct path (1 unknown), 1 below the minimum rate (1 unknown)"
        );
        assert_eq!(users_line(&[known]), "1, 1 without a direct path, 1 below the minimum rate");
    }

    #[test]
    fn takeovers_have_a_line_of_each_controller_where_there_are_any() {
        let with = |takeovers, false_takeovers| {
            let one = |name: &str, takeovers, false_takeovers| ControllerFigures {
                name: name.into(),
                takeovers,
                false_takeovers,
                ..ControllerFigures::default()
            };
            let controllers = vec![one("a", takeovers, false_takeovers), one("b", 0, 0)];
            let figures = Figures { controllers, ..Figures::default() };
            RoomStatus { figures, ..RoomStatus::default() }.to_string()
        };
        assert!(with(2, 1).contains("\ntakeovers    a 2 (false 1)\n"), "{}", with(2, 1));
        assert!(!with(0, 0).contains("takeovers"));
    }
}
