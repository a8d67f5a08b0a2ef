//! Measured gains beside the gains that the belief expects.

/// Measured gains of one user, and those that the belief expects at the time of the measurement
/// without the user's own body.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct GainResidual {
    /// Number of the user.
    pub user: u32,
    /// Measured and expected gain of the direct path.
    pub los: [f64; 2],
    /// Whether the measured direct gain shows a path that is not blocked.
    pub los_shown: bool,
    /// Measured and expected gain over all mirrors at the angles in force.
    pub irs: [f64; 2],
    /// Expected gain if all mirrors were aimed at the user; 0 where the angles are unknown.
    pub steering: f64,
}
