//! What measured gains say about the headings of users and about unreported obstacles.
//!
//! A user's own body blocks the direct path, or the paths from some mirrors, and which of them
//! depends on the heading. For each heading the expected gain over the mirrors, with the angles in
//! force at the time of the measurement, is compared with the measured one. What bodies do not
//! explain, obstacles do.

use heliostat_channel::{
    ChannelModel, MirrorArray, Orientation, Scene, Vec3, blockage, blockage::Cylinder, mirrors::MirrorAngles,
};

use heliostat_scenario::ChannelStream;

use crate::belief::{
    body::Body,
    covered::Covered,
    heading::{HEADINGS, Heading},
    occupancy::Occupancy,
};

/// Standard deviation of a measured gain over the mirrors relative to the expected one: the error
/// of the estimated place changes what each mirror contributes.
const SPREAD: f64 = 0.2;

/// The same relative to the gain without any body: mirrors at the edge of a body.
const SPREAD_OF_CLEAR: f64 = 0.05;

/// Variance of a share of which the map is half certain: all of it arrives, or nothing.
const SPREAD_OF_MAP: f64 = 0.25;

/// Probability that something else explains a measured gain.
const UNEXPLAINED: f64 = 0.1;

/// Probability that the model of the user's own body is wrong about the direct path.
const BODY_WRONG: f64 = 0.02;

/// Expected gains below this share of the gain of all mirrors aimed at the user say nothing: the
/// light of mirrors that are aimed at others.
const SERVED: f64 = 0.02;

/// The measured gains of one user.
#[derive(Clone, Copy, Debug)]
pub(super) struct MeasuredGains {
    pub los: f64,
    pub irs: f64,
}

/// What the receivers can tell apart.
#[derive(Clone, Copy, Debug)]
pub(super) struct Readings {
    /// The largest reading of a blocked path; see `ChannelStream::detectable_gain`.
    pub detectable_gain: f64,
    /// Variance of a reading that does not depend on the gain.
    pub gain_variance: f64,
}

impl Readings {
    pub fn new(settings: &ChannelStream) -> Self {
        Self { detectable_gain: settings.detectable_gain(), gain_variance: settings.gain_variance() }
    }

    /// Whether a direct gain shows a path that is not blocked.
    pub fn shows(&self, los_gain: f64) -> bool {
        los_gain > self.detectable_gain
    }
}

/// What is believed about one user besides the motion.
pub(super) struct Beliefs<'a> {
    pub heading: &'a mut Heading,
    pub covered: &'a mut Covered,
}

/// All bodies in the room.
#[derive(Clone, Copy, Debug)]
pub(super) struct Bodies<'a> {
    /// The shape of a body.
    pub shape: &'a Body,
    /// The unit vectors of the headings.
    pub directions: &'a [Vec3; HEADINGS],
    /// The body of each user, where it is known. Shape: K.
    pub known: &'a [Option<Cylinder>],
}

/// The expected gains at the places and angles of a measurement; its buffers are allocated once.
#[derive(Clone, Debug)]
pub(super) struct ChannelEvidence {
    scene: Scene,
    positions: Vec<Vec3>,
    orientations: Vec<Orientation>,
    forced: Vec<bool>,
    /// Gain over each mirror without bodies. Shape: K * M.
    gains: Vec<f64>,
    clear: Vec<bool>,
    others: Vec<Cylinder>,
    /// A point in the middle of each column of mirrors.
    columns: Vec<Vec3>,
    /// Probability that no obstacle blocks the path to each column.
    unobstructed: Vec<f64>,
    /// Gain over each column for each heading. Shape: [`HEADINGS`] * columns.
    by_heading: Vec<f64>,
    /// Gain over each column with the believed heading.
    shares: Vec<f64>,
    /// Whether the angles of the mirrors were known.
    angles_known: bool,
    readings: Readings,
}

impl ChannelEvidence {
    /// Buffers for this many users.
    pub fn new(model: &ChannelModel, readings: Readings, capacity: usize) -> Self {
        let mirrors = model.mirrors.len();
        let columns = columns(model);
        Self {
            scene: Scene::new(model, capacity),
            positions: Vec::with_capacity(capacity),
            orientations: Vec::with_capacity(capacity),
            forced: Vec::with_capacity(capacity),
            gains: Vec::with_capacity(capacity * mirrors),
            clear: vec![false; mirrors],
            others: Vec::with_capacity(capacity),
            unobstructed: vec![1.0; columns.len()],
            by_heading: vec![0.0; HEADINGS * columns.len()],
            shares: vec![0.0; columns.len()],
            columns,
            angles_known: false,
            readings,
        }
    }

    /// A point in the middle of each column of mirrors.
    pub fn columns(&self) -> &[Vec3] {
        &self.columns
    }

