//! A part of the system as an operating-system process of its own, watched from here.

use std::collections::VecDeque;
use std::io::{BufRead, BufReader, Read};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};

/// How many lines of a process are kept as its last words.
const LAST_WORDS: usize = 12;

/// A running part.
pub struct Part {
    name: &'static str,
    process: Child,
    last_words: Arc<Mutex<VecDeque<String>>>,
    readers: Vec<JoinHandle<()>>,
    answer: Arc<Mutex<Option<String>>>,
}

impl Part {
    /// Starts this same program with the given arguments; the part ends when its standard input closes.
    pub fn start(name: &'static str, arguments: &[String]) -> Result<Self> {
        let program = std::env::current_exe().context("cannot find this program's own file")?;
        let mut command = Command::new(program);
        command
            .args(arguments)
            .args(["--exit-with-parent", "--json"])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped());
        // A process group of its own: Ctrl-C reaches this process alone, which then ends its parts in order.
        #[cfg(unix)]
        std::os::unix::process::CommandExt::process_group(&mut command, 0);
        let mut process = command.spawn().with_context(|| format!("cannot start the {name} process"))?;
        let last_words = Arc::new(Mutex::new(VecDeque::with_capacity(LAST_WORDS)));
        let answer = Arc::new(Mutex::new(None));
        let stdout = process.stdout.take().context("no standard output")?;
        let stderr = process.stderr.take().context("no standard error")?;
        let (words, kept) = (Arc::clone(&last_words), Arc::clone(&answer));
        let readers = vec![
            read_lines(stdout, move |line| *kept.lock().expect("no reader panics") = Some(line)),
            read_lines(stderr, move |line| {
                let mut words = words.lock().expect("no reader panics");
                if words.len() == LAST_WORDS {
                    words.pop_front();
                }
                words.push_back(line);
            }),
        ];
        Ok(Self { name, process, last_words, readers, answer })
    }

    /// The operating system's number of the process.
    pub fn id(&self) -> u32 {
        self.process.id()
    }

    /// An error with the process' last words if it has ended, though nobody asked it to.
    pub fn check_alive(&mut self) -> Result<()> {
        match self.process.try_wait().with_context(|| format!("cannot watch the {} process", self.name))? {
            None => Ok(()),
            Some(status) => bail!(self.epitaph(status)),
        }
    }

    /// Asks the process to end, waits for it, and returns the JSON object that it printed last.
    pub fn finish(mut self, patience: Duration) -> Result<serde_json::Value> {
        drop(self.process.stdin.take());
        let deadline = Instant::now() + patience;
        let status = loop {
            if let Some(status) = self.process.try_wait()? {
                break status;
            }
            if Instant::now() > deadline {
                self.process.kill().ok();
                bail!(
                    "the {} process did not end within {} s of being asked to, and was killed",
                    self.name,
                    patience.as_secs()
                );
            }
            std::thread::sleep(Duration::from_millis(10));
        };
        self.readers.drain(..).for_each(|reader| {
            reader.join().ok();
        });
        if !status.success() {
            bail!(self.epitaph(status));
        }
        let line = self.answer.lock().expect("no reader panics").take();
        let line = line.with_context(|| format!("the {} process printed no summary", self.name))?;
        serde_json::from_str(&line).with_context(|| format!("the {} process' summary is not JSON: {line}", self.name))
    }

    fn epitaph(&mut self, status: ExitStatus) -> String {
        // The pipe closes with the process: what it said last is complete once the readers are done.
        self.readers.drain(..).for_each(|reader| {
            reader.join().ok();
        });
        let words = self.last_words.lock().expect("no reader panics");
        let words = if words.is_empty() {
            "nothing".to_string()
        } else {
            words.iter().cloned().collect::<Vec<_>>().join("\n  ")
        };
        format!("the {} process ended early ({status}); its last words:\n  {words}", self.name)
    }
}

impl Drop for Part {
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
