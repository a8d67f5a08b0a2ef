//! Run-time selection of the widest vector instructions that the processor supports.

/// Runs `work` with these instructions.
///
/// This also avoids a slowdown. Code of another library may leave the upper halves of the vector
/// registers in use. Sums and products of baseline x86-64 code then depend on those halves. AVX and
/// AVX-512 code has no such dependency and clears the upper halves when it ends.
///
/// The compiler uses these instructions only for code that is inlined into `work`. Inner functions
/// are therefore marked `#[inline(always)]`. The results do not depend on the instructions: the
/// order of operations is fixed in the source, and rustc fuses no multiplication with an addition.
#[inline]
pub fn with_widest_simd<T>(work: impl FnOnce() -> T) -> T {
    pulp::Arch::new().dispatch(work)
}
