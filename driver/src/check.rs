//! Conformance: plays valid, hostile and unlucky traffic at any driver, in whatever language, and tells which rules it keeps.
//!
//! It sees what everybody sees: capabilities, telemetry, liveliness. Each rule gives its evidence; a rule that cannot be judged, since
//! the driver does not have what it is about or breaks the one before it, says why. Waits end when the driver has answered; where it
//! never does, after a few seconds, so a busy machine makes the check slow and not wrong.

mod player;
mod rules;

use std::fmt;
use std::time::Duration;

use anyhow::{Context, Result, bail, ensure};
use heliostat_bus::{Bus, BusConfig};
use heliostat_proto::NodeKind;
use serde::Serialize;

use player::Player;

/// How long a driver is waited for.
const PRESENCE_LIMIT: Duration = Duration::from_secs(5);

/// What became of one rule.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Verdict {
    /// The driver keeps it.
    Kept,
    /// The driver breaks it.
    Broken,
    /// It could not be judged.
    NotJudged,
}

/// One rule and what was seen of it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Finding {
    /// Short name, the same in every version.
    pub rule: &'static str,
    /// What the contract asks.
    pub asks: &'static str,
    /// Kept, broken, or not judged.
    pub verdict: Verdict,
    /// What was seen, or why nothing could be.
    pub evidence: String,
}

/// What a driver was found to do.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Report {
    /// The room.
    pub room: String,
    /// Hardware, as announced.
    pub hardware: String,
    /// Driver, as announced.
    pub driver: String,
    /// Mirrors, as announced.
    pub mirrors: usize,
    /// Every rule, in the order in which they were tried.
    pub findings: Vec<Finding>,
}

impl Report {
    /// The rules that are broken.
    pub fn broken(&self) -> impl Iterator<Item = &Finding> {
        self.findings.iter().filter(|finding| finding.verdict == Verdict::Broken)
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "room {}: {}, driver {}, {} mirrors", self.room, self.hardware, self.driver, self.mirrors)?;
        for Finding { rule, asks, verdict, evidence } in &self.findings {
            let word = match verdict {
                Verdict::Kept => "kept",
                Verdict::Broken => "BROKEN",
                Verdict::NotJudged => "-",
            };
            writeln!(f, "{word:<7} {rule:<18} {asks}")?;
            writeln!(f, "{:27}{evidence}", "")?;
        }
        let broken: Vec<&str> = self.broken().map(|finding| finding.rule).collect();
        match broken.len() {
            0 => writeln!(f, "every rule that could be judged is kept"),
            count => writeln!(f, "{count} broken: {}", broken.join(", ")),
        }
    }
}

/// Checks the driver of a room.
///
/// # Errors
/// Nobody there who drives mirrors, a controller that would interfere, a transport that fails.
pub fn run(config: &BusConfig) -> Result<Report> {
    let bus = Bus::open(config).context("cannot join the room")?;
    let room = bus.room().clone();
    let begun = std::time::Instant::now();
    let present = |kind: NodeKind| Ok::<_, anyhow::Error>(!bus.alive(&room.alive_of(kind), PRESENCE_LIMIT)?.is_empty());
    while !present(NodeKind::Driver)? && !present(NodeKind::SimNode)? {
        ensure!(
            begun.elapsed() < PRESENCE_LIMIT,
            "nobody in room \"{room}\" has a liveliness token of a driver (alive/driver/*) or a simulator: does it run, with the same room and a matching endpoint?"
        );
        std::thread::sleep(Duration::from_millis(50));
    }
    if present(NodeKind::Controller)? {
        bail!("a controller is in room \"{room}\" and would interfere: stop it first");
    }
    let mut player = Player::start(bus)?;
    let findings = rules::judge(&mut player)?;
    let report = Report {
        room: room.to_string(),
        hardware: player.capabilities.hardware.clone(),
        driver: player.capabilities.driver.clone(),
        mirrors: player.capabilities.mirrors(),
        findings,
    };
    player.close()?;
    Ok(report)
}
