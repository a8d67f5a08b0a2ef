//! Names the commit that is built, so that every figure can say what computed it, and the code of
//! each figure, so that a part can say whether it is still that.

use std::{env, error::Error, fs, path::Path, process::Command};

#[path = "src/sources.rs"]
mod sources;

fn main() -> Result<(), Box<dyn Error>> {
    let root = Path::new(&env::var("CARGO_MANIFEST_DIR")?).join("../..");
    for name in sources::CRATES.into_iter().chain(["lab/reproduce"]) {
        println!("cargo::rerun-if-changed={}", root.join(name).join("src").display());
    }
    for entry in fs::read_dir(root.join("lab/reproduce/src/figures"))? {
        let file = entry?.file_name().to_string_lossy().into_owned();
        let figure = file.trim_end_matches(".rs").to_uppercase();
        println!("cargo::rustc-env=HELIOSTAT_CODE_{figure}={}", sources::of_figure(&root, &file)?);
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
