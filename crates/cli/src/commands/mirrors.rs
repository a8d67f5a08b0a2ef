//! Mirror angles at one instant: given, aimed at a point, of a policy, or of the oracle.

use std::path::Path;

use anyhow::{Context, Result, bail, ensure};
use clap::ValueEnum;
use heliostat_channel::solver::{Method, MinimumRates, Solver};
use heliostat_channel::{ChannelModel, Cylinder, MirrorAngles, Vec3, decode};
use heliostat_core::observation::{Observation, RoomState};
use heliostat_core::policy::PolicyKind;
use heliostat_models::{ActorSource, build};
use heliostat_scenario::{Room, Scenario};
use heliostat_service::counted::counted;
use heliostat_service::output::note;

use super::number_table;

/// One instant of a room: users and blockers.
pub struct Instant<'a> {
    scenario: &'a Scenario,
    /// The channel of the room.
    pub model: &'a ChannelModel,
    /// The observation for a policy.
    pub observation: Observation,
}

impl<'a> Instant<'a> {
    /// Users at `positions`, whose receivers face up; those marked in `forced` have no direct path.
    pub fn new(
        scenario: &'a Scenario,
        model: &'a ChannelModel,
        positions: &[Vec3],
        blockers: &[Cylinder],
        forced: &[bool],
    ) -> Self {
        let mut observation = Observation::new(model, positions.len());
        let (velocities, min_rate_bps) = (vec![Vec3::zeros(); positions.len()], scenario.min_rate_bps());
        let state = RoomState {
            tick: 0,
            positions,
            velocities: &velocities,
            min_rate_bps: &min_rate_bps,
            blockers,
            forced,
            orientations: None,
            measured_los_gain: None,
        };
        observation.set_state(model, &state);
        Self { scenario, model, observation }
    }

    /// Notes on standard error where the users of the room tilt their receivers: here each one faces up.
    pub fn note_upright(&self) {
        if self.scenario.has_tilted_receivers() {
            note(
                "condition: users.orientation tilts the receivers of this room, and here every receiver faces up; for tilted \
                 ones use `heliostat-lab eval`, or heliostat.Room in Python with normals",
            );
        }
    }

    /// The angles for a value of the command line.
    pub fn angles(&self, how: &str) -> Result<MirrorAngles> {
        let mirrors = self.model.mirrors.len();
        let mut angles = MirrorAngles::flat(mirrors);
        if how == "none" {
            // Turned to the ceiling, where no user is.
            angles.roll.fill(-std::f64::consts::FRAC_PI_2);
        } else if how == "oracle" || how == "aimed" {
            angles = self.oracle(0.0);
        } else if let Some(user) = how.strip_prefix("user:") {
            let last = self.observation.users() - 1;
            let user = user.parse().ok().filter(|user| *user <= last);
            let user: usize =
                user.with_context(|| format!("mirrors {how}: expected user:N with N from 0 to {last}"))?;
            decode::aim_at_point(self.model, &self.observation.positions[user], &mut angles);
        } else if let Some(point) = how.strip_prefix("aim:") {
            let place =
                parse_position(point).with_context(|| format!("mirrors {how}: expected aim:X,Y or aim:X,Y,Z in m"))?;
            let point = Vec3::new(place.0, place.1, place.2.unwrap_or(self.scenario.receiver.height_m));
            check_inside(&format!("mirrors {how}: the point"), &point, &self.scenario.room)?;
            decode::aim_at_point(self.model, &point, &mut angles);
        } else if let Ok(kind) = PolicyKind::from_str(how, false) {
            build(kind, self.scenario, &ActorSource::Shipped)?.act(self.model, &self.observation, &mut angles)?;
        } else if how.to_ascii_lowercase().ends_with(".onnx") {
            // Any learned policy: the file determines the network.
            let mut actor = build(PolicyKind::Ddpg, self.scenario, &ActorSource::Path(how.into()))?;
            actor.act(self.model, &self.observation, &mut angles)?;
        } else if Path::new(how).exists() {
            angles = from_file(how, mirrors)?;
        } else {
            let policies: Vec<String> = PolicyKind::value_variants().iter().map(|kind| kind.name()).collect();
            bail!(
                "mirrors {how}: no such file; expected a CSV of angles, an ONNX actor (FILE.onnx), none, oracle, user:N, aim:X,Y or a policy: {}",
                policies.join(", ")
            );
        }
        Ok(angles)
    }

    /// The best angles; `qos_penalty` is the cost of each bit/s below a minimum rate, in bit/s.
    pub fn oracle(&self, qos_penalty: f64) -> MirrorAngles {
        let mut angles = MirrorAngles::flat(self.model.mirrors.len());
        let minimum_rates = MinimumRates { min_rate_bps: &self.observation.min_rate_bps, qos_penalty };
        let mut solver = Solver::new(self.observation.users(), self.model.mirrors.len());
        solver.solve(self.model, &self.observation.scene, &minimum_rates, Method::Oracle, &mut angles);
        angles
    }
}

/// Refuses a place outside the room; a coordinate that is not finite is outside.
pub fn check_inside(what: &str, place: &Vec3, room: &Room) -> Result<()> {
    let half = [0.5 * room.length_x_m, 0.5 * room.length_y_m];
    ensure!(
        place.x.abs() <= half[0] && place.y.abs() <= half[1] && (0.0..room.height_m).contains(&place.z),
        "{what} at ({}, {}, {}) is outside the room; expected |x| <= {}, |y| <= {}, 0 <= z < {}",
        place.x,
        place.y,
        place.z,
        half[0],
        half[1],
        room.height_m
    );
    Ok(())
}

/// `X,Y` or `X,Y,Z` in m.
pub fn parse_position(text: &str) -> Option<(f64, f64, Option<f64>)> {
    let numbers: Vec<f64> = text.split(',').map(|part| part.trim().parse().ok()).collect::<Option<_>>()?;
    match numbers[..] {
        [x, y] => Some((x, y, None)),
        [x, y, z] => Some((x, y, Some(z))),
        _ => None,
    }
}

fn from_file(file: &str, mirrors: usize) -> Result<MirrorAngles> {
    let rows = number_table::read(file, &["roll_deg", "yaw_deg"], &[])?;
    let rows: Vec<[f64; 2]> = rows.into_iter().filter_map(|row| Some([row[0]?, row[1]?])).collect();
    let found = counted(rows.len(), "mirror");
    ensure!(rows.len() == mirrors, "{file} has angles for {found}, the scenario has {mirrors}");
    let mut angles = MirrorAngles::flat(mirrors);
    for (index, [roll_deg, yaw_deg]) in rows.iter().enumerate() {
        let allowed = roll_deg.abs() <= 90.0 && yaw_deg.abs() <= 90.0;
        ensure!(
            allowed,
            "{file}, mirror {index}: expected angles from -90 to 90 degrees, found {roll_deg} and {yaw_deg}"
        );
        angles.roll[index] = roll_deg.to_radians();
        angles.yaw[index] = yaw_deg.to_radians();
    }
    Ok(angles)
}
