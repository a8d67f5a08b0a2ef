//! The attacker: publishes payloads that no honest process publishes, from those that it has
//! received.

use std::collections::{BTreeMap, VecDeque};
use std::rc::Rc;

use heliostat_proto::{
    ArrayState, Capabilities, EmergencyStop, MirrorCommand, MirrorTelemetry, SafetyReport, Stamp, StopAction,
    UserReport, decode,
};
use rand::RngExt;

use super::{Context, Incoming, encoded};
use crate::clock::{MS, TrueNs};
use crate::plan::Attack;
use crate::random::Rng;
use crate::topic::Topic;

/// Time between two payloads of an attack in ns.
const INTERVAL_NS: u64 = 20 * MS;

/// Payloads of a topic that are kept.
const KEPT: usize = 80;

/// Payloads of a topic, each with the true time of its arrival.
type Kept = VecDeque<(TrueNs, Rc<[u8]>)>;

/// A process of an attacker.
pub(crate) struct Attacker {
    source: u64,
    kept: BTreeMap<Topic, Kept>,
    active: Vec<Attack>,
    due_ns: u64,
    stops: u64,
    rng: Rng,
}

impl Attacker {
    pub fn start(source: u64, rng: Rng, ctx: &Context<'_>) -> Self {
        Self { source, kept: BTreeMap::new(), active: Vec::new(), due_ns: ctx.at.local_ns, stops: 0, rng }
    }

    pub fn next_ns(&self) -> Option<u64> {
        (!self.active.is_empty()).then_some(self.due_ns)
    }

    pub fn handle(&mut self, incoming: &Incoming, ctx: &Context<'_>) {
        let Incoming::Payload { topic, payload, .. } = incoming else { return };
        let kept = self.kept.entry(*topic).or_default();
        kept.push_back((ctx.now, payload.clone()));
        if kept.len() > KEPT {
            kept.pop_front();
        }
    }

    pub fn begin(&mut self, attack: Attack, ctx: &mut Context<'_>) {
        self.active.push(attack);
        self.due_ns = ctx.at.local_ns + INTERVAL_NS;
        self.publish(attack, ctx);
    }

    pub fn end(&mut self, attack: Attack) {
        if let Some(index) = self.active.iter().position(|known| *known == attack) {
            self.active.remove(index);
        }
    }

    pub fn wake(&mut self, ctx: &mut Context<'_>) {
        if ctx.at.local_ns < self.due_ns {
            return;
        }
        self.due_ns = ctx.at.local_ns + INTERVAL_NS;
        for attack in self.active.clone() {
            if attack != Attack::ForeignStop {
                self.publish(attack, ctx);
            }
        }
    }

    fn publish(&mut self, attack: Attack, ctx: &mut Context<'_>) {
        match attack {
            Attack::Truncated | Attack::WrongKind | Attack::Replayed | Attack::Stale => self.repeat(attack, ctx),
            Attack::ForgedTelemetry | Attack::OwnTelemetry | Attack::OwnTelemetryStopped => {
                self.forge_telemetry(attack, ctx);
            }
            Attack::OutsideUsers | Attack::ForeignUsers | Attack::FarUsers | Attack::LastUsers => {
                self.forge_users(attack, ctx)
            }
            Attack::ForgedCapabilities => {
                let stamp = Stamp { source: self.source, sequence: 1, time_ns: ctx.at.room_ns };
                let forged = Capabilities { stamp, rows: 7, columns: 1, ..Capabilities::default() };
                ctx.publish(Topic::Capabilities(0), encoded(&forged));
            }
            Attack::ForgedSafety => {
                let stamp = Stamp { source: self.source, sequence: 1, time_ns: ctx.at.room_ns };
                let forged = SafetyReport { stamp, epoch: u64::MAX, validity_max_ms: 1, ..SafetyReport::default() };
                ctx.publish(Topic::Safety(0), encoded(&forged));
            }
            Attack::ForeignStop => {
                self.stops += 1;
                let stamp = Stamp { source: self.source, sequence: self.stops, time_ns: ctx.at.room_ns };
                let order = EmergencyStop { stamp, action: StopAction::Stop, ..EmergencyStop::default() };
                ctx.publish(Topic::Stop, encoded(&order));
            }
            _ => self.forge_command(attack, ctx),
        }
    }

