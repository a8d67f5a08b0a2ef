//! Takeovers: many faults of one controller of several, and the page docs/results/takeovers.md.

use std::fmt::Write as _;

use heliostat_tests::faults::page::Origin;
use heliostat_tests::faults::{Succession, Team};

use crate::{freeze, wait_s};

/// Duration of a fault, and time until a killed controller starts again.
const FAULT_S: f64 = 3.0;

/// A gap of up to this many intervals counts as two: a report is not always on time.
const TWO_INTERVALS: f64 = 2.1;

/// What is done to the leader, or to a standby.
#[derive(Clone, Copy, Debug)]
enum Fault {
    Killed,
    Ended,
    Frozen,
    LeaderCut,
    StandbyCut,
}

const FAULTS: [(Fault, &str); 5] = [
    (Fault::Killed, "the leader is killed (SIGKILL)"),
    (Fault::Ended, "the leader ends (SIGTERM)"),
    (Fault::Frozen, "the leader is frozen (SIGSTOP)"),
    (Fault::LeaderCut, "the link of the leader's host is cut"),
    (Fault::StandbyCut, "the link of a standby's host is cut"),
];

impl Fault {
    fn happen(self, team: &mut Team, [leader, standby]: [usize; 2]) {
        match self {
            Self::Killed => {
                team.controller(leader).kill();
                wait_s(FAULT_S);
                team.restart(leader);
            }
            Self::Ended => {
                team.controller(leader).signal("TERM");
                wait_s(FAULT_S);
                team.controller(leader).wait_mut();
                team.restart(leader);
            }
            Self::Frozen => freeze(team.controller(leader), FAULT_S),
            Self::LeaderCut | Self::StandbyCut => {
                let host = if matches!(self, Self::LeaderCut) { leader } else { standby };
                team.segment().cut(host);
                wait_s(FAULT_S);
                team.segment().heal(host);
            }
        }
    }
}

fn setting(name: &str, default: &str) -> String {
    std::env::var(name).unwrap_or_else(|_| default.to_owned())
}

#[test]
#[ignore = "takes an hour and writes a page; HELIOSTAT_TAKEOVERS is the number of faults for each row, HELIOSTAT_TAKEOVER_ROWS a part of the names of rows"]
fn takeovers_after_many_faults() {
    let runs: usize = setting("HELIOSTAT_TAKEOVERS", "30").parse().expect("a number of faults");
    assert!(runs > 0, "HELIOSTAT_TAKEOVERS is 0: expected at least one fault");
    let wanted = setting("HELIOSTAT_TAKEOVER_ROWS", "");
    let mut rows = String::new();
    for (fault, name) in FAULTS {
        for (reports_per_s, controllers) in [(10, 2), (10, 3), (100, 2), (100, 3)] {
            let title = format!("| {name} | {reports_per_s} | {controllers} |");
            if title.contains(&wanted) {
                let mut team = Team::start(controllers, reports_per_s);
                let once = |_| {
                    let of = team.settle();
                    team.undergo(|team| fault.happen(team, of))
                };
                let found: Vec<Succession> = (0..runs).map(once).collect();
                println!("{title} {found:?}");
                writeln!(rows, "{title} {}", describe(&found)).expect("a text grows");
                print!("{rows}");
            }
        }
    }
    if wanted.is_empty() {
        let page = HEAD.replace("ORIGIN", &Origin::here().to_string()).replace("RUNS", &runs.to_string());
        let path = heliostat_tests::workspace().join("docs/results/takeovers.md");
        std::fs::write(path, format!("{page}{rows}")).expect("the folder exists");
    }
}

/// The cells of a row.
fn describe(found: &[Succession]) -> String {
    let mut gaps: Vec<f64> = found.iter().map(|one| one.gap).collect();
    gaps.sort_by(f64::total_cmp);
    let mut lost: Vec<u64> = found.iter().map(|one| one.lost).collect();
    lost.sort_unstable();
    let middle = gaps.len() / 2;
    let count = |is_so: &dyn Fn(&Succession) -> bool| found.iter().filter(|one| is_so(one)).count();
    let within = count(&|one| one.gap <= TWO_INTERVALS);
    let changes = [count(&|one| one.changes == 0), count(&|one| one.changes == 1), count(&|one| one.changes > 1)];
    let [none, once, often] = changes;
    let parked = count(&|one| one.has_parked);
    format!(
        "{:.2} | {:.2} | {within} | {} | {} | {none}, {once}, {often} | {parked} |",
        gaps[middle],
        gaps[gaps.len() - 1],
        lost[middle],
        lost[lost.len() - 1]
    )
}

const HEAD: &str = "# Results: takeovers

An array and two or three controllers, each controller on a host of its own: network namespaces on one bridge, TCP without
TLS, telemetry 100 times a second. Each fault lasts 3 s; a controller that was killed or has ended starts again after that time.
The next fault comes when one controller leads and all others stand by. This command writes this page, on an idle machine and as root:

```sh no-run
HELIOSTAT_TAKEOVERS=RUNS cargo test --release -p heliostat-tests --test faults -- --ignored --nocapture takeovers_after
```

ORIGIN; RUNS faults for each row.

| column | meaning |
| --- | --- |
| gap | longest time between two commands that the array accepted, in report intervals; 1 without a fault |
| up to 2.1 | faults with a gap up to 2.1 intervals |
| lost | commands that the array would have accepted at the rate of the reports, less those accepted |
| changes | faults with no, one, and more changes of the controller that the array follows, until all controllers are back |
| parked | faults during which the array parked |

The cut of a standby's link does not concern the leader: its rows show what the machine and the network add to each gap.

| fault | reports/s | controllers | gap, median | gap, largest | up to 2.1 | lost, median | lost, largest | changes 0, 1, more | parked |
| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |
";
