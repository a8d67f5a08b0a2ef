//! Lists the actors in `lab/actors`, so that they are built into the laboratory.

include!("../../models/list_actors.rs");

fn main() -> Result<(), Box<dyn std::error::Error>> {
    list_actors(&std::path::Path::new(&std::env::var("CARGO_MANIFEST_DIR")?).join("../actors"), "actors.rs")
}
