//! `heliostat calibrate apply`: brings a calibration file to the running driver of an array.

use std::collections::BTreeSet;
use std::fmt;
use std::sync::mpsc::{self, Receiver};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, anyhow, bail};
use heliostat_array::calibration::check_corrections;
use heliostat_array::calibration_file::CalibrationFile;
use heliostat_bus::arriving::{arriving, fetch};
use heliostat_bus::{AccessRole, Bus, Class, Subscription};
use heliostat_driver::calibration_store;
use heliostat_proto::gauges::CalibrationProgress;
use heliostat_proto::keys::parse_alive;
use heliostat_proto::messages::fault;
use heliostat_proto::{Capabilities, MirrorTelemetry, NodeKind, NodeStatus, Stamp, decode, encode};
use heliostat_service::clock::utc_ns;
use heliostat_service::exit::UnusableInput;
use heliostat_service::printable::printable;
use heliostat_service::{outln, source_id};
use heliostat_ui::find_absent_room;
use serde_json::json;

use super::args::ApplyArgs;
use super::room::{OTHER_GAP_MAX, WAIT, wait};
use crate::commands::join::join;

/// Number of the steps from the sequence in use to the next one.
const STEPS: u64 = 1024;

/// What an error adds where no message left this process.
const NOTHING_SENT: &str = "Nothing was sent";

/// Runs the command.
///
/// # Errors
/// [`UnusableInput`]: a file that is no calibration, or one of another array. A room without a driver, and a
/// calibration that telemetry does not show.
pub fn run(args: &ApplyArgs) -> Result<()> {
    let file = read(args).context(UnusableInput::new("this calibration cannot be applied"))?;
    let config = args.bus.config_or_connect(&[AccessRole::Calibrator])?;
    let bus = join(&config, WAIT).map_err(|reason| {
        let advised = format!("{NOTHING_SENT}: give --connect the endpoint of the driver or of its router");
        anyhow!(reason.with_either(NOTHING_SENT, &advised))
    })?;
    let (order, took) = apply(args, &bus, &file)?;
    show(args, &bus, &order, took)?;
    Ok(bus.close()?)
}

/// The file, if any driver accepts its corrections.
fn read(args: &ApplyArgs) -> Result<CalibrationFile> {
    let file = calibration_store::load(&args.file)?;
    check_corrections(&file.message(Stamp::default())).with_context(|| format!("in {}", args.file.display()))?;
    Ok(file)
}

/// Publishes the calibration once, and waits until telemetry shows it; returns how long that took.
fn apply(args: &ApplyArgs, bus: &Bus, file: &CalibrationFile) -> Result<(Order, Duration)> {
    let (room, keys) = (bus.room(), bus.room().array(args.array));
    let reports = Reports::subscribe(bus, args.array)?;
    let capabilities: Capabilities = fetch(bus, &keys.capabilities(), WAIT)?.with_context(|| {
        let absent = find_absent_room([bus]).map_or_else(String::new, |absent| format!(": {absent}"));
        format!(
            "no driver of array {} answers in room \"{room}\". {NOTHING_SENT}: give --connect its endpoint or that of \
             its router, and check --room and --array{absent}",
            args.array
        )
    })?;
    file.check_array(&capabilities)
        .with_context(|| format!("in {}", args.file.display()))
        .context(UnusableInput::new(format!("this calibration does not fit array {}", args.array)))?;
    refuse_during_calibration(bus)?;
    let publisher = bus.publisher(&keys.calibration(), Class::RealTimeBlock)?;
    let has_driver = wait(|| publisher.has_subscribers().unwrap_or_default().then_some(()));
    has_driver
        .with_context(|| format!("no driver subscribes to {}. {NOTHING_SENT}: check its log", keys.calibration()))?;
    let before = reports.next_telemetry().with_context(|| {
        format!("the array publishes no telemetry: expected ten messages a second. {NOTHING_SENT}: check its driver")
    })?;
    let source = source_id::random();
    let order = Order::after(&before, source);
    let stamp = Stamp { source, sequence: order.sequence, time_ns: utc_ns() };
    let mut payload = Vec::new();
    encode(&file.message(stamp), &mut payload)?;
    let published = Instant::now();
    publisher.put(&payload)?;
    confirm(&reports, &order)?;
    Ok((order, published.elapsed()))
}

