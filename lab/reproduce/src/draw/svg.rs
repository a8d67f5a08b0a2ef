//! A figure as an SVG file.

use anyhow::Result;
use plotters::coord::types::RangedCoordf64;
use plotters::coord::{CoordTranslate, Shift};
use plotters::element::DashedPathElement;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::style::{Marker, QUOTED, axis_number, columns, short_number, style};
use crate::figure::{Axis, Figure, Floor, Panel, Point, Series};

type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;
type Chart<'a, 'b> = ChartContext<'a, SVGBackend<'b>, Cartesian2d<RangedCoordf64, RangedCoordf64>>;

/// Size of a panel in pixels, and what stands above and below all of them.
const PANEL: (u32, u32) = (450, 350);
const TITLE: u32 = 34;
const LEGEND_ROW: u32 = 22;
/// Width of the colour bar beside a floor.
const BAR: u32 = 90;
/// Width of one entry of the legend.
const ENTRY: u32 = 190;

/// Draws a figure, and returns the text of the file.
///
/// # Errors
/// An error of the drawing library.
pub fn draw(figure: &Figure) -> Result<String> {
    let across = columns(figure.panels.len()) as u32;
    let down = (figure.panels.len() as u32).div_ceil(across);
    let bar = if figure.floor_range().is_some() { BAR } else { 0 };
    let width = across * PANEL.0 + bar;
    let names = figure.names();
    let quoted = figure.panels.iter().any(|panel| !panel.quoted.is_empty());
    let entries_a_row = (width / ENTRY).max(1);
    let legend = (names.len() as u32 + u32::from(quoted)).div_ceil(entries_a_row) * LEGEND_ROW + 8;
    let mut text = String::new();
    {
        let root = SVGBackend::with_string(&mut text, (width, TITLE + down * PANEL.1 + legend)).into_drawing_area();
        root.fill(&WHITE)?;
        let title = ("sans-serif", 18).into_font().color(&BLACK).pos(Pos::new(HPos::Center, VPos::Top));
        let heading = format!("{} ({})", figure.title, figure.room);
        root.draw(&Text::new(heading, (width as i32 / 2, 8), title))?;
        let (_, rest) = root.split_vertically(TITLE);
        let (panels, foot) = rest.split_vertically(down * PANEL.1);
        let (panels, scale) = panels.split_horizontally(across * PANEL.0);
        let ranges = Ranges::of(figure);
        let areas = panels.split_evenly((down as usize, across as usize));
        for (panel, area) in figure.panels.iter().zip(&areas) {
            draw_panel(area, figure, panel, &ranges)?;
        }
        if let Some([low, high]) = figure.floor_range() {
            draw_scale(&scale, figure, low, high)?;
        }
        draw_legend(&foot, &names, quoted, entries_a_row)?;
        root.present()?;
    }
    Ok(text)
}

/// Where the axes begin and end, in the units in which they are drawn: the same for all panels.
struct Ranges {
    x: [f64; 2],
    y: [f64; 2],
}

impl Ranges {
    fn of(figure: &Figure) -> Self {
        let points = || figure.panels.iter().flat_map(|panel| &panel.series).flat_map(|series| &series.points);
        let quoted = || figure.panels.iter().flat_map(|panel| &panel.quoted);
        let floor = figure.panels.iter().find_map(|panel| panel.floor.as_ref());
        let xs = points().map(|point| point.x).chain(quoted().filter_map(|quoted| quoted.x));
        let ys = points().flat_map(|point| ends(&figure.y, point)).chain(quoted().filter_map(|quoted| quoted.y));
        match floor {
            Some(floor) => {
                let [x, y] = floor.half_m;
                Self { x: [-x, x], y: [-y, y] }
            }
            None => Self { x: range(&figure.x, xs, 0.0), y: range(&figure.y, ys, 0.05) },
        }
    }
}

/// The ends of the interval of a point.
fn ends(axis: &Axis, point: &Point) -> [f64; 2] {
    let half = point.ci95.unwrap_or(0.0);
    [point.y - half, point.y + half].map(|end| axis.cut(point.y, end))
}

/// The axis' own range, or that of the values with a margin; a linear axis of positive values
/// begins at 0.
fn range(axis: &Axis, values: impl Iterator<Item = f64>, margin: f64) -> [f64; 2] {
    if let Some(range) = axis.range {
        return range.map(|value| place(axis, value));
    }
    let [mut low, mut high] = values.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], value| {
        let value = place(axis, value);
        [low.min(value), high.max(value)]
    });
    if !low.is_finite() || !high.is_finite() {
        return [0.0, 1.0];
    }
    if !axis.log && low >= 0.0 {
        low = 0.0;
    }
    high += margin * (high - low);
    [low, if high > low { high } else { low + 1.0 }]
}

