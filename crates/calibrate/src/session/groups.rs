//! Coded groups in a session: which mirrors are lit together, and what a complete group says.
//!
//! Groups are used at a spot where the light of single mirrors is weak. A group is read pattern by pattern. A
//! pattern whose report was lost is repeated. If a body was in the path, the whole group is read again.

use heliostat_channel::{MirrorAngles, Vec3};
use heliostat_proto::Nanos;

use super::Session;
use super::timing::Purpose;
use crate::code;
use crate::probes::{self, State};
use crate::signal::Signal;
use crate::stand::median;

/// A mirror and its commanded angles in rad.
pub(super) type Probe = (usize, [f64; 2]);

/// A pattern of a group.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Pattern {
    Due,
    Sent,
    Read(f64),
}

/// Mirrors that are lit together.
#[derive(Clone, Debug)]
struct Group {
    number: u32,
    /// At most one for each pattern; a slot without a mirror is dark.
    members: Vec<Probe>,
    patterns: Vec<Pattern>,
}

/// The groups whose readings are not complete.
#[derive(Clone, Debug, Default)]
pub(super) struct Groups {
    open: Vec<Group>,
    /// Number of the next group.
    next: u32,
}

impl Groups {
    /// Begins a group of this size.
    fn begin(&mut self, members: Vec<Probe>, size: usize) {
        self.open.push(Group { number: self.next, members, patterns: vec![Pattern::Due; size] });
        self.next += 1;
    }

    /// The next pattern to command.
    fn next_due(&mut self) -> Option<Purpose> {
        self.open.iter_mut().find_map(|group| {
            let pattern = group.patterns.iter().position(|pattern| *pattern == Pattern::Due)?;
            group.patterns[pattern] = Pattern::Sent;
            Some(Purpose::Group(group.number, pattern))
        })
    }

    /// The mirrors that a pattern lights.
    fn lit(&self, number: u32, pattern: usize) -> impl Iterator<Item = Probe> {
        let members = self.open.iter().find(|group| group.number == number).map(|group| group.members.as_slice());
        let slots = members.unwrap_or_default().iter().enumerate();
        slots.filter(move |(slot, _)| code::is_lit(pattern, *slot)).map(|(_, member)| *member)
    }

    /// Takes a reading of a pattern; after the last one the group ends with the light of each of its mirrors.
    fn handle_reading(&mut self, number: u32, pattern: usize, gain: f64) -> Option<Vec<(Probe, f64)>> {
        let index = self.open.iter().position(|group| group.number == number)?;
        let patterns = &mut self.open[index].patterns;
        if !matches!(patterns[pattern], Pattern::Read(_)) {
            patterns[pattern] = Pattern::Read(gain);
        }
        let read = |pattern: &Pattern| if let Pattern::Read(gain) = pattern { Some(*gain) } else { None };
        let readings: Vec<f64> = patterns.iter().map(read).collect::<Option<_>>()?;
        let members = self.open.remove(index).members;
        Some(members.into_iter().zip(code::decoded(&readings)).collect())
    }

    /// The report of a pattern was lost: it is due again.
    fn handle_loss(&mut self, number: u32, pattern: usize) {
        if let Some(group) = self.open.iter_mut().find(|group| group.number == number)
            && group.patterns[pattern] == Pattern::Sent
        {
            group.patterns[pattern] = Pattern::Due;
        }
    }

    /// Drops a group: its mirrors, and how many of its patterns were read.
    fn reject(&mut self, number: u32) -> Option<(Vec<Probe>, u64)> {
        let index = self.open.iter().position(|group| group.number == number)?;
        let group = self.open.remove(index);
        let read = group.patterns.iter().filter(|pattern| matches!(pattern, Pattern::Read(_))).count();
        Some((group.members, read as u64))
    }

    /// Drops all groups.
    pub(super) fn clear(&mut self) {
        self.open.clear();
    }
}

impl Session {
    /// Mirrors of the coded groups that are lit at the present spot; 1 where single mirrors are.
    pub fn group(&self) -> usize {
        self.spots.last().map_or(1, |spot| spot.group)
    }

    /// The light of single mirrors at a place, compared with the receiver's own noise in the dark readings.
    fn own_signal(&self, place: usize) -> Option<Signal> {
        let spot = self.spots.last()?;
        let [x, y] = spot.tracked_m;
        let at = self.optics.array().room_from_wall(&Vec3::new(x, y, 0.0));
        Signal::weakest(&self.optics, std::iter::once((place, [at.x, at.y, spot.height_m])), self.own_noise())
    }

    /// Standard deviation of the receiver's own noise, by the dark readings.
    pub(super) fn own_noise(&self) -> f64 {
        dark_deviation(&self.dark_gains)
    }

