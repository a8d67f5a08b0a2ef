//! What the arrays of a room report about the emergency stops, and which stops are held for them.
//!
//! This is the rule by which a room is called stopped (CONTRACT.md, section 5). The page, the command
//! line and the simulation use this type.
//!
//! Times are those of the process that uses it, on a clock that never steps, since any origin. An array
//! has stopped where its last stop report is fresh, lists every stop that is held for it, and states
//! that its device has executed them. Where the liveliness tokens of several drivers name the array, each
//! driver has to: the reports of one say nothing about the mirrors of another one. A driver is lost if its token ends
//! while a stop is held that it has not confirmed, whether it hung, was killed or ended in order; not so one that yields
//! its array at its start, see [`PresentDriver`]. A driver that left before is lost if a controller reports it. The stop
//! then stays unconfirmed until this driver answers, or until the release.
//!
//! | the array publishes | its standing, by its last reports |
//! | --- | --- |
//! | reports of several drivers, or of one of them | [`Shared`](Standing::Shared) until each has stopped |
//! | what confirms a stop, beside a driver that was lost before it answered | [`Lost`](Standing::Lost) |
//! | stop reports | [`Stopped`](Standing::Stopped), [`Latched`](Standing::Latched) or [`Moving`](Standing::Moving) |
//! | safety reports or telemetry only | [`Unknown`](Standing::Unknown) in state *stopped*, else [`Moving`](Standing::Moving) |
//! | nothing for some time | [`Silent`](Standing::Silent) |

mod lost_reports;
mod reported_array;
mod standing;

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use crate::enumerations::ArrayState;
use crate::limits::{MAX_ARRAYS, Nanos, cut};
use crate::messages::{EmergencyStop, MirrorTelemetry, NodeStatus, SafetyReport, StopReport, fault};
use crate::present_driver::PresentDriver;
use crate::sources::make_place;
use crate::stop_hold::{HeldStop, StopHold, unknown_stops};
use crate::structures::{LatchedStopReport, Stamp, StopName};
use lost_reports::LostReports;
use reported_array::{REPORT_AGE_MAX, ReportedArray};

pub use standing::Standing;

/// A driver that publishes stop reports has published one after this time of telemetry.
pub const STOPS_WITHIN: Duration = Duration::from_millis(1500);

/// The array and the source of a process with mirrors, by its liveliness token; a simulator drives every array of its
/// room.
pub type Driver = (Option<usize>, u64);

/// A stop that is in force or held, with the arrays for which it is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RoomStop {
    /// Its name.
    pub name: StopName,
    /// Name of the operator who sent it.
    pub operator: String,
    /// Reason for it.
    pub reason: String,
    /// Indices of the arrays for which it is held.
    pub arrays: Vec<usize>,
    /// When this process learned of it.
    pub known: Duration,
    /// Whether it stands for stops that an array could not list: their holders repeat them after its release.
    pub stands_for_unlisted: bool,
}

/// What the arrays of a room reported, and what is held for them.
#[derive(Clone, Debug, Default)]
pub struct ReportedStops {
    arrays: BTreeMap<usize, ReportedArray>,
    /// The processes with mirrors that are in the room.
    drivers: BTreeMap<Driver, PresentDriver>,
    /// Those that left it before they confirmed a stop that is held.
    lost: BTreeSet<Driver>,
    /// Those that controllers have lost, also before this process looked.
    reported_lost: LostReports,
    /// Number of arrays of the largest geometry that was announced; 0 before the first.
    announced: usize,
    /// When each stop became known here.
    known: BTreeMap<StopName, Duration>,
    /// The stops of this process, the last of each sender. An array that appears later never got them.
    orders: Vec<EmergencyStop>,
}

impl ReportedStops {
    /// Number of arrays that have to confirm a stop: those of the announced geometry, and all that
    /// were ever seen.
    fn expected(&self) -> usize {
        let seen = self.arrays.keys().next_back().map_or(0, |last| last + 1);
        seen.max(self.announced)
    }

    /// Whether a geometry was announced.
    pub fn has_geometry(&self) -> bool {
        self.announced > 0
    }

    /// What each array does about the stops that are held for it. Of several reports only those that
    /// arrived after `since` count.
    pub fn standings(&self, now: Duration, since: Option<Duration>) -> Vec<(usize, Standing)> {
        let standing = |array: usize| {
            let Some(seen) = self.arrays.get(&array) else { return (array, Standing::Silent) };
            let standing = seen.standing(&self.drivers_of(array), now, since);
            let lost = if standing == Standing::Stopped { self.lost_of(array, now) } else { None };
            (array, lost.unwrap_or(standing))
        };
        (0..self.expected()).map(standing).collect()
    }

