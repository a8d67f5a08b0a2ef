//! Lists the actors in `models/actors`, so that they are built into the program and a new one needs
//! no edit here.

use std::{env, error::Error, fmt::Write, fs, path::Path};

fn main() -> Result<(), Box<dyn Error>> {
    let folder = Path::new(&env::var("CARGO_MANIFEST_DIR")?).join("actors");
    // A folder that does not exist yet cannot be watched: its parent is.
    let watched = if folder.exists() { "actors" } else { "." };
    println!("cargo::rerun-if-changed={watched}");
    let mut actors = Vec::new();
    for entry in fs::read_dir(&folder).into_iter().flatten() {
        let path = entry?.path();
        if path.extension().is_some_and(|extension| extension == "onnx") {
            actors.push(path.canonicalize()?);
        }
    }
    actors.sort();
    let mut list =
        String::from("/// Name and bytes of each built-in actor.\nstatic SHIPPED_ACTORS: &[(&str, &[u8])] = &[\n");
    for path in &actors {
        let name = path.file_name().ok_or("a file without a name")?;
        writeln!(list, "    ({name:?}, include_bytes!({path:?})),")?;
    }
    list.push_str("];\n");
    fs::write(Path::new(&env::var("OUT_DIR")?).join("shipped_actors.rs"), list)?;
    Ok(())
}
