//! Tasks: the same seed gives the same run, and actions mean what the controller's code makes of
//! them.

use heliostat_channel::MirrorAngles;
use heliostat_core::core::Controller;
use heliostat_core::policy::{Fixed, build_fallback};
use heliostat_environment::action::ActionForm;
use heliostat_environment::episodes::{HeldOutEpisode, WARM};
use heliostat_environment::held_out::{best_angles, held_out_seed, held_out_state, held_out_world};
use heliostat_environment::score::Sample;
use heliostat_environment::task::{Dynamics, ObservationForm, Step, Task, TaskSettings};
use heliostat_environment::{ClosedLoop, EnvironmentError};
use heliostat_room::episode::Episode;
use heliostat_scenario::{Fallback, Scenario};

fn scenario(name: &str, overrides: &[&str]) -> Scenario {
    Scenario::builtin(name).unwrap().with_overrides(overrides).unwrap()
}

fn settings() -> Vec<TaskSettings> {
    let paper = TaskSettings {
        observation: ObservationForm::AngleState,
        ..TaskSettings::of_true_state(scenario("paper", &[]))
    };
    let office = TaskSettings {
        action: ActionForm::Weights,
        observation: ObservationForm::Belief,
        ..TaskSettings::closed_loop(scenario("office", &[]))
    };
    vec![
        TaskSettings::of_true_state(scenario("specular", &[])),
        TaskSettings::closed_loop(scenario("hall", &[])),
        paper,
        office,
    ]
}

/// An action whose components differ from each other and from step to step.
fn action(step: usize, len: usize) -> Vec<f32> {
    (0..len).map(|index| ((index * 7 + step * 3) % 11) as f32 / 10.0 - 0.5).collect()
}

/// The observation before the first step, and then each step with its observation.
fn run(task: &mut Task, steps: usize) -> Vec<(Step, Vec<f32>)> {
    let seen = |task: &Task| {
        let mut seen = vec![0.0; task.observation_len()];
        task.write_observation(&mut seen);
        seen
    };
    let mut rows = vec![(Step::default(), seen(task))];
    for index in 0..steps {
        let step = task.step(&action(index, task.action_len())).unwrap();
        rows.push((step, seen(task)));
    }
    rows
}

#[test]
fn a_reset_task_equals_a_new_one_of_the_same_seed() {
    for settings in settings() {
        let mut task = Task::new(settings.clone(), 3).unwrap();
        let first = run(&mut task, 12);
        assert!(first.iter().all(|(step, _)| step.reward.is_finite()));
        task.reset(4).unwrap();
        assert_ne!(run(&mut task, 12), first);
        task.reset(3).unwrap();
        assert_eq!(run(&mut task, 12), first, "{}", settings.scenario.name);
    }
}

#[test]
fn a_copy_continues_as_its_original() {
    for settings in settings() {
        let settings = TaskSettings { oracle: true, ..settings };
        let mut task = Task::new(settings.clone(), 3).unwrap();
        run(&mut task, 7);
        let mut copy = task.clone();
        let expected = run(&mut task, 12);
        assert_eq!(run(&mut copy, 12), expected, "{}", settings.scenario.name);
        assert_ne!(run(&mut task, 12), expected, "{}", settings.scenario.name);
    }
    let mut task = Task::new(TaskSettings::closed_loop(scenario("hall", &[])), 1).unwrap();
    task.begin_episode(&HeldOutEpisode::new(9, 0, 5, WARM)).unwrap();
    run(&mut task, 30);
    let mut copy = task.clone();
    assert_eq!(run(&mut copy, 20), run(&mut task, 20));
    assert_eq!(copy.sampling().unwrap().samples(), task.sampling().unwrap().samples());
}