    /// The arrays of which drivers are lost, whether or not a stop is held, each with [`Standing::Lost`].
    pub fn lost(&self, now: Duration) -> Vec<(usize, Standing)> {
        (0..self.expected()).filter_map(|array| Some((array, self.lost_of(array, now)?))).collect()
    }

    /// That drivers of an array are lost; `None` if there is none, or each has stopped since.
    fn lost_of(&self, array: usize, now: Duration) -> Option<Standing> {
        let (present, seen) = (self.drivers_of(array), self.arrays.get(&array));
        let has_stopped = |source: u64| seen.is_some_and(|seen| seen.has_stopped(source, now));
        let is_lost = |source: &u64| !present.contains(source) && !has_stopped(*source);
        let reported: Vec<_> = self.reported_lost.of(array, now).filter(|lost| is_lost(&lost.source)).collect();
        let own = sources_of(&self.lost, array).into_iter().filter(is_lost);
        let drivers: BTreeSet<u64> = own.chain(reported.iter().map(|lost| lost.source)).collect();
        let since_ns = reported.iter().map(|lost| lost.since_ns).min();
        (!drivers.is_empty()).then(|| Standing::Lost { drivers: drivers.into_iter().collect(), since_ns })
    }

    /// The controllers that are in the room and have not reported yet which drivers they have lost.
    pub fn unheard_controllers(&self) -> Vec<u64> {
        self.reported_lost.unheard()
    }

    /// Whether the tokens of several drivers name one array.
    pub fn has_shared_array(&self) -> bool {
        (0..MAX_ARRAYS).any(|array| self.drivers_of(array).len() > 1)
    }

    /// Whether the token of a driver names an array.
    pub fn has_driver(&self, array: usize) -> bool {
        !self.drivers_of(array).is_empty()
    }

    /// The sources of the drivers whose tokens name an array.
    fn drivers_of(&self, array: usize) -> Vec<u64> {
        sources_of(self.drivers.keys(), array)
    }

    /// Whether a driver whose token ends has not confirmed a stop that is held.
    fn is_lost(&self, driver: Driver) -> bool {
        let is_open = |(array, seen): (&usize, &ReportedArray)| serves(driver, *array) && seen.is_unanswered(driver.1);
        self.arrays.iter().any(is_open)
    }

    /// Whether a driver whose token ends has yielded each of its arrays at its start to another driver.
    fn has_yielded(&self, now: Duration, driver: Driver, left: PresentDriver) -> bool {
        let mut served = (0..self.expected()).filter(|array| serves(driver, *array));
        served.all(|array| left.has_yielded(now.as_nanos() as Nanos, driver.1, self.drivers_of(array)))
    }

    /// Whether every array holds a stop and has stopped, by reports that arrived after `since`.
    pub fn has_stopped(&self, name: StopName, now: Duration, since: Duration) -> bool {
        let standings = self.standings(now, Some(since));
        let is_stopped = standings.iter().all(|(_, standing)| *standing == Standing::Stopped);
        is_stopped && self.has_array() && (0..self.expected()).all(|array| self.holds(array, name))
    }

    /// All stops that are held, in the order of their arrival at the first array that has them.
    pub fn stops(&self) -> Vec<RoomStop> {
        let mut stops: Vec<RoomStop> = Vec::new();
        for (array, seen) in &self.arrays {
            for held in seen.hold.stops() {
                let HeldStop { name, operator, reason, .. } = held;
                let stands_for_unlisted = seen.stands_for_unlisted(held);
                match stops.iter_mut().find(|stop| stop.name == *name) {
                    Some(stop) => {
                        stop.arrays.push(*array);
                        stop.stands_for_unlisted |= stands_for_unlisted;
                        // Each process that started stopped has its own reason.
                        if *name == StopName::default() && !stop.reason.contains(reason.as_str()) {
                            stop.reason = format!("{}; {reason}", stop.reason);
                        }
                    }
                    None => stops.push(RoomStop {
                        name: *name,
                        operator: operator.clone(),
                        reason: reason.clone(),
                        arrays: vec![*array],
                        known: self.known.get(name).copied().unwrap_or_default(),
                        stands_for_unlisted,
                    }),
                }
            }
        }
        stops
    }

