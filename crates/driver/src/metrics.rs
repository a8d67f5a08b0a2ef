//! The driver's metrics, made together with its status.
//!
//! The counters of commands have the names that the simulated room uses, so that a dashboard shows
//! both kinds of room.

use heliostat_proto::ArrayState;
use heliostat_service::Page;

use crate::summary::Summary;

/// The page of an array in its present state.
pub(crate) fn page(room: &str, summary: &Summary, state: ArrayState, is_recorded: bool) -> Page {
    let mut page = Page::new(&[("room", room)]);
    page.build_info("driver", env!("CARGO_PKG_VERSION"));
    for (name, help, value) in [
        ("heliostat_room_commands", "Commands that the array accepted", summary.commands),
        (
            "heliostat_room_commands_clipped",
            "Accepted commands with an angle beyond the range",
            summary.clipped_commands,
        ),
        ("heliostat_device_connections", "Times that the device was connected", summary.connections),
    ] {
        page.counter(name, help, &[], value);
    }
    for (reason, count) in &summary.refused {
        let labels = [("reason", reason.as_str())];
        page.counter("heliostat_room_refused", "Payloads and commands refused, by reason", &labels, *count);
    }
    page.stop_recorded(&[], is_recorded);
    page.array_state(&[], state.name());
    page
}
