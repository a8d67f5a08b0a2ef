//! The simulated room as a measuring bench: nobody in it, detectors at known spots, an array whose mounting is not known.
//!
//! A reading turns the mirrors, waits until they have settled, and averages the light for a while. What it gives is the simulated channel's
//! gain at the angles at which the mirrors truly stand, with the noise of the receiver and the relative noise of `streams.channel`.

use heliostat_array::moment::Moment;
use heliostat_array::{Device, DeviceError};
use heliostat_channel::specular::{self, Plate, bisector};
use heliostat_channel::{ChannelModel, MirrorAngles, Scene, Vec3};
use heliostat_proto::{AxisLimits, Capabilities};
use heliostat_scenario::Scenario;
use heliostat_sim::mirrors::SimulatedMirrors;
use heliostat_sim::random::{self, Purpose, RoomRng};

use super::locate::{Instrument, Pair};

/// Where the detectors stand, as shares of half the room along x and y.
const SPOTS: [[f64; 2]; 5] = [[0.0, 0.0], [-0.6, -0.6], [0.6, -0.6], [-0.6, 0.6], [0.6, 0.6]];

/// How far a mirror that is not measured turns up, where its range lets it: its light goes to the ceiling.
const AWAY_RAD: f64 = 30.0 * std::f64::consts::PI / 180.0;

/// The spots of a room in m.
pub fn spots(scenario: &Scenario) -> Vec<Vec3> {
    let (half_x, half_y) = (0.5 * scenario.room.length_x_m, 0.5 * scenario.room.length_y_m);
    SPOTS.iter().map(|[x, y]| Vec3::new(x * half_x, y * half_y, scenario.receiver.height_m)).collect()
}

/// An array to be calibrated, and what has been spent on it.
pub struct Bench {
    model: ChannelModel,
    scene: Scene,
    mirrors: SimulatedMirrors,
    capabilities: Capabilities,
    told: MirrorAngles,
    away: [f64; 2],
    /// The mirror that is measured, and what each spot gets while it is turned away too.
    dark: Option<(usize, Vec<f64>)>,
    gains: Vec<f64>,
    noise: RoomRng,
    noise_relative: f64,
    /// Standard deviation of a reading's gain by the receiver's noise.
    noise_gain: f64,
    dwell_s: f64,
    now_ns: u64,
    readings: u64,
    failure: Option<DeviceError>,
}

