//! The state of a room at one instant, for an operator: who leads, what the arrays do, and what is wrong.

use std::fmt;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use heliostat_bus::{Bus, Subscription};
use heliostat_proto::{ArrayState, UserReport, codec};
use heliostat_service::counted::counted;
use serde::Serialize;

use crate::figures::{Figures, NodeFigures, Origin};
use crate::terminal::texts::{stops, time, without_rates};
use crate::{UiError, View};

/// The position reports of a room since a subscription.
pub struct ReportCount {
    begun: Instant,
    count: Arc<AtomicU64>,
    _subscription: Subscription,
}

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
    /// Position reports a second.
    pub reports_per_s: f64,
    /// The figures of the page.
    pub figures: Figures,
}

impl ReportCount {
    /// Counts from now on.
    ///
    /// # Errors
    /// [`UiError::Bus`] if the session is closed.
    pub fn open(bus: &Bus) -> Result<Self, UiError> {
        let count = Arc::new(AtomicU64::new(0));
        let of_subscription = Arc::clone(&count);
        let subscription = bus.subscribe(&bus.room().users(), move |payload| {
            if codec::decode::<UserReport>(payload).is_ok() {
                of_subscription.fetch_add(1, Ordering::Relaxed);
            }
        })?;
        Ok(Self { begun: Instant::now(), count, _subscription: subscription })
    }

    /// Reports a second.
    fn rate(&self) -> f64 {
        self.count.load(Ordering::Relaxed) as f64 / self.begun.elapsed().as_secs_f64().max(1e-3)
    }
}

impl RoomStatus {
    /// The state that a view and a count show.
    pub fn new(room: &str, view: &View, reports: &ReportCount) -> Self {
        let mut status = Self {
            room: room.to_owned(),
            stops: stops(&view.stops.room()),
            reports_per_s: reports.rate(),
            figures: view.figures(),
            ..Self::default()
        };
        status.problems = status.found();
        status.is_healthy = status.problems.is_empty();
        status
    }

    fn found(&self) -> Vec<String> {
        let Figures { controllers, array, nodes, notes, .. } = &self.figures;
        let of_node = |NodeFigures { node, problem, .. }: &NodeFigures| {
            (!problem.is_empty()).then(|| format!("{node}: {problem}"))
        };
        let leads = match (controllers.len(), controllers.iter().all(|one| one.is_standby)) {
            (0, _) => Some("no controller: start one, or connect to its endpoint or router too"),
            (_, true) => Some("no controller leads: each stands by"),
            (_, false) => None,
        };
        let reports = (self.reports_per_s == 0.0).then(|| {
            "no position reports: start the tracker or the simulator, or connect to its endpoint or router too".into()
        });
        let array_state = (array.state != ArrayState::Following.name())
            .then(|| format!("the array does not follow: {}", array.state));
        let faults = (!array.faults.is_empty()).then(|| format!("faults of the array: {}", array.faults.join(", ")));
        let found = reports.into_iter().chain(leads.map(String::from)).chain(array_state).chain(faults);
        found.chain(self.stops.iter().cloned()).chain(nodes.iter().filter_map(of_node)).chain(notes.clone()).collect()
    }

    /// Whether any array reports.
    fn is_array_seen(&self) -> bool {
        self.figures.array.silent.len() < self.figures.array.arrays
    }

    /// The stops. Only the reports of an array show that no stop holds it.
    fn stop_line(&self) -> String {
        let silent = &self.figures.array.silent;
        match (self.stops.is_empty(), self.is_array_seen(), silent.is_empty()) {
            (false, ..) => self.stops.join("; "),
            (true, false, _) => "unknown: no array reports; connect to its process or router too".into(),
            (true, true, false) => format!("none that reports show; unknown of {}", silent.join(" and ")),
            (true, true, true) => "none".into(),
        }
    }
}