    /// Whether a stop is held for an array, or a later one of its sender.
    pub fn holds(&self, array: usize, name: StopName) -> bool {
        let stops = self.arrays.get(&array).map(|seen| seen.hold.stops());
        stops.is_some_and(|stops| stops.iter().any(|held| held.name.replaces(name)))
    }

    /// The stops that are due for repetition, with the index of the array, and whether its driver
    /// understands none.
    pub fn unreported(&self, now: Duration) -> Vec<(usize, HeldStop, bool)> {
        let of = |(array, seen): (&usize, &ReportedArray)| {
            // Its first stop report may be on its way; a stop of kind 9 also stops arrays that were released.
            let (array, is_older) = (*array, seen.lacks_stop_reports(now) && seen.is_settled(now));
            seen.hold.unreported().map(|held| (array, held.clone(), is_older)).collect::<Vec<_>>()
        };
        self.arrays.iter().flat_map(of).collect()
    }

    /// The present arrays that are stopped and publish neither stop reports nor safety reports.
    pub fn unnamed(&self, now: Duration) -> Vec<usize> {
        let is_unnamed = |seen: &ReportedArray| {
            let is_stopped = seen.state.is_some_and(|(_, state)| state == ArrayState::Stopped);
            is_stopped && seen.lacks_stop_reports(now) && !seen.has_safety
        };
        self.arrays.iter().filter(|(_, seen)| is_unnamed(seen)).map(|(array, _)| *array).collect()
    }

    /// Whether an array has been seen for so long that its stop reports would have arrived.
    pub fn is_settled(&self, array: usize, now: Duration) -> bool {
        self.arrays.get(&array).is_some_and(|seen| seen.is_settled(now))
    }

    /// The arrays for which any of these stops is held, and whether each reports.
    pub fn holding(&self, names: &[StopName], now: Duration) -> Vec<(usize, bool)> {
        let is_held = |seen: &ReportedArray| seen.hold.stops().iter().any(|held| names.contains(&held.name));
        let holding = self.arrays.iter().filter(|(_, seen)| is_held(seen));
        holding.map(|(array, seen)| (*array, !seen.is_silent(now))).collect()
    }

    /// Whether no array is known.
    pub fn is_empty(&self) -> bool {
        self.expected() == 0
    }

    /// Whether any array reports.
    pub fn has_array(&self) -> bool {
        self.arrays.values().any(|seen| seen.first.is_some())
    }

    /// Whether an array that has to confirm a stop does not report, or no array is known.
    pub fn has_silent_array(&self, now: Duration) -> bool {
        let is_silent = |array: usize| self.arrays.get(&array).is_none_or(|seen| seen.is_silent(now));
        self.is_empty() || (0..self.expected()).any(is_silent)
    }

    /// Whether each array that was seen has published its stops, or publishes none.
    pub fn has_published(&self, now: Duration) -> bool {
        self.has_array() && self.arrays.values().all(|seen| seen.stops.is_some() || seen.is_settled(now))
    }

    /// Whether every array has published its stops.
    pub fn is_complete(&self) -> bool {
        let has_reported = |array| self.arrays.get(&array).is_some_and(|seen: &ReportedArray| seen.stops.is_some());
        self.has_geometry() && (0..self.expected()).all(has_reported)
    }

    /// Whether all that can keep a stop unconfirmed was heard: the stops of every array, and the lost drivers of every
    /// controller. What has not come some time after the first report of an array is not awaited.
    pub fn is_heard(&self, now: Duration) -> bool {
        let is_told = self.is_complete() && self.unheard_controllers().is_empty();
        is_told || self.arrays.values().any(|seen| seen.is_settled(now))
    }

    /// Whether a stop report of an array has arrived after this time.
    pub fn has_stops_after(&self, array: usize, time: Duration) -> bool {
        self.arrays.get(&array).and_then(|seen| seen.stops.as_ref()).is_some_and(|(at, _)| *at > time)
    }

    /// The arrays that have stopped and do not record the stop, each with its reason.
    pub fn unrecorded(&self, now: Duration) -> Vec<(usize, String)> {
        let of = |(array, seen): (&usize, &ReportedArray)| {
            let (at, report) = seen.stops.as_ref()?;
            let is_recent = now.saturating_sub(*at) < REPORT_AGE_MAX;
            let is_unrecorded = is_recent && report.device_stopped && !report.problem.is_empty();
            is_unrecorded.then(|| (*array, report.problem.clone()))
        };
        self.arrays.iter().filter_map(of).collect()
    }

