//! `heliostat link`: the link budget of given users under given mirror angles.

use std::path::Path;

use anyhow::{Context, Result, bail, ensure};
use heliostat_channel::blockage::{Cylinder, blocks};
use heliostat_channel::link::ber_ook;
use heliostat_channel::mirrors::MirrorAngles;
use heliostat_channel::scene::Scene;
use heliostat_channel::solver::{Method, Need, Solver};
use heliostat_channel::{ChannelModel, Vec3, decode};
use heliostat_scenario::{MinRate, Scenario, ScenarioArgs};
use serde::{Deserialize, Serialize};

/// The weight of an unmet minimum rate in the oracle with QoS: large enough that a need is met wherever it can be.
const QOS_PENALTY: f64 = 50.0;

/// Compute the link budget of users at given positions under given mirror angles.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    scenario: ScenarioArgs,
    /// CSV of users with the header x,y,z in m; optional columns heading_deg (places the user's body behind the device)
    #[arg(long, value_name = "FILE", required_unless_present = "user")]
    users: Option<String>,
    /// A user at X,Y or X,Y,Z in m; Z is the scenario's receiver height when left out (repeatable)
    #[arg(long, value_name = "X,Y[,Z]", allow_hyphen_values = true, conflicts_with = "users")]
    user: Vec<String>,
    /// Mirror angles: flat, oracle (or aimed), nearest, user:N (all at user N, counted from 0), or a CSV with the header roll_deg,yaw_deg, one line a mirror in index order
    #[arg(long, value_name = "HOW|FILE", default_value = "oracle")]
    angles: String,
    /// Obstacles: none, seed (drawn from the scenario's seed), or a CSV with the header x,y,radius,height in m
    #[arg(long, value_name = "HOW|FILE", default_value = "none")]
    obstacles: String,
    /// List the gain of each mirror to each user
    #[arg(long)]
    per_mirror: bool,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

/// One user's link.
#[derive(Debug, Serialize)]
struct UserLink {
    position_m: [f64; 3],
    los_gain: f64,
    irs_gain: f64,
    sinr: f64,
    sinr_db: f64,
    rate_mbps: f64,
    min_rate_mbps: f64,
    ber: f64,
    los_blocked: bool,
    los_blocked_by: Vec<String>,
    mirrors_blocked: usize,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    mirror_gain: Vec<f64>,
}

/// The whole answer.
#[derive(Debug, Serialize)]
struct LinkBudgetReport {
    scenario: String,
    mode: &'static str,
    angles: String,
    noise_variance_a2: f64,
    users: Vec<UserLink>,
    sum_rate_mbps: f64,
    oracle_sum_rate_mbps: f64,
    oracle_qos_sum_rate_mbps: f64,
}

/// Runs the command.
pub fn run(args: Args) -> Result<()> {
    let mut scenario = args.scenario.load()?;
    let rows = user_rows(&args, &scenario)?;
    set_user_count(&mut scenario, rows.len())?;
    let model = scenario.channel_model()?;
    let users: Vec<Vec3> = rows.iter().map(|row| row.position(&scenario)).collect();
    let (blockers, names) = blockers(&args, &scenario, &rows)?;
    let forced: Vec<bool> = (0..users.len()).map(|user| user < scenario.blockage.forced_users).collect();
    let mut scene = Scene::new(&model, users.len());
    scene.update(&model, &users, &blockers, &forced);

    let room = LitRoom { scenario: &scenario, model: &model, scene: &scene };
    let angles = room.angles(&args.angles)?;
    let mut report = room.report(&angles, args.per_mirror);
    report.angles = args.angles.clone();
    for (user, link) in report.users.iter_mut().enumerate() {
        if forced[user] {
            link.los_blocked_by.push("forced".into());
        }
        for (blocker, name) in blockers.iter().zip(&names) {
            if model.leds.iter().any(|led| blocks(blocker, &led.position, &users[user])) {
                link.los_blocked_by.push(name.clone());
            }
        }
    }
    if args.json {
        println!("{}", serde_json::to_string(&report)?);
    } else {
        print_table(&report);
    }
    Ok(())
}

/// A line of the users' file.
#[derive(Debug, Deserialize)]
struct UserRow {
    x: f64,
    y: f64,
    z: Option<f64>,
    heading_deg: Option<f64>,
}

impl UserRow {
    fn position(&self, scenario: &Scenario) -> Vec3 {
        Vec3::new(self.x, self.y, self.z.unwrap_or(scenario.receiver.height_m))
    }
}

fn user_rows(args: &Args, scenario: &Scenario) -> Result<Vec<UserRow>> {
    let rows: Vec<UserRow> = match &args.users {
        Some(file) => read_csv(file)?,
        None => args.user.iter().map(|text| parse_user(text)).collect::<Result<_>>()?,
    };
    ensure!(!rows.is_empty(), "no users: give a CSV with at least one line after the header, or --user X,Y");
    let room = &scenario.room;
    for (index, row) in rows.iter().enumerate() {
        let place = row.position(scenario);
        let inside = place.iter().all(|coordinate| coordinate.is_finite())
            && place.x.abs() <= room.length_x_m / 2.0
            && place.y.abs() <= room.length_y_m / 2.0
            && (0.0..room.height_m).contains(&place.z);
        ensure!(
            inside,
            "user {index} at ({}, {}, {}) is outside the room: wanted |x| <= {}, |y| <= {}, 0 <= z < {}",
            place.x,
            place.y,
            place.z,
            room.length_x_m / 2.0,
            room.length_y_m / 2.0,
            room.height_m
        );
    }
    Ok(rows)
}

