//! The figures on a terminal: a full-screen view, or one line at a time if output is not a
//! terminal.

mod drawing;
#[cfg_attr(unix, path = "terminal/unix_screen.rs")]
#[cfg_attr(not(unix), path = "terminal/other_screen.rs")]
mod full_screen;
pub(crate) mod texts;

use std::io::{self, IsTerminal};
use std::time::{Duration, Instant};

use heliostat_service::clock::utc_ns;
use heliostat_service::log_limit::EventLimit;
use heliostat_service::output;
use heliostat_service::terminal::takes_escapes;

use crate::causes::NoteLines;
use crate::figures::Figures;
use crate::{UiError, View};
use drawing::draw;
use full_screen::FullScreen;
use texts::stops;

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
    /// The stops at the last call.
    stops: Vec<String>,
    stop_lines: EventLimit,
    /// The notes and remarks.
    notes: NoteLines,
    /// The line of figures that was printed last.
    line: String,
    /// The lines go to the log.
    is_log: bool,
    /// Figures are left out.
    is_quiet: bool,
}

/// A line of text, and whether it reports that something is wrong.
struct Line {
    text: String,
    is_problem: bool,
}

/// The terminal in full-screen mode; dropping it restores the terminal.
pub struct Screen {
    screen: FullScreen,
    title: String,
    /// Commands that the user may give elsewhere, one in a line.
    advice: String,
}

impl Display {
    /// A full-screen view if input and output are a terminal, one that is not dumb, and `plain` is false, else lines. The
    /// title has one or two lines.
    ///
    /// # Errors
    /// [`UiError::Terminal`] if the terminal refuses full-screen mode.
    pub fn open(plain: bool, title: &str) -> Result<Self, UiError> {
        if plain || !takes_escapes(&io::stdout()) || !io::stdin().is_terminal() {
            return Ok(Self::Lines(Lines::default()));
        }
        Ok(Self::Screen(Box::new(Screen {
            screen: FullScreen::open()?,
            title: title.to_owned(),
            advice: String::new(),
        })))
    }

    /// Lines of the log: the stops and notes that begin or end, and the figures unless it is quiet.
    pub fn log(is_quiet: bool) -> Self {
        Self::Lines(Lines { is_log: true, is_quiet, ..Lines::default() })
    }

    /// Time between two updates.
    pub fn interval(&self) -> Duration {
        Duration::from_millis(match self {
            Self::Screen(_) => 200,
            Self::Lines(_) => 1000,
        })
    }

    /// Shows a command that the user may give elsewhere, with its purpose; in the full-screen view the command alone, as the
    /// first line of the title while the room has a problem.
    pub fn advise(&mut self, purpose: &str, command: &str) {
        match self {
            Self::Lines(_) => output::note(format_args!("{purpose}: {command}")),
            Self::Screen(screen) => {
                screen.advice = format!("{command}\n{}", screen.advice);
            }
        }
    }

    /// Draws the current state.
    ///
    /// # Errors
    /// [`UiError::Terminal`] if the terminal is closed.
    pub fn draw(&mut self, view: &View) -> Result<(), UiError> {
        let (mut figures, stops) = (view.figures(), stops(&view.stops.room()));
        match self {
            Self::Lines(lines) => {
                lines.leave_out(&mut figures.notes, || view.notes_of_connection());
                lines.take(&figures, &stops).iter().for_each(|line| lines.print(line));
            }
            Self::Screen(screen) => {
                let history: Vec<_> = view.history().into_iter().map(|(at, past)| (at, past.sum)).collect();
                let title = title_after(&screen.advice, &screen.title, &figures);
                screen.screen.draw(|frame| draw(frame, &title, (&figures, &stops), &history))?;
            }
        }
        Ok(())
    }

    /// Whether q, Escape or Ctrl-C was pressed since the last call.
    ///
    /// # Errors
    /// [`UiError::Terminal`] if the terminal is closed.
    pub fn quit_requested(&mut self) -> Result<bool, UiError> {
        match self {
            Self::Screen(screen) => Ok(screen.screen.quit_requested()?),
            Self::Lines(_) => Ok(false),
        }
    }
}

