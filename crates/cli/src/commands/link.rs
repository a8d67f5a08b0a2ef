//! `heliostat link`: the link budget of users for given mirror angles.

use std::io;

use anyhow::{Context, Result, ensure};
use heliostat_channel::Vec3;
use heliostat_channel::blockage::{Cylinder, blocks};
use heliostat_channel::link::ber_ook;
use heliostat_channel::mirrors::MirrorAngles;
use heliostat_channel::solver::QOS_PENALTY;
use heliostat_room::World;
use heliostat_scenario::{MinRate, STUDY_SCENARIO, Scenario, ScenarioArgs, USERS_MAX};
use heliostat_service::counted::counted;
use serde::Serialize;

use super::mirrors::{Instant, check_inside, parse_position};
use super::number_table;
use heliostat_service::exit::UnusableInput;
use heliostat_service::{exit, outln};

/// Compute the link budget of users at given positions, for given mirror angles.
#[derive(Debug, clap::Args)]
#[command(mut_arg("scenario", |argument| argument.default_value(STUDY_SCENARIO)))]
pub struct Args {
    #[command(flatten)]
    scenario: ScenarioArgs,
    /// CSV of users with the header x,y,z in m; z is optional, and heading_deg (0 is +x, 90 is +y)
    /// places the user's body behind the detector
    #[arg(long, value_name = "FILE", group = "positions")]
    users: Option<String>,
    /// A user at X,Y or X,Y,Z in m; Z defaults to the scenario's receiver height (repeatable)
    #[arg(long, value_name = "X,Y[,Z]", allow_hyphen_values = true, group = "positions")]
    user: Vec<String>,
    /// Mirror angles: none, oracle (or aimed), user:N (all at user N, from 0) and aim:X,Y or
    /// aim:X,Y,Z by the law of reflection in each mode, a policy (such as flat, nearest, greedy or
    /// ddpg), an ONNX actor (FILE.onnx), or a
    /// CSV with the header roll_deg,yaw_deg and one line for each mirror in index order
    #[arg(long, value_name = "HOW|FILE", default_value = "oracle", allow_hyphen_values = true)]
    angles: String,
    /// Obstacles: none, seed (drawn from the scenario's seed), or a CSV with the header
    /// x,y,radius,height in m
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
    /// Absent without any received power.
    sinr_db: Option<f64>,
    rate_mbps: f64,
    min_rate_mbps: f64,
    ber: f64,
    los_blocked: bool,
    los_blocked_by: Vec<String>,
    mirrors_blocked: usize,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    mirror_gain: Vec<f64>,
}

/// The report.
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
    let mut scenario = args.scenario.load_arrays()?;
    let rows = user_rows(&args, &scenario).map_err(exit::unusable)?;
    set_user_count(&mut scenario, rows.len()).map_err(exit::unusable)?;
    let model = scenario.channel_model()?;
    let users: Vec<Vec3> = rows.iter().map(|row| row.position(&scenario)).collect();
    let (blockers, names) = blockers(&args, &scenario, &rows).map_err(exit::unusable)?;
    let forced: Vec<bool> = (0..users.len()).map(|user| user < scenario.blockage.forced_users).collect();
    let instant = Instant::new(&scenario, &model, &users, &blockers, &forced);
    let mut report = LinkBudgetReport::new(&scenario, &instant, &args)?;
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
        outln!("{}", serde_json::to_string(&report)?)?;
    } else {
        print_table(&report)?;
    }
    instant.note_upright();
    Ok(())
}

