//! Which rooms are reached: a misspelt `--room` names one that has no process, beside others that have some.

use std::collections::BTreeSet;

use heliostat_bus::{Bus, Presence, reached_rooms};
use heliostat_proto::NodeKind;
use heliostat_proto::keys::{parse_alive, parse_alive_room};

/// Most rooms that are named.
const NAMED: usize = 16;

/// That the room of these sessions has no process that one of them reaches, with the rooms that have some; `None` where it
/// has one, and where there are none. It asks the network.
pub fn find_absent_room<'a>(sessions: impl IntoIterator<Item = &'a Bus>) -> Option<String> {
    let (mut own, mut reached) = (None, BTreeSet::new());
    for bus in sessions {
        own = Some(bus.room().name());
        reached.extend(reached_rooms(bus));
    }
    absent_room(own?, &reached)
}

/// As [`find_absent_room`], of a room and the rooms that are reached.
fn absent_room(room: &str, reached: &BTreeSet<String>) -> Option<String> {
    if reached.is_empty() || reached.contains(room) {
        return None;
    }
    let names: Vec<&str> = reached.iter().take(NAMED).map(String::as_str).collect();
    let others = reached.len() - names.len();
    let rest = if others > 0 { format!(" and {others} more") } else { String::new() };
    Some(format!("room {room} has no process here: rooms that are there: {}{rest}", names.join(", ")))
}

/// The rooms that a view sees.
#[derive(Debug, Default)]
pub(crate) struct Rooms {
    /// The room of the view.
    own: String,
    /// Room, kind and source of each process, viewers aside.
    processes: BTreeSet<(String, &'static str, u64)>,
}

impl Rooms {
    /// Of a view of this room, which has seen no process.
    pub fn of(own: &str) -> Self {
        Self { own: own.to_owned(), ..Self::default() }
    }

    /// Notes a liveliness token; returns kind and source of its process where it is in the room of the view.
    pub fn take(&mut self, token: &str, presence: Presence) -> Option<(&'static str, u64)> {
        let ((node, source), room) = (parse_alive(token)?, parse_alive_room(token)?);
        if node != NodeKind::Viewer {
            let process = (room.name().to_owned(), node.name(), source);
            match presence {
                Presence::Alive => self.processes.insert(process),
                Presence::Gone => self.processes.remove(&process),
            };
        }
        (room.name() == self.own).then_some((node.name(), source))
    }

    /// As [`find_absent_room`], by what the view has seen.
    pub fn absent(&self) -> Option<String> {
        let reached: BTreeSet<String> = self.processes.iter().map(|(room, ..)| room.clone()).collect();
        absent_room(&self.own, &reached)
    }
}

#[cfg(test)]
mod tests {
    use heliostat_proto::Room;

    use super::*;

    #[test]
    fn a_room_without_process_is_named_with_those_that_have_some() {
        let named = |names: &[&str]| names.iter().map(|name| (*name).to_owned()).collect::<BTreeSet<String>>();
        let expected = "room lba has no process here: rooms that are there: hall, lab";
        assert_eq!(absent_room("lba", &named(&["lab", "hall"])).as_deref(), Some(expected));
        assert_eq!(absent_room("lba", &named(&["lab", "lba"])), None);
        assert_eq!(absent_room("lba", &named(&[])), None, "nothing is reached");
        let many: BTreeSet<String> = (10..30).map(|number| format!("r{number}")).collect();
        let many = absent_room("lba", &many).expect("no process");
        assert!(many.ends_with(", r25 and 4 more"), "{many}");
    }

    #[test]
    fn the_tokens_of_other_rooms_are_none_of_the_own_one() {
        let mut rooms = Rooms::of("lba");
        let token = |room: &str, node| Room::new(room).expect("a valid name").alive(node, 7);
        assert_eq!(rooms.take(&token("hall", NodeKind::Viewer), Presence::Alive), None);
        assert_eq!(rooms.absent(), None, "a viewer is no process of a room");
        assert_eq!(rooms.take(&token("lab", NodeKind::Driver), Presence::Alive), None);
        assert!(rooms.absent().is_some_and(|absent| absent.ends_with(": lab")));
        assert_eq!(rooms.take(&token("lba", NodeKind::Driver), Presence::Alive), Some((NodeKind::Driver.name(), 7)));
        assert_eq!(rooms.absent(), None);
        rooms.take(&token("lba", NodeKind::Driver), Presence::Gone);
        rooms.take(&token("lab", NodeKind::Driver), Presence::Gone);
        assert_eq!(rooms.absent(), None);
    }
}
