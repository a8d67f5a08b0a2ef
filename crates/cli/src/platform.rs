//! What differs between operating systems: the group of a new process, and the clock that processes
//! share.

pub(crate) use system::{own_group, shared_clock};

#[cfg(unix)]
mod system {
    use std::os::unix::process::CommandExt;
    use std::process::Command;
    use std::time::Duration;

    use anyhow::{Context, Result};
    use nix::time::{ClockId, clock_gettime};

    /// A process group of its own: Ctrl-C reaches this process only, which then ends its children in
    /// order.
    pub(crate) fn own_group(command: &mut Command) {
        command.process_group(0);
    }

    /// The time of the monotonic clock of this machine, which its processes share.
    ///
    /// # Errors
    /// The system has no such clock.
    pub(crate) fn shared_clock() -> Result<Duration> {
        let time = clock_gettime(ClockId::CLOCK_MONOTONIC).context("there is no monotonic clock")?;
        Ok(Duration::from(time))
    }
}

#[cfg(windows)]
mod system {
    use std::os::windows::process::CommandExt;
    use std::process::Command;
    use std::time::Duration;

    use anyhow::{Result, bail};

    /// `CREATE_NEW_PROCESS_GROUP`, see "Process Creation Flags" of the Windows API.
    const NEW_GROUP: u32 = 0x200;

    pub(crate) fn own_group(command: &mut Command) {
        command.creation_flags(NEW_GROUP);
    }

    pub(crate) fn shared_clock() -> Result<Duration> {
        bail!("the processes share no monotonic clock: this benchmark needs Linux or macOS")
    }
}
