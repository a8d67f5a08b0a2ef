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

use crate::causes::{FAULTS, NoteLines};
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
        let mut notes = [figures.notes.as_slice(), figures.remarks.as_slice()].concat();
        // No fault is over because its array is silent.
        if !figures.array.silent.is_empty() && !notes.iter().any(|note| note.starts_with(FAULTS)) {
            notes.extend(self.notes.beginning(FAULTS));
        }
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
mod tests;
