//! The rules of ARCHITECTURE.md that manifests, sources and `cargo metadata` show.
//!
//! The tables at the top are the rules; the functions below them check one rule each and return what
//! breaks it. The unit tests at the end show on small inputs that each check can fail.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use heliostat_tests::module_graph::{ModuleGraph, rust_files};
use heliostat_tests::packages::{CRATES_IO, Packages, is_licence_allowed};
use heliostat_tests::rust_source::RustSource;

/// How the workspace is arranged.
struct Layout {
    /// Folders of all crates from the lowest to the highest: a crate may depend only on crates before it.
    order: &'static [&'static str],
    /// Crates without I/O, clock and threads.
    pure: &'static [&'static str],
    /// A foreign library and the one file or folder that may name it.
    doors: &'static [(&'static str, &'static str)],
    /// A crate and the crates of the workspace that it may not need, directly or through others.
    bans: &'static [(&'static str, &'static [&'static str])],
    /// Crates whose files still form import circles.
    with_circles: &'static [&'static str],
}

/// TEMPORARY: the arrangement that is checked. It becomes `TARGET` when the pure crates exist, and `TODAY` goes away.
const LAYOUT: &Layout = &TODAY;

/// TEMPORARY: the arrangement before the pure crates are split off.
const TODAY: Layout = Layout {
    order: &[
        "channel",
        "scenario",
        "proto",
        "bus",
        "metrics",
        "driver",
        "controller",
        "sim-node",
        "models",
        "record",
        "ui",
        "reproduce",
        "heliostat",
        "tests",
    ],
    pure: &["channel", "scenario", "proto"],
    doors: &[
        ("zenoh", "bus/src"),
        ("ort", "controller/src/policy/actor.rs"),
        ("ort_tract", "controller/src/policy/actor.rs"),
        ("postcard", "proto/src/codec.rs"),
        ("mcap", "record/src/file"),
        ("foxglove", "record/src/scene"),
    ],
    bans: &[
        ("controller", &["sim-node"]),
        ("sim-node", &["controller"]),
        ("ui", &["controller", "sim-node", "models"]),
    ],
    with_circles: &["channel", "scenario", "proto", "driver", "controller", "sim-node", "models", "heliostat"],
};

/// The arrangement that ARCHITECTURE.md describes.
#[expect(dead_code, reason = "TEMPORARY: until LAYOUT refers to it")]
const TARGET: Layout = Layout {
    order: &[
        "channel",
        "scenario",
        "proto",
        "array",
        "decide",
        "sim",
        "engine",
        "models",
        "bus",
        "service",
        "controller",
        "driver",
        "sim-node",
        "record",
        "ui",
        "reproduce",
        "heliostat",
        "tests",
    ],
    pure: &["channel", "scenario", "proto", "array", "decide", "sim"],
    doors: &[
        ("zenoh", "bus/src"),
        ("ort", "engine/src"),
        ("ort_tract", "engine/src"),
        ("postcard", "proto/src/codec.rs"),
        ("mcap", "record/src/file"),
        ("foxglove", "record/src/scene"),
    ],
    bans: &[
        ("controller", &["sim-node", "sim", "driver"]),
        ("sim-node", &["controller"]),
        ("array", &["bus"]),
        ("decide", &["bus", "engine", "sim"]),
        ("sim", &["bus", "engine"]),
        ("engine", &["bus"]),
        ("models", &["bus", "service", "controller", "sim-node", "driver"]),
        ("ui", &["controller", "sim-node", "models", "decide", "sim"]),
    ],
    with_circles: &[],
};

/// Packages that a pure crate may not need: transports, signals, HTTP, inference and tensor engines. `*` ends a prefix.
const NOT_IN_PURE: [&str; 12] =
    ["zenoh*", "ctrlc", "axum*", "hyper*", "tiny_http", "ureq*", "tokio", "tract*", "ort", "ort-*", "onnx*", "candle*"];

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
const IMPURE_ALLOWED: [(&str, &str, &str); 1] =
    [("scenario/src/args.rs", "std::fs", "reads the file that --scenario names; parsing and checking take text")];

