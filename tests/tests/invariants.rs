//! The rules of ARCHITECTURE.md that manifests, sources and `cargo metadata` show.
//!
//! The tables at the top are the rules. The checks are in `heliostat_tests::architecture`, whose
//! unit tests show on small inputs that each check can fail.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use heliostat_tests::architecture::{
    Source, forbidden, impurities, named, named_elsewhere, second_versions, unlicensed, upward,
};
use heliostat_tests::module_graph::{ModuleGraph, rust_files};
use heliostat_tests::packages::Packages;
use heliostat_tests::rust_source::RustSource;

/// How the workspace is arranged.
struct Layout {
    /// Folders of all crates from the lowest to the highest: a crate may depend only on crates
    /// before it.
    order: &'static [&'static str],
    /// Crates without I/O, clock and threads.
    pure: &'static [&'static str],
    /// A foreign library and the one file or folder that may name it.
    single_places: &'static [(&'static str, &'static str)],
    /// A crate and the crates of the workspace that it may not need, directly or through others.
    bans: &'static [(&'static str, &'static [&'static str])],
}

/// The arrangement that ARCHITECTURE.md describes.
const LAYOUT: &Layout = &Layout {
    order: &[
        "channel",
        "scenario",
        "proto",
        "onnx",
        "array",
        "decide",
        "sim",
        "environment",
        "engine",
        "models",
        "bus",
        "service",
        "driver",
        "controller",
        "sim-node",
        "record",
        "ui",
        "reproduce",
        "heliostat",
        "tests",
    ],
    pure: &["channel", "scenario", "proto", "onnx", "array", "decide", "sim", "environment"],
    single_places: &[
        ("zenoh", "bus/src"),
        ("rcgen", "bus/src/keys"),
        ("x509_parser", "bus/src"),
        ("tract_hir", "engine/src/tract"),
        ("tract_onnx", "engine/src/tract"),
        ("ort", "engine/src/onnxruntime"),
        ("postcard", "proto/src/codec"),
        ("mcap", "record/src/file"),
        ("foxglove", "record/src/scene"),
        ("ctrlc", "service/src/signals"),
        ("hyper", "service/src/http"),
    ],
    bans: &[
        ("controller", &["sim-node", "sim", "driver"]),
        ("sim-node", &["controller", "decide", "engine"]),
        ("array", &["bus", "service"]),
        ("decide", &["bus", "service", "engine", "sim", "array"]),
        ("sim", &["bus", "service", "engine"]),
        ("environment", &["bus", "service", "engine"]),
        ("engine", &["bus", "service"]),
        ("models", &["bus", "service", "controller", "sim-node", "driver"]),
        ("ui", &["controller", "sim-node", "models", "decide", "sim"]),
    ],
};

/// Names that only these files use, so that no process writes its own version.
const WRITTEN_ONCE: [(&str, &[&str]); 3] = [
    (
        "SystemTime",
        &[
            "service/src/clock.rs",
            // Validity of certificates; `bus` is below `service`.
            "bus/src/certificate.rs",
            "bus/src/keys.rs",
            "heliostat/src/commands/doctor/machine.rs",
            "reproduce/src/machine.rs",
        ],
    ),
    ("RandomState", &["service/src/source_id.rs", "bus/src/config.rs"]),
    ("process::exit", &["service/src/exit.rs", "service/src/signals.rs"]),
];

/// Packages that a pure crate may not need: transports, signals, HTTP, inference and tensor
/// engines. `*` ends a prefix.
const NOT_IN_PURE: [&str; 11] =
    ["zenoh*", "ctrlc", "axum*", "hyper*", "tiny_http", "ureq*", "tokio", "tract*", "ort", "ort-*", "candle*"];

/// Packages of training and plotting, which a deployed process may not need.
const NOT_DEPLOYED: [&str; 4] = ["candle*", "plotters*", "plotly*", "heliostat-models"];

