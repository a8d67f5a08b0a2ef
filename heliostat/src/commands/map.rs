//! `heliostat map`: what the floor gets, as a heat map.

use std::path::PathBuf;

use anyhow::{Context, Result, bail, ensure};
use clap::ValueEnum;
use heliostat_channel::blockage::Cylinder;
use heliostat_channel::mirrors::MirrorAngles;
use heliostat_channel::scene::Scene;
use heliostat_channel::solver::{Method, Need, Solver};
use heliostat_channel::{ChannelModel, Vec3, decode};
use heliostat_scenario::{Scenario, ScenarioArgs};
use heliostat_sim_node::world::World;
use plotters::prelude::*;

/// Draw the rate, SINR or coverage over the floor as an SVG heat map.
///
/// Circles are obstacles and bodies, red crosses users, the blue line the mirrors.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    scenario: ScenarioArgs,
    /// What to draw
    #[arg(long, value_enum, default_value = "rate")]
    what: Quantity,
    /// Mirror angles: none (no array), flat, aim:X,Y (all at one point), nearest or oracle (for the users as they stand)
    #[arg(long, value_name = "HOW", default_value = "oracle", allow_hyphen_values = true)]
    array: String,
    /// Let the users walk for this long first, in s
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

/// A quantity over the floor.
#[derive(Clone, Copy, Debug, ValueEnum)]
enum Quantity {
    /// Rate of one user of the scenario's K, in Mbit/s
    Rate,
    /// SINR in dB
    Sinr,
    /// Whether the minimum rate is met
    Coverage,
}

impl Quantity {
    fn label(self) -> &'static str {
        match self {
            Self::Rate => "rate (Mbit/s)",
            Self::Sinr => "SINR (dB)",
            Self::Coverage => "minimum rate met (1) or not (0)",
        }
    }
}

/// SINR below this is drawn as this: a point in full shadow has no SINR in dB.
const SINR_FLOOR_DB: f64 = -20.0;

/// Runs the command.
pub fn run(args: Args) -> Result<()> {
    let scenario = args.scenario.load()?;
    ensure!((0.5..=100.0).contains(&args.step_cm), "--step-cm {}: wanted 0.5 to 100", args.step_cm);
    ensure!((0.0..=3600.0).contains(&args.at_seconds), "--at-seconds {}: wanted 0 to 3600", args.at_seconds);
    let mut world = World::new(&scenario, scenario.seed)?;
    world.step(args.at_seconds);
    let angles = array_angles(&args.array, &scenario, &world)?;
    let map = Map::compute(&args, &scenario, &world, angles.as_ref());
    draw(&args, &scenario, &world, &map).with_context(|| format!("cannot draw {}", args.out.display()))?;
    if args.json {
        let summary = serde_json::json!({
            "file": args.out, "what": args.what.label(), "array": args.array, "scenario": scenario.name,
            "min": map.min(), "mean": map.mean(), "max": map.max(), "points": map.values.len(),
        });
        println!("{summary}");
    } else {
        let (what, file) = (args.what.label(), args.out.display());
        println!("{file}: {what} from {:.3} to {:.3}, mean {:.3}", map.min(), map.max(), map.mean());
    }
    Ok(())
}

fn array_angles(how: &str, scenario: &Scenario, world: &World) -> Result<Option<MirrorAngles>> {
    let (model, scene) = (world.model(), world.scene());
    let mut angles = MirrorAngles::flat(model.mirrors.len());
    match how {
        "none" => return Ok(None),
        "flat" => {}
        "nearest" => decode::decode(model, scene, &vec![1.0; scene.users()], &mut angles),
        "oracle" => {
            let min_rate_bps = scenario.min_rate_bps();
            let need = Need { min_rate_bps: &min_rate_bps, qos_penalty: 0.0 };
            Solver::new(scene.users(), angles.roll.len()).solve(model, scene, &need, Method::Oracle, &mut angles);
        }
        _ => {
            let point = how.strip_prefix("aim:").and_then(|text| text.split_once(','));
            let point = point.and_then(|(x, y)| Some((x.trim().parse().ok()?, y.trim().parse().ok()?)));
            let Some((x, y)) = point else {
                bail!("--array {how}: wanted none, flat, nearest, oracle or aim:X,Y in metres");
            };
            decode::aim_at_point(model, &Vec3::new(x, y, scenario.receiver.height_m), &mut angles);
        }
    }
    Ok(Some(angles))
}

/// Values over a grid of the floor, row by row from the smallest y.
struct Map {
    columns: usize,
    rows: usize,
    values: Vec<f64>,
}

