//! Rooms over a network that loses packets: QUIC compared with TCP.
//!
//! `HELIOSTAT_LOSS_TABLE=1` makes the test print the comparison for several loss rates, as in
//! docs/results/network.md.

use std::time::Duration;

use heliostat_needs::needs;
use heliostat_tests::Process;
use heliostat_tests::faults::Link;
use serde_json::Value;
use tempfile::TempDir;

/// Duration of a run in s.
const RUN_S: &str = "20";

/// Environment variable that selects the comparison for several loss rates.
const TABLE: &str = "HELIOSTAT_LOSS_TABLE";

/// The result of a run.
#[derive(Debug)]
struct Run {
    lost_percent: f64,
    loop_p50_ms: f64,
    loop_p99_ms: f64,
}

impl Run {
    fn of(summary: &Value) -> Self {
        let number = |value: &Value| value.as_f64().expect("a number");
        let attended = number(&summary["ticks"]) - number(&summary["unattended_ticks"]);
        let [p50, p99] = ["p50", "p99"].map(|name| number(&summary["loop_us"][name]) * 1e-3);
        Self { lost_percent: 100.0 * number(&summary["lost_ticks"]) / attended, loop_p50_ms: p50, loop_p99_ms: p99 }
    }
}

/// Keys of a room whose processes may listen at an address.
fn keys(host: &str) -> (TempDir, String) {
    let folder = tempfile::tempdir().expect("a folder");
    let keys = folder.path().join("keys").display().to_string();
    let made = Process::heliostat(&["keys", "init", "--room", "demo", "--host", host, "--out", &keys, "--json"]).wait();
    assert!(made.status.success(), "{}", made.errors);
    (folder, keys)
}

/// Runs a simulated room in a namespace and a controller outside.
fn run(protocol: &str, percent: u32) -> Run {
    let link = Link::create();
    let (_folder, keys) = keys(&link.address());
    let security = if protocol == "tcp" { vec!["--insecure"] } else { vec!["--tls", &keys] };
    let endpoint = format!("{protocol}/{}:7447", link.address());
    let room = ["sim-node", "--listen", &endpoint, "--seconds", RUN_S, "--json", "--set", "streams.truth.rate_hz=0.1"];
    let room = Process::heliostat_under(&link.wrapper(), &[], &[&room[..], &security].concat());
    let controller = ["controller", "--policy", "nearest", "--connect", &endpoint, "--exit-with-parent", "--json"];
    let _controller = Process::heliostat(&[&controller[..], &security].concat());
    std::thread::sleep(Duration::from_secs(2));
    assert!(percent == 0 || link.lose(percent), "packets cannot be lost");
    Run::of(&room.wait().json())
}

#[needs("network-namespaces")]
#[test]
fn quic_answers_more_reports_than_tcp_on_a_network_that_loses_packets() {
    if std::env::var_os(TABLE).is_some() {
        println!("| transport | packets lost | ticks lost | loop p50 | loop p99 |");
        for percent in [0, 1, 3, 10] {
            for protocol in ["tcp", "tls", "quic"] {
                let Run { lost_percent, loop_p50_ms, loop_p99_ms } = run(protocol, percent);
                println!(
                    "| {protocol} | {percent} % | {lost_percent:.1} % | {loop_p50_ms:.1} ms | {loop_p99_ms:.0} ms |"
                );
            }
        }
        return;
    }
    let (tcp, quic) = (run("tcp", 10), run("quic", 10));
    println!("tcp {tcp:?}, quic {quic:?}");
    assert!(quic.lost_percent < 0.7 * tcp.lost_percent, "tcp {tcp:?}, quic {quic:?}");
    assert!(quic.loop_p99_ms < tcp.loop_p99_ms, "tcp {tcp:?}, quic {quic:?}");
}
