//! The emergency stop of a driver whose boards fail: emulated boards on sockets, and the driver's own
//! loop in a room.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use heliostat_bus::{Bus, BusConfig, Class, Publisher, Subscription, free_loopback_endpoint};
use heliostat_driver::Kit;
use heliostat_driver::config::Config;
use heliostat_driver::run::{self, Settings};
use heliostat_driver::stop_record::StopRecordSettings;
use heliostat_proto::{
    ArrayState, EmergencyStop, Message, MirrorCommand, MirrorTelemetry, Room, Stamp, StopReport, decode, encode,
};
use heliostat_service::Stop;
use heliostat_service::clock::utc_ns;

use crate::until;

/// How a board answers.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Manner {
    Prompt,
    /// Each line after this time.
    Slow(Duration),
    /// It answers no line.
    Silent,
    /// It refuses each stop.
    RefusesStops,
    /// It prints without a question, and answers no line.
    Chatty,
}

/// The lines that a board received, in the order of their arrival.
type Log = Arc<Mutex<Vec<String>>>;

/// Starts a board of one mirror at an address.
fn board(listener: TcpListener, manner: Manner) -> Log {
    board_until(listener, manner, Arc::default())
}

/// The same; it closes each connection while the flag is set.
fn board_until(listener: TcpListener, manner: Manner, hangs_up: Arc<AtomicBool>) -> Log {
    let log = Log::default();
    let received = Arc::clone(&log);
    std::thread::spawn(move || {
        for stream in listener.incoming().map_while(Result::ok) {
            let (log, hangs_up, closed) = (Arc::clone(&received), Arc::clone(&hangs_up), stream.try_clone());
            // The driver may close the connection at any time.
            std::thread::spawn(move || drop(serve(stream, manner, &log)));
            std::thread::spawn(move || {
                while !hangs_up.load(Ordering::SeqCst) {
                    std::thread::sleep(Duration::from_millis(5));
                }
                drop(closed.map(|stream| stream.shutdown(std::net::Shutdown::Both)));
            });
        }
    });
    log
}

fn serve(mut stream: TcpStream, manner: Manner, log: &Log) -> std::io::Result<()> {
    stream.set_nodelay(true)?;
    let lines = BufReader::new(stream.try_clone()?);
    if manner == Manner::Chatty {
        let mut printed = stream.try_clone()?;
        std::thread::spawn(move || {
            while printed.write_all(b"....").is_ok() {
                std::thread::sleep(Duration::from_millis(4));
            }
        });
    }
    for line in lines.lines().map_while(Result::ok) {
        log.lock().unwrap().push(line.clone());
        let answer = match (line.split(' ').next(), manner) {
            (_, Manner::Silent | Manner::Chatty) => continue,
            (Some("hello"), _) => "heliostat 1 1 -523599 523599 0\n",
            (Some("stop"), Manner::RefusesStops) => "error busy\n",
            _ => "ok\n",
        };
        if let Manner::Slow(delay) = manner {
            std::thread::sleep(delay);
        }
        stream.write_all(answer.as_bytes())?;
    }
    // Keeps the connection open until the driver closes it.
    stream.read(&mut [0]).map(drop)
}

fn listener() -> (TcpListener, String) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    (listener, address)
}

/// What the driver published last, and the number of telemetry messages.
#[derive(Clone, Default)]
struct Reports {
    telemetry: Option<MirrorTelemetry>,
    count: u64,
    stops: Option<StopReport>,
}

/// A controller and an operator of a room.
struct Observer {
    reports: Arc<Mutex<Reports>>,
    commands: Publisher,
    stops: Publisher,
    sequence: u64,
    _bus: Bus,
    _subscriptions: [Subscription; 2],
}