/// Refuses while a calibration commands the room: its readings hold for the calibration in use alone.
fn refuse_during_calibration(bus: &Bus) -> Result<()> {
    let room = bus.room();
    let (statuses, subscription) = arriving(bus, &room.status(NodeKind::Controller))?;
    let tokens = bus.alive(&room.alive_of(NodeKind::Controller), WAIT)?;
    let silent = tokens.iter().filter_map(|key| parse_alive(key)).map(|(_, source)| source).collect();
    let running = running_calibration(&statuses, silent, Instant::now() + OTHER_GAP_MAX);
    drop(subscription);
    match running {
        Some(running) => bail!(
            "a calibration commands room \"{room}\", {running}: its readings hold for the calibration in use alone. \
             {NOTHING_SENT}: let it end, or end it, then repeat the command"
        ),
        None => Ok(()),
    }
}

/// The name and the progress of the calibration among these controllers; waits for a status of each, until this time
/// at most.
fn running_calibration(statuses: &Receiver<NodeStatus>, mut silent: BTreeSet<u64>, until: Instant) -> Option<String> {
    while !silent.is_empty() {
        let status = statuses.recv_timeout(until.saturating_duration_since(Instant::now())).ok()?;
        if silent.remove(&status.stamp.source)
            && let Some(progress) = CalibrationProgress::of(&status)
        {
            return Some(format!("{} ({progress})", printable(&status.name)));
        }
    }
    None
}

/// Waits until telemetry shows the calibration in use; else says what it shows.
fn confirm(reports: &Reports, order: &Order) -> Result<()> {
    let until = Instant::now() + WAIT;
    let (mut refusal, mut other) = (None, None);
    let outcome = reports.wait(until, |report| {
        refusal = report.refusal(order.driver).or_else(|| refusal.take());
        let Report::Telemetry(now) = report else { return None };
        match order.judge(&now) {
            // It may have come just before this one, which the next telemetry then shows.
            shown @ Some(Outcome::Other(_)) => {
                other = shown;
                None
            }
            shown => shown,
        }
    });
    let outcome = outcome.or(other);
    let kept = Number(order.former);
    let named = |refusal: Option<String>| refusal.unwrap_or_else(|| "its log says why".to_owned());
    match outcome {
        Some(Outcome::InUse) => Ok(()),
        Some(Outcome::Refused) => {
            // A status before the telemetry may name an earlier refusal.
            let refusal = reports.wait(until, |report| report.refusal(order.driver));
            bail!("the driver has refused the calibration, and keeps {kept}: {}", named(refusal))
        }
        Some(Outcome::Other(other)) => bail!(
            "the array uses {} of another sender instead of this one, {}: agree on one, then repeat the command",
            Number(other),
            Number(order.sequence)
        ),
        Some(Outcome::OtherDriver) => bail!(
            "another driver process reports the array: it was restarted meanwhile, or there are two of them. \
             `heliostat status` names them; with one driver, repeat the command"
        ),
        None if order.was_refused => bail!(
            "the array still uses {kept} after {} s, and shows a refused calibration, as before this one: {}",
            WAIT.as_secs(),
            named(refusal)
        ),
        None => bail!(
            "the array still uses {kept} after {} s: the calibration did not arrive, or the driver is busy. A room with \
             keys accepts it from the role calibrator only; a router needs these rights too",
            WAIT.as_secs()
        ),
    }
}

fn show(args: &ApplyArgs, bus: &Bus, order: &Order, took: Duration) -> Result<()> {
    let file = args.file.display().to_string();
    if args.json {
        let result = json!({
            "room": bus.room().name(),
            "array": args.array,
            "file": file,
            "calibration": order.sequence,
            "former": order.former,
            "confirmed_after_ms": took.as_secs_f64() * 1e3,
        });
        outln!("{result}")?;
        return Ok(());
    }
    let [used, former] = [order.sequence, order.former].map(Number);
    outln!("in use         {file} as {used}, in place of {former}")?;
    outln!("driver         it forgets this when it ends: start it with --calibration {file} from now on")?;
    outln!(
        "controller     start it again with the measured room of the same calibration: --scenario and its --room-out"
    )?;
    Ok(())
}

/// The number of a calibration in telemetry, in words.
struct Number(u64);

impl fmt::Display for Number {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0 {
            0 => f.write_str("no calibration"),
            sequence => write!(f, "calibration {sequence}"),
        }
    }
}

/// A calibration that is published once, and what the array reported before it.
struct Order {
    /// Source of the telemetry.
    driver: u64,
    /// Sequence of the calibration in use before; 0 for none.
    former: u64,
    sequence: u64,
    /// Whether the array had refused a calibration: telemetry then shows no further refusal.
    was_refused: bool,
}

/// What telemetry shows of a calibration that was published.
#[derive(Debug, PartialEq)]
enum Outcome {
    InUse,
    /// The former one stays in use.
    Refused,
    /// One of another sender is in use, with this sequence.
    Other(u64),
    /// Another process reports the array.
    OtherDriver,
}

