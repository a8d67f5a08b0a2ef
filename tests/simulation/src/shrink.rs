//! The smallest part of a plan that still fails: delta debugging over its faults.

use crate::plan::Timed;

/// Removes faults in ever smaller groups while the rest still fails.
pub(crate) fn shrink(faults: &[Timed], fails: impl Fn(&[Timed]) -> bool) -> Vec<Timed> {
    let mut kept = faults.to_vec();
    let mut group = kept.len().div_ceil(2);
    while group > 0 && !kept.is_empty() {
        let mut start = 0;
        while start < kept.len() {
            let end = kept.len().min(start + group);
            let rest: Vec<Timed> = kept[..start].iter().chain(&kept[end..]).cloned().collect();
            if fails(&rest) {
                kept = rest;
            } else {
                start = end;
            }
        }
        group /= 2;
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::Fault;

    #[test]
    fn only_the_faults_that_are_needed_together_remain() {
        let faults: Vec<Timed> = (0..17).map(|at_ms| Timed { at_ms, for_ms: 0, fault: Fault::Stop }).collect();
        let has = |faults: &[Timed], at_ms: u64| faults.iter().any(|timed| timed.at_ms == at_ms);
        let kept = shrink(&faults, |rest| has(rest, 3) && has(rest, 11));
        assert_eq!(kept.iter().map(|timed| timed.at_ms).collect::<Vec<_>>(), [3, 11]);
    }
}