/// Licences that every dependency must offer.
const LICENCES: [&str; 10] = [
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
];

/// Packages that take long to build: a second version of one needs a reason in `SECOND_VERSIONS`. `*` ends a prefix.
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

fn matches(pattern: &str, name: &str) -> bool {
    pattern.strip_suffix('*').map_or(pattern == name, |prefix| name.starts_with(prefix))
}

/// Every source of a crate by its path from the workspace.
fn sources(folder: &str) -> Vec<(String, RustSource)> {
    let files = rust_files(&root().join(folder).join("src"));
    assert!(!files.is_empty(), "the folder {folder}/src is missing or empty, and LAYOUT names it");
    let read = |path: PathBuf| {
        let text = fs::read_to_string(&path).expect("a source is readable");
        let path = path.strip_prefix(root()).expect("it lies in the workspace").to_string_lossy().into_owned();
        (path, RustSource::parse(&text))
    };
    files.into_iter().map(read).collect()
}

/// Every path that a source names, with local names replaced by what they were imported as.
fn full_paths(source: &RustSource) -> Vec<String> {
    let import = |name: &str| source.imports.iter().find(|import| import.name == name && name != "*");
    let inline = source.paths.iter().map(|path| match import(&path[0]) {
        Some(import) => [import.path.as_slice(), &path[1..]].concat(),
        None => path.clone(),
    });
    source.imports.iter().map(|import| import.path.clone()).chain(inline).map(|path| path.join("::")).collect()
}

/// Which of these names a source uses: a path or its beginning, or a single word.
fn named<'a>(source: &RustSource, names: &[&'a str]) -> Vec<&'a str> {
    let paths = full_paths(source);
    let is_named = |name: &&&str| {
        let begins =
            |path: &String| path.strip_prefix(**name).is_some_and(|rest| rest.is_empty() || rest.starts_with("::"));
        let is_in_glob = |path: &String| {
            path.strip_suffix('*').is_some_and(|start| start.starts_with("std::") && name.starts_with(start))
        };
        let is_last = |path: &String| !name.contains("::") && path.rsplit("::").next() == Some(**name);
        paths.iter().any(|path| begins(path) || is_in_glob(path) || is_last(path))
            || (!name.contains("::") && source.words.contains(**name))
    };
    names.iter().filter(is_named).copied().collect()
}

/// Uses of what a pure crate may not use.
fn impurities(sources: &[(String, RustSource)], allowed: &[(&str, &str, &str)]) -> Vec<String> {
    let uses =
        sources.iter().flat_map(|(file, source)| named(source, &IMPURE).into_iter().map(move |name| (file, name)));
    let is_allowed = |file: &str, name: &str| allowed.iter().any(|entry| (entry.0, entry.1) == (file, name));
    uses.filter(|(file, name)| !is_allowed(file, name)).map(|(file, name)| format!("{file} names {name}")).collect()
}

/// Files that name a foreign library elsewhere than behind its door.
fn past_the_door(sources: &[(String, RustSource)], library: &str, door: &str) -> Vec<String> {
    let is_behind = |file: &str| {
        let rest = file.strip_prefix(door);
        rest.is_some_and(|rest| rest.is_empty() || rest.starts_with('/') || rest.starts_with(".rs"))
    };
    let names = |source: &RustSource| {
        full_paths(source).iter().any(|path| path == library || path.starts_with(&format!("{library}::")))
    };
    let found = sources.iter().filter(|(file, source)| !is_behind(file) && names(source));
    found.map(|(file, _)| format!("{file} names {library}; expected only {door} to")).collect()
}

/// Dependencies that lead from a crate to one that stands beside or above it.
fn upward(order: &[&str], depends_on: impl Fn(&str) -> Vec<String>) -> Vec<String> {
    let place = |name: &str| order.iter().position(|folder| package(folder) == name);
    let mut found = Vec::new();
    for (index, folder) in order.iter().enumerate() {
        for dependency in depends_on(&package(folder)) {
            match place(&dependency) {
                Some(below) if below < index => {}
                Some(_) => found.push(format!("{folder} depends on {dependency}, which is not below it")),
                None => found.push(format!("{folder} depends on {dependency}, which the layout does not name")),
            }
        }
    }
    found
}

