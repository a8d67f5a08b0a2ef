//! Ceilings of a closed loop: a policy that observes the true room instead of reports.
//!
//! It decides at the times of the position reports, and its commands turn the same mirrors. It
//! knows users, bodies, obstacles, orientations and equipment, at the time of the decision or in
//! the middle of the time in which its command is in force. What remains is the loss by the rate of
//! the decisions and by the mirrors. The offsets of mounted mirrors stay unknown.

use std::ops::Range;

use anyhow::Context;
use heliostat_array::moment::Moment;
use heliostat_array::rules::Refusal;
use heliostat_channel::{ChannelModel, MirrorAngles, Vec3};
use heliostat_core::observation::{Observation, RoomState};
use heliostat_core::policy::Policy;
use heliostat_core::safety::Limits;
use heliostat_proto::MirrorCommand;
use heliostat_room::SimulatedRoom;
use heliostat_room::episode::{Episode, Event};
use heliostat_room::reports::Report;
use heliostat_room::world::World;
use heliostat_scenario::Scenario;

/// The time of the room that a policy knows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Known {
    /// The time of the decision.
    Present,
    /// The middle of the time in which the command is in force.
    Future,
}

impl Known {
    /// The suffix of a policy's name.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Present => "true-present",
            Self::Future => "true-future",
        }
    }
}

/// A policy in a room that it knows.
pub(super) struct Ceiling {
    episode: Episode,
    policy: Box<dyn Policy>,
    observation: Observation,
    limits: Limits,
    proposed: MirrorAngles,
    command: MirrorCommand,
    /// From a decision to the known room in s.
    ahead_s: f64,
}

impl Ceiling {
    /// A policy in the room of an episode.
    pub fn new(scenario: &Scenario, episode: Episode, policy: Box<dyn Policy>, known: Known) -> Self {
        let model = episode.room().world().model();
        let mut limits = Limits::new(&scenario.control);
        let mut settling_s = 0.0_f64;
        // All arrays of a scenario have the same actuator.
        for capabilities in episode.capabilities() {
            limits.narrow(&capabilities.roll, &capabilities.yaw);
            settling_s = settling_s.max(capabilities.roll.settling_s.max(capabilities.yaw.settling_s).into());
        }
        let mirrors = model.mirrors.len();
        Self {
            ahead_s: match known {
                Known::Present => 0.0,
                Known::Future => settling_s + 0.5 / scenario.streams.positions.rate_hz,
            },
            observation: Observation::new(model, scenario.users.count),
            proposed: MirrorAngles::flat(mirrors),
            command: MirrorCommand {
                epoch: 1,
                validity_ms: scenario.control.command_validity_ms(),
                roll: vec![0.0; mirrors],
                yaw: vec![0.0; mirrors],
                ..MirrorCommand::default()
            },
            episode,
            policy,
            limits,
        }
    }

    /// Runs until the last of these times and calls `look` with each and with the room at it.
    pub fn run(&mut self, times_ns: &[u64], look: &mut dyn FnMut(u64, &SimulatedRoom)) -> anyhow::Result<()> {
        for at_ns in times_ns {
            while let Some((now, event)) = self.episode.poll_event(*at_ns) {
                let Event::Report(Report::Users(report)) = event else { continue };
                if !report.users.is_empty() && self.decide(now.room_ns)? {
                    self.command.answers = report.tick;
                    self.send(now).context("an array refused a command")?;
                }
            }
            self.episode.advance(*at_ns);
            look(*at_ns, self.episode.room());
        }
        Ok(())
    }

    /// Gives each array its part of the command.
    fn send(&mut self, now: Moment) -> Result<(), Refusal> {
        let arrays = self.episode.room().world().model().mirrors.ranges();
        let ranges: Vec<Range<usize>> = arrays.map(|(_, mirrors)| mirrors).collect();
        for (array, mirrors) in ranges.into_iter().enumerate() {
            let (roll, yaw) = (self.command.roll[mirrors.clone()].to_vec(), self.command.yaw[mirrors].to_vec());
            let part = MirrorCommand { roll, yaw, ..self.command };
            self.episode.handle_command(array, now, &part)?;
        }
        Ok(())
    }

    /// Completes the command for the known room; false without users in it.
    fn decide(&mut self, now_ns: u64) -> anyhow::Result<bool> {
        let mut world = self.episode.room().world().clone();
        world.step(self.ahead_s);
        if world.users().is_empty() {
            return Ok(false);
        }
        let model = world.model();
        observe(&world, model, &mut self.observation);
        if let Some([roll, yaw]) = self.limits.narrow_axes_rad() {
            self.observation.scene.restrict_to_range(model, &roll, &yaw);
        }
        self.policy.act(model, &self.observation, &mut self.proposed)?;
        self.limits.bound(&self.observation.angles, f64::INFINITY, &mut self.proposed);
        self.observation.angles.copy_from(&self.proposed);
        self.command.sequence += 1;
        self.command.time_ns = now_ns;
        let narrow = |from: &[f64], to: &mut [f32]| to.iter_mut().zip(from).for_each(|(to, from)| *to = *from as f32);
        narrow(&self.proposed.roll, &mut self.command.roll);
        narrow(&self.proposed.yaw, &mut self.command.yaw);
        Ok(true)
    }
}

fn observe(world: &World, model: &ChannelModel, observation: &mut Observation) {
    let velocities = world.users().iter().map(|user| Vec3::new(user.velocity[0], user.velocity[1], 0.0));
    observation.set_state(
        model,
        &RoomState {
            tick: 0,
            positions: world.positions(),
            orientations: Some(world.orientations()),
            velocities: &velocities.collect::<Vec<_>>(),
            min_rate_bps: world.min_rate_bps(),
            blockers: world.blockers(),
            forced: world.forced(),
            measured_los_gain: None,
        },
    );
    observation.ids.copy_from_slice(world.ids());
}
