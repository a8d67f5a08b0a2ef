//! After construction, a step does not allocate in any mode.

use crate::common::{PAPER, Random, Room, angle_diversity, led};
use heliostat_channel::decode::{aim_at_point, decode};
use heliostat_channel::{Combining, Method, MinimumRates, MirrorAngles, Scene, Solver, Vec3};

#[test]
fn a_step_does_not_allocate() {
    let mut branches = Room::paper();
    branches.receiver.branches = angle_diversity();
    branches.receiver.combining = Combining::MaximalRatio;
    branches.leds.push(led(1.0, 1.0, 0.1));
    for room in [Room::paper(), Room::paper().with_panel(), Room::paper().with_mode(PAPER), branches] {
        let model = room.model();
        let mut random = Random::new(41);
        let users = random.positions(20);
        let blockers = random.blockers(&users);
        let orientations = [(); 20].map(|()| random.orientation());
        let mut scene = Scene::new(&model, 20);
        let mut angles = MirrorAngles::flat(100);
        let (mut rates, mut each) = ([0.0; 20], vec![0.0; 2000]);
        let counted = allocation_counter::measure(|| {
            scene.update(&model, &users, &blockers, &[false; 20]);
            scene.update_turned(&model, &users, &orientations, &blockers, &[false; 20]);
            decode(&model, &scene, &[1.0; 20], &mut angles);
            scene.rates_bps(&model, &angles, &mut rates);
            scene.irs_gain_each(&model, &angles, &mut each);
            aim_at_point(&model, &users[3], &mut angles);
            scene.irs_gain(&model, &angles, &mut rates);
            scene.set_los_gain(&rates);
        });
        assert_eq!(counted.count_total, 0);
        assert!(each.iter().any(|gain| *gain > 0.0));
    }
}

#[test]
fn users_who_come_and_go_do_not_make_scene_and_solver_allocate() {
    for room in [Room::paper(), Room::paper().with_mode(PAPER)] {
        let model = room.model();
        let mut random = Random::new(42);
        // Half of the users stand in one spot.
        let mut positions = random.positions(20);
        for user in 0..10 {
            positions[user] = positions[0] + Vec3::new(0.04 * user as f64, 0.0, 0.0);
        }
        let (mut scene, mut solver) = (Scene::new(&model, 20), Solver::with_capacity(1, 20, 100));
        let mut angles = MirrorAngles::flat(100);
        let former = [None; 20];
        for users in [3, 1, 20, 7] {
            let counted = allocation_counter::measure(|| {
                scene.resize(users);
                scene.update(&model, &positions[..users], &[], &[false; 20][..users]);
                solver.change_users(&former[..users]);
                solver.solve(&model, &scene, &MinimumRates::NONE, Method::Greedy { passes: 1 }, &mut angles);
                solver.solve(&model, &scene, &MinimumRates::NONE, Method::Oracle, &mut angles);
            });
            assert_eq!(counted.count_total, 0, "{users} users");
        }
    }
}
