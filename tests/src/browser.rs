//! A headless Chromium, driven by chromedriver over W3C WebDriver (JSON over HTTP).

use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use base64::prelude::{BASE64_STANDARD, Engine as _};
use serde_json::{Value, json};

use crate::turn::Turn;
use crate::wait::{TIME_LIMIT, wait_until};

/// Flags for a run as root, without a graphics card, and without requests other than the page's.
const FLAGS: [&str; 9] = [
    "--headless",
    "--no-sandbox",
    "--disable-quic",
    "--disable-dev-shm-usage",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--hide-scrollbars",
];

/// Flags for pictures in three dimensions without a graphics card.
const SOFTWARE_3D: [&str; 2] = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader"];

/// Flags for a browser without WebGL.
const FLAT: [&str; 2] = ["--disable-gpu", "--disable-3d-apis"];

/// Time limit for an answer of the driver: a browser that hangs ends its test. A script has a shorter one.
const ANSWER_LIMIT: Duration = Duration::from_secs(2 * TIME_LIMIT.as_secs());

/// A browser with one page; it ends when dropped.
///
/// It takes a [`Turn`].
pub struct Browser {
    /// Address of the session.
    session: String,
    // Dropped after the session ended, and before the profile.
    _driver: Driver,
    _profile: tempfile::TempDir,
    // Dropped last, after the browser ended.
    _turn: Turn,
}

/// A chromedriver, also of a browser that does not start; it ends when dropped.
struct Driver(Child);

impl Drop for Driver {
    fn drop(&mut self) {
        self.0.kill().ok();
        self.0.wait().ok();
    }
}

impl Browser {
    /// Opens a page in a browser with an empty profile, which draws in three dimensions.
    ///
    /// # Panics
    /// When the browser does not start.
    pub fn open(url: &str) -> Self {
        Self::start(url, &SOFTWARE_3D)
    }

    /// The same in a browser without WebGL.
    ///
    /// # Panics
    /// As [`Browser::open`].
    pub fn open_flat(url: &str) -> Self {
        Self::start(url, &FLAT)
    }

    fn start(url: &str, more: &[&str]) -> Self {
        let turn = Turn::wait();
        let mut command = Command::new("chromedriver");
        command.arg("--port=0").stdout(Stdio::piped()).stderr(Stdio::null());
        // Before the driver, whose browser writes into it.
        let profile = tempfile::tempdir().expect("a temporary folder");
        let mut driver = Driver(command.spawn().expect("chromedriver starts"));
        let port = announced_port(&mut driver.0);
        let mut flags: Vec<String> = FLAGS.map(String::from).into();
        flags.push(format!("--user-data-dir={}", profile.path().display()));
        flags.extend(more.iter().map(|flag| (*flag).to_owned()));
        let (options, logs) = (json!({ "args": flags }), json!({ "browser": "ALL" }));
        let capabilities = json!({ "alwaysMatch": { "goog:chromeOptions": options, "goog:loggingPrefs": logs, "timeouts": { "script": TIME_LIMIT.as_millis() } } });
        let sessions = format!("http://127.0.0.1:{port}/session");
        let session =
            call(&sessions, &json!({ "capabilities": capabilities })).expect("chromedriver starts a Chromium");
        let id = session["sessionId"].as_str().expect("a session has an id");
        let browser = Self { session: format!("{sessions}/{id}"), _driver: driver, _profile: profile, _turn: turn };
        browser.command("url", &json!({ "url": url }));
        browser
    }

    /// The handle of the tab that scripts and clicks reach.
    ///
    /// # Panics
    /// When the browser refuses.
    pub fn tab(&self) -> String {
        let request = ureq::get(format!("{}/window", self.session));
        let request = request.config().timeout_global(Some(ANSWER_LIMIT)).build();
        let handle: Value = request
            .call()
            .and_then(|mut answer| answer.body_mut().read_json())
            .unwrap_or_else(|error| panic!("no tab: {error}"));
        handle["value"].as_str().expect("a handle").to_owned()
    }

    /// Opens an address in another tab, which scripts and clicks then reach; returns its handle.
    ///
    /// # Panics
    /// When the browser refuses.
    pub fn open_tab(&self, url: &str) -> String {
        let opened = self.command("window/new", &json!({ "type": "tab" }));
        let tab = opened["handle"].as_str().expect("a handle").to_owned();
        self.switch_to(&tab);
        self.command("url", &json!({ "url": url }));
        tab
    }

    /// Lets scripts and clicks reach another tab.
    ///
    /// # Panics
    /// When there is no such tab.
    pub fn switch_to(&self, tab: &str) {
        self.command("window", &json!({ "handle": tab }));
    }

    /// Clicks the element of a CSS selector, once it exists, is enabled and stays where it is: a click that another
    /// element received, because the page moved meanwhile, is repeated.
    ///
    /// # Panics
    /// When that takes longer than the time limit.
    pub fn click(&self, selector: &str) {
        wait_until(&format!("{selector} that can be clicked"), || {
            // In the middle of the window, where no bar of the page lies above it.
            let enabled = format!(
                "const element = document.querySelector({selector:?}); element?.scrollIntoView({{ block: 'center' }}); \
                 window.reached = false; element?.addEventListener('click', () => window.reached = true, {{ once: true }}); \
                 return element?.disabled === false"
            );
            self.run(&enabled) == true
                && self.element(selector, "click", &json!({})).is_some()
                // A page that the click has left has no such mark.
                && self.run("return window.reached !== false") == true
        });
    }

