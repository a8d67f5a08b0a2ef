//! The effect of each fault of the simulated campaign: no invariant fails, and the page has its row.

use std::fmt::Write;
use std::fs;
use std::path::PathBuf;

use heliostat_simulation::effects::{Case, Effect, cases};

/// Seeds of each fault: for the test, and for the page.
const SEEDS: (u64, u64) = (5, 200);

fn page() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../docs/results/simulated-faults.md")
}

fn effects(case: &Case, seeds: u64) -> Vec<Effect> {
    let run = |seed| case.run(seed).unwrap_or_else(|violation| panic!("{}, seed {seed}: {violation}", case.action));
    (0..seeds).map(run).collect()
}

/// Median, 95th percentile and maximum.
fn quantiles(mut values: Vec<f64>, decimals: usize) -> String {
    values.sort_by(f64::total_cmp);
    let at = |share: f64| values[((values.len() - 1) as f64 * share).round() as usize];
    [0.5, 0.95, 1.0].map(|share| format!("{:.decimals$}", at(share))).join(" / ")
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
        fs::write(page(), text).expect("the page can be written");
        return;
    }
    let page = fs::read_to_string(page()).expect("the page of simulated faults");
    let missing: Vec<_> =
        cases().iter().map(|case| case.action).filter(|action| !page.contains(&format!("\n| {action} |"))).collect();
    assert!(missing.is_empty(), "HELIOSTAT_WRITE_FAULTS=1 writes the page again; it lacks {missing:?}");
}

const HEAD: &str = "# Results: simulated faults

Each row is a fault of a room in virtual time, over 200 seeds. The production code runs unchanged: the decision core from payload
bytes, the array's side of the contract, the rule of an operator. The seed draws the moment of the fault, delays, clocks, positions
and policy. The room has one array and 100 reports a second; a command is valid for 200 ms, and the array parks 1000 ms later.
Each cell has the median, the 95th percentile and the maximum. [faults.md](../faults.md) has one measurement of real processes for
the faults that processes can show.

| column | meaning |
| --- | --- |
| gap | longest time between two followed commands, in ms; 10 to 11 ms without a fault |
| lost | commands that the array would have followed at the rate of the reports, less those that it followed |
| recovery | from the end of the fault to the next followed command, in ms |

No invariant of the simulation fails in any of these runs. Among them: an array that was ordered to stop does not move, a silent array
parks in time, and a controller follows again within 5 s.

```sh no-run
HELIOSTAT_WRITE_FAULTS=1 cargo test --release -p heliostat-simulation --test effects
```

| fault | gap | lost | recovery |
| --- | --- | --- | --- |
";
