//! What the terminal shows while the demo runs, read from the public topics alone.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};

use anyhow::Result;
use console::Term;
use heliostat_bus::{Bus, Subscription};
use heliostat_proto::{NodeKind, NodeStatus, Quantiles, Room, RoomTruth, codec};

/// The latest of what the room says.
#[derive(Default)]
struct Heard {
    truth: Option<RoomTruth>,
    status: BTreeMap<&'static str, NodeStatus>,
    unreadable: u64,
}

/// A view of a running room.
pub struct Viewer {
    heard: Arc<Mutex<Heard>>,
    terminal: Option<Term>,
    lines_drawn: usize,
    _subscriptions: Vec<Subscription>,
}

impl Viewer {
    /// Listens to a room; frames are redrawn in place where standard error is a terminal.
    pub fn open(bus: &Bus, room: &Room) -> Result<Self> {
        let heard = Arc::new(Mutex::new(Heard::default()));
        let (on_truth, on_status) = (Arc::clone(&heard), Arc::clone(&heard));
        let truth = bus.subscribe(&room.truth(), move |payload| {
            let mut heard = on_truth.lock().expect("no callback panics");
            match codec::decode::<RoomTruth>(payload) {
                Ok(truth) => heard.truth = Some(truth),
                Err(_) => heard.unreadable += 1,
            }
        })?;
        let status = bus.subscribe(&room.all_status(), move |payload| {
            let mut heard = on_status.lock().expect("no callback panics");
            match codec::decode::<NodeStatus>(payload) {
                Ok(status) => {
                    heard.status.insert(status.node.name(), status);
                }
                Err(_) => heard.unreadable += 1,
            }
        })?;
        let terminal = Some(Term::stderr()).filter(Term::is_term);
        Ok(Self { heard, terminal, lines_drawn: 0, _subscriptions: vec![truth, status] })
    }

    /// Whether both sides have spoken: the room its truth, the controller its status.
    pub fn is_complete(&self) -> bool {
        let heard = self.heard.lock().expect("no callback panics");
        heard.truth.is_some() && heard.status.contains_key(NodeKind::Controller.name())
    }

    /// Draws the present state: a frame on a terminal, a line elsewhere.
    pub fn draw(&mut self) -> Result<()> {
        let heard = self.heard.lock().expect("no callback panics");
        let Some(truth) = &heard.truth else { return Ok(()) };
        match &self.terminal {
            None => eprintln!("{}", line(truth, &heard)),
            Some(terminal) => {
                let mut frame = frame(truth, &heard);
                // Lines beyond the window could not be redrawn in place.
                frame.truncate(usize::from(terminal.size().0).saturating_sub(1).max(1));
                terminal.clear_last_lines(self.lines_drawn)?;
                for line in &frame {
                    terminal.write_line(line)?;
                }
                self.lines_drawn = frame.len();
            }
        }
        Ok(())
    }
}

fn line(truth: &RoomTruth, heard: &Heard) -> String {
    let sum = &truth.sum_rate_bps;
    let blocked = truth.users.iter().filter(|user| user.los_blocked).count();
    format!(
        "tick {:>6}  blocked {blocked}/{}  sum rate {:6.1} Mb/s (no IRS {:.1}, flat {:.1}, oracle {:.1})  decision p99 {}  loop p99 {}",
        truth.tick,
        truth.users.len(),
        sum.policy * 1e-6,
        sum.no_irs * 1e-6,
        sum.flat * 1e-6,
        sum.oracle * 1e-6,
        microseconds(timing(heard, NodeKind::Controller, "decision").map(|time| time.p99)),
        microseconds(timing(heard, NodeKind::SimNode, "loop").map(|time| time.p99)),
    )
}

fn frame(truth: &RoomTruth, heard: &Heard) -> Vec<String> {
    let mut lines = vec![format!("{:<6} {:>16}  {:<9} {:>10}  need", "user", "position (m)", "direct", "rate Mb/s")];
    for user in &truth.users {
        let [x, y, _] = user.position_m;
        let direct = match (user.los_blocked, user.forced) {
            (true, true) => "forced",
            (true, false) => "blocked",
            (false, _) => "clear",
        };
        let bar = "#".repeat((user.rate_bps * 1e-6).clamp(0.0, 40.0).round() as usize);
        let met = if user.rate_bps >= user.min_rate_bps { "met " } else { "MISS" };
        let rate = user.rate_bps * 1e-6;
        lines.push(format!(
            "{:<6} {:>16}  {direct:<9} {rate:>10.2}  {met} {bar}",
            user.user,
            format!("{x:.2}, {y:.2}")
        ));
    }
    let sum = &truth.sum_rate_bps;
    lines.push(String::new());
    for (name, rate) in [("policy", sum.policy), ("no IRS", sum.no_irs), ("flat", sum.flat), ("oracle", sum.oracle)] {
        let share = if sum.oracle > 0.0 { rate / sum.oracle } else { 0.0 };
        let bar = "=".repeat((share.clamp(0.0, 1.1) * 40.0).round() as usize);
        lines.push(format!("{name:<8} {:>8.2} Mb/s {:>5.1} %  {bar}", rate * 1e-6, share * 100.0));
    }
    lines.push(String::new());
    for (label, node, name) in [
        ("decision", NodeKind::Controller, "decision"),
        ("loop", NodeKind::SimNode, "loop"),
        ("age", NodeKind::Controller, "age"),
    ] {
        let time = timing(heard, node, name);
        lines.push(format!(
            "{label:<9} p50 {:>9}  p99 {:>9}  max {:>9}",
            microseconds(time.map(|time| time.p50)),
            microseconds(time.map(|time| time.p99)),
            microseconds(time.map(|time| time.max)),
        ));
    }
    let policy = heard.status.get(NodeKind::Controller.name()).map_or("-", |status| status.policy.as_str());
    lines.push(format!("tick {}  policy {policy}", truth.tick));
    for status in heard.status.values().filter(|status| !status.last_problem.is_empty()) {
        lines.push(format!("{}: {}", status.node, status.last_problem));
    }
    if heard.unreadable > 0 {
        lines.push(format!("{} unreadable messages", heard.unreadable));
    }
    lines
}

fn timing(heard: &Heard, node: NodeKind, name: &str) -> Option<Quantiles> {
    let status = heard.status.get(node.name())?;
    status.timings.iter().find(|(timing, _)| timing == name).map(|(_, quantiles)| *quantiles)
}

fn microseconds(value: Option<f64>) -> String {
    value.map_or("-".into(), |value| format!("{value:.0} us"))
}