#[test]
fn angles_of_the_caller_give_the_run_of_a_policy_that_proposes_the_same() {
    let scenario = scenario("hall", &[]);
    let begin = |policy| {
        let controller = Controller::new(&scenario, scenario.channel_model().unwrap(), policy, 1);
        ClosedLoop::new(Episode::new(&scenario, None, 5, 1_000_000_000).unwrap(), controller)
    };
    let policy = || build_fallback(Fallback::Nearest, &scenario).unwrap();
    let mut by_policy = begin(policy());
    let mut expected = Vec::new();
    while let Some((now, event)) = by_policy.poll_event(4_000_000_000) {
        if by_policy.deliver(now, event, &mut |_| {}).unwrap() {
            expected.push((now.room_ns, by_policy.room().actuator(0).angles().clone()));
        }
    }
    let mut by_caller = begin(Box::new(Fixed::flat(100)));
    let (mut caller, mut angles, mut now_ns) = (policy(), MirrorAngles::flat(100), 0);
    for (at_ns, wanted) in &expected {
        now_ns = by_caller.next_decision(now_ns).unwrap().room_ns;
        caller.act(&scenario.channel_model().unwrap(), by_caller.observation(), &mut angles).unwrap();
        by_caller.decide(&angles).unwrap();
        assert_eq!((now_ns, by_caller.room().actuator(0).angles()), (*at_ns, wanted));
    }
    assert!(expected.len() > 20, "{}", expected.len());
    assert_ne!(expected[5].1, expected[25].1);
}

#[test]
fn an_episode_of_a_comparison_is_sampled_at_its_times_whatever_the_steps() {
    let scenario = scenario("hall", &[]);
    let episode = HeldOutEpisode::new(9, 0, 5, WARM);
    let mut task = Task::new(TaskSettings::closed_loop(scenario.clone()), 1).unwrap();
    assert!(task.sampling().is_none());
    task.begin_episode(&episode).unwrap();
    let mut steps = 0;
    while !task.sampling().unwrap().is_over() {
        task.step(&[0.0; 200]).unwrap();
        steps += 1;
    }
    // The policy `flat` in the same episode.
    let controller = Controller::new(&scenario, scenario.channel_model().unwrap(), Box::new(Fixed::flat(100)), 1);
    let mut flat = ClosedLoop::new(episode.begun(&scenario, None).unwrap(), controller);
    let mut expected = Vec::new();
    for look_ns in episode.looks_ns() {
        while let Some((now, event)) = flat.poll_event(look_ns) {
            flat.deliver(now, event, &mut |_| {}).unwrap();
        }
        flat.advance(look_ns);
        if episode.instants_ns.contains(&look_ns) {
            expected.push(Sample::of(flat.room().world(), flat.room().angles()));
        }
    }
    // Bits, because NaN is the rate of blocked users where there is none.
    let bits = |samples: &[Sample]| samples.iter().map(|one| one.row().map(f64::to_bits)).collect::<Vec<_>>();
    assert_eq!(bits(task.sampling().unwrap().samples()), bits(&expected));
    assert!(expected.len() == 5 && steps > 20, "{steps}");
    task.reset(1).unwrap();
    assert!(task.sampling().is_none());
    let mut other = Task::new(TaskSettings::of_true_state(scenario), 1).unwrap();
    assert!(other.begin_episode(&episode).unwrap_err().to_string().contains("closed-loop"));
}

#[test]
fn a_state_of_a_comparison_is_sampled_once_in_its_held_out_room() {
    let mut settings = TaskSettings::of_true_state(scenario("specular", &[]));
    settings.settle_s = 3.0;
    let mut task = Task::new(settings, 1).unwrap();
    let (set, index) = held_out_state(5, 4, 9);
    assert_eq!((set, index), (7, 1));
    task.begin_state(held_out_seed(set, index)).unwrap();
    assert!(task.sampling().unwrap().samples().is_empty());
    let world = held_out_world(&task.settings().scenario, None, set, index).unwrap();
    let expected = Sample::of(&world, &MirrorAngles::flat(100));
    // The users have walked on before the second action.
    let steps = [0, 1].map(|_| task.step(&[0.0; 200]).unwrap());
    assert!(steps[0].sum_rate_mbps != steps[1].sum_rate_mbps, "{steps:?}");
    let sampling = task.sampling().unwrap();
    let [sample] = sampling.samples() else { panic!("{:?}", sampling.samples()) };
    assert_eq!(sample.row().map(f64::to_bits), expected.row().map(f64::to_bits));
    assert!(sampling.is_over());
    let mut closed = Task::new(TaskSettings::closed_loop(scenario("hall", &[])), 1).unwrap();
    assert!(closed.begin_state(1).unwrap_err().to_string().contains("static"));
}

