//! Checks of the planned run: scenario, policy, driver, ports.

use std::fmt;
use std::net::TcpListener;
use std::time::{Duration, Instant};

use heliostat_bus::arriving::arriving;
use heliostat_bus::{ACCEPTS_WITHIN, AccessRole, Bus, BusArgs, BusConfig, BusError, Reach, join_through};
use heliostat_controller::report::summary::describe_unfit;
use heliostat_core::belief::conditions::{Condition, conditions};
use heliostat_core::capabilities::{Examiner, Force, Unfit};
use heliostat_core::policy::Finding;
use heliostat_models::{PolicyArgs, build_tried};
use heliostat_proto::array_keys::array_name;
use heliostat_proto::messages::fault;
use heliostat_proto::{ArrayState, Capabilities, MirrorTelemetry, NodeStatus, STATUS_WITHIN, ValidityClock, decode};
use heliostat_room::World;
use heliostat_scenario::Scenario;
use heliostat_service::counted::counted;
use heliostat_service::printable::printable;
use heliostat_ui::find_absent_room;

use super::args::Args;
use super::check::{Check, Verdict};
use super::controller::ControllerState;
use super::{calibration, controller, geometry};
use crate::commands::join::unanswered_in_words;

/// Longest time until a driver answers.
const DRIVER_WAIT: Duration = Duration::from_secs(3);

/// Time between two requests to a process that may still connect.
const FETCH_EVERY: Duration = Duration::from_millis(50);

/// Longest time until a session is connected.
pub(super) const CONNECTED_WITHIN: Duration = DRIVER_WAIT;

/// Limits that differ by less than this, in rad, count as equal.
const SAME_ANGLE_RAD: f64 = 1e-4;

/// All checks of the planned run.
pub(super) fn checks(args: &Args) -> Vec<Check> {
    let scenario = match args.scenario.load_arrays().map_err(anyhow::Error::from).and_then(|scenario| {
        World::new(&scenario, scenario.read_trace()?.as_deref(), scenario.seed)?;
        Ok(scenario)
    }) {
        Ok(scenario) => scenario,
        Err(error) => {
            let advice = "correct it, or start from a valid one: heliostat scenario new FILE";
            let mut checks = vec![Check::fail("scenario", format!("{error:#}"), advice)];
            checks.extend(args.ports().into_iter().map(check_port));
            return checks;
        }
    };
    let found = format!(
        "{}: {} mode, {}, {} mirrors, configuration {}",
        scenario.name,
        scenario.channel.mode.name(),
        counted(scenario.users.count, "user"),
        scenario.mirrors,
        scenario.hash()
    );
    let mut checks = vec![Check::ok("scenario", found)];
    checks.extend(check_belief(&scenario));
    checks.push(check_policy(&args.policy, &scenario));
    checks.extend(args.policy.kind().conditions(&scenario).into_iter().map(|condition| warning("policy", condition)));
    let joined = args.joins().then(|| open_bus(args));
    if let Some(Ok((_, unanswered))) = &joined {
        checks.extend(unanswered.iter().map(|endpoint| check_unanswered(endpoint)));
    }
    let drivers = ask_drivers(args, joined.as_ref(), scenario.mirrors.arrays().len());
    let bus = joined.as_ref().and_then(|joined| joined.as_ref().ok()).map(|(bus, _)| bus);
    checks.extend(bus.and_then(check_room));
    let (answers, of_controller) = controller::checks(bus);
    checks.extend(check_drivers(args, &drivers, &scenario, answers.controller.as_ref()));
    checks.extend(geometry::checks(&scenario, &answers));
    checks.extend(of_controller);
    checks.extend(calibration::checks(args, drivers.get(args.array), answers.controller.as_ref()));
    // A driver that is checked listens on its own port, and this command on those of --listen.
    let endpoints = || args.connect.iter().chain(&args.listen);
    let in_use = |port: u16| endpoints().any(|endpoint| endpoint.ends_with(&format!(":{port}")));
    checks.extend(args.ports().into_iter().filter(|(port, _)| !in_use(*port)).map(check_port));
    checks
}

