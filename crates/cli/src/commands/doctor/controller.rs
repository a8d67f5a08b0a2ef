//! What a running room announces, and what its controller has learned about it.

use std::time::Instant;

use heliostat_bus::arriving::arriving;
use heliostat_bus::{Bus, BusError};
use heliostat_proto::array_keys::array_name;
use heliostat_proto::gauges::{ServedLight, TrackerNoise};
use heliostat_proto::{MirrorTelemetry, NodeKind, NodeStatus, RoomGeometry, STATUS_WITHIN};
use heliostat_service::printable::printable;
use heliostat_ui::controllers::{controller_name, leading};

use super::check::Check;
use super::system::CONNECTED_WITHIN;

/// A tracker is noisier than stated if a learned deviation is larger than the stated one by this factor.
const NOISIER: f64 = 1.5;

/// A tracker within this deviation needs no warning, in m and in m/s.
const LEAST: f64 = 5e-3;

/// What to do without a controller.
const START_CONTROLLER: &str = "without one no command reaches the mirrors: check --room, start heliostat controller, or add its endpoint or router to --connect";

/// What to do with a controller that does not command an array.
const FIT_ARRAY: &str = "only the other arrays get its commands: start it with what this line names, or with the --scenario and --set of the room";

/// What to do with a controller that commands nothing.
const FIT_CONTROLLER: &str =
    "it sends no commands: start it with what this line names, or with the --scenario and --set of the room";

/// What to do about reports that are refused.
const CORRECT_REPORTS: &str =
    "no report reaches a decision: correct what this line names, in the tracker or in its clock";

/// What a running room answers.
#[derive(Debug, Default)]
pub(super) struct Answers {
    /// The controller that leads.
    pub controller: Option<ControllerState>,
    /// The geometry that the simulator announces, as TOML.
    pub room: Option<String>,
}

/// What a controller says about itself and its room.
#[derive(Debug, Default)]
pub(super) struct ControllerState {
    /// Its source id in words.
    pub name: String,
    /// The hash of its scenario.
    pub scenario: String,
    /// The geometry that it announces, as TOML.
    pub geometry: Option<String>,
    /// The light of served users.
    pub light: Vec<ServedLight>,
    /// The noise of its tracker.
    pub noise: Option<TrackerNoise>,
    /// Why it refuses every position report.
    pub refused: Option<String>,
    /// Which arrays get no commands: they do not fit its scenario.
    pub unfit: Option<UnfitArrays>,
}

/// Arrays that do not fit the scenario of a controller.
#[derive(Debug)]
pub(super) struct UnfitArrays {
    /// What was found, in words.
    found: String,
    /// Their names; none where no array fits.
    names: Vec<String>,
}

impl UnfitArrays {
    /// No array fits.
    fn is_every(&self) -> bool {
        self.names.is_empty()
    }
}

impl ControllerState {
    /// Whether the array with this index fits its scenario.
    pub fn fits(&self, array: usize) -> bool {
        let is_unfit = |unfit: &UnfitArrays| unfit.is_every() || unfit.names.contains(&array_name(array));
        !self.unfit.as_ref().is_some_and(is_unfit)
    }
}

/// Asks the room and the controller that leads; the checks by the answer of the controller, none without a session.
pub(super) fn checks(bus: Option<&Bus>) -> (Answers, Vec<Check>) {
    let Some(bus) = bus else { return (Answers::default(), Vec::new()) };
    match ask(bus) {
        Ok(answers) => {
            let absent = || vec![Check::warn("controller", "no controller answers", START_CONTROLLER)];
            let checks = answers.controller.as_ref().map_or_else(absent, check_state);
            (answers, checks)
        }
        Err(error) => (Answers::default(), vec![Check::fail("controller", error.to_string(), START_CONTROLLER)]),
    }
}

