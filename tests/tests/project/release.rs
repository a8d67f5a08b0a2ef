//! The release archive: what deploy/release/build packs from the built programs, and the demo from it.
//!
//! The programs are those built beside this test. The build with the profile `dist`, the wheels and the
//! image are made by the same script, and tried by deploy/release/first-beam.

use std::path::{Path, PathBuf};
use std::process::Command;

use heliostat_tests::{programs, workspace};

/// Runs a program of the release in a folder; returns its standard output.
fn run(program: &Path, arguments: &[&str]) -> String {
    let output = Command::new(program).args(arguments).output().expect("the script runs");
    let (out, errors) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert!(output.status.success(), "{} {arguments:?}: {out}{errors}", program.display());
    out.into_owned()
}

/// The archive of the built programs, in a folder of its own.
fn archive(folder: &Path) -> PathBuf {
    let programs = programs();
    let texts = [folder, &programs].map(|path| path.to_str().expect("a plain path"));
    run(&workspace().join("deploy/release/build"), &[texts[0], "--programs", texts[1], "archive", "checksums"]);
    let files = std::fs::read_dir(folder).expect("a folder").flatten().map(|entry| entry.path());
    let mut archives = files.filter(|file| file.extension().is_some_and(|extension| extension == "gz"));
    archives.next().expect("an archive")
}

#[test]
fn the_archive_has_programs_documents_and_units_and_its_demo_runs_from_an_empty_folder() {
    let folder = tempfile::tempdir().expect("a folder");
    let archive = archive(folder.path());
    let listing = run(Path::new("tar"), &["-tzf", archive.to_str().expect("a plain path")]);
    for member in [
        "bin/heliostat",
        "bin/heliostat-controller",
        "bin/heliostat-sim-node",
        "share/man/man1/heliostat-demo.1",
        "share/bash-completion/completions/heliostat",
        "share/zsh/site-functions/_heliostat",
        "share/fish/vendor_completions.d/heliostat.fish",
        "share/doc/heliostat/README.md",
        "LICENSE-MIT",
        "LICENSE-APACHE",
        "deploy/systemd/heliostat-controller@.service",
        "deploy/rooms/studio.toml",
    ] {
        assert!(listing.lines().any(|line| line.ends_with(&format!("/{member}"))), "{member} is missing:\n{listing}");
    }
    let file = archive.to_str().expect("a plain path");
    let install = run(Path::new("tar"), &["-xzOf", file, "--wildcards", "*/INSTALL"]);
    let lock = std::fs::read_to_string(workspace().join("Cargo.lock")).expect("a lock file");
    let zenoh = lock.split_once("name = \"zenoh\"\nversion = \"").expect("zenoh is there").1;
    let version = zenoh.split('"').next().expect("a version");
    assert!(install.contains(&format!(" zenohd --version {version}\n")), "{install}");
    let sums =
        Command::new("sha256sum").args(["--check", "--strict", "SHA256SUMS"]).current_dir(folder.path()).output();
    assert!(sums.expect("sha256sum runs").status.success());
    let measured =
        run(&workspace().join("deploy/release/first-beam"), &[folder.path().to_str().expect("a plain path")]);
    assert!(measured.contains("first answered report after"), "{measured}");
}

#[test]
fn two_archives_of_the_same_programs_are_equal() {
    let folders = [(); 2].map(|()| tempfile::tempdir().expect("a folder"));
    let [first, second] = folders.each_ref().map(|folder| std::fs::read(archive(folder.path())).expect("an archive"));
    assert!(first == second, "the archives differ");
}

#[test]
fn binstall_finds_the_program_in_the_archive() {
    let folder = tempfile::tempdir().expect("a folder");
    let archive = archive(folder.path());
    let manifest = std::fs::read_to_string(workspace().join("crates/cli/Cargo.toml")).expect("a manifest");
    let manifest: toml::Table = manifest.parse().expect("TOML");
    let metadata = &manifest["package"]["metadata"]["binstall"];
    let name = archive.file_name().expect("a file").to_string_lossy().into_owned();
    let target = name.trim_end_matches(".tar.gz").splitn(3, '-').nth(2).expect("a target");
    let fill = |template: &str| {
        let values = [
            ("{ repo }", "REPOSITORY"),
            ("{ name }", "heliostat"),
            ("{ version }", env!("CARGO_PKG_VERSION")),
            ("{ target }", target),
            ("{ archive-suffix }", ".tar.gz"),
            ("{ bin }", "heliostat"),
            ("{ binary-ext }", ""),
        ];
        values.iter().fold(template.to_owned(), |text, (name, value)| text.replace(name, value))
    };
    let url = fill(metadata["pkg-url"].as_str().expect("a template"));
    assert!(url.ends_with(&format!("/{name}")), "{url} is not {name}");
    let listing = run(Path::new("tar"), &["-tzf", archive.to_str().expect("a plain path")]);
    let program = fill(metadata["bin-dir"].as_str().expect("a template"));
    assert!(listing.lines().any(|line| line == program), "{program}:\n{listing}");
}

#[test]
fn a_release_that_cannot_be_built_says_what_is_missing_and_writes_nothing() {
    let folder = tempfile::tempdir().expect("a folder");
    let place = folder.path().join("release");
    let empty = folder.path().to_str().expect("a plain path");
    for (arguments, expected) in [
        (&["--target", "abacus", "archive"][..], "unknown target \"abacus\": expected one of"),
        (&["--target", "x86_64-pc-windows-gnu", "archive"], "expected a target of Linux or macOS"),
        (&["--target", "riscv64gc-unknown-openbsd", "archive"], "expected a target of Linux or macOS"),
        (&["--programs", empty, "archive"], "has no heliostat: build it with"),
        (&["--programs", "absent", "archive"], "--programs absent is not a folder"),
        (&["--host-program", "absent", "archive"], "--host-program absent is not a program"),
    ] {
        let mut command = Command::new(workspace().join("deploy/release/build"));
        let output = command.arg(&place).args(arguments).output().expect("the script runs");
        let errors = String::from_utf8_lossy(&output.stderr);
        assert!(!output.status.success() && errors.contains(expected), "{arguments:?}: {errors}");
        assert!(std::fs::read_dir(&place).map_or(0, Iterator::count) == 0, "{arguments:?}");
    }
    let mut command = Command::new(workspace().join("deploy/release/build"));
    let programs = programs();
    command.arg(&place).arg("--programs").arg(&programs).arg("image").env("DOCKER_HOST", "unix:///absent");
    let output = command.output().expect("the script runs");
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(!output.status.success() && errors.contains("no container engine answers"), "{errors}");
}