/// A line of the file of users.
#[derive(Debug)]
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
        Some(file) => number_table::read(file, &["x", "y"], &["z", "heading_deg"])?
            .into_iter()
            .filter_map(|row| Some(UserRow { x: row[0]?, y: row[1]?, z: row[2], heading_deg: row[3] }))
            .collect(),
        None => args.user.iter().map(|text| parse_user(text)).collect::<Result<_>>()?,
    };
    if rows.is_empty() {
        let advice = "no users: give --user X,Y, or --users with a CSV of at least one line after the header";
        return Err(UnusableInput::new(advice).into());
    }
    ensure!(
        rows.len() <= USERS_MAX,
        "{} users; expected at most {USERS_MAX}, the largest number in a room",
        rows.len()
    );
    for (index, row) in rows.iter().enumerate() {
        let place = row.position(scenario);
        let heading = row.heading_deg.unwrap_or(0.0);
        ensure!(heading.is_finite(), "user {index}: heading_deg is {heading}; expected a finite number of degrees");
        check_inside(&format!("user {index}"), &place, &scenario.room)?;
    }
    Ok(rows)
}

fn parse_user(text: &str) -> Result<UserRow> {
    let expected = || format!("--user {text}: expected X,Y or X,Y,Z in m, for example --user 1.0,-0.5");
    let (x, y, z) = parse_position(text).with_context(expected)?;
    Ok(UserRow { x, y, z, heading_deg: None })
}

fn set_user_count(scenario: &mut Scenario, count: usize) -> Result<()> {
    if let MinRate::Each(rates) = &scenario.users.min_rate_mbps {
        ensure!(
            rates.len() == count,
            "users.min_rate_mbps lists {} for {}",
            counted(rates.len(), "value"),
            counted(count, "user")
        );
    }
    scenario.users.count = count;
    scenario.blockage.forced_users = scenario.blockage.forced_users.min(count);
    Ok(())
}

/// Obstacles and bodies, each with its name in the report.
fn blockers(args: &Args, scenario: &Scenario, rows: &[UserRow]) -> Result<(Vec<Cylinder>, Vec<String>)> {
    let mut blockers: Vec<Cylinder> = match args.obstacles.as_str() {
        "none" => Vec::new(),
        "seed" => World::new(scenario, scenario.read_trace()?.as_deref(), scenario.seed)?.obstacles().to_vec(),
        file => number_table::read(file, &["x", "y", "radius", "height"], &[])?
            .into_iter()
            .filter_map(|row| Some(Cylinder { x_m: row[0]?, y_m: row[1]?, radius_m: row[2]?, height_m: row[3]? }))
            .map(|one| {
                let finite = [one.x_m, one.y_m, one.radius_m, one.height_m].iter().all(|value| value.is_finite());
                let valid = finite && one.radius_m > 0.0 && one.height_m >= 0.0;
                ensure!(valid, "in {file}: invalid obstacle {one:?}; expected x, y, radius > 0 and height >= 0 in m");
                Ok(one)
            })
            .collect::<Result<_>>()?,
    };
    let mut names: Vec<String> = (0..blockers.len()).map(|index| format!("obstacle {index}")).collect();
    for (user, row) in rows.iter().enumerate() {
        if let Some((heading, body)) = row.heading_deg.zip(scenario.blockage.body()) {
            let (sin, cos) = heading.to_radians().sin_cos();
            blockers.push(body.behind(&Vec3::new(row.x, row.y, 0.0), &Vec3::new(cos, sin, 0.0)));
            names.push(format!("body of user {user}"));
        }
    }
    Ok((blockers, names))
}

