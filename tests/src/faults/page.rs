//! docs/faults.md: the table of faults with their measured effects, written by the campaign.

use std::collections::BTreeMap;
use std::env::consts::ARCH;
use std::fmt::{self, Write as _};
use std::fs;
use std::path::PathBuf;
use std::process::Command;
use std::sync::Mutex;
use std::thread;

use heliostat_service::locks::lock;

use crate::faults::effect::Effect;
use crate::faults::table::{FAULTS, Fault};
use crate::process::workspace;

/// Counters that a row names.
const COUNTERS_MAX: usize = 3;

/// Tests run in parallel; one at a time writes the page.
static WRITING: Mutex<()> = Mutex::new(());

/// Where and with which build the faults were measured.
#[derive(Clone, Debug)]
pub struct Origin {
    /// The commit, followed by `+changes` if the working copy was modified.
    pub commit: String,
    machine: String,
}

impl Origin {
    /// This working copy on this machine.
    pub fn here() -> Self {
        let git = |arguments: &[&str]| {
            let output = Command::new("git").arg("-C").arg(workspace()).args(arguments).output().ok()?;
            output.status.success().then(|| String::from_utf8_lossy(&output.stdout).trim().to_owned())
        };
        let commit = git(&["rev-parse", "--short=9", "HEAD"]).unwrap_or_else(|| "unknown".to_owned());
        // The page itself changes while it is written.
        let changes =
            git(&["status", "--porcelain", "--untracked-files=no", "--", ".", ":!docs/faults.md", ":!docs/results"]);
        let changed = changes.is_some_and(|changes| !changes.is_empty());
        let listing = fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
        let model = listing.lines().find_map(|line| line.strip_prefix("model name")?.split_once(':'));
        let cores = thread::available_parallelism().map_or(1, usize::from);
        Self {
            commit: format!("{commit}{}", if changed { "+changes" } else { "" }),
            machine: format!("{cores} cores of {}", model.map_or(ARCH, |(_, name)| name.trim())),
        }
    }
}

impl fmt::Display for Origin {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "Commit {}, {}", self.commit, self.machine)
    }
}

/// The file of the page.
pub fn path() -> PathBuf {
    workspace().join("docs/faults.md")
}

/// Whether the text of the page before its rows is the one that the tests write.
pub fn has_present_head(page: &str) -> bool {
    HEAD.split("MACHINE").all(|part| page.contains(part))
}

/// Replaces the row of a fault, and keeps the others.
///
/// # Panics
/// When the page cannot be written.
pub fn record(fault: &Fault, effects: &[Effect], origin: &Origin) {
    let _writing = lock(&WRITING);
    let mut rows = rows(&fs::read_to_string(path()).unwrap_or_default());
    rows.insert(fault.test.to_owned(), row(fault, effects, origin));
    fs::write(path(), page(&rows, origin)).expect("the page can be written");
}

/// The rows of a page by the name of the test, which stands in the last column.
pub fn rows(page: &str) -> BTreeMap<String, String> {
    let named = page.lines().filter_map(|line| {
        let test = line.strip_suffix("` |")?.rsplit_once('`')?.1;
        Some((test.to_owned(), line.to_owned()))
    });
    named.collect()
}

fn row(fault: &Fault, effects: &[Effect], origin: &Origin) -> String {
    let column = |value: fn(&Effect) -> f64| {
        let mut values: Vec<f64> = effects.iter().map(value).collect();
        values.sort_by(f64::total_cmp);
        let (median, largest) = (values[values.len() / 2], values[values.len() - 1]);
        if values.len() == 1 { format!("{median:.0}") } else { format!("{median:.0} ({largest:.0})") }
    };
    let longest = effects.iter().max_by_key(|effect| effect.states.len()).expect("a fault was measured");
    let states: Vec<&str> = longest.states.iter().map(|state| state.name()).collect();
    let mut reported = states.join(", ");
    for counter in longest.counted.iter().take(COUNTERS_MAX) {
        // Writing to a string cannot fail.
        let _ = write!(reported, "; {counter}");
    }
    let is_kept = effects.iter().all(|effect| fault.promise.check(effect).is_ok());
    format!(
        "| {} | {}{} | {} | {} | {} | {reported} | {} x {} | `{}` |",
        fault.action,
        fault.promise,
        if is_kept { "" } else { "; **not met**" },
        column(|effect| effect.gap_ms),
        column(|effect| effect.lost as f64),
        column(|effect| effect.recovery_ms),
        effects.len(),
        origin.commit,
        fault.test,
    )
}

fn page(rows: &BTreeMap<String, String>, origin: &Origin) -> String {
    let mut page = HEAD.replace("MACHINE", &origin.machine);
    let mut group = "";
    for fault in FAULTS {
        let Some(row) = rows.get(fault.test) else { continue };
        if fault.group != group {
            group = fault.group;
            // Writing to a string cannot fail.
            let _ = write!(page, "\n## {group}\n\n{COLUMNS}\n");
        }
        page.push_str(row);
        page.push('\n');
    }
    page
}

const COLUMNS: &str = "\
| fault | bound | gap in ms | commands lost | recovery in ms | reported | runs x commit | test |
| --- | --- | --- | --- | --- | --- | --- | --- |";

const HEAD: &str = "\
# Faults and their effects

[simulated-faults.md](results/simulated-faults.md) has the distribution of the effect of each fault, over many moments, from the
simulation in virtual time. This page has one measurement of real processes over real sockets for faults that only processes can show:
sockets, signals, certificates, floods, boards and disks. A test with the name in the last column causes the fault and fails if the
effect exceeds the bound. The room is `specular`: 100 reports a second, a validity of 200 ms, and parks 1000 ms after the end of validity.

| column | meaning |
| --- | --- |
| gap | longest time between two accepted commands at the array, from telemetry, or for a fault of a board between two turns of its mirrors; 10 ms without a fault |
| commands lost | commands that the array would have accepted at the rate of the reports, less those accepted |
| recovery | from the end of the fault to the next accepted command |
| reported | states of the array in telemetry, then counters of refusals and degraded modes that rose |
| runs x commit | number of measurements; of several, the median is given, and the largest in brackets |

Measured on MACHINE. The tests write this page:

```sh no-run
HELIOSTAT_WRITE_FAULTS=1 HELIOSTAT_FAULT_RUNS=3 cargo test --release -p heliostat-tests --test faults
```

Faults in network namespaces need root, and shifted clocks a C compiler; these tests are ignored where these are missing.
`HELIOSTAT_REQUIRE=network-namespaces,cc` makes their absence a failure. `tests/tests/frozen_viewers.rs` has sharper bounds
for frozen viewers: a quarter of the commands lost beyond those lost before, a median stop within 100 ms, and each stop within 1 s.
In the group *Two hosts* each host is a network namespace with a router (`zenohd`), two rooms have TLS and access control, and all processes are
clients of the router of their host. Array and leader of the measured room are on host A, its standby is on host B; the second room is the other way round.
[deploy.md](deploy.md#two-hosts) sets it up. These tests need root and `zenohd`.
[Beside real processes](results/simulated-faults.md#beside-real-processes) compares the rows whose fault is simulated too with the range of the
simulation. The others have no counterpart there: a simulated host has no socket, certificate or board, and no viewer that holds up a sender.
Faults during an emergency stop have a [table of their own](stop-faults.md).
";
