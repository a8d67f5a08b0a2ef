//! The live page: its server as a process, and its theme in a browser.

use heliostat_bus::free_loopback_port;

use crate::{browser::Browser, process::Process, wait::wait_until};

/// A server of the live page; it is killed when dropped.
pub struct PageServer {
    process: Process,
    port: u16,
}

impl PageServer {
    /// Starts `heliostat ui` on a free port, and waits until the page is served. `arguments` follow
    /// those of the port.
    ///
    /// # Panics
    /// When the page is not served within the time limit.
    pub fn start(arguments: &[&str]) -> Self {
        let (process, port) = serve(free_loopback_port().expect("a free port"), arguments);
        Self { process, port }
    }

    /// Starts another server on the same port, after [`kill`](Self::kill) or [`end`](Self::end).
    ///
    /// # Panics
    /// As [`PageServer::start`].
    pub fn restart(&mut self, arguments: &[&str]) {
        let (process, port) = serve(self.port, arguments);
        assert_eq!(port, self.port, "{}", process.errors());
        self.process = process;
    }

    /// Kills the server.
    pub fn kill(&mut self) {
        self.process.kill();
    }

    /// Requests an orderly end of the server.
    ///
    /// # Panics
    /// When it has ended already.
    pub fn end(&self) {
        self.process.signal("INT");
    }

    /// The address of the page.
    pub fn url(&self) -> String {
        url(self.port)
    }
}

/// Clicks the button of the theme until the page has this one, `light` or `dark`.
///
/// # Panics
/// When that takes longer than the time limit.
pub fn choose_theme(browser: &Browser, theme: &str) {
    let expected = format!("theme: {theme}");
    wait_until("the theme", || {
        let now = browser.text("#theme");
        if now != expected {
            browser.click("#theme");
        }
        now == expected
    });
}

/// A server of the page, and the port that it prints.
fn serve(port: u16, arguments: &[&str]) -> (Process, u16) {
    let mut process = Process::heliostat(&[&["ui", "--plain", "--ui-port", &port.to_string()], arguments].concat());
    let mut bound = None;
    wait_until("the address of the page", || {
        assert!(process.is_running(), "the server of the page ended: {}", process.errors());
        bound = printed_port(&process.errors());
        bound.is_some()
    });
    (process, bound.expect("waited for"))
}

fn printed_port(errors: &str) -> Option<u16> {
    let (_, address) = errors.split_once("the page is at http://127.0.0.1:")?;
    address.split_once('/')?.0.parse().ok()
}

fn url(port: u16) -> String {
    format!("http://127.0.0.1:{port}/")
}