impl Bench {
    /// The array of a scenario and a seed, at rest. `dwell_s`: how long the light is averaged for a reading, in s.
    ///
    /// The noise of a gain is that of the link budget over an equivalent bandwidth of 1 / (2 dwell): sigma_H = 1 / sqrt(2 dwell B SINR(1)), where
    /// SINR(1) is that of a gain of 1 over the bandwidth B.
    ///
    /// # Errors
    /// A scenario that makes no channel.
    pub fn new(scenario: &Scenario, seed: u64, dwell_s: f64) -> anyhow::Result<Self> {
        let model = scenario.channel_model()?;
        let spots = spots(scenario);
        let mut scene = Scene::new(&model, spots.len());
        scene.update(&model, &spots, &[], &vec![false; spots.len()]);
        let mirrors = SimulatedMirrors::new(&scenario.actuator, &model.mirrors, seed);
        let capabilities = mirrors.capabilities();
        let away = [f64::from(capabilities.roll.min_rad).max(-AWAY_RAD), 0.0];
        let count = model.mirrors.len();
        let budget = &model.budget;
        Ok(Self {
            noise_gain: 1.0 / (2.0 * dwell_s * budget.bandwidth_hz * budget.sinr(1.0)).sqrt(),
            gains: vec![0.0; spots.len()],
            told: MirrorAngles { roll: vec![away[0]; count], yaw: vec![away[1]; count] },
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

    /// The pairs of a mirror and the spots that it can be aimed at within its range.
    pub fn pairs(&self, mirror: usize) -> Vec<Pair> {
        let Capabilities { roll, yaw, .. } = self.capabilities;
        let within =
            |angle: f64, axis: &AxisLimits| (f64::from(axis.min_rad)..=f64::from(axis.max_rad)).contains(&angle);
        let pairs = (0..self.scene.positions().len()).filter_map(|spot| self.pair(mirror, spot));
        pairs.filter(|pair| pair.gain > 0.0 && within(pair.aim[0], &roll) && within(pair.aim[1], &yaw)).collect()
    }

    /// What the law of reflection says of a mirror and a spot; nothing where it can send no light there.
    ///
    /// With ways D1 to the LED and D2 to the spot, a turn by x moves the ray on the mirror by 2 x D1 D2 / (D1 + D2), so light leaves the spot at
    /// x = a (1 / D1 + 1 / D2) / 2 for half a side of a, and the panel of half side p widens that by p / (2 D1).
    fn pair(&self, mirror: usize, spot: usize) -> Option<Pair> {
        let (mirrors, led) = (&self.model.mirrors, &self.model.leds[self.scene.serving()[spot]]);
        let (centre, position) = (mirrors.positions()[mirror], self.scene.positions()[spot]);
        let aim = mirrors.angles_of(&bisector(&centre, &led.position, &position)?).into();
        let (to_led, to_spot) = ((led.position - centre).norm(), (position - centre).norm());
        let half_width = [mirrors.spec().mirror_height_m, mirrors.spec().mirror_width_m]
            .map(|side| 0.25 * side * (1.0 / to_led + 1.0 / to_spot) + 0.25 * led.side_m / to_led);
        let gain = self.expected().read(mirror, spot, aim);
        Some(Pair { mirror, spot, aim, half_width, gain })
    }

    /// The same room without noise, mounting or drives.
    pub fn expected(&self) -> Expected<'_> {
        Expected { model: &self.model, scene: &self.scene }
    }

    /// What the array announces.
    pub fn capabilities(&self) -> &Capabilities {
        &self.capabilities
    }

    /// How far the drives go, roll and yaw, in rad.
    pub fn travel_rad(&self) -> [[f64; 2]; 2] {
        self.mirrors.travel_rad()
    }

    /// Readings so far.
    pub fn readings(&self) -> u64 {
        self.readings
    }

    /// Time so far in s, as it would pass in a real room.
    pub fn seconds(&self) -> f64 {
        self.now_ns as f64 * 1e-9
    }

    /// What the drives answered first that was no success.
    pub fn take_failure(&mut self) -> Option<DeviceError> {
        self.failure.take()
    }

    /// Turns one mirror, waits, and takes what all spots get.
    fn look(&mut self, mirror: usize, angles: [f64; 2]) {
        let Capabilities { roll, yaw, .. } = self.capabilities;
        let mut turning_s: f64 = 0.0;
        for (told, (angle, axis)) in [&mut self.told.roll[mirror], &mut self.told.yaw[mirror]]
            .into_iter()
            .zip(angles.into_iter().zip([roll, yaw]))
        {
            let turn_s = if axis.slew_rad_s > 0.0 { (angle - *told).abs() / f64::from(axis.slew_rad_s) } else { 0.0 };
            turning_s = turning_s.max(turn_s + f64::from(axis.settling_s));
            *told = angle;
        }
        let at = Moment::simulated(self.now_ns);
        let applied = self.mirrors.connect(at).and_then(|()| self.mirrors.apply(at, &self.told));
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
                (self.told.roll[before], self.told.yaw[before]) = self.away.into();
            }
            self.look(mirror, self.away);
            self.dark = Some((mirror, self.gains.clone()));
        }
        self.look(mirror, angles);
        let dark = self.dark.as_ref().map_or(0.0, |(_, gains)| gains[spot]);
        self.gains[spot] - dark
    }
}

/// What the law of reflection says that a reading would be.
pub struct Expected<'a> {
    model: &'a ChannelModel,
    scene: &'a Scene,
}

impl Instrument for Expected<'_> {
    fn read(&mut self, mirror: usize, spot: usize, [roll, yaw]: [f64; 2]) -> f64 {
        let ChannelModel { leds, mirrors, receiver, .. } = self.model;
        let plate = Plate::of(mirrors, mirror, roll, yaw);
        let (led, position) = (&leds[self.scene.serving()[spot]], &self.scene.positions()[spot]);
        let gain = |branch| specular::gain(led, &plate, mirrors.spec().reflectivity, (receiver, branch), position);
        // Positions of spots are finite, which is all that the gain asks for.
        receiver.branches.iter().map(|branch| gain(branch).unwrap_or(0.0)).fold(0.0, f64::max)
    }
}
