//! Sum rates of all users, and those of a past instant.

use serde::Serialize;

/// Sum rates of all users at the same instant in Mbit/s. In a real room references are absent, but for the modelled
/// one without mirrors.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct SumFigures {
    /// With the mirrors as they are.
    pub policy: f64,
    /// Without mirrors.
    pub no_irs: Option<f64>,
    /// With all mirrors flat.
    pub flat: Option<f64>,
    /// At the best angles that meet the minimum rates.
    pub oracle: Option<f64>,
    /// Whether the channel model gives them, because no receiver reports gains.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub is_modelled: bool,
}

impl SumFigures {
    /// The name of the sum rate, for page and terminal.
    pub fn name(&self) -> &'static str {
        if self.is_modelled { "modelled sum rate" } else { "sum rate" }
    }
}

/// Sum rates at a past instant, and what the mirrors followed then.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PastSum {
    /// The sum rates.
    #[serde(flatten)]
    pub sum: SumFigures,
    /// What the mirrors followed, as in [`InCharge`](crate::in_charge::InCharge).
    pub name: String,
    /// Whether it was not the policy.
    pub idle: bool,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn past_sum_rates_have_what_the_mirrors_followed_beside_them() {
        let sum = SumFigures { policy: 3.0, no_irs: Some(1.0), ..SumFigures::default() };
        let past = PastSum { sum, name: "stopped".into(), idle: true };
        let json = serde_json::to_value(past).expect("numbers and texts");
        let expected = serde_json::json!({
            "policy": 3.0, "no_irs": 1.0, "flat": null, "oracle": null, "name": "stopped", "idle": true
        });
        assert_eq!(json, expected);
    }
}
