//! Which file of a crate uses which: the graph behind the rule that files form no import circles.
//!
//! A node is a module with a file of its own. An edge goes from a file that uses an item to the
//! file that defines it, through any re-exports in between. A re-export (`pub use`) by itself is no
//! use.
//!
//! Limits: see [`crate::rust_source`]. Calls of methods make no edge, since a method call does not
//! name its file; `super` inside an inline `mod x { }` is taken as if it stood in the file itself.
//! Binaries (`src/main.rs` beside a `src/lib.rs`, and `src/bin`) are not looked at.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use crate::rust_source::{Import, RustSource};

/// A module's path inside its crate; empty for the crate root.
type ModulePath = Vec<String>;

/// How many re-exports may lead from one to the next.
const REEXPORTS_MAX: usize = 16;

/// The modules of one crate.
#[derive(Debug, Default)]
pub struct ModuleGraph {
    modules: BTreeMap<ModulePath, Module>,
}

#[derive(Debug)]
struct Module {
    /// Path of the file under the crate's `src`.
    file: String,
    source: RustSource,
}

impl ModuleGraph {
    /// Reads the crate in a folder.
    ///
    /// # Panics
    /// When a source cannot be read.
    pub fn read(folder: &Path) -> Self {
        let src = folder.join("src");
        let sources = rust_files(&src).into_iter().map(|path| {
            let file = path.strip_prefix(&src).expect("it lies there").to_string_lossy().replace('\\', "/");
            (file, std::fs::read_to_string(&path).expect("a source is readable"))
        });
        Self::from_sources(sources)
    }

    /// Builds the graph of the files of a `src` folder, each given by its path in there and its
    /// text.
    pub fn from_sources(sources: impl IntoIterator<Item = (String, String)>) -> Self {
        let sources: BTreeMap<String, String> = sources.into_iter().collect();
        let has_library = sources.contains_key("lib.rs");
        let is_part = |file: &str| !(file.starts_with("bin/") || has_library && file == "main.rs");
        let modules = sources
            .iter()
            .filter(|(file, _)| is_part(file))
            .map(|(file, text)| (module_path(file), Module { file: file.clone(), source: RustSource::parse(text) }));
        let mut graph = Self { modules: modules.collect() };
        graph.drop_test_modules();
        graph
    }

    /// The circles: for each set of files that use one another, one way round, first file repeated
    /// at the end.
    pub fn circles(&self) -> Vec<Vec<String>> {
        let edges: BTreeMap<&ModulePath, BTreeSet<&ModulePath>> =
            self.modules.iter().map(|(path, module)| (path, self.used_by(path, module))).collect();
        let mut seen: BTreeSet<&ModulePath> = BTreeSet::new();
        let mut circles = Vec::new();
        for start in edges.keys().copied() {
            if seen.contains(start) {
                continue;
            }
            if let Some(circle) = shortest_way(&edges, start, start) {
                let reaches_back = |path: &&&ModulePath| shortest_way(&edges, path, start).is_some();
                let reached = edges.keys().filter(|path| shortest_way(&edges, start, path).is_some());
                seen.extend(reached.filter(reaches_back).copied());
                circles.push(circle.into_iter().map(|path| self.modules[path].file.clone()).collect());
            }
        }
        circles
    }

    /// Files that exist in tests only take no part.
    fn drop_test_modules(&mut self) {
        let parents = self.modules.iter();
        let dropped: Vec<ModulePath> = parents
            .flat_map(|(path, module)| {
                module.source.test_modules.iter().map(|name| [path.as_slice(), std::slice::from_ref(name)].concat())
            })
            .collect();
        self.modules.retain(|path, _| !dropped.iter().any(|test| path.starts_with(test)));
    }

