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
        let port = free_loopback_port().expect("a free port");
        Self { process: serve(port, arguments), port }
    }

    /// Starts another server on the same port, after [`kill`](Self::kill).
    ///
    /// # Panics
    /// As [`PageServer::start`].
    pub fn restart(&mut self, arguments: &[&str]) {
        self.process = serve(self.port, arguments);
    }

    /// Kills the server.
    pub fn kill(&mut self) {
        self.process.kill();
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

fn serve(port: u16, arguments: &[&str]) -> Process {
    let process = Process::heliostat(&[&["ui", "--plain", "--ui-port", &port.to_string()], arguments].concat());
    let served = format!("the page is at {}", url(port));
    wait_until("the address of the page", || process.errors().contains(&served));
    process
}

fn url(port: u16) -> String {
    format!("http://127.0.0.1:{port}/")
}
