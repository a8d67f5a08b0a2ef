//! The widest vector instructions that the processor has, chosen as the program runs.
//!
//! Results are the same to the last bit on every processor: loops are written lane by lane, and the compiler neither reorders nor fuses
//! their arithmetic, whatever the width.

/// Runs work that was inlined here with the widest instructions at hand.
///
/// Only what is inlined into `work` gains: mark it `#[inline(always)]`.
#[inline(always)]
pub(crate) fn widest<R>(work: impl FnOnce() -> R) -> R {
    pulp::Arch::new().dispatch(work)
}
