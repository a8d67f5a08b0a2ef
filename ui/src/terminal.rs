//! The figures on a terminal: a full-screen view, or one line at a time if output is not a
//! terminal.

use std::io::{self, IsTerminal, Stdout};
use std::time::Duration;

use heliostat_service::output;
use ratatui::backend::TermionBackend;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::{Color, Style, Stylize};
use ratatui::symbols::Marker;
use ratatui::termion::event::Key;
use ratatui::termion::input::{Keys, TermRead};
use ratatui::termion::raw::{IntoRawMode, RawTerminal};
use ratatui::termion::screen::{AlternateScreen, IntoAlternateScreen};
use ratatui::termion::{AsyncReader, async_stdin};
use ratatui::text::{Line, Span};
use ratatui::widgets::{Axis, Block, Chart, Dataset, GraphType, Paragraph, Row, Table};
use ratatui::{Frame, Terminal};

use crate::figures::{Figures, SumFigures, TimeFigures};
use crate::{UiError, View};

/// Length of the longest bar in characters.
const BAR: usize = 28;
/// The Okabe-Ito palette, which is distinguishable with colour-vision deficiency.
const POLICY: Color = Color::Rgb(0x56, 0xB4, 0xE9);
const FLAT: Color = Color::Rgb(0x99, 0x99, 0x99);
const NO_IRS: Color = Color::Rgb(0xBB, 0xBB, 0xBB);
const GOOD: Color = Color::Rgb(0x00, 0x9E, 0x73);
const BAD: Color = Color::Rgb(0xD5, 0x5E, 0x00);

/// The output of the figures.
pub enum Display {
    /// A full-screen view on standard output.
    Screen(Box<Screen>),
    /// One line at a time on standard error; standard output is for summaries.
    Lines(Lines),
}

/// Output by lines.
#[derive(Debug, Default)]
pub struct Lines {
    /// The notes that were printed last.
    notes: Vec<String>,
}

/// A terminal in full-screen mode; dropping it restores the terminal.
pub struct Screen {
    terminal: Terminal<TermionBackend<AlternateScreen<RawTerminal<Stdout>>>>,
    keys: Keys<AsyncReader>,
    title: String,
}

impl Display {
    /// A full-screen view if input and output are a terminal and `plain` is false, else lines.
    ///
    /// # Errors
    /// [`UiError::Terminal`] if the terminal refuses full-screen mode.
    pub fn open(plain: bool, title: &str) -> Result<Self, UiError> {
        if plain || !io::stdout().is_terminal() || !io::stdin().is_terminal() {
            return Ok(Self::Lines(Lines::default()));
        }
        let screen = io::stdout().into_raw_mode()?.into_alternate_screen()?;
        let terminal = Terminal::new(TermionBackend::new(screen))?;
        Ok(Self::Screen(Box::new(Screen { terminal, keys: async_stdin().keys(), title: title.to_owned() })))
    }

    /// Time between two updates.
    pub fn interval(&self) -> Duration {
        Duration::from_millis(match self {
            Self::Screen(_) => 200,
            Self::Lines(_) => 1000,
        })
    }

    /// Draws the current state.
    ///
    /// # Errors
    /// [`UiError::Terminal`] if the terminal is closed.
    pub fn draw(&mut self, view: &View) -> Result<(), UiError> {
        let figures = view.figures();
        match self {
            Self::Lines(lines) => lines.print(&figures),
            Self::Screen(screen) => {
                let history = view.history();
                screen.terminal.draw(|frame| draw(frame, &screen.title, &figures, &history))?;
            }
        }
        Ok(())
    }

    /// Whether q, Escape or Ctrl-C was pressed since the last call.
    ///
    /// # Errors
    /// [`UiError::Terminal`] if the terminal is closed.
    pub fn quit_requested(&mut self) -> Result<bool, UiError> {
        let Self::Screen(screen) = self else { return Ok(false) };
        // In raw mode the terminal sends no signals; Ctrl-C arrives as a key.
        while let Some(key) = screen.keys.next().transpose()? {
            if matches!(key, Key::Char('q') | Key::Esc | Key::Ctrl('c')) {
                return Ok(true);
            }
        }
        Ok(false)
    }
}