impl LinkBudgetReport {
    /// The links for the requested angles, and the oracle's sum rates; `los_blocked_by` is still
    /// empty.
    fn new(scenario: &Scenario, instant: &Instant, args: &Args) -> Result<Self> {
        let (model, scene) = (instant.model, &instant.observation.scene);
        let (users, mirrors) = (scene.users(), model.mirrors.len());
        let angles = instant.angles(&args.angles).map_err(exit::unusable)?;
        let (mut irs, mut sinr, mut each) = (vec![0.0; users], vec![0.0; users], vec![0.0; users * mirrors]);
        scene.irs_gain(model, &angles, &mut irs);
        scene.sinr(model, &angles, &mut sinr);
        scene.irs_gain_each(model, &angles, &mut each);
        let sum_rate_mbps = |angles: &MirrorAngles| {
            let mut rates = vec![0.0; users];
            scene.rates_bps(model, angles, &mut rates);
            rates.iter().sum::<f64>() * 1e-6
        };
        let links = (0..users).map(|user| {
            let paths = &scene.irs_path_clear()[user * mirrors..][..mirrors];
            let position = scene.positions()[user];
            UserLink {
                position_m: [position.x, position.y, position.z],
                los_gain: scene.los_gain()[user],
                irs_gain: irs[user],
                sinr: sinr[user],
                sinr_db: (sinr[user] > 0.0).then(|| 10.0 * sinr[user].log10()),
                rate_mbps: model.budget.rate_bps(sinr[user], users) * 1e-6,
                min_rate_mbps: instant.observation.min_rate_bps[user] * 1e-6,
                ber: ber_ook(sinr[user]),
                los_blocked: scene.los_blocked()[user],
                los_blocked_by: Vec::new(),
                mirrors_blocked: paths.iter().filter(|visible| !**visible).count(),
                mirror_gain: if args.per_mirror { each[user * mirrors..][..mirrors].to_vec() } else { Vec::new() },
            }
        });
        Ok(Self {
            scenario: scenario.name.clone(),
            mode: scenario.channel.mode.name(),
            angles: args.angles.clone(),
            noise_variance_a2: model.budget.noise_variance_a2(),
            users: links.collect(),
            sum_rate_mbps: sum_rate_mbps(&angles),
            oracle_sum_rate_mbps: sum_rate_mbps(&instant.oracle(0.0)),
            oracle_qos_sum_rate_mbps: sum_rate_mbps(&instant.oracle(QOS_PENALTY)),
        })
    }
}

/// A bit error rate in the table. Below the limit a number in double precision loses digits.
fn ber_text(ber: f64) -> String {
    if ber < 1e-300 { "< 1e-300".into() } else { format!("{ber:.2e}") }
}

fn print_table(report: &LinkBudgetReport) -> io::Result<()> {
    outln!(
        "{} mode, mirrors {}, noise {:.3e} A2, {} on the bandwidth",
        report.mode,
        report.angles,
        report.noise_variance_a2,
        counted(report.users.len(), "user")
    )?;
    outln!(
        "{:>4} {:>21} {:>11} {:>11} {:>9} {:>13} {:>9}  blocked",
        "user",
        "position (m)",
        "LoS gain",
        "IRS gain",
        "SINR (dB)",
        "rate (Mbit/s)",
        "BER"
    )?;
    for (user, link) in report.users.iter().enumerate() {
        let [x, y, z] = link.position_m;
        let mut blocked = link.los_blocked_by.join(", ");
        if link.mirrors_blocked > 0 {
            blocked.push_str(&format!(
                "{}{}",
                if blocked.is_empty() { "" } else { "; " },
                counted(link.mirrors_blocked, "mirror")
            ));
        }
        outln!(
            "{user:>4} {:>21} {:>11.3e} {:>11.3e} {:>9} {:>13.3} {:>9}  {blocked}",
            format!("{x:.2}, {y:.2}, {z:.2}"),
            link.los_gain,
            link.irs_gain,
            link.sinr_db.map_or("none".into(), |decibels| format!("{decibels:.2}")),
            link.rate_mbps,
            ber_text(link.ber)
        )?;
        for (mirror, gain) in link.mirror_gain.iter().enumerate().filter(|(_, gain)| **gain > 0.0) {
            outln!("{:>4} {:>21} {:>11} {gain:>11.3e}", "", format!("mirror {mirror}"), "")?;
        }
    }
    outln!(
        "sum rate {:.3} Mbit/s; oracle {:.3} Mbit/s; oracle without minimum rates {:.3} Mbit/s",
        report.sum_rate_mbps,
        report.oracle_qos_sum_rate_mbps,
        report.oracle_sum_rate_mbps
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bit_error_rate_below_every_measurement_is_a_bound() {
        assert_eq!([8.42e-319, 0.0].map(ber_text), ["< 1e-300", "< 1e-300"]);
        assert_eq!([1e-300, 0.5].map(ber_text), ["1.00e-300", "5.00e-1"]);
    }
}