    /// When the oldest of the arrays reported last.
    pub fn oldest_report(&self) -> Option<Duration> {
        self.arrays.values().filter_map(|seen| seen.state.map(|(at, _)| at)).min()
    }

    /// Whether an array has reported a stop of this process, also where it has dropped it since.
    pub fn has_reported(&self, array: usize, name: StopName) -> bool {
        self.arrays.get(&array).is_some_and(|seen| {
            seen.reported.iter().any(|reported| reported.replaces(name)) || seen.hold.has_released(name)
        })
    }

    /// Holds a stop of this process for every array. While no geometry is announced, any number of arrays can appear
    /// later: the stop is held for each of them too, also where the other arrays have released it.
    pub fn order(&mut self, now: Duration, order: &EmergencyStop) {
        self.known.entry(order.name()).or_insert(now);
        self.orders.retain(|earlier| !order.name().replaces(earlier.name()));
        self.orders.push(order.clone());
        for array in 0..self.expected() {
            self.arrays.entry(array).or_default().hold.order(order.stamp.time_ns, order);
        }
        self.note_names(now);
    }

    /// Holds these stops no longer for arrays that appear later, and for those whose stop report arrived after `since`
    /// and names none of them: no process has repeated the stop to such an array.
    pub fn forget_unlatched(&mut self, names: &[StopName], since: Duration) {
        self.orders.retain(|order| !names.contains(&order.name()));
        for ReportedArray { stops, hold, .. } in self.arrays.values_mut() {
            if let Some((_, report)) = stops.as_ref().filter(|(at, _)| *at > since) {
                names.iter().filter(|name| !report.is_latched(**name)).for_each(|name| hold.forget(*name));
            }
        }
    }

    /// The geometry of the room has so many arrays.
    pub fn announce(&mut self, now: Duration, arrays: usize) {
        // The arrays of the first geometry had no number when a stop of this process was ordered.
        self.add_arrays(arrays);
        self.announced = self.announced.max(arrays);
        self.note_names(now);
    }

    /// The token of a driver has appeared in the room, or has left it.
    pub fn handle_driver(&mut self, now: Duration, driver: Driver, is_present: bool) {
        if is_present {
            self.drivers.entry(driver).or_insert(PresentDriver::new(now.as_nanos() as Nanos));
            self.lost.remove(&driver);
            // A simulator announces its arrays with the geometry.
            self.add_arrays(driver.0.map_or(0, |array| array + 1));
        } else if let Some(left) = self.drivers.remove(&driver)
            && self.is_lost(driver)
            && !self.has_yielded(now, driver, left)
        {
            self.lost.insert(driver);
        }
        self.note_names(now);
    }

    /// The token of a controller has appeared in the room, or has left it.
    pub fn handle_controller(&mut self, source: u64, is_present: bool) {
        self.reported_lost.handle_controller(source, is_present);
    }

    /// The status of a process arrived: that of a controller names the drivers that it has lost.
    pub fn handle_status(&mut self, now: Duration, status: &NodeStatus) {
        let arrays = self.reported_lost.handle_status(now, status);
        self.add_arrays(arrays);
        self.note_names(now);
    }

    /// Telemetry of an array arrived.
    pub fn handle_telemetry(&mut self, now: Duration, array: usize, report: &MirrorTelemetry) {
        for driver in [Some(array), None].map(|of| (of, report.stamp.source)) {
            self.drivers.get_mut(&driver).into_iter().for_each(|driver| driver.handle_telemetry(report));
        }
        let (seen, is_stopped) = (self.array(now, array), report.state == ArrayState::Stopped);
        seen.hold.handle_state(report.stamp.source, is_stopped);
        seen.state = Some((now, report.state));
        if is_stopped && report.faults & fault::STOP == 0 {
            seen.device_stopped = Some((now, report.stamp.source));
        }
        self.note_names(now);
    }

