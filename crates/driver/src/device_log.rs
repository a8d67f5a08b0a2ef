//! What the log has about a device: whether it answers, and which mirrors do not follow their commands.

/// Mirrors that a line names; the others are counted.
const NAMED: usize = 12;

/// The state of a device at the last call.
#[derive(Debug, Default)]
pub(crate) struct DeviceLog {
    is_absent: bool,
    problems: u64,
    unusable: Vec<u32>,
}

/// What has changed since the last call.
#[derive(Debug, Default, PartialEq, Eq)]
pub(crate) struct Changes {
    /// Whether it no longer answers, or did not between the two calls; its last problem has the reason.
    pub is_lost: bool,
    /// Mirrors that do not follow.
    pub warning: Option<String>,
    /// The ends of earlier problems.
    pub ends: Vec<String>,
}

impl DeviceLog {
    /// Compares with the last call: whether the device does not answer, its number of problems so far, and the mirrors
    /// that do not follow. Those of a device that does not answer are not compared.
    pub fn changes(&mut self, is_absent: bool, problems: u64, unusable: &[u32]) -> Changes {
        let was_absent = std::mem::replace(&mut self.is_absent, is_absent);
        let has_failed = std::mem::replace(&mut self.problems, problems) < problems;
        if is_absent {
            return Changes { is_lost: !was_absent, ..Changes::default() };
        }
        let answers = (was_absent || has_failed).then(|| "the device answers".to_owned());
        let before = std::mem::replace(&mut self.unusable, unusable.to_vec());
        let stuck = not_in(unusable, &before);
        let recovered = not_in(&before, unusable);
        let follow = said(&recovered, ["follows its commands again", "follow their commands again"]);
        Changes {
            is_lost: has_failed && !was_absent,
            warning: said(&stuck, ["does not follow its commands", "do not follow their commands"]),
            ends: answers.into_iter().chain(follow).collect(),
        }
    }
}

fn not_in(mirrors: &[u32], others: &[u32]) -> Vec<u32> {
    mirrors.iter().copied().filter(|mirror| !others.contains(mirror)).collect()
}

/// A statement about one mirror or several, by their numbers; none about no mirror.
fn said(mirrors: &[u32], [of_one, of_several]: [&str; 2]) -> Option<String> {
    let numbers: Vec<String> = mirrors.iter().take(NAMED).map(ToString::to_string).collect();
    let rest = mirrors.len().saturating_sub(NAMED);
    let rest = if rest > 0 { format!(" and {rest} others") } else { String::new() };
    match mirrors {
        [] => None,
        [mirror] => Some(format!("mirror {mirror} {of_one}")),
        _ => Some(format!("mirrors {}{rest} {of_several}", numbers.join(", "))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_device_that_answers_again_is_logged_also_where_it_was_lost_between_two_calls() {
        let mut log = DeviceLog::default();
        let mut changes = |is_absent, problems| log.changes(is_absent, problems, &[]);
        assert_eq!(changes(false, 0), Changes::default(), "it answers from the start");
        assert!(changes(true, 1).is_lost);
        assert_eq!(changes(true, 2), Changes::default(), "it is still lost");
        assert_eq!(changes(false, 2).ends, ["the device answers"]);
        assert!(changes(true, 3).is_lost, "lost again, with the same reason");
        assert_eq!(changes(false, 3).ends, ["the device answers"]);
        let short = changes(false, 4);
        assert_eq!(short.ends, ["the device answers"], "lost for less than the time between two calls");
        assert!(short.is_lost, "the reason comes before it");
        assert_eq!(changes(false, 4), Changes::default());
    }

    #[test]
    fn mirrors_that_stick_and_recover_are_logged_and_those_of_a_lost_device_are_not() {
        let mut log = DeviceLog::default();
        let stuck = log.changes(false, 0, &[3, 7]);
        assert_eq!(stuck.warning.as_deref(), Some("mirrors 3, 7 do not follow their commands"));
        assert_eq!(log.changes(false, 0, &[3, 7]), Changes::default());
        assert_eq!(log.changes(true, 1, &[0, 1, 2, 3, 4, 5, 6, 7]).warning, None);
        let returned = log.changes(false, 1, &[7]);
        assert_eq!(returned.ends, ["the device answers", "mirror 3 follows its commands again"]);
        let all: Vec<u32> = (0..20).collect();
        let warning = log.changes(false, 1, &all).warning.expect("19 more");
        assert!(warning.starts_with("mirrors 0, 1, 2, 3, 4, 5, 6, 8, 9, 10, 11, 12 and 7 others do"), "{warning}");
    }
}
