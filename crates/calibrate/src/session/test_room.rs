//! A room in which the tests of a session stand: reports at regular times, and light without latency.

use heliostat_channel::{MirrorAngles, Vec3};
use heliostat_proto::{AxisLimits, Capabilities, ChannelReport, Nanos, Stamp, UserChannel, UserReport, UserState};
use heliostat_scenario::{MismatchLevel, Scenario};

use super::{Place, Session, Setup, Stage};
use crate::optics::{PLACE, QUANTITIES, Quantities};
use crate::parameters::Prior;
use crate::signal::Signal;

/// The spots and the place of the verification.
const PLACES_M: [[f64; 2]; 4] = [[-1.2, 0.4], [1.2, 0.4], [0.0, -1.3], [0.6, -0.5]];
const HEIGHT_M: f64 = 0.85;

/// Standard deviation in rad of an offset that is known.
const KNOWN_RAD: f64 = 0.002;

/// Time between two reports of each kind.
pub const PERIOD_NS: Nanos = 50_000_000;

/// A room of 8 x 8 mirrors with random offsets, whose receiver is at once where it shall be.
pub struct Room {
    pub session: Session,
    at_m: [f64; 2],
    /// How far the tracker reports the receiver from where it is.
    pub tracker_error_m: [f64; 2],
    pub exact: Quantities,
    pub offsets: Vec<[f64; 2]>,
    angles: MirrorAngles,
    pub peak: f64,
    pub noise_gain: f64,
    pub now: Nanos,
    random: u64,
}

impl Room {
    /// `ratio`: of the light of the median mirror to the receiver's own noise.
    pub fn new(ratio: f64) -> Self {
        let size = ["mirrors.rows=8", "mirrors.columns=8"];
        let scenario = Scenario::builtin("hall").expect("a scenario").with_overrides(&size).expect("valid");
        let [spots @ .., verify] = PLACES_M.map(|at| Place { floor_m: Some(at), height_m: HEIGHT_M });
        let axis = AxisLimits { min_rad: -1.0, max_rad: 1.0, ..AxisLimits::default() };
        let setup = Setup {
            model: scenario.channel_model().expect("a model"),
            room: scenario.room.clone(),
            array: 0,
            capabilities: Capabilities { rows: 8, columns: 8, roll: axis, yaw: axis, ..Capabilities::default() },
            prior: Prior::of_level(MismatchLevel::Rough),
            spots: spots.to_vec(),
            verify,
            user: None,
            unusable: Vec::new(),
        };
        let session = Session::new(setup).expect("a session");
        let at_m = PLACES_M[0];
        let place = std::iter::once((0, [at_m[0], at_m[1], HEIGHT_M]));
        let peak = Signal::weakest(&session.optics, place, 1.0).expect("light").gain;
        let angles = MirrorAngles::flat(64);
        let noise_gain = peak / ratio;
        let mut room = Self {
            session,
            at_m,
            tracker_error_m: [0.0; 2],
            exact: [0.0; QUANTITIES],
            offsets: Vec::new(),
            angles,
            peak,
            noise_gain,
            now: 0,
            random: 20_261_126,
        };
        room.offsets = (0..64).map(|_| [0.6, 0.6].map(|deg: f64| deg.to_radians() * room.normal())).collect();
        room
    }

    /// A sum of twelve uniform numbers, which is nearly normal.
    fn normal(&mut self) -> f64 {
        let mut uniform = || {
            self.random = self.random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (self.random >> 11) as f64 / (1_u64 << 53) as f64
        };
        (0..12).map(|_| uniform()).sum::<f64>() - 6.0
    }

    /// The reading of a gain.
    fn measured(&mut self, gain: f64, own: f64) -> f32 {
        (gain * (1.0 + 0.05 * self.normal()) + own * self.normal()).max(0.0) as f32
    }

    /// The light of a mirror without noise.
    pub fn light(&self, mirror: usize, command: [f64; 2]) -> f64 {
        let turned = [0, 1].map(|axis| command[axis] + self.offsets[mirror][axis]);
        self.session.optics.mirror_gain((mirror, 0), turned, &self.exact)
    }

    /// Mirrors that light the receiver's place, as far as they are turned to it.
    pub fn turned(&self) -> usize {
        let away = |mirror: &usize| self.session.dark_angles.get(*mirror).map_or(0.0, |angles| angles[0]);
        (0..64).filter(|mirror| (self.angles.roll[*mirror] - away(mirror)).abs() > 1e-6).count()
    }

    /// One report of each kind. `direct`: share of the direct light that arrives.
    pub fn step(&mut self, direct: f64) {
        self.now += PERIOD_NS;
        let stamp = Stamp { time_ns: self.now, ..Stamp::default() };
        if let (Stage::Await(_), Some(Place { floor_m: Some(at_m), .. })) = (self.session.stage(), self.session.place())
        {
            self.at_m = at_m;
        }
        let [x, y] = self.at_m;
        let at = self.session.optics.array().wall_from_room(&Vec3::new(x, y, 0.0));
        self.exact[PLACE..PLACE + 3].copy_from_slice(&[at.x, at.y, HEIGHT_M]);
        let [error_x, error_y] = self.tracker_error_m;
        let position_m = [x + error_x, y + error_y, HEIGHT_M].map(|coordinate| coordinate as f32);
        let user = UserState { user: 0, position_m, ..UserState::default() };
        self.session.handle_users(&UserReport { stamp, users: vec![user], ..UserReport::default() });
        let all: f64 = (0..64).map(|of| self.light(of, [self.angles.roll[of], self.angles.yaw[of]])).sum();
        let irs_gain = self.measured(all, self.noise_gain);
        let los_gain = self.measured(direct * self.session.optics.direct_gain(0, &self.exact), 0.0);
        let user = UserChannel { user: 0, los_gain, irs_gain, ..UserChannel::default() };
        self.session.handle_channel(&ChannelReport { stamp, users: vec![user], ..ChannelReport::default() });
        if !self.session.is_estimate_due()
            && let Some(angles) = self.session.next_command(self.now)
        {
            self.angles = angles;
        }
    }

    /// An estimate with the true offsets, and nothing left of the present spot. The fit itself would take a test
    /// without optimisation too long.
    pub fn know_offsets(&mut self) {
        let session = &mut self.session;
        session.extend_estimate();
        if let Some(estimate) = &mut session.estimate {
            for (mirror, offset) in self.offsets.iter().enumerate() {
                for (axis, offset) in offset.iter().enumerate() {
                    let parameter = estimate.layout.offset(mirror, axis);
                    estimate.values[parameter] = *offset;
                    estimate.covariance[(parameter, parameter)] = KNOWN_RAD.powi(2);
                }
            }
        }
        session.complete = None;
        session.jobs.clear();
    }

    /// Steps until the session is so.
    pub fn step_until(&mut self, is_over: impl Fn(&Session) -> bool) {
        for _ in 0..5000 {
            if is_over(&self.session) {
                return;
            }
            self.step(1.0);
        }
        panic!("no end: {:?}", self.session.progress());
    }
}
