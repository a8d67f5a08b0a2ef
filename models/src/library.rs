//! Where the shared library of ONNX Runtime comes from.
//!
//! The first of these that exists is used:
//!
//! 1. the file that [`choose`] names (`--onnxruntime`), then that of `ORT_DYLIB_PATH`;
//! 2. the folder of the executable, and `lib` in it;
//! 3. the Python environment of the executable, of `VIRTUAL_ENV` and of `CONDA_PREFIX`, where
//!    `pip install onnxruntime` puts it;
//! 4. the search path of the system's loader.

use std::{
    env, fs,
    path::{Path, PathBuf},
    sync::{Mutex, PoisonError},
};

/// The name of ONNX Runtime as an engine.
pub const ORT: &str = "ort";

/// The environment variable that names the library.
const VARIABLE: &str = "ORT_DYLIB_PATH";

/// Where an unnamed library is searched for, as in "not found PLACES".
pub const PLACES: &str = "beside the program, in the Python environment of the program, of VIRTUAL_ENV or of \
    CONDA_PREFIX, or where the system's loader searches";

static CHOSEN: Mutex<Option<PathBuf>> = Mutex::new(None);

/// Uses this file in place of a search. It has no effect once a library is loaded.
pub fn choose(path: PathBuf) {
    // A name without a folder may be one for the system's loader.
    let path = if path.exists() { std::path::absolute(&path).unwrap_or(path) } else { path };
    *CHOSEN.lock().unwrap_or_else(PoisonError::into_inner) = Some(path);
}

/// The file that replaces a search.
pub fn chosen() -> Option<PathBuf> {
    CHOSEN.lock().unwrap_or_else(PoisonError::into_inner).clone()
}

/// The flag that names the library.
#[derive(Clone, Debug, clap::Args)]
pub struct LibraryArgs {
    // The flag's help is the text that follows, so that it names the same places as a failed search.
    #[arg(long, global = true, value_name = "FILE", help = format!(
        "Shared library of ONNX Runtime, for actors that are no chain of dense layers \
         [default: {VARIABLE}, else the first one {PLACES}]"
    ))]
    onnxruntime: Option<PathBuf>,
}

impl LibraryArgs {
    /// Uses the file, if one is named.
    pub fn apply(self) {
        self.onnxruntime.into_iter().for_each(choose);
    }
}

/// Where the library may be.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Candidates {
    /// Files, the first to be tried first. The last one is a name for the system's loader.
    pub files: Vec<PathBuf>,
    /// Whether the only file was named by the user, so that a failure is not passed over.
    pub named_by: Option<&'static str>,
}

/// The files to try.
pub fn candidates() -> Candidates {
    let named = chosen().map(|path| (path, "--onnxruntime"));
    let named = named.or_else(|| variable(VARIABLE).map(|path| (path, VARIABLE)));
    if let Some((path, by)) = named {
        return Candidates { files: vec![path], named_by: Some(by) };
    }
    let executable = env::current_exe().and_then(fs::canonicalize).unwrap_or_default();
    let folder = executable.parent().unwrap_or(Path::new("")).to_owned();
    let mut files: Vec<PathBuf> =
        [folder.join("lib"), folder.clone()].iter().flat_map(|folder| libraries(folder)).collect();
    let prefixes = folder.parent().map(Path::to_owned).into_iter();
    for prefix in prefixes.chain(["VIRTUAL_ENV", "CONDA_PREFIX"].into_iter().filter_map(variable)) {
        files.extend(of_python(&prefix));
    }
    files.push(file_name().into());
    Candidates { files, named_by: None }
}

fn variable(name: &str) -> Option<PathBuf> {
    env::var_os(name).filter(|value| !value.is_empty()).map(PathBuf::from)
}

/// The name of the library without a version.
fn file_name() -> &'static str {
    match env::consts::OS {
        "windows" => "onnxruntime.dll",
        "macos" => "libonnxruntime.dylib",
        _ => "libonnxruntime.so",
    }
}

/// The libraries in a folder, without or with a version in the name, the last version first.
fn libraries(folder: &Path) -> Vec<PathBuf> {
    let is_library = |name: &str| match env::consts::OS {
        "windows" => name == file_name(),
        "macos" => name.starts_with("libonnxruntime.") && name.ends_with(".dylib"),
        _ => name == file_name() || name.starts_with("libonnxruntime.so."),
    };
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let mut found: Vec<PathBuf> =
        entries.filter(|entry| entry.file_name().to_str().is_some_and(is_library)).map(|entry| entry.path()).collect();
    found.sort();
    found.reverse();
    found
}

/// The libraries of the package onnxruntime in a Python environment.
fn of_python(prefix: &Path) -> Vec<PathBuf> {
    let packages = ["lib", "lib64"].into_iter().flat_map(|lib| {
        let versions = fs::read_dir(prefix.join(lib)).into_iter().flatten().flatten();
        versions.filter(|entry| entry.file_name().to_string_lossy().starts_with("python")).map(|entry| entry.path())
    });
    let mut folders: Vec<PathBuf> = packages.map(|python| python.join("site-packages")).collect();
    folders.sort();
    folders.push(prefix.join("Lib").join("site-packages"));
    folders.iter().flat_map(|folder| libraries(&folder.join("onnxruntime").join("capi"))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_help_of_the_flag_names_every_place_of_a_search() {
        let command = <LibraryArgs as clap::Args>::augment_args(clap::Command::new("program"));
        let help = command.get_arguments().next().and_then(clap::Arg::get_help).expect("one flag").to_string();
        for place in [VARIABLE, "beside the program", "VIRTUAL_ENV", "CONDA_PREFIX", "system's loader"] {
            assert!(help.contains(place), "{place}: {help}");
        }
    }

    #[test]
    fn the_library_of_a_python_environment_is_found_under_its_versioned_name() {
        let prefix = env::temp_dir().join(format!("heliostat-library-{}", std::process::id()));
        let capi = prefix.join("lib/python3.12/site-packages/onnxruntime/capi");
        fs::create_dir_all(&capi).expect("a folder");
        for name in ["libonnxruntime.so.1.20.0", "libonnxruntime_providers_shared.so", "__init__.py"] {
            fs::write(capi.join(name), "").expect("a file");
        }
        let found = of_python(&prefix);
        fs::remove_dir_all(&prefix).expect("its own folder");
        if env::consts::OS == "linux" {
            assert_eq!(found, [capi.join("libonnxruntime.so.1.20.0")]);
        }
    }
}