impl fmt::Display for RoomStatus {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Figures { policy, controllers, array, users, sum_mbps, times, .. } = &self.figures;
        let verdict = if self.is_healthy { "healthy".into() } else { counted(self.problems.len(), "problem") };
        writeln!(formatter, "room {}: {verdict}", self.room)?;
        let or_none = |text: String| if text.is_empty() { "none".to_owned() } else { text };
        let role = |is_standby| if is_standby { "stands by" } else { "leads" };
        let controllers: Vec<String> =
            controllers.iter().map(|one| format!("{} {}", one.name, role(one.is_standby))).collect();
        let are_users_seen = self.figures.origin != Origin::NoData;
        let blocked = users.iter().filter(|user| user.blocked == Some(true)).count();
        let below = users.iter().filter(|user| user.is_rate_known && !user.is_met()).count();
        let rate = sum_mbps.map_or_else(|| without_rates(&self.figures), |sum| format!("{:.1} Mbit/s", sum.policy));
        let decision = times.first().map(|decision| (time(decision, |us| us.p50), time(decision, |us| us.p99)));
        let (p50, p99) = decision.unwrap_or_default();
        for (name, value) in [
            ("controllers", or_none(controllers.join(", "))),
            ("policy", or_none(policy.clone())),
            (
                "array",
                if self.is_array_seen() {
                    format!("{}, {} mirrors, {} unusable", array.state, array.mirrors, array.unusable)
                } else {
                    array.state.clone()
                },
            ),
            ("stops", self.stop_line()),
            ("reports", format!("{:.1} a second", self.reports_per_s)),
            (
                "users",
                if are_users_seen {
                    format!("{}, {blocked} without a direct path, {below} below the minimum rate", users.len())
                } else {
                    "unknown: no position reports".into()
                },
            ),
            ("sum rate", rate),
            ("decision", format!("p50 {p50}, p99 {p99}")),
        ] {
            writeln!(formatter, "{name:<12} {value}")?;
        }
        self.problems.iter().try_for_each(|problem| writeln!(formatter, "problem      {problem}"))
    }
}

#[cfg(test)]
mod tests {
    use crate::controllers::ControllerFigures;
    use crate::figures::ArrayFigures;

    use super::*;

    #[test]
    fn a_room_is_healthy_only_with_reports_a_leader_and_an_array_that_follows() {
        let controller =
            |is_standby| ControllerFigures { name: "a".into(), is_standby, takeovers: 0, false_takeovers: 0 };
        let array = ArrayFigures { state: "following".into(), ..ArrayFigures::default() };
        let figures = |controllers| Figures { controllers, array: array.clone(), ..Figures::default() };
        let found = |figures| RoomStatus { reports_per_s: 20.0, figures, ..RoomStatus::default() }.found();
        assert_eq!(found(figures(vec![controller(false), controller(true)])), [""; 0]);
        assert_eq!(found(figures(vec![controller(true)])), ["no controller leads: each stands by"]);
        let parked = ArrayFigures { state: "parked".into(), faults: vec!["link"], ..ArrayFigures::default() };
        let parked = Figures { array: parked, ..figures(vec![controller(false)]) };
        assert_eq!(found(parked), ["the array does not follow: parked", "faults of the array: link"]);
        // A simulator whose true state arrives, and no position report.
        let silent = Figures { origin: Origin::Simulated, ..figures(vec![controller(false)]) };
        let silent = RoomStatus { figures: silent, ..RoomStatus::default() }.found();
        assert!(silent.len() == 1 && silent[0].starts_with("no position reports: "), "{silent:?}");
        assert!(found(figures(Vec::new()))[0].starts_with("no controller: "));
    }

    #[test]
    fn no_stop_is_shown_as_absent_for_an_array_that_does_not_report() {
        let line = |silent: &[&str]| {
            let silent = silent.iter().map(|name| (*name).to_owned()).collect();
            let array = ArrayFigures { arrays: 2, mirrors: 24, silent, ..ArrayFigures::default() };
            let status = RoomStatus { figures: Figures { array, ..Figures::default() }, ..RoomStatus::default() };
            let text = status.to_string();
            let line = |name| text.lines().find(|line| line.starts_with(name)).unwrap_or_default().to_owned();
            (line("stops"), line("array").contains("24 mirrors"))
        };
        assert_eq!(line(&[]), ("stops        none".into(), true));
        assert_eq!(line(&["array 1"]), ("stops        none that reports show; unknown of array 1".into(), true));
        let (stops, has_mirrors) = line(&["mirrors", "array 1"]);
        assert!(stops.starts_with("stops        unknown: no array reports") && !has_mirrors, "{stops}");
    }
}