impl Observer {
    fn join(config: &BusConfig) -> Self {
        let bus = Bus::open(config).unwrap();
        let reports: Arc<Mutex<Reports>> = Arc::default();
        let (of_telemetry, of_stops) = (Arc::clone(&reports), Arc::clone(&reports));
        let subscriptions = [
            bus.subscribe(&bus.room().telemetry(), move |payload| {
                let mut reports = of_telemetry.lock().unwrap();
                (reports.telemetry, reports.count) = (decode(payload).ok(), reports.count + 1);
            }),
            bus.subscribe(&bus.room().stops(), move |payload| of_stops.lock().unwrap().stops = decode(payload).ok()),
        ];
        Self {
            reports,
            commands: bus.publisher(&bus.room().command(), Class::RealTimeBlock).unwrap(),
            stops: bus.publisher(&bus.room().stop(), Class::RealTimeBlock).unwrap(),
            sequence: 0,
            _subscriptions: subscriptions.map(Result::unwrap),
            _bus: bus,
        }
    }

    fn reports(&self) -> Reports {
        self.reports.lock().unwrap().clone()
    }

    fn state(&self) -> Option<ArrayState> {
        self.reports().telemetry.map(|telemetry| telemetry.state)
    }

    /// Commands other angles than before to so many mirrors.
    fn command(&mut self, mirrors: usize) {
        self.sequence += 1;
        let roll = vec![0.001 * (self.sequence % 200) as f32; mirrors];
        let command = MirrorCommand {
            epoch: 1,
            sequence: self.sequence,
            time_ns: utc_ns(),
            validity_ms: 10_000,
            yaw: roll.clone(),
            roll,
            ..MirrorCommand::default()
        };
        put(&self.commands, &command);
    }

    fn stop(&self) {
        let stamp = Stamp { source: 7, sequence: 1, time_ns: utc_ns() };
        put(&self.stops, &EmergencyStop { stamp, operator: "ann".into(), ..EmergencyStop::default() });
    }

    /// The stop report of a latched stop.
    fn latched(&self) -> Option<StopReport> {
        self.reports().stops.filter(|report| !report.stops.is_empty())
    }

    fn is_device_stopped(&self) -> bool {
        self.reports().stops.is_some_and(|report| report.device_stopped)
    }
}

fn put<M: Message>(publisher: &Publisher, message: &M) {
    let mut payload = Vec::new();
    encode(message, &mut payload).unwrap();
    publisher.put(&payload).unwrap();
}

/// Runs a driver of boards at these addresses, one mirror each, and the checks of a test.
fn driven(room: &str, folder: &Path, addresses: &[&str], check: impl FnOnce(&mut Observer)) {
    let endpoint = free_loopback_endpoint().unwrap();
    let config = BusConfig::new(Room::new(room).unwrap());
    let board = |(mirror, address): (usize, &&str)| {
        format!(
            "[[boards]]\nkind = \"servo-board\"\naddress = \"tcp:{address}\"\nmin_deg = -30.0\nmax_deg = 30.0\nmirrors = [{mirror}]\n"
        )
    };
    let boards: String = addresses.iter().enumerate().map(board).collect();
    let text = format!("rows = 1\ncolumns = {}\n{boards}", addresses.len());
    let kit = Kit::new(heliostat_files::from_toml::<Config>(&text).unwrap().wall().unwrap());
    let record = StopRecordSettings { directory: Some(folder.to_owned()), start_armed: true };
    let settings = Settings { record, ..Settings::new(config.clone().listen_at(&endpoint)) };
    let (stop, is_ended) = (Stop::default(), AtomicBool::new(false));
    std::thread::scope(|scope| {
        scope.spawn(|| {
            run::run(kit, &settings, &stop).unwrap();
            is_ended.store(true, Ordering::SeqCst);
        });
        let _end = RequestAtEnd(&stop);
        let mut observer = Observer::join(&config.connect_to(&endpoint));
        until("telemetry", || observer.reports().telemetry);
        check(&mut observer);
        stop.request();
        until("the end of the driver", || is_ended.load(Ordering::SeqCst).then_some(()));
    });
}

/// Ends the driver of a test that fails.
pub struct RequestAtEnd<'a>(pub &'a Stop);

impl Drop for RequestAtEnd<'_> {
    fn drop(&mut self) {
        self.0.request();
    }
}

