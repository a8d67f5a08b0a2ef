//! A figure as an interactive plot for a page that includes the plotting library once.

use plotly::color::{NamedColor, Rgb, Rgba};
use plotly::common::{
    Anchor, ColorBar, ColorScale, ColorScalePalette, DashType, ErrorData, ErrorType, Fill, Font, HoverInfo, Line,
    Marker, MarkerSymbol, Mode, Orientation, Position, Title,
};
use plotly::layout::{Annotation, Axis as PlotlyAxis, AxisRange, AxisType, Legend, Margin};
use plotly::{Configuration, HeatMap, Layout, Plot, Scatter};

use super::style::{QUOTED, columns, style};
use crate::figure::{Axis, Figure, Panel, Point, Series};

/// Largest number of panels in a figure.
pub const PANELS_MAX: usize = 8;

/// Height of a row of panels, and of what stands above and below all of them, in pixels.
const ROW: usize = 380;
const AROUND: usize = 150;

/// The script that draws a figure into the element `id`, and the element.
///
/// # Panics
/// When the figure has more than [`PANELS_MAX`] panels.
pub fn draw(figure: &Figure, id: &str) -> String {
    assert!(figure.panels.len() <= PANELS_MAX, "{} panels", figure.panels.len());
    let mut plot = Plot::new();
    let mut named = Vec::new();
    for (index, panel) in figure.panels.iter().enumerate() {
        add_panel(&mut plot, figure, panel, index, &mut named);
    }
    plot.set_layout(layout(figure));
    plot.set_configuration(Configuration::new().responsive(true).display_logo(false));
    let height = figure.panels.len().div_ceil(columns(figure.panels.len())) * ROW + AROUND;
    format!("<div class=\"plot\" style=\"height:{height}px\">{}</div>", plot.to_inline_html(Some(id)))
}

/// The plotting library, for the head of the page.
pub fn library() -> String {
    let sources = Plot::offline_js_sources();
    // The later scripts typeset formulas, which are not used.
    let end = sources.find("</script>").map_or(sources.len(), |end| end + "</script>".len());
    sources[..end].to_owned()
}

fn layout(figure: &Figure) -> Layout {
    let across = columns(figure.panels.len());
    let down = figure.panels.len().div_ceil(across);
    let mut layout = Layout::new()
        .margin(Margin::new().left(70).right(20).top(40).bottom(110))
        .font(Font::new().family("system-ui, sans-serif").size(12))
        .plot_background_color(NamedColor::White)
        .legend(Legend::new().orientation(Orientation::Horizontal).y(-0.2 / down as f64).y_anchor(Anchor::Top));
    let mut titles = Vec::new();
    for (index, panel) in figure.panels.iter().enumerate() {
        let (column, row) = (index % across, index / across);
        let share = |place: usize, count: usize, gap: f64| {
            let size = (1.0 - gap * (count - 1) as f64) / count as f64;
            let begin = place as f64 * (size + gap);
            [begin, begin + size]
        };
        let across_gap = if figure.floor_range().is_some() { 0.12 } else { 0.08 };
        let (x_domain, y_domain) = (share(column, across, across_gap), share(down - 1 - row, down, 0.24));
        let suffix = suffix(index);
        let mut x = axis(&figure.x).domain(&x_domain).anchor(format!("y{suffix}"));
        let mut y = axis(&figure.y).domain(&y_domain).anchor(format!("x{suffix}"));
        if panel.floor.is_some() {
            (x, y) = (x.show_grid(false).zero_line(false), y.show_grid(false).zero_line(false));
        }
        layout = place_axes(layout, index, x, y);
        titles.push(
            Annotation::new()
                .text(format!("<b>{}</b>", panel.title))
                .x_ref("paper")
                .y_ref("paper")
                .x((x_domain[0] + x_domain[1]) / 2.0)
                .y(y_domain[1])
                .x_anchor(Anchor::Center)
                .y_anchor(Anchor::Bottom)
                .show_arrow(false),
        );
    }
    layout.annotations(titles)
}

fn suffix(index: usize) -> String {
    if index == 0 { String::new() } else { (index + 1).to_string() }
}

