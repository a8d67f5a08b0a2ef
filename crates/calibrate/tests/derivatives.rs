//! The model of a mirror's light: its derivatives, and its agreement with the channel's reference.

use heliostat_calibrate::optics::{Optics, PLACE, QUANTITIES, Quantities, SEMI_ANGLE, variables};
use heliostat_channel::specular::{self, Plate};
use heliostat_channel::{ChannelModel, Vec3, los};
use heliostat_scenario::Scenario;

fn model(changes: &[&str]) -> ChannelModel {
    Scenario::builtin("specular").unwrap().with_overrides(changes).unwrap().channel_model().unwrap()
}

/// Quantities near the nominal ones, with every entry away from 0.
fn quantities() -> Quantities {
    let mut quantities: Quantities =
        [0.004, -0.006, 0.002, -0.001, 0.01, -0.02, 0.015, 0.03, -0.01, 0.05, -0.04, 0.0, 0.0, 0.0, -0.1];
    quantities[PLACE..PLACE + 3].copy_from_slice(&[-1.2, 0.4, 0.85]);
    quantities
}

#[test]
fn every_derivative_is_the_slope_of_the_gain() {
    let optics = Optics::new(&model(&[]), 0).unwrap();
    let quantities = quantities();
    for (mirror, aside) in [(0, [0.0, 0.0]), (37, [0.012, 0.0]), (99, [0.0, -0.035]), (55, [-0.014, 0.02])] {
        let aim = optics.aim((mirror, 0), &quantities).unwrap();
        let command = [0, 1].map(|axis| aim[axis] - quantities[axis] + aside[axis]);
        let exact = optics.mirror_gain((mirror, 0), command, &variables(&quantities));
        let direct = optics.direct_gain(0, &variables(&quantities));
        assert!(exact.re > 0.0, "mirror {mirror} is dark");
        let [of_mirror, of_direct] =
            [exact, direct].map(|dual| dual.eps.unwrap_generic(nalgebra::Const::<QUANTITIES>, nalgebra::U1));
        for index in 0..QUANTITIES {
            let step = 1e-6;
            let at = |sign: f64| {
                let mut moved = quantities;
                moved[index] += sign * step;
                (optics.mirror_gain((mirror, 0), command, &moved), optics.direct_gain(0, &moved))
            };
            let (up, down) = (at(1.0), at(-1.0));
            for (found, slope, scale) in [
                (of_mirror[index], (up.0 - down.0) / (2.0 * step), exact.re),
                (of_direct[index], (up.1 - down.1) / (2.0 * step), direct.re),
            ] {
                assert!(
                    (found - slope).abs() < 1e-4 * scale + 1e-4 * slope.abs(),
                    "mirror {mirror}, quantity {index}: {found} and {slope}"
                );
            }
        }
    }
}

#[test]
fn no_place_has_more_light_than_the_largest_gains() {
    let optics = Optics::new(&model(&["led.positions_m=[[0,0,3]]"]), 0).unwrap();
    let most = (optics.direct_gain_max(0.85), optics.mirror_gain_max());
    for [x, y] in [[0.0, 0.0], [-1.2, 0.4], [0.6, -0.7], [2.0, 2.0], [0.0, 2.3]] {
        let at = optics.array().wall_from_room(&Vec3::new(x, y, 0.85));
        let mut quantities: Quantities = [0.0; QUANTITIES];
        quantities[PLACE..PLACE + 3].copy_from_slice(at.as_slice());
        let direct = optics.direct_gain(0, &quantities);
        assert!(direct <= 1.000_001 * most.0, "{direct:e} at {x} {y}, and at most {:e}", most.0);
        for mirror in 0..100 {
            let Some(aim) = optics.aim((mirror, 0), &quantities) else { continue };
            let gain = optics.mirror_gain((mirror, 0), aim, &quantities);
            assert!(gain <= most.1, "{gain:e} of mirror {mirror} at {x} {y}, and at most {:e}", most.1);
        }
    }
    assert_eq!(optics.direct_gain_max(3.0), f64::INFINITY, "at the LED");
}

#[test]
fn the_smooth_light_is_that_of_the_channel_on_every_wall() {
    for wall in ["+y", "-y", "+x", "-x"] {
        let model = model(&[&format!("mirrors.wall={wall:?}"), "led.points_per_side=40"]);
        let optics = Optics::new(&model, 0).unwrap();
        let place = Vec3::new(0.6, -0.7, 0.85);
        let at = optics.array().wall_from_room(&place);
        let mut quantities = [0.0; QUANTITIES];
        quantities[PLACE..PLACE + 3].copy_from_slice(at.as_slice());
        let (receiver, branch) = (&model.receiver, &model.receiver.branches[0]);
        for mirror in [0, 44, 99] {
            let aim = optics.aim((mirror, 0), &quantities).unwrap();
            let peak = optics.mirror_gain((mirror, 0), aim, &quantities);
            for step in -8..=8 {
                let command = [aim[0] + f64::from(step) * 0.004, aim[1] - f64::from(step) * 0.008];
                let smooth = optics.mirror_gain((mirror, 0), command, &quantities);
                let plate = Plate::of(&model.mirrors, mirror, command[0], command[1]);
                let reflectivity = model.mirrors.reflectivity(mirror);
                let exact = specular::gain(&model.leds[0], &plate, reflectivity, (receiver, branch), &place).unwrap();
                assert!(
                    (smooth - exact).abs() < 0.06 * peak,
                    "wall {wall}, mirror {mirror}, step {step}: {smooth} and {exact}"
                );
            }
        }
        let direct = los::gain(&model.leds[0], receiver, branch, &place).unwrap();
        assert!((optics.direct_gain(0, &quantities) / direct - 1.0).abs() < 0.003, "{direct}");
    }
}

#[test]
fn a_wider_semi_angle_spreads_the_light() {
    let optics = Optics::new(&model(&[]), 0).unwrap();
    let mut wider = quantities();
    wider[SEMI_ANGLE] += 0.05;
    assert!(optics.direct_gain(0, &wider) != optics.direct_gain(0, &quantities()));
    assert!(optics.semi_angle(0.05) > optics.semi_angle(0.0));
}
