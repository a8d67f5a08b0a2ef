//! Room, controller and server of the page as processes of their own, and what the page shows.

use heliostat_bus::{BusConfig, private_endpoint};
use heliostat_proto::Room;
use heliostat_tests::{Browser, PageServer, Process, RoomObserver, Turn, wait_until};

/// A script: whether the chart of the sum rate has a line in the colour of the policy "greedy".
pub const GREEDY_LINE: &str = "const canvas = document.querySelector('#sum-chart canvas'); \
     if (!canvas) return false; \
     const { data } = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height); \
     return new Uint32Array(data.buffer).some((pixel) => pixel === 0xff337711)";

/// Room, controller and page.
pub struct Setting {
    pub room: Process,
    pub controller: Process,
    pub server: PageServer,
    endpoints: [String; 2],
    // Taken before the processes start, and dropped last.
    _turn: Turn,
}

impl Setting {
    pub fn new() -> Self {
        Self::with(&[])
    }

    /// The processes with a browser that shows them from above.
    pub fn shown() -> (Self, Browser) {
        let setting = Self::new();
        let browser = setting.browser();
        (setting, browser)
    }

    /// The processes with settings of the room's scenario, which the other processes share.
    pub fn with(set: &[&str]) -> Self {
        Self::seen_by(set, &[])
    }

    /// The processes with an observer whose messages reach all processes.
    pub fn observed() -> (Self, RoomObserver) {
        let of_observer = private_endpoint().expect("an endpoint");
        let setting = Self::seen_by(&[], &["--connect", &of_observer]);
        let room = BusConfig::new(Room::new("demo").expect("a valid name")).listen_at(&of_observer);
        let [at_room, at_controller] = setting.endpoints.each_ref().map(String::as_str);
        let observer = RoomObserver::join(&room.connect_to(at_room).connect_to(at_controller));
        (setting, observer)
    }

    /// The processes, with more flags of the page's server.
    fn seen_by(set: &[&str], server: &[&str]) -> Self {
        let turn = Turn::wait();
        let endpoints = [(); 2].map(|()| private_endpoint().expect("an endpoint"));
        let [at_room, at_controller] = endpoints.each_ref().map(String::as_str);
        let room = Process::heliostat(&[&["sim-node", "--listen", at_room], set].concat());
        let join = ["controller", "--policy", "greedy", "--connect", at_room, "--listen", at_controller];
        let controller = Process::heliostat(&[&join, set].concat());
        let server = PageServer::start(&[&["--connect", at_room, "--connect", at_controller], server, set].concat());
        Self { room, controller, server, endpoints, _turn: turn }
    }

    /// A browser that shows the running room from above, which costs little of the processors.
    pub fn browser(&self) -> Browser {
        showing_the_room(Browser::open_flat(&self.server.url()))
    }

    /// A browser that shows the running room in three dimensions.
    pub fn browser_3d(&self) -> Browser {
        showing_the_room(Browser::open(&self.server.url()))
    }

    /// Starts another server on the port of the one that was killed or has ended.
    pub fn restart_server(&mut self) {
        let [room, controller] = self.endpoints.each_ref().map(String::as_str);
        self.server.restart(&["--connect", room, "--connect", controller]);
    }
}

/// The browser, once it shows and draws the room.
fn showing_the_room(browser: Browser) -> Browser {
    wait_until("a page that shows the room", || is_live(&browser));
    wait_until("a drawn room", || drawn(&browser) > 3);
    browser
}

pub fn is_live(browser: &Browser) -> bool {
    browser.text("#chip-array") == "following" && browser.text("#chip-controller") == "alive"
}

/// Number of pictures since the page was loaded.
pub fn drawn(browser: &Browser) -> u64 {
    browser.run("return document.getElementById('room').room?.frames ?? 0").as_u64().expect("a number")
}

pub fn banner(browser: &Browser) -> String {
    let script = "const banner = document.getElementById('banner'); return banner.hidden ? '' : banner.textContent";
    browser.run(script).as_str().unwrap_or_default().to_owned()
}

/// Sends an order as a button does, also one for which there is no button.
pub fn order(browser: &Browser, order: &str) {
    let script = format!(
        "return fetch('/order', {{ method: 'POST', headers: {{ 'content-type': 'application/json' }}, \
         body: JSON.stringify({order}) }}).then((answer) => answer.status)"
    );
    browser.run(&script);
}