fn parse_user(text: &str) -> Result<UserRow> {
    let numbers = text.split(',').map(|part| part.trim().parse::<f64>()).collect::<Result<Vec<_>, _>>();
    match numbers.as_deref() {
        Ok([x, y]) => Ok(UserRow { x: *x, y: *y, z: None, heading_deg: None }),
        Ok([x, y, z]) => Ok(UserRow { x: *x, y: *y, z: Some(*z), heading_deg: None }),
        _ => bail!("--user {text}: wanted X,Y or X,Y,Z in metres, for example --user 1.0,-0.5"),
    }
}

fn set_user_count(scenario: &mut Scenario, count: usize) -> Result<()> {
    if let MinRate::Each(rates) = &scenario.users.min_rate_mbps {
        ensure!(rates.len() == count, "users.min_rate_mbps has {} entries for {count} users", rates.len());
    }
    scenario.users.count = count;
    scenario.blockage.forced_users = scenario.blockage.forced_users.min(count);
    Ok(())
}

fn read_csv<T: serde::de::DeserializeOwned>(file: &str) -> Result<Vec<T>> {
    let mut reader = csv::ReaderBuilder::new()
        .trim(csv::Trim::All)
        .comment(Some(b'#'))
        .from_path(file)
        .with_context(|| format!("cannot read {file}"))?;
    reader.deserialize().collect::<Result<_, _>>().with_context(|| format!("in {file}"))
}

/// A line of the obstacles' file.
#[derive(Debug, Deserialize)]
struct ObstacleRow {
    x: f64,
    y: f64,
    radius: f64,
    height: f64,
}

/// Obstacles and bodies, each with the name by which the report calls it.
fn blockers(args: &Args, scenario: &Scenario, rows: &[UserRow]) -> Result<(Vec<Cylinder>, Vec<String>)> {
    let mut blockers: Vec<Cylinder> = match args.obstacles.as_str() {
        "none" => Vec::new(),
        "seed" => heliostat_sim_node::world::World::new(scenario, scenario.seed)?.obstacles().to_vec(),
        file => read_csv::<ObstacleRow>(file)?
            .into_iter()
            .map(|row| {
                let valid =
                    [row.x, row.y].iter().all(|value| value.is_finite()) && row.radius > 0.0 && row.height >= 0.0;
                ensure!(valid, "in {file}: an obstacle needs finite x and y, radius > 0 and height >= 0, not {row:?}");
                Ok(Cylinder { x_m: row.x, y_m: row.y, radius_m: row.radius, height_m: row.height })
            })
            .collect::<Result<_>>()?,
    };
    let mut names: Vec<String> = (0..blockers.len()).map(|index| format!("obstacle {index}")).collect();
    for (user, row) in rows.iter().enumerate() {
        if let Some(heading) = row.heading_deg.filter(|_| scenario.blockage.bodies) {
            let (sin, cos) = heading.to_radians().sin_cos();
            let body = &scenario.blockage;
            blockers.push(Cylinder {
                x_m: row.x - body.body_offset_m * cos,
                y_m: row.y - body.body_offset_m * sin,
                radius_m: body.body_radius_m,
                height_m: body.body_height_m,
            });
            names.push(format!("body of user {user}"));
        }
    }
    Ok((blockers, names))
}

/// A line of the angles' file.
#[derive(Debug, Deserialize)]
struct AngleRow {
    roll_deg: f64,
    yaw_deg: f64,
}

/// The room with its users in place.
struct LitRoom<'a> {
    scenario: &'a Scenario,
    model: &'a ChannelModel,
    scene: &'a Scene,
}

