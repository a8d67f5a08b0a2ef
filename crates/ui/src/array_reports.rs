//! The latest telemetry of each array of a room, and of all arrays together.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use heliostat_channel::MirrorArrays;
use heliostat_proto::messages::fault;
use heliostat_proto::{ArrayState, Counters, MirrorTelemetry};

use crate::expiry::EXPIRY;

/// An array is commanded this long after telemetry that shows further accepted commands. This is shorter than
/// [`EXPIRY`] by the interval of a status at least: the status of a controller that has left stays fresh for longer.
const COMMANDED: Duration = Duration::from_secs(1);

/// The latest telemetry of each array, by its index, with the arrival times.
#[derive(Debug, Default)]
pub(crate) struct ArrayReports {
    latest: BTreeMap<usize, (Instant, MirrorTelemetry)>,
    /// The sources that reported each array lately, with their last report.
    sources: BTreeMap<usize, BTreeMap<u64, (Instant, ArrayState)>>,
    /// The two sources of an array that report in turn, and when this was seen last.
    shared: BTreeMap<usize, (Instant, [u64; 2])>,
    /// When the first telemetry of the room arrived.
    first_at: Option<Instant>,
    /// The last series of accepted commands.
    commands: Option<Commands>,
}

/// A series of accepted commands without a pause of [`COMMANDED`].
#[derive(Clone, Copy, Debug)]
struct Commands {
    /// When it began; `None` where it was under way when the first telemetry arrived.
    began: Option<Instant>,
    /// When telemetry last showed further ones.
    last: Instant,
}

impl ArrayReports {
    /// Keeps telemetry that arrives now. Of an array that two sources report, the state is the more serious
    /// one: it does not alternate, and a driver that is stopped is not hidden by one that moves its mirrors.
    pub fn note(&mut self, array: usize, mut telemetry: MirrorTelemetry) {
        let (now, source) = (Instant::now(), telemetry.stamp.source);
        let first = *self.first_at.get_or_insert(now);
        let sources = self.sources.entry(array).or_default();
        sources.retain(|_, (at, _)| at.elapsed() < EXPIRY);
        let is_known = sources.insert(source, (now, telemetry.state)).is_some();
        let before = self.latest.get(&array).map(|(_, last)| last.stamp.source).filter(|before| *before != source);
        // A driver that replaces another one reports after it. Of two drivers, the former reports again.
        if let Some(before) = before.filter(|_| is_known) {
            self.shared.insert(array, (now, [source.min(before), source.max(before)]));
        }
        if self.shared.get(&array).is_some_and(|(at, _)| at.elapsed() < EXPIRY) {
            let states = sources.values().map(|(_, state)| *state);
            telemetry.state = states.max_by_key(|state| severity(*state)).unwrap_or(telemetry.state);
        }
        let accepted = telemetry.counters.accepted;
        let last = self.latest.insert(array, (now, telemetry)).filter(|(_, last)| last.stamp.source == source);
        if last.is_some_and(|(_, last)| last.counters.accepted < accepted) {
            let began = match self.present_commands() {
                Some(commands) => commands.began,
                None => (now - first > COMMANDED).then_some(now),
            };
            self.commands = Some(Commands { began, last: now });
        }
    }

    /// Whether an array accepts commands.
    pub fn are_commanded(&self) -> bool {
        self.present_commands().is_some()
    }

    /// Whether an array has begun to accept commands so lately that this viewer may not yet be connected to the
    /// process that sends them.
    pub fn are_newly_commanded(&self) -> bool {
        let began = self.present_commands().and_then(|commands| commands.began);
        began.is_some_and(|at| at.elapsed() < EXPIRY)
    }

    fn present_commands(&self) -> Option<Commands> {
        self.commands.filter(|commands| commands.last.elapsed() < COMMANDED)
    }

    /// The arrays that two sources report at present, with these sources.
    pub fn shared(&self) -> Vec<(usize, [u64; 2])> {
        let fresh = self.shared.iter().filter(|(_, (at, _))| at.elapsed() < EXPIRY);
        fresh.map(|(array, (_, sources))| (*array, *sources)).collect()
    }

    /// State and arrival of the telemetry of each array that is not old.
    pub fn states(&self) -> Vec<(Instant, ArrayState)> {
        self.fresh().map(|(_, (at, telemetry))| (*at, telemetry.state)).collect()
    }

