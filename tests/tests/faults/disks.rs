//! Disks that take no more bytes. A limit of the file size stands for them; it needs no rights.

use heliostat_tests::faults::{Array, Launch, Setup};

use crate::{measure, wait_s};

/// A program under which no file grows beyond this size in KiB, and a write beyond it fails instead
/// of ending the process.
fn limited(kib: &str) -> Launch {
    let script = format!("trap '' XFSZ; ulimit -f {kib}; exec \"$@\"");
    Launch { wrapper: ["bash", "-c", &script, "bash"].map(str::to_owned).into(), ..Launch::default() }
}

#[test]
fn a_full_disk_ends_the_recorder_and_not_the_room() {
    measure("a_full_disk_ends_the_recorder_and_not_the_room", || {
        let mut room = Setup::new(Array::Simulated).start();
        let file = room.folder().join("full.mcap").display().to_string();
        let mut refusal = String::new();
        let effect = room.undergo(|room| {
            let recorder = room.start_process(&limited("64"), &["record", "--out", &file]);
            refusal = recorder.wait().refusal().to_owned();
            wait_s(0.2);
        });
        assert!(refusal.contains("no space is left"), "{refusal}");
        effect
    });
}
