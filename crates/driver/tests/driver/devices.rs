//! The drivers for hardware with emulated devices on a pseudo-terminal and a socket, byte for byte.
#![cfg(unix)]

use std::fs::File;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::os::fd::AsRawFd;
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, mpsc};
use std::time::{Duration, Instant};

use heliostat_array::moment::Moment;
use heliostat_channel::MirrorAngles;
use heliostat_driver::config::Config;
use heliostat_driver::devices::wall::Wall;
use heliostat_driver::{Device, Kit};
use heliostat_needs::needs;
use heliostat_proto::messages::fault;
use heliostat_proto::{ArrayState, Feedback, MirrorCommand, MirrorTelemetry, Stamp};

use crate::servo_board::servo_board;
use crate::{LIMIT, until};

const NOW: Moment = Moment { local_ns: 0, room_ns: 1_800_000_000_000_000_000 };

fn wall(text: &str) -> Wall {
    heliostat_files::from_toml::<Config>(text).expect("the file is valid").wall().expect("the array is valid")
}

/// Waits until the emulated device has received as much as expected; returns so much of what it received. A
/// stopped device receives the stop again and again.
fn received<T: Clone + PartialEq>(log: &Mutex<Vec<T>>, expected: &[T]) -> Vec<T> {
    let begun = Instant::now();
    while log.lock().unwrap().len() < expected.len() && begun.elapsed() < LIMIT {
        std::thread::sleep(Duration::from_millis(5));
    }
    log.lock().unwrap().iter().take(expected.len()).cloned().collect()
}

/// The problem of a wall whose boards do not answer.
fn refusal(mut device: Wall) -> String {
    device.connect(NOW).unwrap();
    until("a problem", || device.health(NOW).unwrap().problem).to_string()
}

/// A PlayzerX on a pseudo-terminal: splits frames by their length and answers pings.
fn playzerx(answer: &'static str) -> (String, Arc<Mutex<Vec<Vec<u8>>>>, impl Sized) {
    playzerx_until(answer, Arc::default())
}

/// The same; it answers no ping while the flag is set.
fn playzerx_until(answer: &'static str, silent: Arc<AtomicBool>) -> (String, Arc<Mutex<Vec<Vec<u8>>>>, impl Sized) {
    let pty = nix::pty::openpty(None, None).unwrap();
    let path = std::fs::read_link(format!("/proc/self/fd/{}", pty.slave.as_raw_fd())).unwrap();
    let frames = Arc::new(Mutex::new(Vec::new()));
    let log = Arc::clone(&frames);
    let mut device = File::from(pty.master);
    std::thread::spawn(move || {
        let (mut bytes, mut is_greeted) = (Vec::new(), false);
        let mut chunk = [0; 256];
        while let Ok(count) = device.read(&mut chunk) {
            bytes.extend_from_slice(&chunk[..count]);
            while bytes.len() >= 4 && bytes.len() >= usize::from(bytes[3]) {
                let frame: Vec<u8> = bytes.drain(..usize::from(bytes[3])).collect();
                assert!(frame.starts_with(b"pl") && frame.ends_with(b"\n"), "{frame:?}");
                if frame[2] == b'p' && !silent.load(Ordering::SeqCst) {
                    device.write_all(answer.as_bytes()).unwrap();
                    // The driver asks an idle device with the same frame.
                    if std::mem::replace(&mut is_greeted, true) {
                        continue;
                    }
                }
                log.lock().unwrap().push(frame);
            }
        }
    });
    // The other end stays open, so that the terminal does not hang up between two connections.
    (path.display().to_string(), frames, pty.slave)
}