/// Needed packages that match a forbidden pattern.
fn forbidden(needed: &BTreeSet<&str>, patterns: &[&str]) -> Vec<String> {
    let found = needed.iter().filter(|name| patterns.iter().any(|pattern| matches(pattern, name)));
    found.map(|name| (*name).to_owned()).collect()
}

/// Second versions of large packages without a reason, and reasons without a second version.
fn second_versions(several: &BTreeMap<&str, BTreeSet<&str>>, reasons: &[(&str, &str)]) -> Vec<String> {
    let is_large = |name: &str| LARGE.iter().any(|pattern| matches(pattern, name));
    let has_reason = |name: &str| reasons.iter().any(|(reason, _)| *reason == name);
    let unexplained = several.iter().filter(|(name, _)| is_large(name) && !has_reason(name));
    let unexplained = unexplained.map(|(name, versions)| format!("{name} in the versions {versions:?}"));
    let stale = reasons.iter().filter(|(name, _)| !several.contains_key(name));
    unexplained.chain(stale.map(|(name, _)| format!("{name} has one version: remove its reason"))).collect()
}

/// Dependencies under another licence or from another source than allowed.
fn unlicensed(packages: &Packages) -> Vec<String> {
    let foreign = packages.all().filter_map(|package| package.source.as_ref().map(|source| (package, source)));
    let bad =
        foreign.filter(|(package, source)| *source != CRATES_IO || !is_licence_allowed(&package.licence, &LICENCES));
    bad.map(|(package, source)| format!("{} {}: {:?} from {source}", package.name, package.version, package.licence))
        .collect()
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
    assert_eq!(upward(LAYOUT.order, direct), NONE);
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
        assert_eq!(impurities(&sources(folder), &IMPURE_ALLOWED), NONE, "{folder}");
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
    let all: Vec<(String, RustSource)> = LAYOUT.order.iter().flat_map(|folder| sources(folder)).collect();
    for (library, door) in LAYOUT.doors {
        assert_eq!(past_the_door(&all, library, door), NONE);
        let is_used = all.iter().any(|(file, _)| file.starts_with(door));
        assert!(is_used, "{door}, the door of {library}, does not exist");
    }
}

