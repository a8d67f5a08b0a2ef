//! The room that the controllers know: its scenario, built once for each kind of setup.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::rc::Rc;

use heliostat_channel::ChannelModel;
use heliostat_scenario::Scenario;

use crate::hosts::device::SIDE;
use crate::monitor::commands::RANGE_DEG;
use crate::plan::{PolicyChoice, Setup};

/// Largest rate of the mirrors in degrees per second.
const SLEW_DEG_PER_S: f64 = 900.0;

/// A room as its controllers know it.
#[derive(Clone)]
pub(crate) struct Room {
    pub scenario: Rc<Scenario>,
    pub model: Rc<ChannelModel>,
    pub policy: PolicyChoice,
    /// Time between two position reports in ns.
    pub interval_ns: u64,
    /// Age in ns above which a position report is not answered.
    pub age_max_ns: u64,
    /// Largest rate of the mirrors in rad/s.
    pub slew_rad_s: f64,
}

/// What of a setup a room depends on: arrays, filter, last-good in silence, rate.
type Key = (usize, bool, bool, u64);

thread_local! {
    static ROOMS: RefCell<BTreeMap<Key, Room>> = const { RefCell::new(BTreeMap::new()) };
}

impl Room {
    /// The room of a setup.
    pub fn of(setup: &Setup) -> Self {
        let key = (setup.arrays, setup.has_filter, setup.repeats_in_silence, setup.rate_hz);
        let room = ROOMS.with_borrow_mut(|rooms| rooms.entry(key).or_insert_with(|| Self::build(key)).clone());
        Self { policy: setup.policy, ..room }
    }

    fn build((arrays, has_filter, repeats_in_silence, rate_hz): Key) -> Self {
        let belief = if has_filter { "filter" } else { "constant-velocity" };
        let when_silent = if repeats_in_silence { "last-good" } else { "hold" };
        let walls = ["+y", "-y"];
        let array = |wall: &str| format!("[[mirrors]]\nrows = {SIDE}\ncolumns = {SIDE}\nwall = \"{wall}\"\n");
        let mirrors: String = walls[..arrays].iter().map(|wall| array(wall)).collect();
        let text = format!(
            "[led]\npoints_per_side = 1\n[users]\ncount = 2\n[streams.positions]\nrate_hz = {rate_hz}.0\n\
             [streams.channel]\nrate_hz = {rate_hz}.0\n[control]\nbelief = \"{belief}\"\nfallback = \"nearest\"\n\
             when_silent = \"{when_silent}\"\n\
             range_deg = {RANGE_DEG}\nslew_deg_per_s = {SLEW_DEG_PER_S}\n{mirrors}"
        );
        let scenario = Scenario::from_toml(&text).unwrap_or_else(|error| panic!("{text}\n{error}"));
        let model = scenario.channel_model().unwrap_or_else(|error| panic!("{text}\n{error}"));
        Self {
            policy: PolicyChoice::Nearest,
            interval_ns: 1_000_000_000 / rate_hz,
            age_max_ns: scenario.control.report_age_max_ns(),
            slew_rad_s: SLEW_DEG_PER_S.to_radians(),
            scenario: Rc::new(scenario),
            model: Rc::new(model),
        }
    }
}
