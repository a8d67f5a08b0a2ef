//! The flags of `heliostat calibrate`.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use heliostat_bus::BusArgs;
use heliostat_calibrate::Place;
use heliostat_calibrate::places::{default_spots, default_verification};
use heliostat_driver::cli::array_index;
use heliostat_scenario::{MismatchLevel, Scenario, ScenarioArgs};
use heliostat_service::EndArgs;
use heliostat_service::exit::UnusableInput;
use heliostat_service::input;

/// Measure the mirrors, the LEDs and the tracker's frame of a running room.
///
/// One user carries one receiver to a few spots and to one more place for the verification, faces
/// the mirrors and stands still. The command notices where the receiver stands. It turns one mirror
/// after the other to the receiver and reads the channel reports. Then it estimates how each mirror is
/// mounted, where the LEDs are, and the height of the tracker's frame.
///
/// It commands the array as a controller does: other controllers and the live page see its epoch. End
/// a running controller first, or give --take-over. Nothing is written if the calibrated aims give
/// no more light than the nominal ones. Connect to the process of the room, or to its router.
///
/// With --refine it finds the mirrors that have turned since a complete calibration, beside a running
/// controller. It commands the array only while the receiver stands at a spot and the position reports
/// have named no other user for 3 s. When another user enters, the controller leads again at once.
#[derive(Debug, clap::Args)]
#[command(args_conflicts_with_subcommands = true, subcommand_negates_reqs = true)]
pub struct Args {
    #[command(subcommand)]
    pub step: Option<Step>,
    #[command(flatten)]
    pub scenario: ScenarioArgs,
    #[command(flatten)]
    pub bus: BusArgs,
    /// A spot X,Y,Z in m, Z the height of the detector above the floor; or a file with one spot a
    /// line (repeatable). Without it, three spots in a triangle at the receiver's height of the scenario
    #[arg(long, value_name = "FILE|X,Y,Z", allow_hyphen_values = true)]
    pub spots: Vec<String>,
    /// Place of the verification, away from the spots
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    pub verify: Option<String>,
    /// Write the corrections of the mirrors to this new file, for --calibration of a driver, or for
    /// `heliostat calibrate apply`
    #[arg(long, value_name = "FILE", required = true)]
    pub out: Option<PathBuf>,
    /// Write the scenario with the measured LEDs, heights and noise to this new file, for --scenario
    /// of a controller
    #[arg(long, value_name = "FILE")]
    pub room_out: Option<PathBuf>,
    /// Keep the readings in this file; if it exists, continue from it
    #[arg(long, value_name = "FILE")]
    pub readings: Option<PathBuf>,
    /// Index of the array, from 0
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = array_index)]
    pub array: usize,
    /// Number of the user who holds the receiver; without it, the only user that the tracker reports
    #[arg(long, value_name = "N")]
    pub user: Option<u32>,
    /// How the room was installed: by a laser and with care, or by a tape and by eye
    #[arg(long, value_name = "LEVEL", default_value = "rough")]
    pub level: MismatchLevel,
    /// Estimate the scale of each axis too, not only its offset
    #[arg(long)]
    pub scales: bool,
    /// The calibration that the array uses now; the result includes it. `none`: it changes no angle, as the one
    /// that `heliostat driver check` leaves
    #[arg(long, value_name = "FILE|none")]
    pub base: Option<PathBuf>,
    /// Refine the calibration in use, in idle time only. FILE: the --readings of the complete calibration;
    /// --base names its corrections, --scenario is the one that it was made with
    #[arg(long, value_name = "FILE", requires_all = ["base", "user", "room_out"], conflicts_with = "take_over")]
    pub refine: Option<PathBuf>,
    /// Take the lead from a controller that commands the array now
    #[arg(long)]
    pub take_over: bool,
    /// Print the result as one JSON object
    #[arg(long)]
    pub json: bool,
    #[command(flatten)]
    pub end: EndArgs,
}

// What follows the measurement. No doc comments: clap would show them in place of those of the arguments.
#[derive(Debug, clap::Subcommand)]
pub enum Step {
    Apply(ApplyArgs),
}