/// The methods of the belief that do not apply to the room.
fn check_belief(scenario: &Scenario) -> Vec<Check> {
    let Ok(model) = scenario.channel_model() else { return Vec::new() };
    let found = conditions(scenario, &model);
    if found.is_empty() {
        return vec![Check::ok("belief", "every method applies to the room")];
    }
    found.into_iter().map(|condition| warning("belief", condition)).collect()
}

fn warning(name: &'static str, condition: Condition) -> Check {
    let found = format!("{} does not apply: {}", condition.method, condition.because);
    Check::warn(name, found, condition.consequence)
}

fn check_policy(args: &PolicyArgs, scenario: &Scenario) -> Check {
    let (policy, findings) = match build_tried(args.kind(), scenario, &args.actor()) {
        Ok(tried) => tried,
        Err(error) => {
            let advice = "choose a policy that needs no file (--policy fixed-point), or train an actor for this scenario: heliostat-lab train ddpg";
            return Check::fail("policy", format!("{error:#}"), advice);
        }
    };
    let name = args.model.as_ref().map_or(policy.name().to_owned(), |path| path.display().to_string());
    let engine = policy.engine().map_or(String::new(), |engine| format!(", engine {engine}"));
    let is_default = args.policy.is_none() && args.model.is_none();
    let default = if is_default { " (default, --policy names another one)" } else { "" };
    let mut found = format!("{name} fits the scenario{engine}{default}");
    let mut warnings = Vec::new();
    for finding in findings {
        match finding {
            Finding::Note(note) => found.push_str(&format!("; {note}")),
            Finding::Warning(warning) => warnings.push(warning),
        }
    }
    match warnings.is_empty() {
        true => Check::ok("policy", found),
        false => Check::warn("policy", found, warnings.join("; ")),
    }
}

fn check_port((port, remark): (u16, &str)) -> Check {
    match TcpListener::bind(("127.0.0.1", port)) {
        Ok(_) => Check::ok("port", format!("127.0.0.1:{port} is free{remark}")),
        Err(error) => Check::fail(
            "port",
            format!("127.0.0.1:{port}: {error}{remark}"),
            "end the process that listens there (ss -ltnp names it), or run with --listen tcp/127.0.0.1:PORT and the same --connect",
        ),
    }
}

/// What the driver of each array answers; nothing without an address.
fn ask_drivers(
    args: &Args,
    joined: Option<&anyhow::Result<(Bus, Vec<String>)>>,
    arrays: usize,
) -> Vec<anyhow::Result<DriverState>> {
    let asked = if joined.is_some() { arrays } else { 0 };
    let ask = |array| match joined {
        Some(Ok((bus, _))) => ask_driver(args, bus, array),
        // Its type decides about the advice.
        Some(Err(error)) => Err(error
            .downcast_ref::<BusError>()
            .map_or_else(|| anyhow::anyhow!("{error:#}"), |error| error.clone().into())),
        None => Err(anyhow::anyhow!("no --connect")),
    };
    (0..asked).map(ask).collect()
}

/// An endpoint at which no process of a room answers, beside one at which one does.
fn check_unanswered(endpoint: &str) -> Check {
    let advice = "start the process there, or leave the endpoint out: what it alone reaches is not checked";
    Check::warn("endpoint", unanswered_in_words(endpoint), advice)
}

/// That the room has no process, where other rooms have some.
fn check_room(bus: &Bus) -> Option<Check> {
    let found = find_absent_room([bus])?;
    Some(Check::warn("room", found, "give --room the name of one of them, or start the processes of this room"))
}

