//! The file of a recorded walk.

use std::path::Path;

use anyhow::{Result, ensure};
use heliostat_room::walks::text::trace_text;
use heliostat_room::walks::tracks::Track;
use heliostat_room::world::trace::Trace;
use heliostat_room::world::walker::Floor;

use heliostat_service::whole_file;

/// Writes users' tracks as a recorded walk that a room with this floor accepts.
pub(super) fn write_trace(users: &[Track], floor: &Floor, out: &Path) -> Result<()> {
    let text = trace_text(users, floor);
    let problems = Trace::problems(&text, users.len(), floor);
    let listed: Vec<String> = problems.iter().map(ToString::to_string).collect();
    ensure!(problems.is_empty(), "the walk cannot be played: {}", listed.join("; "));
    whole_file::write(out, text.as_bytes())
}
