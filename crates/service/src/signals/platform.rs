//! What differs between operating systems: which signals end a process, and how it receives them.

pub(super) use system::{has_ended, on_each_signal, restore_in_children};

#[cfg(unix)]
mod system {
    use std::io;
    use std::os::unix::process::ExitStatusExt;
    use std::process::ExitStatus;
    use std::sync::atomic::AtomicBool;
    use std::sync::{Arc, Once};
    use std::thread;

    use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
    use signal_hook::flag::register_conditional_default;
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

    /// A signal with a handler has its default action in a new program; an ignored one stays ignored there.
    pub(crate) fn restore_in_children() {
        static RESTORED: Once = Once::new();
        RESTORED.call_once(|| {
            for signal in ENDING {
                let always = Arc::new(AtomicBool::new(true));
                register_conditional_default(signal, always).expect("a handler of a signal that ends a process");
            }
        });
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

    /// No process inherits what another one ignores.
    pub(crate) fn restore_in_children() {}

    pub(crate) fn has_ended(_: ExitStatus) -> bool {
        false
    }
}
