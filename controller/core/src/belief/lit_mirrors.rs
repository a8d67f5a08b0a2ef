//! The mirrors from which light reaches one user, and what is left of it past a body.
//!
//! Most mirrors are aimed at other users, and their gain is 0. The others are kept in one array for
//! each quantity, so that the loop over them vectorises.

use heliostat_channel::{ChannelModel, Cylinder, Vec3, simd::with_widest_simd};

use crate::belief::{
    expected::ExpectedGains,
    tilt::{self, Tilt},
};

/// The mirrors that light one user; its buffers are allocated once.
#[derive(Clone, Debug)]
pub(super) struct LitMirrors {
    /// Height of the receiver in m.
    height_m: f64,
    /// The column of each mirror, array after array.
    columns: Vec<usize>,
    lit: Vec<usize>,
    /// From the receiver to each mirror in m, and the squared length in plan view.
    x: Vec<f64>,
    y: Vec<f64>,
    rise: Vec<f64>,
    squared: Vec<f64>,
    /// Slopes of that direction; see [`tilt::slopes`].
    slopes: Vec<[f64; 2]>,
    /// By LED, of those that are lit. Shape: leds * lit mirrors.
    gains: Vec<f64>,
    /// What is left of the gains of one LED.
    left: Vec<f64>,
}

impl LitMirrors {
    /// Buffers for all mirrors.
    pub fn new(model: &ChannelModel) -> Self {
        let mirrors = model.mirrors.len();
        let mut columns = Vec::with_capacity(mirrors);
        for ((_, mirrors), (_, of_array)) in model.mirrors.ranges().zip(model.mirrors.column_ranges()) {
            columns.extend(mirrors.clone().map(|mirror| of_array.start + (mirror - mirrors.start) % of_array.len()));
        }
        let buffer = || Vec::with_capacity(mirrors);
        Self {
            height_m: 0.0,
            columns,
            lit: Vec::with_capacity(mirrors),
            x: buffer(),
            y: buffer(),
            rise: buffer(),
            squared: buffer(),
            slopes: Vec::with_capacity(mirrors),
            gains: Vec::with_capacity(mirrors * model.leds.len()),
            left: buffer(),
        }
    }

    /// Lists the mirrors with an expected gain for the selected user by any lit LED.
    pub fn select(&mut self, model: &ChannelModel, expected: &ExpectedGains, user: usize) {
        let Self { lit, x, y, rise, squared, slopes, gains, left, .. } = self;
        lit.clear();
        let is_lit = |mirror: &usize| expected.lit().any(|led| expected.gains(led)[*mirror] > 0.0);
        lit.extend((0..model.mirrors.len()).filter(is_lit));
        let position: &Vec3 = &expected.positions()[user];
        self.height_m = position.z;
        [&mut *x, y, rise, squared].into_iter().for_each(Vec::clear);
        slopes.clear();
        for mirror in lit.iter() {
            let towards = model.mirrors.positions()[*mirror] - position;
            x.push(towards.x);
            y.push(towards.y);
            rise.push(towards.z);
            squared.push(towards.x * towards.x + towards.y * towards.y);
            slopes.push(tilt::slopes(position, &model.mirrors.positions()[*mirror]));
        }
        gains.clear();
        gains.resize(expected.leds().len() * lit.len(), 0.0);
        for led in expected.lit() {
            let of_led = expected.gains(led);
            gains[led * lit.len()..].iter_mut().zip(&*lit).for_each(|(gain, mirror)| *gain = of_led[*mirror]);
        }
        left.clear();
        left.resize(lit.len(), 0.0);
    }

    /// Writes the gain over each column of mirrors by an LED, past a body, of a receiver that is
    /// tilted from the one as evaluated. `body` is relative to the receiver in plan view; a path
    /// that it blocks, by [`blockage::blocks`](heliostat_channel::blockage::blocks), has no gain.
    pub fn sum_columns(&mut self, led: usize, body: Option<&Cylinder>, tilt: Option<&Tilt>, out: &mut [f64]) {
        let body = body.filter(|body| body.radius_m > 0.0);
        with_widest_simd(
            #[inline(always)]
            || {
                let lit = self.left.len();
                self.left.copy_from_slice(&self.gains[led * lit..][..lit]);
                if let Some(tilt) = tilt {
                    self.left.iter_mut().zip(&self.slopes).for_each(|(gain, slopes)| *gain *= tilt.factor(*slopes));
                }
                if let Some(body) = body {
                    self.shade(body);
                }
            },
        );
        out.fill(0.0);
        self.lit.iter().zip(&self.left).for_each(|(mirror, gain)| out[self.columns[*mirror]] += gain);
    }