impl Map {
    fn compute(args: &Args, scenario: &Scenario, world: &World, angles: Option<&MirrorAngles>) -> Self {
        let step_m = args.step_cm * 1e-2;
        let columns = (scenario.room.length_x_m / step_m).round().max(1.0) as usize;
        let rows = (scenario.room.length_y_m / step_m).round().max(1.0) as usize;
        // The map shows a visitor's detector: obstacles and the users' bodies block its light, a body of its own does not.
        let blockers: Vec<Cylinder> = world.blockers().to_vec();
        let model = world.model();
        let mut scene = Scene::new(model, 1);
        let values = (0..rows * columns)
            .map(|index| {
                let x = ((index % columns) as f64 + 0.5) / columns as f64 - 0.5;
                let y = ((index / columns) as f64 + 0.5) / rows as f64 - 0.5;
                let place =
                    Vec3::new(x * scenario.room.length_x_m, y * scenario.room.length_y_m, scenario.receiver.height_m);
                scene.update(model, &[place], &blockers, &[false]);
                value(args.what, scenario, model, &scene, angles)
            })
            .collect();
        Self { columns, rows, values }
    }

    fn min(&self) -> f64 {
        self.values.iter().copied().fold(f64::INFINITY, f64::min)
    }

    fn max(&self) -> f64 {
        self.values.iter().copied().fold(f64::NEG_INFINITY, f64::max)
    }

    fn mean(&self) -> f64 {
        self.values.iter().sum::<f64>() / self.values.len() as f64
    }
}

fn value(
    what: Quantity,
    scenario: &Scenario,
    model: &ChannelModel,
    scene: &Scene,
    angles: Option<&MirrorAngles>,
) -> f64 {
    let mut sinr = [0.0];
    match angles {
        Some(angles) => scene.sinr(model, angles, &mut sinr),
        None => sinr[0] = model.budget.sinr(scene.los_gain()[0]),
    }
    let rate = model.budget.rate_bps(sinr[0], scenario.users.count);
    match what {
        Quantity::Rate => rate * 1e-6,
        Quantity::Sinr => (10.0 * sinr[0].max(f64::MIN_POSITIVE).log10()).max(SINR_FLOOR_DB),
        Quantity::Coverage => f64::from(u8::from(rate >= scenario.min_rate_bps()[0])),
    }
}

/// Viridis at a position from 0 to 1: even steps to the eye, readable without colour vision.
fn colour(position: f64) -> RGBColor {
    ViridisRGB::get_color(position.clamp(0.0, 1.0))
}

fn draw(args: &Args, scenario: &Scenario, world: &World, map: &Map) -> Result<()> {
    let (half_x, half_y) = (scenario.room.length_x_m / 2.0, scenario.room.length_y_m / 2.0);
    let (low, high) = (map.min(), map.max());
    let span = if high > low { high - low } else { 1.0 };
    let root = SVGBackend::new(&args.out, (760, 640)).into_drawing_area();
    root.fill(&WHITE)?;
    let (left, right) = root.split_horizontally(640);
    let title = format!("{} - array {} - {}", args.what.label(), args.array, scenario.name);
    let mut chart = ChartBuilder::on(&left)
        .margin(10)
        .caption(title, ("sans-serif", 18))
        .x_label_area_size(40)
        .y_label_area_size(50)
        .build_cartesian_2d(-half_x..half_x, -half_y..half_y)?;
    chart.configure_mesh().disable_mesh().x_desc("x (m)").y_desc("y (m)").draw()?;
    let (width, height) = (2.0 * half_x / map.columns as f64, 2.0 * half_y / map.rows as f64);
    chart.draw_series(map.values.iter().enumerate().map(|(index, value)| {
        let x = (index % map.columns) as f64 * width - half_x;
        let y = (index / map.columns) as f64 * height - half_y;
        Rectangle::new([(x, y), (x + width, y + height)], colour((value - low) / span).filled())
    }))?;
    let circle = |cylinder: &Cylinder| -> Vec<(f64, f64)> {
        let turn = |step: i32| std::f64::consts::TAU * f64::from(step) / 32.0;
        let at = |angle: f64| {
            (cylinder.x_m + cylinder.radius_m * angle.cos(), cylinder.y_m + cylinder.radius_m * angle.sin())
        };
        (0..=32).map(|step| at(turn(step))).collect()
    };
    chart.draw_series(
        world.blockers().iter().map(|cylinder| PathElement::new(circle(cylinder), BLACK.stroke_width(2))),
    )?;
    chart.draw_series(
        world.users().iter().map(|user| Cross::new((user.position.x, user.position.y), 5, RED.stroke_width(2))),
    )?;

    let mirrors = &world.model().mirrors;
    let foot = |index: usize| (mirrors.positions()[index].x, mirrors.positions()[index].y);
    let wall = vec![foot(0), foot(mirrors.columns() - 1)];
    chart.draw_series([PathElement::new(wall, BLUE.stroke_width(8))])?;

    let mut bar = ChartBuilder::on(&right)
        .margin(10)
        .margin_top(40)
        .margin_bottom(50)
        .y_label_area_size(45)
        .build_cartesian_2d(0.0..1.0, low..low + span)?;
    bar.configure_mesh()
        .disable_mesh()
        .disable_x_axis()
        .y_label_style(("sans-serif", 13))
        .y_desc(args.what.label())
        .draw()?;
    bar.draw_series((0..128).map(|step| {
        let (from, to) = (f64::from(step) / 128.0, f64::from(step + 1) / 128.0);
        Rectangle::new([(0.0, low + from * span), (1.0, low + to * span)], colour(from).filled())
    }))?;
    root.present()?;
    Ok(())
}
