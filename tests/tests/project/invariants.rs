//! The rules of ARCHITECTURE.md that `cargo metadata` shows: layers of crates, and which crate may
//! depend on which foreign library. Clippy checks that pure crates read no clock (`.ci/pure`), and
//! cargo-deny checks licences and sources (`deny.toml`).

use std::collections::BTreeSet;
use std::fs;
use std::process::Command;

use heliostat_tests::packages::Packages;
use heliostat_tests::workspace;

/// Packages from the lowest to the highest layer. A package depends only on packages in earlier rows.
const LAYERS: [&str; 26] = [
    "tokio-rustls",
    "heliostat-needs",
    "heliostat-proto",
    "heliostat-channel",
    "heliostat-files",
    "heliostat-scenario",
    "heliostat-onnx",
    "heliostat-array",
    "heliostat-core",
    "heliostat-room",
    "heliostat-calibrate",
    "heliostat-simulation",
    "heliostat-environment",
    "heliostat-models",
    "heliostat-learn",
    "heliostat-bus",
    "heliostat-service",
    "heliostat-driver",
    "heliostat-controller",
    "heliostat-sim-node",
    "heliostat-record",
    "heliostat-ui",
    "heliostat-reproduce",
    "heliostat",
    "heliostat-lab",
    "heliostat-tests",
];

/// A package, and what it may not need, directly or through other packages. `*` ends a prefix.
const BANS: [(&str, &[&str]); 12] = [
    (
        "heliostat",
        &[
            "heliostat-learn",
            "heliostat-environment",
            "heliostat-reproduce",
            "candle*",
            "plotly*",
            "plotters*",
            "csv*",
            "statrs",
            "rayon*",
        ],
    ),
    (
        "heliostat-controller",
        &["heliostat-sim-node", "heliostat-room", "heliostat-driver", "heliostat-learn", "candle*"],
    ),
    ("heliostat-sim-node", &["heliostat-controller", "heliostat-core", "heliostat-models", "candle*"]),
    ("heliostat-driver", &["heliostat-core", "candle*"]),
    ("heliostat-calibrate", &PURE),
    ("heliostat-environment", &PURE),
    ("heliostat-simulation", &PURE),
    ("heliostat-onnx", &PURE),
    ("heliostat-models", &["heliostat-bus", "heliostat-service", "zenoh*"]),
    ("heliostat-learn", &["heliostat-bus", "heliostat-service", "zenoh*"]),
    ("heliostat-record", &["heliostat-controller", "heliostat-sim-node"]),
    ("heliostat-ui", &["heliostat-controller", "heliostat-core", "heliostat-room"]),
];

/// What the decision core, the room and the libraries below them may not need.
const PURE: [&str; 10] =
    ["zenoh*", "signal-hook", "axum*", "hyper*", "ureq*", "tokio", "ort", "ort-*", "candle*", "heliostat-bus"];

/// A foreign library and the only package of the workspace that may name it.
const SINGLE_USERS: [(&str, &str); 8] = [
    ("zenoh", "heliostat-bus"),
    ("rcgen", "heliostat-bus"),
    ("x509-parser", "heliostat-bus"),
    ("ort", "heliostat-models"),
    ("postcard", "heliostat-proto"),
    ("mcap", "heliostat-record"),
    ("foxglove", "heliostat-record"),
    ("signal-hook", "heliostat-service"),
];

/// The needed packages that match one of the patterns.
fn forbidden<'a>(needed: &BTreeSet<&'a str>, patterns: &[&str]) -> Vec<&'a str> {
    let matches = |name: &str, pattern: &&str| match pattern.strip_suffix('*') {
        Some(prefix) => name.starts_with(prefix),
        None => name == *pattern,
    };
    needed.iter().copied().filter(|name| patterns.iter().any(|pattern| matches(name, pattern))).collect()
}

#[test]
fn a_package_depends_only_on_packages_of_lower_layers() {
    let packages = Packages::read(&workspace());
    assert_eq!(packages.of_the_workspace(), BTreeSet::from(LAYERS), "the layers name every package");
    for (index, package) in LAYERS.iter().enumerate() {
        let direct = packages.workspace_dependencies(package);
        let higher: Vec<_> = direct.iter().filter(|name| !LAYERS[..index].contains(name)).collect();
        assert!(higher.is_empty(), "{package} depends on {higher:?}; expected lower layers only");
    }
}

#[test]
fn a_package_needs_nothing_that_its_row_bans() {
    let packages = Packages::read(&workspace());
    for (package, banned) in BANS {
        let found = forbidden(&packages.needed_by(package), banned);
        assert!(found.is_empty(), "{package} needs {found:?}; its row of BANS excludes them");
    }
}

#[test]
fn each_foreign_library_has_one_user() {
    let packages = Packages::read(&workspace());
    for (library, user) in SINGLE_USERS {
        assert_eq!(packages.users_of(library), BTreeSet::from([user]), "direct users of {library}");
    }
}

#[test]
fn each_program_is_built_without_the_other_packages() {
    for program in ["heliostat", "heliostat-controller", "heliostat-sim-node", "heliostat-driver", "heliostat-lab"] {
        let mut tree = Command::new(env!("CARGO"));
        tree.args(["tree", "--offline", "--locked", "--depth", "0", "--package", program]).current_dir(workspace());
        let output = tree.output().expect("cargo runs");
        assert!(output.status.success(), "{program}: {}", String::from_utf8_lossy(&output.stderr));
    }
}

#[test]
fn a_needed_package_is_found_by_name_and_by_prefix() {
    let needed = BTreeSet::from(["zenoh-codec", "nalgebra", "ort", "portable"]);
    assert_eq!(forbidden(&needed, &["zenoh*", "ort"]), ["ort", "zenoh-codec"]);
}

#[test]
fn the_readme_names_the_test_command_that_continuous_integration_runs() {
    let command = "cargo test --release --workspace";
    for file in ["README.md", ".ci/run", "CONTRIBUTING.md"] {
        assert!(fs::read_to_string(workspace().join(file)).expect("readable").contains(command), "{file}");
    }
}
