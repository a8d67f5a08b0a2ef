//! Policies: from an observation to proposed mirror angles.
//!
//! [`Policy`] is the trait; [`build`] makes a policy from its [`PolicyKind`]. A learned policy
//! ([`Actor`]) evaluates an ONNX file ([`actor_file`]) through an [`Engine`], of which
//! [`DenseEngine`] evaluates dense graphs without an inference library. The other policies solve
//! the channel model, search, or hold fixed angles.
//!
//! To add a policy: write its file in `policy/`, list the file here, and add one row to the table
//! in `registry.rs`.

mod actor;
pub mod actor_file;
pub mod codewords;
mod conditions;
mod dense;
mod engine;
mod exhaustive;
mod fixed;
mod metaheuristic;
mod model_based;
mod nearest;
mod proposal;
mod pso;
mod registry;
mod sine_cosine;
mod tally;
mod warm_up;
pub mod weights;
mod with_fallback;

pub use actor::{Actor, Finding, fixed_input};
pub use dense::{DENSE, DenseEngine, DenseError, DenseNetwork};
pub use engine::{Engine, Network};
pub use fixed::Fixed;
pub use model_based::ModelBased;
pub use proposal::{Policy, PolicyError, PolicyMemory, PolicyResult, TimeSource};
pub use registry::{BuildError, PolicyKind, Resources, build, build_fallback};
pub use tally::{Tallies, Tally};
pub use warm_up::warm_up;
pub use with_fallback::{FallbackMemory, ProposedBy, WithFallback};