/// One check for each array of the scenario.
fn check_drivers(
    args: &Args,
    drivers: &[anyhow::Result<DriverState>],
    scenario: &Scenario,
    controller: Option<&ControllerState>,
) -> Vec<Check> {
    if drivers.is_empty() {
        return vec![Check::unknown("driver", "not checked: neither --connect nor --listen")];
    }
    let named = |(array, driver)| {
        let check = check_driver(args, driver, scenario, array, controller);
        if drivers.len() == 1 {
            check
        } else {
            Check { found: format!("{}: {}", array_name(array), check.found), ..check }
        }
    };
    drivers.iter().enumerate().map(named).collect()
}

fn check_driver(
    args: &Args,
    driver: &anyhow::Result<DriverState>,
    scenario: &Scenario,
    array: usize,
    controller: Option<&ControllerState>,
) -> Check {
    match driver {
        Ok(DriverState { device_problem: Some(problem), .. }) => Check::fail(
            "driver",
            problem,
            "check power and cable of the hardware, and the address in the driver's configuration",
        ),
        Ok(driver) => {
            let accepted = accepted_range(args, array, driver, controller);
            with_state(compare(array, &driver.capabilities, scenario, accepted), driver)
        }
        Err(error) => {
            let is_refused = || bus_config(args).is_ok_and(|config| Bus::find_connection_problem(&config).is_some());
            Check::fail("driver", format!("{error:#}"), advice_without_driver(error, is_refused))
        }
    }
}

/// What to do where no driver, or more than one, has answered; the closure tells whether a process there refuses.
fn advice_without_driver(error: &anyhow::Error, is_refused: impl FnOnce() -> bool) -> &'static str {
    if error.is::<SeveralDrivers>() {
        "stop one of them: an array has one driver"
    } else if error.downcast_ref::<BusError>().is_some_and(BusError::is_of_settings) {
        "correct the flag that the message names (--connect, --listen, --room, --tls): nothing was asked yet"
    } else if is_refused() {
        "a process listens there: correct the address, the certificate or the rights that the message names"
    } else {
        "start the driver, and pass its endpoint and the name of its room (--connect, --room)"
    }
}

/// Several drivers have the same array.
#[derive(Debug)]
struct SeveralDrivers {
    count: usize,
    room: String,
}

impl fmt::Display for SeveralDrivers {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} drivers answer in room \"{}\"; expected one", self.count, self.room)
    }
}

impl std::error::Error for SeveralDrivers {}

/// The session of the checks, and the endpoints at which no process answers. No check publishes, so the rights of
/// any role do.
fn open_bus(args: &Args) -> anyhow::Result<(Bus, Vec<String>)> {
    let config = bus_config(args)?;
    if let (Some(bus), unanswered) = join_through(&config, ACCEPTS_WITHIN) {
        return Ok((bus, unanswered));
    }
    let bus = Bus::open(&config.clone().reaching(Reach::Within(DRIVER_WAIT)))?;
    bus.wait_connected(CONNECTED_WITHIN);
    let is_silent = |endpoint: &&String| {
        let at = BusConfig { connect: vec![(*endpoint).clone()], ..config.clone() };
        Bus::find_unanswered(&at).is_some()
    };
    let unanswered = config.connect.iter().filter(is_silent).cloned().collect();
    Ok((bus, unanswered))
}

fn bus_config(args: &Args) -> anyhow::Result<BusConfig> {
    let (room, connect, listen) = (args.room.clone(), args.connect.clone(), args.listen.clone());
    let flags = BusArgs { room, connect, listen, client: args.client, tls: args.tls.clone() };
    Ok(flags.config(&AccessRole::ALL)?)
}

/// What a driver reports of its array.
pub(super) struct DriverState {
    pub capabilities: Capabilities,
    /// Why its hardware does not answer.
    pub device_problem: Option<String>,
    /// Number of the calibration in use, 0 for none; `None` without telemetry.
    pub calibration: Option<u64>,
    /// The bits of its faults.
    pub faults: u32,
    /// What its mirrors do; `None` without telemetry.
    pub state: Option<ArrayState>,
}

