//! A child process of the demo.

use std::collections::VecDeque;
use std::io::{BufRead, BufReader, Read};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};

use crate::{platform, programs};

/// Number of lines of standard error that are kept for an error message.
const LAST_LINES: usize = 12;

/// A running child process.
pub struct ChildProcess {
    name: &'static str,
    process: Child,
    last_lines: Arc<Mutex<VecDeque<String>>>,
    readers: Vec<JoinHandle<()>>,
    answer: Arc<Mutex<Option<String>>>,
    /// Whether its end without a request was reported.
    is_end_reported: bool,
}

impl ChildProcess {
    /// Starts `heliostat` with other arguments; the child ends when its standard input closes.
    pub fn start(name: &'static str, arguments: &[String]) -> Result<Self> {
        let mut command = Command::new(programs::heliostat()?);
        command
            .args(arguments)
            .args(["--exit-with-parent", "--json"])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped());
        platform::own_group(&mut command);
        let mut process = command.spawn().with_context(|| format!("cannot start the {name} process"))?;
        let last_lines = Arc::new(Mutex::new(VecDeque::with_capacity(LAST_LINES)));
        let answer = Arc::new(Mutex::new(None));
        let stdout = process.stdout.take().context("no standard output")?;
        let stderr = process.stderr.take().context("no standard error")?;
        let (lines, kept) = (Arc::clone(&last_lines), Arc::clone(&answer));
        let readers = vec![
            read_lines(stdout, move |line| *kept.lock().expect("no reader panics") = Some(line)),
            read_lines(stderr, move |line| {
                let mut lines = lines.lock().expect("no reader panics");
                if lines.len() == LAST_LINES {
                    lines.pop_front();
                }
                lines.push_back(line);
            }),
        ];
        Ok(Self { name, process, last_lines, readers, answer, is_end_reported: false })
    }

    /// The process id.
    pub fn id(&self) -> u32 {
        self.process.id()
    }

    /// Its command.
    pub fn name(&self) -> &'static str {
        self.name
    }

    /// Once an error with the last output of the process, if it has ended without a request.
    pub fn check_alive(&mut self) -> Result<()> {
        let status = self.process.try_wait().with_context(|| format!("cannot watch the {} process", self.name))?;
        match status.filter(|_| !std::mem::replace(&mut self.is_end_reported, true)) {
            None => Ok(()),
            Some(status) => bail!(self.end_report(status)),
        }
    }

    /// Requests the end of the process, waits for it, and returns the JSON object on its last line.
    pub fn finish(mut self, limit: Duration) -> Result<serde_json::Value> {
        drop(self.process.stdin.take());
        let deadline = Instant::now() + limit;
        let status = loop {
            if let Some(status) = self.process.try_wait()? {
                break status;
            }
            if Instant::now() > deadline {
                self.process.kill().ok();
                bail!(
                    "the {} process did not end within {} s of the request, and was killed",
                    self.name,
                    limit.as_secs()
                );
            }
            std::thread::sleep(Duration::from_millis(10));
        };
        self.readers.drain(..).for_each(|reader| {
            reader.join().ok();
        });
        // An end in order is early too where this process did not request it.
        if !status.success() || self.is_end_reported {
            bail!(self.end_report(status));
        }
        let line = self.answer.lock().expect("no reader panics").take();
        let line = line.with_context(|| format!("the {} process printed no summary", self.name))?;
        serde_json::from_str(&line).with_context(|| format!("the {} process' summary is not JSON: {line}", self.name))
    }

    fn end_report(&mut self, status: ExitStatus) -> String {
        // The pipe closes with the process: its output is complete when the readers have ended.
        self.readers.drain(..).for_each(|reader| {
            reader.join().ok();
        });
        let lines = self.last_lines.lock().expect("no reader panics");
        let lines = if lines.is_empty() {
            "nothing".to_string()
        } else {
            lines.iter().cloned().collect::<Vec<_>>().join("\n  ")
        };
        format!("the {} process ended early ({status}); its last output:\n  {lines}", self.name)
    }
}

impl Drop for ChildProcess {
    fn drop(&mut self) {
        if matches!(self.process.try_wait(), Ok(None)) {
            self.process.kill().ok();
            self.process.wait().ok();
        }
    }
}

fn read_lines(stream: impl Read + Send + 'static, mut take: impl FnMut(String) + Send + 'static) -> JoinHandle<()> {
    std::thread::spawn(move || {
        for line in BufReader::new(stream).lines().map_while(Result::ok) {
            if !line.trim().is_empty() {
                take(line);
            }
        }
    })
}
