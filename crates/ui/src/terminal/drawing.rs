//! The layout of the full-screen view: complete at 80 x 24 characters, the users at 60 x 15.

use ratatui::Frame;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::{Color, Style, Stylize};
use ratatui::symbols::Marker;
use ratatui::text::{Line, Span};
use ratatui::widgets::{Axis, Block, Chart, Dataset, GraphType, Paragraph, Row, Table};

use crate::figures::{Figures, UserFigures};
use crate::sums::SumFigures;
use crate::terminal::texts::{FLAT, NO_IRS, ORACLE, POLICY, named, time, without_rates};

/// Longest bar of a user in characters.
const USER_BAR: u16 = 20;
/// Longest bar of a sum rate in characters.
const SUM_BAR: u16 = 14;
/// Width of times and counts in characters.
const TIMES_WIDTH: u16 = 38;
/// Most lines of the title.
const TITLE_LINES: usize = 2;
/// The name of the program before the first row of the title.
const PROGRAM: &str = "Heliostat  ";
/// Most rows about emergency stops.
const STOP_ROWS: usize = 5;
/// Rows of the sum rates with their title.
const SUM_ROWS: u16 = 5;
/// Rows of the times with their title.
const TIME_ROWS: u16 = 4;
/// Width from which times, counts and the chart are drawn beside the sum rates.
const WIDE: u16 = 76;

/// Also of the Okabe-Ito palette.
const GOOD: Color = Color::Rgb(0x00, 0x9E, 0x73);
const BAD: Color = Color::Rgb(0xD5, 0x5E, 0x00);

/// Draws the view: the figures, and the lines about emergency stops. Of a title of several lines a low window has the
/// first one.
pub(super) fn draw(
    frame: &mut Frame,
    title: &str,
    (figures, stops): (&Figures, &[String]),
    history: &[(f64, SumFigures)],
) {
    let Rect { width, height, .. } = frame.area();
    let (is_wide, problems) = (width >= WIDE, problems(figures));
    let problem_rows = (problems.len() as u16).min(if height >= 24 { 2 } else { 1 });
    let users = u16::try_from(figures.users.len()).unwrap_or(u16::MAX).saturating_add(1);
    let counts = if is_wide { TIME_ROWS + figures.counts.len().div_ceil(2) as u16 } else { 0 };
    let most = if height >= 24 { STOP_ROWS } else { 1 };
    let stops = stop_lines(stops, most);
    let stop_rows = stops.len() as u16;
    let title_width = usize::from(width).saturating_sub(PROGRAM.len());
    let titles = title.lines().take(if height >= 24 { TITLE_LINES } else { 1 });
    let titles: Vec<String> = titles.flat_map(|line| rows_of(line, title_width)).collect();
    let title_rows = titles.len() as u16;
    let users =
        users.min(height.saturating_sub(2 + title_rows + stop_rows + problem_rows + counts.max(SUM_ROWS)).max(2));
    let rows = [Constraint::Length(1 + title_rows + stop_rows), Constraint::Length(users), Constraint::Fill(1)];
    let foot = [Constraint::Length(problem_rows), Constraint::Length(1)];
    let areas = Layout::vertical(rows.into_iter().chain(foot)).split(frame.area());
    frame.render_widget(heading(&titles, figures, stops), areas[0]);
    draw_users(frame, areas[1], figures);
    if is_wide {
        let columns = [Constraint::Fill(1), Constraint::Length(TIMES_WIDTH)];
        let [rates, times] = Layout::horizontal(columns).spacing(1).areas(areas[2]);
        draw_rates(frame, rates, figures, history);
        draw_times(frame, times, figures);
    } else {
        draw_rates(frame, areas[2], figures, history);
    }
    frame.render_widget(Paragraph::new(problems), areas[3]);
    frame.render_widget(legend(is_wide), areas[4]);
}

/// The rows of a line of the title. A command that is wider than the window goes on below, and a shell reads its rows as
/// one line.
fn rows_of(line: &str, width: usize) -> Vec<String> {
    let mut flags = line.split(" --");
    let mut rows = vec![flags.next().unwrap_or_default().to_owned()];
    for flag in flags {
        let last = rows.last_mut().expect("there is a first row");
        if last.chars().count() + flag.chars().count() + " -- \\".len() <= width {
            last.push_str(" --");
            last.push_str(flag);
        } else {
            last.push_str(" \\");
            rows.push(format!("--{flag}"));
        }
    }
    rows
}

