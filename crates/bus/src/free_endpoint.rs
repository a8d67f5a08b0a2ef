//! Endpoints of this machine for processes that start together.

use std::fs::DirEntry;
use std::net::TcpListener;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use crate::error::BusError;
use crate::platform::HAS_UNIX_SOCKETS;

/// Ports below the ephemeral ranges of Linux, macOS and Windows, so that no outgoing connection and
/// no listener at port 0 gets one.
const PORTS_BELOW_EPHEMERAL: std::ops::Range<u16> = 20_000..32_768;

/// Number of ports that one process takes before those of the next process id.
const PORTS_A_PROCESS: u32 = 8;

/// Distance, in blocks of [`PORTS_A_PROCESS`] ports, between two blocks of one process. Processes with
/// neighbouring ids start at the same time, and the second block of one must not be the first block
/// of another. It has no divisor in common with the number of blocks, so that all are used.
const BLOCK_STEP: u32 = 499;

/// How the names of Unix sockets begin.
const SOCKET: &str = "heliostat-socket-";

/// A day.
const DAY: Duration = Duration::from_secs(86_400);

/// A TCP port on 127.0.0.1 that is free at the time of the call, and another one at each call. It is
/// below the ephemeral range, so that no outgoing connection takes it in the meantime. Processes that
/// start at the same time begin at different ports, because their process ids differ.
///
/// Another process can still take the port before the caller does. Where that must not happen, let the
/// process choose port 0, or use a [`private_endpoint`].
///
/// # Errors
/// [`BusError::NoFreePort`].
pub fn free_loopback_port() -> Result<u16, BusError> {
    static CALLS: AtomicU32 = AtomicU32::new(0);
    let mut last = None;
    for _ in 0..100 {
        let port = nth_port(std::process::id(), CALLS.fetch_add(1, Ordering::Relaxed));
        match TcpListener::bind(("127.0.0.1", port)) {
            Ok(_) => return Ok(port),
            Err(error) => last = Some(error),
        }
    }
    Err(BusError::NoFreePort { problem: last.map(|error| error.to_string()).unwrap_or_default() })
}

/// The port that a process tries at one of its calls.
fn nth_port(process: u32, call: u32) -> u16 {
    let blocks = u32::from(PORTS_BELOW_EPHEMERAL.end - PORTS_BELOW_EPHEMERAL.start) / PORTS_A_PROCESS;
    let block = process.wrapping_add((call / PORTS_A_PROCESS).wrapping_mul(BLOCK_STEP)) % blocks;
    let offset = block * PORTS_A_PROCESS + call % PORTS_A_PROCESS;
    PORTS_BELOW_EPHEMERAL.start + u16::try_from(offset).expect("below the span of a u16 range")
}

/// An endpoint on 127.0.0.1, at a [`free_loopback_port`].
///
/// # Errors
/// [`BusError::NoFreePort`].
pub fn free_loopback_endpoint() -> Result<String, BusError> {
    free_loopback_port().map(|port| format!("tcp/127.0.0.1:{port}"))
}

/// An endpoint of this machine that no other process takes: a Unix socket with a name of its own in
/// the folder of temporary files. A system without Unix sockets gets a [`free_loopback_endpoint`].
///
/// # Errors
/// [`BusError::NoFreePort`].
pub fn private_endpoint() -> Result<String, BusError> {
    static CALLS: AtomicU32 = AtomicU32::new(0);
    if !HAS_UNIX_SOCKETS {
        return free_loopback_endpoint();
    }
    let call = CALLS.fetch_add(1, Ordering::Relaxed);
    if call == 0 {
        remove_old_sockets();
    }
    // A process id comes back, and a process that was killed leaves its socket behind.
    let since_epoch = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |time| time.as_nanos());
    let name = format!("{SOCKET}{}-{since_epoch:x}-{call}.sock", std::process::id());
    Ok(format!("unixsock-stream/{}", std::env::temp_dir().join(name).display()))
}

/// Removes the sockets that killed processes left behind at least a day ago, and their locks.
fn remove_old_sockets() {
    let is_old = |entry: &DirEntry| {
        let age = entry.metadata().and_then(|metadata| metadata.modified()).map(|time| time.elapsed());
        entry.file_name().to_string_lossy().starts_with(SOCKET) && age.is_ok_and(|age| age.is_ok_and(|age| age > DAY))
    };
    for entry in std::env::temp_dir().read_dir().into_iter().flatten().flatten().filter(is_old) {
        // Another user may own it.
        let _ = std::fs::remove_file(entry.path());
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn processes_with_neighbouring_ids_try_different_ports() {
        let ports: Vec<u16> =
            (1000..1032).flat_map(|process| (0..24).map(move |call| nth_port(process, call))).collect();
        let different: BTreeSet<u16> = ports.iter().copied().collect();
        assert_eq!(different.len(), ports.len());
        assert!(ports.iter().all(|port| PORTS_BELOW_EPHEMERAL.contains(port)));
    }

    #[test]
    fn a_process_repeats_no_port_before_it_tried_all() {
        let different: BTreeSet<u16> = (0..12_000).map(|call| nth_port(7, call)).collect();
        assert_eq!(different.len(), 12_000);
    }
}