/// A value as the axis draws it: its logarithm on a logarithmic one, not below the axis.
fn place(axis: &Axis, value: f64) -> f64 {
    if !axis.log {
        return value;
    }
    let floor = axis.range.map_or(f64::MIN_POSITIVE, |[low, _]| low);
    value.max(floor).log10()
}

fn draw_panel(area: &Area, figure: &Figure, panel: &Panel, ranges: &Ranges) -> Result<()> {
    let mut chart = ChartBuilder::on(area)
        .caption(&panel.title, ("sans-serif", 15))
        .margin(8)
        .margin_right(16)
        .x_label_area_size(42)
        .y_label_area_size(60)
        .build_cartesian_2d(ranges.x[0]..ranges.x[1], ranges.y[0]..ranges.y[1])?;
    let label = |axis: &Axis, range: [f64; 2]| {
        let log = axis.log;
        move |value: &f64| {
            if !log {
                axis_number(*value, range)
            } else if (value - value.round()).abs() < 1e-6 {
                short_number(10_f64.powf(value.round()))
            } else {
                String::new()
            }
        }
    };
    let (x_number, y_label) = (label(&figure.x, ranges.x), label(&figure.y, ranges.y));
    let has_categories = !figure.x.names.is_empty();
    let x_label = |value: &f64| match has_categories {
        true => figure.x.category(*value).unwrap_or_default().to_owned(),
        false => x_number(value),
    };
    let ticks = |range: [f64; 2], log: bool| if log { (range[1] - range[0]).round() as usize + 1 } else { 7 };
    let mut mesh = chart.configure_mesh();
    mesh.x_desc(&figure.x.label)
        .y_desc(&figure.y.label)
        .label_style(("sans-serif", 12))
        .light_line_style(TRANSPARENT)
        .bold_line_style(RGBColor(225, 225, 225))
        .x_labels(if has_categories { figure.x.names.len() } else { ticks(ranges.x, figure.x.log) })
        .y_labels(ticks(ranges.y, figure.y.log))
        .x_label_formatter(&x_label)
        .y_label_formatter(&y_label);
    mesh.draw()?;
    if let (Some(floor), Some([low, high])) = (&panel.floor, figure.floor_range()) {
        draw_floor(&mut chart, floor, low, high)?;
    }
    for series in &panel.series {
        draw_series(&mut chart, figure, series)?;
    }
    draw_quoted(&mut chart, figure, panel, ranges)
}

fn draw_series(chart: &mut Chart, figure: &Figure, series: &Series) -> Result<()> {
    let look = style(&series.name);
    let [red, green, blue] = look.rgb;
    let colour = RGBColor(red, green, blue);
    let at = |x: f64, y: f64| (place(&figure.x, x), place(&figure.y, y));
    let has_categories = !figure.x.names.is_empty();
    if has_categories {
        let measured = series.points.iter().filter(|point| point.ci95.is_some());
        let intervals = measured.map(|point| ends(&figure.y, point).map(|end| at(point.x, end)));
        chart.draw_series(intervals.map(|ends| PathElement::new(ends, colour.mix(0.35).stroke_width(7))))?;
    } else if series.points.iter().any(|point| point.ci95.is_some()) {
        let upper = series.points.iter().map(|point| at(point.x, ends(&figure.y, point)[1]));
        let lower = series.points.iter().rev().map(|point| at(point.x, ends(&figure.y, point)[0]));
        chart.draw_series([Polygon::new(upper.chain(lower).collect::<Vec<_>>(), colour.mix(0.18).filled())])?;
    }
    // What lies below a logarithmic axis is not on it.
    let begin = figure.y.range.filter(|_| figure.y.log).map_or(f64::NEG_INFINITY, |[low, _]| low);
    let shown = series.points.iter().filter(|point| point.y >= begin);
    let path: Vec<_> = shown.map(|point| at(point.x, point.y)).collect();
    if look.points_only {
        chart.draw_series(path.iter().map(|point| Cross::new(*point, 5, colour.stroke_width(2))))?;
    } else if let Some([on, off]) = look.dashes.filter(|_| !has_categories) {
        chart.draw_series([DashedPathElement::new(path.clone(), on, off, colour.stroke_width(2))])?;
    } else if !has_categories {
        // Nothing lies between two categories.
        chart.draw_series([PathElement::new(path.clone(), colour.stroke_width(2))])?;
    }
    let measured = series.points.iter().filter_map(|point| Some((point, point.x_ci95?)));
    let across = measured.map(|(point, half)| vec![at(point.x - half, point.y), at(point.x + half, point.y)]);
    chart.draw_series(across.map(|ends| PathElement::new(ends, colour.mix(0.35).stroke_width(7))))?;
    if (has_categories || path.len() <= 12) && !look.points_only {
        let plane = chart.plotting_area();
        path.iter().try_for_each(|point| draw_marker(plane, *point, look.marker, colour))?;
    }
    Ok(())
}

