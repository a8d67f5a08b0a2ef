//! A servo board as a socket on this machine, with the protocol of
//! `crates/driver/src/devices/servo_board.rs`.

use std::io::{BufRead, BufReader, ErrorKind, Write};
use std::net::{TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::{Duration, Instant};

/// Longest delay between a change of the behaviour and its effect.
const POLL: Duration = Duration::from_millis(5);

/// How the board answers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Behaviour {
    /// At once.
    #[default]
    Prompt,
    /// After this time.
    Slow(Duration),
    /// It receives lines and answers none.
    Silent,
    /// It closes each connection.
    Absent,
    /// It executes no stop.
    RefusesStops,
}

#[derive(Default)]
struct State {
    behaviour: Mutex<Behaviour>,
    /// When its mirrors were turned last, and the longest time between two turns.
    turned: Mutex<(Option<Instant>, Duration)>,
    ended: AtomicBool,
}

impl State {
    fn behaviour(&self) -> Behaviour {
        *self.behaviour.lock().expect("no thread panics")
    }
}

/// A board of a given number of mirrors that turn by 80 degrees either way.
pub struct LoopbackBoard {
    address: String,
    mirrors: usize,
    state: Arc<State>,
}

impl LoopbackBoard {
    /// Starts a board.
    ///
    /// # Panics
    /// When no port is free.
    pub fn start(mirrors: usize) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
        listener.set_nonblocking(true).expect("a socket can be set");
        let address = listener.local_addr().expect("bound").to_string();
        let state: Arc<State> = Arc::default();
        let serving = Arc::clone(&state);
        thread::spawn(move || {
            while !serving.ended.load(Ordering::SeqCst) {
                thread::sleep(POLL);
                let Ok((stream, _)) = listener.accept() else { continue };
                let state = Arc::clone(&serving);
                // The host may close the connection at any time.
                thread::spawn(move || drop(serve(&stream, mirrors, &state)));
            }
        });
        Self { address, mirrors, state }
    }

    /// The driver's configuration file for this board.
    pub fn configuration(&self) -> String {
        let mirrors: Vec<usize> = (0..self.mirrors).collect();
        format!(
            "rows = 2\ncolumns = {}\n[[boards]]\nkind = \"servo-board\"\naddress = \"tcp:{}\"\nmin_deg = -80.0\nmax_deg = 80.0\nmirrors = {mirrors:?}\n",
            self.mirrors / 2,
            self.address
        )
    }

    /// Changes how it answers.
    ///
    /// # Panics
    /// When a thread of the board has panicked.
    pub fn behave(&self, behaviour: Behaviour) {
        *self.state.behaviour.lock().expect("no thread panics") = behaviour;
    }

    /// Longest time between two turns of its mirrors since the last call.
    ///
    /// # Panics
    /// When a thread of the board has panicked.
    pub fn longest_pause(&self) -> Duration {
        std::mem::take(&mut self.state.turned.lock().expect("no thread panics").1)
    }
}

impl Drop for LoopbackBoard {
    fn drop(&mut self) {
        self.state.ended.store(true, Ordering::SeqCst);
    }
}

fn serve(stream: &TcpStream, mirrors: usize, state: &State) -> std::io::Result<()> {
    stream.set_nonblocking(false)?;
    stream.set_read_timeout(Some(POLL))?;
    stream.set_nodelay(true)?;
    let (mut lines, mut line) = (BufReader::new(stream), String::new());
    while !state.ended.load(Ordering::SeqCst) && state.behaviour() != Behaviour::Absent {
        match lines.read_line(&mut line) {
            Ok(0) => break,
            Ok(_) if line.ends_with('\n') => {
                match state.behaviour() {
                    Behaviour::Prompt => {}
                    Behaviour::RefusesStops if line.trim() != "stop" => {}
                    Behaviour::RefusesStops => {
                        let mut writer = stream;
                        writer.write_all(b"error busy\n")?;
                        line.clear();
                        continue;
                    }
                    Behaviour::Slow(delay) => thread::sleep(delay),
                    Behaviour::Silent => {
                        line.clear();
                        continue;
                    }
                    Behaviour::Absent => break,
                }
                let mut writer = stream;
                writer.write_all(answer(line.trim(), mirrors, state).as_bytes())?;
                line.clear();
            }
            Ok(_) => {}
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {}
            Err(error) => return Err(error),
        }
    }
    Ok(())
}

fn answer(line: &str, mirrors: usize, state: &State) -> String {
    const LIMIT_URAD: i64 = 1_400_000;
    match line.split_whitespace().next() {
        Some("hello") => format!("heliostat 1 {mirrors} {} {LIMIT_URAD} 0\n", -LIMIT_URAD),
        Some("set") if line.split_whitespace().count() == 1 + 2 * mirrors => {
            let now = Instant::now();
            let (last, longest) = &mut *state.turned.lock().expect("no thread panics");
            let pause = last.replace(now).map_or(Duration::ZERO, |last| now - last);
            *longest = pause.max(*longest);
            "ok\n".to_owned()
        }
        Some("stop") => "ok\n".to_owned(),
        _ => "error expected hello, set or stop\n".to_owned(),
    }
}
