//! A Chromium without a window, driven by chromedriver over W3C WebDriver: JSON over HTTP.

use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Stdio};

use base64::prelude::{BASE64_STANDARD, Engine as _};
use serde_json::{Value, json};

use crate::wait_until;

/// Set where a browser must be there: its absence is then a failure.
const REQUIRED: &str = "HELIOSTAT_REQUIRE_BROWSER";

/// Root may run it, no graphics card is needed, and nothing but the page is asked for.
const FLAGS: [&str; 11] = [
    "--headless",
    "--no-sandbox",
    "--disable-quic",
    "--disable-dev-shm-usage",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--hide-scrollbars",
];

/// A browser with one page; it ends when dropped.
pub struct Browser {
    driver: Child,
    /// Address of the session.
    session: String,
    _profile: tempfile::TempDir,
}

impl Browser {
    /// Opens a page in a browser whose profile is empty; nothing where no browser is installed, which is said.
    ///
    /// # Panics
    /// When a browser is required and not there, or when it does not start.
    pub fn open(url: &str) -> Option<Self> {
        let driver = Command::new("chromedriver").arg("--port=0").stdout(Stdio::piped()).stderr(Stdio::null()).spawn();
        let mut driver = match driver {
            Ok(driver) => driver,
            Err(_) if std::env::var_os(REQUIRED).is_none() => {
                eprintln!("SKIPPED: there is no chromedriver (Debian: apt-get install chromium chromium-driver)");
                return None;
            }
            Err(error) => panic!("{REQUIRED} is set, but chromedriver does not start: {error}"),
        };
        let port = announced_port(&mut driver);
        let profile = tempfile::tempdir().expect("a folder for the profile");
        let mut flags: Vec<String> = FLAGS.map(String::from).into();
        flags.push(format!("--user-data-dir={}", profile.path().display()));
        let wanted = json!({ "alwaysMatch": { "goog:chromeOptions": { "args": flags } } });
        let sessions = format!("http://127.0.0.1:{port}/session");
        let session = call(&sessions, &json!({ "capabilities": wanted })).expect("chromedriver starts a Chromium");
        let id = session["sessionId"].as_str().expect("a session has an id");
        let browser = Self { driver, session: format!("{sessions}/{id}"), _profile: profile };
        browser.order("url", &json!({ "url": url }));
        Some(browser)
    }

    /// Clicks what a CSS selector finds, once it is there and can be clicked.
    ///
    /// # Panics
    /// When that is not so in good time.
    pub fn click(&self, selector: &str) {
        wait_until(&format!("{selector} that can be clicked"), || {
            let enabled = format!("return document.querySelector({selector:?})?.disabled === false");
            self.run(&enabled) == true && self.element(selector, "click", &json!({})).is_some()
        });
    }

    /// Types into what a CSS selector finds.
    ///
    /// # Panics
    /// When it is not there, or takes no keys.
    pub fn press(&self, selector: &str, keys: &str) {
        let typed = self.element(selector, "value", &json!({ "text": keys }));
        assert!(typed.is_some(), "{selector} takes no keys");
    }

    /// What a script returns.
    ///
    /// # Panics
    /// When it fails.
    pub fn run(&self, script: &str) -> Value {
        self.order("execute/sync", &json!({ "script": script, "args": [] }))
    }

    /// The text of what a CSS selector finds; empty where nothing is.
    pub fn text(&self, selector: &str) -> String {
        let text = self.run(&format!("return document.querySelector({selector:?})?.textContent ?? ''"));
        text.as_str().unwrap_or_default().to_owned()
    }

    /// Makes the page this large, in CSS pixels, whatever the window.
    ///
    /// # Panics
    /// When the browser refuses.
    pub fn resize(&self, width: u32, height: u32) {
        let size = json!({ "width": width, "height": height, "deviceScaleFactor": 1, "mobile": false });
        self.devtools("Emulation.setDeviceMetricsOverride", size);
    }

    /// A picture of the page, PNG.
    ///
    /// # Panics
    /// When the browser refuses.
    pub fn picture(&self) -> Vec<u8> {
        let picture = self.devtools("Page.captureScreenshot", json!({ "format": "png" }));
        BASE64_STANDARD.decode(picture["data"].as_str().expect("text")).expect("base 64")
    }

    fn devtools(&self, command: &str, parameters: Value) -> Value {
        self.order("goog/cdp/execute", &json!({ "cmd": command, "params": parameters }))
    }

    /// Does something to what a selector finds; nothing where it is not there or cannot be done.
    fn element(&self, selector: &str, action: &str, body: &Value) -> Option<Value> {
        let found = self.order("elements", &json!({ "using": "css selector", "value": selector }));
        let id = found.as_array()?.first()?.as_object()?.values().next()?.as_str()?;
        call(&format!("{}/element/{id}/{action}", self.session), body).ok()
    }

    fn order(&self, command: &str, body: &Value) -> Value {
        call(&format!("{}/{command}", self.session), body).unwrap_or_else(|error| panic!("{command} {body}: {error}"))
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        // It ends with its driver at the latest.
        let _ = ureq::delete(&self.session).call();
        self.driver.kill().ok();
        self.driver.wait().ok();
    }
}

/// The value of a WebDriver command's answer, or what was wrong.
fn call(url: &str, body: &Value) -> Result<Value, String> {
    let request = ureq::post(url).config().http_status_as_error(false).build();
    let mut answer = request.send_json(body).map_err(|error| error.to_string())?;
    let is_good = answer.status().is_success();
    let mut answer: Value = answer.body_mut().read_json().map_err(|error| error.to_string())?;
    let value = answer["value"].take();
    if is_good { Ok(value) } else { Err(value["message"].as_str().unwrap_or_default().to_owned()) }
}

/// The port that the system gave, from what chromedriver says when it has started.
fn announced_port(driver: &mut Child) -> u16 {
    let output = BufReader::new(driver.stdout.take().expect("standard output is piped"));
    let port = |line: String| line.split_once("successfully on port ")?.1.trim_end_matches('.').parse().ok();
    output.lines().map_while(Result::ok).find_map(port).expect("chromedriver says on which port it started")
}
