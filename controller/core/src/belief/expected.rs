//! The gains that the model expects at the places and angles of a measurement, without bodies.
//!
//! The receiver of a user whose heading is not certain is evaluated upright, and
//! [`tilt`](super::tilt) turns it for each heading. Another LED may serve at each heading: the direct
//! gains are those of every LED, and the gains over the mirrors those of the LEDs that are lit for a
//! user with [`ExpectedGains::light`].

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

/// What a measurement depends on besides users and bodies.
#[derive(Clone, Copy, Debug)]
pub(super) struct Room<'a> {
    pub model: &'a ChannelModel,
    /// Those of the latest survey.
    pub obstacles: &'a [Cylinder],
    /// The angles of the mirrors, where they are known.
    pub angles: Option<&'a MirrorAngles>,
    /// The mirrors that do not follow.
    pub unusable: &'a [u32],
}

/// The gains over the mirrors of each user by the LED with the largest direct gain, which most often
/// serves: for all users at once, the mirrors are turned once.
#[derive(Clone, Debug)]
struct Strongest {
    /// Shape: K.
    led: Vec<usize>,
    /// Over each mirror. Shape: K * M.
    gains: Vec<f64>,
    /// If all mirrors were aimed at the user. Shape: K.
    steering: Vec<f64>,
}

