//! What measured gains show of the headings of users, of how they hold their receivers, and of
//! unreported obstacles.
//!
//! A user's own body blocks the direct path, or the paths from some mirrors, and which of them
//! depends on the heading. The gain of a receiver that is tilted towards the face does too. For each
//! heading the expected gain over the mirrors, with the angles in force at the time of the
//! measurement, is compared with the measured one; for a tilted receiver the direct gain is
//! compared as well. What bodies do not explain, obstacles do.
//!
//! With several LEDs the direct gain also shows which LED serves: see [`serving`]. The gain over the
//! mirrors is compared with that by the LED which most probably serves at each heading.

mod served_light;
mod serving;
mod tilt_decision;

use heliostat_channel::{Body, ChannelModel, MirrorArray, Vec3, blockage, blockage::Cylinder};

use crate::belief::{
    covered::Covered,
    densities::{Densities, density},
    elementary::{exp, ln},
    expected::{Direct, ExpectedGains, HeldPlace, Room},
    heading::{HEADINGS, Heading},
    light::Received,
    lit_mirrors::LitMirrors,
    occupancy::Occupancy,
    posture::TiltEvidence,
    readings::{MeasuredGains, Readings},
    tilt::Tilt,
};
use serving::Serving;

/// Standard deviation of a measured gain over the mirrors relative to the expected one: the error
/// of the estimated place changes what each mirror contributes.
const SPREAD: f64 = 0.2;

/// The same of a measured direct gain of a tilted receiver.
pub(super) const SPREAD_OF_DIRECT: f64 = 0.08;

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
    /// Whether the receiver is tilted, and the polar angle in rad that it then has, where
    /// measurements decide it.
    pub undecided: Option<(&'a mut TiltEvidence, f64)>,
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
    serving: Serving,
    /// The LED that serves the user at each possible heading.
    served_by: [usize; HEADINGS],
    /// The LED with the most light for the user over the mirrors.
    brightest: usize,
    led_positions: Vec<Vec3>,
    readings: Readings,
}