#[test]
fn a_playzerx_receives_the_bytes_of_its_published_protocol() {
    let (path, frames, _open) = playzerx("pl-ok\n");
    let mut device = wall(&format!(
        "rows = 1\ncolumns = 1\n[[boards]]\nkind = \"playzerx\"\naddress = \"serial:{path}\"\nrange_deg = 5.0\nsample_rate_hz = 10000\nmirrors = [0]"
    ));
    device.connect(NOW).unwrap();
    let to = |roll_deg: f64, yaw_deg: f64| MirrorAngles {
        roll: vec![roll_deg.to_radians()],
        yaw: vec![yaw_deg.to_radians()],
    };
    let expected: Vec<Vec<u8>> = [
        &b"plp\x05\n"[..],
        b"pli\x08usb\n",
        b"plr\x08\x10\x27\x00\n",
        b"plc\x05\n",
        b"plD\x08\x00\x80\x80\n",
        b"plD\x08\xff\xf0\x00\n",
        b"plD\x08\xff\xbd\x4c\n",
        b"plc\x05\n",
    ]
    .map(<[u8]>::to_vec)
    .to_vec();
    // Later angles replace those that were not sent yet.
    device.apply(NOW, &to(0.0, 0.0)).unwrap();
    received(&frames, &expected[..5]);
    device.apply(NOW, &to(-5.0, 5.0)).unwrap();
    received(&frames, &expected[..6]);
    // x: half of the range is 3071.25, 0xbff; y: -0.4 of it is 1228.5, 0x4cd.
    device.apply(NOW, &to(-2.0, 2.5)).unwrap();
    received(&frames, &expected[..7]);
    device.stop(NOW).unwrap();
    until("a stop", || device.has_stopped().is_ok_and(|has_stopped| has_stopped).then_some(()));
    assert_eq!(received(&frames, &expected), expected);
    let mut nowhere = to(0.0, 0.0);
    assert_eq!(device.measure(NOW, &mut nowhere), Ok(false), "no acknowledgement, so nothing is measured");
    assert_eq!(device.capabilities().feedback, Feedback::OpenLoop);
}

#[test]
fn a_playzerx_has_stopped_only_when_it_answers_after_the_stop() {
    let silent = Arc::new(AtomicBool::new(false));
    let (path, _frames, _open) = playzerx_until("pl-ok\n", Arc::clone(&silent));
    let mut device = wall(&format!(
        "rows = 1\ncolumns = 1\n[[boards]]\nkind = \"playzerx\"\naddress = \"serial:{path}\"\nrange_deg = 5.0\nmirrors = [0]"
    ));
    device.connect(NOW).unwrap();
    until("a connection", || (device.connections() == Some(1)).then_some(()));
    silent.store(true, Ordering::SeqCst);
    device.stop(NOW).unwrap();
    let problem = until("a problem", || device.has_stopped().err());
    assert!(problem.to_string().contains("no answer"), "{problem}");
    silent.store(false, Ordering::SeqCst);
    until("a stop", || device.has_stopped().is_ok_and(|has_stopped| has_stopped).then_some(()));
}

#[test]
fn another_device_on_the_port_is_refused_by_its_answer() {
    let (path, _frames, _open) = playzerx("hello\n");
    let error = refusal(wall(&format!(
        "rows = 1\ncolumns = 1\n[[boards]]\nkind = \"playzerx\"\naddress = \"serial:{path}\"\nrange_deg = 5.0\nmirrors = [0]"
    )));
    assert!(error.contains("\"hello\"") && error.contains("pl-ok"), "{error}");
}

fn servos(address: &str, mirrors: &str) -> Wall {
    wall(&format!(
        "rows = 1\ncolumns = 2\n[[boards]]\nkind = \"servo-board\"\naddress = \"tcp:{address}\"\nmin_deg = -30.0\nmax_deg = 30.0\nmeasures = true\nmirrors = {mirrors}"
    ))
}

#[test]
fn a_servo_board_receives_angles_in_the_order_of_its_channels() {
    let (address, log) = servo_board(2, usize::MAX);
    let mut device = servos(&address, "[1, 0]");
    device.connect(NOW).unwrap();
    let angles = MirrorAngles { roll: vec![0.1, 0.2], yaw: vec![-0.3, 0.4] };
    device.apply(NOW, &angles).unwrap();
    let expected = ["hello", "set 200000 400000 100000 -300000", "get", "stop"].map(str::to_owned);
    received(&log, &expected[..2]);
    device.request_measurement();
    let mut measured = MirrorAngles::flat(2);
    until("a measurement", || (device.measure(NOW, &mut measured) == Ok(true)).then_some(()));
    assert_eq!(measured, angles);
    device.stop(NOW).unwrap();
    until("a stop", || device.has_stopped().is_ok_and(|has_stopped| has_stopped).then_some(()));
    assert_eq!(received(&log, &expected), expected);
}

