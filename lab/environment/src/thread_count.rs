//! How many threads a computation may have, by a flag or by the variable of its pool.

/// Most threads: far more than a machine has processors, and few enough that each can start.
pub const THREADS_MAX: u16 = 1024;

/// The variable that sets the number of threads where no flag does.
pub const THREADS_VARIABLE: &str = "RAYON_NUM_THREADS";

/// Refuses a number of threads in the variable that is too large. What is no number sets none.
///
/// # Errors
/// What was found, and what was expected.
pub fn check_thread_variable(value: Option<&str>) -> Result<(), String> {
    let count = value.and_then(|value| value.parse::<usize>().ok()).unwrap_or_default();
    match count > usize::from(THREADS_MAX) {
        true => {
            Err(format!("{THREADS_VARIABLE}={count}: expected at most {THREADS_MAX} threads, or 0 for one a processor"))
        }
        false => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_variable_with_more_threads_than_can_start_is_refused() {
        for accepted in [None, Some(""), Some("0"), Some("1024"), Some("many")] {
            assert_eq!(check_thread_variable(accepted), Ok(()), "{accepted:?}");
        }
        let refused = check_thread_variable(Some("100000")).expect_err("too many");
        assert!(refused.starts_with("RAYON_NUM_THREADS=100000: expected at most 1024 threads"), "{refused}");
    }
}