impl Lines {
    /// Prints the figures; before them the notes, if they have changed.
    fn print(&mut self, figures: &Figures) {
        if self.notes != figures.notes {
            figures.notes.iter().for_each(output::note);
            self.notes.clone_from(&figures.notes);
        }
        output::note(line(figures));
    }
}

impl Drop for Screen {
    fn drop(&mut self) {
        // The drop of the inner types restores mode and screen; an error of a closed terminal has
        // no remedy.
        let _ = self.terminal.show_cursor();
    }
}

/// The figures in one line.
fn line(figures: &Figures) -> String {
    let Some(sum) = &figures.sum_mbps else { return "no messages from the room".into() };
    let blocked = figures.users.iter().filter(|user| user.blocked).count();
    let others = named(sum)[1..].iter().map(|(name, rate, _)| format!("{name} {rate:.1}")).collect::<Vec<_>>();
    let others = if others.is_empty() { String::new() } else { format!(" ({})", others.join(", ")) };
    let [decision, round, ..] = &figures.times[..] else { return String::new() };
    format!(
        "tick {:>6}  {}  blocked {blocked}/{}  sum rate {:6.1} Mbit/s{others}  decision p99 {}  loop p99 {}",
        figures.tick,
        figures.array.state,
        figures.users.len(),
        sum.policy,
        time(decision, |us| us.p99),
        time(round, |us| us.p99),
    )
}

fn draw(frame: &mut Frame, title: &str, figures: &Figures, history: &[(f64, SumFigures)]) {
    let users = u16::try_from(figures.users.len()).unwrap_or(u16::MAX).saturating_add(3);
    let [head, users_area, middle, foot] = Layout::vertical([
        Constraint::Length(2),
        Constraint::Length(users.min(frame.area().height / 3)),
        Constraint::Min(9),
        Constraint::Length(2),
    ])
    .areas(frame.area());
    let [rates, times] = Layout::horizontal([Constraint::Fill(1), Constraint::Length(46)]).areas(middle);
    frame.render_widget(heading(title, figures), head);
    draw_users(frame, users_area, figures);
    draw_rates(frame, rates, figures, history);
    draw_times(frame, times, figures);
    let problems = figures.nodes.iter().filter(|node| !node.problem.is_empty());
    let mut lines: Vec<Line> =
        problems.map(|node| Line::from(format!("{}: {}", node.node, node.problem)).fg(BAD)).take(1).collect();
    lines.push(Line::from("q quits").dim());
    frame.render_widget(Paragraph::new(lines), foot);
}

fn heading(title: &str, figures: &Figures) -> Paragraph<'static> {
    let state = figures.array.state;
    let is_normal = matches!(state, "following" | "holding");
    let unusable = match figures.array.unusable {
        0 => String::new(),
        some => format!(", {some} of {} mirrors unusable", figures.array.mirrors),
    };
    let controller = if figures.controller_alive { "" } else { "  no controller" };
    Paragraph::new(vec![
        Line::from(vec![Span::from("Heliostat  ").bold(), Span::from(title.to_owned()).dim()]),
        Line::from(vec![
            Span::from(format!("policy {}  tick {}  mirrors ", figures.policy, figures.tick)),
            Span::from(format!("{state}{unusable}")).fg(if is_normal { GOOD } else { BAD }),
            Span::from(controller).fg(BAD),
        ]),
    ])
}

