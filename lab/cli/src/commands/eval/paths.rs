//! The users of one episode as an SVG file: where they are, and where the controller believes them to
//! be.

use anyhow::{Result, ensure};
use heliostat_learn::comparison::TrackedUser;
use heliostat_scenario::Scenario;
use plotters::prelude::*;

use crate::commands::drawn_room::{Plan, draw_equipment};

/// The longer side of the floor in pixels; the shorter one has the same scale.
const FLOOR: f64 = 720.0;
/// Height of the caption above the floor and of the legend below it, and the width of the axes.
const ABOVE: u32 = 40;
const LEGEND: u32 = 50;
const AXIS: u32 = 45;
const MARGIN: u32 = 10;
/// Time between two drawn ellipses and headings of a user in s.
const SPACING_S: f64 = 1.0;
/// Probability of the true place within an ellipse.
const PROBABILITY: f64 = 0.95;
/// Points of an ellipse.
const POINTS: usize = 32;
/// Length of an arrow, and of each side of its head, as shares of the floor's longer side.
const ARROW: f64 = 0.05;
const HEAD: f64 = 0.012;
/// The colour of the truth.
const TRUTH: RGBColor = RGBColor(150, 150, 150);
/// Angle between an arrow and a side of its head in rad.
const HEAD_ANGLE: f64 = 0.45;

/// Draws the users of an episode as SVG text.
///
/// # Errors
/// No policy has the belief `filter`, or an error of the drawing library.
pub fn draw(scenario: &Scenario, tracked: &[TrackedUser]) -> Result<String> {
    ensure!(!tracked.is_empty(), "--paths: no policy predicts users; expected one with the belief filter");
    let (x_m, y_m) = (scenario.room.length_x_m, scenario.room.length_y_m);
    let longer_m = x_m.max(y_m);
    let pixels = |length_m: f64| (FLOOR / longer_m * length_m).round().max(1.0) as u32;
    let size = (pixels(x_m) + AXIS + 2 * MARGIN, pixels(y_m) + ABOVE + AXIS);
    let mut svg = String::new();
    {
        let root = SVGBackend::with_string(&mut svg, (size.0, size.1 + LEGEND)).into_drawing_area();
        root.fill(&WHITE)?;
        let (floor, legend) = root.split_vertically(size.1);
        let after_s = tracked.iter().fold(0.0, |latest: f64, user| latest.max(user.after_s));
        let title = format!("users of one episode of {after_s:.1} s, scenario {}", scenario.name);
        floor.draw(&Text::new(title, (AXIS as i32, 12), ("sans-serif", 18)))?;
        let mut plan: Plan = ChartBuilder::on(&floor)
            .margin_left(MARGIN)
            .margin_right(MARGIN)
            .margin_top(ABOVE)
            .x_label_area_size(AXIS)
            .y_label_area_size(AXIS)
            .build_cartesian_2d(-x_m / 2.0..x_m / 2.0, -y_m / 2.0..y_m / 2.0)?;
        plan.configure_mesh().disable_mesh().x_desc("x (m)").y_desc("y (m)").label_style(("sans-serif", 13)).draw()?;
        draw_equipment(&mut plan, &scenario.channel_model()?, &BLACK)?;
        let mut users: Vec<u32> = tracked.iter().map(|user| user.user).collect();
        users.sort_unstable();
        users.dedup();
        for user in users {
            let of_user: Vec<&TrackedUser> = tracked.iter().filter(|one| one.user == user).collect();
            draw_user(&mut plan, &of_user, longer_m)?;
        }
        let notes = [
            "grey: the true path and, each second, the true heading; colours: the predicted path, heading and 95 % ellipse",
            "triangles: LEDs; blue bars: mirror arrays; each prediction is for the time in which its command acts",
        ];
        for (row, note) in (0..).zip(notes) {
            legend.draw(&Text::new(note, (MARGIN as i32, 6 + 18 * row), ("sans-serif", 12)))?;
        }
        root.present()?;
    }
    Ok(svg)
}

fn draw_user(plan: &mut Plan, instants: &[&TrackedUser], longer_m: f64) -> Result<()> {
    let Some(first) = instants.first() else { return Ok(()) };
    let colour = Palette99::pick(first.user as usize);
    let path = |of: fn(&TrackedUser) -> [f64; 2]| instants.iter().map(|one| pair(of(one))).collect::<Vec<_>>();
    plan.draw_series([
        PathElement::new(path(|one| one.true_m), TRUTH.stroke_width(3)),
        PathElement::new(path(|one| one.believed_m), colour.stroke_width(2)),
    ])?;
    let mut next_s = first.after_s;
    for one in instants {
        if one.after_s < next_s {
            continue;
        }
        next_s = one.after_s + SPACING_S;
        let edge = one.ellipse(PROBABILITY, POINTS).into_iter().map(pair).collect::<Vec<_>>();
        plan.draw_series([PathElement::new(edge, colour.stroke_width(2))])?;
        plan.draw_series([
            arrow(one.true_m, one.true_heading, longer_m, TRUTH.stroke_width(3)),
            arrow(one.believed_m, one.believed_heading, longer_m, colour.stroke_width(2)),
        ])?;
    }
    Ok(())
}

/// An arrow from a point in m along a unit vector; a dot for a zero vector.
fn arrow(from: [f64; 2], along: [f64; 2], longer_m: f64, style: ShapeStyle) -> PathElement<(f64, f64)> {
    let length = ARROW * longer_m;
    let tip = [0, 1].map(|axis| from[axis] + length * along[axis]);
    let side = |angle: f64| {
        let (sine, cosine) = angle.sin_cos();
        let back = [-(cosine * along[0] - sine * along[1]), -(sine * along[0] + cosine * along[1])];
        [0, 1].map(|axis| tip[axis] + HEAD * longer_m * back[axis])
    };
    PathElement::new([from, tip, side(HEAD_ANGLE), tip, side(-HEAD_ANGLE)].map(pair), style)
}

fn pair([x, y]: [f64; 2]) -> (f64, f64) {
    (x, y)
}
