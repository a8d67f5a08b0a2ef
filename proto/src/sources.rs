//! The bound on what a receiver keeps of the sources of messages: any number of processes can publish under one key.

use std::collections::BTreeMap;

/// Most sources of which something is kept under one key.
pub const SOURCES_MAX: usize = 64;

/// Makes a place for what is kept of a source, and returns whether there is one. Where all places are taken, a process
/// that is in the room takes the place of one that is not.
pub fn make_place<T>(kept: &mut BTreeMap<u64, T>, source: u64, is_present: impl Fn(u64) -> bool) -> bool {
    if kept.contains_key(&source) || kept.len() < SOURCES_MAX {
        return true;
    }
    let stranger = kept.keys().copied().find(|known| !is_present(*known)).filter(|_| is_present(source));
    stranger.is_some_and(|stranger| kept.remove(&stranger).is_some())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_process_in_the_room_has_a_place_among_very_many_sources() {
        let (mut kept, present) = (BTreeMap::new(), 500..600_u64);
        let mut keep = |source| {
            let has_place = make_place(&mut kept, source, |source| present.contains(&source));
            kept.extend(has_place.then_some((source, ())));
            (has_place, kept.len())
        };
        assert!((1..=SOURCES_MAX as u64).all(|source| keep(source).0));
        assert_eq!([keep(100), keep(1)], [(false, SOURCES_MAX), (true, SOURCES_MAX)]);
        assert!(present.clone().take(SOURCES_MAX).all(|source| keep(source) == (true, SOURCES_MAX)));
        assert_eq!([keep(599), keep(100)], [(false, SOURCES_MAX); 2], "all places have processes of the room");
    }
}
