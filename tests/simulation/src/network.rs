//! The links between hosts: delay, loss, duplicates, order, partitions.

use rand::RngExt;

use crate::clock::{MS, TrueNs};
use crate::plan::{Fault, Role};
use crate::random::{Purpose, Rng, stream};

/// Longest delay of a message without a fault in ns.
pub(crate) const DELAY_MAX_NS: u64 = 2 * MS;

/// What happens to a message.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Carried {
    /// It arrives at these times.
    At(Vec<TrueNs>),
    /// It waits until the link is up again.
    Held,
    /// It is lost.
    Lost,
}

#[derive(Clone, Debug, Default)]
struct Link {
    /// In force, one for each fault.
    loss_per_mille: Vec<u32>,
    duplicate_per_mille: Vec<u32>,
    delay_ms: Vec<u64>,
    reorder_ms: Vec<u64>,
    /// Whether each partition in force holds messages.
    partitions: Vec<bool>,
    /// Arrival of the last message; a connection keeps the order.
    last: TrueNs,
    delay_ns: u64,
}

/// All links, by the numbers of their hosts.
pub(crate) struct Network {
    roles: Vec<Role>,
    links: Vec<Link>,
    rng: Rng,
}

impl Network {
    pub fn new(seed: u64, roles: &[Role]) -> Self {
        let mut rng = stream(seed, Purpose::Network);
        let count = roles.len() * roles.len();
        let link = |rng: &mut Rng| Link { delay_ns: rng.random_range(MS / 10..MS), ..Link::default() };
        let links = (0..count).map(|_| link(&mut rng)).collect();
        Self { roles: roles.to_vec(), links, rng }
    }

    /// Sends a message from a host to another at `now`.
    pub fn carry(&mut self, now: TrueNs, from: usize, to: usize) -> Carried {
        let index = self.index(from, to);
        let (link, rng) = (&mut self.links[index], &mut self.rng);
        let jitter_ns = rng.random_range(0..MS / 2);
        let (chance, copy) = (rng.random_range(0..1000), rng.random_range(0..1000));
        if let Some(holds) = link.partitions.first() {
            return if *holds { Carried::Held } else { Carried::Lost };
        }
        if link.loss_per_mille.iter().any(|per_mille| chance < *per_mille) {
            return Carried::Lost;
        }
        let late_ns = link.delay_ms.iter().sum::<u64>() * MS;
        let mut at = now + link.delay_ns + jitter_ns + late_ns;
        if let Some(spread_ms) = link.reorder_ms.iter().max() {
            at += rng.random_range(0..spread_ms * MS);
        } else {
            at = at.max(link.last + 1);
            link.last = at;
        }
        let mut times = vec![at];
        if link.duplicate_per_mille.iter().any(|per_mille| copy < *per_mille) {
            times.push(at + rng.random_range(1..30 * MS));
        }
        Carried::At(times)
    }

    /// When news of the connection itself, or what was held, arrives: after everything before it.
    pub fn carry_surely(&mut self, now: TrueNs, from: usize, to: usize) -> TrueNs {
        let index = self.index(from, to);
        let link = &mut self.links[index];
        let late_ns = link.delay_ms.iter().sum::<u64>() * MS;
        link.last = link.last.max(now + link.delay_ns + late_ns) + 1;
        link.last
    }

    /// Whether messages pass from a host to another.
    pub fn is_connected(&self, from: usize, to: usize) -> bool {
        self.links[self.index(from, to)].partitions.is_empty()
    }

    /// A fault of links begins; false for other faults.
    pub fn begin(&mut self, fault: &Fault) -> bool {
        match fault {
            Fault::Loss { from, to, per_mille } => self.link(*from, *to).loss_per_mille.push(*per_mille),
            Fault::Delay { from, to, ms } => self.link(*from, *to).delay_ms.push(*ms),
            Fault::Duplicate { from, to, per_mille } => self.link(*from, *to).duplicate_per_mille.push(*per_mille),
            Fault::Reorder { from, to, ms } => self.link(*from, *to).reorder_ms.push(*ms),
            Fault::Partition { pairs, holds } => {
                for (one, other) in pairs {
                    self.link(*one, *other).partitions.push(*holds);
                    self.link(*other, *one).partitions.push(*holds);
                }
            }
            _ => return false,
        }
        true
    }

    /// A fault of links ends; false for other faults.
    pub fn end(&mut self, fault: &Fault) -> bool {
        match fault {
            Fault::Loss { from, to, per_mille } => remove(&mut self.link(*from, *to).loss_per_mille, per_mille),
            Fault::Delay { from, to, ms } => remove(&mut self.link(*from, *to).delay_ms, ms),
            Fault::Duplicate { from, to, per_mille } => {
                remove(&mut self.link(*from, *to).duplicate_per_mille, per_mille)
            }
            Fault::Reorder { from, to, ms } => remove(&mut self.link(*from, *to).reorder_ms, ms),
            Fault::Partition { pairs, holds } => {
                for (one, other) in pairs {
                    remove(&mut self.link(*one, *other).partitions, holds);
                    remove(&mut self.link(*other, *one).partitions, holds);
                }
            }
            _ => return false,
        }
        true
    }

    fn link(&mut self, from: Role, to: Role) -> &mut Link {
        let number = |role: Role| self.roles.iter().position(|known| *known == role).unwrap_or_default();
        let index = self.index(number(from), number(to));
        &mut self.links[index]
    }

    fn index(&self, from: usize, to: usize) -> usize {
        from * self.roles.len() + to
    }
}

fn remove<T: PartialEq>(list: &mut Vec<T>, item: &T) {
    if let Some(index) = list.iter().position(|known| known == item) {
        list.remove(index);
    }
}
