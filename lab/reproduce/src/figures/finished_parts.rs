//! Curves of finished parts: grouped, and averaged over seeds.

use crate::figure::Series;
use crate::part::{Curve, Part};
use crate::statistics::over_seeds;
use crate::store::Finished;

/// A part with what it found.
pub type Done = (Part, Finished);

/// Groups in the order in which they first appear.
pub(super) fn groups(done: &[Done]) -> Vec<&str> {
    let mut groups: Vec<&str> = Vec::new();
    for curve in curves(done) {
        if !groups.contains(&curve.group.as_str()) {
            groups.push(&curve.group);
        }
    }
    groups
}

/// The mean series over seeds of each name of a group, in the order of `names`.
pub(super) fn series(done: &[Done], group: &str, names: &[&str]) -> Vec<Series> {
    let of_name = |name: &&str| {
        let same: Vec<&Curve> = curves(done).filter(|curve| curve.group == group && curve.name == *name).collect();
        over_seeds(name, &same)
    };
    names.iter().filter_map(of_name).collect()
}

pub(super) fn curves(done: &[Done]) -> impl Iterator<Item = &Curve> {
    done.iter().flat_map(|(_, finished)| &finished.measured.curves)
}

/// How many different seeds there are.
pub(super) fn seeds(done: &[Done]) -> usize {
    let mut seeds: Vec<u64> = done.iter().map(|(part, _)| part.seed).collect();
    seeds.sort_unstable();
    seeds.dedup();
    seeds.len()
}

/// How an interval came about, for captions.
pub(super) fn intervals(done: &[Done]) -> String {
    match seeds(done) {
        1 => "One seed, so no intervals.".into(),
        seeds => format!("Means over {seeds} seeds; bands are 95 % intervals of the mean over seeds (Student's t)."),
    }
}