impl ChannelEvidence {
    /// Buffers for this many users.
    pub fn new(model: &ChannelModel, readings: Readings, capacity: usize) -> Self {
        let columns = columns(model);
        Self {
            expected: ExpectedGains::new(model, capacity),
            lit: LitMirrors::new(model),
            others: Vec::with_capacity(capacity),
            unobstructed: vec![1.0; columns.len()],
            by_heading: vec![0.0; HEADINGS * columns.len()],
            shares: vec![0.0; columns.len()],
            held_variance: [0.0; HEADINGS],
            serving: Serving::new(model),
            served_by: [0; HEADINGS],
            brightest: 0,
            led_positions: model.leds.iter().map(|led| led.position).collect(),
            columns,
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

    /// Computes the expected direct gains of users at these places, without bodies.
    pub fn expect(&mut self, room: &Room<'_>, places: impl Iterator<Item = HeldPlace>) {
        self.expected.update(room, places);
    }

    /// Updates what is believed about a user, and the map, by the user's measured gains. Returns the measured
    /// light relative to the expected one.
    pub fn examine(
        &mut self,
        room: &Room<'_>,
        user: usize,
        measured: MeasuredGains<'_>,
        bodies: Option<&Bodies<'_>>,
        Beliefs { heading, covered, undecided, independent }: Beliefs<'_>,
        mut map: Option<&mut Occupancy>,
    ) -> Received {
        let model = room.model;
        self.mask_others(model, user, bodies);
        let position = self.expected.positions()[user];
        if let Some(map) = &mut map {
            map.trace(&position, &self.led_positions, &self.columns);
            map.clear_columns(&mut self.unobstructed);
        }
        let unobstructed = |led: usize| map.as_ref().map_or(1.0, |map| map.clear_direct(led));
        self.serving.begin(measured.leds, &self.readings, unobstructed);
        if let (Some(bodies), Some((tilt, polar_rad))) = (bodies, undecided) {
            tilt.handle_log_ratio(self.tilt_log_ratio(model, (user, polar_rad), measured, bodies, heading));
        }
        covered.predict();
        let open = 1.0 - covered.probability();
        if let Some(bodies) = bodies {
            let likelihood = self.likelihood(room, user, (bodies, heading), open, measured);
            heading.handle_likelihood(&likelihood);
        } else {
            self.without_bodies(room, user, open, measured);
        }
        let known = bodies.is_some().then_some(&*heading);
        let received = self.received(user, known, measured);
        self.examine_direct(model, user, (known, open), (measured, covered), map.as_deref_mut());
        if let (Some(map), Some(_)) = (map, room.angles) {
            self.examine_reflected(known, (measured, independent), map);
        }
        received
    }

    /// Takes what the measured direct gain shows of a covered detector and of obstacles. `heading` is
    /// absent where bodies block no light.
    fn examine_direct(
        &mut self,
        model: &ChannelModel,
        user: usize,
        (heading, open): (Option<&Heading>, f64),
        (measured, covered): (MeasuredGains<'_>, &mut Covered),
        mut map: Option<&mut Occupancy>,
    ) {
        if !self.readings.shows(self.expected.strongest(user)) {
            return;
        }
        let mut clear = 0.0;
        for led in self.expected.leds() {
            let past_bodies = self.past_bodies(model, (user, led), heading);
            clear += (1.0 - clear) * (past_bodies * self.serving.unobstructed(led));
            if let Some(map) = map.as_deref_mut().filter(|_| self.readings.shows(self.expected.direct(user, led))) {
                let shown = self.serving.shown(led, possible(heading));
                map.handle_direct(led, shown, past_bodies * open);
            }
        }
        covered.handle_direct(self.readings.shows(measured.los), clear);
    }

    /// Probability that no body blocks the path from an LED to a user.
    fn past_bodies(&self, model: &ChannelModel, (user, led): (usize, usize), heading: Option<&Heading>) -> f64 {
        let Some(heading) = heading else { return 1.0 };
        let dark = heading.possible().filter(|(index, _)| self.serving.is_dark(led, *index));
        let mut past_bodies = 1.0 - dark.map(|(_, probability)| probability).sum::<f64>();
        let (led, position) = (&model.leds[led].position, &self.expected.positions()[user]);
        if self.others.iter().any(|body| blockage::blocks(body, led, position)) {
            past_bodies *= BODY_WRONG;
        }
        past_bodies.clamp(BODY_WRONG, 1.0 - BODY_WRONG)
    }

    /// Takes what the measured gain over the mirrors shows of obstacles.
    fn examine_reflected(
        &mut self,
        heading: Option<&Heading>,
        (measured, independent): (MeasuredGains<'_>, f64),
        map: &mut Occupancy,
    ) {
        self.shares.fill(0.0);
        for (index, probability) in possible(heading) {
            let row = &self.by_heading[index * self.columns.len()..];
            self.shares.iter_mut().zip(row).for_each(|(share, gain)| *share += probability * gain);
        }
        let expected: f64 = self.shares.iter().sum();
        if expected > SERVED * self.expected.steering(self.brightest) {
            let shares = self.shares.iter().map(|gain| gain / expected);
            let (ratio, noise) = (measured.irs / expected, self.readings.gain_variance / expected.powi(2));
            let by_heading = heading.map_or(0.0, |heading| self.variance_by_heading(heading, expected));
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
        self.expected.select(model, user, &self.others);
    }

    /// Sums the gains of the selected user by an LED over each column, past the body of a heading.
    fn sum_columns(&mut self, (heading, led): (usize, usize), body: Option<&Cylinder>, tilt: Option<&Tilt>) {
        let columns = self.columns.len();
        self.lit.sum_columns(led, body, tilt, &mut self.by_heading[heading * columns..][..columns]);
    }

    /// Variance of the gain over the mirrors relative to the `expected` one, by what is unknown of the
    /// heading and of the angles at which the device is held.
    fn variance_by_heading(&self, heading: &Heading, expected: f64) -> f64 {
        let of = |(index, probability): (usize, f64)| {
            probability * ((self.reflected(index) - expected).powi(2) + self.held_variance[index])
        };
        heading.possible().map(of).sum::<f64>() / expected.powi(2)
    }

    /// The gain over each column at a heading.
    fn row(&self, heading: usize) -> &[f64] {
        &self.by_heading[heading * self.columns.len()..][..self.columns.len()]
    }

    /// The gain over all mirrors at a heading.
    fn reflected(&self, heading: usize) -> f64 {
        self.row(heading).iter().sum()
    }

    /// The same past unreported obstacles.
    fn past_obstacles(&self, heading: usize) -> f64 {
        self.row(heading).iter().zip(&self.unobstructed).map(|(sum, clear)| sum * clear).sum()
    }

    /// The lit LED with the most light for the selected user over the mirrors, of the receiver as evaluated
    /// and without a body, and that gain.
    fn brightest(&mut self) -> (usize, f64) {
        let mut brightest = (self.expected.lit().next().unwrap_or(0), 0.0);
        for led in self.expected.leds() {
            if !self.expected.is_lit(led) {
                continue;
            }
            self.sum_columns((0, led), None, None);
            let gain = self.past_obstacles(0);
            if gain > brightest.1 {
                brightest = (led, gain);
            }
        }
        brightest
    }

    /// The likelihood of each possible heading of a user; `open` is the probability that the detector
    /// is not covered.
    fn likelihood(
        &mut self,
        room: &Room<'_>,
        user: usize,
        (bodies, heading): (&Bodies<'_>, &Heading),
        open: f64,
        measured: MeasuredGains<'_>,
    ) -> [f64; HEADINGS] {
        let position = self.expected.positions()[user];
        let tilts = bodies.directions.each_ref().map(|direction| self.expected.tilt(user, direction));
        for (index, _) in heading.possible() {
            let own = bodies.shape.behind(&position, &bodies.directions[index]);
            self.expect_direct(room.model, (user, index), &own, tilts[index].as_ref());
        }
        let mut likelihood = self.likelihood_of_direct(user, Some(heading), open, measured);
        self.light(room, user, Some(heading));
        // A heading that becomes possible by this measurement must not have the gains of another user.
        self.by_heading.fill(0.0);
        self.held_variance.fill(0.0);
        let (brightest, without_body) = self.brightest();
        self.brightest = brightest;
        let is_served = room.angles.is_some() && without_body > SERVED * self.expected.steering(brightest);
        let slopes = self.expected.mean_slopes(brightest);
        let mut reflected = Densities::default();
        for (index, _) in heading.possible() {
            let tilt = tilts[index].as_ref();
            if room.angles.is_some() {
                let own = bodies.shape.behind(&Vec3::zeros(), &bodies.directions[index]);
                self.sum_columns((index, self.served_by[index]), Some(&own), tilt);
            }
            if is_served {
                let held = tilt.map_or(0.0, |tilt| tilt.factor_variance(slopes));
                self.held_variance[index] = without_body.powi(2) * held;
                let variance = self.readings.gain_variance / without_body.powi(2) + held;
                reflected.expect(index, self.past_obstacles(index) / without_body, variance);
            }
        }
        reflected.apply(measured.irs / without_body, SPREAD, &mut likelihood);
        likelihood
    }

    /// Which LED serves, and the gain over each column, where bodies block no light.
    fn without_bodies(&mut self, room: &Room<'_>, user: usize, open: f64, measured: MeasuredGains) {
        for led in self.expected.leds() {
            let direct = self.expected.direct(user, led);
            self.expect_direct_gain(user, (led, 0), Direct { gain: direct, variance: 0.0 }, false);
        }
        self.likelihood_of_direct(user, None, open, measured);
        self.light(room, user, None);
        self.brightest = self.served_by[0];
        self.sum_columns((0, self.brightest), None, None);
    }

    /// Notes the direct gains that are expected of a user at a heading.
    fn expect_direct(
        &mut self,
        model: &ChannelModel,
        (user, heading): (usize, usize),
        own: &Cylinder,
        tilt: Option<&Tilt>,
    ) {
        for led in self.expected.leds() {
            let direct = self.expected.past_body(model, (user, led), own, tilt);
            self.expect_direct_gain(user, (led, heading), direct, tilt.is_some());
        }
    }

    fn expect_direct_gain(&mut self, user: usize, (led, heading): (usize, usize), direct: Direct, is_tilted: bool) {
        self.serving.expect(led, heading, direct.gain);
        // The density by one LED of an upright receiver is the same at all headings.
        if is_tilted || self.expected.leds().len() > 1 {
            let reference = self.expected.strongest(user);
            let variance = (direct.variance + self.readings.gain_variance) / reference.powi(2);
            self.serving.expect_share(led, heading, direct.gain / reference, variance);
        }
    }

    /// The likelihood of each heading by the measured direct gain.
    fn likelihood_of_direct(
        &mut self,
        user: usize,
        heading: Option<&Heading>,
        open: f64,
        measured: MeasuredGains<'_>,
    ) -> [f64; HEADINGS] {
        let mut likelihood = [1.0; HEADINGS];
        let reference = self.expected.strongest(user);
        if self.readings.shows(reference) {
            let readings = self.readings;
            possible(heading).for_each(|(index, _)| self.serving.weigh(index, open, |gain| readings.shows(gain)));
            self.serving.measure(Some(measured.los).filter(|los| readings.shows(*los)), reference, SPREAD_OF_DIRECT);
            possible(heading).for_each(|(index, _)| likelihood[index] = self.serving.likelihood(index));
        }
        likelihood
    }

    /// Finds the LED that serves a user at each possible heading, and computes the gains over the mirrors by
    /// these LEDs alone.
    fn light(&mut self, room: &Room<'_>, user: usize, heading: Option<&Heading>) {
        let mut by_steering = None;
        for (index, _) in possible(heading) {
            let led = self.serving.led(index);
            let led =
                led.unwrap_or_else(|| *by_steering.get_or_insert_with(|| self.expected.light_by_steering(room, user)));
            self.expected.light(room, user, led);
            self.served_by[index] = led;
        }
        self.lit.select(room.model, &self.expected, user);
    }
}

/// The headings that are worth an examination, with their probability; the first one stands for all
/// where bodies block no light.
fn possible(heading: Option<&Heading>) -> impl Iterator<Item = (usize, f64)> {
    let any = heading.is_none().then_some((0, 1.0));
    heading.into_iter().flat_map(Heading::possible).chain(any)
}

/// A point in the middle of each column of mirrors, array after array.
pub(super) fn columns(model: &ChannelModel) -> Vec<Vec3> {
    let middle_row = |array: &MirrorArray| {
        let columns = array.columns();
        array.positions()[array.rows() / 2 * columns..][..columns].to_vec()
    };
    model.mirrors.arrays().iter().flat_map(middle_row).collect()
}
