//! The command line, and the checks before long computations.

use std::path::PathBuf;

use anyhow::{Result, bail, ensure};
use clap::ValueEnum;
use heliostat_files::shell_word;
use heliostat_models::ActorSource;
use heliostat_scenario::ScenarioArgs;

use crate::command;
use crate::effort::Effort;
use crate::figures::Kind;
use crate::plan::{Plan, Room};
use crate::report::LeftOut;

/// Reproduce the figures of the paper, with a verdict for each of its statements.
///
/// Writes report.md, and SVG, CSV and JSON files for each figure. Finished parts
/// are stored in DIR/parts: an interrupted run continues, and only parts with changed inputs are
/// computed again.
#[derive(Debug, clap::Args)]
pub struct ReproduceArgs {
    /// The figure
    #[arg(value_enum)]
    pub what: What,
    /// The output folder; finished parts in it are reused
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Built-in scenarios, separated by commas [default: specular, paper, paper-calibrated]
    #[arg(long, value_name = "MODE,..", value_delimiter = ',')]
    pub mode: Vec<String>,
    /// A scenario file (TOML) instead of the built-in scenarios
    #[arg(long, value_name = "FILE", conflicts_with = "mode")]
    pub scenario: Option<String>,
    /// Override a key of every scenario, for example --set users.count=3 (repeatable)
    #[arg(long = "set", value_name = "TABLE.KEY=VALUE")]
    pub overrides: Vec<String>,
    /// A short run of a few minutes: fewer seeds, states and episodes
    #[arg(long)]
    pub quick: bool,
    /// Number of seeds of computations without training [default: 10, quick 2]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=1000))]
    pub seeds: Option<u64>,
    /// Number of seeds of training runs and timings [default: 3, quick 1]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=100))]
    pub training_seeds: Option<u64>,
    /// Episodes of each training run [default: 300, quick 25; the paper: 1000]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    pub episodes: Option<u32>,
    /// The first seed
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,
    /// Numbers of blocked users in sum-rate-power and outage
    #[arg(long, value_name = "B,..", value_delimiter = ',', default_values_t = BLOCKED)]
    pub blocked: Vec<usize>,
    /// Report the finished parts only, and list the missing ones
    #[arg(long)]
    pub finished: bool,
    /// Also write reproduction.json and reproduction.md into this folder
    #[arg(long, value_name = "DIR")]
    pub write_docs: Option<PathBuf>,
    /// Print one JSON object at the end
    #[arg(long)]
    pub json: bool,
}

/// The selection of figures.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum What {
    /// Sum rate against iterations of training (Fig. 4)
    SumRateIterations,
    /// Sum rate against optical power, by number of blocked users (Fig. 5)
    SumRatePower,
    /// Bit error rate against SNR, by walking speed (Fig. 6)
    BerSnr,
    /// Decision time, compared with methods that search
    Inference,
    /// Time below the minimum rate, long outages and fairness, by number of blocked users
    Outage,
    /// Rate over the floor without and with the array
    Map,
    /// The statements of the paper with verdicts: computes the figures that have one
    Table,
    /// All figures
    All,
}

impl What {
    /// The required figures.
    pub fn kinds(self) -> Vec<Kind> {
        match self {
            Self::SumRateIterations => vec![Kind::SumRateIterations],
            Self::SumRatePower => vec![Kind::SumRatePower],
            Self::BerSnr => vec![Kind::BerSnr],
            Self::Inference => vec![Kind::Inference],
            Self::Outage => vec![Kind::Outage],
            Self::Map => vec![Kind::Map],
            Self::Table => Kind::ALL.into_iter().filter(|kind| kind.is_in_the_paper()).collect(),
            Self::All => Kind::ALL.to_vec(),
        }
    }
}

/// The selected figures, each with its room, and the omitted ones.
pub type Choice<'a> = (Vec<(Kind, &'a Room)>, Vec<LeftOut>);

/// The numbers of blocked users when none are given.
pub(crate) const BLOCKED: [usize; 4] = [0, 2, 3, 5];

/// The default rooms.
const ROOMS: [&str; 3] = ["specular", "paper", "paper-calibrated"];

impl ReproduceArgs {
    /// The sizes of the run.
    pub fn effort(&self) -> Effort {
        let effort = if self.quick { Effort::quick() } else { Effort::full() };
        Effort {
            seeds: self.seeds.unwrap_or(effort.seeds),
            training_seeds: self.training_seeds.unwrap_or(effort.training_seeds),
            episodes: self.episodes.map_or(effort.episodes, |count| count as usize),
            evaluations: effort.evaluations.min(self.episodes.map_or(effort.evaluations, |count| count as usize)),
            ..effort
        }
    }

    /// The parameters of all figures.
    pub fn plan(&self, effort: Effort) -> Plan {
        let mut blocked = self.blocked.clone();
        blocked.sort_unstable();
        blocked.dedup();
        Plan { effort, first_seed: self.seed, blocked }
    }

