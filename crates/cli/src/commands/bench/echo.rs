//! The echo that the loop is compared with: a process that answers each report with a given number
//! of bytes.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use anyhow::{Result, ensure};
use heliostat_bus::{Bus, BusConfig, Class, Role};
use heliostat_proto::Room;
use heliostat_service::{Stop, signals};

use heliostat_service::outln;

/// Between two checks whether the end has been requested.
const LOOK_EVERY: Duration = Duration::from_secs(1);

/// Answer each report with as many bytes as a command has, until standard input closes.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[arg(long)]
    connect: String,
    #[arg(long)]
    client: bool,
    #[arg(long, value_delimiter = ',')]
    rooms: Vec<String>,
    #[arg(long)]
    bytes: usize,
    #[arg(long)]
    exit_with_parent: bool,
    #[arg(long)]
    json: bool,
}

/// Runs the echo.
pub fn run(args: &Args) -> Result<()> {
    ensure!(args.bytes >= 8, "--bytes {}: expected at least 8, for the number that is echoed", args.bytes);
    let echoed = Arc::new(AtomicU64::new(0));
    let role = if args.client { Role::Client } else { Role::Peer };
    let bus = Bus::open(&BusConfig { role, ..BusConfig::new(Room::new("bench")?).connect_to(&args.connect) })?;
    let mut declared = Vec::new();
    for name in &args.rooms {
        let room = Room::new(name)?;
        let publisher = bus.publisher(&room.command(), Class::RealTimeDrop)?;
        let (mut answer, echoed) = (vec![0; args.bytes], Arc::clone(&echoed));
        declared.push(bus.subscribe(&room.users(), move |payload| {
            if let Some(number) = payload.first_chunk::<8>() {
                answer[..8].copy_from_slice(number);
                // If the session is closed, the answers are missing and counted as lost.
                let _ = publisher.put(&answer);
                echoed.fetch_add(1, Ordering::Relaxed);
            }
        })?);
        // A controller receives these reports too and does not answer them.
        declared.push(bus.subscribe(&room.channel(), |_| {})?);
        declared.push(bus.subscribe(&room.obstacles(), |_| {})?);
    }
    let stop = Stop::default();
    signals::stop_at_end_of_input(&stop);
    while !stop.wait_for(LOOK_EVERY) {}
    drop(declared);
    bus.close()?;
    outln!("{}", serde_json::json!({ "echoed": echoed.load(Ordering::Relaxed) }))?;
    Ok(())
}
