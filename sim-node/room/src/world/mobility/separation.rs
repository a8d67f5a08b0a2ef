//! Users of the social force model stay clear of other users, obstacles and walls.
//!
//! The repulsion of the model is finite, so it does not exclude contact. Each user is a disc. Discs
//! that would overlap after a step are pushed apart, which lets users slide past each other. A user
//! whose step would still bring it closer to a disc that it touches does not make the step.

use crate::world::mobility::member::Member;
use crate::world::mobility::motion::GRID_S;
use crate::world::mobility::places::{Places, distance_m};

/// Passes over all pairs of discs.
const PASSES: usize = 4;
/// Overlap in m that is rounding.
const ROUNDING_M: f64 = 1e-9;

/// Keeps the next places of all users of the social force model apart, and sets their velocities.
pub fn separate(members: &mut [Member], places: &Places, radius_m: f64) {
    for _ in 0..PASSES {
        if !push_apart(members, places, radius_m) {
            break;
        }
    }
    let half = places.half_extents_m(radius_m);
    for member in members.iter_mut() {
        if let Some(reach_m) = member.reach_m() {
            // The last push can have been into a wall.
            member.to.at = [0, 1].map(|axis| member.to.at[axis].clamp(-half[axis], half[axis]));
            shorten(member, reach_m);
            member.is_held = false;
        }
    }
    hold_back(members, places, radius_m);
    for member in members.iter_mut().filter(|member| member.reach_m().is_some()) {
        member.to.velocity = [0, 1].map(|axis| (member.to.at[axis] - member.from.at[axis]) / GRID_S);
    }
}

/// One pass over walls, obstacles and pairs; returns whether a place changed.
fn push_apart(members: &mut [Member], places: &Places, radius_m: f64) -> bool {
    let half = places.half_extents_m(radius_m);
    let mut changed = false;
    for index in 0..members.len() {
        let can_move = is_moving(&members[index]);
        for other in 0..index {
            let (a, b) = (members[index].to.at, members[other].to.at);
            let least_m = 2.0 * radius_m;
            let moves = [can_move, is_moving(&members[other])];
            if (moves[0] || moves[1]) && is_within(a, b, least_m) {
                let share = if moves[0] && moves[1] { 0.5 } else { 1.0 };
                let push = push(b, a, least_m).map(|component| component * share);
                [0, 1].into_iter().for_each(|axis| {
                    members[index].to.at[axis] += if moves[0] { push[axis] } else { 0.0 };
                    members[other].to.at[axis] -= if moves[1] { push[axis] } else { 0.0 };
                });
                changed = true;
            }
        }
        if can_move {
            changed |= push_into_room(&mut members[index].to.at, places, half, radius_m);
        }
    }
    changed
}

fn push_into_room(at: &mut [f64; 2], places: &Places, half: [f64; 2], radius_m: f64) -> bool {
    let before = *at;
    for obstacle in &places.obstacles {
        let least_m = obstacle.radius_m + radius_m;
        if is_within(*at, obstacle.at, least_m) {
            let push = push(obstacle.at, *at, least_m);
            *at = [at[0] + push[0], at[1] + push[1]];
        }
    }
    *at = [0, 1].map(|axis| at[axis].clamp(-half[axis], half[axis]));
    *at != before
}

/// Whether two places are closer than a distance.
fn is_within(a: [f64; 2], b: [f64; 2], least_m: f64) -> bool {
    let [x, y] = [a[0] - b[0], a[1] - b[1]];
    x * x + y * y < least_m * least_m
}

/// The way in m that moves a place to a distance from another one.
fn push(from: [f64; 2], at: [f64; 2], least_m: f64) -> [f64; 2] {
    let way_m = distance_m(from, at);
    // Two places that are the same have no direction between them.
    let direction = if way_m > 0.0 { [0, 1].map(|axis| (at[axis] - from[axis]) / way_m) } else { [1.0, 0.0] };
    direction.map(|component| component * (least_m - way_m))
}

/// Whether others can move this user.
fn is_moving(member: &Member) -> bool {
    member.reach_m().is_some_and(|reach_m| reach_m > 0.0)
}

/// Shortens a step to the longest way of the user.
fn shorten(member: &mut Member, reach_m: f64) {
    let way_m = distance_m(member.from.at, member.to.at);
    if way_m > reach_m {
        let scale = reach_m / way_m;
        member.to.at = [0, 1].map(|axis| member.from.at[axis] + scale * (member.to.at[axis] - member.from.at[axis]));
    }
}

/// Undoes steps until none brings a user closer to a disc that it touches.
fn hold_back(members: &mut [Member], places: &Places, radius_m: f64) {
    let mut changed = true;
    while changed {
        changed = false;
        for index in 0..members.len() {
            if is_moving(&members[index]) && !members[index].is_held && is_touching(members, index, places, radius_m) {
                members[index].to.at = members[index].from.at;
                members[index].is_held = true;
                changed = true;
            }
        }
    }
}

/// Whether the step of a user brings it closer to a user or an obstacle that it touches.
fn is_touching(members: &[Member], index: usize, places: &Places, radius_m: f64) -> bool {
    let me = &members[index];
    // A pair that overlapped before may stay as it is, so that it can come apart.
    let is_closer = |now: [f64; 2], before: [f64; 2], least_m: f64| {
        is_within(me.to.at, now, least_m - ROUNDING_M)
            && distance_m(me.to.at, now) < distance_m(me.from.at, before) - ROUNDING_M
    };
    let others = members.iter().enumerate().filter(|(other, _)| *other != index);
    places.obstacles.iter().any(|obstacle| is_closer(obstacle.at, obstacle.at, obstacle.radius_m + radius_m))
        || others.into_iter().any(|(_, other)| is_closer(other.to.at, other.from.at, 2.0 * radius_m))
}
