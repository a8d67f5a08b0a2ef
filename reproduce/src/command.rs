//! The command line that makes a report, or one of its figures, again.
//!
//! What says where on this machine (`--out`, `--write-docs`) and how to print it is left out: a command is for whoever reads the report.

use clap::ValueEnum;

use crate::args::{BLOCKED, ReproduceArgs};
use crate::figures::Room;

/// The command that makes the same report.
pub fn of_report(args: &ReproduceArgs) -> String {
    let what = args.what.to_possible_value().map_or(String::new(), |value| value.get_name().to_owned());
    let rooms = match &args.scenario {
        Some(file) => Some(("scenario", file.clone())),
        None => (!args.mode.is_empty()).then(|| ("mode", args.mode.join(","))),
    };
    let finished = if args.finished { " --finished" } else { "" };
    begun(&what) + &flags(args, rooms.as_ref().map(|(flag, value)| (*flag, value.as_str()))) + finished
}

/// The command that makes one figure in one room, and computes what is missing of it.
pub fn of_figure(id: &str, room: &Room) -> String {
    begun(id) + &room.flags
}

fn begun(what: &str) -> String {
    format!("heliostat reproduce {what} --out DIR")
}

/// The flags on which a figure depends, with the one that names its room or all rooms.
pub(crate) fn flags(args: &ReproduceArgs, rooms: Option<(&str, &str)>) -> String {
    let mut flags = String::new();
    let mut add = |flag: &str, value: &str| flags.push_str(&format!(" --{flag} {}", quoted(value)));
    rooms.into_iter().for_each(|(flag, value)| add(flag, value));
    args.overrides.iter().for_each(|text| add("set", text));
    let mut number = |flag: &str, value: Option<u64>| value.into_iter().for_each(|value| add(flag, &value.to_string()));
    number("seeds", args.seeds);
    number("training-seeds", args.training_seeds);
    number("episodes", args.episodes.map(u64::from));
    number("seed", (args.seed != 1).then_some(args.seed));
    if args.blocked != BLOCKED {
        add("blocked", &args.blocked.iter().map(usize::to_string).collect::<Vec<_>>().join(","));
    }
    for (given, flag) in [(args.quick, " --quick"), (args.train_missing, " --train-missing")] {
        flags.push_str(if given { flag } else { "" });
    }
    flags
}

/// A word as a shell takes it back unchanged.
fn quoted(word: &str) -> String {
    let plain = |letter: char| letter.is_alphanumeric() || "-_./,=:+".contains(letter);
    if !word.is_empty() && word.chars().all(plain) { word.into() } else { format!("'{}'", word.replace('\'', r"'\''")) }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CHANGED: &str = "--set users.count=6 --set mirrors.rows=8 --seeds 4 --training-seeds 2 --episodes 7 --seed 3 --blocked 0,6 --quick";

    #[test]
    fn a_report_s_command_is_the_one_that_was_given() {
        for given in ["--mode paper,specular", "--scenario hall.toml", "--finished", "--train-missing"] {
            let args = ReproduceArgs::of_command(&format!("heliostat reproduce all --out DIR {given} {CHANGED}"));
            assert_eq!(format!("{:?}", ReproduceArgs::of_command(&of_report(&args))), format!("{args:?}"));
        }
        assert_eq!(
            of_report(&ReproduceArgs::of_command("heliostat reproduce map --out /tmp --json")),
            "heliostat reproduce map --out DIR"
        );
    }

    #[test]
    fn a_figure_s_command_names_its_room_and_keeps_every_other_flag() {
        let all = ReproduceArgs::of_command(&format!(
            "heliostat reproduce all --out DIR --mode paper,specular --train-missing {CHANGED}"
        ));
        let one = ReproduceArgs::of_command(&format!(
            "heliostat reproduce map --out DIR --mode specular --train-missing {CHANGED}"
        ));
        let command = of_figure("map", &all.rooms().unwrap()[1]);
        assert_eq!(format!("{:?}", ReproduceArgs::of_command(&command)), format!("{one:?}"));
    }

    #[test]
    fn a_scenario_file_is_named_as_one() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("hall.toml").display().to_string();
        std::fs::write(&file, heliostat_scenario::Scenario::builtin_text("specular").unwrap()).unwrap();
        let args =
            ReproduceArgs::of_command(&format!("heliostat reproduce all --out DIR --scenario {file} --finished"));
        let command = of_figure("inference", &args.rooms().unwrap()[0]);
        assert_eq!(command, format!("heliostat reproduce inference --out DIR --scenario {file}"));
    }

    #[test]
    fn a_shell_takes_words_back_unchanged() {
        assert_eq!(["users.count=3", "a b=[1]", "it's"].map(quoted), ["users.count=3", "'a b=[1]'", r"'it'\''s'"]);
    }
}