    /// The most serious state of the arrays whose telemetry is not old, in the order of [`joint`](Self::joint).
    pub fn state(&self) -> Option<ArrayState> {
        self.fresh().map(|(_, (_, telemetry))| telemetry.state).max_by_key(|state| severity(*state))
    }

    /// The epoch of the commands that the first array follows, where its telemetry is not old.
    pub fn followed_epoch(&self) -> Option<u64> {
        self.fresh().find(|(array, _)| **array == 0).map(|(_, (_, telemetry))| telemetry.epoch)
    }

    /// Arrival of the oldest telemetry that is not old, else of the newest.
    pub fn at(&self) -> Option<Instant> {
        self.fresh().map(|(_, (at, _))| *at).min().or_else(|| self.latest.values().map(|(at, _)| *at).max())
    }

    /// The arrays without telemetry that is not old, in a room of so many arrays.
    pub fn silent(&self, arrays: usize) -> Vec<usize> {
        let fresh: Vec<usize> = self.fresh().map(|(array, _)| *array).collect();
        (0..arrays).filter(|array| !fresh.contains(array)).collect()
    }

    /// The arrays that report that a device does not answer, by telemetry that is not old.
    pub fn lost_devices(&self) -> Vec<usize> {
        let is_lost = |(_, telemetry): &(Instant, MirrorTelemetry)| telemetry.faults & fault::LINK != 0;
        self.fresh().filter(|(_, report)| is_lost(report)).map(|(array, _)| *array).collect()
    }

    /// Telemetry of a room with these arrays, with the mirrors of all in index order; `None` where
    /// all telemetry is old.
    ///
    /// Mirrors of an array without telemetry are flat. The state is the first in the order fault,
    /// stopped, parked, holding, following that any array has. Counters are sums.
    pub fn joint(&self, arrays: &MirrorArrays) -> Option<MirrorTelemetry> {
        join(arrays, &self.fresh().map(|(array, (_, telemetry))| (*array, telemetry)).collect())
    }

    /// The same with the last telemetry of each array, of any age.
    pub fn last_joint(&self, arrays: &MirrorArrays) -> Option<MirrorTelemetry> {
        join(arrays, &self.latest.iter().map(|(array, (_, telemetry))| (*array, telemetry)).collect())
    }

    /// Lets the telemetry arrive that much earlier.
    #[cfg(test)]
    pub fn age(&mut self, by: Duration) {
        self.latest.values_mut().for_each(|(at, _)| *at -= by);
        self.first_at.iter_mut().for_each(|at| *at -= by);
        if let Some(commands) = &mut self.commands {
            commands.last -= by;
            commands.began.iter_mut().for_each(|at| *at -= by);
        }
    }

    fn fresh(&self) -> impl Iterator<Item = (&usize, &(Instant, MirrorTelemetry))> {
        self.latest.iter().filter(|(_, (at, _))| at.elapsed() < EXPIRY)
    }
}

fn join(arrays: &MirrorArrays, reports: &BTreeMap<usize, &MirrorTelemetry>) -> Option<MirrorTelemetry> {
    if arrays.arrays().len() == 1 {
        // Telemetry of another shape is shown too, for its state and its faults.
        return reports.get(&0).map(|telemetry| (*telemetry).clone());
    }
    let mut joint =
        reports.values().next().map(|first| MirrorTelemetry { stamp: first.stamp, ..Default::default() })?;
    joint.state = reports.values().map(|telemetry| telemetry.state).max_by_key(|state| severity(*state))?;
    for (index, (array, mirrors)) in arrays.ranges().enumerate() {
        let telemetry = reports.get(&index).filter(|telemetry| telemetry.check_mirrors(array.len()).is_ok());
        let axes = |commanded: fn(&MirrorTelemetry) -> [&Vec<f32>; 2]| {
            let given = telemetry.and_then(|telemetry| commanded(telemetry).into_iter().find(|axis| !axis.is_empty()));
            given.cloned().unwrap_or_else(|| vec![0.0; mirrors.len()])
        };
        joint.roll_commanded.extend(axes(|telemetry| [&telemetry.roll_commanded, &telemetry.roll_commanded]));
        joint.yaw_commanded.extend(axes(|telemetry| [&telemetry.yaw_commanded, &telemetry.yaw_commanded]));
        joint.roll_measured.extend(axes(|telemetry| [&telemetry.roll_measured, &telemetry.roll_commanded]));
        joint.yaw_measured.extend(axes(|telemetry| [&telemetry.yaw_measured, &telemetry.yaw_commanded]));
        let Some(telemetry) = telemetry else { continue };
        joint.faults |= telemetry.faults;
        joint.counters = sum(&joint.counters, &telemetry.counters);
        joint.unusable.extend(telemetry.unusable.iter().map(|mirror| mirrors.start as u32 + mirror));
    }
    Some(joint)
}

