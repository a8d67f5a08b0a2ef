//! The heat map as an SVG file: floor, obstacles, users, colour bar and legend.

use std::f64::consts::TAU;
use std::path::Path;

use anyhow::Result;
use heliostat_channel::Cylinder;
use heliostat_reproduce::figure::Floor;
use heliostat_scenario::Scenario;
use heliostat_sim::World;
use plotters::coord::Shift;
use plotters::prelude::*;

use super::quantity::Quantity;

type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;

/// Width and height of the map, of the colour bar and of the legend, in pixels.
const MAP: u32 = 640;
const BAR_WIDTH: u32 = 120;
const LEGEND_HEIGHT: u32 = 40;
/// Height of the caption above and the axis below the floor; the colour bar is aligned with the
/// floor.
const ABOVE: u32 = 44;
const BELOW: u32 = 50;

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
    /// Draws the map into an SVG file.
    pub fn draw(&self, out: &Path) -> Result<()> {
        let root = SVGBackend::new(out, (MAP + BAR_WIDTH, MAP + LEGEND_HEIGHT)).into_drawing_area();
        root.fill(&WHITE)?;
        let (top, legend) = root.split_vertically(MAP);
        let (floor, bar) = top.split_horizontally(MAP);
        let scale = Scale::of(self.quantity, self.map);
        let title = format!("{}, scenario {}", self.quantity.label(), self.scenario.name);
        top.draw(&Text::new(title, (70, 14), ("sans-serif", 20)))?;
        draw_floor(&floor, self, &scale)?;
        draw_bar(&bar, self.quantity.label(), &scale)?;
        draw_legend(&legend, self.mirrors)?;
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
        .margin_left(10)
        .margin_right(10)
        .margin_top(ABOVE)
        .x_label_area_size(BELOW)
        .y_label_area_size(50)
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
    chart.draw_series(world.model().leds.iter().map(|led| {
        TriangleMarker::new((led.position.x, led.position.y), 6, ShapeStyle::from(&WHITE).stroke_width(2))
    }))?;
    let mirrors = &world.model().mirrors;
    let foot = |index: usize| (mirrors.positions()[index].x, mirrors.positions()[index].y);
    chart.draw_series([PathElement::new(vec![foot(0), foot(mirrors.columns() - 1)], BLUE.stroke_width(8))])?;
    Ok(())
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