/// Draws the sign of a point.
fn draw_marker<C: CoordTranslate>(
    area: &DrawingArea<SVGBackend, C>,
    at: C::From,
    marker: Marker,
    colour: RGBColor,
) -> Result<()> {
    let square = [(-3, -3), (3, 3)];
    match marker {
        Marker::Circle => area.draw(&Circle::new(at, 3, colour.filled()))?,
        Marker::Triangle => area.draw(&TriangleMarker::new(at, 5, colour.filled()))?,
        Marker::Cross => area.draw(&Cross::new(at, 4, colour.stroke_width(2)))?,
        Marker::Square => area.draw(&(EmptyElement::at(at) + Rectangle::new(square, colour.filled())))?,
        Marker::Ring => area.draw(&Circle::new(at, 5, colour.stroke_width(2)))?,
    }
    Ok(())
}

fn draw_quoted(chart: &mut Chart, figure: &Figure, panel: &Panel, ranges: &Ranges) -> Result<()> {
    let colour = RGBColor(QUOTED[0], QUOTED[1], QUOTED[2]);
    for quoted in &panel.quoted {
        let (x, y) = (quoted.x.map(|x| place(&figure.x, x)), quoted.y.map(|y| place(&figure.y, y)));
        let line = |ends: [(f64, f64); 2]| DashedPathElement::new(ends, 3, 3, colour.stroke_width(2));
        // The text stands on the side of its mark where there is room.
        let (at, right) = match (x, y) {
            (Some(x), Some(y)) => {
                chart.draw_series([TriangleMarker::new((x, y), 7, colour.filled())])?;
                ((x, y), x > 0.6 * ranges.x[1] + 0.4 * ranges.x[0])
            }
            (Some(x), None) => {
                chart.draw_series([line([(x, ranges.y[0]), (x, ranges.y[1])])])?;
                ((x, 0.98 * ranges.y[1] + 0.02 * ranges.y[0]), x > 0.5 * (ranges.x[1] + ranges.x[0]))
            }
            (None, Some(y)) => {
                chart.draw_series([line([(ranges.x[0], y), (ranges.x[1], y)])])?;
                ((ranges.x[0], y), false)
            }
            (None, None) => continue,
        };
        let (side, shift) = if right { (HPos::Right, -9) } else { (HPos::Left, 9) };
        let font = ("sans-serif", 12).into_font().color(&colour).pos(Pos::new(side, VPos::Bottom));
        let text = EmptyElement::at(at) + Text::new(quoted.text.clone(), (shift, -2), font);
        chart.draw_series([text])?;
    }
    Ok(())
}

/// Viridis: even steps to the eye, readable without colour vision.
fn floor_colour(value: f64, low: f64, high: f64) -> RGBColor {
    ViridisRGB::get_color(if high > low { (value - low) / (high - low) } else { 0.0 })
}

fn draw_floor(chart: &mut Chart, floor: &Floor, low: f64, high: f64) -> Result<()> {
    let half = [floor.half_m[0] / floor.columns as f64, floor.half_m[1] / floor.rows as f64];
    chart.draw_series(floor.values.iter().enumerate().map(|(index, value)| {
        let [x, y] = floor.centre(index % floor.columns, index / floor.columns);
        let corners = [(x - half[0], y - half[1]), (x + half[0], y + half[1])];
        Rectangle::new(corners, floor_colour(*value, low, high).filled())
    }))?;
    Ok(())
}

fn draw_scale(area: &Area, figure: &Figure, low: f64, high: f64) -> Result<()> {
    let label = figure.panels.iter().find_map(|panel| panel.floor.as_ref()).map_or("", |floor| &floor.label);
    let high = if high > low { high } else { low + 1.0 };
    let mut chart = ChartBuilder::on(area)
        .margin_top(36)
        .margin_bottom(50)
        .margin_right(16)
        .y_label_area_size(52)
        .build_cartesian_2d(0.0..1.0, low..high)?;
    chart.configure_mesh().disable_mesh().disable_x_axis().label_style(("sans-serif", 12)).y_desc(label).draw()?;
    chart.draw_series((0..64).map(|step| {
        let at = |step: i32| low + f64::from(step) / 64.0 * (high - low);
        Rectangle::new([(0.0, at(step)), (1.0, at(step + 1))], floor_colour(at(step), low, high).filled())
    }))?;
    Ok(())
}

