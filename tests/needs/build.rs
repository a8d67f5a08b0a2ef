//! Looks for the programs that some tests need.

use std::env;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// What a machine may lack: its name, whether it is here, and what to install.
type Need = (&'static str, fn() -> bool, &'static str);

const NEEDS: [Need; 11] = [
    ("browser", browser, "chromium and chromedriver (Debian: apt-get install chromium chromium-driver)"),
    ("cc", || runs("cc", &["--version"]), "a C compiler, cc"),
    ("containers", || false, "HELIOSTAT_REQUIRE=containers, root, dockerd, compose, debootstrap and zenohd"),
    ("cxx", || runs("g++", &["--version"]), "g++"),
    ("network-namespaces", network_namespaces, "root, ip and nft (Debian: apt-get install iproute2 nftables)"),
    ("numpy", || imports("numpy"), "NumPy (pip install numpy; HELIOSTAT_PYTHON names the interpreter)"),
    ("onnxruntime", onnxruntime, "ONNX Runtime (pip install onnxruntime in the environment that VIRTUAL_ENV names)"),
    ("python", || imports("pty"), "Python 3 (Debian: apt-get install python3; HELIOSTAT_PYTHON names the interpreter)"),
    (
        "python-package",
        || imports("heliostat.driver, heliostat.tracker"),
        "the Python package (pip install \"./python[zenoh]\"; HELIOSTAT_PYTHON names the interpreter)",
    ),
    (
        "router",
        router,
        "zenohd on the path or named by HELIOSTAT_ZENOHD (docs/deploy.md has the command that builds it)",
    ),
    ("script", || runs("script", &["--version"]), "script (Debian: apt-get install bsdutils)"),
];

/// Variables that name ONNX Runtime, or a Python environment with it.
const ONNXRUNTIME: [&str; 3] = ["ORT_DYLIB_PATH", "VIRTUAL_ENV", "CONDA_PREFIX"];

fn main() {
    let of_programs = ["HELIOSTAT_PYTHON", "HELIOSTAT_REQUIRE", "HELIOSTAT_ZENOHD", "PATH"];
    for variable in of_programs.into_iter().chain(ONNXRUNTIME) {
        println!("cargo::rerun-if-env-changed={variable}");
    }
    println!("cargo::rerun-if-changed=build.rs");
    for folder in folders().filter(|folder| folder.is_dir()) {
        println!("cargo::rerun-if-changed={}", folder.display());
    }
    let required = env::var("HELIOSTAT_REQUIRE").unwrap_or_default();
    let required: Vec<&str> = required.split([',', ' ']).filter(|name| !name.is_empty()).collect();
    let names = NEEDS.map(|(name, ..)| name);
    if let Some(unknown) = required.iter().find(|name| !names.contains(name)) {
        panic!("HELIOSTAT_REQUIRE holds {unknown:?}: expected some of {}, separated by commas", names.join(", "));
    }
    let reasons = NEEDS.map(|(name, is_here, what)| {
        let is_lacking = !required.contains(&name) && !is_here();
        (name, is_lacking.then(|| format!("needs {what}")))
    });
    let out = PathBuf::from(env::var_os("OUT_DIR").expect("cargo sets it"));
    fs::write(out.join("reasons.rs"), format!("&{reasons:?}")).expect("the output folder is writable");
}

fn folders() -> impl Iterator<Item = PathBuf> {
    let path = env::var_os("PATH").unwrap_or_default();
    env::split_paths(&path).collect::<Vec<_>>().into_iter()
}

fn runs(program: impl AsRef<Path>, arguments: &[&str]) -> bool {
    let output = Command::new(program.as_ref()).args(arguments).output();
    output.is_ok_and(|output| output.status.success())
}

fn is_on_path(program: &str) -> bool {
    folders().any(|folder| folder.join(program).is_file())
}

fn browser() -> bool {
    let browsers = ["chromium", "chromium-browser", "google-chrome", "google-chrome-stable"];
    is_on_path("chromedriver") && browsers.into_iter().any(is_on_path)
}

fn network_namespaces() -> bool {
    let name = format!("heliostat-build-{}", std::process::id());
    let is_made = runs("ip", &["netns", "add", &name]);
    let is_filtered = is_made && runs("ip", &["netns", "exec", &name, "nft", "list", "ruleset"]);
    is_made && runs("ip", &["netns", "delete", &name]) && is_filtered
}

fn imports(modules: &str) -> bool {
    let python = env::var("HELIOSTAT_PYTHON").unwrap_or_else(|_| "python3".into());
    runs(python, &["-c", &format!("import {modules}")])
}

fn onnxruntime() -> bool {
    let [named, environments @ ..] = ONNXRUNTIME.map(|name| env::var_os(name).filter(|value| !value.is_empty()));
    let is_in = |environment: PathBuf| runs(environment.join("bin/python"), &["-c", "import onnxruntime"]);
    named.is_some() || environments.into_iter().flatten().map(PathBuf::from).any(is_in)
}

fn router() -> bool {
    let named = env::var_os("HELIOSTAT_ZENOHD").map(PathBuf::from);
    runs(named.unwrap_or_else(|| "zenohd".into()), &["--version"])
}
