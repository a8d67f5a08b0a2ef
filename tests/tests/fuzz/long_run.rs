//! Many payloads in one process, from a seed, and the page docs/results/fuzzing.md with the result.

use std::fmt::Write as _;
use std::panic::catch_unwind;
use std::time::{Duration, Instant};

use heliostat_proto::Kind;
use heliostat_tests::faults::page::Origin;
use heliostat_tests::workspace;

use crate::INPUT_MAX;
use crate::bounds::within_bounds;
use crate::room::Room;
use crate::script::Script;
use crate::tally::Tally;

/// The room after the attack of one input: a script, or after a zero byte a transcript.
fn attack(input: &[u8]) -> Room {
    let transcript = input.strip_prefix(&[0]);
    let mut script = Script::new(transcript.unwrap_or(input));
    let mut room = Room::new(&mut script);
    if transcript.is_some() {
        room.replay(&mut script);
    } else {
        room.run(&mut script);
    }
    room
}

/// Attacks a room, which then has to work again; returns what was delivered.
pub fn attack_and_recover(input: &[u8]) -> Tally {
    let mut room = attack(input);
    room.recover();
    *room.tally()
}

/// A generator of inputs: splitmix64, so that a seed gives the same inputs everywhere.
struct Inputs {
    state: u64,
}

impl Inputs {
    fn word(&mut self) -> u64 {
        self.state = self.state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mixed = (self.state ^ (self.state >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        mixed ^ (mixed >> 31)
    }

    fn fill(&mut self, input: &mut Vec<u8>) {
        let length = 64 + self.word() as usize % (INPUT_MAX - 64);
        input.clear();
        input.extend(std::iter::repeat_with(|| self.word().to_le_bytes()).flatten().take(length));
    }
}

fn setting(name: &str, default: u64) -> u64 {
    match std::env::var(name) {
        Ok(text) => text.parse().unwrap_or_else(|_| panic!("invalid {name} \"{text}\": expected a whole number")),
        Err(_) => default,
    }
}

#[test]
#[ignore = "takes hours and writes a page; HELIOSTAT_FUZZ_PAYLOADS and HELIOSTAT_FUZZ_SEED are its settings"]
fn many_payloads_leave_the_room_sound() {
    let (wanted, seed) = (setting("HELIOSTAT_FUZZ_PAYLOADS", 100_000_000), setting("HELIOSTAT_FUZZ_SEED", 1));
    let (commit, start) = (Origin::here().commit, Instant::now());
    let (mut inputs, mut input) = (Inputs { state: seed }, Vec::new());
    let (mut tally, mut count, mut reported) = (Tally::default(), 0_u64, start);
    while tally.hostile < wanted {
        inputs.fill(&mut input);
        count += 1;
        let found = catch_unwind(|| {
            let mut tally = Tally::default();
            within_bounds(&input, || tally = attack_and_recover(&input));
            tally
        });
        match found {
            Ok(found) => tally += found,
            Err(panic) => {
                let folder = workspace().join("tests/tests/fuzz/__fuzz__/payloads/crashes");
                let file = folder.join(format!("seed-{seed}-input-{count}"));
                std::fs::create_dir_all(&folder).and_then(|()| std::fs::write(&file, &input)).expect("a folder");
                eprintln!("input {count} of seed {seed} fails; it is in {}", file.display());
                std::panic::resume_unwind(panic);
            }
        }
        if reported.elapsed() > Duration::from_secs(60) {
            reported = Instant::now();
            eprintln!("{} of {wanted} payloads after {:.0?}", tally.hostile, start.elapsed());
        }
    }
    let page = page(&tally, wanted, seed, count, &commit, start.elapsed());
    std::fs::write(workspace().join("docs/results/fuzzing.md"), page).expect("the folder exists");
}

fn page(tally: &Tally, wanted: u64, seed: u64, inputs: u64, commit: &str, taken: Duration) -> String {
    let seconds = taken.as_secs_f64();
    let (total, hostile) = (tally.payloads(), tally.hostile);
    let mut page = format!(
        "# Results: fuzzing\n\n\
         One process holds the driver's kit, the controller's decision core and the simulated room of `tests/tests/fuzz/room.rs`.\n\
         An attacker sends payloads on every key, between the messages of a genuine tracker. After each step the test checks that nothing\n\
         panicked, that a stopped array did not move, that every angle was finite and within its limits, and that every message could be encoded.\n\
         After each attack the attacker stops. The array must then accept a command of the same controller within a simulated minute.\n\n\
         This command writes this page:\n\n\
         ```\n\
         HELIOSTAT_FUZZ_PAYLOADS={wanted} HELIOSTAT_FUZZ_SEED={seed} cargo test --release -p heliostat-tests --test fuzz -- --ignored --nocapture many_payloads\n\
         ```\n\n\
         | | |\n| --- | --- |\n\
         | commit | `{commit}` |\n\
         | seed | {seed} |\n\
         | attacks, each on a new room | {inputs} |\n\
         | payloads of the attacker | {hostile} |\n\
         | payloads of the genuine processes | {} |\n\
         | duration | {seconds:.0} s on one core, {:.0} payloads/s |\n\
         | failures | 0 |\n\n\
         ## Payloads\n\n\
         | kind | payloads | decoded |\n| --- | --- | --- |\n",
        total - hostile,
        total as f64 / seconds.max(1e-9),
    );
    for kind in Kind::ALL {
        let (delivered, decoded) = tally.of(kind);
        writeln!(page, "| {kind} | {delivered} | {decoded} |").expect("a text grows");
    }
    let counters = &tally.counters;
    write!(
        page,
        "\n## Commands at the array\n\n\
         | | |\n| --- | --- |\n\
         | accepted | {} |\n| rejected | {} |\n| old epoch | {} |\n| old sequence | {} |\n| expired | {} |\n\
         | refused by a latched stop | {} |\n",
        counters.accepted,
        counters.rejected,
        counters.old_epoch,
        counters.old_sequence,
        counters.expired,
        counters.stopped,
    )
    .expect("a text grows");
    page
}
