//! Checks of the architecture rules: each returns what breaks its rule. The rules themselves are in
//! `tests/invariants.rs`.

use std::collections::{BTreeMap, BTreeSet};

use crate::packages::{CRATES_IO, Packages, is_licence_allowed};
use crate::rust_source::RustSource;

/// A source file by its path from the workspace.
pub type Source = (String, RustSource);

/// Whether a name matches a pattern; `*` ends a prefix.
pub fn matches(pattern: &str, name: &str) -> bool {
    pattern.strip_suffix('*').map_or(pattern == name, |prefix| name.starts_with(prefix))
}

/// Every path that a source names, with local names replaced by what they were imported as.
fn full_paths(source: &RustSource) -> Vec<String> {
    let import = |name: &str| source.imports.iter().find(|import| import.name == name && name != "*");
    let expand = |path: &Vec<String>| match import(&path[0]).filter(|import| import.path != *path) {
        Some(import) => [import.path.as_slice(), &path[1..]].concat(),
        None => path.clone(),
    };
    let imported = source.imports.iter().map(|import| &import.path);
    imported.chain(&source.paths).map(|path| expand(path).join("::")).collect()
}

/// Which of these names a source uses: a path or its beginning, or a single word.
pub fn named<'a>(source: &RustSource, names: &[&'a str]) -> Vec<&'a str> {
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

/// Names that a pure crate may not use, except the allowed ones.
pub fn impurities(sources: &[Source], impure: &[&str], allowed: &[(&str, &str, &str)]) -> Vec<String> {
    let uses =
        sources.iter().flat_map(|(file, source)| named(source, impure).into_iter().map(move |name| (file, name)));
    let is_allowed = |file: &str, name: &str| allowed.iter().any(|entry| (entry.0, entry.1) == (file, name));
    uses.filter(|(file, name)| !is_allowed(file, name)).map(|(file, name)| format!("{file} names {name}")).collect()
}

/// Files that name a foreign library outside the file or folder reserved for it.
pub fn named_elsewhere(sources: &[Source], library: &str, place: &str) -> Vec<String> {
    let is_inside = |file: &str| {
        let rest = file.strip_prefix(place);
        rest.is_some_and(|rest| rest.is_empty() || rest.starts_with('/') || rest.starts_with(".rs"))
    };
    let names = |source: &RustSource| {
        full_paths(source).iter().any(|path| path == library || path.starts_with(&format!("{library}::")))
    };
    let found = sources.iter().filter(|(file, source)| !is_inside(file) && names(source));
    found.map(|(file, _)| format!("{file} names {library}; expected only {place} to")).collect()
}

/// Dependencies of a crate on one that is not below it.
pub fn upward(order: &[String], depends_on: impl Fn(&str) -> Vec<String>) -> Vec<String> {
    let place = |name: &str| order.iter().position(|package| package == name);
    let mut found = Vec::new();
    for (index, package) in order.iter().enumerate() {
        for dependency in depends_on(package) {
            match place(&dependency) {
                Some(below) if below < index => {}
                Some(_) => found.push(format!("{package} depends on {dependency}, which is not below it")),
                None => found.push(format!("{package} depends on {dependency}, which the layout does not name")),
            }
        }
    }
    found
}

/// Needed packages that match a forbidden pattern.
pub fn forbidden(needed: &BTreeSet<&str>, patterns: &[&str]) -> Vec<String> {
    let found = needed.iter().filter(|name| patterns.iter().any(|pattern| matches(pattern, name)));
    found.map(|name| (*name).to_owned()).collect()
}

/// Second versions of large packages without a reason, and reasons without a second version.
pub fn second_versions(
    several: &BTreeMap<&str, BTreeSet<&str>>,
    large: &[&str],
    reasons: &[(&str, &str)],
) -> Vec<String> {
    let is_large = |name: &str| large.iter().any(|pattern| matches(pattern, name));
    let has_reason = |name: &str| reasons.iter().any(|(reason, _)| *reason == name);
    let unexplained = several.iter().filter(|(name, _)| is_large(name) && !has_reason(name));
    let unexplained = unexplained.map(|(name, versions)| format!("{name} in the versions {versions:?}"));
    let stale = reasons.iter().filter(|(name, _)| !several.contains_key(name));
    unexplained.chain(stale.map(|(name, _)| format!("{name} has one version: remove its reason"))).collect()
}

/// Dependencies under another licence or from another source than allowed.
pub fn unlicensed(packages: &Packages, licences: &[&str]) -> Vec<String> {
    let foreign = packages.all().filter_map(|package| package.source.as_ref().map(|source| (package, source)));
    let bad =
        foreign.filter(|(package, source)| *source != CRATES_IO || !is_licence_allowed(&package.licence, licences));
    bad.map(|(package, source)| format!("{} {}: {:?} from {source}", package.name, package.version, package.licence))
        .collect()
}