fn place_axes(layout: Layout, index: usize, x: PlotlyAxis, y: PlotlyAxis) -> Layout {
    match index {
        0 => layout.x_axis(x).y_axis(y),
        1 => layout.x_axis2(x).y_axis2(y),
        2 => layout.x_axis3(x).y_axis3(y),
        3 => layout.x_axis4(x).y_axis4(y),
        4 => layout.x_axis5(x).y_axis5(y),
        5 => layout.x_axis6(x).y_axis6(y),
        6 => layout.x_axis7(x).y_axis7(y),
        _ => layout.x_axis8(x).y_axis8(y),
    }
}

fn axis(axis: &Axis) -> PlotlyAxis {
    let mut plotted = PlotlyAxis::new()
        .title(Title::with_text(&axis.label))
        .show_line(true)
        .line_color(Rgb::new(120, 120, 120))
        .grid_color(Rgb::new(225, 225, 225))
        .zero_line(false);
    if axis.log {
        plotted = plotted.type_(AxisType::Log).dtick(1.0).exponent_format(plotly::common::ExponentFormat::Power);
    } else {
        plotted = plotted.range_mode(plotly::layout::RangeMode::ToZero);
    }
    if let Some([low, high]) = axis.range {
        let ends = if axis.log { [low.log10(), high.log10()] } else { [low, high] };
        plotted = plotted.range(AxisRange::new(ends[0], ends[1]));
    }
    plotted
}

/// `named` holds the names that have their place in the legend already.
fn add_panel(plot: &mut Plot, figure: &Figure, panel: &Panel, index: usize, named: &mut Vec<String>) {
    let axes = (format!("x{}", suffix(index)), format!("y{}", suffix(index)));
    if let (Some(floor), Some([low, high])) = (&panel.floor, figure.floor_range()) {
        let rows: Vec<Vec<f64>> = floor.values.chunks(floor.columns).map(<[f64]>::to_vec).collect();
        let xs = (0..floor.columns).map(|column| floor.centre(column, 0)[0]).collect();
        let ys = (0..floor.rows).map(|row| floor.centre(0, row)[1]).collect();
        let map = HeatMap::new(xs, ys, rows)
            .zmin(low)
            .zmax(high)
            .color_scale(ColorScale::Palette(ColorScalePalette::Viridis))
            .show_scale(index + 1 == figure.panels.len())
            .color_bar(ColorBar::new().title(Title::with_text(&floor.label)))
            .x_axis(&axes.0)
            .y_axis(&axes.1);
        plot.add_trace(map);
    }
    for series in &panel.series {
        let first = !named.contains(&series.name);
        if first {
            named.push(series.name.clone());
        }
        if let Some(band) = band(series) {
            plot.add_trace(band.x_axis(&axes.0).y_axis(&axes.1));
        }
        plot.add_trace(curve(series).show_legend(first).x_axis(&axes.0).y_axis(&axes.1));
    }
    for quoted in &panel.quoted {
        let name = "quoted from the paper".to_owned();
        let first = !named.contains(&name);
        if first {
            named.push(name.clone());
        }
        let (xs, ys) = ends(figure, panel, quoted.x, quoted.y);
        let line = xs.len() > 1;
        // One text: at the upper end of a line, beside a point.
        let texts =
            (0..xs.len()).map(|end| if end + 1 == xs.len() { quoted.text.clone() } else { String::new() }).collect();
        let [red, green, blue] = QUOTED;
        let colour = Rgb::new(red, green, blue);
        let trace = Scatter::new(xs, ys)
            .name(&name)
            .legend_group(&name)
            .show_legend(first)
            .mode(if line { Mode::LinesText } else { Mode::MarkersText })
            .marker(Marker::new().color(colour).size(11).symbol(MarkerSymbol::TriangleUp))
            .line(Line::new().color(colour).dash(DashType::Dot).width(2.0))
            .text_array(texts)
            .text_position(if line { Position::BottomLeft } else { Position::MiddleLeft })
            .text_font(Font::new().color(colour).size(11))
            .hover_info(HoverInfo::Text)
            .x_axis(&axes.0)
            .y_axis(&axes.1);
        plot.add_trace(trace);
    }
}