#[test]
fn the_oracle_of_a_step_is_that_of_the_state_in_which_the_action_was_chosen() {
    let mut settings = TaskSettings::of_true_state(scenario("specular", &[]));
    settings.oracle = true;
    let mut task = Task::new(settings, 2).unwrap();
    let world = task.world().clone();
    let mut solver = heliostat_channel::Solver::new(5, 100);
    let best = best_angles(&mut solver, world.model(), world.scene(), world.min_rate_bps());
    let range_rad = heliostat_core::safety::Limits::new(&task.settings().scenario.control).range_rad();
    let action: Vec<f32> = best.roll.iter().chain(&best.yaw).map(|angle| (angle / range_rad) as f32).collect();
    let step = task.step(&action).unwrap();
    let oracle_mbps = step.oracle_mbps.unwrap();
    // The action is the oracle's own, rounded to f32.
    assert!((step.sum_rate_mbps / oracle_mbps - 1.0).abs() < 1e-4, "{step:?}");
}

#[test]
fn an_action_of_zero_weights_is_the_balanced_assignment_and_weights_differ_from_angles() {
    let weights =
        TaskSettings { action: ActionForm::Weights, ..TaskSettings::of_true_state(scenario("specular", &[])) };
    let mut task = Task::new(weights, 2).unwrap();
    assert_eq!(task.action_len(), 10);
    let balanced = task.step(&[0.0; 10]).unwrap();
    let mut flat = Task::new(TaskSettings::of_true_state(scenario("specular", &[])), 2).unwrap();
    assert_eq!(flat.action_len(), 200);
    assert!(balanced.sum_rate_mbps > 1.2 * flat.step(&[0.0; 200]).unwrap().sum_rate_mbps);
}

#[test]
fn actions_and_settings_outside_their_domain_are_refused_and_change_nothing() {
    let mut task = Task::new(TaskSettings::of_true_state(scenario("specular", &[])), 2).unwrap();
    assert!(matches!(task.step(&[0.0; 7]), Err(EnvironmentError::ActionLength { found: 7, expected: 200, .. })));
    let mut bad = vec![0.0; 200];
    bad[3] = f32::NAN;
    assert!(matches!(task.step(&bad), Err(EnvironmentError::NotFinite { index: 3, .. })));
    let mut other = Task::new(TaskSettings::of_true_state(scenario("specular", &[])), 2).unwrap();
    assert_eq!(run(&mut task, 3), run(&mut other, 3));

    let refused = |settings: TaskSettings| Task::new(settings, 1).err().unwrap().to_string();
    let known = TaskSettings::of_true_state(scenario("specular", &[]));
    for step_s in [0.0, f64::NAN, 1e9] {
        let reason = refused(TaskSettings { dynamics: Dynamics::Static { step_s }, ..known.clone() });
        assert!(reason.contains(&format!("step_s = {step_s}")), "{reason}");
    }
    assert!(refused(TaskSettings { settle_s: f64::NAN, ..known }).contains("settle_s = NaN"));
    let unknown = scenario("specular", &["mismatch.level=rough"]);
    assert!(refused(TaskSettings::of_true_state(unknown)).contains("mismatch.level"));
    let unknown = scenario("specular", &["mismatch.unknown_leds_m=[[1,1,3]]"]);
    assert!(refused(TaskSettings::of_true_state(unknown)).contains("mismatch.unknown_leds_m"));
}

#[test]
fn a_step_in_closed_loop_lasts_from_one_position_report_to_the_next_and_turns_the_mirrors() {
    let scenario = scenario("hall", &[]);
    let interval_s = 1.0 / scenario.streams.positions.rate_hz;
    let mut task = Task::new(TaskSettings::closed_loop(scenario), 2).unwrap();
    let (begun_s, mut rewards) = (task.world().time_s(), Vec::new());
    for _ in 0..10 {
        rewards.push(task.step(&vec![0.3; task.action_len()]).unwrap().reward);
    }
    assert!((task.world().time_s() - begun_s - 10.0 * interval_s).abs() < 1e-6, "{}", task.world().time_s() - begun_s);
    let range_rad = heliostat_core::safety::Limits::new(&task.settings().scenario.control).range_rad();
    assert!((task.angles().roll[0] - 0.3 * range_rad).abs() < 0.02, "{}", task.angles().roll[0]);
    assert!(rewards.windows(2).all(|pair| pair[0] != pair[1]), "{rewards:?}");
}
