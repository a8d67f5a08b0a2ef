//! Computation of a scene's tables: serving LED, blockage, line-of-sight and steering gains.

use super::Scene;
use super::visibility::mark_visible;
use crate::blockage::{Cylinder, blocks};
use crate::geometry::Vec3;
use crate::los::unit_gain;
use crate::model::{ChannelModel, Detector, Panel};
use crate::orientation::Orientation;
use crate::receiver::BRANCHES_MAX;
use crate::simd::with_widest_simd;

impl Scene {
    /// Computes blockage, line-of-sight gains and steering gains for upright receivers at these
    /// positions.
    ///
    /// `users`: positions of the receivers in m. `forced`: whether the line-of-sight path of each
    /// user is blocked regardless of the cylinders. Shape of both: K. `blockers`: all cylinders in
    /// the room, including the users' own bodies. Paths run from the centre of a panel, directly or
    /// by way of the centre of a mirror, to the detector.
    ///
    /// # Panics
    /// When `users` or `forced` does not have one entry per user, or the model has another size
    /// than that of [`Scene::new`].
    pub fn update(&mut self, model: &ChannelModel, users: &[Vec3], blockers: &[Cylinder], forced: &[bool]) {
        assert_eq!(model.detectors.len(), self.branches, "the scene was made for another receiver");
        for held in self.detectors.chunks_exact_mut(self.branches) {
            held.copy_from_slice(&model.detectors);
        }
        self.update_paths(model, users, blockers, forced);
    }

    /// The same for receivers that the users hold in these orientations. Shape of `orientations`: K.
    ///
    /// A branch that faces away from a path has gain zero. With [`Orientation::UPRIGHT`] the gains
    /// are those of [`Scene::update`]. The literal interpretation of the paper's equations does
    /// not use the normals, so there only the direct gain depends on the orientation.
    ///
    /// # Panics
    /// As [`Scene::update`], and when `orientations` does not have one entry per user.
    pub fn update_turned(
        &mut self,
        model: &ChannelModel,
        users: &[Vec3],
        orientations: &[Orientation],
        blockers: &[Cylinder],
        forced: &[bool],
    ) {
        self.hold(model, orientations);
        self.update_paths(model, users, blockers, forced);
    }

    /// Places the receivers that the users hold in these orientations, without any gain: for receivers of
    /// unknown orientation, which any LED may serve. [`Scene::serve_by`] then computes the gains of one user.
    ///
    /// # Panics
    /// As [`Scene::update_turned`].
    pub fn place_turned(
        &mut self,
        model: &ChannelModel,
        users: &[Vec3],
        orientations: &[Orientation],
        blockers: &[Cylinder],
    ) {
        self.hold(model, orientations);
        with_widest_simd(
            #[inline(always)]
            || self.place(model, users, blockers),
        );
    }

    /// Turns the detectors of each user.
    fn hold(&mut self, model: &ChannelModel, orientations: &[Orientation]) {
        assert_eq!(orientations.len(), self.users, "one orientation per user");
        assert_eq!(model.detectors.len(), self.branches, "the scene was made for another receiver");
        for (held, orientation) in self.detectors.chunks_exact_mut(self.branches).zip(orientations) {
            model.turn_detectors(orientation, held);
        }
    }

    /// Computes all tables for the detectors as they are.
    fn update_paths(&mut self, model: &ChannelModel, users: &[Vec3], blockers: &[Cylinder], forced: &[bool]) {
        assert!(forced.len() == self.users, "one flag per user");
        with_widest_simd(
            #[inline(always)]
            || {
                self.place(model, users, blockers);
                for (user, forced) in forced.iter().enumerate() {
                    let pairs = user * self.mirrors..(user + 1) * self.mirrors;
                    mark_visible(&mut self.irs_path_clear[pairs], &model.mirrors, &self.positions[user], blockers);
                    let led = self.choose_led(model, blockers, user, *forced);
                    self.set_led(model, blockers, (user, led), *forced);
                }
            },
        );
    }

    /// Places the users, and marks the mirrors that are visible from each LED.
    #[inline(always)]
    fn place(&mut self, model: &ChannelModel, users: &[Vec3], blockers: &[Cylinder]) {
        assert_eq!(model.mirrors.len(), self.mirrors, "the scene was made for another array");
        assert_eq!(model.leds.len() * self.mirrors, self.led_path_clear.len(), "the scene was made for other LEDs");
        self.positions.copy_from_slice(users);
        for (led, clear) in self.led_path_clear.chunks_exact_mut(self.mirrors).enumerate() {
            mark_visible(clear, &model.mirrors, &model.leds[led].position, blockers);
        }
    }

    /// Serves one user by this LED until the next update, whichever LED is the strongest: for a
    /// receiver of unknown orientation. `blockers` are those of the update or of
    /// [`Scene::place_turned`]; mirrors that were excluded are not.
    ///
    /// # Panics
    /// When there is no such user or LED.
    pub fn serve_by(&mut self, model: &ChannelModel, blockers: &[Cylinder], user: usize, led: usize) {
        with_widest_simd(
            #[inline(always)]
            || {
                let pairs = user * self.mirrors..(user + 1) * self.mirrors;
                mark_visible(&mut self.irs_path_clear[pairs], &model.mirrors, &self.positions[user], blockers);
                self.set_led(model, blockers, (user, led), false);
            },
        );
    }

