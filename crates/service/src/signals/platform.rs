//! What differs between operating systems: which signals end a process, and how it receives them.

pub(super) use system::{has_ended, on_each_signal};

#[cfg(unix)]
mod system {
    use std::io;
    use std::os::unix::process::ExitStatusExt;
    use std::process::ExitStatus;
    use std::thread;

    use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
    use signal_hook::iterator::Signals;

    const ENDING: [i32; 3] = [SIGINT, SIGTERM, SIGHUP];

    /// Calls a function at each signal that ends a process, on a thread of its own.
    ///
    /// A signal that the process ignores since its start stays ignored: `nohup` does this with SIGHUP, and a shell
    /// without job control with SIGINT for a command in the background.
    pub(crate) fn on_each_signal(mut act: impl FnMut() + Send + 'static) -> io::Result<()> {
        let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
        let ignored = ignored(&status);
        let mut signals = Signals::new(ENDING.iter().filter(|signal| (ignored >> (**signal - 1)) & 1 == 0))?;
        thread::Builder::new().name("signals".into()).spawn(move || signals.forever().for_each(|_| act()))?;
        Ok(())
    }

    /// The signals that a process ignores, one bit each, by its status in `/proc`. Only Linux has this file.
    fn ignored(status: &str) -> u64 {
        let mask = |line: &str| u64::from_str_radix(line.strip_prefix("SigIgn:")?.trim(), 16).ok();
        status.lines().find_map(mask).unwrap_or_default()
    }

    /// Whether one of these signals has ended a process that did not handle it.
    pub(crate) fn has_ended(status: ExitStatus) -> bool {
        status.signal().is_some_and(|signal| ENDING.contains(&signal))
    }
}

#[cfg(not(unix))]
mod system {
    use std::io;
    use std::process::ExitStatus;

    pub(crate) fn on_each_signal(act: impl FnMut() + Send + 'static) -> io::Result<()> {
        ctrlc::set_handler(act).map_err(io::Error::other)
    }

    pub(crate) fn has_ended(_: ExitStatus) -> bool {
        false
    }
}
