//! What is wrong in a room, for its status and its log.

/// What went wrong since the last status.
pub enum Problem {
    /// The array receives no commands, or another sender interferes.
    Alarm(String),
    /// Anything else.
    Warning(String),
    /// What lasts and is expected: the status has it, and the log has it as information.
    Notice(String),
    /// What has happened and is over: the log has it as a warning, and the status has no problem.
    Event(String),
    /// The end of a lasting one, or information.
    End(String),
}

impl Problem {
    /// Its text.
    pub fn text(&self) -> &str {
        match self {
            Self::Alarm(text) | Self::Warning(text) | Self::Notice(text) | Self::Event(text) | Self::End(text) => text,
        }
    }

    /// The same with another text.
    pub(super) fn map(self, change: impl FnOnce(String) -> String) -> Self {
        match self {
            Self::Alarm(text) => Self::Alarm(change(text)),
            Self::Warning(text) => Self::Warning(change(text)),
            Self::Notice(text) => Self::Notice(change(text)),
            Self::Event(text) => Self::Event(change(text)),
            Self::End(text) => Self::End(change(text)),
        }
    }
}

/// What a problem is about: its end clears no other one.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum Subject {
    /// Whether the array fits the scenario.
    Fit,
    Driver,
    Stops,
    /// Whether this controller leads, and under which epoch.
    Tenure,
    Geometry,
    /// The light of the mirrors, or of an LED.
    Light(String),
    /// Another controller.
    Peer(u64),
    #[default]
    Other,
}

/// The newest problem that has not ended; by default none.
#[derive(Default)]
pub(super) struct NewestProblem {
    subject: Subject,
    text: String,
}

impl NewestProblem {
    /// Its text; empty for none.
    pub fn text(&self) -> &str {
        &self.text
    }

    /// A problem takes the place of the former one, and an end that of the problem about the same subject.
    pub fn handle(&mut self, (subject, problem): &(Subject, Problem)) {
        match problem {
            Problem::Alarm(text) | Problem::Warning(text) | Problem::Notice(text) => {
                *self = Self { subject: subject.clone(), text: text.clone() };
            }
            Problem::Event(_) | Problem::End(_) if *subject == self.subject => *self = Self::default(),
            Problem::Event(_) | Problem::End(_) => {}
        }
    }
}
