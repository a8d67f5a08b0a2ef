//! Passes recorded messages to a controller.

use heliostat_decide::core::Controller;
use heliostat_decide::inbox::Message;
use heliostat_decide::refusal::{Refusal, Stream};
use heliostat_proto::{CodecError, InputKind, Nanos, decode};

/// Passes a message to a controller without a decision.
pub(super) fn handle(controller: &mut Controller, input: InputKind, data: &[u8], now: Nanos) {
    let (stream, read) = match input {
        InputKind::Users => (Stream::Users, pass(controller, data, now, |report| Message::Users(report))),
        InputKind::Channel => (Stream::Channel, pass(controller, data, now, |report| Message::Channel(report))),
        InputKind::Obstacles => (Stream::Obstacles, pass(controller, data, now, |report| Message::Obstacles(report))),
        InputKind::Orientation => {
            (Stream::Orientation, pass(controller, data, now, |report| Message::Orientation(report)))
        }
        InputKind::Telemetry => (Stream::Telemetry, pass(controller, data, now, |report| Message::Telemetry(report))),
        InputKind::Decision | InputKind::LateDecision | InputKind::StaleDecision | InputKind::SilenceDecision => return,
    };
    if let Err(error) = read {
        controller.handle_malformed(stream, Refusal::from(&error));
    }
}

fn pass<T: heliostat_proto::Message>(
    controller: &mut Controller,
    data: &[u8],
    now: Nanos,
    message: fn(&mut T) -> Message<'_>,
) -> Result<(), CodecError> {
    let mut report = decode::<T>(data)?;
    controller.handle_message(now, message(&mut report));
    Ok(())
}
