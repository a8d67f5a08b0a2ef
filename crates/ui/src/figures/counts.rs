//! The counters that page and terminal show, each with its meaning.

use heliostat_proto::{MirrorTelemetry, NodeKind, NodeStatus};

use super::{ARRAY, CONTROLLER, Count, PAGE, ROOM};

/// The counters of controller, simulated room, arrays and page.
pub(super) fn counts(
    controller: Option<&NodeStatus>,
    room: Option<&NodeStatus>,
    array: Option<&MirrorTelemetry>,
    unreadable: u64,
) -> Vec<Count> {
    let value = |status: Option<&NodeStatus>, counter: &str| {
        let counters = &status?.counters;
        // A controller that waits for its policy publishes few counters; the others are unknown.
        if status.is_some_and(|status| status.node == NodeKind::Controller)
            && !counters.iter().any(|(name, _)| name == "decisions")
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
    let decisions = value(controller, "decisions");
    let all = [
        (
            "decisions",
            CONTROLLER,
            decisions,
            false,
            "Decisions on position reports since the start of this controller.",
        ),
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
            "Decisions that took longer than the budget of 0.5 ms.",
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
            "Reports of the simulated room that no accepted command answered in time. Those during a stop of all arrays do not count.",
        ),
        ("ticks late", ROOM, value(room, "late_ticks"), true, "Reports of the simulated room that it published late."),
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
    let all = all.into_iter().map(|(name, of, value, is_problem, meaning)| Count {
        name: name.into(),
        of,
        value,
        is_problem,
        meaning,
    });
    // Shown where it counts anything: a room with receivers never has it.
    all.filter(|count| count.name != "modelled" || count.value.is_some_and(|value| value > 0)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_command_that_is_withheld_is_no_fallback() {
        let counters = [("decisions", 9), ("fallback:late", 2), ("fallback:standby", 5), ("fallback:withheld", 7)];
        let counters = counters.map(|(name, count)| (name.to_owned(), count)).to_vec();
        let status = NodeStatus { node: NodeKind::Controller, counters, ..NodeStatus::default() };
        let mut shown = counts(Some(&status), None, None, 0).into_iter();
        assert_eq!(shown.find(|count| count.name == "fallbacks").and_then(|count| count.value), Some(2));
    }
}
