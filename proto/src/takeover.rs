//! Why a controller took over, in the words of its journal and of the page.

/// Why a controller took over, by what is known: whether the liveliness token of the former leader had ended, and
/// whether the takeover proved to be contested.
pub fn takeover_reason(has_ended: bool, is_contested: bool) -> &'static str {
    match (has_ended, is_contested) {
        (true, false) => "the former leader has ended",
        (false, false) => "no accepted command of the former leader was seen",
        (true, true) => {
            "the liveliness token of the former leader had ended, but it or another controller commanded on, or its token is back"
        }
        (false, true) => {
            "no accepted command of the former leader was seen, but it or another controller commanded on, or its token is back"
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_reason_says_both_that_the_leader_has_ended_and_that_it_was_not_gone() {
        for has_ended in [true, false] {
            let [calm, contested] = [false, true].map(|is_contested| takeover_reason(has_ended, is_contested));
            assert!(contested.contains("commanded on") && !contested.contains("has ended"), "{contested}");
            assert_eq!(calm.contains("has ended"), has_ended, "{calm}");
        }
    }
}