/// Notes about the room, then the last problem of each process, then what is no fault.
fn problems(figures: &Figures) -> Vec<Line<'static>> {
    let of_nodes = figures.nodes.iter().filter(|node| !node.problem.is_empty());
    let of_nodes = of_nodes.map(|node| format!("{}: {}", node.node, node.problem));
    let problems = figures.notes.iter().cloned().chain(of_nodes).map(|text| Line::from(text).fg(BAD));
    problems.chain(figures.remarks.iter().map(|remark| Line::from(remark.clone()).dim())).collect()
}

/// The meaning of the colours, and the keys.
fn legend(is_wide: bool) -> Line<'static> {
    let entry = |name: &'static str, colour: Color| [Span::from("■ ").fg(colour), Span::from(name).dim()];
    let users = [entry("minimum met  ", GOOD), entry("below  ", BAD)];
    let lines = [entry("policy  ", POLICY), entry("no IRS  ", NO_IRS), entry("flat  ", FLAT), entry("oracle", ORACLE)];
    let lines = lines.into_iter().filter(|_| is_wide);
    let colours = users.into_iter().chain(lines).flatten();
    Line::from_iter(std::iter::once(Span::from("q quits  ").dim()).chain(colours))
}

/// The lines about emergency stops, at most so many.
fn stop_lines(stops: &[String], most: usize) -> Vec<Line<'static>> {
    let hidden = stops.len().saturating_sub(most);
    // The last row counts the lines for which there is no row.
    let shown = if hidden > 0 && most > 1 { most - 1 } else { most };
    let rest = (hidden > 0 && most > 1).then(|| format!("{} more", hidden + 1));
    stops.iter().take(shown).cloned().chain(rest).map(|text| Line::from(text).fg(BAD).bold()).collect()
}

fn heading(titles: &[String], figures: &Figures, stops: Vec<Line<'static>>) -> Paragraph<'static> {
    let state = figures.array.state.as_str();
    let is_normal = matches!(state, "following" | "holding");
    let unusable = match figures.array.unusable {
        0 => String::new(),
        some => format!(", {some} of {} mirrors unusable", figures.array.mirrors),
    };
    let controller = match (figures.controller_alive, figures.controller_unseen) {
        (true, false) => "",
        (true, true) => "  another process commands",
        (false, true) => "  controller not seen",
        (false, false) => "  no controller",
    };
    let line = |(index, text): (usize, &String)| {
        let (program, width) = (if index == 0 { PROGRAM } else { "" }, PROGRAM.len());
        Line::from(vec![Span::from(format!("{program:width$}")).bold(), Span::from(text.clone()).dim()])
    };
    let state = Line::from(vec![
        Span::from(format!("policy {}  tick {}  mirrors ", figures.policy, figures.tick)),
        Span::from(format!("{state}{unusable}")).fg(if is_normal { GOOD } else { BAD }),
        Span::from(controller).fg(BAD),
    ]);
    Paragraph::new(titles.iter().enumerate().map(line).chain([state]).chain(stops).collect::<Vec<_>>())
}

fn draw_users(frame: &mut Frame, area: Rect, figures: &Figures) {
    let largest = figures.users.iter().map(|user| user.rate_mbps).fold(1.0, f32::max);
    let shown = usize::from(area.height).saturating_sub(1);
    let hidden = figures.users.len().saturating_sub(shown);
    // The last row counts the users for which there is no row.
    let rows = figures.users.iter().take(if hidden > 0 { shown.saturating_sub(1) } else { shown });
    let rows = rows.map(|user| user_row(user, largest));
    let rest = (hidden > 0).then(|| Row::new([String::new(), format!("{} more", hidden + 1)]).dim());
    let widths = [4, 12, 15, 8, 7, 5].map(Constraint::Length).into_iter().chain([Constraint::Max(USER_BAR)]);
    let header = Row::new(["user", "position (m)", "direct path", "  Mbit/s", "minimum", "", ""]).dim();
    frame.render_widget(Table::new(rows.chain(rest), widths).header(header), area);
}

fn user_row(user: &UserFigures, largest: f32) -> Row<'static> {
    let [x, y, _] = user.position_m;
    let direct = match (user.blocked, user.forced) {
        (Some(true), true) => "blocked (order)",
        (Some(true), false) => "blocked",
        (Some(false), _) => "clear",
        (None, _) => "unknown",
    };
    let (met, colour) = match (user.is_rate_known, user.is_met()) {
        (false, _) => ("", Color::Reset),
        (true, true) => ("met", GOOD),
        (true, false) => ("below", BAD),
    };
    let rate = if user.is_rate_known { format!("{:>8.2}", user.rate_mbps) } else { format!("{:>8}", "unknown") };
    let bar = (user.rate_mbps / largest * f32::from(USER_BAR)).round() as usize;
    Row::new(vec![
        Line::from(user.user.to_string()),
        Line::from(format!("{x:>5.2},{y:>6.2}")),
        Line::from(direct),
        Line::from(rate),
        Line::from(format!("{:>7.1}", user.min_rate_mbps)),
        Line::from(met).fg(colour),
        Line::from("█".repeat(bar)).fg(colour),
    ])
}

