//! The effect of each fault of the simulated campaign: no invariant fails, the page has its row, and what real
//! processes did lies within the range of the simulation.

mod reality;

use std::fmt::Write;
use std::fs;
use std::path::PathBuf;

use heliostat_simulation::effects::{Case, Effect, cases};
use reality::{Reality, Simulated};

/// Seeds of each fault: for the test, and for the page.
const SEEDS: (u64, u64) = (5, 200);

fn page() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../docs/results/simulated-faults.md")
}

fn effects(case: &Case, seeds: u64) -> Vec<Effect> {
    let run = |seed| case.run(seed).unwrap_or_else(|violation| panic!("{}, seed {seed}: {violation}", case.action));
    (0..seeds).map(run).collect()
}

/// Least value, median, 95th percentile and largest value.
fn quantiles(mut values: Vec<f64>, decimals: usize) -> String {
    values.sort_by(f64::total_cmp);
    let at = |share: f64| values[((values.len() - 1) as f64 * share).round() as usize];
    [0.0, 0.5, 0.95, 1.0].map(|share| format!("{:.decimals$}", at(share))).join(" / ")
}

fn row(case: &Case, effects: &[Effect]) -> String {
    let all = |value: fn(&Effect) -> f64, decimals| quantiles(effects.iter().map(value).collect(), decimals);
    format!(
        "| {} | {} | {} | {} |",
        case.action,
        all(|effect| effect.gap_ms, 0),
        all(|effect| effect.lost as f64, 0),
        all(|effect| effect.recovery_ms, 1)
    )
}

/// The table of all cases, and the comparison with real processes.
#[test]
fn each_fault_keeps_the_invariants_and_has_its_row() {
    let writes = std::env::var_os("HELIOSTAT_WRITE_FAULTS").is_some();
    let seeds = if writes { SEEDS.1 } else { SEEDS.0 };
    let mut text = String::from(HEAD);
    for case in cases() {
        let row = row(&case, &effects(&case, seeds));
        println!("{row}");
        writeln!(text, "{row}").expect("a text grows");
    }
    if writes {
        text.push_str(COMPARED);
        let compared: Vec<String> =
            cases().iter().flat_map(|case| comparison(case, &text)).map(|line| line.1).collect();
        writeln!(text, "{}", compared.join("\n")).expect("a text grows");
        fs::write(page(), text).expect("the page can be written");
        return;
    }
    let page = fs::read_to_string(page()).expect("the page of simulated faults");
    let missing: Vec<_> =
        cases().iter().map(|case| case.action).filter(|action| !page.contains(&format!("\n| {action} |"))).collect();
    assert!(missing.is_empty(), "HELIOSTAT_WRITE_FAULTS=1 writes the page again; it lacks {missing:?}");
}

/// Whether each measurement is accounted for, and its line on the page.
fn comparison(case: &Case, page: &str) -> Vec<(bool, String)> {
    let line = |reality: Reality| {
        let simulated = Simulated::of(page, case.action);
        let outside = simulated.outside(&reality);
        let (is_known, verdict) = match (outside.is_empty(), case.differs) {
            (true, _) => (true, "yes".to_owned()),
            (false, Some(reason)) => (true, format!("not the {}: {reason}", outside.join(" and the "))),
            (false, None) => (false, format!("**not the {}**", outside.join(" and the "))),
        };
        let cells = simulated.beside(&reality).join(" | ");
        (is_known, format!("| {} | {} | {cells} | {verdict} |", reality.action, case.action))
    };
    case.tests.iter().map(|test| line(Reality::of(test))).collect()
}

#[test]
fn the_effects_on_real_processes_lie_within_the_simulated_ranges() {
    let page = fs::read_to_string(page()).expect("the page of simulated faults");
    let compared: Vec<(bool, String)> = cases().iter().flat_map(|case| comparison(case, &page)).collect();
    assert!(compared.len() > 15, "few faults are compared: {compared:#?}");
    let outside: Vec<&String> = compared.iter().filter(|(is_known, _)| !is_known).map(|(_, line)| line).collect();
    assert!(outside.is_empty(), "where reality lies outside, the simulation is wrong: {outside:#?}");
}

const HEAD: &str = "# Results: simulated faults

Each row is a fault of a room in virtual time, over 200 seeds. The production code runs unchanged: the decision core from payload
bytes, the array's side of the contract, the rule of an operator. The seed draws the moment of the fault, delays, clocks, positions
and policy. The room has one array and 100 reports a second; a command is valid for 200 ms, and the array parks 1000 ms later.
Each cell has the least value, the median, the 95th percentile and the largest value.

The processes pause, as on a machine with 2 cores beside a build. There a thread that slept for 10 ms was late by more than 2 ms
in 1.5 % of 3921 times, by more than 3.8 ms in 0.5 %, by more than 7.4 ms in 0.1 %, and by 21 ms once. A process that is started again
needs 5 to 130 ms until its first message. A controller that goes on finds a backlog, and decides for the newest of 1 to 64 reports at
once. A connection whose packets were lost carries messages again at the next retransmission of TCP, or after the lease of 5 s at the
next attempt to connect. The array publishes telemetry 20 times a second as a driver, and 100 times where the fault is compared with
that of a real simulator.

| column | meaning |
| --- | --- |
| gap | longest time between two followed commands, in ms |
| lost | commands that the array would have followed at the rate of the reports, less those that it followed |
| recovery | from the end of the fault to the next followed command, in ms; a process that is started again is launched at that end |

No invariant of the simulation fails in any of these runs. Among them: an array that was ordered to stop does not move, a silent array
parks in time, and a controller follows again within 5 s.

```sh no-run
HELIOSTAT_WRITE_FAULTS=1 cargo test --release -p heliostat-simulation --test effects
```

| fault | gap | lost | recovery |
| --- | --- | --- | --- |
";

const COMPARED: &str = "
## Beside real processes

[faults.md](../faults.md) has measurements of real processes. This table has those whose fault is simulated too: the measurement, then the
range of the simulation. A test fails where a measurement lies outside without a stated reason.
Viewers, recorders, floods, certificates, boards and routers have no counterpart: a simulated host has no socket that can fill.

| fault of real processes | simulated fault | gap | lost | recovery | inside |
| --- | --- | --- | --- | --- | --- |
";
