//! What measured gains show of the headings of users, of how they hold their receivers, and of
//! unreported obstacles.
//!
//! A user's own body blocks the direct path, or the paths from some mirrors, and which of them
//! depends on the heading. The gain of a receiver that is tilted towards the face does too. For each
//! heading the expected gain over the mirrors, with the angles in force at the time of the
//! measurement, is compared with the measured one; for a tilted receiver the direct gain is
//! compared as well. What bodies do not explain, obstacles do.

use heliostat_channel::{ChannelModel, MirrorArray, Vec3, blockage, blockage::Cylinder, mirrors::MirrorAngles};

use crate::belief::{
    body::Body,
    covered::Covered,
    densities::{Densities, density},
    elementary::{exp, ln},
    expected::{ExpectedGains, HeldPlace},
    heading::{HEADINGS, Heading},
    lit_mirrors::LitMirrors,
    occupancy::Occupancy,
    readings::{MeasuredGains, Readings},
    tilt::{self, Tilt},
};

/// Standard deviation of a measured gain over the mirrors relative to the expected one: the error
/// of the estimated place changes what each mirror contributes.
const SPREAD: f64 = 0.2;

/// The same of a measured direct gain of a tilted receiver.
const SPREAD_OF_DIRECT: f64 = 0.08;

/// The same where receivers may be upright or tilted: the spread of received power and of the tilt
/// of detectors in their devices adds to it.
const SPREAD_OF_DEVICES: f64 = 0.2;

/// Variance of a share of which the map is half certain: all of it arrives, or nothing.
const SPREAD_OF_MAP: f64 = 0.25;

/// Probability that the model of the user's own body is wrong about the direct path.
const BODY_WRONG: f64 = 0.02;

/// Expected gains below this share of the gain of all mirrors aimed at the user say nothing: the
/// light of mirrors that are aimed at others.
const SERVED: f64 = 0.02;

/// What is believed about one user besides the motion.
pub(super) struct Beliefs<'a> {
    pub heading: &'a mut Heading,
    pub covered: &'a mut Covered,
    /// Share of an independent measurement as which one of the gain over the mirrors counts.
    pub independent: f64,
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