fn draw_rates(frame: &mut Frame, area: Rect, figures: &Figures, history: &[(f64, SumFigures)]) {
    let Some(sum) = &figures.sum_mbps else {
        return frame.render_widget(Paragraph::new(without_rates(figures).fg(BAD)), area);
    };
    let rows = [Constraint::Length(SUM_ROWS), Constraint::Fill(1)];
    let [bars, chart] = Layout::vertical(rows).areas(area);
    let best = sum.oracle.unwrap_or(sum.policy).max(sum.policy).max(1e-9);
    let lines = named(sum).into_iter().map(|(name, rate, colour)| {
        let share = rate / best;
        Line::from(vec![
            Span::from(format!("{name:<7}{rate:>9.2}{:>7.1} %  ", share * 100.0)),
            Span::from("█".repeat((share.clamp(0.0, 1.0) * f64::from(SUM_BAR)).round() as usize)).fg(colour),
        ])
    });
    let (first, rest) = sum.name().split_at(1);
    let title = Line::from(format!("{}{rest}, Mbit/s", first.to_uppercase()).bold());
    frame.render_widget(Paragraph::new(std::iter::once(title).chain(lines).collect::<Vec<_>>()), bars);
    if chart.height >= 3 {
        draw_history(frame, chart, history);
    }
}

fn draw_history(frame: &mut Frame, area: Rect, history: &[(f64, SumFigures)]) {
    let (Some(first), Some(last)) = (history.first(), history.last()) else { return };
    let series = |rate: fn(&SumFigures) -> Option<f64>| -> Vec<(f64, f64)> {
        history.iter().filter_map(|(at, sum)| Some((*at, rate(sum)?))).collect()
    };
    let lines = [
        ("no IRS", NO_IRS, series(|sum| sum.no_irs)),
        ("flat", FLAT, series(|sum| sum.flat)),
        ("oracle", ORACLE, series(|sum| sum.oracle)),
        ("policy", POLICY, series(|sum| Some(sum.policy))),
    ];
    let top = lines.iter().flat_map(|(_, _, points)| points).map(|(_, rate)| *rate).fold(1.0, f64::max);
    let datasets = lines.iter().map(|(name, colour, points)| {
        let style = Style::new().fg(*colour);
        Dataset::default().name(*name).marker(Marker::Braille).graph_type(GraphType::Line).style(style).data(points)
    });
    let chart = Chart::new(datasets.collect())
        .legend_position(None)
        .x_axis(Axis::default().bounds([first.0, last.0.max(first.0 + 1.0)]))
        .y_axis(
            Axis::default().bounds([0.0, top]).labels(["0".to_owned(), format!("{top:.0}")]).style(Style::new().dim()),
        );
    frame.render_widget(chart, area);
}

fn draw_times(frame: &mut Frame, area: Rect, figures: &Figures) {
    let [times, counts] = Layout::vertical([Constraint::Length(TIME_ROWS), Constraint::Fill(1)]).areas(area);
    let rows = figures
        .times
        .iter()
        .map(|of| Row::new([of.name.to_owned(), time(of, |us| us.p50), time(of, |us| us.p99), time(of, |us| us.max)]));
    let header = Row::new([Line::from("Times".bold()), "p50".into(), "p99".into(), "max".into()]);
    let widths = [8, 9, 9, 9].map(Constraint::Length);
    frame.render_widget(Table::new(rows, widths).header(header), times);
    // Where the rows do not suffice, first the title is left out, then the counts take two columns.
    let space = usize::from(counts.height);
    let columns = if figures.counts.len() > space { 2 } else { 1 };
    let in_rows = figures.counts.chunks(columns).map(|some| {
        Row::new(some.iter().flat_map(|count| {
            let colour =
                if count.is_problem && count.value.is_some_and(|value| value > 0) { BAD } else { Color::Reset };
            let name: String = if columns == 1 { count.name.clone() } else { count.name.chars().take(11).collect() };
            [
                Line::from(name),
                Line::from(count.value.map_or_else(|| "-".to_owned(), |value| value.to_string()))
                    .right_aligned()
                    .fg(colour),
            ]
        }))
    });
    let widths: &[u16] = if columns == 1 { &[20, 10] } else { &[11, 6, 11, 7] };
    let table = Table::new(in_rows, widths.iter().copied().map(Constraint::Length));
    let has_title = figures.counts.len() < space;
    let block = if has_title { Block::new().title("Counts".bold()) } else { Block::new() };
    frame.render_widget(table.block(block), counts);
}
