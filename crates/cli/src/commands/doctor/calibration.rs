//! The files of a calibration, compared with the running room.

use std::path::Path;
use std::time::{Duration, SystemTime};

use anyhow::Result;
use heliostat_array::calibration::check_corrections;
use heliostat_array::calibration_file::CalibrationFile;
use heliostat_driver::calibration_store;
use heliostat_files::shell_word;
use heliostat_proto::Stamp;
use heliostat_proto::messages::fault;
use heliostat_scenario::{GeometryDifference, Scenario, ScenarioArgs};
use heliostat_service::counted::counted;
use heliostat_service::printable::printable;

use super::args::Args;
use super::check::Check;
use super::controller::ControllerState;
use super::system::{DriverState, accepted_range, compare};

/// Name of the check of the driver's file, and of that of the measured room.
const FILE: &str = "calibration";
const ROOM: &str = "measured room";

/// What to do where a file cannot be compared.
const GIVE_DRIVER: &str =
    "one driver of the array has to answer: give its endpoint with --connect, and see the check of the driver";

/// Seconds of a day.
const DAY_S: u64 = 86_400;

/// The checks of the files that the flags name. `driver` and `controller` are what answered, if any did.
pub(super) fn checks(
    args: &Args,
    driver: Option<&Result<DriverState>>,
    controller: Option<&ControllerState>,
) -> Vec<Check> {
    let mut checks = Vec::new();
    let driver = driver.and_then(|driver| driver.as_ref().ok());
    if let Some(file) = &args.calibration {
        checks.extend(check_calibration(file, args.array, driver));
    }
    if let Some(file) = &args.measured {
        let accepted = driver.and_then(|driver| accepted_range(args, args.array, driver, controller));
        checks.extend(check_measured(file, args.array, driver, controller, accepted));
    }
    // The light of a controller without a fit is not shown, however much it has compared.
    let lacks_light = |controller: &ControllerState| controller.unfit.is_none() && controller.light.is_empty();
    if !checks.is_empty() && controller.is_some_and(lacks_light) {
        let found = "not known: the controller has compared too little light of served users so far";
        checks.push(Check::unknown("light", found));
    }
    checks
}

/// A file without an array to compare it with.
fn not_compared(name: &'static str, found: &str) -> Check {
    Check::warn(name, format!("{found}; not compared: no array answers"), GIVE_DRIVER)
}

/// The corrections: whether the array can use them, and does.
fn check_calibration(file: &Path, array: usize, driver: Option<&DriverState>) -> Vec<Check> {
    let shown = file.display();
    let calibration = match calibration_store::load(file) {
        Ok(calibration) => calibration,
        Err(error) => {
            let advice = "expected the --out of heliostat calibrate: give that file, or calibrate again";
            return vec![Check::fail(FILE, format!("{error:#}"), advice)];
        }
    };
    let CalibrationFile { rows, columns, .. } = calibration;
    let found = format!("{shown}: {rows} x {columns} mirrors, {}", age_of(file));
    if let Err(unfit) = check_corrections(&calibration.message(Stamp::default())) {
        return vec![Check::fail(FILE, format!("{shown}: {unfit}"), "a driver refuses this file: calibrate again")];
    }
    let Some(driver) = driver else {
        return vec![not_compared(FILE, &found)];
    };
    if let Err(difference) = calibration.check_array(&driver.capabilities) {
        let advice = "give the file of this array, or name its array: --array N; else calibrate again";
        return vec![Check::fail(FILE, format!("{shown}: {difference}"), advice)];
    }
    vec![Check::ok(FILE, found), check_use(file, array, driver)]
}

/// Whether the array has a calibration in use. The contract numbers it, and does not show its corrections.
fn check_use(file: &Path, array: usize, driver: &DriverState) -> Check {
    let name = "in use";
    let of_array = if array == 0 { String::new() } else { format!(" --array {array}") };
    let bring = format!(
        "heliostat calibrate apply {file}{of_array} brings it to the running driver; start the driver with \
         --calibration {file} from then on",
        file = shell_word(&file.to_string_lossy())
    );
    match (driver.calibration, driver.faults & fault::CALIBRATION != 0) {
        (_, true) => Check::fail(
            name,
            "the array has refused a calibration",
            format!("the log of the driver says why; correct the file: {bring}"),
        ),
        (None, _) => Check::warn(name, "unknown: the array publishes no telemetry", "check its driver"),
        (Some(0), _) => Check::warn(name, "the array uses no calibration: expected that of the file", bring),
        (Some(sequence), _) => Check::ok(
            name,
            format!(
                "the array uses a calibration, number {sequence}; whether it is that of the file cannot be seen over \
                 the contract"
            ),
        ),
    }
}

/// The measured room: whether it fits the array, and is that of the controller. `accepted` is why a small range is no
/// failure.
fn check_measured(
    file: &Path,
    array: usize,
    driver: Option<&DriverState>,
    controller: Option<&ControllerState>,
    accepted: Option<&str>,
) -> Vec<Check> {
    let shown = file.display();
    let load = ScenarioArgs { scenario: shown.to_string(), ..ScenarioArgs::default() };
    let room = match load.load_arrays() {
        Ok(room) => room,
        Err(error) => {
            let advice = "expected the --room-out of heliostat calibrate: give that file, or calibrate again";
            return vec![Check::fail(ROOM, error.to_string(), advice)];
        }
    };
    let mut checks = Vec::new();
    let found = format!("{shown}: {}, {}", counted(room.mirrors.arrays().len(), "array"), age_of(file));
    match driver {
        Some(driver) => {
            let fit = compare(array, &driver.capabilities, &room, accepted);
            checks.push(Check { name: ROOM, found: format!("{found}; for {}", fit.found), ..fit });
        }
        None => checks.push(not_compared(ROOM, &found)),
    }
    checks.extend(controller.map(|controller| compare_rooms(file, &room, controller)));
    checks
}