impl LitRoom<'_> {
    fn angles(&self, how: &str) -> Result<MirrorAngles> {
        let mirrors = self.model.mirrors.len();
        let mut angles = MirrorAngles::flat(mirrors);
        match how {
            "flat" => {}
            "oracle" | "aimed" => angles = self.oracle(0.0),
            "nearest" => decode::decode(self.model, self.scene, &vec![1.0; self.scene.users()], &mut angles),
            _ if how.starts_with("user:") && !Path::new(how).exists() => {
                let user: usize =
                    how["user:".len()..].parse().with_context(|| format!("--angles {how}: wanted user:N"))?;
                ensure!(
                    user < self.scene.users(),
                    "--angles {how}: users are counted from 0 to {}",
                    self.scene.users() - 1
                );
                decode::aim_at_point(self.model, &self.scene.positions()[user], &mut angles);
            }
            file => {
                let rows: Vec<AngleRow> = read_csv(file)?;
                ensure!(
                    rows.len() == mirrors,
                    "{file} has angles for {} mirrors, the scenario has {mirrors}",
                    rows.len()
                );
                for (index, row) in rows.iter().enumerate() {
                    let allowed = row.roll_deg.abs() <= 90.0 && row.yaw_deg.abs() <= 90.0;
                    ensure!(allowed, "{file}, mirror {index}: wanted angles from -90 to 90 degrees, not {row:?}");
                    angles.roll[index] = row.roll_deg.to_radians();
                    angles.yaw[index] = row.yaw_deg.to_radians();
                }
            }
        }
        Ok(angles)
    }

    fn oracle(&self, qos_penalty: f64) -> MirrorAngles {
        let mut angles = MirrorAngles::flat(self.model.mirrors.len());
        let min_rate_bps = self.scenario.min_rate_bps();
        let need = Need { min_rate_bps: &min_rate_bps, qos_penalty };
        let mut solver = Solver::new(self.scene.users(), self.model.mirrors.len());
        solver.solve(self.model, self.scene, &need, Method::Oracle, &mut angles);
        angles
    }

    fn sum_rate_mbps(&self, angles: &MirrorAngles) -> f64 {
        let mut rates = vec![0.0; self.scene.users()];
        self.scene.rates_bps(self.model, angles, &mut rates);
        rates.iter().sum::<f64>() * 1e-6
    }

    fn report(&self, angles: &MirrorAngles, per_mirror: bool) -> LinkBudgetReport {
        let (users, mirrors) = (self.scene.users(), self.model.mirrors.len());
        let (mut irs, mut sinr, mut each) = (vec![0.0; users], vec![0.0; users], vec![0.0; users * mirrors]);
        self.scene.irs_gain(self.model, angles, &mut irs);
        self.scene.sinr(self.model, angles, &mut sinr);
        self.scene.irs_gain_each(self.model, angles, &mut each);
        let min_rate = self.scenario.min_rate_bps();
        let links = (0..users).map(|user| {
            let legs = &self.scene.leg_visible()[user * mirrors..][..mirrors];
            let position = self.scene.positions()[user];
            UserLink {
                position_m: [position.x, position.y, position.z],
                los_gain: self.scene.los_gain()[user],
                irs_gain: irs[user],
                sinr: sinr[user],
                sinr_db: 10.0 * sinr[user].max(f64::MIN_POSITIVE).log10(),
                rate_mbps: self.model.budget.rate_bps(sinr[user], users) * 1e-6,
                min_rate_mbps: min_rate[user] * 1e-6,
                ber: ber_ook(sinr[user]),
                los_blocked: self.scene.los_blocked()[user],
                los_blocked_by: Vec::new(),
                mirrors_blocked: legs.iter().filter(|visible| !**visible).count(),
                mirror_gain: if per_mirror { each[user * mirrors..][..mirrors].to_vec() } else { Vec::new() },
            }
        });
        LinkBudgetReport {
            scenario: self.scenario.name.clone(),
            mode: self.scenario.channel.mode.name(),
            angles: String::new(),
            noise_variance_a2: self.model.budget.noise_variance_a2(),
            users: links.collect(),
            sum_rate_mbps: self.sum_rate_mbps(angles),
            oracle_sum_rate_mbps: self.sum_rate_mbps(&self.oracle(0.0)),
            oracle_qos_sum_rate_mbps: self.sum_rate_mbps(&self.oracle(QOS_PENALTY)),
        }
    }
}

fn print_table(report: &LinkBudgetReport) {
    println!("{} mode, mirrors {}, noise {:.3e} A2", report.mode, report.angles, report.noise_variance_a2);
    println!(
        "{:>4} {:>21} {:>11} {:>11} {:>9} {:>11} {:>9}  blocked",
        "user", "position (m)", "LoS gain", "IRS gain", "SINR (dB)", "rate (Mb/s)", "BER"
    );
    for (user, link) in report.users.iter().enumerate() {
        let [x, y, z] = link.position_m;
        let mut blocked = link.los_blocked_by.join(", ");
        if link.mirrors_blocked > 0 {
            blocked.push_str(&format!(
                "{}{} mirrors",
                if blocked.is_empty() { "" } else { "; " },
                link.mirrors_blocked
            ));
        }
        println!(
            "{user:>4} {:>21} {:>11.3e} {:>11.3e} {:>9.2} {:>11.3} {:>9.2e}  {blocked}",
            format!("{x:.2}, {y:.2}, {z:.2}"),
            link.los_gain,
            link.irs_gain,
            link.sinr_db,
            link.rate_mbps,
            link.ber
        );
        for (mirror, gain) in link.mirror_gain.iter().enumerate().filter(|(_, gain)| **gain > 0.0) {
            println!("{:>4} {:>21} {:>11} {gain:>11.3e}", "", format!("mirror {mirror}"), "");
        }
    }
    println!(
        "sum rate {:.3} Mb/s; oracle {:.3} Mb/s; oracle with QoS {:.3} Mb/s",
        report.sum_rate_mbps, report.oracle_sum_rate_mbps, report.oracle_qos_sum_rate_mbps
    );
}