fn draw_legend(area: &Area, names: &[&str], quoted: bool, entries_a_row: u32) -> Result<()> {
    let font = ("sans-serif", 13).into_font().color(&BLACK).pos(Pos::new(HPos::Left, VPos::Center));
    let spot = |index: usize| {
        let (column, row) = (index as u32 % entries_a_row, index as u32 / entries_a_row);
        ((column * ENTRY + 60) as i32, (row * LEGEND_ROW + 12) as i32)
    };
    for (index, name) in names.iter().enumerate() {
        let look = style(name);
        let colour = RGBColor(look.rgb[0], look.rgb[1], look.rgb[2]);
        let (x, y) = spot(index);
        let ends = [(x, y), (x + 26, y)];
        // White signs on the map need a ground.
        if look.rgb == [255; 3] {
            area.draw(&Rectangle::new([(x - 2, y - 8), (x + 28, y + 8)], ViridisRGB::get_color(0.3).filled()))?;
        }
        if look.points_only {
            area.draw(&Cross::new((x + 13, y), 5, colour.stroke_width(2)))?;
        } else if let Some([on, off]) = look.dashes {
            area.draw(&DashedPathElement::new(ends, on, off, colour.stroke_width(2)))?;
        } else {
            area.draw(&PathElement::new(ends, colour.stroke_width(2)))?;
        }
        if look.marker != Marker::Circle {
            draw_marker(area, (x + 13, y), look.marker, colour)?;
        }
        area.draw(&Text::new((*name).to_owned(), (x + 32, y), font.clone()))?;
    }
    if quoted {
        let (x, y) = spot(names.len());
        let colour = RGBColor(QUOTED[0], QUOTED[1], QUOTED[2]);
        area.draw(&TriangleMarker::new((x + 13, y), 7, colour.filled()))?;
        area.draw(&Text::new("quoted from the paper", (x + 32, y), font))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_belief_of_a_series_shows_at_its_points_and_in_the_legend() {
        let triangles = |belief: &str| {
            let point = Point { x: 1.0, y: 0.9, ci95: None, x_ci95: None };
            let points = vec![point, Point { x: 2.0, ..point }];
            let series = vec![Series { name: format!("greedy+{belief}"), points }];
            let panels = vec![Panel { series, ..Panel::default() }];
            let figure = Figure { x: Axis::linear("users"), y: Axis::linear("ratio"), panels, ..Figure::default() };
            draw(&figure).expect("a figure").matches("<polygon").count()
        };
        assert_eq!(["filter", "constant-velocity"].map(triangles), [0, 3]);
    }

    #[test]
    fn categories_have_their_names_and_points_without_a_curve() {
        let drawn = |x: Axis| {
            let point = Point { x: 1.0, y: 0.9, ci95: Some(0.05), x_ci95: None };
            let points = vec![point, Point { x: 2.0, ..point }];
            let panels = vec![Panel { series: vec![Series { name: "flat".into(), points }], ..Panel::default() }];
            draw(&Figure { x, y: Axis::linear("ratio"), panels, ..Figure::default() }).expect("a figure")
        };
        let categories = drawn(Axis::categories("combining", ["best", "equal-gain"].map(String::from).into()));
        let numbers = drawn(Axis::linear("combining"));
        let named = |text: &str| ["best", "equal-gain"].map(|name| text.matches(name).count());
        assert_eq!((named(&categories), named(&numbers)), ([1, 1], [0, 0]), "{categories}");
        // The band of the intervals is a polygon.
        let bands = [&categories, &numbers].map(|text| text.contains("<polygon"));
        assert_eq!(bands, [false, true], "{categories}");
    }

    #[test]
    fn an_interval_is_not_drawn_beyond_the_values_that_its_quantity_can_have() {
        let point = Point { x: 1.0, y: 0.9, ci95: Some(2.0), x_ci95: None };
        let rate = Axis::linear("sum rate (Mbit/s)");
        let share = Axis { bounds: Some([0.0, 1.0]), ..rate.clone() };
        let signed = Axis { bounds: Some([f64::NEG_INFINITY, f64::INFINITY]), ..rate.clone() };
        assert_eq!(ends(&rate, &point), [0.0, 2.9]);
        assert_eq!(ends(&share, &point), [0.0, 1.0]);
        assert_eq!(ends(&signed, &point), [-1.1, 2.9]);
        let figure = Figure {
            y: rate,
            panels: vec![Panel {
                series: vec![Series { name: "flat".into(), points: vec![point, Point { x: 2.0, ..point }] }],
                ..Panel::default()
            }],
            ..Figure::default()
        };
        assert_eq!(Ranges::of(&figure).y[0], 0.0, "no negative rate on the axis");
    }
}