    /// The places of the expected gains in m. Shape: K.
    pub fn positions(&self) -> &[Vec3] {
        &self.positions
    }

    /// Computes the expected gains of users at these places and orientations, without bodies;
    /// `angles` are those of the mirrors, where they are known.
    pub fn expect(
        &mut self,
        model: &ChannelModel,
        places: impl Iterator<Item = (Vec3, Orientation)>,
        obstacles: &[Cylinder],
        angles: Option<&MirrorAngles>,
        unusable: &[u32],
    ) {
        self.positions.clear();
        self.orientations.clear();
        for (position, orientation) in places {
            self.positions.push(position);
            self.orientations.push(orientation);
        }
        let users = self.positions.len();
        self.forced.clear();
        self.forced.resize(users, false);
        self.scene.resize(users);
        self.scene.update_turned(model, &self.positions, &self.orientations, obstacles, &self.forced);
        self.scene.exclude_mirrors(unusable);
        self.gains.clear();
        self.gains.resize(users * model.mirrors.len(), 0.0);
        self.angles_known = angles.is_some();
        if let Some(angles) = angles {
            self.scene.irs_gain_each(model, angles, &mut self.gains);
        }
    }

    /// Updates the heading of a user and the map by the user's measured gains.
    pub fn examine(
        &mut self,
        model: &ChannelModel,
        user: usize,
        measured: MeasuredGains,
        bodies: Option<&Bodies<'_>>,
        Beliefs { heading, covered }: Beliefs<'_>,
        mut map: Option<&mut Occupancy>,
    ) {
        self.mask_others(model, user, bodies);
        let position = self.positions[user];
        let led = single_led(model);
        // The path to the LED, if there is one, and then those to the columns.
        let first_column = usize::from(led.is_some());
        let mut unobstructed = 1.0;
        if let Some(map) = &mut map {
            map.trace(&position, led.iter().chain(&self.columns).copied());
            for (column, unobstructed) in self.unobstructed.iter_mut().enumerate() {
                *unobstructed = map.clear_probability(first_column + column);
            }
            if led.is_some() {
                unobstructed = map.clear_probability(0);
            }
        }
        covered.predict();
        let is_open = 1.0 - covered.probability();
        let is_clear = self.readings.shows(measured.los);
        // Probability that no body blocks the direct path.
        let mut past_bodies = 1.0;
        if let Some(bodies) = bodies {
            let clear = unobstructed * is_open;
            let likelihood = self.likelihood(model, user, (bodies, heading), clear, measured);
            heading.handle_likelihood(&likelihood);
            let blocks = |body: &Cylinder| is_blocked(model, body, &position);
            let behind = |index: usize| bodies.shape.behind(&position, &bodies.directions[index]);
            let own = heading.possible().filter(|(index, _)| blocks(&behind(*index)));
            past_bodies -= own.map(|(_, probability)| probability).sum::<f64>();
            if self.others.iter().any(blocks) {
                past_bodies *= BODY_WRONG;
            }
            past_bodies = past_bodies.clamp(BODY_WRONG, 1.0 - BODY_WRONG);
        } else {
            self.sum_columns(model, user, 0);
        }
        let is_modelled = self.readings.shows(self.scene.los_gain()[user]);
        if is_modelled {
            covered.handle_direct(is_clear, past_bodies * unobstructed);
        }
        let Some(map) = map else { return };
        if led.is_some() && is_modelled {
            map.handle_direct(0, is_clear, past_bodies * is_open);
        }
        if !self.angles_known {
            return;
        }
        self.shares.fill(0.0);
        let columns = self.columns.len();
        let mut add = |index: usize, probability: f64| {
            let row = &self.by_heading[index * columns..][..columns];
            self.shares.iter_mut().zip(row).for_each(|(share, gain)| *share += probability * gain);
        };
        if bodies.is_some() {
            heading.possible().for_each(|(index, probability)| add(index, probability));
        } else {
            add(0, 1.0);
        }
        let expected: f64 = self.shares.iter().sum();
        if expected > SERVED * self.steering(user) {
            let shares = self.shares.iter().enumerate().map(|(column, gain)| (first_column + column, gain / expected));
            let (ratio, noise) = (measured.irs / expected, self.readings.gain_variance / expected.powi(2));
            map.handle_reflected(shares, |share| {
                density(ratio, share, noise + SPREAD_OF_MAP * (share * (1.0 - share)).max(0.0))
            });
        }
    }

    /// Removes the gains that the bodies of other users block.
    fn mask_others(&mut self, model: &ChannelModel, user: usize, bodies: Option<&Bodies<'_>>) {
        self.others.clear();
        let known = bodies.map_or(&[][..], |bodies| bodies.known);
        self.others.extend(known.iter().enumerate().filter(|(other, _)| *other != user).filter_map(|(_, body)| *body));
        model.mirrors.visible_from(&self.positions[user], &self.others, &mut self.clear);
        let mirrors = self.clear.len();
        let gains = &mut self.gains[user * mirrors..][..mirrors];
        gains.iter_mut().zip(&self.clear).for_each(|(gain, clear)| *gain *= f64::from(u8::from(*clear)));
        self.clear.fill(true);
    }