    /// A stop report of an array arrived.
    pub fn handle_stops(&mut self, now: Duration, array: usize, report: StopReport) {
        // A report that arrives late must not show a device as stopped that has moved on since.
        if self.handle_reported(now, array, &report.stops, |hold| hold.handle_stops(&report)) {
            let drivers = self.drivers_of(array);
            let seen = self.array(now, array);
            let is_recent = |at: Duration| now.saturating_sub(at) < REPORT_AGE_MAX;
            seen.by_source.retain(|source, (at, _)| is_recent(*at) || drivers.contains(source));
            let is_late = |(_, known): &(Duration, StopReport)| known.stamp.sequence > report.stamp.sequence;
            let source = report.stamp.source;
            if !seen.by_source.get(&source).is_some_and(is_late)
                && make_place(&mut seen.by_source, source, |source| drivers.contains(&source))
            {
                seen.by_source.insert(source, (now, report.clone()));
            }
            let had_unlisted = seen.had_unlisted && report.lists(StopName::default());
            seen.had_unlisted = had_unlisted || report.stands_for_unlisted();
            seen.stops = Some((now, report));
        }
        self.note_names(now);
    }

    /// A safety report of an array arrived.
    pub fn handle_safety(&mut self, now: Duration, array: usize, report: &SafetyReport) {
        self.handle_reported(now, array, report.stop().as_slice(), |hold| hold.handle_safety(report));
        self.array(now, array).has_safety = true;
        self.note_names(now);
    }

    /// Adds arrays up to an index; stops that are held for another array are held for them too, and those of this
    /// process unless every array of an announced geometry has dropped them.
    fn add_arrays(&mut self, count: usize) {
        let known: Vec<EmergencyStop> = self.stops().iter().map(ordered).collect();
        let own: &[EmergencyStop] = if self.has_geometry() { &[] } else { &self.orders };
        for array in 0..count.min(MAX_ARRAYS) {
            if !self.arrays.contains_key(&array) {
                let seen = self.arrays.entry(array).or_default();
                own.iter().for_each(|order| seen.hold.order(order.stamp.time_ns, order));
                known.iter().for_each(|order| seen.hold.order(0, order));
            }
        }
    }

    fn array(&mut self, now: Duration, array: usize) -> &mut ReportedArray {
        self.add_arrays(array + 1);
        let seen = self.arrays.entry(array).or_default();
        seen.first.get_or_insert(now);
        seen
    }

    /// Applies a report; whether it counts. A stop in it that was not known concerns all arrays.
    fn handle_reported(
        &mut self,
        now: Duration,
        array: usize,
        reported: &[LatchedStopReport],
        apply: impl FnOnce(&mut StopHold) -> bool,
    ) -> bool {
        self.array(now, array);
        let unknown = unknown_stops(reported, self.arrays.values().map(|seen| &seen.hold));
        let counts = apply(&mut self.array(now, array).hold);
        if counts {
            for stop in &unknown {
                self.arrays.values_mut().for_each(|seen| seen.hold.learn(stop));
            }
        }
        counts
    }

    /// Notes when stops became known, and which arrays have reported those of this process. A release ends the wait for
    /// the drivers that were lost.
    fn note_names(&mut self, now: Duration) {
        let arrays = &self.arrays;
        let is_held = |driver: Driver| arrays.iter().any(|(array, of)| serves(driver, *array) && of.hold.is_stopped());
        self.lost.retain(|driver| is_held(*driver));
        for seen in self.arrays.values_mut() {
            for name in self.orders.iter().map(EmergencyStop::name) {
                if seen.hold.has_reported(name) {
                    seen.reported.retain(|reported| !name.replaces(*reported));
                    seen.reported.push(name);
                }
            }
        }
        let names: BTreeSet<StopName> =
            self.arrays.values().flat_map(|seen| seen.hold.stops().iter().map(|held| held.name)).collect();
        self.known.retain(|name, _| names.contains(name));
        for name in names {
            self.known.entry(name).or_insert(now);
        }
    }
}

/// Whether a driver serves an array, by its token.
fn serves((of, _): Driver, array: usize) -> bool {
    of.is_none_or(|of| of == array)
}

/// The sources of those of these drivers that serve an array.
fn sources_of<'a>(drivers: impl IntoIterator<Item = &'a Driver>, array: usize) -> Vec<u64> {
    drivers.into_iter().filter(|driver| serves(**driver, array)).map(|(_, source)| *source).collect()
}

/// The order of a stop that is known from reports.
fn ordered(stop: &RoomStop) -> EmergencyStop {
    let stamp = Stamp { source: stop.name.source, sequence: stop.name.sequence, time_ns: 0 };
    let (operator, reason) = (stop.operator.clone(), cut(&stop.reason).to_owned());
    EmergencyStop { stamp, operator, reason, ..EmergencyStop::default() }
}

#[cfg(test)]
mod tests;