#[test]
fn a_board_with_other_limits_than_configured_is_refused() {
    let (address, _log) = servo_board(2, usize::MAX);
    let wide = format!(
        "rows = 1\ncolumns = 2\n[[boards]]\nkind = \"servo-board\"\naddress = \"tcp:{address}\"\nmin_deg = -40.0\nmax_deg = 30.0\nmirrors = [0, 1]"
    );
    let error = refusal(wall(&wide));
    assert!(error.contains("-30.00 to 30.00") && error.contains("-40.00"), "{error}");
}

#[test]
fn a_lost_device_is_a_fault_and_receives_the_target_after_its_reconnection() {
    // hello and the park position; then it disconnects.
    let (address, log) = servo_board(2, 2);
    let mut kit = Kit::new(servos(&address, "[0, 1]"));
    let at = |ms: u64| Moment { local_ns: ms * 1_000_000, room_ns: NOW.room_ns + ms * 1_000_000 };
    let start = Instant::now();
    let now = || at(start.elapsed().as_millis() as u64);
    until("a connection", || {
        kit.advance(now());
        (kit.connections() >= 1 && log.lock().unwrap().len() >= 2).then_some(())
    });
    let command = MirrorCommand {
        epoch: 1,
        sequence: 1,
        time_ns: now().room_ns,
        validity_ms: 10_000,
        roll: vec![0.25; 2],
        yaw: vec![0.125; 2],
        ..MirrorCommand::default()
    };
    kit.handle_command(now(), &command).unwrap();
    let telemetry = until("a fault", || {
        Some(kit.telemetry(now(), Stamp::default())).filter(|telemetry| telemetry.state == ArrayState::Fault)
    });
    assert_eq!((telemetry.faults & fault::LINK, telemetry.unusable), (fault::LINK, vec![0, 1]));
    assert!(telemetry.roll_measured.is_empty() && kit.last_problem().is_some());
    // The board ends each of its connections after the second line.
    until("another connection", || (kit.connections() >= 2).then_some(()));
    let target = "set 250000 125000 250000 125000";
    until("the target", || log.lock().unwrap().iter().any(|line| line == target).then_some(()));
    until("the end of the fault", || {
        (kit.telemetry(now(), Stamp::default()).state == ArrayState::Following).then_some(())
    });
}

/// A board with two mirrors on a socket that answers as `serve` does; and how often it was opened.
fn scripted(serve: impl Fn(TcpStream) + Send + 'static) -> (Wall, Arc<AtomicUsize>) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    let opened = Arc::new(AtomicUsize::new(0));
    let count = Arc::clone(&opened);
    std::thread::spawn(move || {
        for stream in listener.incoming().map_while(Result::ok) {
            count.fetch_add(1, Ordering::SeqCst);
            serve(stream);
        }
    });
    let device = wall(&format!(
        "rows = 1\ncolumns = 2\n[[boards]]\nkind = \"servo-board\"\naddress = \"tcp:{address}\"\nmin_deg = -30.0\nmax_deg = 30.0\nmirrors = [0, 1]"
    ));
    (device, opened)
}

const HELLO_ANSWER: &[u8] = b"heliostat 1 2 -523599 523599 0\n";

#[test]
fn a_board_that_restarts_when_it_is_opened_is_asked_until_it_answers() {
    let (sent, lines) = mpsc::channel();
    let (mut device, opened) = scripted(move |stream| {
        let mut out = stream.try_clone().unwrap();
        let mut asked = 0;
        for line in BufReader::new(stream).lines().map_while(Result::ok) {
            asked += usize::from(line == "hello");
            let answer: &[u8] = match (line.as_str(), asked) {
                // The boot loader discards the first question, and the sketch prints before it runs.
                ("hello", 1) => b"boot: 3 servos\ncalibrating",
                ("hello", 2) => b"\nerror unknown line\n",
                ("hello", _) => HELLO_ANSWER,
                _ => b"ok\n",
            };
            sent.send(line).unwrap();
            out.write_all(answer).unwrap();
        }
    });
    device.connect(NOW).unwrap();
    device.apply(NOW, &MirrorAngles { roll: vec![0.1, 0.2], yaw: vec![0.0; 2] }).unwrap();
    assert_eq!(lines.iter().find(|line| line != "hello").as_deref(), Some("set 100000 0 200000 0"));
    assert_eq!((opened.load(Ordering::SeqCst), device.connections()), (1, Some(1)));
    device.stop(NOW).unwrap();
    until("a stop", || device.has_stopped().is_ok_and(|has_stopped| has_stopped).then_some(()));
    assert_eq!(device.health(NOW).unwrap().problem, None);
}