fn ask_driver(args: &Args, bus: &Bus, array: usize) -> anyhow::Result<DriverState> {
    let room = bus.room().clone();
    let keys = room.array(array);
    let (telemetries, _telemetries) = arriving::<MirrorTelemetry>(bus, &keys.telemetry())?;
    let (statuses, _statuses) = arriving::<NodeStatus>(bus, &keys.driver_status())?;
    let payloads = fetch_capabilities(args, bus, &keys.capabilities())?;
    let until = Instant::now() + STATUS_WITHIN;
    let left = || until.saturating_duration_since(Instant::now());
    let telemetry = telemetries.recv_timeout(left()).ok();
    // The problem matters only with a fault.
    let device_problem = telemetry.as_ref().filter(|telemetry| telemetry.faults & fault::LINK != 0).map(|_| {
        let problem = statuses.recv_timeout(left()).map(|status| status.last_problem).unwrap_or_default();
        format!("a device of the driver does not answer: {}", printable(&problem))
    });
    match payloads.as_slice() {
        [] => anyhow::bail!("no driver in room \"{room}\" publishes the capabilities of an array"),
        [payload] => Ok(DriverState {
            capabilities: decode(payload)?,
            device_problem,
            calibration: telemetry.as_ref().map(|telemetry| telemetry.calibration),
            faults: telemetry.as_ref().map_or(0, |telemetry| telemetry.faults),
            state: telemetry.map(|telemetry| telemetry.state),
        }),
        several => Err(SeveralDrivers { count: several.len(), room: room.to_string() }.into()),
    }
}

/// The capabilities of an array. A process that connects to this one may still introduce itself.
fn fetch_capabilities(args: &Args, bus: &Bus, key: &str) -> Result<Vec<Vec<u8>>, BusError> {
    let until = Instant::now() + DRIVER_WAIT;
    loop {
        let payloads = bus.fetch(key, DRIVER_WAIT)?;
        if !payloads.is_empty() || args.listen.is_empty() || Instant::now() >= until {
            return Ok(payloads);
        }
        std::thread::sleep(FETCH_EVERY);
    }
}

/// The check of an array, with a warning where it is stopped or has a fault; a stop is named in place of faults.
/// An array that does not fit is advised on that first.
fn with_state(check: Check, driver: &DriverState) -> Check {
    let faults = fault::names(driver.faults);
    let (what, advice) = match driver.state {
        Some(ArrayState::Stopped) => {
            ("it is stopped".to_owned(), "release it with heliostat rearm when the mirrors may move")
        }
        _ if check.verdict != Verdict::Ok => return check,
        _ if !faults.is_empty() => {
            (format!("faults: {}", faults.join(", ")), "heliostat status and the log of the driver name the cause")
        }
        _ => return check,
    };
    let found = format!("{}; {what}", check.found);
    match check.verdict {
        Verdict::Ok | Verdict::Unknown => Check::warn("driver", found, advice),
        Verdict::Warn => Check { found, advice: format!("{advice}; {}", check.advice), ..check },
        Verdict::Fail => Check { found, advice: format!("{}; {advice}", check.advice), ..check },
    }
}

/// Why a range that does not reach all of the floor is no failure of an array; `None` where it is one.
pub(super) fn accepted_range(
    args: &Args,
    array: usize,
    driver: &DriverState,
    controller: Option<&ControllerState>,
) -> Option<&'static str> {
    let is_following = driver.state == Some(ArrayState::Following);
    if args.range.accept_small_range {
        Some("accepted by --accept-small-range")
    } else if is_following && controller.is_some_and(|controller| controller.fits(array)) {
        Some("the controller of the room accepts it, and the array follows")
    } else {
        None
    }
}

