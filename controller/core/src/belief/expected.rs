//! The gains that the model expects at the places and angles of a measurement, without bodies.
//!
//! The receiver of a user whose heading is not certain is evaluated upright, and
//! [`tilt`](super::tilt) turns it for each heading. The strongest LED may then be another one at
//! each heading, so the gains of every LED are kept.

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

/// The LED that serves a user, and its direct gain past the user's body with the variance.
#[derive(Clone, Copy, Debug)]
pub(super) struct Served {
    /// Index for [`ExpectedGains::turn`].
    pub led: usize,
    pub direct: f64,
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
    forced: Vec<bool>,
    /// By LED, or the first entry for the LEDs that `scene` chooses.
    lit: Vec<Lit>,
    /// Entries of `lit` in use.
    leds: usize,
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
            forced: Vec::with_capacity(capacity),
            lit: vec![Lit::new(capacity, mirrors); model.leds.len()],
            leds: 1,
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
        self.forced.clear();
        self.forced.resize(users, false);
        self.scene.resize(users);
        self.leds = if self.leans.iter().any(Option::is_some) { model.leds.len() } else { 1 };
        if self.leds > 1 {
            self.scene.update_turned_by(model, &self.positions, &self.orientations, obstacles, 0);
        } else {
            self.scene.update_turned(model, &self.positions, &self.orientations, obstacles, &self.forced);
        }
        for (led, lit) in self.lit[..self.leds].iter_mut().enumerate() {
            if led > 0 {
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
        for lit in &mut self.lit[..self.leds] {
            let mirrors = clear.len();
            let gains = lit.gains[user * mirrors..][..mirrors].iter_mut().zip(clear);
            gains.for_each(|(gain, clear)| *gain *= f64::from(u8::from(*clear)));
        }
        let position = self.positions[user];
        let is_blocked = |led: &Vec3| others.iter().any(|body| blockage::blocks(body, led, &position));
        self.led_open.clear();
        self.led_open.extend(model.leds.iter().map(|led| !is_blocked(&led.position)));
        self.led_slopes.clear();
        self.mirror_slopes.clear();
        if self.leans[user].is_some() {
            self.led_slopes.extend(model.leds.iter().map(|led| tilt::slopes(&position, &led.position)));
            let mirrors = model.mirrors.arrays().iter().flat_map(MirrorArray::positions);
            self.mirror_slopes.extend(mirrors.map(|mirror| tilt::slopes(&position, mirror)));
        }
    }

    /// The receiver of the selected user at a heading; `None` where it does not depend on it.
    pub fn tilt(&self, user: usize, heading: &Vec3) -> Option<Tilt> {
        self.leans[user].map(|lean| Tilt::of(&lean, heading))
    }

    /// The largest direct gain of a user, of the receiver as evaluated.
    pub fn direct(&self, user: usize) -> f64 {
        self.lit[..self.leds].iter().map(|lit| lit.direct[user]).fold(0.0, f64::max)
    }

    /// The entries of [`Self::gains`].
    pub fn leds(&self) -> std::ops::Range<usize> {
        0..self.leds
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

    /// The LED that serves the selected user, whose body and receiver are these. Without a direct
    /// path it is the LED with the largest steering gain.
    pub fn served(&self, model: &ChannelModel, user: usize, own: &Cylinder, tilt: Option<&Tilt>) -> Served {
        let position = &self.positions[user];
        let Some(tilt) = tilt else {
            let blocked = model.leds.iter().all(|led| blockage::blocks(own, &led.position, position));
            return Served { led: 0, direct: if blocked { 0.0 } else { self.lit[0].direct[user] }, variance: 0.0 };
        };
        let mut best = Served { led: 0, direct: 0.0, variance: 0.0 };
        for (led, lit) in self.lit[..self.leds].iter().enumerate() {
            let direct = lit.direct[user] * tilt.factor(self.led_slopes[led]);
            let is_open = self.led_open[led] && !blockage::blocks(own, &model.leds[led].position, position);
            if direct > best.direct && is_open {
                let variance = lit.direct[user].powi(2) * tilt.factor_variance(self.led_slopes[led]);
                best = Served { led, direct, variance };
            }
        }
        if best.direct == 0.0 {
            let by_steering =
                |one: &usize, other: &usize| self.steering(user, *one).total_cmp(&self.steering(user, *other));
            best.led = self.leds().max_by(by_steering).unwrap_or(0);
        }
        best
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