fn received(log: &Log, line: &str) -> usize {
    log.lock().unwrap().iter().filter(|found| found.starts_with(line)).count()
}

/// The lines after the first stop.
fn after_stop(log: &Log) -> Vec<String> {
    log.lock().unwrap().iter().skip_while(|line| *line != "stop").cloned().collect()
}

#[test]
fn a_dead_board_keeps_no_healthy_one_from_following_or_stopping() {
    let folder = tempfile::tempdir().unwrap();
    let (healthy, (dead, dead_address)) = (listener(), listener());
    drop(dead);
    let log = board(healthy.0, Manner::Prompt);
    driven("dead", folder.path(), &[&healthy.1, &dead_address], |observer| {
        until("angles at the healthy board", || {
            observer.command(2);
            (received(&log, "set") > 20).then_some(())
        });
        until("telemetry of an array that follows without the mirror of the dead board", || {
            observer.command(2);
            let telemetry = observer.reports().telemetry?;
            (telemetry.state == ArrayState::Following && telemetry.unusable == [1]).then_some(())
        });
        observer.stop();
        until("a stop at the healthy board", || (received(&log, "stop") > 0).then_some(()));
        let report = until("a report of the dead board", || {
            observer.latched().filter(|report| report.problem.contains(&dead_address))
        });
        assert!(!report.device_stopped, "{report:?}");
        // The board returns: it is stopped before it gets angles.
        let returned = board(TcpListener::bind(&dead_address).unwrap(), Manner::Prompt);
        until("an array that has stopped", || observer.is_device_stopped().then_some(()));
        let first = returned.lock().unwrap().first().cloned();
        assert_eq!((first.as_deref(), received(&returned, "set")), (Some("stop"), 0));
        let lines = after_stop(&log);
        assert!(lines.iter().all(|line| line == "stop"), "no angles after the stop: {lines:?}");
    });
}

#[test]
fn a_slow_board_delays_neither_the_latch_nor_the_stop_at_another_board() {
    let folder = tempfile::tempdir().unwrap();
    let ((slow, slow_address), (prompt, prompt_address)) = (listener(), listener());
    let slow = board(slow, Manner::Slow(Duration::from_millis(1500)));
    let prompt = board(prompt, Manner::Prompt);
    driven("slow", folder.path(), &[&slow_address, &prompt_address], |observer| {
        until("angles at both boards", || {
            observer.command(2);
            (received(&slow, "set") > 0 && received(&prompt, "set") > 0).then_some(())
        });
        observer.stop();
        until("a latched stop", || observer.latched());
        until("the record", || {
            let record = std::fs::read_to_string(folder.path().join("slow.stop.toml")).ok()?;
            record.contains("stopped = true").then_some(())
        });
        for _ in 0..50 {
            observer.command(2);
        }
        until("a stop at the prompt board", || (received(&prompt, "stop") > 0).then_some(()));
        until("a stop that the slow board has executed", || observer.is_device_stopped().then_some(()));
        for log in [&slow, &prompt] {
            assert!(after_stop(log).iter().all(|line| !line.starts_with("set")), "{:?}", log.lock().unwrap());
        }
    });
}

#[test]
fn a_stop_that_is_repeated_to_a_slow_board_is_written_once_and_executed() {
    let folder = tempfile::tempdir().unwrap();
    let (slow, address) = listener();
    let log = board(slow, Manner::Slow(Duration::from_millis(450)));
    driven("repeated", folder.path(), &[&address], |observer| {
        until("angles", || {
            observer.command(1);
            (received(&log, "set") > 0).then_some(())
        });
        observer.stop();
        until("a latched stop", || observer.latched());
        // While the board has not answered the first one.
        for _ in 0..20 {
            observer.stop();
            std::thread::sleep(Duration::from_millis(20));
        }
        until("a device that has stopped", || observer.is_device_stopped().then_some(()));
        let lines = received(&log, "stop");
        assert!(lines <= 10, "each line delays the answer: {lines} lines");
    });
}

