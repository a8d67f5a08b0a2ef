//! The heat map as an SVG file: floor, obstacles, users, colour bar and legend.

use std::f64::consts::TAU;

use anyhow::Result;
use heliostat_channel::Cylinder;
use heliostat_reproduce::figure::Floor;
use heliostat_room::World;
use heliostat_scenario::Scenario;
use plotters::coord::Shift;
use plotters::prelude::*;

use super::quantity::Quantity;
use crate::commands::drawn_room::draw_equipment;

type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;

/// The longer side of the floor in pixels; the shorter one has the same scale.
const FLOOR: f64 = 560.0;
/// Least width and height of the part with the floor: the legend and the colour bar need them.
const MAP_LEAST: [u32; 2] = [640, 240];
/// Width of the colour bar and height of the legend in pixels.
const BAR_WIDTH: u32 = 120;
const LEGEND_HEIGHT: u32 = 40;
/// Height of the caption above and the axis below the floor.
const ABOVE: u32 = 44;
const BELOW: u32 = 50;
/// Margins beside the floor, and the width of its axis.
const MARGIN: u32 = 10;
const LEFT_AXIS: u32 = 50;
/// Lengths of the scale bar in m; it is the longest that fits [`SCALE_BAR`] pixels.
const SCALE_BARS_M: [f64; 8] = [0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0];
const SCALE_BAR: f64 = 120.0;

/// A heat map and the objects in the room.
pub struct Picture<'a> {
    pub quantity: Quantity,
    /// The mirror angles as given on the command line.
    pub mirrors: &'a str,
    pub scenario: &'a Scenario,
    pub world: &'a World,
    pub map: &'a Floor,
}

impl Picture<'_> {
    /// Draws the map as SVG text; returns it with the scale in pixels a metre, which is the same on
    /// both axes.
    pub fn draw(&self) -> Result<(String, f64)> {
        let (x_m, y_m) = (self.scenario.room.length_x_m, self.scenario.room.length_y_m);
        let pixels_per_m = FLOOR / x_m.max(y_m);
        let pixels = |length_m: f64| (pixels_per_m * length_m).round().max(1.0) as u32;
        let chart = (pixels(x_m) + LEFT_AXIS + 2 * MARGIN, pixels(y_m) + ABOVE + BELOW);
        let (width, height) = (chart.0.max(MAP_LEAST[0]), chart.1.max(MAP_LEAST[1]));
        let mut svg = String::new();
        {
            let size = (width + BAR_WIDTH, height + LEGEND_HEIGHT);
            self.draw_on(SVGBackend::with_string(&mut svg, size).into_drawing_area(), chart, pixels_per_m)?;
        }
        Ok((svg, pixels_per_m))
    }

    /// Draws floor, colour bar and legend; `chart` is the size of the floor with its axes.
    fn draw_on(&self, root: Area<'_>, chart: (u32, u32), pixels_per_m: f64) -> Result<()> {
        root.fill(&WHITE)?;
        let (width, height) = root.dim_in_pixel();
        let (top, legend) = root.split_vertically(height - LEGEND_HEIGHT);
        let (left, bar) = top.split_horizontally(width - BAR_WIDTH);
        let floor = left.margin(0, left.dim_in_pixel().1 - chart.1, 0, left.dim_in_pixel().0 - chart.0);
        let scale = Scale::of(self.quantity, self.map);
        let title = format!("{}, scenario {}", self.quantity.label(), self.scenario.name);
        top.draw(&Text::new(title, (70, 14), ("sans-serif", 20)))?;
        draw_floor(&floor, self, &scale)?;
        draw_bar(&bar, self.quantity.label(), &scale)?;
        draw_legend(&legend, self.mirrors)?;
        draw_scale_bar(&legend, pixels_per_m)?;
        root.present()?;
        Ok(())
    }
}

/// The mapping from values to colours.
struct Scale {
    low: f64,
    high: f64,
}

impl Scale {
    fn of(what: Quantity, map: &Floor) -> Self {
        let (low, high) = match what {
            Quantity::Coverage => (0.0, 1.0),
            Quantity::Rate | Quantity::Sinr => {
                let [low, high] = map.range();
                (low, high)
            }
        };
        Self { low, high: if high > low { high } else { low + 1.0 } }
    }

    /// The Viridis scale: perceptually uniform, and readable with colour-vision deficiency.
    fn colour(&self, value: f64) -> RGBColor {
        ViridisRGB::get_color(((value - self.low) / (self.high - self.low)).clamp(0.0, 1.0))
    }
}