/// Bring a calibration file to the running driver of an array, without a restart.
///
/// The command compares the file with the array, publishes the calibration, and waits for at most 5 s
/// until telemetry shows it. The exit status is 0 only then. The new corrections replace those in use at
/// once, and the mirrors turn by the difference. Nothing else changes: stops stay in force. While a
/// calibration commands the room, the file is refused: its readings hold for the calibration in use.
///
/// The driver forgets the calibration when it ends. Copy the file to its machine, and start it with
/// --calibration FILE from then on: `heliostat driver run`, or `heliostat sim-node`.
///
/// The measured room of the same calibration (--room-out) belongs to it: start the controller again with
/// this scenario. With --tls the command needs the keys of the role calibrator.
#[derive(Debug, clap::Args)]
pub struct ApplyArgs {
    /// The --out of `heliostat calibrate`
    #[arg(value_name = "FILE")]
    pub file: PathBuf,
    #[command(flatten)]
    pub bus: BusArgs,
    /// Index of the array, from 0
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = array_index)]
    pub array: usize,
    /// Print the result as one JSON object
    #[arg(long)]
    pub json: bool,
}

impl Args {
    /// The spots of the flags, or those of the scenario's room.
    pub fn spots(&self, scenario: &Scenario) -> Result<Vec<Place>> {
        let mut spots = Vec::new();
        for text in &self.spots {
            if Path::new(text).is_file() {
                let lines = input::read(Path::new(text))?;
                let rows = lines.lines().map(str::trim).filter(|line| !line.is_empty() && !line.starts_with('#'));
                for row in rows {
                    spots.push(place(row).with_context(|| UnusableInput::new(format!("in {text}")))?);
                }
            } else {
                spots.push(place(text)?);
            }
        }
        if self.spots.is_empty() {
            spots = default_spots(scenario);
        }
        spots.iter().try_for_each(|spot| check_inside(scenario, spot))?;
        Ok(spots)
    }

    /// The place of the verification.
    pub fn verification(&self, scenario: &Scenario) -> Result<Place> {
        let verify = self.verify.as_deref().map_or_else(|| Ok(default_verification(scenario)), place)?;
        check_inside(scenario, &verify)?;
        Ok(verify)
    }
}

/// Reads X,Y,Z in m.
fn place(text: &str) -> Result<Place> {
    let numbers: Option<Vec<f64>> = text.split(',').map(|part| part.trim().parse().ok()).collect();
    match numbers.as_deref() {
        Some([x, y, z]) if [x, y, z].iter().all(|number| number.is_finite()) => {
            Ok(Place { floor_m: Some([*x, *y]), height_m: *z })
        }
        _ => Err(UnusableInput::new(format!(
            "invalid spot `{text}`: expected X,Y,Z in m, for example -1.5,0.8,0.85, or a file with such lines"
        ))
        .into()),
    }
}

fn check_inside(scenario: &Scenario, place: &Place) -> Result<()> {
    let room = &scenario.room;
    let [x, y] = place.floor_m.unwrap_or_default();
    ensure!(
        x.abs() <= 0.5 * room.length_x_m
            && y.abs() <= 0.5 * room.length_y_m
            && (0.0..room.height_m).contains(&place.height_m),
        UnusableInput::new(format!(
            "the spot {x},{y},{} is outside the room: expected a place within {} m x {} m, centred on the origin, below {} m",
            place.height_m, room.length_x_m, room.length_y_m, room.height_m
        ))
    );
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_spot_has_three_finite_numbers() {
        assert_eq!(place("-1.5, 0.8,0.85").unwrap(), Place { floor_m: Some([-1.5, 0.8]), height_m: 0.85 });
        for text in ["", "1,2", "1,2,3,4", "1,2,x", "1,2,nan"] {
            assert!(place(text).unwrap_err().to_string().contains("expected X,Y,Z"), "{text}");
        }
    }

    #[test]
    fn spots_outside_the_room_are_refused() {
        let scenario = Scenario::builtin("hall").unwrap();
        for place in default_spots(&scenario).iter().chain([&default_verification(&scenario)]) {
            check_inside(&scenario, place).unwrap();
        }
        assert!(check_inside(&scenario, &place("2.6,0,0.85").unwrap()).is_err());
        assert!(check_inside(&scenario, &place("0,0,3.2").unwrap()).is_err());
    }
}
