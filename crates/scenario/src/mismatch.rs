//! The difference between the room that the controller assumes, and the true one.
//!
//! A scenario describes the room that the controller knows: nominal values. A simulator draws the
//! true room around them, once for each seed. The spreads are standard deviations. Where neither a
//! data sheet nor a paper has a value, the list says that it is assumed.
//!
//! | quantity | typical | rough | source |
//! | --- | --- | --- | --- |
//! | body radius | 0.02 m | 0.04 m | half of the spread of the bideltoid breadth of adults, 33 mm (ANSUR II, Gordon et al., 2014); rough: clothes and bags, assumed |
//! | body height | 0.07 m | 0.07 m | stature of adults (ANSUR II) |
//! | body offset | 0.05 m | 0.10 m | how far a device is held from the body, assumed |
//! | receiver tilt | 3 deg | 10 deg | of the detector in its device, about each horizontal axis, fixed for each user, assumed |
//! | mirror angles | 0.2 deg | 0.6 deg | fixed offset of each axis, after alignment with a laser or by eye, assumed |
//! | reflectivity | 2 % | 5 % | loss by dust and ageing, always below the nominal value, assumed |
//! | LED position | 0.01 m | 0.03 m | along x, y and z, by a laser meter or a tape, assumed |
//! | half-power semi-angle | 3 % | 8 % | spread between parts and diffusers, assumed |
//! | received power | 5 % | 12 % | spread of the flux of LEDs within a bin, and of photodiodes, assumed |
//! | tracker noise | x 1.3 | x 2 | factor on the noise of positions and velocities, assumed |
//! | floor height | 0.01 m | 0.03 m | LED and mirrors above the tracker's floor, assumed |

use serde::{Deserialize, Serialize};

/// How far the true room is from the assumed one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum MismatchLevel {
    /// The room is as the scenario describes it.
    #[default]
    #[value(skip)]
    None,
    /// An installation with care.
    Typical,
    /// An installation without alignment tools, and a wider spread of bodies.
    Rough,
}

impl MismatchLevel {
    /// The name in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Typical => "typical",
            Self::Rough => "rough",
        }
    }
}

/// A part of the room that may differ.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum MismatchKind {
    /// Radius, height and offset of each user's body.
    Bodies,
    /// A fixed tilt of each user's receiver.
    Tilt,
    /// The angles of each mirror, and the reflectivity of the array.
    Mirrors,
    /// Position of each LED, and the half-power semi-angle of all.
    Led,
    /// The power that a detector receives, as a factor on all gains.
    Receiver,
    /// The height of LED and mirrors above the floor of the tracker.
    Floor,
    /// The noise of reported positions and velocities.
    Tracker,
}

/// The difference between the assumed room and the true one.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Mismatch {
    /// The size of the differences.
    pub level: MismatchLevel,
    /// The parts that differ; empty: all.
    pub kinds: Vec<MismatchKind>,
    /// Centres of LEDs that shine in the true room and that the controller does not know, such as those of
    /// a neighbour, in m.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub unknown_leds_m: Vec<[f64; 3]>,
}

/// Standard deviations of the true values around the nominal ones; the [module](self) has their
/// sources.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Spreads {
    /// Of the radius of a body in m.
    pub body_radius_m: f64,
    /// Of the height of a body in m.
    pub body_height_m: f64,
    /// Of the distance of a body's axis behind the device in m.
    pub body_offset_m: f64,
    /// Of the tilt of a receiver about each horizontal axis in degrees.
    pub tilt_deg: f64,
    /// Of the fixed offset of each axis of each mirror in degrees.
    pub mirror_deg: f64,
    /// Of the loss of reflectivity, relative; the true value is never above the nominal one.
    pub reflectivity_loss: f64,
    /// Of each coordinate of an LED in m.
    pub led_m: f64,
    /// Of the half-power semi-angle, relative.
    pub semi_angle: f64,
    /// Of the received power, relative.
    pub received: f64,
    /// Of the height of LED and mirrors in m.
    pub floor_m: f64,
    /// How much more noise positions and velocities have than the scenario states, relative: not a
    /// deviation, but the same for each seed.
    pub tracker_excess: f64,
}

impl Mismatch {
    /// The first key by which the true room differs from the assumed one.
    pub fn key(&self) -> Option<&'static str> {
        match (self.level, self.unknown_leds_m.is_empty()) {
            (MismatchLevel::None, true) => None,
            (MismatchLevel::None, false) => Some("mismatch.unknown_leds_m"),
            _ => Some("mismatch.level"),
        }
    }

    /// The spreads of the chosen kinds; those of the other kinds are 0.
    pub fn spreads(&self) -> Spreads {
        let chosen = |kind: MismatchKind, typical: f64, rough: f64| {
            let applies = self.kinds.is_empty() || self.kinds.contains(&kind);
            match self.level {
                MismatchLevel::Typical if applies => typical,
                MismatchLevel::Rough if applies => rough,
                _ => 0.0,
            }
        };
        Spreads {
            body_radius_m: chosen(MismatchKind::Bodies, 0.02, 0.04),
            body_height_m: chosen(MismatchKind::Bodies, 0.07, 0.07),
            body_offset_m: chosen(MismatchKind::Bodies, 0.05, 0.10),
            tilt_deg: chosen(MismatchKind::Tilt, 3.0, 10.0),
            mirror_deg: chosen(MismatchKind::Mirrors, 0.2, 0.6),
            reflectivity_loss: chosen(MismatchKind::Mirrors, 0.02, 0.05),
            led_m: chosen(MismatchKind::Led, 0.01, 0.03),
            semi_angle: chosen(MismatchKind::Led, 0.03, 0.08),
            received: chosen(MismatchKind::Receiver, 0.05, 0.12),
            floor_m: chosen(MismatchKind::Floor, 0.01, 0.03),
            tracker_excess: chosen(MismatchKind::Tracker, 0.3, 1.0),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_chosen_kinds_differ_and_none_does_without_a_level() {
        assert_eq!(Mismatch::default().spreads(), Spreads::default());
        let all = Mismatch { level: MismatchLevel::Typical, ..Mismatch::default() }.spreads();
        let rough = Mismatch { level: MismatchLevel::Rough, ..Mismatch::default() }.spreads();
        assert!(rough.mirror_deg > all.mirror_deg && all.mirror_deg > 0.0);
        let kinds = vec![MismatchKind::Floor];
        let floor = Mismatch { level: MismatchLevel::Typical, kinds, ..Mismatch::default() }.spreads();
        assert_eq!(floor, Spreads { floor_m: all.floor_m, ..Spreads::default() });
    }
}