    /// Publishes received payloads again, perhaps damaged.
    fn repeat(&mut self, attack: Attack, ctx: &mut Context<'_>) {
        for (topic, kept) in &self.kept {
            let of_age = |at: TrueNs| attack != Attack::Stale || ctx.now - at > 1000 * MS;
            let Some((_, payload)) = kept.iter().rev().find(|(at, _)| of_age(*at)) else { continue };
            let mut payload = payload.to_vec();
            match attack {
                Attack::Truncated => payload.truncate(self.rng.random_range(0..payload.len().max(1))),
                Attack::WrongKind if payload.len() > 1 => {
                    payload[self.rng.random_range(0..2)] ^= self.rng.random_range(1..=255);
                }
                _ => {}
            }
            ctx.publish(*topic, payload);
        }
    }

    fn forge_command(&mut self, attack: Attack, ctx: &mut Context<'_>) {
        let commands = self.kept.iter().filter(|(topic, _)| matches!(topic, Topic::Command(_)));
        for (topic, kept) in commands {
            let Some(Ok(mut command)) = kept.back().map(|(_, payload)| decode::<MirrorCommand>(payload)) else {
                continue;
            };
            command.time_ns = ctx.at.room_ns;
            match attack {
                Attack::LastEpoch => command.epoch = u64::MAX,
                Attack::HigherEpoch => (command.epoch, command.sequence) = (command.epoch + 30_000, 1),
                Attack::LowerEpoch => (command.epoch, command.sequence) = (command.epoch.saturating_sub(5000), 1),
                Attack::FarSequence => command.sequence += 900_000,
                Attack::LastSequence => command.sequence = u64::MAX,
                Attack::WildAngles => command.roll.fill(1e30),
                Attack::LongValidity => {
                    (command.sequence, command.validity_ms) = (command.sequence + 1, u32::MAX);
                }
                Attack::WrongCount => {
                    command.roll.pop();
                    command.yaw.pop();
                }
                _ => {}
            }
            let mut payload = encoded(&command);
            if attack == Attack::NotANumber {
                let end = payload.len();
                payload[end - 4..].copy_from_slice(&f32::NAN.to_le_bytes());
            }
            ctx.publish(*topic, payload);
        }
    }

    fn forge_telemetry(&mut self, attack: Attack, ctx: &mut Context<'_>) {
        for (topic, kept) in self.kept.iter().filter(|(topic, _)| matches!(topic, Topic::Telemetry(_))) {
            let Some(Ok(mut report)) = kept.back().map(|(_, payload)| decode::<MirrorTelemetry>(payload)) else {
                continue;
            };
            report.stamp.sequence += 1;
            report.stamp.time_ns = ctx.at.room_ns;
            match attack {
                Attack::OwnTelemetryStopped => report.state = ArrayState::Stopped,
                Attack::OwnTelemetry => report.epoch = u64::MAX,
                _ => (report.stamp.source, report.epoch) = (self.source, u64::MAX),
            }
            ctx.publish(*topic, encoded(&report));
        }
    }

    fn forge_users(&mut self, attack: Attack, ctx: &mut Context<'_>) {
        let latest = self.kept.get(&Topic::Users).and_then(VecDeque::back);
        let Some(Ok(mut report)) = latest.map(|(_, payload)| decode::<UserReport>(payload)) else { return };
        match attack {
            Attack::OutsideUsers => {
                report.stamp.sequence += 1;
                report.users.iter_mut().for_each(|user| user.position_m = [99.0; 3]);
            }
            Attack::FarUsers => report.stamp.sequence += 900_000,
            Attack::LastUsers => report.stamp.sequence = u64::MAX,
            _ => report.stamp.source = self.source,
        }
        ctx.publish(Topic::Users, encoded(&report));
    }
}
