//! The processes of a room. Each reads its own clock and publishes through its [`Context`].

pub(crate) mod adapter;
pub(crate) mod array;
pub(crate) mod attacker;
pub(crate) mod calibration;
pub(crate) mod controller;
pub(crate) mod device;
pub(crate) mod disk;
pub(crate) mod operator;
mod policy;
mod shadow;
pub(crate) mod tracker;

use std::rc::Rc;

use heliostat_array::moment::Moment;
use heliostat_proto::NodeKind;

use crate::clock::TrueNs;
use crate::monitor::Monitor;
use crate::mutation::Mutation;
use crate::topic::Topic;

/// What arrives at a host.
#[derive(Clone, Debug)]
pub(crate) enum Incoming {
    /// A payload of a topic, and the number of the host that published it.
    Payload { topic: Topic, from: usize, payload: Rc<[u8]> },
    /// A liveliness token appeared or ended.
    Presence { node: NodeKind, source: u64, is_alive: bool },
}

/// What a host publishes.
#[derive(Debug)]
pub(crate) struct Outgoing {
    pub topic: Topic,
    pub payload: Vec<u8>,
    /// To one host, as the answer to its query; else to all subscribers.
    pub to: Option<usize>,
    /// How long after the event.
    pub after_ns: u64,
}

/// What a host has while it handles an event.
pub(crate) struct Context<'a> {
    pub now: TrueNs,
    /// Both times of its own clock.
    pub at: Moment,
    pub monitor: &'a mut Monitor,
    pub mutation: Option<Mutation>,
    pub out: Vec<Outgoing>,
    /// For how long it handles no further event.
    pub busy_ns: u64,
}

impl Context<'_> {
    /// Publishes a payload.
    pub fn publish(&mut self, topic: Topic, payload: Vec<u8>) {
        self.out.push(Outgoing { topic, payload, to: None, after_ns: 0 });
    }

    pub fn has(&self, mutation: Mutation) -> bool {
        self.mutation == Some(mutation)
    }
}

/// The bytes of a message; a message that does not encode is a violation elsewhere.
pub(crate) fn encoded<M: heliostat_proto::Message>(message: &M) -> Vec<u8> {
    let mut payload = Vec::new();
    if heliostat_proto::encode(message, &mut payload).is_err() {
        payload.clear();
    }
    payload
}
