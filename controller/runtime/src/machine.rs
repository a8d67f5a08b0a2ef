//! Requests to the operating system that keep other work from delaying decisions: memory locked in
//! RAM, processors of its own, and real-time priority.
//!
//! Each request is made alone. Its result is reported, and the controller continues without what is
//! not granted.

/// The requests.
#[derive(Clone, Debug, Default, clap::Args)]
pub struct MachineArgs {
    /// Keep all memory of the process in RAM, where that is permitted
    #[arg(long)]
    lock_memory: bool,
    /// Run on these processors only, such as 1 or 0,1
    #[arg(long, value_name = "CPU", value_delimiter = ',')]
    pin: Vec<usize>,
    /// Run with this real-time priority (SCHED_FIFO), 1 to 99, where that is permitted
    #[arg(long, value_name = "PRIORITY", num_args = 0..=1, default_missing_value = "50", value_parser = clap::value_parser!(u8).range(1..=99))]
    realtime: Option<u8>,
}

impl MachineArgs {
    /// Makes each request, and returns the result of each in words, as an error where it is not granted.
    ///
    /// Processors and priority apply to the calling thread and to all threads that it starts later:
    /// call this first.
    pub fn obtain(&self) -> Vec<Result<String, String>> {
        let requests = [
            self.lock_memory.then(|| ("memory locked in RAM".to_string(), system::lock_memory())),
            (!self.pin.is_empty()).then(|| (format!("on processors {:?} only", self.pin), system::pin(&self.pin))),
            self.realtime.map(|priority| (format!("SCHED_FIFO, priority {priority}"), system::realtime(priority))),
        ];
        let describe = |(what, granted): (String, Result<(), String>)| match granted {
            Ok(()) => Ok(format!("granted: {what}")),
            Err(problem) => Err(format!("not granted, continuing without: {what}: {problem}")),
        };
        requests.into_iter().flatten().map(describe).collect()
    }
}

#[cfg(target_os = "linux")]
mod system {
    use nix::{
        errno::Errno,
        sched::{CpuSet, sched_setaffinity},
        sys::mman::{MlockAllFlags, mlockall},
        unistd::Pid,
    };
    use thread_priority::{
        RealtimeThreadSchedulePolicy, ThreadPriority, ThreadPriorityValue, ThreadSchedulePolicy,
        set_thread_priority_and_policy, thread_native_id,
    };

    pub fn lock_memory() -> Result<(), String> {
        let advice = "give it CAP_IPC_LOCK or raise the limit (ulimit -l unlimited)";
        mlockall(MlockAllFlags::MCL_CURRENT | MlockAllFlags::MCL_FUTURE).map_err(|error| explain(error, advice))
    }

    pub fn pin(processors: &[usize]) -> Result<(), String> {
        let mut set = CpuSet::new();
        for processor in processors {
            set.set(*processor).map_err(|_| format!("there is no processor {processor}"))?;
        }
        sched_setaffinity(Pid::from_raw(0), &set).map_err(|error| explain(error, "name processors that exist"))
    }

    pub fn realtime(priority: u8) -> Result<(), String> {
        let value = ThreadPriorityValue::try_from(priority).map_err(|problem| problem.to_string())?;
        let policy = ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo);
        set_thread_priority_and_policy(thread_native_id(), ThreadPriority::Crossplatform(value), policy)
            .map_err(|error| format!("{error:?}; give it CAP_SYS_NICE or raise the limit (ulimit -r 99)"))
    }

    fn explain(error: Errno, advice: &str) -> String {
        format!("{}; {advice}", error.desc())
    }
}

#[cfg(not(target_os = "linux"))]
mod system {
    const HERE: &str = "supported on Linux only";

    pub fn lock_memory() -> Result<(), String> {
        Err(HERE.into())
    }

    pub fn pin(_: &[usize]) -> Result<(), String> {
        Err(HERE.into())
    }

    pub fn realtime(_: u8) -> Result<(), String> {
        Err(HERE.into())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_missing_processor_is_reported_and_the_controller_continues() {
        let requests = MachineArgs { pin: vec![1 << 20], ..MachineArgs::default() };
        let results = requests.obtain();
        let [Err(refused)] = &results[..] else { panic!("{results:?}") };
        assert!(refused.starts_with("not granted, continuing without: on processors"), "{refused}");
    }
}