    /// The modules whose items a module uses.
    fn used_by(&self, path: &ModulePath, module: &Module) -> BTreeSet<&ModulePath> {
        let source = &module.source;
        let mut used = BTreeSet::new();
        for import in &source.imports {
            let is_glob = import.path.last().is_some_and(|last| last == "*");
            if import.is_public && (is_glob || !source.words.contains(&import.name)) {
                continue;
            }
            let target = if is_glob { &import.path[..import.path.len() - 1] } else { &import.path };
            let Some(target) = self.absolute(target, path, 0) else { continue };
            let found = if is_glob { self.modules.get_key_value(&target) } else { None };
            used.extend(found.map(|(path, _)| path).or_else(|| self.definer(&target, 0)));
        }
        for name in source.paths.iter().filter(|name| name.len() > 1) {
            used.extend(self.absolute(name, path, 0).and_then(|target| self.definer(&target, 0)));
        }
        used.remove(path);
        used
    }

    /// A path as it stands in a module, from the crate root; nothing where it leads out of the
    /// crate.
    fn absolute(&self, path: &[String], module: &ModulePath, depth: usize) -> Option<Vec<String>> {
        let (first, rest) = path.split_first()?;
        match first.as_str() {
            "crate" => return Some(rest.to_vec()),
            "self" => return Some([module.as_slice(), rest].concat()),
            "super" => {
                let supers = path.iter().take_while(|segment| *segment == "super").count();
                let parent = module.len().checked_sub(supers)?;
                return Some([&module[..parent], &path[supers..]].concat());
            }
            _ => {}
        }
        let child = [module.as_slice(), std::slice::from_ref(first)].concat();
        if let Some(import) = self.import(module, first).filter(|import| import.path != path && depth < REEXPORTS_MAX) {
            let target = self.absolute(&import.path, module, depth + 1)?;
            return Some([target.as_slice(), rest].concat());
        }
        self.modules.contains_key(&child).then(|| [child.as_slice(), rest].concat())
    }

    /// The module that defines what an absolute path names; nothing for a module itself, and
    /// outside the crate.
    fn definer(&self, path: &[String], depth: usize) -> Option<&ModulePath> {
        let length = (0..=path.len()).rev().find(|length| self.modules.contains_key(&path[..*length]))?;
        let (module, module_data) = self.modules.get_key_value(&path[..length])?;
        let (name, rest) = path[length..].split_first()?;
        if depth >= REEXPORTS_MAX {
            return Some(module);
        }
        if let Some(import) = self.import(module, name) {
            let target = self.absolute(&import.path, module, depth + 1)?;
            return self.definer(&[target.as_slice(), rest].concat(), depth + 1);
        }
        if !module_data.source.definitions.contains(name) {
            let globs = module_data.source.imports.iter().filter(|import| import.name == "*");
            for glob in globs {
                let target = self.absolute(&glob.path[..glob.path.len() - 1], module, depth + 1);
                let Some(target) = target.filter(|target| self.modules.contains_key(target)) else { continue };
                let source = &self.modules[&target].source;
                if source.definitions.contains(name) || source.imports.iter().any(|import| import.name == *name) {
                    return self.definer(&[target.as_slice(), std::slice::from_ref(name)].concat(), depth + 1);
                }
            }
        }
        Some(module)
    }

    fn import(&self, module: &ModulePath, name: &str) -> Option<&Import> {
        let imports = self.modules.get(module)?.source.imports.iter();
        imports.into_iter().find(|import| import.name == name && name != "*")
    }
}

/// Every Rust file below a folder.
pub fn rust_files(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path());
    let files = entries.flat_map(|path| if path.is_dir() { rust_files(&path) } else { vec![path] });
    let mut files: Vec<PathBuf> = files.filter(|path| path.extension().is_some_and(|ending| ending == "rs")).collect();
    files.sort();
    files
}

fn module_path(file: &str) -> ModulePath {
    let mut path: ModulePath = file.trim_end_matches(".rs").split('/').map(String::from).collect();
    if path.last().is_some_and(|last| last == "mod") || matches!(file, "lib.rs" | "main.rs") {
        path.pop();
    }
    path
}