/// Whether a controller decides with the measured room.
fn compare_rooms(file: &Path, room: &Scenario, controller: &ControllerState) -> Check {
    let name = "served room";
    let restart = format!("start the controller with --scenario {}", file.display());
    if controller.scenario == room.hash() {
        return Check::ok(name, "the controller uses the measured room");
    }
    let announced = controller.geometry.as_deref().map(Scenario::from_geometry_toml);
    match announced {
        Some(Ok(served)) => match room.geometry_difference(&served) {
            Some(GeometryDifference { key, here, there, .. }) => Check::warn(
                name,
                format!("{key} is {} in the controller: expected {here}, as in the file", printable(&there)),
                restart,
            ),
            None => Check::ok(
                name,
                "the controller uses the measured geometry; other settings differ, for example by --set",
            ),
        },
        Some(Err(_)) | None => Check::warn(
            name,
            format!(
                "the controller has the configuration {}: expected {}, as in the file; it announces no geometry to \
                 compare",
                printable(&controller.scenario),
                room.hash()
            ),
            restart,
        ),
    }
}

/// How old a file is, in words.
fn age_of(file: &Path) -> String {
    let written = std::fs::metadata(file).and_then(|file| file.modified());
    written.map_or("of unknown age".into(), |written| match SystemTime::now().duration_since(written) {
        Ok(age) => age_text(age),
        Err(_) => "written in the future: check the clock".into(),
    })
}

fn age_text(age: Duration) -> String {
    match age.as_secs() / DAY_S {
        0 => "written less than a day ago".into(),
        days => format!("written {} ago", counted(usize::try_from(days).unwrap_or(usize::MAX), "day")),
    }
}

#[cfg(test)]
mod tests {
    use heliostat_proto::Capabilities;

    use super::super::check::Verdict;
    use super::*;

    fn driver(calibration: Option<u64>, faults: u32) -> DriverState {
        DriverState { capabilities: Capabilities::default(), device_problem: None, calibration, faults, state: None }
    }

    #[test]
    fn only_an_array_that_uses_a_calibration_passes_and_the_advice_names_the_file() {
        let check = |calibration, faults| check_use(Path::new("wall.toml"), 0, &driver(calibration, faults));
        let verdicts = [(Some(3), 0), (Some(0), 0), (None, 0), (Some(3), fault::CALIBRATION)]
            .map(|(calibration, faults)| check(calibration, faults).verdict);
        assert_eq!(verdicts, [Verdict::Ok, Verdict::Warn, Verdict::Warn, Verdict::Fail]);
        assert!(check(Some(3), 0).found.contains("cannot be seen over the contract"));
        let advice = check(Some(0), 0).advice;
        assert!(advice.starts_with("heliostat calibrate apply wall.toml brings it to the running driver;"), "{advice}");
        assert!(advice.ends_with("start the driver with --calibration wall.toml from then on"), "{advice}");
        assert!(check(Some(3), fault::CALIBRATION).advice.contains("heliostat calibrate apply wall.toml "));
        let second = check_use(Path::new("wall.toml"), 1, &driver(Some(0), 0)).advice;
        assert!(second.starts_with("heliostat calibrate apply wall.toml --array 1 brings"), "{second}");
    }

    #[test]
    fn a_room_that_is_compared_with_no_array_is_a_warning() {
        let checks = check_measured(Path::new("hall"), 0, None, None, None);
        assert_eq!(checks.iter().map(|check| check.verdict).collect::<Vec<_>>(), [Verdict::Warn]);
        assert!(checks[0].found.ends_with("not compared: no array answers"), "{checks:?}");
    }

    #[test]
    fn a_controller_with_another_room_is_a_warning_that_names_the_key() {
        let room = Scenario::builtin("hall").expect("a built-in scenario");
        let controller = |scenario: &Scenario, geometry: Option<String>| ControllerState {
            scenario: scenario.hash(),
            geometry,
            ..ControllerState::default()
        };
        let check = |state: &ControllerState| compare_rooms(Path::new("measured.toml"), &room, state);
        assert_eq!(check(&controller(&room, None)).verdict, Verdict::Ok);
        let changed = |set: &str| room.with_overrides(&[set]).expect("a valid change");
        let other = changed("led.half_power_semi_angle_deg=50");
        let check_of = |scenario: &Scenario| check(&controller(scenario, Some(scenario.geometry_toml())));
        let differing = check_of(&other);
        assert_eq!(differing.verdict, Verdict::Warn);
        assert!(
            differing.found.starts_with("led.half_power_semi_angle_deg is 50.0 in the controller"),
            "{differing:?}"
        );
        assert_eq!(differing.advice, "start the controller with --scenario measured.toml");
        assert_eq!(check_of(&changed("seed=77")).verdict, Verdict::Ok);
        assert_eq!(check(&controller(&other, None)).verdict, Verdict::Warn);
    }

    #[test]
    fn an_age_is_in_days() {
        let texts = [3, DAY_S, 40 * DAY_S + 5].map(|seconds| age_text(Duration::from_secs(seconds)));
        assert_eq!(texts, ["written less than a day ago", "written 1 day ago", "written 40 days ago"]);
    }
}