/// Each check on small inputs: what it accepts, and what it does not.
#[cfg(test)]
mod tests {
    use super::*;

    const NONE: [String; 0] = [];

    const IMPURE: [&str; 8] = [
        "std::time::Instant",
        "std::time::SystemTime",
        "std::fs",
        "std::net",
        "println!",
        "rand::rng",
        "from_os_rng",
        "thread_rng",
    ];

    fn file(name: &str, text: &str) -> Vec<Source> {
        vec![(name.to_owned(), RustSource::parse(text))]
    }

    #[test]
    fn a_clock_a_file_or_a_thread_in_a_pure_crate_is_found() {
        for text in [
            "use std::time::{Duration, Instant};",
            "use std::time; fn f() { time::SystemTime::now(); }",
            "use std::time; use time::Instant;",
            "use std::time::*;",
            "fn f() { std::fs::read(\"x\"); }",
            "use std::{net::TcpStream};",
            "fn f() { println!(\"x\"); }",
            "fn f() { rand::rng(); }",
            "fn f() { ChaCha8Rng::from_os_rng(); }",
            "use rand::thread_rng as source;",
        ] {
            assert!(!impurities(&file("a.rs", text), &IMPURE, &[]).is_empty(), "{text}");
        }
        let pure = "use std::time::Duration; use rand::Rng; /// std::fs\nfn rng(now: u64) { writeln!(x); }";
        assert_eq!(impurities(&file("a.rs", pure), &IMPURE, &[]), NONE);
        let reads = file("a.rs", "fn f() { std::fs::read(\"x\"); }");
        assert_eq!(impurities(&reads, &IMPURE, &[("a.rs", "std::fs", "a reason")]), NONE);
        assert_eq!(impurities(&reads, &IMPURE, &[("b.rs", "std::fs", "a reason")]).len(), 1);
    }

    #[test]
    fn a_library_outside_its_place_is_found() {
        let names = "use zenoh::Session;";
        assert_eq!(named_elsewhere(&file("bus/src/session.rs", names), "zenoh", "bus/src"), NONE);
        assert_eq!(named_elsewhere(&file("record/src/file/read.rs", names), "zenoh", "record/src/file"), NONE);
        assert_eq!(named_elsewhere(&file("record/src/files.rs", names), "zenoh", "record/src/file").len(), 1);
        assert_eq!(named_elsewhere(&file("ui/src/view.rs", "fn f() { zenoh::open() }"), "zenoh", "bus/src").len(), 1);
        assert_eq!(named_elsewhere(&file("ui/src/view.rs", "use zenoh_like::X;"), "zenoh", "bus/src"), NONE);
    }

    #[test]
    fn a_dependency_that_points_up_or_sideways_is_found() {
        let found = |from: &'static str, to: &'static str| {
            let depends_on = move |name: &str| if name == from { vec![to.to_owned()] } else { Vec::new() };
            let order = ["heliostat-channel", "heliostat-bus", "heliostat"].map(String::from);
            upward(&order, depends_on).len()
        };
        assert_eq!(found("heliostat", "heliostat-bus"), 0);
        assert_eq!(found("heliostat-channel", "heliostat-bus"), 1);
        assert_eq!(found("heliostat-bus", "heliostat-bus"), 1);
        assert_eq!(found("heliostat-bus", "heliostat-unknown"), 1);
    }

    #[test]
    fn an_engine_below_a_pure_crate_is_found() {
        let needed = BTreeSet::from(["zenoh-codec", "nalgebra", "ort", "portable"]);
        assert_eq!(forbidden(&needed, &["zenoh*", "ort"]), ["ort", "zenoh-codec"]);
    }

    #[test]
    fn a_second_version_without_a_reason_and_a_stale_reason_are_found() {
        let several = BTreeMap::from([("tokio", BTreeSet::from(["1.0", "2.0"])), ("glam", BTreeSet::from(["1", "2"]))]);
        assert_eq!(second_versions(&several, &["tokio"], &[("tokio", "a reason")]), NONE);
        assert_eq!(second_versions(&several, &["tokio"], &[]).len(), 1);
        assert_eq!(second_versions(&several, &["tokio"], &[("tokio", "a reason"), ("syn", "a reason")]).len(), 1);
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
        assert_eq!(unlicensed(&packages(r#""MIT""#, CRATES_IO), &["MIT"]), NONE);
        assert_eq!(unlicensed(&packages(r#""GPL-3.0-only""#, CRATES_IO), &["MIT"]).len(), 1);
        assert_eq!(unlicensed(&packages("null", CRATES_IO), &["MIT"]).len(), 1);
        assert_eq!(unlicensed(&packages(r#""MIT""#, "git+https://example.org/a"), &["MIT"]).len(), 1);
    }
}
