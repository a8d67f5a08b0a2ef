//! `heliostat-lab map`: a quantity over the floor as a heat map.

mod picture;
mod quantity;

use std::path::PathBuf;

use anyhow::{Context, Result, ensure};
use heliostat_channel::ChannelModel;
use heliostat_channel::mirrors::MirrorAngles;
use heliostat_channel::scene::Scene;
use heliostat_reproduce::over_floor::over_floor;
use heliostat_room::World;
use heliostat_scenario::{Scenario, ScenarioArgs};

use heliostat::commands::mirrors::Instant;
use heliostat_service::counted::counted;
use heliostat_service::whole_file;
use heliostat_service::{exit, outln};
use picture::Picture;
use quantity::Quantity;

/// Draw the rate, SINR or coverage over the floor as an SVG heat map.
///
/// The map shows the value for one additional detector at each point. Obstacles and the bodies of
/// the users block its light; it has no body of its own. A legend under the map explains the
/// symbols.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    scenario: ScenarioArgs,
    /// The quantity to draw
    #[arg(long, value_enum, default_value = "rate")]
    what: Quantity,
    /// Mirror angles: none (no array), aim:X,Y or aim:X,Y,Z (all at one point), user:N, oracle, a
    /// policy (such as flat, nearest, greedy or ddpg) or an ONNX actor (FILE.onnx) for the users of
    /// the scenario, or a CSV with the header roll_deg,yaw_deg
    #[arg(
        long,
        value_name = "HOW|FILE",
        default_value = "oracle",
        visible_alias = "angles",
        allow_hyphen_values = true
    )]
    array: String,
    /// Time in s that the users walk before the map is computed
    #[arg(long, default_value_t = 0.0)]
    at_seconds: f64,
    /// Distance between points of the map in cm
    #[arg(long, default_value_t = 5.0)]
    step_cm: f64,
    /// The file to write (SVG)
    #[arg(long, default_value = "map.svg")]
    out: PathBuf,
    /// Print the map's figures as one JSON object
    #[arg(long)]
    json: bool,
}

/// Largest number of points of a map.
const POINTS_MAX: f64 = 4e6;

/// Lower limit of the SINR on the map: a point without light has no SINR in dB.
const SINR_FLOOR_DB: f64 = -20.0;

impl Args {
    /// Refuses values that no map has.
    fn check(&self, scenario: &Scenario) -> Result<()> {
        ensure!((0.5..=100.0).contains(&self.step_cm), "--step-cm {}: expected 0.5 to 100", self.step_cm);
        let (room, step_m) = (&scenario.room, self.step_cm * 1e-2);
        let points = room.length_x_m / step_m * (room.length_y_m / step_m);
        ensure!(
            points <= POINTS_MAX,
            "--step-cm {}: {points:.0} points in this room; expected at most {POINTS_MAX}, use a larger step",
            self.step_cm
        );
        ensure!((0.0..=3600.0).contains(&self.at_seconds), "--at-seconds {}: expected 0 to 3600", self.at_seconds);
        let svg = self.out.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("svg"));
        ensure!(svg, "--out {}: expected a name that ends in .svg", self.out.display());
        Ok(())
    }
}

/// Runs the command.
pub fn run(args: Args) -> Result<()> {
    let scenario = args.scenario.load_arrays()?;
    args.check(&scenario).map_err(exit::unusable)?;
    whole_file::check_writable(&args.out)?;
    let mut world = World::new(&scenario, scenario.read_trace()?.as_deref(), scenario.seed)?;
    world.step(args.at_seconds);
    let instant = Instant::new(&scenario, world.model(), world.positions(), world.blockers(), world.forced());
    let angles = instant.angles(&args.array).map_err(exit::unusable)?;
    let mut evaluate = |scene: &Scene| value(args.what, &scenario, world.model(), scene, &angles);
    let map = over_floor(&scenario, &world, args.step_cm * 1e-2, &mut evaluate);
    let picture = Picture { quantity: args.what, mirrors: &args.array, scenario: &scenario, world: &world, map: &map };
    let (svg, pixels_per_m) = picture.draw().with_context(|| format!("cannot draw {}", args.out.display()))?;
    whole_file::write(&args.out, svg.as_bytes())?;
    let ([min, max], mean) = (map.range(), map.mean());
    if args.json {
        let summary = serde_json::json!({
            "file": args.out, "what": args.what.label(), "array": args.array, "scenario": scenario.name,
            "min": min, "mean": mean, "max": max, "points": map.values.len(), "pixels_per_m": pixels_per_m,
        });
        outln!("{summary}")?;
    } else {
        let (what, file) = (args.what.label(), args.out.display());
        // A rate depends on how many users share the bandwidth, a SINR does not.
        let sharing = match args.what {
            Quantity::Rate | Quantity::Coverage => {
                format!(", one of {} on the bandwidth", counted(scenario.users.count, "user"))
            }
            Quantity::Sinr => String::new(),
        };
        outln!(
            "{file}: {what}{sharing}, from {min:.3} to {max:.3}, mean {mean:.3}; {pixels_per_m:.1} pixels a metre on both axes"
        )?;
    }
    instant.note_upright();
    Ok(())
}

fn value(what: Quantity, scenario: &Scenario, model: &ChannelModel, scene: &Scene, angles: &MirrorAngles) -> f64 {
    let mut sinr = [0.0];
    scene.sinr(model, angles, &mut sinr);
    let rate = model.budget.rate_bps(sinr[0], scenario.users.count);
    match what {
        Quantity::Rate => rate * 1e-6,
        Quantity::Sinr => (10.0 * sinr[0].max(f64::MIN_POSITIVE).log10()).max(SINR_FLOOR_DB),
        Quantity::Coverage => f64::from(u8::from(rate >= scenario.min_rate_bps()[0])),
    }
}