    /// Computes the gains of a user, whose visible mirrors are marked, for an LED.
    #[inline(always)]
    fn set_led(&mut self, model: &ChannelModel, blockers: &[Cylinder], (user, led): (usize, usize), forced: bool) {
        let position = self.positions[user];
        let pairs = user * self.mirrors..(user + 1) * self.mirrors;
        self.serving[user] = led;
        self.direct(model, user, led);
        let blocked = forced || is_blocked(model, blockers, led, &position);
        self.los_blocked[user] = blocked;
        let branches = user * self.branches..(user + 1) * self.branches;
        if blocked {
            self.los_branch[branches.clone()].fill(0.0);
        } else {
            self.los_branch[branches.clone()].copy_from_slice(&self.los_clear[branches.clone()]);
        }
        self.los_gain[user] = self.combining.combine(&self.los_branch[branches]);
        let led_path = &self.led_path_clear[led * self.mirrors..(led + 1) * self.mirrors];
        self.irs_path_clear[pairs].iter_mut().zip(led_path).for_each(|(both, clear)| *both &= clear);
        self.steer(model, user, led);
    }

    /// The LED with the largest unblocked line-of-sight gain, or else with the largest sum of
    /// steering gains.
    #[inline(always)]
    fn choose_led(&mut self, model: &ChannelModel, blockers: &[Cylinder], user: usize, forced: bool) -> usize {
        if model.leds.len() == 1 {
            return 0;
        }
        let (mut largest, mut first, mut equals) = (0.0, 0, 0);
        for led in 0..model.leds.len() {
            let direct = self.unblocked_direct(model, blockers, (user, led), forced);
            if direct > largest {
                (largest, first, equals) = (direct, led, 0);
            }
            equals += usize::from(direct == largest);
        }
        if equals == 1 {
            return first;
        }
        let mut best = (first, 0.0);
        for led in 0..model.leds.len() {
            if self.unblocked_direct(model, blockers, (user, led), forced) == largest {
                self.steer(model, user, led);
                let led_path = &self.led_path_clear[led * self.mirrors..(led + 1) * self.mirrors];
                let row = &self.steering_gain[user * self.mirrors..(user + 1) * self.mirrors];
                let steered: f64 = row.iter().zip(led_path).filter(|(_, clear)| **clear).map(|(gain, _)| gain).sum();
                if steered > best.1 {
                    best = (led, steered);
                }
            }
        }
        best.0
    }

    /// The line-of-sight gain of a user by any LED, combined over the branches; 0 where a blocker is before
    /// the LED. `blockers` are those of the update; no force blocks the path.
    ///
    /// # Panics
    /// When there is no such user or LED.
    pub fn los_gain_by(&self, model: &ChannelModel, blockers: &[Cylinder], user: usize, led: usize) -> f64 {
        let position = &self.positions[user];
        if is_blocked(model, blockers, led, position) {
            return 0.0;
        }
        let mut gains = [0.0; BRANCHES_MAX];
        let gains = &mut gains[..self.branches];
        direct_gains(&model.panels[led], &self.detectors[user * self.branches..][..self.branches], position, gains);
        self.combining.combine(gains)
    }

    /// The combined line-of-sight gain of a user by an LED; 0 where the path is blocked.
    #[inline(always)]
    fn unblocked_direct(
        &mut self,
        model: &ChannelModel,
        blockers: &[Cylinder],
        (user, led): (usize, usize),
        forced: bool,
    ) -> f64 {
        if forced || is_blocked(model, blockers, led, &self.positions[user]) {
            return 0.0;
        }
        self.direct(model, user, led);
        self.combining.combine(&self.los_clear[user * self.branches..(user + 1) * self.branches])
    }

    /// Writes the line-of-sight gain of each branch without blockage.
    #[inline(always)]
    fn direct(&mut self, model: &ChannelModel, user: usize, led: usize) {
        let branches = user * self.branches..(user + 1) * self.branches;
        let detectors = &self.detectors[branches.clone()];
        direct_gains(&model.panels[led], detectors, &self.positions[user], &mut self.los_clear[branches]);
    }
}

/// Writes the line-of-sight gain of each branch at a position, without blockage.
#[inline(always)]
fn direct_gains(panel: &Panel, detectors: &[Detector], position: &Vec3, gains: &mut [f64]) {
    for (out, detector) in gains.iter_mut().zip(detectors) {
        let branch = (&detector.normal, detector.fov_cosine);
        let gain = |point| unit_gain(point, panel.order, branch, position);
        *out = panel.front * detector.concentrator_gain * panel.points.iter().map(gain).sum::<f64>();
    }
}

fn is_blocked(model: &ChannelModel, blockers: &[Cylinder], led: usize, user: &Vec3) -> bool {
    blockers.iter().any(|blocker| blocks(blocker, &model.leds[led].position, user))
}
