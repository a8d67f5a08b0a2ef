//! Conversion of a scenario to the types and units of `heliostat-channel`.

use heliostat_channel as optics;
use optics::{ArraySpec, ChannelError, ChannelModel, LinkBudget, Mode, Vec3};

use crate::scenario::Scenario;
use crate::tables::{Branch, ChannelMode, Mirrors, ReceiverPreset, Wall};

/// Field of view of each branch of the angle-diversity preset, in degrees.
const ANGLE_DIVERSITY_FOV_DEG: f64 = 35.0;
/// Tilt of the six outer branches of the angle-diversity preset, in degrees.
const ANGLE_DIVERSITY_TILT_DEG: f64 = 45.0;

impl Scenario {
    /// The channel model of the room: degrees become radians, mm2 become m2, and MHz become Hz.
    ///
    /// # Errors
    /// [`ChannelError`] for a combination of values that the channel refuses, such as an LED behind
    /// the mirror wall.
    pub fn channel_model(&self) -> Result<ChannelModel, ChannelError> {
        let mode = match self.channel.mode {
            ChannelMode::Specular => Mode::Specular,
            ChannelMode::Paper | ChannelMode::PaperCalibrated => {
                Mode::Paper { literal: self.channel.literal, gain_scale: self.channel.gain_scale }
            }
        };
        let array = |table| optics::MirrorArray::new(&self.array_spec(table));
        let arrays = self.mirrors.arrays().iter().map(array).collect::<Result<_, _>>()?;
        let mirrors = optics::MirrorArrays::new(arrays)?;
        ChannelModel::new(mode, self.leds(), mirrors, self.detectors(), self.link_budget())
    }

    fn array_spec(&self, table: &Mirrors) -> ArraySpec {
        let wall_distance_m = match table.wall {
            Wall::PlusY | Wall::MinusY => self.room.length_y_m / 2.0,
            Wall::PlusX | Wall::MinusX => self.room.length_x_m / 2.0,
        };
        ArraySpec {
            rows: table.rows,
            columns: table.columns,
            mirror_width_m: table.width_m,
            mirror_height_m: table.height_m,
            gap_m: table.gap_m,
            centre_height_m: table.centre_height_m,
            wall: table.wall,
            wall_distance_m,
            reflectivity: table.reflectivity,
        }
    }

    fn leds(&self) -> Vec<optics::Led> {
        let led = |position: &[f64; 3]| optics::Led {
            position: Vec3::from(*position),
            side_m: self.led.side_m,
            points_per_side: self.led.points_per_side,
            half_power_semi_angle: self.led.half_power_semi_angle_deg.to_radians(),
        };
        self.led.positions_m.iter().map(led).collect()
    }

    fn detectors(&self) -> optics::Receiver {
        let table = &self.receiver;
        let branches =
            match (table.branches.as_slice(), table.preset) {
                ([], ReceiverPreset::Single) => vec![branch(0.0, 0.0, table.fov_deg)],
                ([], ReceiverPreset::AngleDiversity) => std::iter::once(branch(0.0, 0.0, ANGLE_DIVERSITY_FOV_DEG))
                    .chain((0..6).map(|index| {
                        branch(ANGLE_DIVERSITY_TILT_DEG, 60.0 * f64::from(index), ANGLE_DIVERSITY_FOV_DEG)
                    }))
                    .collect(),
                (branches, _) => branches
                    .iter()
                    .map(|Branch { tilt_deg, azimuth_deg, fov_deg }| branch(*tilt_deg, *azimuth_deg, *fov_deg))
                    .collect(),
            };
        optics::Receiver {
            branches,
            detector_area_m2: table.area_mm2 * 1e-6,
            filter_gain: table.filter_gain,
            concentrator_index: table.concentrator.then_some(table.concentrator_index),
            combining: table.combining,
        }
    }

    fn link_budget(&self) -> LinkBudget {
        LinkBudget {
            power_w: self.led.power_w,
            power_law: self.channel.power_law,
            responsivity_a_per_w: self.receiver.responsivity_a_per_w,
            noise: self.noise.clone(),
            bandwidth_hz: self.link.bandwidth_mhz * 1e6,
        }
    }
}

fn branch(tilt_deg: f64, azimuth_deg: f64, fov_deg: f64) -> optics::Branch {
    let (sin_tilt, cos_tilt) = tilt_deg.to_radians().sin_cos();
    let (sin_azimuth, cos_azimuth) = azimuth_deg.to_radians().sin_cos();
    optics::Branch {
        normal: Vec3::new(sin_tilt * cos_azimuth, sin_tilt * sin_azimuth, cos_tilt),
        fov_semi_angle: fov_deg.to_radians(),
    }
}
