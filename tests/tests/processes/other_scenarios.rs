//! Replays of a recording in which a controller used another scenario than the recorder, or has no status.

use std::path::Path;

use heliostat_proto::{MirrorCommand, NodeKind, NodeStatus, codec};
use heliostat_tests::{Process, encoded, golden_recording};
use tempfile::TempDir;

use crate::recording::copy;

/// The source id of the controller with another scenario.
const VISITOR: u64 = 0xabcd;

/// The status of a controller with another scenario, of the epoch that is so much later.
fn of_visitor(payload: &[u8], later: u64) -> Option<Vec<u8>> {
    let mut status = codec::decode::<NodeStatus>(payload).ok().filter(|status| status.node == NodeKind::Controller)?;
    status.stamp.source = VISITOR;
    status.scenario = "0123456789abcdef".into();
    status.counters.iter_mut().filter(|(name, _)| name == "epoch").for_each(|(_, epoch)| *epoch += later);
    Some(encoded(&status))
}

fn verify(file: &Path) -> Process {
    Process::heliostat(&["replay", &file.to_string_lossy(), "--json", "--verify"])
}

#[test]
fn a_visitor_with_another_scenario_leaves_the_commands_of_the_others_replayable() {
    let folder = TempDir::new().unwrap();
    let file = folder.path().join("changed.mcap");
    copy(&golden_recording(), &file, |_, payload| {
        let command = codec::decode::<MirrorCommand>(&payload).ok().map(|mut command| {
            command.epoch += 1;
            command.roll.fill(0.0);
            encoded(&command)
        });
        let further = command.or_else(|| of_visitor(&payload, 1));
        [Some(payload), further].into_iter().flatten()
    });
    let verdict = verify(&file).wait().json();
    assert_eq!((verdict["same"].as_u64(), verdict["different"].as_u64()), (Some(120), Some(0)), "{verdict}");
    let left_out = &verdict["left_out"][0];
    assert_eq!(left_out["controller"], format!("{VISITOR:016x}"), "{verdict}");
    assert_eq!(left_out["commands"].as_u64(), Some(120), "{verdict}");
}

#[test]
fn the_commands_of_a_takeover_whose_status_the_file_lacks_leave_the_others_replayable() {
    let folder = TempDir::new().unwrap();
    let file = folder.path().join("cut.mcap");
    copy(&golden_recording(), &file, |_, payload| {
        let further = codec::decode::<MirrorCommand>(&payload).ok().map(|mut command| {
            command.epoch += 1;
            command.roll.fill(0.0);
            encoded(&command)
        });
        [Some(payload), further].into_iter().flatten()
    });
    let verdict = verify(&file).wait().json();
    assert_eq!((verdict["same"].as_u64(), verdict["different"].as_u64()), (Some(120), Some(0)), "{verdict}");
    assert_eq!(verdict["without_policy"].as_u64(), Some(120), "{verdict}");
}

#[test]
fn a_recording_whose_only_controller_used_another_scenario_names_it_and_both_possible_causes() {
    let folder = TempDir::new().unwrap();
    let file = folder.path().join("changed.mcap");
    copy(&golden_recording(), &file, |_, payload| [of_visitor(&payload, 0).unwrap_or(payload)]);
    let ended = verify(&file).wait();
    assert_eq!(ended.status.code(), Some(2), "{}", ended.errors);
    let expected = format!("controller {VISITOR:016x} used scenario 0123456789abcdef, it holds ");
    assert!(ended.errors.contains(&expected), "{}", ended.errors);
    assert!(ended.errors.contains("either the recorder or the controller did not have"), "{}", ended.errors);
}
