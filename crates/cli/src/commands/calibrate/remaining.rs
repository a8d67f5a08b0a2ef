//! The remaining time of a calibration as it is shown: it falls, or the reason of its rise is named. Without a further
//! reading it stays.

use heliostat_calibrate::{Progress, Stage};

/// Rise without an event that is shown: by this share, and by this time in s.
const SLOWER_SHARE: f64 = 1.25;
const SLOWER_S: f64 = 5.0;

/// Least rise in s after an event that is shown.
const RISE_S: f64 = 1.0;

/// What was shown last.
#[derive(Debug, Default)]
pub struct Remaining {
    shown: Option<(Stage, f64)>,
    /// Readings then.
    readings: usize,
    /// Mirrors of a group at the last spot.
    group: usize,
    /// An event since the last rise, which can cause the next one.
    event: Option<String>,
}

impl Remaining {
    /// Replaces the remaining time by the one to show; the reason if it has risen.
    pub fn follow(&mut self, progress: &mut Progress, group: usize) -> Option<String> {
        let Progress { stage, remaining_s, readings, .. } = *progress;
        let has_read = std::mem::replace(&mut self.readings, readings) != readings;
        let Some((former, shown_s)) = self.shown else {
            (self.shown, self.group) = (Some((stage, remaining_s)), group);
            return None;
        };
        self.note_event(former, stage, group);
        if stage == former && !has_read {
            // The estimate follows the times of reports, which tell nothing about readings while none is made.
            progress.remaining_s = shown_s;
            return None;
        }
        let reason = match self.event.take() {
            event if remaining_s <= shown_s => {
                self.event = event;
                None
            }
            Some(event) if remaining_s >= shown_s + RISE_S => Some(event),
            None if remaining_s > SLOWER_SHARE * shown_s + SLOWER_S => {
                Some("readings are slower, or more of them are needed, than expected".to_owned())
            }
            event => {
                self.event = event;
                None
            }
        };
        progress.remaining_s = if reason.is_some() { remaining_s } else { remaining_s.min(shown_s) };
        self.shown = Some((stage, progress.remaining_s));
        reason.map(|reason| format!("about {:.0} s remain, more than before: {reason}", progress.remaining_s))
    }

    fn note_event(&mut self, former: Stage, stage: Stage, group: usize) {
        let event = match (former, stage) {
            (Stage::Dark(from) | Stage::Probe(from) | Stage::Locate(from), Stage::Await(place)) if from == place => {
                Some("the receiver has left its place".to_owned())
            }
            (Stage::Verify, Stage::Await(_)) => Some("the receiver has left its place".to_owned()),
            (Stage::Probe(_), Stage::Locate(place)) => Some(format!("spot {} is searched", place + 1)),
            (Stage::Probe(_) | Stage::Locate(_) | Stage::Verify, Stage::Dark(_)) => {
                Some("the dark readings are made again".to_owned())
            }
            _ if group > self.group => Some("the light is weak, so mirrors are measured in groups".to_owned()),
            _ => None,
        };
        self.group = self.group.max(group);
        self.event = event.or(self.event.take());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_remaining_time_rises_only_with_a_reason_that_is_named() {
        let (mut remaining, mut readings) = (Remaining::default(), 0);
        let mut follow = |stage, remaining_s: f64, group| {
            readings += 1;
            let mut progress = Progress { stage, located: (0, 100), readings, unused: 0, remaining_s };
            let reason = remaining.follow(&mut progress, group);
            (progress.remaining_s, reason.unwrap_or_default())
        };
        assert_eq!(follow(Stage::Dark(0), 100.0, 1), (100.0, String::new()));
        let (shown_s, reason) = follow(Stage::Probe(0), 180.0, 31);
        assert!(shown_s == 180.0 && reason.contains("in groups"), "{reason}");
        for (estimate_s, expected_s) in [(170.0, 170.0), (174.0, 170.0), (160.0, 160.0), (200.0, 160.0)] {
            assert_eq!(follow(Stage::Probe(0), estimate_s, 31), (expected_s, String::new()));
        }
        let (shown_s, reason) = follow(Stage::Probe(0), 300.0, 31);
        assert!(shown_s == 300.0 && reason.contains("slower"), "{reason}");
        // The search reads less than it causes.
        assert_eq!(follow(Stage::Locate(0), 290.0, 31), (290.0, String::new()));
        let (shown_s, reason) = follow(Stage::Probe(0), 310.0, 31);
        assert!(shown_s == 310.0 && reason.ends_with("spot 1 is searched"), "{reason}");
        let (shown_s, reason) = follow(Stage::Await(0), 320.0, 31);
        assert!(shown_s == 320.0 && reason.ends_with("has left its place"), "{reason}");
        assert_eq!(follow(Stage::Await(1), 200.0, 31), (200.0, String::new()));
    }

    #[test]
    fn the_remaining_time_stays_while_no_reading_is_made() {
        let mut remaining = Remaining::default();
        let mut follow = |stage, readings, remaining_s| {
            let mut progress = Progress { stage, located: (0, 100), readings, unused: 0, remaining_s };
            let reason = remaining.follow(&mut progress, 1);
            (progress.remaining_s, reason.is_some())
        };
        assert_eq!(follow(Stage::Probe(0), 580, 35.0), (35.0, false));
        for stage in [Stage::Probe(0), Stage::Await(0), Stage::Dark(0)] {
            let (shown_s, _) = follow(stage, 580, 35.0);
            for estimate_s in [49.0, 70.0, 19.0] {
                assert_eq!(follow(stage, 580, estimate_s), (shown_s, false), "{stage:?}");
            }
        }
        assert_eq!(follow(Stage::Dark(0), 581, 19.0), (19.0, false));
    }
}
