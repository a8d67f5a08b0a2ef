//! The other controllers of the room, by their liveliness tokens.

use heliostat_proto::EPOCH_SLOTS;

use super::numbers::Rule;
use super::{PEERS_MAX, RANK_MAX, Standing, Tenure, TenureEvent};

impl Tenure {
    /// Source ids of the other controllers in the room.
    pub fn peers(&self) -> &[u64] {
        &self.peers
    }

    /// Another controller is in the room, or has left it.
    pub fn handle_controller(&mut self, peer: u64, is_present: bool) -> Option<TenureEvent> {
        let Rule::Live { source, .. } = self.rule else { return None };
        if peer == source || (!is_present && !self.peers.contains(&peer)) {
            return None;
        }
        if !is_present {
            self.remove_peer(peer);
        } else if !self.peers.contains(&peer) {
            self.add_peer(peer);
        }
        // A further token of the same remainder may be forged: its end is no end of the leader.
        if self.standing == Standing::Standby && self.leads(peer) {
            self.watch.set_left(!self.has_peer(peer));
        }
        let seen_ns = self.seen.map_or(0, |(seen_ns, _)| seen_ns);
        let is_back = is_present && self.contest.is_back(peer % EPOCH_SLOTS, seen_ns);
        self.watch.has_left &= !(is_back && self.standing == Standing::Leading);
        is_back.then_some(TenureEvent::Contested)
    }

    /// Keeps the controllers that may be the leader, and for the rank the others with the lowest source ids.
    fn add_peer(&mut self, peer: u64) {
        self.peers.push(peer);
        if self.peers.len() > PEERS_MAX {
            let others = self.peers.iter().filter(|known| !self.leads(**known));
            let removed = others.max().copied().unwrap_or(peer);
            self.peers.retain(|known| *known != removed);
        }
        if self.peers.contains(&peer) {
            self.guest.handle_joined(peer, self.seen.map(|(seen_ns, _)| seen_ns));
        }
    }

    fn remove_peer(&mut self, peer: u64) {
        self.peers.retain(|known| *known != peer);
        if !self.has_peer(peer) {
            let is_followed = self.leads(peer);
            self.guest.handle_left(peer, is_followed);
        }
    }

    /// Unanswered reports after which this standby takes over, without the back-off.
    pub fn rank(&self) -> u8 {
        let Rule::Live { source, .. } = self.rule else { return u8::MAX };
        let is_before = |peer: &&u64| **peer < source && !self.leads(**peer);
        let counted = || RANK_MAX.min(1 + self.peers.iter().filter(is_before).count() as u8);
        self.rank.unwrap_or_else(counted).max(1)
    }

    /// Standbys that have a rank of their own, this one included.
    pub(super) fn standbys(&self) -> u8 {
        RANK_MAX.min(1 + self.peers.iter().filter(|peer| !self.leads(**peer)).count() as u8)
    }

    /// Whether the array follows a controller with this source id, by its epoch.
    pub(super) fn leads(&self, peer: u64) -> bool {
        self.followed_epoch().is_some_and(|epoch| epoch % EPOCH_SLOTS == peer % EPOCH_SLOTS)
    }

    /// Whether the controller of an epoch is this one, or another one that is in the room.
    pub(super) fn is_present(&self, epoch: u64) -> bool {
        let Rule::Live { source, .. } = self.rule else { return false };
        source % EPOCH_SLOTS == epoch % EPOCH_SLOTS || self.has_peer(epoch)
    }

    /// Whether another controller with this remainder in its source id or epoch is in the room.
    pub(super) fn has_peer(&self, one: u64) -> bool {
        self.peers.iter().any(|peer| peer % EPOCH_SLOTS == one % EPOCH_SLOTS)
    }
}
