//! The status of a calibration for the viewers of the room, also while an estimate computes.

use std::sync::mpsc::{self, RecvTimeoutError};
use std::thread;
use std::time::Duration;

use anyhow::Result;
use heliostat_calibrate::Session;
use heliostat_proto::gauges::CalibrationProgress;
use heliostat_service::output::note;

use super::remaining::Remaining;
use super::room::LiveRoom;
use super::show;

/// Time between two messages for viewers, which call a process silent after a second.
pub const EVERY: Duration = Duration::from_millis(500);

/// How far the session is; a note says why its remaining time has risen.
pub fn progress(session: &Session, remaining: &mut Remaining) -> CalibrationProgress {
    let mut progress = session.progress();
    remaining.follow(&mut progress, session.group()).iter().for_each(note);
    show::progress_of(&progress, session.spot_count())
}

/// Makes the estimate that is due. With many mirrors it takes minutes, in which the status goes on.
pub fn run_estimate(session: &mut Session, room: &mut LiveRoom, remaining: &mut Remaining) -> Result<()> {
    let mut computing = progress(session, remaining);
    // The stage may await the receiver already, also at another place.
    (computing.is_waiting, computing.is_computing) = (false, true);
    if let Some(index) = session.due_place() {
        computing.place = u32::try_from(index + 1).unwrap_or(u32::MAX);
    }
    let mut published = Ok(());
    let publish = || {
        if published.is_ok() {
            published = room.publish_status(&computing);
        }
    };
    beside(|| session.run_estimate(), EVERY, publish);
    published
}

/// Works on another thread. Until this ends, it repeats something on the present one: at once, and after each interval.
fn beside(work: impl FnOnce() + Send, every: Duration, mut repeated: impl FnMut()) {
    let (end, ended) = mpsc::channel::<()>();
    thread::scope(|scope| {
        scope.spawn(move || {
            // It is dropped at the end of the work, also at that by a panic.
            let _end = end;
            work();
        });
        loop {
            repeated();
            if ended.recv_timeout(every) != Err(RecvTimeoutError::Timeout) {
                break;
            }
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_status_is_repeated_until_a_long_work_has_ended() {
        let (published, seen) = mpsc::channel();
        let mut count = 0;
        let work = move || (0..3).for_each(|_| seen.recv_timeout(Duration::from_secs(60)).expect("one more status"));
        beside(work, Duration::from_millis(1), || {
            count += 1;
            // The work has ended where the other end is gone.
            let _ = published.send(());
        });
        assert!(count >= 3, "{count}");
    }
}