/// Whether the array fits the scenario. `accepted` is why a range that does not reach all of the floor is no failure.
pub(super) fn compare(index: usize, array: &Capabilities, scenario: &Scenario, accepted: Option<&str>) -> Check {
    let found = format!("{} ({}), {} x {} mirrors", array.hardware, array.driver, array.rows, array.columns);
    // The controller examines the capabilities in the same way.
    let examined = scenario
        .channel_model()
        .map_err(anyhow::Error::from)
        .and_then(|model| Ok(Examiner::new(scenario, &model, Force::default()).examine(index, array)?));
    let small_range = match examined {
        Ok(()) => None,
        Err(error) => match (error.downcast_ref::<Unfit>(), accepted) {
            (Some(unfit @ Unfit::Range { .. }), Some(reason)) => Some(format!("{unfit}: {reason}")),
            (Some(unfit), _) => return Check::fail("driver", found, describe_unfit(unfit)),
            (None, _) => return Check::fail("driver", found, format!("{error:#}")),
        },
    };
    let remarks = [small_range, clamp_remark(array, scenario), rate_remark(array, scenario)];
    let remarks: Vec<String> = remarks.into_iter().flatten().collect();
    if !remarks.is_empty() {
        return Check::warn("driver", found, remarks.join("; "));
    }
    let clock = match array.validity_clock {
        ValidityClock::SourceTime => "",
        ValidityClock::Arrival => ", counts validity from arrival",
    };
    Check::ok("driver", format!("{found}{clock}"))
}

/// Where the controller may command angles beyond the range of the array.
fn clamp_remark(array: &Capabilities, scenario: &Scenario) -> Option<String> {
    let range_deg = scenario.control.range_deg;
    let reach_rad = [array.roll.min_rad, array.yaw.min_rad, -array.roll.max_rad, -array.yaw.max_rad];
    let reach_rad = -reach_rad.into_iter().map(f64::from).fold(f64::NEG_INFINITY, f64::max);
    let reach_deg = reach_rad.to_degrees();
    (reach_rad + SAME_ANGLE_RAD < range_deg.to_radians()).then(|| {
        format!(
            "the controller may command {range_deg:.2} degrees, but the array clamps at {reach_deg:.2}: --set control.range_deg={:.2}",
            (reach_deg * 100.0).floor() / 100.0
        )
    })
}

/// Where the controller sends more commands than the array accepts.
fn rate_remark(array: &Capabilities, scenario: &Scenario) -> Option<String> {
    let (rate_hz, reports_hz) = (f64::from(array.command_rate_max_hz), scenario.streams.positions.rate_hz);
    (rate_hz > 0.0 && rate_hz < reports_hz).then(|| {
        format!(
            "it accepts {rate_hz} commands a second, but each of {reports_hz} reports a second is answered: lower streams.positions.rate_hz"
        )
    })
}

#[cfg(test)]
mod tests {
    use clap::Parser;
    use heliostat_proto::AxisLimits;

    use super::*;

    #[derive(Parser)]
    struct Flags {
        #[command(flatten)]
        args: Args,
    }

    #[test]
    fn the_advice_without_a_driver_is_that_for_the_reason() {
        let several = anyhow::Error::from(SeveralDrivers { count: 2, room: "lab".into() });
        assert_eq!(several.to_string(), "2 drivers answer in room \"lab\"; expected one");
        assert!(advice_without_driver(&several, || true).starts_with("stop one of them"));
        assert!(advice_without_driver(&anyhow::anyhow!("no driver"), || false).starts_with("start the driver"));
        let unencrypted = BusError::Unencrypted { endpoint: "tcp/127.0.0.1:7447".into() };
        let asked = ask_drivers(&Flags::parse_from(["doctor"]).args, Some(&Err(unencrypted.into())), 1);
        let error = asked[0].as_ref().err().expect("no session");
        assert!(advice_without_driver(error, || false).starts_with("correct the flag that the message names"));
    }

    /// Mirrors of the default scenario that turn by 4 degrees.
    fn small() -> (Scenario, Capabilities) {
        let scenario = Scenario::default();
        let shape = &scenario.mirrors.arrays()[0];
        let (rows, columns) = (shape.rows as u32, shape.columns as u32);
        let range = 4_f32.to_radians();
        let axis = AxisLimits { min_rad: -range, max_rad: range, ..AxisLimits::default() };
        let array = Capabilities { rows, columns, roll: axis, yaw: axis, ..Capabilities::default() };
        (scenario, array)
    }