fn draw_floor(area: &Area, picture: &Picture, scale: &Scale) -> Result<()> {
    let Picture { scenario, world, map, .. } = picture;
    let (half_x, half_y) = (scenario.room.length_x_m / 2.0, scenario.room.length_y_m / 2.0);
    let mut chart = ChartBuilder::on(area)
        .margin_left(MARGIN)
        .margin_right(MARGIN)
        .margin_top(ABOVE)
        .x_label_area_size(BELOW)
        .y_label_area_size(LEFT_AXIS)
        .build_cartesian_2d(-half_x..half_x, -half_y..half_y)?;
    chart.configure_mesh().disable_mesh().x_desc("x (m)").y_desc("y (m)").label_style(("sans-serif", 13)).draw()?;
    let half = [half_x / map.columns as f64, half_y / map.rows as f64];
    chart.draw_series(map.values.iter().enumerate().map(|(index, value)| {
        let [x, y] = map.centre(index % map.columns, index / map.columns);
        Rectangle::new([(x - half[0], y - half[1]), (x + half[0], y + half[1])], scale.colour(*value).filled())
    }))?;
    // White on black, visible on every colour of the scale.
    for style in [BLACK.stroke_width(4), WHITE.stroke_width(2)] {
        chart.draw_series(world.blockers().iter().map(|cylinder| PathElement::new(outline(cylinder), style)))?;
    }
    chart.draw_series(
        world.users().iter().map(|user| Cross::new((user.position.x, user.position.y), 5, RED.stroke_width(2))),
    )?;
    draw_equipment(&mut chart, world.model(), &WHITE)
}

fn outline(cylinder: &Cylinder) -> Vec<(f64, f64)> {
    let at = |step: i32| {
        let (sin, cos) = (TAU * f64::from(step) / 32.0).sin_cos();
        (cylinder.x_m + cylinder.radius_m * cos, cylinder.y_m + cylinder.radius_m * sin)
    };
    (0..=32).map(at).collect()
}

fn draw_bar(area: &Area, label: &str, scale: &Scale) -> Result<()> {
    let mut bar = ChartBuilder::on(area)
        .margin_right(20)
        .margin_top(ABOVE)
        .margin_bottom(BELOW)
        .y_label_area_size(60)
        .build_cartesian_2d(0.0..1.0, scale.low..scale.high)?;
    bar.configure_mesh().disable_mesh().disable_x_axis().label_style(("sans-serif", 13)).y_desc(label).draw()?;
    bar.draw_series((0..128).map(|step| {
        let at = |step: i32| scale.low + f64::from(step) / 128.0 * (scale.high - scale.low);
        Rectangle::new([(0.0, at(step)), (1.0, at(step + 1))], scale.colour(at(step)).filled())
    }))?;
    Ok(())
}

/// A line of a round length, with the length.
fn draw_scale_bar(area: &Area, pixels_per_m: f64) -> Result<()> {
    let fits = |length_m: &&f64| **length_m * pixels_per_m <= SCALE_BAR;
    let length_m = SCALE_BARS_M.iter().rev().find(fits).copied().unwrap_or(SCALE_BARS_M[0]);
    let (width, middle) = (area.dim_in_pixel().0 as i32, LEGEND_HEIGHT as i32 / 2);
    let start = width - SCALE_BAR as i32 - 50;
    let end = start + (length_m * pixels_per_m).round() as i32;
    area.draw(&PathElement::new(vec![(start, middle), (end, middle)], BLACK.stroke_width(3)))?;
    area.draw(&Text::new(format!("{length_m} m"), (end + 8, middle - 6), ("sans-serif", 14)))?;
    Ok(())
}

/// The symbols of the map, each with its name.
fn draw_legend(area: &Area, mirrors: &str) -> Result<()> {
    let middle = LEGEND_HEIGHT as i32 / 2;
    let ground =
        |x: i32| Rectangle::new([(x - 14, middle - 11), (x + 14, middle + 11)], ViridisRGB::get_color(0.3).filled());
    let name = |x: i32, text: String| Text::new(text, (x + 20, middle - 6), ("sans-serif", 14));
    let places = [70, 160, 250, 410];
    places[..3].iter().try_for_each(|x| area.draw(&ground(*x)))?;
    area.draw(&Cross::new((places[0], middle), 5, RED.stroke_width(2)))?;
    area.draw(&name(places[0], "user".into()))?;
    area.draw(&TriangleMarker::new((places[1], middle), 6, ShapeStyle::from(&WHITE).stroke_width(2)))?;
    area.draw(&name(places[1], "LED".into()))?;
    area.draw(&Circle::new((places[2], middle), 8, WHITE.stroke_width(2)))?;
    area.draw(&name(places[2], "obstacle or body".into()))?;
    area.draw(&PathElement::new(vec![(places[3] - 14, middle), (places[3] + 14, middle)], BLUE.stroke_width(8)))?;
    area.draw(&name(places[3], format!("mirrors: {mirrors}")))?;
    Ok(())
}
