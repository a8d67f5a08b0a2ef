//! The thread that writes the record of an array's emergency stop, so that a slow disk does not delay the
//! next stop.

use std::io;
use std::sync::Arc;
use std::sync::mpsc::{self, Receiver, Sender};
use std::thread::Builder;

use heliostat_array::stop_record::{RecordError, RecordTask};
use heliostat_service::whole_file::Held;

use crate::receive_queue::ReceiveQueue;
use crate::stop_record::StopFile;

/// What became of a task.
type Written = Result<(), RecordError>;

/// The thread of one record. It ends after the task under way when this is dropped; a disk that does not
/// answer keeps no process from ending.
pub(crate) struct RecordThread {
    tasks: Sender<RecordTask>,
    written: Receiver<Written>,
    /// Not with the thread: the next driver of this process must not wait for it.
    _held: Option<Held>,
}

impl RecordThread {
    /// Starts the thread; it wakes the array's thread after each task.
    ///
    /// # Errors
    /// If the system starts no thread.
    pub fn spawn(mut file: StopFile, array: Arc<ReceiveQueue>) -> io::Result<Self> {
        let (tasks, begun) = mpsc::channel::<RecordTask>();
        let (ended, written) = mpsc::channel();
        let held = file.take_held();
        Builder::new().name("stop record".into()).spawn(move || {
            for task in begun {
                let result = task.run(&mut file);
                if ended.send(result).is_err() {
                    break;
                }
                array.wake();
            }
        })?;
        Ok(Self { tasks, written, _held: held })
    }

    /// Begins a task; the last one has ended.
    pub fn begin(&self, task: RecordTask) {
        // It fails after a panic of the thread only; the task then never ends, which the record reports.
        let _ = self.tasks.send(task);
    }

    /// The result of a task that has ended since the last call.
    pub fn poll_written(&self) -> Option<Written> {
        self.written.try_recv().ok()
    }
}
