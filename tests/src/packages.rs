//! The packages of a build as `cargo metadata` reports them: names and dependencies.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::process::Command;

use serde_json::Value;

/// A package of the build.
#[derive(Clone, Debug)]
struct Package {
    name: String,
    /// Whether the workspace holds it.
    is_own: bool,
}

/// All packages that a build for this platform takes part in.
#[derive(Clone, Debug, Default)]
pub struct Packages {
    packages: BTreeMap<String, Package>,
    /// By id: the ids of normal and build dependencies, not of those that only tests have.
    dependencies: BTreeMap<String, BTreeSet<String>>,
}

impl Packages {
    /// Asks cargo about the workspace in a folder, without a download and without a change to the
    /// lock file.
    ///
    /// # Panics
    /// When cargo does not answer.
    pub fn read(workspace: &Path) -> Self {
        let platform = host();
        let flags = ["metadata", "--format-version", "1", "--offline", "--locked", "--filter-platform", &platform];
        Self::from_json(&cargo(workspace, &flags))
    }

    /// Reads the answer of `cargo metadata`.
    ///
    /// # Panics
    /// When it is none.
    pub fn from_json(json: &str) -> Self {
        let metadata: Value = serde_json::from_str(json).expect("cargo metadata answers with JSON");
        let text = |value: &Value| value.as_str().unwrap_or_default().to_owned();
        let nodes = metadata["resolve"]["nodes"].as_array().expect("a list of nodes");
        let taking_part: BTreeSet<String> = nodes.iter().map(|node| text(&node["id"])).collect();
        let packages = metadata["packages"].as_array().expect("a list of packages").iter();
        let packages = packages.filter(|package| taking_part.contains(&text(&package["id"]))).map(|package| {
            let package_data = Package { name: text(&package["name"]), is_own: package["source"].is_null() };
            (text(&package["id"]), package_data)
        });
        let is_built = |dependency: &&Value| {
            let kinds = dependency["dep_kinds"].as_array().map_or(&[][..], Vec::as_slice);
            kinds.iter().any(|kind| kind["kind"] != "dev")
        };
        let dependencies = nodes.iter().map(|node| {
            let all = node["deps"].as_array().map_or(&[][..], Vec::as_slice).iter();
            (text(&node["id"]), all.filter(is_built).map(|dependency| text(&dependency["pkg"])).collect())
        });
        Self { packages: packages.collect(), dependencies: dependencies.collect() }
    }

    /// Names of the packages that a package of the workspace needs, itself left out.
    pub fn needed_by(&self, name: &str) -> BTreeSet<&str> {
        let is_it = |(_, package): &(&String, &Package)| package.name == name && package.is_own;
        let mut waiting: Vec<&String> = self.packages.iter().filter(is_it).map(|(id, _)| id).collect();
        let mut seen: BTreeSet<&String> = waiting.iter().copied().collect();
        let mut needed = BTreeSet::new();
        while let Some(id) = waiting.pop() {
            for dependency in self.dependencies.get(id).into_iter().flatten() {
                needed.extend(self.packages.get(dependency).map(|package| package.name.as_str()));
                if seen.insert(dependency) {
                    waiting.push(dependency);
                }
            }
        }
        needed
    }

    /// Names of the workspace's packages on which a package of the workspace depends directly.
    pub fn workspace_dependencies(&self, name: &str) -> BTreeSet<&str> {
        let own = self.packages.iter().filter(|(_, package)| package.name == name && package.is_own);
        let ids = own.flat_map(|(id, _)| self.dependencies.get(id).into_iter().flatten());
        let packages = ids.filter_map(|id| self.packages.get(id)).filter(|package| package.is_own);
        packages.map(|package| package.name.as_str()).collect()
    }

    /// Names of the workspace's own packages.
    pub fn of_the_workspace(&self) -> BTreeSet<&str> {
        self.packages.values().filter(|package| package.is_own).map(|package| package.name.as_str()).collect()
    }

    /// Names of the workspace's packages that depend directly on a package, tests left out.
    pub fn users_of(&self, library: &str) -> BTreeSet<&str> {
        let depends = |id: &&String| {
            let ids = self.dependencies.get(*id).into_iter().flatten();
            ids.filter_map(|id| self.packages.get(id)).any(|package| package.name == library)
        };
        let own = self.packages.iter().filter(|(_, package)| package.is_own);
        own.filter(|(id, _)| depends(id)).map(|(_, package)| package.name.as_str()).collect()
    }
}

/// The platform for which cargo builds: packages of other platforms may not be on this machine.
fn host() -> String {
    let version = cargo(Path::new("."), &["-vV"]);
    let host = version.lines().find_map(|line| line.strip_prefix("host: "));
    host.expect("cargo reports its host").to_owned()
}

fn cargo(folder: &Path, arguments: &[&str]) -> String {
    let program = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let output = Command::new(program).args(arguments).current_dir(folder).output().expect("cargo starts");
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "cargo {}: {errors}", arguments.join(" "));
    String::from_utf8(output.stdout).expect("cargo answers with text")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `a` needs `b`, which needs `c` 1; `a` has `c` 2 for its tests only.
    const METADATA: &str = r#"{
        "packages": [
            {"id": "a", "name": "a", "version": "0.1.0", "license": "MIT", "source": null},
            {"id": "b", "name": "b", "version": "1.0.0", "license": "MIT", "source": "git+https://example.org/b"},
            {"id": "c1", "name": "c", "version": "1.0.0", "license": null, "source": "registry"},
            {"id": "c2", "name": "c", "version": "2.0.0", "license": "MIT", "source": "registry"},
            {"id": "d", "name": "elsewhere", "version": "2.0.0", "license": "MIT", "source": "registry"}
        ],
        "resolve": {"nodes": [
            {"id": "a", "deps": [
                {"pkg": "b", "dep_kinds": [{"kind": "dev"}, {"kind": null}]},
                {"pkg": "c2", "dep_kinds": [{"kind": "dev"}]}
            ]},
            {"id": "b", "deps": [{"pkg": "c1", "dep_kinds": [{"kind": "build"}]}]},
            {"id": "c1", "deps": []},
            {"id": "c2", "deps": []}
        ]}
    }"#;

    #[test]
    fn needs_are_followed_and_those_of_tests_are_not() {
        let packages = Packages::from_json(METADATA);
        assert_eq!(packages.needed_by("a"), BTreeSet::from(["b", "c"]));
        assert_eq!(packages.workspace_dependencies("a"), BTreeSet::new());
    }
}