#[test]
fn an_idle_board_that_is_lost_is_a_fault_without_a_command() {
    // It answers no line while the flag is set.
    let silent = Arc::new(AtomicBool::new(false));
    let is_silent = Arc::clone(&silent);
    let (device, opened) = scripted(move |stream| {
        let mut out = stream.try_clone().unwrap();
        for line in BufReader::new(stream).lines().map_while(Result::ok) {
            let answer = if line == "hello" { HELLO_ANSWER } else { b"ok\n" };
            if !is_silent.load(Ordering::SeqCst) {
                // The driver may have closed the connection.
                out.write_all(answer).ok();
            }
        }
    });
    let mut kit = Kit::new(device);
    let start = Instant::now();
    let mut telemetry = || {
        let ms = start.elapsed().as_millis() as u64;
        let now = Moment { local_ns: ms * 1_000_000, room_ns: NOW.room_ns + ms * 1_000_000 };
        kit.advance(now);
        (kit.telemetry(now, Stamp::default()), kit.connections())
    };
    let is_parked = |telemetry: &MirrorTelemetry| telemetry.state == ArrayState::Parked && telemetry.faults == 0;
    until("a parked array", || Some(telemetry()).filter(|(telemetry, _)| is_parked(telemetry)));
    silent.store(true, Ordering::SeqCst);
    let (lost, _) = until("a fault", || Some(telemetry()).filter(|(lost, _)| lost.faults & fault::LINK != 0));
    assert_eq!((lost.state, lost.unusable), (ArrayState::Fault, vec![0, 1]));
    silent.store(false, Ordering::SeqCst);
    let (_, connections) = until("its return", || Some(telemetry()).filter(|(found, _)| is_parked(found)));
    assert!(connections >= 2 && opened.load(Ordering::SeqCst) >= 2, "{connections} connections");
}

#[test]
fn a_board_that_sends_lines_of_its_own_is_refused_also_if_it_answers() {
    let (mut device, _) = scripted(|stream| {
        let mut out = stream.try_clone().unwrap();
        out.write_all(b"temperature 21.5\r\n").unwrap();
        std::thread::spawn(move || {
            while out.write_all(b"temperature 21.5\r\n").is_ok() {
                std::thread::sleep(Duration::from_millis(20));
            }
        });
        let mut out = stream.try_clone().unwrap();
        for _ in BufReader::new(stream).lines().map_while(Result::ok) {
            out.write_all(HELLO_ANSWER).ok();
        }
    });
    device.connect(NOW).unwrap();
    // A pause of the machine looks like the end of the lines, and then an attempt ends with another problem.
    until("a refusal of its lines", || {
        let problem = device.health(NOW).unwrap().problem?;
        problem.to_string().contains("sends without a question").then_some(())
    });
}

/// A program that ends with its test.
struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        self.0.kill().ok();
        self.0.wait().ok();
    }
}

