//! The files that a calibration writes: new ones for its results, each for one purpose and for one process.

use std::path::Path;

use anyhow::Result;
use heliostat_service::exit::unusable;
use heliostat_service::whole_file::{self, Held};

use super::args::Args;

/// Holds the files until the process ends.
///
/// # Errors
/// [`UnusableInput`](heliostat_service::exit::UnusableInput): a result that exists already, a file that cannot be
/// written, that has two purposes, or that another process writes.
pub fn hold(args: &Args) -> Result<Vec<Held>> {
    let results = [args.out.as_ref(), args.room_out.as_ref()];
    results.into_iter().flatten().try_for_each(|file| whole_file::check_new(file)).map_err(unusable)?;
    check_distinct(args)?;
    let files = results.into_iter().chain([args.readings.as_ref()]).flatten();
    let held =
        files.map(|file| whole_file::check_writable(file).and_then(|()| whole_file::hold(file)).map_err(unusable));
    held.collect()
}

/// Refuses one file for two purposes.
fn check_distinct(args: &Args) -> Result<()> {
    let base = args.base.as_ref().filter(|file| file.as_path() != Path::new("none"));
    let named = [
        ("--out", args.out.as_ref()),
        ("--room-out", args.room_out.as_ref()),
        ("--readings", args.readings.as_ref()),
        ("--refine", args.refine.as_ref()),
        ("--base", base),
    ];
    whole_file::check_distinct(named)
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Parser)]
    struct Command {
        #[command(flatten)]
        args: Args,
    }

    #[test]
    fn a_file_with_two_purposes_or_of_two_calibrations_is_refused() {
        let folder = tempfile::tempdir().expect("a folder");
        std::fs::create_dir(folder.path().join("inner")).expect("a folder");
        let hold_with = |out: &str, readings: &str| {
            let [out, readings] = [out, readings].map(|name| folder.path().join(name).display().to_string());
            let flags = ["calibrate", "--out", &out, "--readings", &readings];
            hold(&Command::try_parse_from(flags).expect("valid flags").args)
        };
        let refusal = |out: &str, readings: &str| hold_with(out, readings).expect_err("refused").to_string();
        assert!(refusal("one.toml", "inner/../one.toml").contains("--out and --readings name one file"));
        let held = hold_with("one.toml", "readings.json").expect("free");
        assert!(refusal("other.toml", "readings.json").contains("readings.json is in use by another process"));
        assert!(refusal("one.toml", "others.json").contains("one.toml is in use by another process"));
        drop(held);
        hold_with("one.toml", "readings.json").expect("free again");
        std::fs::write(folder.path().join("one.toml"), "").expect("writable");
        assert!(refusal("one.toml", "readings.json").contains("exists already: expected a new file"));
    }
}
