//! The plots of the report, as SVG elements.

use anyhow::Result;
use heliostat_learn::comparison::{Report, Row, Spread};
use heliostat_reproduce::draw::style::{axis_number, short_number, style};
use heliostat_reproduce::draw::svg;
use heliostat_reproduce::figure::{Axis, Figure, Panel, Point, Series};
use heliostat_service::printable::printable;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::super::cells::rows;
use super::super::differences::Difference;
use super::super::sweep::{Grid, Sweep};

/// Width of a plot, of its column of names, and height of a row and of the axis, in pixels.
const WIDTH: u32 = 600;
const NAMES: u32 = 190;
const ROW: u32 = 28;
const AXIS: u32 = 32;
const TITLE: u32 = 30;
/// Longest name in characters; the table has the complete one.
const NAME_MAX: usize = 26;
/// Characters below an axis of categories, and the fewest of each.
const CATEGORIES: usize = 56;
const CATEGORY_MIN: usize = 3;
/// Share of the distance between two categories in which the policies are beside each other.
const BESIDE: f64 = 0.6;

/// A value with its interval; NaN where there is none.
struct Dot<'a> {
    name: &'a str,
    at: f64,
    low: f64,
    high: f64,
}

/// A figure of a row, and its title.
type Quantity = (&'static str, fn(&Row) -> Spread);

const QUANTITIES: [Quantity; 4] = [
    ("sum rate (Mbit/s)", |row| row.sum_rate_mbps),
    ("ratio to the oracle", |row| row.ratio_to_oracle),
    ("QoS met (share of the users)", |row| row.qos_met),
    ("outage (share of the users' time)", |row| row.outage_time.unwrap_or(Spread::MISSING)),
];

/// The quantities that a comparison has.
fn quantities(report: &Report) -> impl Iterator<Item = Quantity> {
    let has = |(_, quantity): &Quantity| !quantity(&report.oracle).mean.is_nan();
    QUANTITIES.into_iter().filter(has)
}

/// A plot of each quantity by policy, and one of the decision times where they are measured.
pub fn by_policy(report: &Report) -> Result<String> {
    let mut plots = String::new();
    for (title, quantity) in quantities(report) {
        let dots = rows(report).map(|(name, row)| {
            let spread = quantity(row);
            let [low, high] = spread.ends();
            Dot { name, at: spread.mean, low, high }
        });
        plots += &draw(&format!("{title}, 95 % interval of the mean"), false, &dots.collect::<Vec<_>>())?;
    }
    plots += &differences(report)?;
    let times = report.policies.iter().filter_map(|(name, row)| {
        row.decision_us.map(|times| Dot { name, at: times.p50, low: times.p50, high: times.p99 })
    });
    let times: Vec<Dot> = times.filter(|dot| dot.at > 0.0).collect();
    if !times.is_empty() {
        plots += &draw("decision time (us), median to 99th percentile", true, &times)?;
    }
    Ok(plots)
}

/// The figures of the oracle and of each further policy minus those of the first; nothing for a single policy.
fn differences(report: &Report) -> Result<String> {
    let mut plots = String::new();
    for Difference { figure, of, .. } in Difference::all(report) {
        let dots = rows(report).filter_map(|(name, row)| {
            let spread = of(row)?;
            let [low, high] = spread.ends();
            Some(Dot { name, at: spread.mean, low, high })
        });
        let dots: Vec<Dot> = dots.collect();
        if !dots.is_empty() {
            let first = short_name(&report.policies[0].0);
            plots += &draw(&format!("{figure}: minus that of {first}, paired, 95 % interval"), false, &dots)?;
        }
    }
    Ok(plots)
}

/// A curve of each quantity for each policy over the values of the first key, in one panel for each
/// value of a second key; points beside each other if a value of the first key is no number.
pub fn over(grid: &Grid, reports: &[Report]) -> Result<String> {
    let (axis, places) = first_axis(grid);
    let seconds: Vec<Option<&str>> = match grid.sweeps() {
        [_, second] => second.values().iter().map(|value| Some(value.as_str())).collect(),
        _ => vec![None],
    };
    let mut plots = String::new();
    for (title, quantity) in quantities(&reports[0]) {
        let panels = seconds.iter().map(|second| {
            let points = || reports.iter().zip(&places).zip(grid.points());
            let points = || points().filter(|(_, point)| point.get(1).copied() == *second).map(|(found, _)| found);
            let count = rows(&reports[0]).count() as f64;
            let series = rows(&reports[0]).enumerate().map(|(index, (name, _))| {
                let aside = if axis.names.is_empty() { 0.0 } else { BESIDE * ((index as f64 + 0.5) / count - 0.5) };
                let points = points().filter_map(|(report, x)| {
                    // A point may lack a policy that does not fit it.
                    let spread = quantity(rows(report).find(|(of, _)| *of == name)?.1);
                    let ci95 = (!spread.ci95.is_nan()).then_some(spread.ci95);
                    (!spread.mean.is_nan()).then_some(Point { x: *x + aside, y: spread.mean, ci95, x_ci95: None })
                });
                let mut points: Vec<Point> = points.collect();
                points.sort_by(|one, other| one.x.total_cmp(&other.x));
                // The style knows the oracle by its plain name.
                Series { name: printable(name.trim_matches(['(', ')'])).into_owned(), points }
            });
            let key = grid.keys().nth(1).unwrap_or_default();
            let title = second.map_or(String::new(), |value| printable(&format!("{key} = {value}")).into_owned());
            Panel { title, series: series.collect(), ..Panel::default() }
        });
        let [low, high] = quantity(&reports[0].oracle).bounds;
        let figure = Figure {
            room: printable(&reports[0].scenario).into_owned(),
            title: title.into(),
            x: axis.clone(),
            y: Axis { bounds: low.is_finite().then_some([low, high]), ..Axis::linear(title) },
            panels: panels.collect(),
            ..Figure::default()
        };
        plots += &svg::draw(&figure)?;
    }
    Ok(plots)
}

/// The axis of the first key, and the place of each point on it: categories if a value is no number.
fn first_axis(grid: &Grid) -> (Axis, Vec<f64>) {
    let key = printable(grid.keys().next().unwrap_or_default());
    let numbers: Result<Vec<f64>, _> = grid.points().iter().map(|point| point[0].parse::<f64>()).collect();
    if let Some(numbers) = numbers.ok().filter(|numbers| numbers.iter().all(|value| value.is_finite())) {
        return (Axis::linear(&key), numbers);
    }
    let values = grid.sweeps().first().map_or(&[][..], Sweep::values);
    let length = (CATEGORIES / values.len().max(1)).max(CATEGORY_MIN);
    let place = |point: &Vec<&str>| values.iter().position(|value| value == point[0]).map_or(0.0, |at| at as f64 + 1.0);
    let names = values.iter().map(|value| shortened(value, length)).collect();
    (Axis::categories(&key, names), grid.points().iter().map(place).collect())
}

/// Draws one row for each dot, the first at the top.
fn draw(title: &str, is_log: bool, dots: &[Dot]) -> Result<String> {
    let place = |value: f64| if is_log { value.max(f64::MIN_POSITIVE).log10() } else { value };
    let [low, high] = ends(is_log, dots, place);
    let rows = dots.len() as u32;
    let mut out = String::new();
    {
        let root = SVGBackend::with_string(&mut out, (WIDTH, TITLE + rows * ROW + AXIS)).into_drawing_area();
        root.fill(&WHITE)?;
        let heading = ("sans-serif", 15).into_font().color(&BLACK).pos(Pos::new(HPos::Left, VPos::Center));
        root.draw(&Text::new(title, (8, TITLE as i32 / 2), heading))?;
        let (_, rest) = root.split_vertically(TITLE);
        let mut chart = ChartBuilder::on(&rest)
            .margin_right(24)
            .x_label_area_size(AXIS)
            .y_label_area_size(NAMES)
            .build_cartesian_2d(low..high, 0.0..f64::from(rows))?;
        let label = |value: &f64| match is_log {
            false => axis_number(*value, [low, high]),
            true if (value - value.round()).abs() < 1e-6 => short_number(10_f64.powf(value.round())),
            true => String::new(),
        };
        let ticks = if is_log { (high - low).round() as usize + 1 } else { 7 };
        chart
            .configure_mesh()
            .disable_y_mesh()
            .y_labels(0)
            .light_line_style(TRANSPARENT)
            .bold_line_style(RGBColor(225, 225, 225))
            .label_style(("sans-serif", 13))
            .x_labels(ticks)
            .x_label_formatter(&label)
            .draw()?;
        for (index, dot) in dots.iter().enumerate() {
            let [red, green, blue] = style(dot.name.trim_matches(['(', ')'])).rgb;
            let colour = RGBColor(red, green, blue);
            let row = f64::from(rows) - index as f64 - 0.5;
            let middle = index as i32 * ROW as i32 + ROW as i32 / 2;
            let font = ("sans-serif", 13).into_font().color(&BLACK).pos(Pos::new(HPos::Right, VPos::Center));
            rest.draw(&Text::new(short_name(dot.name), (NAMES as i32 - 10, middle), font))?;
            if dot.low.is_finite() && dot.high.is_finite() {
                let ends = vec![(place(dot.low).max(low), row), (place(dot.high), row)];
                chart.draw_series([PathElement::new(ends, colour.mix(0.45).stroke_width(7))])?;
            }
            if dot.at.is_finite() {
                chart.draw_series([Circle::new((place(dot.at), row), 4, colour.filled())])?;
            }
        }
        root.present()?;
    }
    Ok(out)
}

/// The ends of the axis: whole decades of a logarithmic one; a linear one contains 0.
fn ends(is_log: bool, dots: &[Dot], place: impl Fn(f64) -> f64) -> [f64; 2] {
    let values = dots.iter().flat_map(|dot| [dot.at, dot.low, dot.high]).filter(|value| value.is_finite()).map(place);
    let [low, high] =
        values.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], value| [low.min(value), high.max(value)]);
    if !low.is_finite() || !high.is_finite() {
        return [0.0, 1.0];
    }
    if is_log {
        let (low, high) = (low.floor(), high.ceil());
        return [low, high.max(low + 1.0)];
    }
    let (low, high) = (low.min(0.0), high.max(0.0));
    let margin = 0.05 * (high - low);
    let low = if low < 0.0 { low - margin } else { 0.0 };
    [low, if high > low { high + margin } else { 1.0 }]
}

/// The end of a path names its file.
fn short_name(name: &str) -> String {
    shortened(name, NAME_MAX)
}

/// The last characters of a text, at most this many.
fn shortened(text: &str, most: usize) -> String {
    let text = printable(text);
    let length = text.chars().count();
    if length <= most {
        return text.into_owned();
    }
    let end: String = text.chars().skip(length + 1 - most).collect();
    format!("…{end}")
}