/// The shortest way of at least one edge, both ends included.
fn shortest_way<'a>(
    edges: &BTreeMap<&'a ModulePath, BTreeSet<&'a ModulePath>>,
    from: &'a ModulePath,
    to: &ModulePath,
) -> Option<Vec<&'a ModulePath>> {
    let mut before: BTreeMap<&ModulePath, &ModulePath> = BTreeMap::new();
    let mut queue = std::collections::VecDeque::from([from]);
    while let Some(path) = queue.pop_front() {
        for next in edges[path].iter().copied() {
            if before.contains_key(next) {
                continue;
            }
            before.insert(next, path);
            if next == to {
                let mut way = vec![next];
                let mut at = path;
                while at != from {
                    way.push(at);
                    at = before[at];
                }
                way.push(from);
                way.reverse();
                return Some(way);
            }
            queue.push_back(next);
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    fn circles(files: &[(&str, &str)]) -> Vec<Vec<String>> {
        let sources = files.iter().map(|(file, text)| ((*file).to_owned(), (*text).to_owned()));
        ModuleGraph::from_sources(sources).circles()
    }

    #[test]
    fn two_files_that_use_each_other_are_a_circle() {
        let found = circles(&[
            ("lib.rs", "mod a; mod b;"),
            ("a.rs", "use crate::b::B; pub struct A;"),
            ("b.rs", "pub struct B; fn f() { crate::a::A; }"),
        ]);
        assert_eq!(found, [["a.rs", "b.rs", "a.rs"]]);
    }

    #[test]
    fn a_parent_that_uses_a_child_that_uses_the_parent_is_a_circle() {
        let parent = "mod kind; use kind::build; pub trait Policy {} fn f() { build() }";
        let found = circles(&[
            ("lib.rs", "mod policy;"),
            ("policy.rs", parent),
            ("policy/kind.rs", "use super::Policy; pub fn build() {}"),
        ]);
        assert_eq!(found, [["policy.rs", "policy/kind.rs", "policy.rs"]]);
    }

    #[test]
    fn a_reexport_is_no_use_and_is_followed_to_the_definition() {
        let files = |b: &'static str| {
            [
                ("lib.rs", "mod a; mod b; mod c; pub use a::A; pub use b::*; use c::C;"),
                ("a.rs", "use crate::B; pub struct A;"),
                ("b.rs", b),
                ("c.rs", "use crate::A; pub struct C;"),
            ]
        };
        assert_eq!(circles(&files("pub struct B;")), Vec::<Vec<String>>::new());
        assert_eq!(circles(&files("use crate::C; pub struct B;")), [["a.rs", "b.rs", "c.rs", "a.rs"]]);
    }

    #[test]
    fn modules_that_are_imported_by_name_are_followed() {
        let found = circles(&[
            ("lib.rs", "pub mod codec; pub mod error;"),
            ("codec.rs", "use crate::error; pub fn decode() { error::Error; }"),
            ("error.rs", "use super::codec as c; pub struct Error; fn f() { c::decode() }"),
        ]);
        assert_eq!(found, [["codec.rs", "error.rs", "codec.rs"]]);
    }

    #[test]
    fn tests_and_binaries_make_no_circle() {
        let found = circles(&[
            ("lib.rs", "mod a; mod b; #[cfg(test)] mod fixtures;"),
            ("a.rs", "use crate::b::B; pub struct A; #[cfg(test)] mod tests { use super::*; use crate::fixtures; }"),
            ("b.rs", "pub struct B; #[cfg(test)] mod tests { use crate::a::A; }"),
            ("fixtures.rs", "use crate::a::A; pub struct F;"),
            ("main.rs", "use crate::a::A;"),
        ]);
        assert_eq!(found, Vec::<Vec<String>>::new());
    }
}
