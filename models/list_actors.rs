// Included by the build scripts that build actors into a program.

/// Writes a Rust file of this name with the name and the bytes of each actor in a folder, so that a
/// new actor needs no edit.
fn list_actors(folder: &std::path::Path, file: &str) -> Result<(), Box<dyn std::error::Error>> {
    use std::fmt::Write;
    println!("cargo::rerun-if-changed={}", folder.display());
    let mut actors = Vec::new();
    for entry in std::fs::read_dir(folder)? {
        let path = entry?.path();
        if path.extension().is_some_and(|extension| extension == "onnx") {
            actors.push(path.canonicalize()?);
        }
    }
    actors.sort();
    let mut list = String::from("/// Name and bytes of each actor.\nstatic ACTORS: &[(&str, &[u8])] = &[\n");
    for path in &actors {
        let name = path.file_name().ok_or("a file without a name")?;
        writeln!(list, "    ({name:?}, include_bytes!({path:?})),")?;
    }
    list.push_str("];\n");
    std::fs::write(std::path::Path::new(&std::env::var("OUT_DIR")?).join(file), list)?;
    Ok(())
}
