//! Liveliness tokens: which process each host knows to be alive.
//!
//! A process that ends loses its token at once where it is connected. A host that is not reached, or
//! whose process is frozen, loses it after the lease.

use heliostat_proto::NodeKind;

use super::connections::LEASE_NS;
use super::{Event, World};
use crate::hosts::Incoming;
use crate::plan::Role;

impl World {
    /// Compares what each host has seen with what it can see, and delivers the differences.
    pub(super) fn update_presence(&mut self) {
        for observer in 0..self.hosts.len() {
            let is_observer = matches!(self.hosts[observer].role, Role::Controller(_) | Role::Calibration);
            if !is_observer || self.hosts[observer].process.is_none() {
                continue;
            }
            for subject in 0..self.hosts.len() {
                if let Some(node) = kind(self.hosts[subject].role).filter(|_| subject != observer) {
                    self.update_pair(observer, subject, node);
                }
            }
        }
    }

    fn update_pair(&mut self, observer: usize, subject: usize, node: NodeKind) {
        let is_reached = self.network.is_connected(subject, observer) && self.hosts[subject].frozen == 0;
        let seen = self.hosts[observer].sees[subject];
        let alive = self.hosts[subject].has_token().then_some(self.hosts[subject].source);
        let lost_since = self.hosts[observer].lost_since[subject];
        let sees = match lost_since {
            _ if is_reached => alive,
            Some(since) if self.now - since >= LEASE_NS => None,
            Some(_) => seen,
            None => {
                self.schedule(self.now + LEASE_NS, Event::Presence);
                seen
            }
        };
        self.hosts[observer].lost_since[subject] = if is_reached { None } else { lost_since.or(Some(self.now)) };
        if sees == seen {
            return;
        }
        self.hosts[observer].sees[subject] = sees;
        let (ended, begun) = (seen.map(|source| (source, false)), sees.map(|source| (source, true)));
        for (source, is_alive) in ended.into_iter().chain(begun) {
            let at = self.network.carry_surely(self.now, subject, observer);
            let generation = self.hosts[observer].generation;
            let incoming = Incoming::Presence { node, source, is_alive };
            self.schedule(at, Event::Deliver { to: observer, generation, incoming });
        }
    }
}

/// The kind of process in the token of a role.
fn kind(role: Role) -> Option<NodeKind> {
    match role {
        Role::Tracker => Some(NodeKind::Tracker),
        Role::Array(_) => Some(NodeKind::Driver),
        Role::Controller(_) | Role::Calibration => Some(NodeKind::Controller),
        Role::Operator | Role::Attacker => None,
    }
}
