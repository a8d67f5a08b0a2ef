//! The command line that reproduces a figure. Local paths (`--out`, `--write-docs`) and output
//! options are omitted.

use crate::plan::Room;

/// The command that reproduces one figure in one room.
pub fn of_figure(id: &str, room: &Room) -> String {
    begun(id) + &room.flags
}

/// The command up to its flags.
pub(crate) fn begun(what: &str) -> String {
    format!("heliostat-lab reproduce {what} --out DIR")
}
