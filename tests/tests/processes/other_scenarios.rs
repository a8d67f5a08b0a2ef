//! Replays of a recording in which a controller used another scenario than the recorder.

use std::fs::File;
use std::path::{Path, PathBuf};

use heliostat_proto::{MirrorCommand, NodeKind, NodeStatus, codec};
use heliostat_record::account::Account;
use heliostat_record::file::{Reading, Recording};
use heliostat_tests::{Process, encoded};
use tempfile::TempDir;

/// The source id of the controller with another scenario.
const VISITOR: u64 = 0xabcd;

/// The golden recording, each payload followed by those that `further` makes of it in its place.
fn changed(folder: &TempDir, further: impl Fn(Vec<u8>) -> Vec<Vec<u8>>) -> PathBuf {
    let golden = Path::new(env!("CARGO_MANIFEST_DIR")).join("data/golden.mcap");
    let file = folder.path().join("changed.mcap");
    let mut reading = Reading::open(File::open(golden).unwrap()).unwrap();
    let mut recording = Recording::create(File::create_new(&file).unwrap(), reading.header()).unwrap();
    while let Some(entry) = reading.entry().unwrap() {
        for payload in further(entry.data) {
            recording.payload(&entry.topic, entry.arrived_ns, entry.arrived_ns, &payload).unwrap();
        }
    }
    recording.finish(&Account::default()).unwrap();
    file
}

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
    let file = changed(&folder, |payload| {
        let command = codec::decode::<MirrorCommand>(&payload).ok().map(|mut command| {
            command.epoch += 1;
            command.roll.fill(0.0);
            encoded(&command)
        });
        let further = command.or_else(|| of_visitor(&payload, 1));
        [Some(payload), further].into_iter().flatten().collect()
    });
    let verdict = verify(&file).wait().json();
    assert_eq!((verdict["same"].as_u64(), verdict["different"].as_u64()), (Some(120), Some(0)), "{verdict}");
    let left_out = &verdict["left_out"][0];
    assert_eq!(left_out["controller"], format!("{VISITOR:016x}"), "{verdict}");
    assert_eq!(left_out["commands"].as_u64(), Some(120), "{verdict}");
}

#[test]
fn a_recording_whose_only_controller_used_another_scenario_names_it_and_both_possible_causes() {
    let folder = TempDir::new().unwrap();
    let file = changed(&folder, |payload| vec![of_visitor(&payload, 0).unwrap_or(payload)]);
    let ended = verify(&file).wait();
    assert_eq!(ended.status.code(), Some(2), "{}", ended.errors);
    let expected = format!("controller {VISITOR:016x} used scenario 0123456789abcdef, it holds ");
    assert!(ended.errors.contains(&expected), "{}", ended.errors);
    assert!(ended.errors.contains("either the recorder or the controller did not have"), "{}", ended.errors);
}