/// The crates of deployed processes.
const DEPLOYED: [&str; 3] = ["controller", "sim-node", "driver"];

/// What the sources of a pure crate may not name.
const IMPURE: [&str; 13] = [
    "std::time::Instant",
    "std::time::SystemTime",
    "std::thread",
    "std::fs",
    "std::net",
    "std::process",
    "println!",
    "eprintln!",
    "print!",
    "rand::rng",
    "rand::make_rng",
    "from_os_rng",
    "thread_rng",
];

/// Files of pure crates that may name something of `IMPURE`, each with its reason.
const IMPURE_ALLOWED: [(&str, &str, &str); 1] = [(
    "scenario/src/bounded_file.rs",
    "std::fs",
    "reads the file that a flag or a scenario names; all else takes text",
)];

/// Licences that every dependency must offer.
const LICENCES: [&str; 11] = [
    "MIT",
    "Apache-2.0",
    "Apache-2.0 WITH LLVM-exception",
    "BSD-2-Clause",
    "BSD-3-Clause",
    "ISC",
    "Zlib",
    "Unicode-3.0",
    "Unlicense",
    // Copyleft for its own files only, which are used unchanged (option-ext, below zenoh).
    "MPL-2.0",
    // For data: the root certificates in webpki-roots, below zenoh, used unchanged.
    "CDLA-Permissive-2.0",
];

/// Packages that take long to build: a second version of one needs a reason in `SECOND_VERSIONS`.
/// `*` ends a prefix.
const LARGE: [&str; 29] = [
    "axum",
    "candle*",
    "clap*",
    "foxglove",
    "futures-util",
    "gemm*",
    "hyper",
    "mcap",
    "nalgebra",
    "ndarray",
    "nix",
    "ort*",
    "plotly",
    "plotters",
    "prost*",
    "rand",
    "ratatui*",
    "rayon*",
    "regex*",
    "rustls*",
    "serde",
    "serde_json",
    "syn",
    "tokenizers",
    "tokio",
    "tower",
    "tract*",
    "tracing*",
    "zenoh*",
];

/// Why there is more than one version of a large package.
const SECOND_VERSIONS: [(&str, &str); 3] = [
    ("syn", "derive macros of zenoh, nalgebra and others stay on 2, those of clap and serde are on 3"),
    ("rand", "zenoh needs 0.8, candle 0.9; this workspace uses 0.10"),
    ("nix", "zenoh's Unix sockets need 0.29; this workspace uses 0.31"),
];

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// The package in a folder of the workspace.
fn package(folder: &str) -> String {
    format!("heliostat-{folder}").replace("heliostat-heliostat", "heliostat")
}

/// Every source of a crate by its path from the workspace.
fn sources(folder: &str) -> Vec<Source> {
    let files = rust_files(&root().join(folder).join("src"));
    assert!(!files.is_empty(), "the folder {folder}/src is missing or empty, and LAYOUT names it");
    let read = |path: PathBuf| {
        let text = fs::read_to_string(&path).expect("a source is readable");
        let path = path.strip_prefix(root()).expect("it lies in the workspace").to_string_lossy().into_owned();
        (path, RustSource::parse(&text))
    };
    files.into_iter().map(read).collect()
}

/// An empty list, for comparisons that show what was found.
const NONE: [String; 0] = [];

#[test]
fn the_layout_names_every_crate_of_the_workspace() {
    let manifest = fs::read_to_string(root().join("Cargo.toml")).expect("the workspace has a manifest");
    let manifest: toml::Table = toml::from_str(&manifest).expect("a manifest is TOML");
    let members = manifest["workspace"]["members"].as_array().expect("a list").iter();
    let members: BTreeSet<&str> = members.filter_map(toml::Value::as_str).collect();
    assert_eq!(members, LAYOUT.order.iter().copied().collect());
}

