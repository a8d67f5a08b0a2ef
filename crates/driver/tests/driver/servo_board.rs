//! An emulated servo board on a socket, which answers as docs/servo-board.md describes.

use std::io::{BufRead, BufReader, Write};
use std::net::TcpListener;
use std::sync::{Arc, Mutex};

/// The address of a board of so many mirrors, and the lines that it received. It serves one connection after the other,
/// and disconnects after `lines` lines.
pub fn servo_board(mirrors: usize, lines: usize) -> (String, Arc<Mutex<Vec<String>>>) {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
    let address = listener.local_addr().expect("an address").to_string();
    let log = Arc::new(Mutex::new(Vec::new()));
    let received = Arc::clone(&log);
    std::thread::spawn(move || {
        for stream in listener.incoming().map_while(Result::ok) {
            let mut out = stream.try_clone().expect("a socket");
            let (mut at, mut is_greeted) = (vec!["0"; 2 * mirrors].join(" "), false);
            for line in BufReader::new(stream).lines().take(lines).map_while(Result::ok) {
                let answer = match line.split_once(' ').map_or((line.as_str(), ""), |parts| parts) {
                    ("hello", _) => format!("heliostat 1 {mirrors} -523599 523599 1"),
                    ("set", angles) => {
                        at = angles.to_owned();
                        "ok".to_owned()
                    }
                    ("get", _) => format!("at {at}"),
                    ("stop", _) => "ok".to_owned(),
                    _ => "error unknown".to_owned(),
                };
                // The driver asks an idle board with the same line.
                if line != "hello" || !std::mem::replace(&mut is_greeted, true) {
                    received.lock().expect("no test panics").push(line);
                }
                // One write, so that the answer is not delayed; the driver may have closed the connection.
                out.write_all(format!("{answer}\n").as_bytes()).ok();
            }
        }
    });
    (address, log)
}
