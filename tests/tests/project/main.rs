//! What the repository promises without a room in operation: documents, packages, release, units and rules.

mod alerts;
mod documentation;
mod invariants;
mod release;
mod rules_model;
mod units;