impl Order {
    /// The next calibration of an array.
    ///
    /// Telemetry names the sequence of the calibration in use, and not its source. A sequence above the former
    /// one, from any source, is recognised there, and no driver refuses it. Its step depends on the source, so that
    /// two senders at the same moment have different sequences.
    fn after(before: &MirrorTelemetry, source: u64) -> Self {
        let step = 1 + source % STEPS;
        Self {
            driver: before.stamp.source,
            former: before.calibration,
            // Each order has a source of its own, so it may begin again after the last number.
            sequence: before.calibration.checked_add(step).unwrap_or(step),
            was_refused: is_refused(before),
        }
    }

    /// What a later telemetry message shows; `None` as long as it shows nothing new.
    fn judge(&self, now: &MirrorTelemetry) -> Option<Outcome> {
        if now.stamp.source != self.driver {
            Some(Outcome::OtherDriver)
        } else if now.calibration == self.sequence {
            Some(Outcome::InUse)
        } else if now.calibration != self.former {
            Some(Outcome::Other(now.calibration))
        } else {
            (is_refused(now) && !self.was_refused).then_some(Outcome::Refused)
        }
    }
}

fn is_refused(telemetry: &MirrorTelemetry) -> bool {
    telemetry.faults & fault::CALIBRATION != 0
}

/// What arrives from the process that drives the array.
enum Report {
    Telemetry(Box<MirrorTelemetry>),
    /// The last problem of a status, and the source of both.
    Problem {
        source: u64,
        problem: String,
    },
}

impl Report {
    /// Why this driver has refused a calibration, if this is its status and names that.
    fn refusal(&self, driver: u64) -> Option<String> {
        match self {
            Self::Problem { source, problem } if *source == driver => {
                problem.strip_prefix("calibration: ").map(str::to_owned)
            }
            _ => None,
        }
    }
}

/// The reports of an array and of its driver, in the order of their arrival.
struct Reports {
    queue: Receiver<Report>,
    _subscriptions: Vec<Subscription>,
}

impl Reports {
    fn subscribe(bus: &Bus, array: usize) -> Result<Self> {
        let keys = bus.room().array(array);
        let (sender, queue) = mpsc::channel();
        let telemetry = sender.clone();
        let mut subscriptions = vec![bus.subscribe(&keys.telemetry(), move |payload| {
            if let Ok(shown) = decode(payload) {
                // The queue is gone when the command ends.
                drop(telemetry.send(Report::Telemetry(Box::new(shown))));
            }
        })?];
        for key in [keys.driver_status(), bus.room().status(NodeKind::SimNode)] {
            let problems = sender.clone();
            subscriptions.push(bus.subscribe(&key, move |payload| {
                if let Ok(NodeStatus { stamp, last_problem, .. }) = decode(payload) {
                    drop(problems.send(Report::Problem { source: stamp.source, problem: last_problem }));
                }
            })?);
        }
        Ok(Self { queue, _subscriptions: subscriptions })
    }

    /// What a report gives first, until this time at most.
    fn wait<T>(&self, until: Instant, mut find: impl FnMut(Report) -> Option<T>) -> Option<T> {
        loop {
            let report = self.queue.recv_timeout(until.saturating_duration_since(Instant::now())).ok()?;
            if let Some(found) = find(report) {
                return Some(found);
            }
        }
    }