    /// Chooses single mirrors or groups for the present spot, with the noise of their readings.
    pub(super) fn choose_group(&mut self, place: usize) {
        let Some(signal) = self.own_signal(place) else { return };
        let open = self.jobs.iter().filter(|job| job.state == State::Open).count();
        let Some(spot) = self.spots.last_mut() else { return };
        let group = signal.group(spot.noise_relative, open);
        if group > 1 {
            let grouped = signal.in_groups(group, spot.noise_relative);
            (spot.group, spot.noise_gain) = (group, grouped.gain / grouped.ratio);
        }
    }

    /// The next pattern, of a new group where no other is due. A group is not begun with few mirrors while others are
    /// to follow.
    pub(super) fn plan_group(&mut self) -> Option<Purpose> {
        if let Some(due) = self.groups.next_due() {
            return Some(due);
        }
        let size = self.group();
        let (free, pending) = probes::free_and_pending(&self.jobs);
        if free < size && pending > 0 {
            return None;
        }
        let members: Vec<Probe> = std::iter::from_fn(|| self.next_probe()).take(size).collect();
        if members.is_empty() {
            return None;
        }
        self.groups.begin(members, size);
        self.groups.next_due()
    }

    /// Turns the mirrors that a pattern lights to their angles.
    pub(super) fn light_group(&self, (number, pattern): (u32, usize), angles: &mut MirrorAngles) {
        for (mirror, command) in self.groups.lit(number, pattern) {
            (angles.roll[mirror], angles.yaw[mirror]) = command.into();
        }
    }

    /// A reading of a pattern, with the dark level.
    pub(super) fn handle_group(&mut self, time_ns: Nanos, place: usize, (number, pattern): (u32, usize), gain: f64) {
        let gain = gain - median(&self.dark_gains);
        let Some(decoded) = self.groups.handle_reading(number, pattern, gain) else { return };
        for (probe, gain) in decoded {
            self.handle_probe(time_ns, probe, gain);
        }
        self.after_probe(place);
    }

    /// The reading of a command is lost.
    pub(super) fn forget(&mut self, purpose: Purpose) {
        match purpose {
            Purpose::Probe(mirror, _) => self.release(mirror),
            Purpose::Group(number, pattern) => self.groups.handle_loss(number, pattern),
            Purpose::Dark | Purpose::Locate(..) | Purpose::Verify(_) => {}
        }
    }

    /// A body was in the path while a command was measured. Some of a group's earlier readings may be spoiled too,
    /// and one spoils all of its mirrors.
    pub(super) fn reject(&mut self, purpose: Purpose) {
        match purpose {
            Purpose::Group(number, _) => {
                let (members, read) = self.groups.reject(number).unwrap_or_default();
                self.unused += read;
                members.into_iter().for_each(|(mirror, _)| self.release(mirror));
            }
            _ => self.forget(purpose),
        }
    }

    /// A mirror awaits no reading any more.
    fn release(&mut self, mirror: usize) {
        if let Some(job) = self.jobs.get_mut(mirror) {
            job.is_pending = false;
        }
    }
}

/// Standard deviation of dark readings. A receiver that reports 0 for a negative gain shows its noise only above the
/// dark level: their median, or 0 where it cuts at least half of the readings off. In coarse steps none may be above
/// the median: the noise is then about 0.
fn dark_deviation(dark: &[f64]) -> f64 {
    let cut = dark.iter().filter(|gain| **gain == 0.0).count();
    let level = if 2 * cut >= dark.len() { 0.0 } else { median(dark) };
    let above: Vec<f64> = dark.iter().copied().filter(|gain| cut == 0 || *gain > level).collect();
    let (used, about) = if above.is_empty() { (dark, 0.0) } else { (above.as_slice(), level) };
    let squares: f64 = used.iter().map(|gain| (gain - about).powi(2)).sum();
    (squares / used.len().max(1) as f64).sqrt()
}

#[cfg(test)]
mod tests {
    use super::super::Stage;
    use super::super::test_room::Room;
    use super::*;

    #[test]
    fn the_noise_is_found_at_each_dark_level_although_negative_readings_are_cut_off() {
        // The quantiles of twelve readings of a normal distribution.
        let upper = [0.105_f64, 0.319, 0.549, 0.812, 1.150, 1.732];
        for level in [0.0_f64, 0.5, 1.4, 5.0] {
            let dark: Vec<f64> =
                upper.iter().flat_map(|of| [level - of, level + of]).map(|gain| gain.max(0.0)).collect();
            let found = dark_deviation(&dark);
            assert!((0.9..1.0).contains(&found), "{found} at the level {level}");
        }
        let coarse = dark_deviation(&[0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0]);
        assert!((0.5..1.0).contains(&coarse), "{coarse} of steps of 1");
        assert_eq!([dark_deviation(&[0.0; 6]), dark_deviation(&[])], [0.0; 2]);
    }