/// A title, after the lines of an advice while the room has a problem.
fn title_after(advice: &str, title: &str, figures: &Figures) -> String {
    format!("{}{title}", if figures.notes.is_empty() { "" } else { advice })
}

impl Lines {
    /// Leaves out the notes about the connection, which the session itself writes to the log.
    fn leave_out(&self, notes: &mut Vec<String>, of_connection: impl FnOnce() -> Vec<String>) {
        if self.is_log {
            let logged = of_connection();
            notes.retain(|note| !logged.contains(note));
        }
    }

    /// The stops, if they have changed, the notes that begin or end, and the figures, unless their line is the one
    /// before.
    fn take(&mut self, figures: &Figures, stops: &[String]) -> Vec<Line> {
        let line = |text: String, is_problem| Line { text, is_problem };
        let mut lines = Vec::new();
        if self.stops != stops {
            let (now, limit) = (Instant::now(), &mut self.stop_lines);
            let due = stops.iter().filter_map(|stop| limit.line(now, stop, "the stops change further"));
            lines.extend(due.map(|stop| line(stop, true)));
            if stops.is_empty() {
                lines.push(line("no stop is in force".into(), false));
            }
            self.stops = stops.to_vec();
        }
        let notes = [figures.notes.as_slice(), figures.remarks.as_slice()].concat();
        let (begun, ended) = self.notes.next(utc_ns() / 1_000_000, &notes);
        lines.extend(begun.into_iter().map(|note| {
            let is_problem = figures.notes.contains(&note);
            line(note, is_problem)
        }));
        lines.extend(ended.into_iter().map(|text| line(text, false)));
        let of_figures = texts::line(figures);
        if self.line != of_figures && !self.is_quiet {
            lines.push(line(of_figures.clone(), false));
            self.line = of_figures;
        }
        lines
    }

