//! A function in Python as a policy of a comparison: `FILE.py:FUNCTION`.
//!
//! A process of Python evaluates the function, and answers over pipes. One process serves all
//! episodes of a comparison. The function reads the observation of an environment with
//! `observation="flat"` and returns an action; its attribute `action` names the form of its actions,
//! `angles` if absent, and its attribute `reset` is called where an episode begins.

use std::fmt;
use std::io::{BufReader, Read, Write};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::sync::{Arc, Mutex, PoisonError};

use anyhow::{Context, Result, bail, ensure};
use heliostat_core::policy::Policy;
use heliostat_environment::action::ActionForm;
use heliostat_environment::function_policy::FunctionPolicy;
use heliostat_files::UnusableInput;
use heliostat_scenario::Scenario;

/// The program of the process.
const PROGRAM: &str = include_str!("python_policy.py");

/// Names the interpreter in place of `python3`.
const INTERPRETER: &str = "HELIOSTAT_PYTHON";

/// Longest answer in bytes: the angles of far more mirrors than a room has.
const ANSWER_MAX: u32 = 1 << 24;

/// A function by the file that defines it.
#[derive(Clone)]
pub struct PythonFunction {
    file: String,
    function: String,
    process: Arc<Mutex<Option<Process>>>,
}

impl fmt::Debug for PythonFunction {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{}:{}", self.file, self.function)
    }
}

/// The process that evaluates it.
struct Process {
    child: Child,
    requests: Option<ChildStdin>,
    answers: BufReader<ChildStdout>,
    form: ActionForm,
}

/// What the process answers.
enum Answer {
    Action(Vec<f32>),
    Problem(String),
    Form(String),
}

impl PythonFunction {
    /// The function of a name `FILE.py:FUNCTION`; `None` for another name.
    pub fn parse(name: &str) -> Option<Self> {
        let (file, function) = name.rsplit_once(':')?;
        let is_name = !function.is_empty() && function.chars().all(|letter| letter.is_alphanumeric() || letter == '_');
        (file.ends_with(".py") && is_name).then(|| Self {
            file: file.into(),
            function: function.into(),
            process: Arc::default(),
        })
    }

    /// Checks that the file is there.
    ///
    /// # Errors
    /// It is not.
    pub fn check_file(&self) -> Result<()> {
        let found = std::path::Path::new(&self.file).is_file();
        let expected =
            || format!("no file {}: expected the file that defines the function {}", self.file, self.function);
        ensure!(found, UnusableInput::new(expected()));
        Ok(())
    }

    /// A policy that calls the function.
    ///
    /// # Errors
    /// The process does not start, or the file has no such function.
    pub fn policy(&self, name: &str, scenario: &Scenario) -> Result<Box<dyn Policy>> {
        self.check_file()?;
        let form = {
            let mut process = self.process.lock().unwrap_or_else(PoisonError::into_inner);
            if process.is_none() {
                *process = Some(Process::start(&self.file, &self.function)?);
            }
            process.as_ref().context("the process has started")?.form
        };
        let process = Arc::clone(&self.process);
        let call = move |vector: &[f32]| {
            let mut process = process.lock().unwrap_or_else(PoisonError::into_inner);
            let process = process.as_mut().ok_or("its process has ended")?;
            process.request(vector)?;
            match process.answer()? {
                Answer::Action(action) => Ok(action),
                Answer::Problem(problem) => Err(problem),
                Answer::Form(_) => Err("its process answered out of turn".to_owned()),
            }
        };
        Ok(Box::new(FunctionPolicy::new(name, scenario, form, call)))
    }

    /// Calls the attribute `reset` of the function, of which a policy exists. What it raises is the failure of the
    /// next decision.
    ///
    /// # Errors
    /// The process has ended.
    pub fn begin_episode(&self) -> Result<()> {
        let mut process = self.process.lock().unwrap_or_else(PoisonError::into_inner);
        process.as_mut().map_or(Ok(()), |process| process.request(&[])).map_err(anyhow::Error::msg)
    }
}

impl Process {
    fn start(file: &str, function: &str) -> Result<Self> {
        let interpreter = std::env::var(INTERPRETER).unwrap_or_else(|_| "python3".into());
        let mut child = Command::new(&interpreter)
            .args(["-c", PROGRAM, file, function, INTERPRETER])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .with_context(|| format!("cannot start {interpreter}: install Python 3, or name it in {INTERPRETER}"))?;
        let requests = child.stdin.take();
        let answers = BufReader::new(child.stdout.take().context("a pipe")?);
        let mut process = Self { child, requests, answers, form: ActionForm::Angles };
        process.form = match process.answer().map_err(anyhow::Error::msg)? {
            Answer::Form(form) if form == "angles" => ActionForm::Angles,
            Answer::Form(form) if form == "weights" => ActionForm::Weights,
            Answer::Form(form) => {
                let found = format!("{file}: {function}.action = {form:?}: expected \"angles\" or \"weights\"");
                bail!(UnusableInput::new(found))
            }
            Answer::Problem(problem) => {
                bail!(UnusableInput::new(format!("{file}:{function} cannot be used: {problem}")))
            }
            Answer::Action(_) => bail!("{file}:{function}: the process answered out of turn"),
        };
        Ok(process)
    }

    fn request(&mut self, vector: &[f32]) -> Result<(), String> {
        let Some(requests) = &mut self.requests else { return Err(self.end()) };
        let mut message = (vector.len() as u32).to_le_bytes().to_vec();
        message.extend(vector.iter().flat_map(|value| value.to_le_bytes()));
        let sent = requests.write_all(&message).and_then(|()| requests.flush());
        sent.map_err(|_| self.end())
    }

    fn receive(&mut self, content: &mut [u8]) -> Result<(), String> {
        let received = self.answers.read_exact(content);
        received.map_err(|_| self.end())
    }

    /// Ends the process, of which a pipe is closed; how it has ended, also where it has before.
    fn end(&mut self) -> String {
        self.requests = None;
        // One that has ended by itself keeps its exit status.
        drop(self.child.kill());
        match self.child.wait() {
            Ok(status) => format!("its process has ended: {status}"),
            Err(error) => format!("its process does not answer: {error}"),
        }
    }

    fn answer(&mut self) -> Result<Answer, String> {
        let mut head = [0; 5];
        self.receive(&mut head)?;
        let [status, length @ ..] = head;
        let length = u32::from_le_bytes(length);
        if length > ANSWER_MAX {
            return Err(format!("its process answered with {length} bytes, expected at most {ANSWER_MAX}"));
        }
        let mut content = vec![0; length as usize];
        self.receive(&mut content)?;
        let text = || String::from_utf8_lossy(&content).into_owned();
        match status {
            0 => {
                let (values, _) = content.as_chunks::<4>();
                Ok(Answer::Action(values.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect()))
            }
            1 => Ok(Answer::Problem(text())),
            2 => Ok(Answer::Form(text())),
            other => Err(format!("its process answered with the status {other}")),
        }
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        drop(self.end());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_function_is_named_by_its_file_and_its_name() {
        for name in ["my.py:act", "folder/my.py:act_2", "./a:b.py:act"] {
            assert!(PythonFunction::parse(name).is_some(), "{name}");
        }
        for name in ["my.py", "my.py:", "my.py:a b", "greedy", "my.onnx", "my.txt:act"] {
            assert!(PythonFunction::parse(name).is_none(), "{name}");
        }
        let missing = PythonFunction::parse("nowhere/my.py:act").expect("a name").check_file();
        assert!(missing.expect_err("no file").to_string().contains("no file nowhere/my.py"));
    }
}
