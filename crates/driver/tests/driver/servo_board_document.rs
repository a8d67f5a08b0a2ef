//! docs/servo-board.md against the driver: its example, byte for byte.

use std::io::{BufRead, BufReader, Write};
use std::net::TcpListener;

use heliostat_array::moment::Moment;
use heliostat_channel::MirrorAngles;
use heliostat_driver::Device;
use heliostat_driver::config::Config;

use crate::until;

const NOW: Moment = Moment { local_ns: 0, room_ns: 1_800_000_000_000_000_000 };

/// The lines of the example by their sender: the host's, each with the board's answer.
fn example() -> Vec<(String, String)> {
    let page = include_str!("../../../../docs/servo-board.md");
    let block = page.split("```text\n").nth(1).and_then(|rest| rest.split("```").next()).expect("an example");
    let lines: Vec<&str> = block.lines().collect();
    let pair = |pair: &[&str]| {
        let of = |line: &str, sign: &str| line.strip_prefix(sign).expect("host and board take turns").to_owned();
        (of(pair[0], "> "), of(pair[1], "< "))
    };
    lines.chunks(2).map(pair).collect()
}

#[test]
fn the_driver_sends_and_accepts_the_bytes_of_the_documented_example() {
    let example = example();
    assert_eq!(example.len(), 5, "{example:?}");
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    let script = example.clone();
    let board = std::thread::spawn(move || {
        let (mut stream, _) = listener.accept().unwrap();
        let mut lines = BufReader::new(stream.try_clone().unwrap());
        // The host ignores the carriage return that println of an Arduino sends.
        let mut answer_with = |answer: &str| stream.write_all(format!("{answer}\r\n").as_bytes()).unwrap();
        for (host, answer) in &script {
            let mut line = String::new();
            lines.read_line(&mut line).unwrap();
            // A board that is idle for a moment is asked again.
            while line == "hello\n" && host != "hello" {
                answer_with(&script[0].1);
                line.clear();
                lines.read_line(&mut line).unwrap();
            }
            assert_eq!(line, format!("{host}\n"));
            answer_with(answer);
        }
    });
    let file = format!(
        "rows = 1\ncolumns = 2\n[[boards]]\nkind = \"servo-board\"\naddress = \"tcp:{address}\"\nmin_deg = -30.0\nmax_deg = 30.0\nmeasures = true\nmirrors = [0, 1]"
    );
    let mut device =
        heliostat_files::from_toml::<Config>(&file).expect("the file is valid").wall().expect("the array is valid");
    device.connect(NOW).unwrap();
    device.apply(NOW, &MirrorAngles { roll: vec![0.2, 0.1], yaw: vec![0.4, -0.3] }).unwrap();
    device.request_measurement();
    let mut measured = MirrorAngles::flat(2);
    until("a measurement", || device.measure(NOW, &mut measured).unwrap().then_some(()));
    assert_eq!(measured, MirrorAngles { roll: vec![0.1998, 0.1], yaw: vec![0.4001, -0.3] });
    device.stop(NOW).unwrap();
    until("a stop", || device.has_stopped().unwrap().then_some(()));
    device.apply(NOW, &MirrorAngles { roll: vec![0.6, 0.0], yaw: vec![0.0, 0.0] }).unwrap();
    let message = until("a problem", || device.health(NOW).unwrap().problem).to_string();
    assert!(message.contains("600000 is beyond 523599"), "{message}");
    board.join().expect("the board received what the page says");
}
