//! The gains that the model expects at the places and angles of a measurement, without bodies.
//!
//! The receiver of a user whose heading is not certain is evaluated upright, and
//! [`tilt`](super::tilt) turns it for each heading. Another LED may serve at each heading, so the
//! gains of every LED are kept.

use heliostat_channel::{
    ChannelModel, MirrorArray, Orientation, Scene, Vec3, blockage, blockage::Cylinder, mirrors::MirrorAngles,
};

use crate::belief::{
    device::Lean,
    posture::Held,
    tilt::{self, Tilt},
};

/// Where a user's receiver is, how it is held, and the mean heading, which is zero while unknown.
#[derive(Clone, Copy, Debug)]
pub(super) struct HeldPlace {
    /// In m.
    pub position: Vec3,
    pub held: Held,
    pub heading: Vec3,
}

/// The direct gain of a user past the user's body.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Direct {
    /// Zero where the path is blocked.
    pub gain: f64,
    /// By the spread of the angles at which the device is held.
    pub variance: f64,
}

/// The gains by one LED.
#[derive(Clone, Debug)]
struct Lit {
    /// Over the direct path. Shape: K.
    direct: Vec<f64>,
    /// Over each mirror. Shape: K * M.
    gains: Vec<f64>,
    /// Over all mirrors, if they were aimed at the user. Shape: K.
    steering: Vec<f64>,
}

/// The expected gains of all users; its buffers are allocated once.
#[derive(Clone, Debug)]
pub(super) struct ExpectedGains {
    scene: Scene,
    positions: Vec<Vec3>,
    orientations: Vec<Orientation>,
    /// How each receiver leans that is upright in `scene` and depends on the heading. Shape: K.
    leans: Vec<Option<Lean>>,
    /// Whether the gains of a tilted receiver follow from those of an upright one.
    is_tiltable: bool,
    /// By LED.
    lit: Vec<Lit>,
    /// Slopes of the directions from the user of `select` to the mirrors and to the LEDs.
    mirror_slopes: Vec<[f64; 2]>,
    led_slopes: Vec<[f64; 2]>,
    /// Whether the bodies of others leave the path from each LED to that user clear.
    led_open: Vec<bool>,
}

impl ExpectedGains {
    /// Buffers for this many users.
    pub fn new(model: &ChannelModel, capacity: usize) -> Self {
        let mirrors = model.mirrors.len();
        Self {
            scene: Scene::new(model, capacity),
            positions: Vec::with_capacity(capacity),
            orientations: Vec::with_capacity(capacity),
            leans: Vec::with_capacity(capacity),
            is_tiltable: tilt::is_single_open_detector(model),
            lit: vec![Lit::new(capacity, mirrors); model.leds.len()],
            mirror_slopes: Vec::with_capacity(mirrors),
            led_slopes: Vec::with_capacity(model.leds.len()),
            led_open: Vec::with_capacity(model.leds.len()),
        }
    }

    /// Computes the gains of users at these places; `angles` are those of the mirrors, where they
    /// are known.
    pub fn update(
        &mut self,
        model: &ChannelModel,
        places: impl Iterator<Item = HeldPlace>,
        obstacles: &[Cylinder],
        angles: Option<&MirrorAngles>,
        unusable: &[u32],
    ) {
        self.positions.clear();
        self.orientations.clear();
        self.leans.clear();
        for HeldPlace { position, held, heading } in places {
            let lean = held.lean().filter(|_| self.is_tiltable);
            self.positions.push(position);
            self.orientations.push(lean.map_or_else(|| held.facing(&heading), |_| Orientation::UPRIGHT));
            self.leans.push(lean);
        }
        let users = self.positions.len();
        self.scene.resize(users);
        for (led, lit) in self.lit.iter_mut().enumerate() {
            if led == 0 {
                self.scene.update_turned_by(model, &self.positions, &self.orientations, obstacles, led);
            } else {
                (0..users).for_each(|user| self.scene.serve_by(model, obstacles, user, led));
            }
            self.scene.exclude_mirrors(unusable);
            lit.update(model, &self.scene, angles);
        }
    }

    /// The places in m. Shape: K.
    pub fn positions(&self) -> &[Vec3] {
        &self.positions
    }

    /// Prepares a user: the gains over mirrors that `clear` does not mark become 0. `others` are
    /// the known bodies of other users.
    pub fn select(&mut self, model: &ChannelModel, user: usize, clear: &[bool], others: &[Cylinder]) {
        for lit in &mut self.lit {
            let mirrors = clear.len();
            let gains = lit.gains[user * mirrors..][..mirrors].iter_mut().zip(clear);
            gains.for_each(|(gain, clear)| *gain *= f64::from(u8::from(*clear)));
        }
        let position = self.positions[user];
        let is_blocked = |led: &Vec3| others.iter().any(|body| blockage::blocks(body, led, &position));
        self.led_open.clear();
        self.led_open.extend(model.leds.iter().map(|led| !is_blocked(&led.position)));
        self.led_slopes.clear();
        self.led_slopes.extend(model.leds.iter().map(|led| tilt::slopes(&position, &led.position)));
        self.mirror_slopes.clear();
        if self.leans[user].is_some() {
            let mirrors = model.mirrors.arrays().iter().flat_map(MirrorArray::positions);
            self.mirror_slopes.extend(mirrors.map(|mirror| tilt::slopes(&position, mirror)));
        }
    }