fn draw_users(frame: &mut Frame, area: Rect, figures: &Figures) {
    let largest = figures.users.iter().map(|user| user.rate_mbps).fold(1.0, f32::max);
    let rows = figures.users.iter().map(|user| {
        let [x, y, _] = user.position_m;
        let direct = match (user.blocked, user.forced) {
            (true, true) => "blocked (order)",
            (true, false) => "blocked",
            (false, _) => "clear",
        };
        let (met, colour) = if user.is_met() { ("met", GOOD) } else { ("below", BAD) };
        Row::new(vec![
            Line::from(user.user.to_string()),
            Line::from(format!("{x:>5.2}, {y:>5.2}")),
            Line::from(direct),
            Line::from(format!("{:>7.2}", user.rate_mbps)),
            Line::from(format!("{:>5.1}", user.min_rate_mbps)),
            Line::from(met).fg(colour),
            Line::from("█".repeat((user.rate_mbps / largest * BAR as f32).round() as usize)).fg(colour),
        ])
    });
    let widths = [4, 13, 15, 8, 7, 5, BAR as u16].map(Constraint::Length);
    let header = Row::new(["user", "position (m)", "direct path", "Mbit/s", "minimum", "", ""]).dim();
    frame.render_widget(Table::new(rows, widths).header(header).block(Block::new().title("Rates".bold())), area);
}

fn draw_rates(frame: &mut Frame, area: Rect, figures: &Figures, history: &[(f64, SumFigures)]) {
    let Some(sum) = &figures.sum_mbps else {
        return frame.render_widget(Paragraph::new("no messages from the room".fg(BAD)), area);
    };
    let [bars, chart] = Layout::vertical([Constraint::Length(5), Constraint::Min(4)]).areas(area);
    let best = sum.oracle.unwrap_or(sum.policy).max(sum.policy).max(1e-9);
    let lines = named(sum).into_iter().map(|(name, rate, colour)| {
        let share = rate / best;
        Line::from(vec![
            Span::from(format!("{name:<7} {rate:>8.2} Mbit/s {:>6.1} %  ", share * 100.0)),
            Span::from("█".repeat((share.clamp(0.0, 1.0) * BAR as f64).round() as usize)).fg(colour),
        ])
    });
    let title = Line::from("Sum rate".bold());
    frame.render_widget(Paragraph::new(std::iter::once(title).chain(lines).collect::<Vec<_>>()), bars);
    draw_history(frame, chart, history);
}