    /// Types into the element of a CSS selector.
    ///
    /// # Panics
    /// When it does not exist, or accepts no keys.
    pub fn press(&self, selector: &str, keys: &str) {
        let typed = self.element(selector, "value", &json!({ "text": keys }));
        assert!(typed.is_some(), "{selector} accepts no keys");
    }

    /// The value that a script returns.
    ///
    /// # Panics
    /// When it fails.
    pub fn run(&self, script: &str) -> Value {
        self.command("execute/sync", &json!({ "script": script, "args": [] }))
    }

    /// The text of the element of a CSS selector; empty if there is none.
    pub fn text(&self, selector: &str) -> String {
        let text = self.run(&format!("return document.querySelector({selector:?})?.textContent ?? ''"));
        text.as_str().unwrap_or_default().to_owned()
    }

    /// Keeps each text that the element of a CSS selector has from now on: some are shown for seconds only, and a busy
    /// machine may look at the page less often.
    ///
    /// # Panics
    /// When there is no such element.
    pub fn record(&self, selector: &str) {
        self.run(&format!(
            "window.texts = []; const element = document.querySelector({selector:?}); \
             new MutationObserver(() => window.texts.push(element.textContent)) \
                 .observe(element, {{ childList: true, characterData: true, subtree: true }})"
        ));
    }

    /// The texts since [`record`](Self::record), oldest first.
    ///
    /// # Panics
    /// When none are kept.
    pub fn recorded(&self) -> Vec<String> {
        serde_json::from_value(self.run("return window.texts")).expect("texts that are kept")
    }

    /// Sets the size of the page in CSS pixels.
    ///
    /// # Panics
    /// When the browser refuses.
    pub fn resize(&self, width: u32, height: u32) {
        let size = json!({ "width": width, "height": height, "deviceScaleFactor": 1, "mobile": false });
        self.devtools("Emulation.setDeviceMetricsOverride", size);
    }

    /// Errors that the page wrote to the console since the last call.
    ///
    /// # Panics
    /// When the browser refuses.
    pub fn console_errors(&self) -> Vec<String> {
        let log = self.command("se/log", &json!({ "type": "browser" }));
        let entries = log.as_array().cloned().unwrap_or_default();
        let errors = entries.iter().filter(|entry| entry["level"] == "SEVERE");
        errors.map(|entry| entry["message"].to_string()).collect()
    }

    /// A screenshot of the page as PNG.
    ///
    /// # Panics
    /// When the browser refuses.
    pub fn screenshot(&self) -> Vec<u8> {
        let screenshot = self.devtools("Page.captureScreenshot", json!({ "format": "png" }));
        BASE64_STANDARD.decode(screenshot["data"].as_str().expect("text")).expect("base 64")
    }

    fn devtools(&self, command: &str, parameters: Value) -> Value {
        self.command("goog/cdp/execute", &json!({ "cmd": command, "params": parameters }))
    }

    /// Applies an action to the element of a selector; `None` if it does not exist or the action
    /// fails.
    fn element(&self, selector: &str, action: &str, body: &Value) -> Option<Value> {
        let found = self.command("elements", &json!({ "using": "css selector", "value": selector }));
        let id = found.as_array()?.first()?.as_object()?.values().next()?.as_str()?;
        call(&format!("{}/element/{id}/{action}", self.session), body).ok()
    }

    fn command(&self, name: &str, body: &Value) -> Value {
        call(&format!("{}/{name}", self.session), body).unwrap_or_else(|error| panic!("{name} {body}: {error}"))
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        // If this fails, the browser ends with its driver.
        let _ = ureq::delete(&self.session).config().timeout_global(Some(ANSWER_LIMIT)).build().call();
    }
}

/// The value of a WebDriver response, or its error message.
fn call(url: &str, body: &Value) -> Result<Value, String> {
    let request = ureq::post(url).config().http_status_as_error(false).timeout_global(Some(ANSWER_LIMIT)).build();
    let mut answer = request.send_json(body).map_err(|error| error.to_string())?;
    let is_success = answer.status().is_success();
    let mut answer: Value = answer.body_mut().read_json().map_err(|error| error.to_string())?;
    let value = answer["value"].take();
    if is_success { Ok(value) } else { Err(value["message"].as_str().unwrap_or_default().to_owned()) }
}

/// The port that the system assigned, from chromedriver's first output.
fn announced_port(driver: &mut Child) -> u16 {
    let output = BufReader::new(driver.stdout.take().expect("standard output is piped"));
    let port = |line: String| line.split_once("successfully on port ")?.1.trim_end_matches('.').parse().ok();
    output.lines().map_while(Result::ok).find_map(port).expect("chromedriver prints its port")
}