    /// The receiver of the selected user at a heading; `None` where it does not depend on it.
    pub fn tilt(&self, user: usize, heading: &Vec3) -> Option<Tilt> {
        self.leans[user].map(|lean| Tilt::of(&lean, heading))
    }

    /// The direct gain of a user by an LED, of the receiver as evaluated.
    pub fn direct(&self, user: usize, led: usize) -> f64 {
        self.lit[led].direct[user]
    }

    /// The largest direct gain of a user, of the receiver as evaluated.
    pub fn strongest(&self, user: usize) -> f64 {
        self.lit.iter().map(|lit| lit.direct[user]).fold(0.0, f64::max)
    }

    /// All LEDs.
    pub fn leds(&self) -> std::ops::Range<usize> {
        0..self.lit.len()
    }

    /// Slopes of the direction from the selected user to an LED.
    pub fn led_slopes(&self, led: usize) -> [f64; 2] {
        self.led_slopes[led]
    }

    /// The gains of a user over each mirror by an LED, of the receiver as evaluated. Shape: M.
    pub fn gains(&self, user: usize, led: usize) -> &[f64] {
        let mirrors = self.scene.mirrors();
        &self.lit[led].gains[user * mirrors..][..mirrors]
    }

    /// The gain of a user if all mirrors were aimed at this user.
    pub fn steering(&self, user: usize, led: usize) -> f64 {
        self.lit[led].steering[user]
    }

    /// The LED with the largest steering gain for a user, which serves where no direct path is clear.
    pub fn steering_led(&self, user: usize) -> usize {
        let by_steering =
            |one: &usize, other: &usize| self.steering(user, *one).total_cmp(&self.steering(user, *other));
        self.leds().max_by(by_steering).unwrap_or(0)
    }

    /// Whether the path from an LED to the selected user is clear past the user's `own` body and the
    /// known bodies of others.
    ///
    /// With one LED and an upright receiver the bodies of others are left out: they say nothing of
    /// the heading.
    pub fn is_clear(&self, model: &ChannelModel, (user, led): (usize, usize), own: &Cylinder, is_tilted: bool) -> bool {
        let counts_others = is_tilted || self.lit.len() > 1;
        (self.led_open[led] || !counts_others)
            && !blockage::blocks(own, &model.leds[led].position, &self.positions[user])
    }

    /// The direct gain of the selected user by an LED, past bodies, of a receiver that is tilted so.
    pub fn past_body(
        &self,
        model: &ChannelModel,
        (user, led): (usize, usize),
        own: &Cylinder,
        tilt: Option<&Tilt>,
    ) -> Direct {
        if !self.is_clear(model, (user, led), own, tilt.is_some()) {
            return Direct::default();
        }
        let direct = self.direct(user, led);
        let Some(tilt) = tilt else { return Direct { gain: direct, variance: 0.0 } };
        let gain = direct * tilt.factor(self.led_slopes[led]);
        let variance = direct.powi(2) * tilt.factor_variance(self.led_slopes[led]);
        if gain > 0.0 { Direct { gain, variance } } else { Direct::default() }
    }

    /// The mean slopes of the directions from the selected user to the mirrors, weighted by their
    /// gains; 0 for a receiver that does not depend on the heading.
    pub fn mean_slopes(&self, user: usize, led: usize) -> [f64; 2] {
        let (mut total, mut sums) = (f64::MIN_POSITIVE, [0.0; 2]);
        for (gain, [x, y]) in self.gains(user, led).iter().zip(&self.mirror_slopes) {
            total += gain;
            sums = [sums[0] + gain * x, sums[1] + gain * y];
        }
        sums.map(|sum| sum / total)
    }
}

impl Lit {
    fn new(capacity: usize, mirrors: usize) -> Self {
        let users = || Vec::with_capacity(capacity);
        Self { direct: users(), gains: Vec::with_capacity(capacity * mirrors), steering: users() }
    }

    fn update(&mut self, model: &ChannelModel, scene: &Scene, angles: Option<&MirrorAngles>) {
        self.direct.clear();
        self.direct.extend_from_slice(scene.los_gain());
        self.steering.clear();
        let rows = scene.steering_gain().chunks_exact(scene.mirrors());
        self.steering.extend(rows.map(|row| row.iter().sum::<f64>()));
        self.gains.clear();
        self.gains.resize(scene.users() * scene.mirrors(), 0.0);
        if let Some(angles) = angles {
            scene.irs_gain_each(model, angles, &mut self.gains);
        }
    }
}