/// The gains of the selected user by one LED.
#[derive(Clone, Debug)]
struct Lit {
    is_lit: bool,
    /// Over each mirror. Shape: M.
    gains: Vec<f64>,
    /// Over all mirrors, if they were aimed at the user.
    steering: f64,
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
    /// Over the direct path from each LED. Shape: K * L.
    direct: Vec<f64>,
    strongest: Strongest,
    /// By LED.
    lit: Vec<Lit>,
    /// Slopes of the directions from the user of `select` to the mirrors and to the LEDs.
    mirror_slopes: Vec<[f64; 2]>,
    led_slopes: Vec<[f64; 2]>,
    /// Whether the bodies of others leave the path from each LED, and to each mirror, clear.
    led_open: Vec<bool>,
    mirror_open: Vec<bool>,
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
            direct: Vec::with_capacity(capacity * model.leds.len()),
            strongest: Strongest {
                led: Vec::with_capacity(capacity),
                gains: Vec::with_capacity(capacity * mirrors),
                steering: Vec::with_capacity(capacity),
            },
            lit: vec![Lit { is_lit: false, gains: vec![0.0; mirrors], steering: 0.0 }; model.leds.len()],
            mirror_slopes: Vec::with_capacity(mirrors),
            led_slopes: Vec::with_capacity(model.leds.len()),
            led_open: Vec::with_capacity(model.leds.len()),
            mirror_open: vec![true; mirrors],
        }
    }

    /// Computes the direct gains of users at these places.
    pub fn update(&mut self, room: &Room<'_>, places: impl Iterator<Item = HeldPlace>) {
        self.positions.clear();
        self.orientations.clear();
        self.leans.clear();
        for HeldPlace { position, held, heading } in places {
            let lean = held.lean().filter(|_| self.is_tiltable);
            self.positions.push(position);
            self.orientations.push(lean.map_or_else(|| held.facing(&heading), |_| Orientation::UPRIGHT));
            self.leans.push(lean);
        }
        let (model, obstacles) = (room.model, room.obstacles);
        self.scene.resize(self.positions.len());
        self.scene.place_turned(model, &self.positions, &self.orientations, obstacles);
        self.direct.clear();
        for user in 0..self.positions.len() {
            let by_led = (0..model.leds.len()).map(|led| self.scene.los_gain_by(model, obstacles, user, led));
            self.direct.extend(by_led);
        }
        self.light_strongest(room);
    }

    /// Computes the gains of all users over the mirrors by the LED with the largest direct gain.
    fn light_strongest(&mut self, room: &Room<'_>) {
        let Self { scene, direct, strongest: Strongest { led, gains, steering }, lit, .. } = self;
        led.clear();
        for (user, direct) in direct.chunks_exact(lit.len()).enumerate() {
            let strongest = (1..direct.len()).fold(0, |best, led| if direct[led] > direct[best] { led } else { best });
            scene.serve_by(room.model, room.obstacles, user, strongest);
            led.push(strongest);
        }
        scene.exclude_mirrors(room.unusable);
        steering.clear();
        steering.extend(scene.steering_gain().chunks_exact(scene.mirrors()).map(|row| row.iter().sum::<f64>()));
        gains.clear();
        gains.resize(scene.users() * scene.mirrors(), 0.0);
        if let Some(angles) = room.angles {
            scene.irs_gain_each(room.model, angles, gains);
        }
    }

    /// The places in m. Shape: K.
    pub fn positions(&self) -> &[Vec3] {
        &self.positions
    }

    /// Selects a user; `others` are the known bodies of other users. No LED is lit.
    pub fn select(&mut self, model: &ChannelModel, user: usize, others: &[Cylinder]) {
        let position = self.positions[user];
        model.mirrors.visible_from(&position, others, &mut self.mirror_open);
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
        self.lit.iter_mut().for_each(|lit| lit.is_lit = false);
    }

    /// Computes the gains of the selected user over the mirrors by an LED, past the bodies of others, where
    /// they are not computed yet.
    pub fn light(&mut self, room: &Room<'_>, user: usize, led: usize) {
        let lit = &mut self.lit[led];
        if lit.is_lit {
            return;
        }
        lit.is_lit = true;
        let (scene, mirrors) = (&mut self.scene, lit.gains.len());
        if led == self.strongest.led[user] {
            lit.steering = self.strongest.steering[user];
            lit.gains.copy_from_slice(&self.strongest.gains[user * mirrors..][..mirrors]);
        } else {
            scene.serve_by(room.model, room.obstacles, user, led);
            scene.exclude_mirrors(room.unusable);
            lit.steering = scene.steering_gain()[user * mirrors..][..mirrors].iter().sum();
            match room.angles {
                Some(angles) => scene.irs_gain_each_of(room.model, angles, user, &mut lit.gains),
                None => lit.gains.fill(0.0),
            }
        }
        let open = lit.gains.iter_mut().zip(&self.mirror_open);
        open.for_each(|(gain, is_open)| *gain *= f64::from(u8::from(*is_open)));
    }

    /// The LED with the largest steering gain for the selected user, which serves where no direct path is
    /// clear; it is then lit.
    pub fn light_by_steering(&mut self, room: &Room<'_>, user: usize) -> usize {
        let mut best = (0, 0.0);
        for led in self.leds() {
            self.light(room, user, led);
            if self.lit[led].steering > best.1 {
                best = (led, self.lit[led].steering);
            }
        }
        best.0
    }

    /// The receiver of the selected user at a heading; `None` where it does not depend on it.
    pub fn tilt(&self, user: usize, heading: &Vec3) -> Option<Tilt> {
        self.leans[user].map(|lean| Tilt::of(&lean, heading))
    }

    /// The direct gain of a user by an LED, of the receiver as evaluated.
    pub fn direct(&self, user: usize, led: usize) -> f64 {
        self.direct[user * self.lit.len() + led]
    }

    /// The largest direct gain of a user, of the receiver as evaluated.
    pub fn strongest(&self, user: usize) -> f64 {
        self.direct[user * self.lit.len()..][..self.lit.len()].iter().copied().fold(0.0, f64::max)
    }

    /// All LEDs.
    pub fn leds(&self) -> std::ops::Range<usize> {
        0..self.lit.len()
    }

    /// Whether an LED is lit for the selected user.
    pub fn is_lit(&self, led: usize) -> bool {
        self.lit[led].is_lit
    }

    /// The LEDs that are lit for the selected user.
    pub fn lit(&self) -> impl Iterator<Item = usize> + Clone {
        self.lit.iter().enumerate().filter(|(_, lit)| lit.is_lit).map(|(led, _)| led)
    }

    /// Slopes of the direction from the selected user to an LED.
    pub fn led_slopes(&self, led: usize) -> [f64; 2] {
        self.led_slopes[led]
    }

    /// The gains of the selected user over each mirror by a lit LED, of the receiver as evaluated.
    /// Shape: M.
    pub fn gains(&self, led: usize) -> &[f64] {
        &self.lit[led].gains
    }

    /// The gain of the selected user by a lit LED if all mirrors were aimed at this user.
    pub fn steering(&self, led: usize) -> f64 {
        self.lit[led].steering
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
    /// gains by a lit LED; 0 for a receiver that does not depend on the heading.
    pub fn mean_slopes(&self, led: usize) -> [f64; 2] {
        let (mut total, mut sums) = (f64::MIN_POSITIVE, [0.0; 2]);
        for (gain, [x, y]) in self.gains(led).iter().zip(&self.mirror_slopes) {
            total += gain;
            sums = [sums[0] + gain * x, sums[1] + gain * y];
        }
        sums.map(|sum| sum / total)
    }
}
