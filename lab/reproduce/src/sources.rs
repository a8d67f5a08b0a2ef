//! A hash of the code that a figure depends on: a part is computed again when the code changes.
//!
//! The build script includes this file as a module; it must not name the crate. The hash covers the
//! workspace only; each part also records its commit.

use std::fs;
use std::io;
use std::path::Path;

use sha2::{Digest, Sha256};

/// The crates whose code computes parts.
pub const CRATES: [&str; 8] = [
    "crates/channel",
    "crates/scenario",
    "crates/onnx",
    "crates/array",
    "controller/core",
    "sim-node/room",
    "models",
    "lab/learn",
];

/// The hash for a figure by the name of its file: the crates above, the shared files of this crate,
/// and its own file. Actors enter the key of the part that uses them.
///
/// # Errors
/// A file that cannot be read.
pub fn of_figure(root: &Path, file: &str) -> io::Result<String> {
    let mut places = CRATES.map(|name| format!("{name}/src")).to_vec();
    places.extend(
        ["figures.rs", "figures/finished_parts.rs", "job.rs", "over_floor.rs", "plan.rs", &format!("figures/{file}")]
            .map(|name| format!("lab/reproduce/src/{name}")),
    );
    hash(root, &places)
}

/// Hash of files, and of all files below folders, by their names from the root in order and by
/// their contents.
///
/// # Errors
/// A file or folder that cannot be read.
pub fn hash(root: &Path, places: &[String]) -> io::Result<String> {
    let mut names = Vec::new();
    places.iter().try_for_each(|place| list(root, place, &mut names))?;
    names.sort_unstable();
    let mut hash = Sha256::new();
    for name in names {
        let contents = fs::read(root.join(&name))?;
        for bytes in [name.as_bytes(), &contents] {
            hash.update((bytes.len() as u64).to_le_bytes());
            hash.update(bytes);
        }
    }
    Ok(hash.finalize().iter().take(10).map(|byte| format!("{byte:02x}")).collect())
}

fn list(root: &Path, place: &str, names: &mut Vec<String>) -> io::Result<()> {
    if !root.join(place).is_dir() {
        names.push(place.into());
        return Ok(());
    }
    for entry in fs::read_dir(root.join(place))? {
        list(root, &format!("{place}/{}", entry?.file_name().to_string_lossy()), names)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn any_change_of_a_name_or_of_a_content_changes_the_hash() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        fs::create_dir_all(at("a/src/deep")).unwrap();
        fs::write(at("a/src/deep/one.rs"), "fn one() {}").unwrap();
        fs::write(at("a/src/two.rs"), "fn two() {}").unwrap();
        fs::write(at("a/other.rs"), "").unwrap();
        let now = || hash(folder.path(), &["a/src".into()]).unwrap();
        let begin = now();
        fs::write(at("a/other.rs"), "not below the folder").unwrap();
        assert_eq!(now(), begin);
        fs::write(at("a/src/deep/one.rs"), "fn one() { }").unwrap();
        assert_ne!(now(), begin);
        fs::write(at("a/src/deep/one.rs"), "fn one() {}").unwrap();
        assert_eq!(now(), begin);
        fs::rename(at("a/src/two.rs"), at("a/src/three.rs")).unwrap();
        assert_ne!(now(), begin);
        assert!(hash(folder.path(), &["a/gone.rs".into()]).is_err());
    }

    #[test]
    fn a_build_has_the_hash_of_its_code() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
        let stamped = [("map.rs", env!("HELIOSTAT_CODE_MAP")), ("ber_snr.rs", env!("HELIOSTAT_CODE_BER_SNR"))];
        for (file, code) in stamped {
            assert_eq!(of_figure(&root, file).unwrap(), code);
        }
        assert_ne!(stamped[0].1, stamped[1].1);
    }
}
