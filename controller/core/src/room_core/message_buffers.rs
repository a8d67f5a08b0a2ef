//! Memory into which the payloads of each stream are decoded.

use heliostat_proto::{
    ChannelReport, CodecError, LedReport, MirrorTelemetry, ObstacleReport, OrientationReport, UserReport, decode_into,
};

use super::input::InputChannel;
use crate::input::{inbox::Message, refusal::Stream};

/// One message of each stream.
pub(super) struct MessageBuffers {
    users: UserReport,
    channel: ChannelReport,
    obstacles: ObstacleReport,
    telemetry: MirrorTelemetry,
    orientation: OrientationReport,
    leds: LedReport,
}

impl MessageBuffers {
    /// Buffers with memory for all users.
    pub fn new() -> Self {
        Self {
            users: UserReport::buffer(),
            channel: ChannelReport::buffer(),
            obstacles: ObstacleReport::default(),
            telemetry: MirrorTelemetry::default(),
            orientation: OrientationReport::buffer(),
            leds: LedReport::buffer(),
        }
    }

    /// Decodes a payload into the buffer of its stream.
    ///
    /// # Errors
    /// If the payload is no valid message of the stream.
    pub fn decode(
        &mut self,
        InputChannel { stream, array }: InputChannel,
        payload: &[u8],
    ) -> Result<Message<'_>, CodecError> {
        match stream {
            Stream::Users => decode_into(&mut self.users, payload).map(|()| Message::Users(&mut self.users)),
            Stream::Channel => decode_into(&mut self.channel, payload).map(|()| Message::Channel(&mut self.channel)),
            Stream::Obstacles => {
                decode_into(&mut self.obstacles, payload).map(|()| Message::Obstacles(&mut self.obstacles))
            }
            Stream::Telemetry => {
                decode_into(&mut self.telemetry, payload).map(|()| Message::Telemetry(array, &mut self.telemetry))
            }
            Stream::Orientation => {
                decode_into(&mut self.orientation, payload).map(|()| Message::Orientation(&mut self.orientation))
            }
            Stream::Leds => decode_into(&mut self.leds, payload).map(|()| Message::Leds(&mut self.leds)),
        }
    }
}