    /// Sums the gains of a user over each column, past the body of a heading.
    fn sum_columns(&mut self, model: &ChannelModel, user: usize, heading: usize) {
        let (columns, mirrors) = (self.columns.len(), self.clear.len());
        let sums = &mut self.by_heading[heading * columns..][..columns];
        sums.fill(0.0);
        let gains = &self.gains[user * mirrors..][..mirrors];
        for ((_, mirrors), (_, columns)) in model.mirrors.ranges().zip(model.mirrors.column_ranges()) {
            let rows = gains[mirrors.clone()].chunks_exact(columns.len());
            for (gains, clear) in rows.zip(self.clear[mirrors].chunks_exact(columns.len())) {
                for ((sum, gain), clear) in sums[columns.clone()].iter_mut().zip(gains).zip(clear) {
                    *sum += gain * f64::from(u8::from(*clear));
                }
            }
        }
    }

    /// The likelihood of each possible heading of a user.
    fn likelihood(
        &mut self,
        model: &ChannelModel,
        user: usize,
        (bodies, heading): (&Bodies<'_>, &Heading),
        direct_clear: f64,
        measured: MeasuredGains,
    ) -> [f64; HEADINGS] {
        let position = self.positions[user];
        let expected = |sums: &[f64], unobstructed: &[f64]| -> f64 {
            sums.iter().zip(unobstructed).map(|(sum, clear)| sum * clear).sum()
        };
        // A heading that becomes possible by this measurement must not have the gains of another user.
        self.by_heading.fill(0.0);
        self.sum_columns(model, user, 0);
        let without_body = expected(&self.by_heading[..self.columns.len()], &self.unobstructed);
        let is_served = self.angles_known && without_body > SERVED * self.steering(user);
        let los_modelled = self.readings.shows(self.scene.los_gain()[user]);
        let mut likelihood = [1.0; HEADINGS];
        for (index, _) in heading.possible() {
            let own = bodies.shape.behind(&position, &bodies.directions[index]);
            if los_modelled {
                let clear = if is_blocked(model, &own, &position) {
                    BODY_WRONG
                } else {
                    direct_clear.clamp(BODY_WRONG, 1.0 - BODY_WRONG)
                };
                likelihood[index] *= if self.readings.shows(measured.los) { clear } else { 1.0 - clear };
            }
            if self.angles_known {
                model.mirrors.visible_from(&position, std::slice::from_ref(&own), &mut self.clear);
                self.sum_columns(model, user, index);
            }
            if is_served {
                let row = &self.by_heading[index * self.columns.len()..][..self.columns.len()];
                let expected = expected(row, &self.unobstructed) / without_body;
                let noise = self.readings.gain_variance / without_body.powi(2);
                likelihood[index] *= density(measured.irs / without_body, expected, noise);
            }
        }
        likelihood
    }

    /// The gain of a user if all mirrors were aimed at this user.
    fn steering(&self, user: usize) -> f64 {
        let mirrors = self.clear.len();
        self.scene.steering_gain()[user * mirrors..][..mirrors].iter().sum()
    }
}

/// A point in the middle of each column of mirrors, array after array.
pub(super) fn columns(model: &ChannelModel) -> Vec<Vec3> {
    let middle_row = |array: &MirrorArray| {
        let columns = array.columns();
        array.positions()[array.rows() / 2 * columns..][..columns].to_vec()
    };
    model.mirrors.arrays().iter().flat_map(middle_row).collect()
}

/// The place of the LED, in a room with one.
pub(super) fn single_led(model: &ChannelModel) -> Option<Vec3> {
    (model.leds.len() == 1).then(|| model.leds[0].position)
}

/// Whether a body blocks the paths from all LEDs to a point.
fn is_blocked(model: &ChannelModel, body: &Cylinder, position: &Vec3) -> bool {
    model.leds.iter().all(|led| blockage::blocks(body, &led.position, position))
}

/// Density of a measured gain; both are shares of the same gain.
fn density(measured: f64, expected: f64, variance: f64) -> f64 {
    let spread = ((SPREAD * expected).powi(2) + SPREAD_OF_CLEAR * SPREAD_OF_CLEAR + variance).sqrt();
    let deviation = (measured - expected) / spread;
    let normal = (-0.5 * deviation * deviation).exp() / (spread * std::f64::consts::TAU.sqrt());
    (1.0 - UNEXPLAINED) * normal + UNEXPLAINED
}