fn ask(bus: &Bus) -> Result<Answers, BusError> {
    let room = bus.room();
    let (statuses, _statuses) = arriving::<NodeStatus>(bus, &room.status(NodeKind::Controller))?;
    let (telemetry, _telemetry) = arriving::<MirrorTelemetry>(bus, &room.telemetry())?;
    let (of_controllers, _controllers) = arriving::<RoomGeometry>(bus, &room.geometry(NodeKind::Controller))?;
    let (of_simulator, _simulator) = arriving::<RoomGeometry>(bus, &room.geometry(NodeKind::SimNode))?;
    if !bus.wait_connected(CONNECTED_WITHIN) {
        return Ok(Answers::default());
    }
    // The time for a status begins with the connection.
    let until = Instant::now() + STATUS_WITHIN;
    let left = || until.saturating_duration_since(Instant::now());
    let all = std::iter::from_fn(|| statuses.recv_timeout(left()).ok()).collect();
    // The last epoch of the same time: one of before a takeover would name the former leader.
    let status = leading(all, telemetry.try_iter().last().map(|telemetry| telemetry.epoch));
    let controller = status.map(|status| {
        // Another controller can announce another geometry.
        let own = of_controllers.try_iter().filter(|geometry| geometry.stamp.source == status.stamp.source).last();
        ControllerState {
            name: controller_name(status.stamp.source),
            light: ServedLight::all_of(&status),
            noise: TrackerNoise::of(&status),
            refused: refused(&status),
            unfit: unfit(&status),
            scenario: status.scenario,
            geometry: own.map(|geometry| geometry.scenario),
        }
    });
    Ok(Answers { controller, room: of_simulator.try_iter().last().map(|geometry| geometry.scenario) })
}

/// Why a controller refuses every position report.
fn refused(status: &NodeStatus) -> Option<String> {
    let is_refused = status.state == NodeStatus::REPORTS_REFUSED;
    is_refused.then(|| format!("position reports are refused: {}", printable(&status.last_problem)))
}

/// Which arrays get no commands of a controller, because they do not fit its scenario.
fn unfit(status: &NodeStatus) -> Option<UnfitArrays> {
    let names = status.unfit_arrays()?;
    let of = if names.is_empty() { String::new() } else { format!(" {}", printable(&names.join(" and "))) };
    Some(UnfitArrays {
        found: format!(
            "the array{of} does not fit the scenario of controller {}: {}",
            controller_name(status.stamp.source),
            status.last_problem
        ),
        names: names.into_iter().map(str::to_owned).collect(),
    })
}

/// The checks of a controller that answers. The expectations of a scenario that no array fits say nothing about the
/// room.
fn check_state(state: &ControllerState) -> Vec<Check> {
    let is_every_unfit = state.unfit.as_ref().is_some_and(UnfitArrays::is_every);
    let advice = if is_every_unfit { FIT_CONTROLLER } else { FIT_ARRAY };
    let unfit = state.unfit.iter().map(|unfit| Check::fail("controller", unfit.found.clone(), advice));
    let refused = state.refused.iter().map(|found| Check::fail("tracker", found.clone(), CORRECT_REPORTS));
    // What it learned from the reports before says nothing about those that it refuses.
    let noise = state.noise.iter().filter(|_| state.refused.is_none());
    let learned = noise.map(check_tracker).chain(state.light.iter().map(check_light));
    unfit.chain(refused).chain(learned.filter(|_| !is_every_unfit)).collect()
}

/// Whether the reports have the noise that the scenario states.
fn check_tracker(noise: &TrackerNoise) -> Check {
    let found = noise.to_string();
    let TrackerNoise { position_m, position_stated_m, velocity_m_s, velocity_stated_m_s } = *noise;
    let noisier = |learned: f64, stated: f64| learned > LEAST.max(NOISIER * stated);
    if !noisier(position_m, position_stated_m) && !noisier(velocity_m_s, velocity_stated_m_s) {
        return Check::ok("tracker", found);
    }
    let advice = format!(
        "the reports are noisier than the scenario states: improve the tracker, or state its noise: \
         --set streams.positions.noise_m={position_m:.3} --set streams.positions.velocity_noise_m_s={velocity_m_s:.3}"
    );
    Check::warn("tracker", found, advice)
}

/// Whether served users receive the light that the controller expects.
fn check_light(light: &ServedLight) -> Check {
    match light.off_since_s {
        None => Check::ok("light", light.to_string()),
        Some(_) => Check::warn("light", light.to_string(), light.advice()),
    }
}

#[cfg(test)]
mod tests {
    use super::super::check::Verdict;
    use super::*;