    /// The rooms, each with the source of its actor.
    ///
    /// # Errors
    /// An unreadable or invalid scenario, or two rooms with the same name.
    pub fn rooms(&self) -> Result<Vec<Room>> {
        let names: Vec<String> = match (&self.scenario, self.mode.is_empty()) {
            (Some(file), _) => vec![file.clone()],
            (None, true) => ROOMS.map(String::from).to_vec(),
            (None, false) => self.mode.clone(),
        };
        let flag = if self.scenario.is_some() { "scenario" } else { "mode" };
        let mut rooms: Vec<Room> = Vec::new();
        for given in names {
            let flags = flags(self, Some((flag, &given)));
            let arguments = ScenarioArgs { scenario: given, overrides: self.overrides.clone(), seed: Some(self.seed) };
            let scenario = arguments.load()?;
            let name = scenario.name.clone();
            ensure!(rooms.iter().all(|room| room.name != name), "--mode names {name} twice");
            let actor = ActorSource::Shipped;
            rooms.push(Room { name, scenario, actor, flags });
        }
        Ok(rooms)
    }

    /// The figures for each room, and those that do not apply to a room.
    ///
    /// # Errors
    /// A figure and a room that were both given explicitly, and do not match.
    pub fn choose<'a>(&self, rooms: &'a [Room]) -> Result<Choice<'a>> {
        let kinds = self.what.kinds();
        let named = kinds.len() == 1 && (self.scenario.is_some() || !self.mode.is_empty());
        let (mut chosen, mut left_out) = (Vec::new(), Vec::new());
        for kind in kinds {
            for room in rooms {
                match kind.not_applicable(room) {
                    None => chosen.push((kind, room)),
                    Some(why) if named => bail!("no {} in room {}: {why}", kind.id(), room.name),
                    Some(why) => left_out.push(LeftOut { figure: kind.id().into(), room: room.name.clone(), why }),
                }
            }
        }
        Ok((chosen, left_out))
    }
}

/// The command that reproduces a report.
pub fn command_of_report(args: &ReproduceArgs) -> String {
    let what = args.what.to_possible_value().map_or(String::new(), |value| value.get_name().to_owned());
    let rooms = match &args.scenario {
        Some(file) => Some(("scenario", file.clone())),
        None => (!args.mode.is_empty()).then(|| ("mode", args.mode.join(","))),
    };
    let finished = if args.finished { " --finished" } else { "" };
    command::begun(&what) + &flags(args, rooms.as_ref().map(|(flag, value)| (*flag, value.as_str()))) + finished
}

/// The flags that a figure depends on, with the one for its room or for all rooms.
fn flags(args: &ReproduceArgs, rooms: Option<(&str, &str)>) -> String {
    let mut flags = String::new();
    let mut add = |flag: &str, value: &str| flags.push_str(&format!(" --{flag} {}", shell_word(value)));
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
    if args.quick {
        flags.push_str(" --quick");
    }
    flags
}

#[cfg(test)]
impl ReproduceArgs {
    /// The flags of a command line without quotes, from "heliostat" on.
    pub(crate) fn of_command(command: &str) -> Self {
        use clap::{Args, Command, FromArgMatches};
        let matches = Self::augment_args(Command::new("reproduce")).get_matches_from(command.split(' ').skip(1));
        Self::from_arg_matches(&matches).expect("a command line of a test")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::command::of_figure;

    const CHANGED: &str = "--set users.count=6 --set mirrors.rows=8 --seeds 4 --training-seeds 2 --episodes 7 --seed 3 --blocked 0,6 --quick";

    #[test]
    fn the_command_of_a_report_is_the_given_one() {
        for given in ["--mode paper,specular", "--scenario hall.toml", "--finished"] {
            let args = ReproduceArgs::of_command(&format!("heliostat-lab reproduce all --out DIR {given} {CHANGED}"));
            assert_eq!(format!("{:?}", ReproduceArgs::of_command(&command_of_report(&args))), format!("{args:?}"));
        }
        assert_eq!(
            command_of_report(&ReproduceArgs::of_command("heliostat-lab reproduce map --out /tmp --json")),
            "heliostat-lab reproduce map --out DIR"
        );
    }

    #[test]
    fn the_command_of_a_figure_names_its_room_and_keeps_the_other_flags() {
        let all = ReproduceArgs::of_command(&format!(
            "heliostat-lab reproduce all --out DIR --mode paper,specular {CHANGED}"
        ));
        let one =
            ReproduceArgs::of_command(&format!("heliostat-lab reproduce map --out DIR --mode specular {CHANGED}"));
        let command = of_figure("map", &all.rooms().unwrap()[1]);
        assert_eq!(format!("{:?}", ReproduceArgs::of_command(&command)), format!("{one:?}"));
    }

    #[test]
    fn a_scenario_file_is_named_as_one() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("hall.toml").display().to_string();
        std::fs::write(&file, heliostat_scenario::Scenario::builtin_text("specular").unwrap()).unwrap();
        let args =
            ReproduceArgs::of_command(&format!("heliostat-lab reproduce all --out DIR --scenario {file} --finished"));
        let command = of_figure("inference", &args.rooms().unwrap()[0]);
        assert_eq!(command, format!("heliostat-lab reproduce inference --out DIR --scenario {file}"));
    }
}