/// The ends of a quoted value: itself, or a line across the panel where one coordinate is not
/// given.
fn ends(figure: &Figure, panel: &Panel, x: Option<f64>, y: Option<f64>) -> (Vec<f64>, Vec<f64>) {
    let across = |axis: &Axis, value: fn(&Point) -> f64| {
        let values = panel.series.iter().flat_map(|series| &series.points).map(value);
        let [low, high] =
            values.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], value| [low.min(value), high.max(value)]);
        let begin = if axis.log { low } else { low.min(0.0) };
        axis.range.unwrap_or([begin, high]).to_vec()
    };
    match (x, y) {
        (Some(x), Some(y)) => (vec![x], vec![y]),
        (Some(x), None) => (vec![x; 2], across(&figure.y, |point| point.y)),
        (None, Some(y)) => (across(&figure.x, |point| point.x), vec![y; 2]),
        (None, None) => (vec![], vec![]),
    }
}

fn curve(series: &Series) -> Box<Scatter<f64, f64>> {
    let look = style(&series.name);
    let [red, green, blue] = look.rgb;
    let colour = Rgb::new(red, green, blue);
    let few = series.points.len() <= 12;
    let mode = match (look.points_only, few) {
        (true, _) => Mode::Markers,
        (false, true) => Mode::LinesMarkers,
        (false, false) => Mode::Lines,
    };
    let symbol = if look.points_only { MarkerSymbol::X } else { MarkerSymbol::Circle };
    let ci95 = series.points.iter().map(|point| point.ci95.unwrap_or(0.0)).collect();
    let along = series.points.iter().map(|point| point.x_ci95.unwrap_or(0.0)).collect();
    let curve = Scatter::new(
        series.points.iter().map(|point| point.x).collect(),
        series.points.iter().map(|point| point.y).collect(),
    )
    .name(&series.name)
    .legend_group(&series.name)
    .mode(mode)
    .line(Line::new().color(colour).width(2.0).dash(dash(look.dashes)))
    .marker(Marker::new().color(colour).size(if look.points_only { 9 } else { 6 }).symbol(symbol))
    // Shown when pointed at; the band is what is drawn.
    .error_y(ErrorData::new(ErrorType::Data).array(ci95).visible(false))
    .hover_template(format!("{}: %{{y:.4g}} ± %{{error_y.array:.2g}} at %{{x:.4g}}<extra></extra>", series.name));
    let measured = series.points.iter().any(|point| point.x_ci95.is_some());
    if measured { curve.error_x(ErrorData::new(ErrorType::Data).array(along)) } else { curve }
}

fn dash(dashes: Option<[i32; 2]>) -> DashType {
    match dashes {
        None => DashType::Solid,
        Some([on, _]) if on < 4 => DashType::Dot,
        Some([on, _]) if on > 10 => DashType::LongDash,
        Some(_) => DashType::Dash,
    }
}

/// The 95 % interval as an area around the curve.
fn band(series: &Series) -> Option<Box<Scatter<f64, f64>>> {
    if series.points.iter().all(|point| point.ci95.is_none()) {
        return None;
    }
    let edge = |point: &Point, sign: f64| (point.x, point.y + sign * point.ci95.unwrap_or(0.0));
    let upper = series.points.iter().map(|point| edge(point, 1.0));
    // On a logarithmic axis nothing can be drawn at zero or below.
    let lower =
        series.points.iter().rev().map(|point| edge(point, -1.0)).map(|(x, y)| (x, if y > 0.0 { y } else { 1e-12 }));
    let (xs, ys) = upper.chain(lower).unzip();
    let [red, green, blue] = style(&series.name).rgb;
    let band = Scatter::new(xs, ys)
        .name(&series.name)
        .legend_group(&series.name)
        .show_legend(false)
        .mode(Mode::Lines)
        .line(Line::new().width(0.0).color(Rgba::new(red, green, blue, 0.0)))
        .fill(Fill::ToSelf)
        .fill_color(Rgba::new(red, green, blue, 0.18))
        .hover_info(HoverInfo::Skip);
    Some(band)
}