    #[test]
    fn a_controller_whose_scenario_the_array_does_not_fit_is_the_only_fault() {
        let noise =
            TrackerNoise { position_m: 1.0, position_stated_m: 0.0, velocity_m_s: 1.0, velocity_stated_m_s: 0.0 };
        let state = |count| {
            let counters = vec![(NodeStatus::ARRAY_UNFIT.to_owned(), count)];
            let status = NodeStatus { counters, last_problem: "49 mirrors".into(), ..NodeStatus::default() };
            ControllerState { noise: Some(noise), unfit: unfit(&status), ..ControllerState::default() }
        };
        let checks = check_state(&state(1));
        assert_eq!((checks.len(), checks[0].verdict), (1, Verdict::Fail));
        assert!(
            checks[0].found.contains("does not fit") && checks[0].found.contains("49 mirrors"),
            "{}",
            checks[0].found
        );
        assert_eq!(checks[0].advice, FIT_CONTROLLER);
        assert!(!state(1).fits(0) && state(0).fits(0));
        assert_eq!(check_state(&state(0))[0].verdict, Verdict::Warn, "the tracker");
    }

    #[test]
    fn refused_reports_are_a_fault_in_place_of_the_noise_learned_before() {
        let noise =
            TrackerNoise { position_m: 1.0, position_stated_m: 0.0, velocity_m_s: 1.0, velocity_stated_m_s: 0.0 };
        let found = |state: &str| {
            let (state, last_problem) = (state.to_owned(), "users refused: a report is 60.0 s old".to_owned());
            let status = NodeStatus { state, last_problem, ..NodeStatus::default() };
            let state = ControllerState { noise: Some(noise), refused: refused(&status), ..ControllerState::default() };
            let checks = check_state(&state);
            assert_eq!(checks.len(), 1, "one line for the tracker");
            (checks[0].verdict, checks[0].found.clone())
        };
        let text = "position reports are refused: users refused: a report is 60.0 s old".to_owned();
        assert_eq!(found(NodeStatus::REPORTS_REFUSED), (Verdict::Fail, text));
        assert_eq!(found("running").0, Verdict::Warn);
    }

    #[test]
    fn one_unfit_array_of_several_is_named_beside_what_the_controller_has_learned() {
        let counters = [NodeStatus::ARRAY_UNFIT.to_owned(), format!("{}mirrors-1", NodeStatus::ARRAY_UNFIT_OF)];
        let status = NodeStatus { counters: counters.map(|name| (name, 1)).into(), ..NodeStatus::default() };
        let light = ServedLight { of: "mirrors".into(), ratio: 0.5, off_since_s: Some(3.0) };
        let state = ControllerState { light: vec![light], unfit: unfit(&status), ..ControllerState::default() };
        assert_eq!([0, 1].map(|array| state.fits(array)), [true, false]);
        let checks = check_state(&state);
        assert_eq!(checks.iter().map(|check| check.verdict).collect::<Vec<_>>(), [Verdict::Fail, Verdict::Warn]);
        assert!(checks[0].found.starts_with("the array mirrors-1 does not fit"), "{}", checks[0].found);
        assert_eq!(checks[0].advice, FIT_ARRAY);
    }

    #[test]
    fn a_tracker_with_twice_the_stated_noise_is_a_warning_with_the_learned_one() {
        let noise = |position_m| TrackerNoise {
            position_m,
            position_stated_m: 0.05,
            velocity_m_s: 0.1,
            velocity_stated_m_s: 0.1,
        };
        let (stated, doubled) = (check_tracker(&noise(0.06)), check_tracker(&noise(0.1)));
        assert_eq!((stated.verdict, doubled.verdict), (Verdict::Ok, Verdict::Warn));
        assert!(doubled.advice.contains("streams.positions.noise_m=0.100"), "{}", doubled.advice);
    }

    #[test]
    fn a_deviation_of_some_millimetres_is_no_warning_where_the_scenario_states_none() {
        let noise = |position_m| TrackerNoise {
            position_m,
            position_stated_m: 0.0,
            velocity_m_s: 0.0,
            velocity_stated_m_s: 0.0,
        };
        let (small, large) = (check_tracker(&noise(0.004)), check_tracker(&noise(0.006)));
        assert_eq!((small.verdict, large.verdict), (Verdict::Ok, Verdict::Warn));
    }
}
