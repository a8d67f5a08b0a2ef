//! One look for each name, on every figure: the Okabe-Ito colours, which can be told apart without colour vision.

/// Colour and stroke of a series.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Style {
    /// Red, green, blue.
    pub rgb: [u8; 3],
    /// Length of dashes and of the gaps between them, in pixels, for what does not decide anything: greys alone are too near each other.
    pub dashes: Option<[i32; 2]>,
    /// No line between the points.
    pub points_only: bool,
}

/// The paper's own values.
pub const QUOTED: [u8; 3] = [0xD5, 0x00, 0x32];

/// The look of a policy, of a walking speed (`1.5 m/s`), or of a sign on a map.
pub fn style(name: &str) -> Style {
    // A policy that predicts the users keeps its colour; so do the sizes at which a yardstick stands.
    let policy = name.split(['+', ' ']).next().unwrap_or(name);
    let hex = match policy {
        "oracle" | "exhaustive" => 0x000000,
        "ddpg" | "actor" => 0x0072B2,
        "analytic" => 0x56B4E9,
        "ddpg-basis" => 0x009E73,
        "ddpg-raw" => 0xCC79A7,
        "dql" => 0xD55E00,
        "q-learning" => 0xE69F00,
        "sarsa" => 0xF0E442,
        "greedy" => 0x117733,
        "fixed-point" => 0x44AA99,
        "nearest" => 0x882255,
        "pso" => 0xAA4499,
        "sine-cosine" => 0x999933,
        "random" => 0x999999,
        "flat" => 0x666666,
        "no-irs" => 0xBBBBBB,
        // Speeds, from dark to light.
        "0" => 0x440154,
        "0.5" => 0x3B528B,
        "1" => 0x21918C,
        "1.5" => 0x5EC962,
        "2" => 0xE6B800,
        "user" => 0xD50032,
        "obstacle" => 0xFFFFFF,
        "mirrors" => 0x0072B2,
        "LED" => 0xFFFFFF,
        _ => 0x332288,
    };
    let [_, red, green, blue] = u32::to_be_bytes(hex);
    Style {
        rgb: [red, green, blue],
        dashes: match policy {
            "oracle" | "exhaustive" => Some([9, 4]),
            "random" => Some([5, 5]),
            "flat" => Some([2, 3]),
            "no-irs" => Some([12, 8]),
            _ => None,
        },
        points_only: matches!(policy, "user" | "LED"),
    }
}

/// A colour as HTML writes it.
pub fn html([red, green, blue]: [u8; 3]) -> String {
    format!("#{red:02X}{green:02X}{blue:02X}")
}

/// How many panels stand side by side.
pub fn columns(panels: usize) -> usize {
    if panels == 4 { 2 } else { panels.min(3) }
}

/// A number of an axis: three digits, no trailing zeros, powers of ten where it is tiny or huge.
pub fn short_number(value: f64) -> String {
    if value == 0.0 {
        return "0".into();
    }
    let magnitude = value.abs().log10().floor() as i32;
    if !(-3..6).contains(&magnitude) {
        return format!("{value:.0e}");
    }
    let text = format!("{value:.*}", (2 - magnitude).clamp(0, 4) as usize);
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').into() } else { text }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_policy_keeps_its_colour_under_prediction_and_numbers_are_short() {
        assert_eq!(style("ddpg+prediction"), style("ddpg"));
        assert_eq!(html(style("ddpg").rgb), "#0072B2");
        assert_eq!([0.5, 20.0, 0.0, 1e-7, 123.4].map(short_number), ["0.5", "20", "0", "1e-7", "123"]);
    }
}