    fn print(&self, Line { text, is_problem }: &Line) {
        match (self.is_log, *is_problem) {
            (false, _) => output::note(text),
            (true, true) => tracing::warn!("{text}"),
            (true, false) => tracing::info!("{text}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use heliostat_proto::{Quantiles, StopName};
    use ratatui::Terminal;
    use ratatui::backend::TestBackend;

    use super::*;
    use crate::figures::{ArrayFigures, Count, NodeFigures, Origin, SumFigures, TimeFigures, UserFigures};
    use heliostat_proto::reported_stops::{RoomStop, Standing};

    use crate::stop_watch::RoomStops;
    use texts::line;

    impl Lines {
        /// The texts of the next lines.
        fn next(&mut self, figures: &Figures, stops: &[String]) -> Vec<String> {
            self.take(figures, stops).into_iter().map(|line| line.text).collect()
        }
    }

    #[test]
    fn a_log_has_one_line_about_a_lost_connection() {
        for (is_log, expected) in [(true, &["no driver"][..]), (false, &["no router", "no driver"])] {
            let lines = Lines { is_log, ..Lines::default() };
            let mut notes = vec!["no router".to_owned(), "no driver".to_owned()];
            lines.leave_out(&mut notes, || vec!["no router".to_owned()]);
            assert_eq!(notes, expected);
        }
    }

    fn figures(users: u32) -> Figures {
        let user = |user: u32| UserFigures {
            user,
            rate_mbps: if user == 1 { 0.25 } else { 12.5 + user as f32 },
            is_rate_known: true,
            blocked: Some(user == 0),
            min_rate_mbps: 1.0,
            ..UserFigures::default()
        };
        let us = |p99| Some(Quantiles { count: 9, p50: p99 / 2.0, p99, max: p99 * 20.0, ..Quantiles::default() });
        let counts =
            ["decisions", "commands", "over 0.5 ms", "ticks lost", "ticks late", "fallbacks", "reports refused"];
        let counts = counts.into_iter().chain(["array refused", "unreadable"]).zip(700_001..);
        Figures {
            origin: Origin::Simulated,
            tick: 4711,
            policy: "greedy".into(),
            controller_alive: true,
            users: (0..users).map(user).collect(),
            sum_mbps: Some(SumFigures {
                policy: 40.0,
                no_irs: Some(10.0),
                flat: Some(20.0),
                oracle: Some(50.0),
                is_modelled: false,
            }),
            array: ArrayFigures {
                silent: Vec::new(),
                state: "stopped".into(),
                arrays: 1,
                mirrors: 100,
                unusable: 25,
                faults: vec!["mirror"],
            },
            nodes: vec![NodeFigures {
                node: "controller".into(),
                problem: "a policy failed".into(),
                ..NodeFigures::default()
            }],
            times: vec![
                TimeFigures { name: "decision", of: "controller", us: us(300.0) },
                TimeFigures { name: "loop", of: "room", us: us(900.0) },
                TimeFigures { name: "age", of: "controller", us: None },
            ],
            counts: counts
                .map(|(name, value)| Count {
                    name: name.into(),
                    of: "room",
                    value: Some(value),
                    is_problem: true,
                    ..Count::default()
                })
                .collect(),
            notes: vec!["no driver receives the commands".into()],
            ..Figures::default()
        }
    }

    fn drawn(width: u16, height: u16, figures: &Figures) -> String {
        drawn_with(width, height, figures, &[])
    }

    fn drawn_with(width: u16, height: u16, figures: &Figures, stops: &[String]) -> String {
        drawn_under("room demo", (width, height), figures, stops)
    }

    fn drawn_under(title: &str, (width, height): (u16, u16), figures: &Figures, stops: &[String]) -> String {
        let mut terminal = Terminal::new(TestBackend::new(width, height)).expect("a backend in memory");
        let sum = figures.sum_mbps.unwrap_or_default();
        terminal
            .draw(|frame| draw(frame, title, (figures, stops), &[(0.0, sum), (9.0, sum)]))
            .expect("drawing into memory does not fail");
        terminal.backend().to_string()
    }

    fn check(screen: &str, texts: &[&str]) {
        for text in texts {
            assert!(screen.contains(text), "no {text:?} in\n{screen}");
        }
    }

    const USERS: [&str; 7] = ["direct path", "minimum", "blocked", "12.50", "below", "15.50", "16.50"];

    #[test]
    fn the_screen_is_complete_at_80_by_24() {
        let screen = drawn(80, 24, &figures(5));
        check(&screen, &USERS);
        check(&screen, &["room demo", "policy greedy", "tick 4711", "stopped, 25 of 100 mirrors unusable"]);
        check(
            &screen,
            &["policy     40.00   80.0 %", "oracle     50.00  100.0 %", "150 us", "300 us", "18000 us", "age"],
        );
        check(&screen, &["decisions                700001", "fallbacks", "reports refused", "array refused", "700009"]);
        check(&screen, &["a policy failed", "no driver receives the commands"]);
        check(&screen, &["q quits", "■ minimum met", "■ below", "■ policy", "■ no IRS", "■ flat", "■ oracle"]);
        assert!(screen.contains('⠉') || screen.contains('⠒'), "no chart in\n{screen}");
    }

    #[test]
    fn all_users_and_sum_rates_are_visible_at_60_by_15() {
        let screen = drawn(60, 15, &figures(5));
        check(&screen, &USERS);
        check(&screen, &["policy     40.00", "oracle     50.00", "no driver receives", "q quits", "■ minimum met"]);
    }

    #[test]
    fn the_second_line_of_a_title_is_drawn_where_the_window_is_high_enough() {
        let command = "heliostat status --room demo --connect tcp/127.0.0.1:17447";
        let title = format!("room demo\n{command}");
        let screen = drawn_under(&title, (80, 24), &figures(5), &[]);
        check(&screen, &["room demo", command, "policy greedy", "oracle     50.00", "fallbacks", "q quits"]);
        check(&screen, &USERS);
        let low = drawn_under(&title, (60, 15), &figures(5), &[]);
        assert!(!low.contains(command), "{low}");
        check(&low, &USERS);
    }

    #[test]
    fn a_command_that_is_wider_than_the_window_is_complete_in_rows_that_a_shell_joins() {
        let command = "heliostat controller --scenario hall --room demo --connect tcp/127.0.0.1:17447 --listen \
                       tcp/127.0.0.1:17448 --policy fixed-point";
        for size in [(80, 24), (60, 15)] {
            let screen = drawn_under(&format!("{command}\nroom demo"), size, &figures(5), &[]);
            let mut joined = String::new();
            for row in screen.lines() {
                let row = row.trim_matches('"').trim_start_matches("Heliostat  ").trim();
                joined += row.trim_end_matches('\\');
                if !row.ends_with('\\') {
                    break;
                }
            }
            assert_eq!(joined, command, "{screen}");
            check(&screen, &["policy greedy", "q quits"]);
        }
        assert_eq!(title_after("a command\n", "room demo", &figures(1)), "a command\nroom demo");
        let healthy = Figures { notes: Vec::new(), ..figures(1) };
        assert_eq!(title_after("a command\n", "room demo", &healthy), "room demo", "the process runs again");
    }

    #[test]
    fn users_beyond_the_screen_are_counted() {
        check(&drawn(60, 15, &figures(20)), &["\"0    ", "\"3    ", "16 more", "oracle     50.00"]);
        check(&drawn(80, 24, &figures(20)), &["\"7    ", "12 more", "oracle     50.00", "fallbacks    700006"]);
    }

    #[test]
    fn a_small_window_causes_no_panic() {
        for (width, height) in [(1, 1), (20, 5), (40, 12)] {
            drawn(width, height, &figures(5));
        }
    }

    #[test]
    fn a_line_holds_the_figures_or_reports_their_absence() {
        let text = line(&figures(2));
        assert!(
            text.contains("tick   4711") && text.contains("40.0 Mbit/s (no IRS 10.0, flat 20.0, oracle 50.0)"),
            "{text}"
        );
        assert!(text.contains("blocked 1/2") && text.contains("decision p99 300 us"), "{text}");
        assert_eq!(line(&Figures::default()), "no messages from the room");
    }

    #[test]
    fn a_line_is_not_repeated_while_nothing_changes() {
        let mut lines = Lines::default();
        assert_eq!(lines.next(&Figures::default(), &[]), ["no messages from the room"]);
        assert!(lines.next(&Figures::default(), &[]).is_empty());
        let running = figures(2);
        assert_eq!(lines.next(&running, &[]).len(), 2, "a note and a line");
        assert!(lines.next(&running, &[]).is_empty());
        let stops = stops(&room());
        assert_eq!(lines.next(&running, &stops), stops);
        assert!(lines.next(&running, &stops).is_empty());
        assert_eq!(lines.next(&running, &[]), ["no stop is in force"]);
        let over = "over: no driver receives the commands";
        assert_eq!(lines.next(&Figures::default(), &[]), [over, "no messages from the room"]);
    }

    #[test]
    fn a_flood_of_stops_writes_a_bounded_number_of_lines_and_its_end_is_one() {
        let Display::Lines(mut lines) = Display::log(true) else { panic!("lines") };
        let mut printed = 0;
        for number in 0..10_000 {
            printed += lines.next(&figures(3), &[format!("stop {number}")]).len();
        }
        assert!(printed < 200, "{printed}");
        assert_eq!(lines.next(&figures(3), &[]), ["no stop is in force"]);
    }

    #[test]
    fn the_lines_for_a_log_have_stops_and_notes_and_no_figures() {
        let Display::Lines(mut lines) = Display::log(true) else { panic!("lines") };
        assert!(lines.is_log && lines.next(&Figures::default(), &[]).is_empty());
        assert_eq!(lines.next(&figures(2), &[]), ["no driver receives the commands"]);
        assert_eq!(lines.next(&figures(3), &stops(&room())), stops(&room()));
    }

    #[test]
    fn of_the_lines_for_a_log_the_stops_and_the_notes_of_faults_are_problems() {
        let Display::Lines(mut lines) = Display::log(false) else { panic!("lines") };
        let mut problems = |figures: &Figures, stops: &[String]| {
            lines.take(figures, stops).iter().map(|line| line.is_problem).collect::<Vec<_>>()
        };
        let remarks = vec!["another scenario outside the geometry".to_owned()];
        let begun = Figures { remarks, ..figures(2) };
        assert_eq!(problems(&begun, &["a stop".to_owned()]), [true, true, false, false], "stop, note, remark, figures");
        assert_eq!(problems(&Figures { notes: Vec::new(), ..figures(2) }, &[]), [false; 3], "each is over");
    }

    #[test]
    fn a_note_is_printed_when_it_begins_and_ends_and_not_for_each_of_its_figures() {
        let mut lines = Lines::default();
        let mut next = |notes: &[&str]| {
            let notes = notes.iter().map(|note| (*note).to_owned()).collect();
            lines.next(&Figures { notes, ..figures(2) }, &[])
        };
        assert_eq!(next(&["LED 0 brings 0.61"])[0], "LED 0 brings 0.61");
        assert!(next(&["LED 0 brings 0.60"]).is_empty());
        assert_eq!(next(&["LED 1 brings 0.60"]), ["LED 1 brings 0.60", "over: LED 0 brings 0.60"]);
        assert_eq!(next(&[]), ["over: LED 1 brings 0.60"]);
    }

    /// A room with two stops, of which the second array has executed none.
    fn room() -> RoomStops {
        let stop = |source, operator: &str, arrays: &[usize]| RoomStop {
            name: StopName { source, sequence: 4 },
            operator: operator.into(),
            reason: "person on the ladder".into(),
            arrays: arrays.to_vec(),
            known: Duration::ZERO,
            stands_for_unlisted: false,
        };
        RoomStops {
            stops: vec![stop(3, "ann", &[0, 1]), stop(5, "b\u{1b}ob", &[0])],
            standings: vec![(0, Standing::Stopped), (1, Standing::Silent), (2, Standing::Free)],
            has_geometry: true,
            ..RoomStops::default()
        }
    }

    #[test]
    fn the_stops_are_listed_with_the_arrays_that_have_executed_them() {
        let stops = stops(&room());
        let expected = [
            "array 0 of 0, 1 has stopped: stop 0000000000000003/4 of ann (person on the ladder)",
            "array 0 has stopped: stop 0000000000000005/4 of b\\u001bob (person on the ladder)",
            "array 1 does not answer: cut its power",
            "array 2 is not stopped: no stop holds it",
        ];
        assert_eq!(stops, expected);
        let screen = drawn_with(100, 24, &figures(5), &stops);
        check(&screen, &expected);
        check(&screen, &USERS);
        check(
            &drawn_with(60, 15, &figures(5), &stops),
            &["has stopped: stop 0000000000000003/4 of ann", "oracle     50.00"],
        );
        let many: Vec<String> = (0..9).map(|number| format!("stop {number}")).collect();
        check(&drawn_with(80, 24, &figures(5), &many), &["stop 0", "5 more", "oracle     50.00"]);
    }

    #[test]
    fn several_arrays_that_have_stopped_are_named_in_the_plural() {
        let standings = (0..3).map(|array| (array, Standing::Stopped)).collect();
        let lines = stops(&RoomStops { standings, ..room() });
        let of_both = "arrays 0, 1 have stopped: stop 0000000000000003/4 of ann (person on the ladder)";
        assert_eq!(lines[0], of_both);
    }

    #[test]
    fn a_modelled_sum_rate_is_marked() {
        let sum = SumFigures { policy: 121.0, no_irs: Some(105.0), is_modelled: true, ..SumFigures::default() };
        let modelled = Figures { origin: Origin::Measured, sum_mbps: Some(sum), ..figures(2) };
        assert!(line(&modelled).contains("  modelled sum rate  121.0 Mbit/s (no IRS 105.0)"), "{}", line(&modelled));
        check(&drawn(80, 24, &modelled), &["Modelled sum rate, Mbit/s", "121.00", "105.00"]);
    }

    #[test]
    fn an_unknown_rate_is_shown_as_unknown_and_not_as_zero() {
        let users = vec![UserFigures { user: 7, ..UserFigures::default() }];
        let measured = Figures { origin: Origin::Measured, sum_mbps: None, users, ..figures(0) };
        assert_eq!(line(&measured), "tick   4711  stopped  sum rate unknown: no measured gains");
        let screen = drawn(80, 24, &measured);
        check(&screen, &["sum rate unknown", "7     0.00,  0.00 unknown          unknown"]);
        assert!(!screen.contains("below\n") && !screen.contains("0.00 %"), "{screen}");
    }
}
