//! The rate of one additional user at each point of the floor, without and with the array.

use std::f64::consts::TAU;

use anyhow::{Result, ensure};
use heliostat_channel::{Cylinder, MirrorAngles, MirrorArray};
use heliostat_learn::comparison::EvaluatedPolicy;
use heliostat_models::ActorSource;
use heliostat_room::World;
use heliostat_scenario::Scenario;

use super::finished_parts::Done;
use crate::figure::{Axis, Figure, Panel, Point, Series};
use crate::job::{Job, Map};
use crate::over_floor::over_floor;
use crate::part::{Measured, Part};
use crate::plan::{Plan, Room};

/// The id on the command line.
pub const ID: &str = "map";

/// The policies: no array, and the controller's default.
const POLICIES: [&str; 2] = ["no-irs", "ddpg"];

/// Time that the users walk before the snapshot, in s.
const SETTLE_S: f64 = 20.0;

pub(super) fn parts(room: &Room, plan: &Plan) -> Result<Vec<Part>> {
    ensure!(room.scenario.users.count > 0, "{ID} needs a user in room {}", room.name);
    let step_cm = plan.effort.step_cm;
    let (job, cost_s) = (Job::Map(Map { step_cm }), 50.0 / (step_cm * step_cm));
    Ok(vec![room.part([ID, env!("HELIOSTAT_CODE_MAP")], ("floor".into(), plan.first_seed), job, cost_s)])
}

impl Map {
    /// The floor for each policy, with the objects in the room.
    pub(crate) fn run(&self, scenario: &Scenario, actor: &ActorSource) -> Result<Measured> {
        let mut world = World::new(scenario, scenario.read_trace()?.as_deref(), scenario.seed)?;
        world.step(SETTLE_S);
        let mut floors = Vec::new();
        for name in POLICIES {
            let angles: MirrorAngles = EvaluatedPolicy::parse(name, actor)?.angles(scenario, &world)?;
            let mut floor = over_floor(scenario, &world, 1e-2 * self.step_cm, &mut |scene| {
                let mut sinr = [0.0];
                scene.sinr(world.model(), &angles, &mut sinr);
                1e-6 * world.model().budget.rate_bps(sinr[0], scenario.users.count)
            });
            // Rounded to limit the file size.
            floor.values.iter_mut().for_each(|value| *value = (*value * 1e3).round() * 1e-3);
            floor.label = "rate (Mbit/s)".into();
            floors.push((floor, symbols(&world)));
        }
        Ok(Measured { floors, ..Measured::default() })
    }
}

/// The objects in the room.
fn symbols(world: &World) -> Vec<Series> {
    let point = |x: f64, y: f64| Point { x, y, ci95: None, x_ci95: None };
    let outline = |cylinder: &Cylinder| {
        let at = |step: i32| {
            let (sin, cos) = (TAU * f64::from(step) / 24.0).sin_cos();
            point(cylinder.x_m + cylinder.radius_m * cos, cylinder.y_m + cylinder.radius_m * sin)
        };
        Series { name: "obstacle or body".into(), points: (0..=24).map(at).collect() }
    };
    let mirrors = &world.model().mirrors;
    let foot = |array: &MirrorArray, column: usize| point(array.positions()[column].x, array.positions()[column].y);
    let mut symbols: Vec<Series> = world.blockers().iter().map(outline).collect();
    for array in mirrors.arrays() {
        symbols.push(Series { name: "mirrors".into(), points: vec![foot(array, 0), foot(array, array.columns() - 1)] });
    }
    let users = world.positions().iter().map(|position| point(position.x, position.y)).collect();
    symbols.push(Series { name: "user".into(), points: users });
    symbols
}

pub(super) fn figure(room: &Room, done: &[Done]) -> Figure {
    let titles = ["without the array", "with the array, policy ddpg"];
    let floors = done.iter().flat_map(|(_, finished)| &finished.measured.floors);
    let panel = |(title, (floor, symbols)): (&str, &(_, Vec<Series>))| {
        let floor: &crate::figure::Floor = floor;
        Panel {
            title: format!("{title}: mean {:.2} Mbit/s", floor.mean()),
            series: symbols.clone(),
            quoted: Vec::new(),
            floor: Some(floor.clone()),
        }
    };
    let (seed, forced) = (done.first().map_or(0, |(part, _)| part.seed), room.scenario.blockage.forced_users);
    Figure {
        title: "Rate over the floor".into(),
        caption: vec![
            format!(
                "The rate of one additional detector at each point, with the bandwidth share of each of {} users. Obstacles and the bodies of the users block its \
                 light. The mirrors serve the users at their positions. One room, seed {seed}: an example, not a statistic.",
                room.scenario.users.count
            ),
            if forced > 0 {
                format!("The direct paths of {forced} users are blocked; that of the additional detector is not.")
            } else {
                "No user's direct path is blocked by force.".into()
            },
        ],
        x: Axis::linear("x (m)"),
        y: Axis::linear("y (m)"),
        panels: titles.into_iter().zip(floors).map(panel).collect(),
        ..Figure::default()
    }
}