#[test]
fn no_dependency_points_up() {
    let packages = Packages::read(&root());
    let direct = |name: &str| packages.workspace_dependencies(name).into_iter().map(String::from).collect();
    assert_eq!(upward(&LAYOUT.order.iter().map(|folder| package(folder)).collect::<Vec<_>>(), direct), NONE);
    for (folder, banned) in LAYOUT.bans {
        let banned: Vec<String> = banned.iter().map(|folder| package(folder)).collect();
        let banned: Vec<&str> = banned.iter().map(String::as_str).collect();
        assert_eq!(forbidden(&packages.needed_by(&package(folder)), &banned), NONE, "{folder}");
    }
}

#[test]
fn pure_crates_need_no_transport_no_server_and_no_engine() {
    let packages = Packages::read(&root());
    for folder in LAYOUT.pure {
        assert_eq!(forbidden(&packages.needed_by(&package(folder)), &NOT_IN_PURE), NONE, "{folder}");
    }
}

#[test]
fn pure_crates_read_no_clock_open_nothing_and_start_no_thread() {
    for folder in LAYOUT.pure {
        assert_eq!(impurities(&sources(folder), &IMPURE, &IMPURE_ALLOWED), NONE, "{folder}");
    }
}

#[test]
fn every_exception_of_a_pure_crate_is_still_needed() {
    for (file, name, _) in IMPURE_ALLOWED {
        let text = fs::read_to_string(root().join(file)).expect("an excepted file exists");
        assert!(
            named(&RustSource::parse(&text), &[name]).contains(&name),
            "{file} does not name {name}: remove the entry"
        );
    }
}

#[test]
fn each_foreign_library_is_named_in_one_place() {
    let all: Vec<Source> = LAYOUT.order.iter().flat_map(|folder| sources(folder)).collect();
    for (library, place) in LAYOUT.single_places {
        assert_eq!(named_elsewhere(&all, library, place), NONE);
        let is_used = all.iter().any(|(file, _)| file.starts_with(place));
        assert!(is_used, "{place} does not exist; it is listed as the only place that names {library}");
    }
}

#[test]
fn what_processes_share_is_written_once() {
    let all: Vec<Source> =
        LAYOUT.order.iter().filter(|folder| **folder != "tests").flat_map(|folder| sources(folder)).collect();
    for (name, places) in WRITTEN_ONCE {
        let users = all.iter().filter(|(_, source)| !named(source, &[name]).is_empty()).map(|(file, _)| file.as_str());
        let others: Vec<&str> = users.filter(|file| !places.contains(file)).collect();
        assert!(others.is_empty(), "{name} belongs into {places:?}, found in {others:?}");
    }
}

#[test]
fn the_files_of_a_crate_form_no_import_circles() {
    for folder in LAYOUT.order {
        let circles = ModuleGraph::read(&root().join(folder)).circles();
        let ways: Vec<String> = circles.iter().map(|circle| circle.join(" -> ")).collect();
        assert_eq!(ways, NONE, "import circles in {folder}/src");
    }
}

#[test]
fn deployed_processes_carry_no_training_and_no_plots() {
    let packages = Packages::read(&root());
    for folder in DEPLOYED {
        assert_eq!(forbidden(&packages.needed_by(&package(folder)), &NOT_DEPLOYED), NONE, "{folder}");
    }
}

#[test]
fn dependencies_come_from_crates_io_under_allowed_licences() {
    assert_eq!(unlicensed(&Packages::read(&root()), &LICENCES), NONE);
}

#[test]
fn no_large_dependency_is_built_twice_without_a_reason() {
    let packages = Packages::read(&root());
    assert_eq!(second_versions(&packages.in_several_versions(), &LARGE, &SECOND_VERSIONS), NONE);
}

#[test]
fn the_readme_names_the_test_command_that_continuous_integration_runs() {
    let command = "cargo test --release --workspace";
    for file in ["README.md", ".ci/run", "CONTRIBUTING.md"] {
        assert!(fs::read_to_string(root().join(file)).expect("readable").contains(command), "{file}");
    }
}