    #[test]
    fn weak_light_is_measured_in_groups_and_the_mirrors_are_found() {
        let mut room = Room::new(2.0);
        room.step_until(Session::is_estimate_due);
        assert_eq!(room.session.group(), 31);
        let readings = room.session.readings();
        let spot = &room.session.spots[0];
        assert!(spot.noise_gain < 0.5 * room.noise_gain, "{:e} of {:e}", spot.noise_gain, room.noise_gain);
        let mean = |values: &dyn Fn(&crate::fit::Reading) -> f64| {
            readings.iter().map(values).sum::<f64>() / readings.len() as f64
        };
        let error = |reading: &crate::fit::Reading| reading.gain - room.light(reading.mirror, reading.command);
        let deviation = mean(&|reading| error(reading).powi(2)).sqrt();
        assert!((deviation / spot.noise_gain - 1.0).abs() < 0.35, "{deviation:e} and {:e}", spot.noise_gain);
        assert!(mean(&error).abs() < 0.05 * room.peak, "a common error: {:e}", mean(&error));
        let is_found = |mirror: &usize| {
            let (found, _) = room.session.jobs[*mirror].grid.moments();
            (0..2).all(|axis| (found[axis] - room.offsets[*mirror][axis]).abs() < 0.4_f64.to_radians())
        };
        let found = (0..64).filter(is_found).count();
        assert!(found > 56, "{found} of 64 mirrors");
    }

    #[test]
    fn strong_light_is_measured_mirror_by_mirror() {
        for ratio in [f64::INFINITY, 20.0] {
            let mut room = Room::new(ratio);
            room.step_until(|session| matches!(session.stage(), Stage::Probe(_)));
            assert_eq!(room.session.group(), 1);
            room.step_until(|session| session.readings().len() > 20);
            assert_eq!(room.turned(), 1);
        }
    }

    #[test]
    fn a_body_in_the_path_rejects_the_whole_group_and_its_mirrors_are_probed_again() {
        let mut room = Room::new(1.0);
        room.step_until(|session| session.groups.open.iter().any(|group| read_of(group) == 12));
        assert_eq!((room.session.readings().len(), room.turned()), (0, 16));
        let before = (room.session.groups.open[0].number, room.session.unused);
        room.step(0.0);
        // The reading with the body, and those before it.
        assert_eq!((room.session.unused - before.1, room.session.readings().len()), (13, 0));
        assert!(room.session.groups.open.iter().all(|group| group.number != before.0));
        let pending = room.session.jobs.iter().filter(|job| job.is_pending).count();
        assert_eq!(pending, 31, "only those of the next group");
        room.step_until(|session| session.readings().len() >= 62);
        let probed = room.session.jobs.iter().filter(|job| job.readings > 0).count();
        assert!(probed >= 62, "{probed} mirrors");
    }

    fn read_of(group: &Group) -> usize {
        group.patterns.iter().filter(|pattern| matches!(pattern, Pattern::Read(_))).count()
    }

    #[test]
    fn a_lost_pattern_is_repeated_and_the_group_is_exact() {
        let members: Vec<Probe> = (0..6).map(|mirror| (mirror + 10, [0.1 * mirror as f64, 0.0])).collect();
        let mut groups = Groups::default();
        groups.begin(members.clone(), 7);
        let light =
            |groups: &Groups, pattern: usize| groups.lit(0, pattern).map(|(mirror, _)| mirror as f64).sum::<f64>();
        let sent: Vec<Purpose> = std::iter::from_fn(|| groups.next_due()).collect();
        assert_eq!(sent, (0..7).map(|pattern| Purpose::Group(0, pattern)).collect::<Vec<_>>());
        for pattern in [0, 1, 2, 4, 5, 6] {
            assert_eq!(groups.handle_reading(0, pattern, light(&groups, pattern)), None);
        }
        // A second report of a pattern, and the loss of one that was read, change nothing.
        assert_eq!(groups.handle_reading(0, 2, 1e3), None);
        groups.handle_loss(0, 2);
        assert_eq!(groups.next_due(), None);
        groups.handle_loss(0, 3);
        assert_eq!(groups.next_due(), Some(Purpose::Group(0, 3)));
        let decoded = groups.handle_reading(0, 3, light(&groups, 3)).expect("a complete group");
        for ((probe, gain), member) in decoded.iter().zip(&members) {
            assert_eq!(probe, member);
            assert!((gain - member.0 as f64).abs() < 1e-9, "{gain} of mirror {}", member.0);
        }
        assert_eq!((decoded.len(), groups.handle_reading(0, 3, 1.0)), (6, None));
    }
}