    fn driver(state: Option<ArrayState>, faults: u32) -> DriverState {
        DriverState { capabilities: Capabilities::default(), device_problem: None, calibration: None, faults, state }
    }

    #[test]
    fn a_small_range_that_is_accepted_is_a_warning_with_its_share_and_who_has_accepted_it() {
        let (scenario, array) = small();
        let refused = compare(0, &array, &scenario, None);
        assert_eq!(refused.verdict, Verdict::Fail);
        assert!(refused.advice.ends_with("accept the range with --accept-small-range"), "{refused:?}");
        let accepted = compare(0, &array, &scenario, Some("accepted by --accept-small-range"));
        assert_eq!(accepted.verdict, Verdict::Warn);
        let expected = "expected 100 % of the floor: accepted by --accept-small-range; the controller may command ";
        assert!(accepted.advice.contains(expected), "{accepted:?}");
        let other = Capabilities { rows: array.rows + 1, ..array };
        assert_eq!(compare(0, &other, &scenario, Some("accepted")).verdict, Verdict::Fail, "another shape");
    }

    #[test]
    fn a_driver_that_no_endpoint_reaches_is_not_checked() {
        let args = Flags::parse_from(["doctor"]).args;
        let checks = check_drivers(&args, &[], &Scenario::default(), None);
        assert!(checks.len() == 1 && checks[0].verdict == Verdict::Unknown, "{checks:?}");
    }

    #[test]
    fn a_range_is_accepted_by_the_flag_or_by_a_controller_that_the_array_follows() {
        let flags = |given: &[&str]| Flags::parse_from([&["doctor"][..], given].concat()).args;
        let controller = ControllerState::default();
        let accepted = |given: &[&str], state, controller: Option<&ControllerState>| {
            accepted_range(&flags(given), 0, &driver(state, 0), controller)
        };
        let by_flag = accepted(&["--accept-small-range"], None, None);
        assert_eq!(by_flag, Some("accepted by --accept-small-range"));
        assert!(accepted(&[], Some(ArrayState::Following), Some(&controller)).is_some());
        assert_eq!(accepted(&[], Some(ArrayState::Parked), Some(&controller)), None);
        assert_eq!(accepted(&[], Some(ArrayState::Following), None), None);
    }

    #[test]
    fn an_array_that_fits_is_a_warning_while_it_is_stopped_or_has_a_fault() {
        let found = |state, faults| with_state(Check::ok("driver", "mirrors"), &driver(state, faults));
        let following = found(Some(ArrayState::Following), 0);
        assert_eq!((following.verdict, following.found.as_str()), (Verdict::Ok, "mirrors"));
        let stopped = found(Some(ArrayState::Stopped), 0);
        assert_eq!((stopped.verdict, stopped.found.as_str()), (Verdict::Warn, "mirrors; it is stopped"));
        let remark = Check::warn("driver", "mirrors", "the array clamps");
        let both = with_state(remark, &driver(Some(ArrayState::Stopped), 0));
        assert_eq!(both.found, "mirrors; it is stopped");
        assert_eq!(both.advice, "release it with heliostat rearm when the mirrors may move; the array clamps");
        let unfit = Check::fail("driver", "mirrors", "another number of mirrors");
        let both = with_state(unfit, &driver(Some(ArrayState::Stopped), 0));
        let expected = "another number of mirrors; release it with heliostat rearm when the mirrors may move";
        assert_eq!((both.verdict, both.advice.as_str()), (Verdict::Fail, expected));
        let jammed = found(Some(ArrayState::Following), fault::MIRROR | fault::SUPPLY);
        assert_eq!((jammed.verdict, jammed.found.as_str()), (Verdict::Warn, "mirrors; faults: mirror, supply"));
    }
}
