//! The simulated room as a test bench: no user, detectors at known positions, an array of unknown
//! mounting.
//!
//! A reading turns the mirrors, waits until they have settled, and averages the light. Its value is
//! the gain of the simulated channel at the true angles of the mirrors, with the receiver's noise
//! and the relative noise of `streams.channel`.

use heliostat_array::moment::Moment;
use heliostat_array::{Device, DeviceError};
use heliostat_channel::specular::{self, Plate, bisector};
use heliostat_channel::{ChannelModel, MirrorAngles, Scene, Vec3};
use heliostat_proto::{AxisLimits, Capabilities};
use heliostat_room::mirrors::SimulatedMirrors;
use heliostat_room::random::{self, Purpose, RoomRng};
use heliostat_scenario::Scenario;

use super::locate::{Instrument, Pair};

/// Positions of the detectors, as shares of half the room along x and y.
const SPOTS: [[f64; 2]; 5] = [[0.0, 0.0], [-0.6, -0.6], [0.6, -0.6], [-0.6, 0.6], [0.6, 0.6]];

/// Upward angle of a mirror that is not measured, within its range: its light goes to the ceiling.
const AWAY_RAD: f64 = 30.0 * std::f64::consts::PI / 180.0;

/// Positions of the detectors of a room in m.
pub fn spots(scenario: &Scenario) -> Vec<Vec3> {
    let (half_x, half_y) = (0.5 * scenario.room.length_x_m, 0.5 * scenario.room.length_y_m);
    SPOTS.iter().map(|[x, y]| Vec3::new(x * half_x, y * half_y, scenario.receiver.height_m)).collect()
}

/// An array to be calibrated, with the number of readings and the time so far.
pub struct Bench {
    model: ChannelModel,
    scene: Scene,
    mirrors: SimulatedMirrors,
    capabilities: Capabilities,
    commanded: MirrorAngles,
    away: [f64; 2],
    /// The measured mirror, and the gain of each detector while this mirror is turned away too.
    dark: Option<(usize, Vec<f64>)>,
    gains: Vec<f64>,
    noise: RoomRng,
    noise_relative: f64,
    /// Standard deviation of a reading's gain from the receiver's noise.
    noise_gain: f64,
    dwell_s: f64,
    now_ns: u64,
    readings: u64,
    failure: Option<DeviceError>,
}

impl Bench {
    /// The array of a scenario with one array, at rest, as its index in its room and a seed mount
    /// it. `dwell_s`: averaging time of a reading in s.
    ///
    /// The noise of a gain is that of the link budget over an equivalent bandwidth of 1 / (2
    /// dwell): sigma_H = 1 / sqrt(2 dwell B SINR(1)), where SINR(1) is that of a gain of 1 over the
    /// bandwidth B.
    ///
    /// # Errors
    /// The scenario describes no channel.
    pub fn new(scenario: &Scenario, (index, seed): (usize, u64), dwell_s: f64) -> anyhow::Result<Self> {
        let model = scenario.channel_model()?;
        let spots = spots(scenario);
        let mut scene = Scene::new(&model, spots.len());
        scene.update(&model, &spots, &[], &vec![false; spots.len()]);
        let mirrors = SimulatedMirrors::new(&scenario.actuator, &model.mirrors.arrays()[0], seed, index as u32);
        let capabilities = mirrors.capabilities();
        let away = [f64::from(capabilities.roll.min_rad).max(-AWAY_RAD), 0.0];
        let count = model.mirrors.len();
        let budget = &model.budget;
        Ok(Self {
            noise_gain: 1.0 / (2.0 * dwell_s * budget.bandwidth_hz * budget.sinr(1.0)).sqrt(),
            gains: vec![0.0; spots.len()],
            commanded: MirrorAngles { roll: vec![away[0]; count], yaw: vec![away[1]; count] },
            dark: None,
            noise: random::stream(seed, Purpose::CalibrationNoise, 0),
            noise_relative: scenario.streams.channel.noise_relative,
            now_ns: 0,
            readings: 0,
            failure: None,
            model,
            scene,
            mirrors,
            capabilities,
            away,
            dwell_s,
        })
    }

    /// The pairs of a mirror and the detectors at which it can be aimed within its range.
    pub fn pairs(&self, mirror: usize) -> Vec<Pair> {
        let Capabilities { roll, yaw, .. } = self.capabilities;
        let within =
            |angle: f64, axis: &AxisLimits| (f64::from(axis.min_rad)..=f64::from(axis.max_rad)).contains(&angle);
        let pairs = (0..self.scene.positions().len()).filter_map(|spot| self.pair(mirror, spot));
        pairs.filter(|pair| pair.gain > 0.0 && within(pair.aim[0], &roll) && within(pair.aim[1], &yaw)).collect()
    }

