//! Deliberate bugs: each is found, by the invariant that it breaks.

use heliostat_simulation::{Mutation, run_seed};

/// A bug is found within so many seeds.
const SEEDS: u64 = 200;

#[test]
fn each_deliberate_bug_is_found() {
    let mut missed = Vec::new();
    for mutation in Mutation::ALL {
        let violation = (0..SEEDS).find_map(|seed| Some((seed, run_seed(seed, Some(*mutation)).violation?)));
        match violation {
            Some((seed, violation)) if mutation.found_by().contains(&violation.invariant) => {
                println!("{mutation:?}: {} seeds, {violation}", seed + 1);
            }
            Some((seed, violation)) => missed.push(format!("{mutation:?} was found at seed {seed} by {violation}")),
            None => missed.push(format!("{mutation:?} was not found by {SEEDS} seeds")),
        }
    }
    assert!(missed.is_empty(), "{}", missed.join("\n"));
}
