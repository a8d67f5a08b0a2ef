//! Passes recorded messages to a controller, and copies its commands.

use heliostat_core::core::{Controller, Decision};
use heliostat_core::inbox::Message;
use heliostat_core::refusal::{Refusal, Stream};
use heliostat_proto::{CodecError, InputKind, MirrorCommand, Nanos, decode};

/// What a message is to a controller, and for telemetry the index of the array.
pub(super) type Input = (InputKind, usize);

/// Passes a message to a controller without a decision.
pub(super) fn handle(controller: &mut Controller, (input, array): Input, data: &[u8], now: Nanos) {
    let (stream, read) = match input {
        InputKind::Users => (Stream::Users, pass(controller, data, now, |report| Message::Users(report))),
        InputKind::Channel => (Stream::Channel, pass(controller, data, now, |report| Message::Channel(report))),
        InputKind::Obstacles => (Stream::Obstacles, pass(controller, data, now, |report| Message::Obstacles(report))),
        InputKind::Orientation => {
            (Stream::Orientation, pass(controller, data, now, |report| Message::Orientation(report)))
        }
        InputKind::Leds => (Stream::Leds, pass(controller, data, now, |report| Message::Leds(report))),
        InputKind::Telemetry => {
            (Stream::Telemetry, pass(controller, data, now, |report| Message::Telemetry(array, report)))
        }
        InputKind::Decision | InputKind::LateDecision | InputKind::StaleDecision | InputKind::SilenceDecision => return,
    };
    if let Err(error) = read {
        controller.handle_malformed((stream, array), Refusal::from(&error), data);
    }
}

/// The commands of a decision, each with the index of its array.
pub(super) fn cloned(decision: Decision<'_>) -> Vec<(usize, MirrorCommand)> {
    decision.commands().map(|(array, command)| (array, command.clone())).collect()
}

fn pass<T: heliostat_proto::Message>(
    controller: &mut Controller,
    data: &[u8],
    now: Nanos,
    message: impl for<'a> Fn(&'a mut T) -> Message<'a>,
) -> Result<(), CodecError> {
    let mut report = decode::<T>(data)?;
    controller.handle_message(now, message(&mut report));
    Ok(())
}