    /// A mirror and a detector by the law of reflection; `None` where no light can reach the
    /// detector.
    ///
    /// With distances D1 to the LED and D2 to the detector, a turn by x moves the ray on the mirror
    /// by 2 x D1 D2 / (D1 + D2). The light therefore leaves the detector at x = a (1 / D1 + 1 / D2)
    /// / 2 for half a side of a. The LED's panel of half side p adds p / (2 D1).
    fn pair(&self, mirror: usize, spot: usize) -> Option<Pair> {
        let (mirrors, led) = (&self.model.mirrors, &self.model.leds[self.scene.serving()[spot]]);
        let (centre, position) = (mirrors.positions()[mirror], self.scene.positions()[spot]);
        let aim = mirrors.angles_of(mirror, &bisector(&centre, &led.position, &position)?).into();
        let (to_led, to_spot) = ((led.position - centre).norm(), (position - centre).norm());
        let spec = mirrors.array_of(mirror).spec();
        let half_width = [spec.mirror_height_m, spec.mirror_width_m]
            .map(|side| 0.25 * side * (1.0 / to_led + 1.0 / to_spot) + 0.25 * led.side_m / to_led);
        let gain = self.expected().read(mirror, spot, aim);
        Some(Pair { mirror, spot, aim, half_width, gain })
    }

    /// The same room without noise, mounting errors and drives.
    pub fn expected(&self) -> Expected<'_> {
        Expected { model: &self.model, scene: &self.scene }
    }

    /// The capabilities that the array announces.
    pub fn capabilities(&self) -> &Capabilities {
        &self.capabilities
    }

    /// Travel of the drives, roll and yaw, in rad.
    pub fn travel_rad(&self) -> [[f64; 2]; 2] {
        self.mirrors.travel_rad()
    }

    /// Number of readings so far.
    pub fn readings(&self) -> u64 {
        self.readings
    }

    /// Time so far in a real room, in s.
    pub fn seconds(&self) -> f64 {
        self.now_ns as f64 * 1e-9
    }

    /// The first error of the drives.
    pub fn take_failure(&mut self) -> Option<DeviceError> {
        self.failure.take()
    }

    /// Turns one mirror, waits, and measures the gain of all detectors.
    fn measure(&mut self, mirror: usize, angles: [f64; 2]) {
        let Capabilities { roll, yaw, .. } = self.capabilities;
        let mut turning_s: f64 = 0.0;
        for (commanded, (angle, axis)) in [&mut self.commanded.roll[mirror], &mut self.commanded.yaw[mirror]]
            .into_iter()
            .zip(angles.into_iter().zip([roll, yaw]))
        {
            let turn_s =
                if axis.slew_rad_s > 0.0 { (angle - *commanded).abs() / f64::from(axis.slew_rad_s) } else { 0.0 };
            turning_s = turning_s.max(turn_s + f64::from(axis.settling_s));
            *commanded = angle;
        }
        let at = Moment::simulated(self.now_ns);
        let applied = self.mirrors.connect(at).and_then(|()| self.mirrors.apply(at, &self.commanded));
        self.failure = self.failure.take().or(applied.err());
        self.now_ns += ((turning_s + self.dwell_s) * 1e9) as u64;
        self.mirrors.advance(self.now_ns);
        self.scene.irs_gain(&self.model, self.mirrors.actuator().angles(), &mut self.gains);
        for gain in &mut self.gains {
            let factor = 1.0 + self.noise_relative * random::normal(&mut self.noise);
            *gain = *gain * factor + self.noise_gain * random::normal(&mut self.noise);
        }
        self.readings += 1;
    }
}

impl Instrument for Bench {
    fn read(&mut self, mirror: usize, spot: usize, angles: [f64; 2]) -> f64 {
        if self.dark.as_ref().is_none_or(|(measured, _)| *measured != mirror) {
            if let Some((before, _)) = self.dark {
                (self.commanded.roll[before], self.commanded.yaw[before]) = self.away.into();
            }
            self.measure(mirror, self.away);
            self.dark = Some((mirror, self.gains.clone()));
        }
        self.measure(mirror, angles);
        let dark = self.dark.as_ref().map_or(0.0, |(_, gains)| gains[spot]);
        self.gains[spot] - dark
    }
}

/// Readings by the law of reflection.
pub struct Expected<'a> {
    model: &'a ChannelModel,
    scene: &'a Scene,
}

impl Instrument for Expected<'_> {
    fn read(&mut self, mirror: usize, spot: usize, [roll, yaw]: [f64; 2]) -> f64 {
        let ChannelModel { leds, mirrors, receiver, .. } = self.model;
        let plate = Plate::of(mirrors, mirror, roll, yaw);
        let (led, position) = (&leds[self.scene.serving()[spot]], &self.scene.positions()[spot]);
        let gain = |branch| specular::gain(led, &plate, mirrors.reflectivity(mirror), (receiver, branch), position);
        // The gain is defined because positions of detectors are finite.
        receiver.branches.iter().map(|branch| gain(branch).unwrap_or(0.0)).fold(0.0, f64::max)
    }
}