/// Also where it resets and talks when its port opens.
#[needs("python")]
#[test]
fn the_driver_turns_the_mirrors_of_the_board_in_python() {
    let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../../examples/servo_board.py");
    let python = std::env::var("HELIOSTAT_PYTHON").unwrap_or_else(|_| "python3".into());
    for reset_s in ["0", "0.5"] {
        let arguments = [file, "--mirrors", "2", "--reset", reset_s];
        let mut board =
            Running(Command::new(&python).args(arguments).stdout(Stdio::piped()).spawn().expect("Python runs"));
        let output = board.0.stdout.take().expect("it is piped");
        let mut lines = BufReader::new(output).lines().map_while(Result::ok);
        let first = lines.next().expect("a line");
        let path = first.strip_prefix("the board is at ").expect("the path of its port");
        let mut device = wall(&format!(
            "rows = 1\ncolumns = 2\n[[boards]]\nkind = \"servo-board\"\naddress = \"serial:{path}\"\nmin_deg = -30.0\nmax_deg = 30.0\nmeasures = true\nmirrors = [0, 1]"
        ));
        device.connect(NOW).unwrap();
        device.apply(NOW, &MirrorAngles { roll: vec![0.2, 0.1], yaw: vec![0.4, -0.3] }).unwrap();
        assert_eq!(lines.next().as_deref(), Some("turn 200000 400000 100000 -300000"));
        device.request_measurement();
        let mut measured = MirrorAngles::flat(2);
        until("a measurement", || device.measure(NOW, &mut measured).unwrap().then_some(()));
        let error = |axis: &[f64], expected: [f64; 2]| (axis[0] - expected[0]).abs() + (axis[1] - expected[1]).abs();
        assert!(error(&measured.roll, [0.2, 0.1]) + error(&measured.yaw, [0.4, -0.3]) < 1e-9, "{measured:?}");
        device.stop(NOW).unwrap();
        until("a stop", || device.has_stopped().unwrap().then_some(()));
        assert!(lines.any(|line| line == "stop"));
        device.apply(NOW, &MirrorAngles { roll: vec![0.6, 0.0], yaw: vec![0.0, 0.0] }).unwrap();
        let far = until("a refusal", || device.health(NOW).unwrap().problem).to_string();
        assert!(far.contains("600000 is beyond 523599"), "{far}");
    }
}

/// The reference sketch, built for this host, on a pseudo-terminal.
fn reference_board() -> (String, Child, impl Sized) {
    let folder = tempfile::tempdir().unwrap();
    let program = folder.path().join("board");
    let reference = concat!(env!("CARGO_MANIFEST_DIR"), "/reference/host");
    let built = Command::new("g++")
        .args(["-std=c++11", "-Wall", "-Wextra", "-Werror", "-I", reference, "-o"])
        .arg(&program)
        .arg(format!("{reference}/board.cpp"))
        .output();
    let built = built.expect("g++ runs");
    assert!(built.status.success(), "{}", String::from_utf8_lossy(&built.stderr));
    let pty = nix::pty::openpty(None, None).unwrap();
    let path = std::fs::read_link(format!("/proc/self/fd/{}", pty.slave.as_raw_fd())).unwrap();
    let output = pty.master.try_clone().unwrap();
    let board = Command::new(&program).stdin(pty.master).stdout(output).stderr(Stdio::piped()).spawn().unwrap();
    (path.display().to_string(), board, (pty.slave, folder))
}

#[needs("cxx")]
#[test]
fn the_driver_turns_the_mirrors_of_the_reference_sketch() {
    let (path, mut board, _open) = reference_board();
    let mut device = wall(&format!(
        "rows = 1\ncolumns = 4\n[[boards]]\nkind = \"servo-board\"\naddress = \"serial:{path}\"\nmin_deg = -30.0\nmax_deg = 30.0\nmirrors = [0, 1, 2, 3]"
    ));
    device.connect(NOW).unwrap();
    let to = |roll: f64, yaw: f64| MirrorAngles { roll: vec![0.0, 0.0, 0.0, roll], yaw: vec![0.0, 0.0, 0.0, yaw] };
    device.apply(NOW, &to(0.1, -0.2)).unwrap();
    let mut lines = BufReader::new(board.stderr.take().unwrap()).lines().map_while(Result::ok);
    let mut output: Vec<String> = lines.by_ref().take(8).collect();
    device.apply(NOW, &to(1.0, 0.0)).unwrap();
    let far = until("a refusal", || device.health(NOW).unwrap().problem).to_string();
    assert!(far.contains("not 8 numbers within the limits"), "{far}");
    device.stop(NOW).unwrap();
    output.extend(lines.by_ref().take(8));
    board.kill().unwrap();
    board.wait().unwrap();
    // 637 us per rad around 1500 us: roll and yaw of the last mirror are pins 8 and 9, and a stop
    // ends the pulses.
    let pulses: Vec<&str> = output.iter().map(String::as_str).collect();
    assert_eq!(pulses.len(), 16, "{pulses:?}");
    assert_eq!(
        (pulses[0], pulses[6], pulses[7], pulses[8], pulses[15]),
        ("2 1500", "8 1563", "9 1373", "2 off", "9 off")
    );
}
