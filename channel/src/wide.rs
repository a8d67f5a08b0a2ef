//! The widest vector instructions that the processor is known to have, chosen when the program runs.

/// Does some work with them.
///
/// Beside the width this has another use. Assembly that leaves the upper halves of the vector registers in use, as tract's kernels do, makes code for the x86-64
/// baseline depend on them from then on, at twice the time for sums and products; code for AVX does not, and clears them when it ends.
///
/// Only what is inlined into `work` is compiled for them, so what is worth it below here is marked `#[inline(always)]`. The results are the same
/// to the last bit: wider registers reorder nothing, and rustc fuses no multiplication with an addition.
#[inline]
pub(crate) fn widest<T>(work: impl FnOnce() -> T) -> T {
    pulp::Arch::new().dispatch(work)
}
