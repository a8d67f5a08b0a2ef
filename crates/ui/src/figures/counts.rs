//! The counters that page and terminal show, each with its meaning.

use std::time::Duration;

use heliostat_proto::{MirrorTelemetry, NodeKind, NodeStatus};

use super::{ARRAY, CONTROLLER, Count, PAGE, ROOM};
use crate::controllers::controller_name;
use crate::problems::running_for;

/// Who counts: the last reports of the processes, and this viewer.
#[derive(Default)]
pub(super) struct Counting<'a> {
    pub controller: Option<&'a NodeStatus>,
    /// Of the simulated room.
    pub room: Option<&'a NodeStatus>,
    /// Of the process that moves the mirrors.
    pub driver: Option<&'a NodeStatus>,
    pub array: Option<&'a MirrorTelemetry>,
    /// Messages that this viewer could not decode.
    pub unreadable: u64,
    pub viewed_for: Duration,
}

impl Counting<'_> {
    /// The process behind a counter, in words, and its age in minutes.
    fn process(&self, of: &str) -> (String, Option<u64>) {
        let minutes = |age: Duration| age.as_secs() / 60;
        let status = match of {
            CONTROLLER => self.controller,
            ROOM => self.room,
            ARRAY => self.driver,
            _ => return ("the server of this page".into(), Some(minutes(self.viewed_for))),
        };
        let Some(status) = status else { return (String::new(), None) };
        let name = format!("{} {}", status.node.name(), controller_name(status.stamp.source));
        (name, (status.started_ns > 0).then(|| minutes(running_for(status))))
    }
}

/// The counters of controller, simulated room, arrays and page.
pub(super) fn counts(counting: &Counting<'_>) -> Vec<Count> {
    let Counting { controller, room, array, unreadable, .. } = *counting;
    let value = |status: Option<&NodeStatus>, counter: &str| {
        let counters = &status?.counters;
        // A controller that waits for its policy publishes few counters; the others are unknown.
        if status.is_some_and(|status| status.node == NodeKind::Controller)
            && !counters.iter().any(|(name, _)| name == NodeStatus::DECISIONS)
        {
            return None;
        }
        let matching = counters.iter().filter(|(name, _)| match counter.strip_suffix('*') {
            Some(start) => name.starts_with(start),
            None => name == counter,
        });
        Some(matching.map(|(_, count)| count).sum::<u64>())
    };
    // The array counts since its own start, also what earlier controllers sent.
    let refused = array.map(|array| array.counters.refused());
    let decisions = value(controller, NodeStatus::DECISIONS);
    let all = [
        ("decisions", CONTROLLER, decisions, false, "Decisions on position reports."),
        (
            "commands",
            CONTROLLER,
            value(controller, "commands"),
            false,
            "Commands that this controller sent, one for each array.",
        ),
        (
            "over 0.5 ms",
            CONTROLLER,
            value(controller, "over_budget"),
            true,
            "Decisions that took longer than the budget of 0.5 ms. Other programs on the processor or a slow policy cause them.",
        ),
        (
            "modelled",
            CONTROLLER,
            value(controller, "modelled"),
            false,
            "Decisions on modelled gains: no receiver has ever reported gains in this room.",
        ),
        (
            "ticks lost",
            ROOM,
            value(room, "lost_ticks"),
            true,
            "Reports of the simulated room that no accepted command answered in time, for example after the end of a controller. Those during a stop of all arrays do not count.",
        ),
        (
            "ticks late",
            ROOM,
            value(room, "late_ticks"),
            true,
            "Reports of the simulated room that it published late, because other programs used the processor. It is no fault of the controller.",
        ),
        (
            "fallbacks",
            CONTROLLER,
            value(controller, "fallback:*").and(controller.map(NodeStatus::fallbacks)),
            true,
            NodeStatus::FALLBACKS_MEANING,
        ),
        (
            "reports refused",
            CONTROLLER,
            value(controller, "refused:*"),
            true,
            "Messages that the controller refused, for example for their age or their place.",
        ),
        ("array refused", ARRAY, refused, true, "Commands that the arrays refused, for example during a stop."),
        ("unreadable", PAGE, Some(unreadable), true, "Messages of the room that this page cannot decode."),
    ];
    let all = all.into_iter().map(|(name, of, value, is_problem, meaning)| {
        let (process, minutes) = counting.process(of);
        Count { name: name.into(), of, value, is_problem, meaning, process, minutes }
    });
    // Shown where it counts anything: a room with receivers never has it.
    all.filter(|count| count.name != "modelled" || count.value.is_some_and(|value| value > 0)).collect()
}

#[cfg(test)]
mod tests {
    use heliostat_proto::Stamp;

    use super::*;

    #[test]
    fn a_command_that_is_withheld_is_no_fallback() {
        let counters = [("decisions", 9), ("fallback:late", 2), ("fallback:standby", 5), ("fallback:withheld", 7)];
        let counters = counters.map(|(name, count)| (name.to_owned(), count)).to_vec();
        let status = NodeStatus { node: NodeKind::Controller, counters, ..NodeStatus::default() };
        let mut shown = counts(&Counting { controller: Some(&status), ..Counting::default() }).into_iter();
        assert_eq!(shown.find(|count| count.name == "fallbacks").and_then(|count| count.value), Some(2));
    }

    #[test]
    fn the_guide_of_the_page_explains_each_counter() {
        let guide = include_str!("../../../../docs/page.md");
        let explained: String = guide.lines().filter(|line| line.starts_with("- **`")).collect();
        let counters = ["decisions", "modelled"].map(|name| (name.to_owned(), 1)).to_vec();
        let status = NodeStatus { node: NodeKind::Controller, counters, ..NodeStatus::default() };
        let shown = counts(&Counting { controller: Some(&status), ..Counting::default() });
        assert!(shown.iter().any(|count| count.name == "modelled"));
        for Count { name, .. } in shown {
            assert!(explained.contains(&format!("`{name}`")), "docs/page.md lacks {name}");
        }
    }

    #[test]
    fn each_counter_has_the_process_that_counts_and_the_minutes_since_its_start() {
        let of = |node, source, minutes: u64| {
            let started_ns = 1_000_000_000;
            let stamp = Stamp { source, time_ns: started_ns + minutes * 60_000_000_000, ..Stamp::default() };
            NodeStatus { node, stamp, started_ns, ..NodeStatus::default() }
        };
        let (controller, room) = (of(NodeKind::Controller, 0xa, 2), of(NodeKind::SimNode, 0xb, 61));
        let counting = Counting { controller: Some(&controller), room: Some(&room), ..Counting::default() };
        let of = |name: &str| {
            let found = counts(&counting).into_iter().find(|count| count.name == name);
            found.map(|count| (count.process, count.minutes)).unwrap_or_default()
        };
        assert_eq!(of("commands"), ("controller 000000000000000a".into(), Some(2)));
        assert_eq!(of("ticks lost"), ("sim-node 000000000000000b".into(), Some(61)));
        assert_eq!(of("array refused"), (String::new(), None), "no status of a driver");
        assert_eq!(of("unreadable"), ("the server of this page".into(), Some(0)));
    }
}