fn draw_history(frame: &mut Frame, area: Rect, history: &[(f64, SumFigures)]) {
    let (Some(first), Some(last)) = (history.first(), history.last()) else { return };
    let series = |rate: fn(&SumFigures) -> Option<f64>| -> Vec<(f64, f64)> {
        history.iter().filter_map(|(at, sum)| Some((*at, rate(sum)?))).collect()
    };
    let lines = [
        ("no IRS", NO_IRS, series(|sum| sum.no_irs)),
        ("flat", FLAT, series(|sum| sum.flat)),
        ("oracle", Color::Reset, series(|sum| sum.oracle)),
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
    let [times, counts] =
        Layout::vertical([Constraint::Length(figures.times.len() as u16 + 3), Constraint::Fill(1)]).areas(area);
    let rows = figures
        .times
        .iter()
        .map(|of| Row::new([of.name.to_owned(), time(of, |us| us.p50), time(of, |us| us.p99), time(of, |us| us.max)]));
    let header = Row::new(["", "p50", "p99", "max"]).dim();
    let widths = [Constraint::Length(9), Constraint::Length(11), Constraint::Length(11), Constraint::Length(11)];
    frame.render_widget(Table::new(rows, widths).header(header).block(Block::new().title("Times".bold())), times);
    let counts_shown = figures.counts.iter().map(|count| {
        let colour = if count.is_problem && count.value > 0 { BAD } else { Color::Reset };
        Row::new([Line::from(count.name.clone()), Line::from(format!("{:>10}", count.value)).fg(colour)])
    });
    let table = Table::new(counts_shown, [Constraint::Length(20), Constraint::Length(10)]);
    frame.render_widget(table.block(Block::new().title("Counts".bold())), counts);
}

/// The known sum rates by name, the policy first.
fn named(sum: &SumFigures) -> Vec<(&'static str, f64, Color)> {
    let all = [
        ("policy", Some(sum.policy), POLICY),
        ("no IRS", sum.no_irs, NO_IRS),
        ("flat", sum.flat, FLAT),
        ("oracle", sum.oracle, Color::Reset),
    ];
    all.into_iter().filter_map(|(name, rate, colour)| Some((name, rate?, colour))).collect()
}

fn time(of: &TimeFigures, which: fn(&heliostat_proto::Quantiles) -> f64) -> String {
    of.us.as_ref().map_or("-".into(), |us| format!("{:.0} us", which(us)))
}

#[cfg(test)]
mod tests {
    use heliostat_proto::Quantiles;
    use ratatui::backend::TestBackend;

    use super::*;
    use crate::figures::{ArrayFigures, Count, NodeFigures, Origin, UserFigures};

    fn figures() -> Figures {
        let user = |user, rate_mbps, blocked| UserFigures {
            user,
            rate_mbps,
            blocked,
            min_rate_mbps: 1.0,
            ..UserFigures::default()
        };
        let us = |p99| Some(Quantiles { count: 9, p50: p99 / 2.0, p99, max: p99 * 2.0, ..Quantiles::default() });
        Figures {
            origin: Origin::Simulated,
            tick: 4711,
            policy: "greedy".into(),
            controller_alive: true,
            users: vec![user(0, 12.5, true), user(1, 0.25, false)],
            sum_mbps: Some(SumFigures { policy: 40.0, no_irs: Some(10.0), flat: Some(20.0), oracle: Some(50.0) }),
            array: ArrayFigures { state: "stopped", mirrors: 100, unusable: 25, faults: vec!["mirror"] },
            nodes: vec![NodeFigures {
                node: "controller",
                problem: "a policy failed".into(),
                ..NodeFigures::default()
            }],
            times: vec![
                TimeFigures { name: "decision", us: us(300.0) },
                TimeFigures { name: "loop", us: us(900.0) },
                TimeFigures { name: "age", us: None },
            ],
            counts: vec![Count { name: "fallbacks".into(), value: 3, is_problem: true }],
            ..Figures::default()
        }
    }

    fn drawn(width: u16, height: u16) -> String {
        let mut terminal = Terminal::new(TestBackend::new(width, height)).expect("a backend in memory");
        let history = [(0.0, figures().sum_mbps.expect("set")), (9.0, figures().sum_mbps.expect("set"))];
        terminal
            .draw(|frame| draw(frame, "room demo", &figures(), &history))
            .expect("drawing into memory does not fail");
        terminal.backend().to_string()
    }

    #[test]
    fn the_screen_shows_every_figure() {
        let screen = drawn(100, 30);
        for text in [
            "room demo",
            "policy greedy",
            "tick 4711",
            "stopped, 25 of 100 mirrors unusable",
            "blocked",
            "12.50",
            "below",
            "80.0 %",
            "300 us",
            "fallbacks",
            "a policy failed",
            "q quits",
        ] {
            assert!(screen.contains(text), "no {text:?} in\n{screen}");
        }
    }

    #[test]
    fn a_small_window_causes_no_panic() {
        for (width, height) in [(1, 1), (20, 5), (40, 12)] {
            drawn(width, height);
        }
    }

    #[test]
    fn a_line_holds_the_figures_or_reports_their_absence() {
        let text = line(&figures());
        assert!(
            text.contains("tick   4711") && text.contains("40.0 Mbit/s (no IRS 10.0, flat 20.0, oracle 50.0)"),
            "{text}"
        );
        assert!(text.contains("blocked 1/2") && text.contains("decision p99 300 us"), "{text}");
        assert_eq!(line(&Figures::default()), "no messages from the room");
    }
}
