//! The driver's metrics, made together with its status.

use heliostat_proto::ArrayState;
use heliostat_service::Page;

use crate::summary::Summary;

/// The page of an array in its present state.
pub(crate) fn page(room: &str, summary: &Summary, state: ArrayState, is_recorded: bool) -> Page {
    let mut page = Page::new(&[("room", room)]);
    page.build_info("driver", env!("CARGO_PKG_VERSION"));
    page.commands(summary.commands, summary.clipped_commands, &summary.refused);
    page.counter("heliostat_device_connections", "Times that the device was connected", &[], summary.connections);
    page.stop_recorded(&[], is_recorded);
    page.array_state(&[], state.name());
    page
}
