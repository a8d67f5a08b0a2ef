//! The full screen of a console that is no Unix terminal.

use std::io;
use std::time::Duration;

use ratatui::crossterm::event::{self, Event, KeyCode, KeyModifiers};
use ratatui::{DefaultTerminal, Frame};

pub struct FullScreen(DefaultTerminal);

impl FullScreen {
    pub fn open() -> io::Result<Self> {
        ratatui::try_init().map(Self)
    }

    pub fn draw(&mut self, drawing: impl FnOnce(&mut Frame)) -> io::Result<()> {
        self.0.draw(drawing).map(drop)
    }

    pub fn quit_requested(&mut self) -> io::Result<bool> {
        while event::poll(Duration::ZERO)? {
            let Event::Key(key) = event::read()? else { continue };
            let is_quit = match key.code {
                KeyCode::Char('q') | KeyCode::Esc => true,
                KeyCode::Char('c') => key.modifiers.contains(KeyModifiers::CONTROL),
                _ => false,
            };
            // A console also reports that a key was released.
            if is_quit && key.is_press() {
                return Ok(true);
            }
        }
        Ok(false)
    }
}

impl Drop for FullScreen {
    fn drop(&mut self) {
        // An error of a closed console has no remedy.
        let _ = self.0.show_cursor();
        ratatui::restore();
    }
}