/// The comparison of measured gains with expected ones; its buffers are allocated once.
#[derive(Clone, Debug)]
pub(super) struct ChannelEvidence {
    expected: ExpectedGains,
    /// The mirrors with light for one user.
    lit: LitMirrors,
    /// Whether the bodies of other users leave the path to each mirror clear. Shape: M.
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
    /// Variance of the gain for each heading, by the spread of the angles of held devices.
    held_variance: [f64; HEADINGS],
    /// Whether a user has no direct path at each heading; false for a heading that was not possible.
    dark: [bool; HEADINGS],
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
            expected: ExpectedGains::new(model, capacity),
            lit: LitMirrors::new(model),
            clear: vec![false; mirrors],
            others: Vec::with_capacity(capacity),
            unobstructed: vec![1.0; columns.len()],
            by_heading: vec![0.0; HEADINGS * columns.len()],
            shares: vec![0.0; columns.len()],
            held_variance: [0.0; HEADINGS],
            dark: [false; HEADINGS],
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
        self.expected.positions()
    }

    /// Computes the expected gains of users at these places, without bodies; `angles` are those of
    /// the mirrors, where they are known.
    pub fn expect(
        &mut self,
        model: &ChannelModel,
        places: impl Iterator<Item = HeldPlace>,
        obstacles: &[Cylinder],
        angles: Option<&MirrorAngles>,
        unusable: &[u32],
    ) {
        self.angles_known = angles.is_some();
        self.expected.update(model, places, obstacles, angles, unusable);
    }

    /// Logarithm of the likelihood ratio of a receiver that is tilted towards the face by `polar_rad`
    /// to an upright one, by a measured direct gain; 0 where the gain shows nothing. In a room with
    /// one LED, for receivers that are evaluated upright.
    pub fn tilt_log_ratio(
        &self,
        model: &ChannelModel,
        (user, polar_rad): (usize, f64),
        measured: MeasuredGains,
        bodies: &Bodies<'_>,
        heading: &Heading,
    ) -> f64 {
        let upright = self.expected.direct(user);
        let [led] = &model.leds[..] else { return 0.0 };
        if !self.readings.shows(upright) || !self.readings.shows(measured.los) {
            return 0.0;
        }
        let position = &self.expected.positions()[user];
        let slopes = tilt::slopes(position, &led.position);
        let ratio = measured.los / upright;
        let variance = self.readings.gain_variance / upright.powi(2) + SPREAD_OF_DEVICES.powi(2);
        let (mut possible, polar) = (0.0, polar_rad.sin_cos());
        let (mut weights, mut densities) = ([0.0; HEADINGS], Densities::default());
        for (index, probability) in heading.possible() {
            let direction = &bodies.directions[index];
            if blockage::blocks(&bodies.shape.behind(position, direction), &led.position, position) {
                continue;
            }
            let tilt = Tilt::towards_face(polar, direction);
            let variance = variance + tilt.factor_variance(slopes);
            possible += probability;
            weights[index] = probability;
            densities.expect(index, tilt.factor(slopes), variance);
        }
        densities.apply(ratio, 0.0, &mut weights);
        let tilted: f64 = weights.iter().sum();
        if possible > BODY_WRONG { (tilted / possible / density(ratio, (1.0, 0.0), variance)).ln() } else { 0.0 }
    }

    /// Updates the heading of a user and the map by the user's measured gains.
    pub fn examine(
        &mut self,
        model: &ChannelModel,
        user: usize,
        measured: MeasuredGains,
        bodies: Option<&Bodies<'_>>,
        Beliefs { heading, covered, independent }: Beliefs<'_>,
        mut map: Option<&mut Occupancy>,
    ) {
        self.mask_others(model, user, bodies);
        let position = self.expected.positions()[user];
        let led = single_led(model);
        let mut unobstructed = 1.0;
        if let Some(map) = &mut map {
            map.trace(&position, led.as_ref(), &self.columns);
            map.clear_columns(&mut self.unobstructed);
            if led.is_some() {
                unobstructed = map.clear_direct();
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
            let dark = heading.possible().filter(|(index, _)| self.dark[*index]);
            past_bodies -= dark.map(|(_, probability)| probability).sum::<f64>();
            if self.others.iter().any(|body| is_blocked(model, body, &position)) {
                past_bodies *= BODY_WRONG;
            }
            past_bodies = past_bodies.clamp(BODY_WRONG, 1.0 - BODY_WRONG);
        } else {
            self.sum_columns((0, 0), None, None);
        }
        let is_modelled = self.readings.shows(self.expected.direct(user));
        if is_modelled {
            covered.handle_direct(is_clear, past_bodies * unobstructed);
        }
        let Some(map) = map else { return };
        if led.is_some() && is_modelled {
            map.handle_direct(is_clear, past_bodies * is_open);
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
        if expected > SERVED * self.expected.steering(user, 0) {
            let shares = self.shares.iter().map(|gain| gain / expected);
            let (ratio, noise) = (measured.irs / expected, self.readings.gain_variance / expected.powi(2));
            let by_heading = if bodies.is_some() { self.variance_by_heading(heading, expected) } else { 0.0 };
            map.handle_reflected(
                shares,
                #[inline(always)]
                |share| {
                    let variance = SPREAD_OF_MAP * (share * (1.0 - share)) + by_heading * (share * share);
                    exp(independent * ln(density(ratio, (share, SPREAD), noise + variance)))
                },
            );
        }
    }

    /// Removes the gains that the bodies of other users block.
    fn mask_others(&mut self, model: &ChannelModel, user: usize, bodies: Option<&Bodies<'_>>) {
        self.others.clear();
        let known = bodies.map_or(&[][..], |bodies| bodies.known);
        self.others.extend(known.iter().enumerate().filter(|(other, _)| *other != user).filter_map(|(_, body)| *body));
        model.mirrors.visible_from(&self.expected.positions()[user], &self.others, &mut self.clear);
        self.expected.select(model, user, &self.clear, &self.others);
        self.lit.select(model, &self.expected, user);
    }

    /// Sums the gains of the selected user by an LED over each column, past the body of a heading.
    fn sum_columns(&mut self, (heading, led): (usize, usize), body: Option<&Cylinder>, tilt: Option<&Tilt>) {
        let columns = self.columns.len();
        self.lit.sum_columns(led, body, tilt, &mut self.by_heading[heading * columns..][..columns]);
    }

    /// Variance of the gain over the mirrors relative to the `expected` one, by what is unknown of the
    /// heading and of the angles at which the device is held.
    fn variance_by_heading(&self, heading: &Heading, expected: f64) -> f64 {
        let columns = self.columns.len();
        let of = |(index, probability): (usize, f64)| {
            let gain: f64 = self.by_heading[index * columns..][..columns].iter().sum();
            probability * ((gain - expected).powi(2) + self.held_variance[index])
        };
        heading.possible().map(of).sum::<f64>() / expected.powi(2)
    }

    /// The expected gain of a user over the mirrors past unreported obstacles, at a heading.
    fn past_obstacles(&self, heading: usize) -> f64 {
        let sums = &self.by_heading[heading * self.columns.len()..][..self.columns.len()];
        sums.iter().zip(&self.unobstructed).map(|(sum, clear)| sum * clear).sum()
    }

    /// The LED with the most light for a user over the mirrors, of the receiver as evaluated and
    /// without a body, and that gain.
    fn brightest(&mut self) -> (usize, f64) {
        let mut brightest = (0, 0.0);
        for led in self.expected.leds() {
            self.sum_columns((0, led), None, None);
            let gain = self.past_obstacles(0);
            if gain > brightest.1 {
                brightest = (led, gain);
            }
        }
        brightest
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
        let position = self.expected.positions()[user];
        // A heading that becomes possible by this measurement must not have the gains of another user.
        self.by_heading.fill(0.0);
        self.held_variance.fill(0.0);
        let (brightest, without_body) = self.brightest();
        let is_served = self.angles_known && without_body > SERVED * self.expected.steering(user, brightest);
        let reference = self.expected.direct(user);
        let slopes = self.expected.mean_slopes(user, brightest);
        let is_clear = self.readings.shows(measured.los);
        self.dark.fill(false);
        let mut likelihood = [1.0; HEADINGS];
        let (mut direct, mut reflected) = (Densities::default(), Densities::default());
        for (index, _) in heading.possible() {
            let direction = &bodies.directions[index];
            let own = bodies.shape.behind(&position, direction);
            let tilt = self.expected.tilt(user, direction);
            let served = self.expected.served(model, user, &own, tilt.as_ref());
            self.dark[index] = served.direct <= 0.0;
            if self.readings.shows(reference) {
                let shows = self.readings.shows(served.direct);
                let clear = if shows { direct_clear.clamp(BODY_WRONG, 1.0 - BODY_WRONG) } else { BODY_WRONG };
                likelihood[index] *= if is_clear { clear } else { 1.0 - clear };
                if is_clear && tilt.is_some() {
                    let variance = (served.variance + self.readings.gain_variance) / reference.powi(2);
                    direct.expect(index, served.direct / reference, variance);
                }
            }
            if self.angles_known {
                let own = bodies.shape.behind(&Vec3::zeros(), direction);
                self.sum_columns((index, served.led), Some(&own), tilt.as_ref());
            }
            if is_served {
                let held = tilt.map_or(0.0, |tilt| tilt.factor_variance(slopes));
                self.held_variance[index] = without_body.powi(2) * held;
                let variance = self.readings.gain_variance / without_body.powi(2) + held;
                reflected.expect(index, self.past_obstacles(index) / without_body, variance);
            }
        }
        direct.apply(measured.los / reference, SPREAD_OF_DIRECT, &mut likelihood);
        reflected.apply(measured.irs / without_body, SPREAD, &mut likelihood);
        likelihood
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
