//! How far a comparison is.

use std::time::Duration;

use indicatif::{ProgressBar, ProgressStyle};

/// A progress bar on standard error, which another thread can read.
#[derive(Clone, Debug)]
pub struct Progress(ProgressBar);

impl Progress {
    /// A bar that is shown where standard error is a terminal.
    ///
    /// # Errors
    /// An invalid style.
    pub fn shown() -> anyhow::Result<Self> {
        Ok(Self(progress_bar()?))
    }

    pub(super) fn bar(&self) -> &ProgressBar {
        &self.0
    }

    /// Leaves the bar as it is, and says how far it was: items done, items in all, and the kind of item. `None`
    /// before the first kind.
    pub fn abandon(&self) -> Option<String> {
        self.0.abandon();
        let (done, all, kind) = (self.0.position(), self.0.length().unwrap_or_default(), self.0.message());
        (!kind.is_empty()).then(|| format!("{done} of {all} {kind}"))
    }
}

/// A progress bar on standard error: items done, items in all, the kind of item, and the remaining
/// time.
pub(crate) fn progress_bar() -> anyhow::Result<ProgressBar> {
    let bar = ProgressBar::new(0);
    bar.set_style(ProgressStyle::with_template("{bar:32} {pos}/{len} {msg}, {eta} left")?);
    bar.enable_steady_tick(Duration::from_millis(200));
    Ok(bar)
}