fn severity(state: ArrayState) -> u8 {
    match state {
        ArrayState::Following => 0,
        ArrayState::Holding => 1,
        ArrayState::Parked => 2,
        ArrayState::Stopped => 3,
        ArrayState::Fault => 4,
    }
}

fn sum(one: &Counters, other: &Counters) -> Counters {
    Counters {
        accepted: one.accepted + other.accepted,
        clipped: one.clipped + other.clipped,
        late: one.late + other.late,
        rejected: one.rejected + other.rejected,
        old_epoch: one.old_epoch + other.old_epoch,
        old_sequence: one.old_sequence + other.old_sequence,
        expired: one.expired + other.expired,
        stopped: one.stopped + other.stopped,
    }
}

#[cfg(test)]
mod tests {
    use heliostat_scenario::Scenario;

    use super::*;

    fn telemetry(state: ArrayState, mirrors: usize, roll: f32) -> MirrorTelemetry {
        let (roll_commanded, yaw_commanded) = (vec![roll; mirrors], vec![0.0; mirrors]);
        let counters = Counters { accepted: 5, ..Counters::default() };
        MirrorTelemetry { state, roll_commanded, yaw_commanded, counters, unusable: vec![1], ..Default::default() }
    }

    #[test]
    fn the_mirrors_of_all_arrays_have_the_index_of_the_room() {
        let text = "[[mirrors]]\nrows = 1\ncolumns = 2\n[[mirrors]]\nrows = 1\ncolumns = 3\nwall = \"-x\"\n";
        let model = Scenario::from_toml(text).expect("valid").channel_model().expect("a model");
        let mut reports = ArrayReports::default();
        assert_eq!(reports.joint(&model.mirrors), None);
        assert_eq!(reports.silent(2), [0, 1]);
        reports.note(1, telemetry(ArrayState::Stopped, 3, 0.5));
        let joint = reports.joint(&model.mirrors).expect("telemetry of the second array");
        assert_eq!((joint.roll_commanded, joint.unusable), (vec![0.0, 0.0, 0.5, 0.5, 0.5], vec![3]));
        assert_eq!(reports.silent(2), [0], "a viewer says so");
        reports.note(0, telemetry(ArrayState::Following, 2, 0.25));
        let joint = reports.joint(&model.mirrors).expect("telemetry of both");
        assert_eq!((joint.roll_measured, joint.unusable), (vec![0.25, 0.25, 0.5, 0.5, 0.5], vec![1, 3]));
        assert!(reports.silent(2).is_empty());
        assert_eq!((joint.state, joint.counters.accepted), (ArrayState::Stopped, 10));
    }

    #[test]
    fn the_state_of_an_array_with_two_drivers_is_the_more_serious_one() {
        use ArrayState::{Following, Stopped};
        let from = |source, state| {
            let mut telemetry = telemetry(state, 2, 0.0);
            telemetry.stamp.source = source;
            telemetry
        };
        let mut reports = ArrayReports::default();
        let mut states = Vec::new();
        for (source, state) in [(7, Stopped), (8, Following), (7, Stopped), (8, Following), (8, Following)] {
            reports.note(0, from(source, state));
            states.extend(reports.states().iter().map(|(_, state)| *state));
        }
        assert_eq!(states, [Stopped, Following, Stopped, Stopped, Stopped]);
        assert_eq!(reports.shared(), [(0, [7, 8])]);
    }

    #[test]
    fn an_array_whose_device_does_not_answer_is_named_until_it_reports_otherwise() {
        let mut reports = ArrayReports::default();
        let with = |faults| MirrorTelemetry { faults, ..telemetry(ArrayState::Stopped, 2, 0.0) };
        reports.note(0, with(fault::MIRROR));
        reports.note(1, with(fault::LINK | fault::STOP));
        assert_eq!(reports.lost_devices(), [1]);
        reports.note(1, with(0));
        assert_eq!(reports.lost_devices(), [0; 0]);
    }
}
