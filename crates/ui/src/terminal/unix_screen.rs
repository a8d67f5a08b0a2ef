//! The full screen of a Unix terminal.

use std::io::{self, Stdout, Write};

use ratatui::backend::TermionBackend;
use ratatui::termion::event::Key;
use ratatui::termion::input::{Keys, TermRead};
use ratatui::termion::raw::{IntoRawMode, RawTerminal};
use ratatui::termion::screen::{AlternateScreen, IntoAlternateScreen};
use ratatui::termion::{AsyncReader, async_stdin};
use ratatui::{Frame, Terminal};

/// A terminal in full-screen mode; dropping it restores the terminal.
pub struct FullScreen {
    terminal: Terminal<TermionBackend<AlternateScreen<RawTerminal<Stdout>>>>,
    keys: Keys<AsyncReader>,
    _flush: FlushOutput,
}

/// Writes out what the fields before it wrote when they were dropped: the terminal is restored at
/// once, although a session that is still open may delay the end of the process.
struct FlushOutput;

impl Drop for FlushOutput {
    fn drop(&mut self) {
        // An error of a closed terminal has no remedy.
        let _ = io::stdout().flush();
    }
}

impl FullScreen {
    /// The terminal of standard input and output.
    ///
    /// # Errors
    /// It refuses full-screen mode.
    pub fn open() -> io::Result<Self> {
        let screen = io::stdout().into_raw_mode()?.into_alternate_screen()?;
        let terminal = Terminal::new(TermionBackend::new(screen))?;
        Ok(Self { terminal, keys: async_stdin().keys(), _flush: FlushOutput })
    }

    /// Draws all of it.
    ///
    /// # Errors
    /// The terminal is closed.
    pub fn draw(&mut self, drawing: impl FnOnce(&mut Frame)) -> io::Result<()> {
        self.terminal.draw(drawing).map(drop)
    }

    /// Whether q, Escape or Ctrl-C was pressed since the last call.
    ///
    /// # Errors
    /// The terminal is closed.
    pub fn quit_requested(&mut self) -> io::Result<bool> {
        // In raw mode the terminal sends no signals; Ctrl-C arrives as a key.
        while let Some(key) = self.keys.next().transpose()? {
            if matches!(key, Key::Char('q') | Key::Esc | Key::Ctrl('c')) {
                return Ok(true);
            }
        }
        Ok(false)
    }
}

impl Drop for FullScreen {
    fn drop(&mut self) {
        // The drop of the inner types restores mode and screen; an error of a closed terminal has
        // no remedy.
        let _ = self.terminal.show_cursor();
    }
}