#[test]
fn a_stopped_board_that_hangs_up_is_reported_and_stopped_when_it_returns() {
    let folder = tempfile::tempdir().unwrap();
    let (first, address) = listener();
    let hang_up = Arc::new(AtomicBool::new(false));
    let log = board_until(first, Manner::Prompt, Arc::clone(&hang_up));
    driven("hangs-up", folder.path(), &[&address], |observer| {
        until("angles", || {
            observer.command(1);
            (received(&log, "set") > 0).then_some(())
        });
        observer.stop();
        until("a device that has stopped", || observer.is_device_stopped().then_some(()));
        hang_up.store(true, Ordering::SeqCst);
        let report = until("a report of the board that is gone", || {
            observer.latched().filter(|report| !report.device_stopped && !report.problem.is_empty())
        });
        assert!(report.problem.contains(&address), "{report:?}");
        hang_up.store(false, Ordering::SeqCst);
        until("a device that has stopped again", || observer.is_device_stopped().then_some(()));
        assert!(after_stop(&log).iter().all(|line| line == "stop" || line == "hello"), "{:?}", log.lock().unwrap());
    });
}

#[test]
fn a_silent_board_gets_the_stop_and_telemetry_continues() {
    let folder = tempfile::tempdir().unwrap();
    let (silent, address) = listener();
    let log = board(silent, Manner::Silent);
    driven("silent", folder.path(), &[&address], |observer| {
        until("a question to the board", || (received(&log, "hello") > 0).then_some(()));
        observer.stop();
        let report = until("a latched stop", || observer.latched());
        assert!(!report.device_stopped);
        until("the stop while the board is silent", || (received(&log, "stop") > 0).then_some(()));
        until("the record", || {
            let record = std::fs::read_to_string(folder.path().join("silent.stop.toml")).ok()?;
            record.contains("stopped = true").then_some(())
        });
        // The board, which never answers, is asked on, and the driver publishes on.
        let (asked, count) = (received(&log, "hello"), observer.reports().count);
        until("three more questions", || (received(&log, "hello") > asked + 2).then_some(()));
        until("telemetry", || (observer.reports().count > count + 20).then_some(()));
        until("a stopped array", || (observer.state() == Some(ArrayState::Stopped)).then_some(()));
        assert!(!observer.is_device_stopped());
    });
}

#[test]
fn a_board_that_prints_without_end_gets_the_stop_and_the_driver_ends_on_request() {
    let folder = tempfile::tempdir().unwrap();
    let (chatty, address) = listener();
    let log = board(chatty, Manner::Chatty);
    driven("chatty", folder.path(), &[&address], |observer| {
        observer.stop();
        until("the stop", || (received(&log, "stop") > 0).then_some(()));
        // A pause of the machine looks like the end of the lines, and then an attempt ends with another problem.
        let report = until("a report of its lines", || {
            observer.latched().filter(|report| report.problem.contains("sends without a question"))
        });
        assert!(!report.device_stopped, "{report:?}");
        let count = observer.reports().count;
        until("telemetry", || (observer.reports().count > count + 20).then_some(()));
    });
}

#[test]
fn a_board_that_refuses_the_stop_is_named_and_never_counts_as_stopped() {
    let folder = tempfile::tempdir().unwrap();
    let (refuses, address) = listener();
    let log = board(refuses, Manner::RefusesStops);
    driven("refuses", folder.path(), &[&address], |observer| {
        until("angles", || {
            observer.command(1);
            (received(&log, "set") > 0).then_some(())
        });
        observer.stop();
        let report = until("its problem", || observer.latched().filter(|report| report.problem.contains("refused")));
        assert!(report.problem.contains(&address) && report.problem.contains("busy"), "{report:?}");
        let asked = received(&log, "stop");
        until("more attempts", || (received(&log, "stop") > asked + 4).then_some(()));
        until("a stopped array", || (observer.state() == Some(ArrayState::Stopped)).then_some(()));
        assert!(!observer.is_device_stopped());
    });
}