    /// The first telemetry that arrives from now on.
    fn next_telemetry(&self) -> Option<MirrorTelemetry> {
        self.queue.try_iter().for_each(drop);
        self.wait(Instant::now() + WAIT, |report| match report {
            Report::Telemetry(shown) => Some(*shown),
            Report::Problem { .. } => None,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn telemetry(source: u64, calibration: u64, faults: u32) -> MirrorTelemetry {
        let stamp = Stamp { source, ..Stamp::default() };
        MirrorTelemetry { stamp, calibration, faults, ..MirrorTelemetry::default() }
    }

    #[test]
    fn a_calibration_has_a_number_above_the_one_in_use_and_begins_again_after_the_last() {
        let sequence = |in_use: u64| Order::after(&telemetry(7, in_use, 0), STEPS).sequence;
        assert_eq!([0, 1, u64::MAX - 1, u64::MAX].map(sequence), [1, 2, u64::MAX, 1]);
    }

    #[test]
    fn the_one_of_two_senders_at_the_same_moment_that_is_not_in_use_is_told() {
        let shown = telemetry(7, 4, 0);
        let [first, second] = [1, 2].map(|source| Order::after(&shown, source));
        assert_eq!(first.judge(&telemetry(7, second.sequence, 0)), Some(Outcome::Other(second.sequence)));
        assert_eq!(second.judge(&telemetry(7, second.sequence, 0)), Some(Outcome::InUse));
    }

    #[test]
    fn telemetry_shows_a_calibration_in_use_a_refusal_or_the_order_of_another_sender() {
        let order = Order::after(&telemetry(7, 4, fault::LINK), 0);
        let judge = |source, calibration, faults| order.judge(&telemetry(source, calibration, faults));
        assert_eq!(judge(7, 4, fault::LINK), None, "nothing new");
        assert_eq!(judge(7, 5, 0), Some(Outcome::InUse));
        assert_eq!(judge(7, 5, fault::CALIBRATION), Some(Outcome::InUse), "a later one of another sender was refused");
        assert_eq!(judge(7, 4, fault::CALIBRATION), Some(Outcome::Refused));
        assert_eq!(judge(7, 9, 0), Some(Outcome::Other(9)));
        assert_eq!(judge(8, 5, 0), Some(Outcome::OtherDriver));
        assert_eq!(judge(8, 0, 0), Some(Outcome::OtherDriver), "a driver that starts again forgets it");
    }

    #[test]
    fn a_calibration_among_the_controllers_of_the_room_is_named_with_its_progress() {
        let until = Instant::now() + WAIT;
        let progress = CalibrationProgress { place: 1, places: 4, ..CalibrationProgress::default() };
        let running = |sources: &[u64], silent: &[u64]| {
            let (sender, statuses) = mpsc::channel();
            for source in sources {
                let gauges = match source {
                    8 => progress.gauges().map(|(name, value)| (name.to_owned(), value)).to_vec(),
                    _ => Vec::new(),
                };
                let (stamp, name) = (Stamp { source: *source, ..Stamp::default() }, format!("name-{source}"));
                sender.send(NodeStatus { stamp, name, gauges, ..NodeStatus::default() }).expect("a queue");
            }
            // No further status comes.
            drop(sender);
            running_calibration(&statuses, silent.iter().copied().collect(), until)
        };
        assert_eq!(running(&[7, 7, 8], &[7, 8]), Some(format!("name-8 ({progress})")));
        assert_eq!(running(&[7], &[7]), None, "a controller");
        assert_eq!(running(&[7, 8], &[7]), None, "its token has ended: it has ended");
        assert_eq!(running(&[], &[7]), None, "one that does not report");
    }

    #[test]
    fn a_refusal_of_before_is_none_of_this_calibration() {
        let order = Order::after(&telemetry(7, 4, fault::CALIBRATION), 0);
        assert_eq!(order.judge(&telemetry(7, 4, fault::CALIBRATION)), None);
        assert_eq!(order.judge(&telemetry(7, 5, 0)), Some(Outcome::InUse));
    }

    #[test]
    fn a_calibration_that_comes_just_after_the_one_of_another_sender_is_in_use() {
        let order = Order::after(&telemetry(7, 4, 0), 0);
        let confirmed = |shown: &[u64]| {
            let (sender, queue) = mpsc::channel();
            for calibration in shown {
                let report = Report::Telemetry(Box::new(telemetry(7, *calibration, 0)));
                sender.send(report).expect("a queue");
            }
            // No further report comes.
            drop(sender);
            confirm(&Reports { queue, _subscriptions: Vec::new() }, &order).map_err(|error| error.to_string())
        };
        assert_eq!(confirmed(&[4, 9, 9, 5]), Ok(()));
        let ended = confirmed(&[4, 9]).expect_err("the other one stays in use");
        assert!(ended.starts_with("the array uses calibration 9 of another sender"), "{ended}");
    }

    #[test]
    fn the_last_refusal_that_came_while_telemetry_was_awaited_is_named_without_a_further_wait() {
        let order = Order::after(&telemetry(7, 4, fault::CALIBRATION), 0);
        let (sender, queue) = mpsc::channel();
        for (source, problem) in
            [(7, "calibration: first"), (7, "calibration: last"), (7, "command: late"), (8, "calibration: of another")]
        {
            sender.send(Report::Problem { source, problem: problem.to_owned() }).expect("a queue");
        }
        sender.send(Report::Telemetry(Box::new(telemetry(7, 4, fault::CALIBRATION)))).expect("a queue");
        // No further report comes.
        drop(sender);
        let ended = confirm(&Reports { queue, _subscriptions: Vec::new() }, &order).expect_err("refused").to_string();
        assert!(ended.ends_with(", as before this one: last"), "{ended}");
    }
}