    /// Removes the gains whose paths the body blocks.
    #[inline(always)]
    fn shade(&mut self, body: &Cylinder) {
        let outside = body.x_m * body.x_m + body.y_m * body.y_m - body.radius_m * body.radius_m;
        let count = self.left.len();
        let (x, y, rise, squared) = (&self.x[..count], &self.y[..count], &self.rise[..count], &self.squared[..count]);
        for (index, left) in self.left.iter_mut().enumerate() {
            let nearest = body.x_m * x[index] + body.y_m * y[index];
            let discriminant = nearest * nearest - squared[index] * outside;
            let half = discriminant.max(0.0).sqrt();
            let enter = ((nearest - half) / squared[index]).max(0.0);
            let leave = ((nearest + half) / squared[index]).min(1.0);
            let (first, last) = (self.height_m + enter * rise[index], self.height_m + leave * rise[index]);
            let is_blocked = (discriminant > 0.0)
                & (enter < leave)
                & ((first <= body.height_m) | (last <= body.height_m))
                & ((first >= 0.0) | (last >= 0.0));
            *left = if is_blocked { 0.0 } else { *left };
        }
    }
}

#[cfg(test)]
mod tests {
    use heliostat_channel::mirrors::MirrorAngles;
    use heliostat_scenario::Scenario;

    use super::*;
    use crate::belief::{
        expected::{HeldPlace, Room},
        heading::Heading,
        posture::Held,
    };

    #[test]
    fn the_light_past_a_body_is_that_of_the_visible_mirrors() {
        let scenario = Scenario::builtin("hall").expect("a built-in scenario");
        let model = scenario.channel_model().expect("a valid room");
        let body = scenario.blockage.body().expect("bodies block light");
        let mut expected = ExpectedGains::new(&model, 1);
        let mut lit = LitMirrors::new(&model);
        let (mut clear, mut sums) = (vec![false; model.mirrors.len()], vec![0.0; model.mirrors.columns()]);
        let mut shaded = 0;
        for place in [[0.3, -0.7], [-1.9, 1.1], [0.05, 2.3], [2.2, -2.2]] {
            let position = Vec3::new(place[0], place[1], 0.85);
            let held = HeldPlace { position, held: Held::Upright(0.5), heading: Vec3::zeros() };
            let mut angles = MirrorAngles::flat(model.mirrors.len());
            let aims = model.mirrors.positions().iter().map(|mirror| {
                let normal = (model.leds[0].position - mirror).normalize() + (position - mirror).normalize();
                normal.normalize()
            });
            for (mirror, normal) in aims.enumerate() {
                angles.roll[mirror] = -normal.z.asin();
                angles.yaw[mirror] = (-normal.x).atan2(-normal.y);
            }
            let room = Room { model: &model, obstacles: &[], angles: Some(&angles), unusable: &[] };
            expected.update(&room, std::iter::once(held));
            expected.select(&model, 0, &[]);
            expected.light(&room, 0, 0);
            lit.select(&model, &expected, 0);
            assert!(lit.lit.len() > 50, "the mirrors are aimed at the user: {}", lit.lit.len());
            for index in 0..36 {
                let direction = Heading::direction(index);
                let behind = body.behind(&position, &direction);
                model.mirrors.visible_from(&position, std::slice::from_ref(&behind), &mut clear);
                shaded += clear.iter().filter(|clear| !**clear).count();
                let tilt = (index % 2 == 0).then(|| Tilt::towards_face(0.4_f64.sin_cos(), &direction));
                lit.sum_columns(0, Some(&body.behind(&Vec3::zeros(), &direction)), tilt.as_ref(), &mut sums);
                for (column, sum) in sums.iter().enumerate() {
                    let mirrors = (0..model.mirrors.len()).filter(|mirror| mirror % 10 == column && clear[*mirror]);
                    let factor = |mirror: usize| {
                        let slopes = tilt::slopes(&position, &model.mirrors.positions()[mirror]);
                        tilt.map_or(1.0, |tilt| tilt.factor(slopes))
                    };
                    let direct: f64 = mirrors.map(|mirror| expected.gains(0)[mirror] * factor(mirror)).sum();
                    assert!(
                        (sum - direct).abs() <= 1e-12 * direct,
                        "heading {index}, column {column}: {sum}, {direct}"
                    );
                }
            }
        }
        assert!(shaded > 500, "bodies block some paths: {shaded}");
    }
}