#[test]
fn the_files_of_a_crate_form_no_import_circles() {
    for folder in LAYOUT.order {
        let circles = ModuleGraph::read(&root().join(folder)).circles();
        let ways: Vec<String> = circles.iter().map(|circle| circle.join(" -> ")).collect();
        if LAYOUT.with_circles.contains(folder) {
            assert!(!ways.is_empty(), "{folder} has no circles any more: remove it from with_circles");
        } else {
            assert_eq!(ways, NONE, "import circles in {folder}/src");
        }
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
    assert_eq!(unlicensed(&Packages::read(&root())), NONE);
}

#[test]
fn no_large_dependency_is_built_twice_without_a_reason() {
    let packages = Packages::read(&root());
    assert_eq!(second_versions(&packages.in_several_versions(), &SECOND_VERSIONS), NONE);
}

#[test]
fn the_readme_names_the_test_command_that_continuous_integration_runs() {
    let command = "cargo test --release --workspace";
    for file in ["README.md", ".ci/run", "CONTRIBUTING.md"] {
        assert!(fs::read_to_string(root().join(file)).expect("readable").contains(command), "{file}");
    }
}

/// Each check on small inputs: what it accepts, and what it does not.
mod each_rule_can_fail {
    use super::*;

    fn file(name: &str, text: &str) -> Vec<(String, RustSource)> {
        vec![(name.to_owned(), RustSource::parse(text))]
    }

    #[test]
    fn a_clock_a_file_or_a_thread_in_a_pure_crate_is_found() {
        for text in [
            "use std::time::{Duration, Instant};",
            "use std::time; fn f() { time::SystemTime::now(); }",
            "use std::time::*;",
            "fn f() { std::fs::read(\"x\"); }",
            "use std::{net::TcpStream};",
            "fn f() { println!(\"x\"); }",
            "fn f() { rand::rng(); }",
            "fn f() { ChaCha8Rng::from_os_rng(); }",
            "use rand::thread_rng as source;",
        ] {
            assert!(!impurities(&file("a.rs", text), &[]).is_empty(), "{text}");
        }
        let pure = "use std::time::Duration; use rand::Rng; /// std::fs\nfn rng(now: u64) { writeln!(x); }";
        assert_eq!(impurities(&file("a.rs", pure), &[]), NONE);
        let reads = file("a.rs", "fn f() { std::fs::read(\"x\"); }");
        assert_eq!(impurities(&reads, &[("a.rs", "std::fs", "a reason")]), NONE);
        assert_eq!(impurities(&reads, &[("b.rs", "std::fs", "a reason")]).len(), 1);
    }

    #[test]
    fn a_library_outside_its_door_is_found() {
        let names = "use zenoh::Session;";
        assert_eq!(past_the_door(&file("bus/src/session.rs", names), "zenoh", "bus/src"), NONE);
        assert_eq!(past_the_door(&file("record/src/file/read.rs", names), "zenoh", "record/src/file"), NONE);
        assert_eq!(past_the_door(&file("record/src/files.rs", names), "zenoh", "record/src/file").len(), 1);
        assert_eq!(past_the_door(&file("ui/src/view.rs", "fn f() { zenoh::open() }"), "zenoh", "bus/src").len(), 1);
        assert_eq!(past_the_door(&file("ui/src/view.rs", "use zenoh_like::X;"), "zenoh", "bus/src"), NONE);
    }

    #[test]
    fn a_dependency_that_points_up_or_sideways_is_found() {
        let found = |from: &'static str, to: &'static str| {
            let depends_on = move |name: &str| if name == from { vec![to.to_owned()] } else { Vec::new() };
            upward(&["channel", "bus", "heliostat"], depends_on).len()
        };
        assert_eq!(found("heliostat", "heliostat-bus"), 0);
        assert_eq!(found("heliostat-channel", "heliostat-bus"), 1);
        assert_eq!(found("heliostat-bus", "heliostat-bus"), 1);
        assert_eq!(found("heliostat-bus", "heliostat-unknown"), 1);
    }

    #[test]
    fn an_engine_below_a_pure_crate_is_found() {
        let needed = BTreeSet::from(["zenoh-codec", "nalgebra", "ort", "portable"]);
        assert_eq!(forbidden(&needed, &NOT_IN_PURE), ["ort", "zenoh-codec"]);
    }

    #[test]
    fn a_second_version_without_a_reason_and_a_stale_reason_are_found() {
        let several = BTreeMap::from([("tokio", BTreeSet::from(["1.0", "2.0"])), ("glam", BTreeSet::from(["1", "2"]))]);
        assert_eq!(second_versions(&several, &[("tokio", "a reason")]), NONE);
        assert_eq!(second_versions(&several, &[]).len(), 1);
        assert_eq!(second_versions(&several, &[("tokio", "a reason"), ("syn", "a reason")]).len(), 1);
    }

    #[test]
    fn a_foreign_licence_or_source_is_found() {
        let packages = |licence: &str, source: &str| {
            let json = format!(
                r#"{{"packages": [{{"id": "a", "name": "a", "version": "1", "license": {licence}, "source": "{source}"}}],
                "resolve": {{"nodes": [{{"id": "a", "deps": []}}]}}}}"#
            );
            Packages::from_json(&json)
        };
        assert_eq!(unlicensed(&packages(r#""MIT""#, CRATES_IO)), NONE);
        assert_eq!(unlicensed(&packages(r#""GPL-3.0-only""#, CRATES_IO)).len(), 1);
        assert_eq!(unlicensed(&packages("null", CRATES_IO)).len(), 1);
        assert_eq!(unlicensed(&packages(r#""MIT""#, "git+https://example.org/a")).len(), 1);
    }
}
