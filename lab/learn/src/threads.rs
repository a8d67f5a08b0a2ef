//! The threads of a computation, and independent parts of one that run at the same time.
//!
//! The results of parts are in their order, and each part begins from the same state. The figures are therefore
//! the same, bit for bit, for any number of threads.

use anyhow::Context;
use heliostat_environment::thread_count::{THREADS_VARIABLE, check_thread_variable};
use heliostat_files::UnusableInput;
use rayon::iter::{IntoParallelIterator, ParallelIterator};

/// Runs the work on a pool of this many threads; 0: the number in `RAYON_NUM_THREADS`, or one for each processor.
///
/// # Errors
/// [`UnusableInput`] for a variable with too many threads; the system refuses a thread.
pub fn on_threads<T: Send>(count: usize, work: impl FnOnce() -> T + Send) -> anyhow::Result<T> {
    if count == 0 {
        check_thread_variable(std::env::var(THREADS_VARIABLE).ok().as_deref()).map_err(UnusableInput::new)?;
    }
    let pool = rayon::ThreadPoolBuilder::new().num_threads(count).build().context("cannot start a thread")?;
    Ok(pool.install(work))
}

/// The results of `count` parts by their index, in order: at the same time if `is_parallel`, otherwise one after
/// the other. `begin` makes what a thread reuses from part to part, such as buffers.
///
/// # Errors
/// That of a part that fails.
pub(crate) fn parts<S, T: Send>(
    is_parallel: bool,
    count: usize,
    begin: impl Fn() -> S + Send + Sync,
    part: impl Fn(&mut S, usize) -> anyhow::Result<T> + Send + Sync,
) -> anyhow::Result<Vec<T>> {
    if is_parallel {
        return (0..count).into_par_iter().map_init(begin, part).collect();
    }
    let mut reused = begin();
    (0..count).map(|index| part(&mut reused, index)).collect()
}

#[cfg(test)]
mod tests {
    use std::sync::Barrier;

    use super::*;

    #[test]
    fn parts_run_at_the_same_time_and_their_results_are_in_order() {
        // The parts wait for each other, so that one thread would not come to an end.
        let all = Barrier::new(3);
        let part = |(): &mut (), index: usize| {
            all.wait();
            Ok(index)
        };
        let found = on_threads(3, || parts(true, 3, || (), part)).expect("threads").expect("no part fails");
        assert_eq!(found, [0, 1, 2]);
    }

    #[test]
    fn parts_that_are_not_parallel_share_their_state_in_order() {
        let part = |seen: &mut Vec<usize>, index: usize| {
            seen.push(index);
            Ok(seen.clone())
        };
        let found = on_threads(3, || parts(false, 3, Vec::new, part)).expect("threads").expect("no part fails");
        assert_eq!(found, [vec![0], vec![0, 1], vec![0, 1, 2]]);
    }

    #[test]
    fn the_failure_of_a_part_is_that_of_the_whole() {
        for is_parallel in [true, false] {
            let part = |(): &mut (), index: usize| match index {
                2 => Err(anyhow::anyhow!("part 2")),
                _ => Ok(index),
            };
            let error = parts(is_parallel, 4, || (), part).expect_err("a part fails");
            assert_eq!(error.to_string(), "part 2");
        }
    }
}
