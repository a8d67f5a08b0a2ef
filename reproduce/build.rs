//! Names the commit that is built, so that every figure can say what computed it.

use std::{env, error::Error, path::Path, process::Command};

/// The folders whose code decides the figures.
const SOURCES: [&str; 6] = ["channel", "scenario", "sim-node", "controller", "models", "reproduce"];

fn main() -> Result<(), Box<dyn Error>> {
    let root = Path::new(&env::var("CARGO_MANIFEST_DIR")?).join("..");
    for folder in SOURCES {
        println!("cargo::rerun-if-changed={}", root.join(folder).join("src").display());
    }
    let git = |arguments: &[&str]| {
        let output = Command::new("git").arg("-C").arg(&root).args(arguments).output().ok()?;
        output.status.success().then(|| String::from_utf8_lossy(&output.stdout).trim().to_owned())
    };
    for file in ["HEAD", "logs/HEAD"] {
        // A path that does not exist would have this run at every build.
        if let Some(path) =
            git(&["rev-parse", "--path-format=absolute", "--git-path", file]).filter(|path| Path::new(path).exists())
        {
            println!("cargo::rerun-if-changed={path}");
        }
    }
    let changes = git(&["status", "--porcelain", "--untracked-files=no"]).is_some_and(|changes| !changes.is_empty());
    let commit = git(&["rev-parse", "--short=12", "HEAD"]).unwrap_or_else(|| "unknown".into());
    println!("cargo::rustc-env=HELIOSTAT_COMMIT={commit}{}", if changes { "+changes" } else { "" });
    Ok(())
}
