//! One style for each name in every figure, with the Okabe-Ito palette, which is distinguishable
//! with colour-vision deficiency.

/// Colour and stroke of a series.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Style {
    /// Red, green, blue.
    pub rgb: [u8; 3],
    /// Length of dashes and of the gaps between them, in pixels, for the grey baselines,
    /// for policies that ignore which mirrors are unusable, and for beliefs other than the filter.
    pub dashes: Option<[i32; 2]>,
    /// The sign at the points, which differs with the belief.
    pub marker: Marker,
    /// No line between the points.
    pub points_only: bool,
}

/// The sign at the points of a series.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Marker {
    /// A filled circle.
    Circle,
    /// A filled triangle.
    Triangle,
    /// A diagonal cross.
    Cross,
    /// A filled square.
    Square,
    /// A circle without filling.
    Ring,
}

/// The paper's own values.
pub const QUOTED: [u8; 3] = [0xD5, 0x00, 0x32];

/// The style of a policy, of a walking speed (`1.5 m/s`), or of a symbol on a map.
pub fn style(name: &str) -> Style {
    // A suffix such as "+none" or "-unaware" does not change the colour.
    let first = name.split(['+', ' ']).next().unwrap_or(name);
    let unaware = first.strip_suffix("-unaware");
    let policy = unaware.unwrap_or(first);
    let hex = match policy {
        "oracle" => 0x000000,
        "exhaustive" => 0xC08A00,
        "ddpg" | "actor" => 0x0072B2,
        "analytic" => 0x56B4E9,
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
    let (of_belief, marker) = match name.rsplit_once('+').map(|(_, belief)| belief) {
        Some("none") => (Some([2, 4]), Marker::Cross),
        Some("constant-velocity") => (Some([10, 3]), Marker::Triangle),
        Some("true-present") => (Some([4, 2]), Marker::Square),
        Some("true-future") => (Some([14, 5]), Marker::Ring),
        _ => (None, Marker::Circle),
    };
    Style {
        rgb: [red, green, blue],
        dashes: match policy {
            "oracle" => Some([9, 4]),
            "exhaustive" => Some([3, 3]),
            "random" => Some([5, 5]),
            "flat" => Some([2, 3]),
            "no-irs" => Some([12, 8]),
            _ => of_belief.or(unaware.map(|_| [7, 4])),
        },
        marker,
        points_only: matches!(policy, "user" | "LED"),
    }
}

/// How many panels stand side by side.
pub fn columns(panels: usize) -> usize {
    if panels == 4 { 2 } else { panels.min(3) }
}

/// A number of an axis with these ends, as [`short_number`]. A mark at zero that rounding moved is `0`.
pub fn axis_number(value: f64, [low, high]: [f64; 2]) -> String {
    short_number(if value.abs() < 1e-9 * (high - low).abs() { 0.0 } else { value })
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
    use crate::figures::inference::SMALL;

    /// A colour in CIE L*a*b* as an eye sees it whose cones mix red, green and blue by `sight`.
    ///
    /// Source: Machado, Oliveira, Fernandes (2009), severity 1.
    fn seen(rgb: [u8; 3], sight: [[f64; 3]; 3]) -> [f64; 3] {
        let linear = rgb.map(|value| {
            let value = f64::from(value) / 255.0;
            if value <= 0.04045 { value / 12.92 } else { ((value + 0.055) / 1.055).powf(2.4) }
        });
        let times = |rows: [[f64; 3]; 3], vector: [f64; 3]| {
            rows.map(|row| row.iter().zip(vector).map(|(one, other)| one * other).sum::<f64>())
        };
        // From sRGB to XYZ over the white of D65.
        let xyz = [[0.4339, 0.3762, 0.1899], [0.2126, 0.7152, 0.0722], [0.0177, 0.1095, 0.8727]];
        let [x, y, z] = times(xyz, times(sight, linear).map(|value| value.clamp(0.0, 1.0)))
            .map(|value| if value > 0.008856 { value.cbrt() } else { 7.787 * value + 16.0 / 116.0 });
        [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
    }

    #[test]
    fn those_that_share_the_panel_of_nine_mirrors_are_told_apart_by_every_eye() {
        let sights = [
            [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
            [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
            [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
        ];
        for (index, one) in SMALL.iter().enumerate() {
            for other in &SMALL[..index] {
                for sight in sights {
                    let [one, other] = [one, other].map(|name| seen(style(name).rgb, sight));
                    let apart = one.iter().zip(other).map(|(one, other)| (one - other).powi(2)).sum::<f64>().sqrt();
                    // A difference of 2 or 3 is seen side by side; thin lines of a legend and of a
                    // plot are not.
                    assert!(apart > 20.0, "{one:?} and {other:?}");
                }
            }
        }
        assert_ne!(style("oracle").dashes, style("exhaustive").dashes);
    }

    #[test]
    fn a_policy_keeps_its_colour_with_any_belief_whose_line_and_marker_differ_and_numbers_are_short() {
        assert_eq!(style("ddpg+filter"), style("ddpg"));
        assert_eq!(style("ddpg").rgb, [0x00, 0x72, 0xB2]);
        let beliefs = ["filter", "constant-velocity", "none", "true-present", "true-future"];
        let looks = beliefs.map(|belief| style(&format!("greedy+{belief}")));
        for (index, one) in looks.iter().enumerate() {
            assert_eq!(one.rgb, style("greedy").rgb);
            for other in &looks[..index] {
                assert!(one.dashes != other.dashes && one.marker != other.marker, "{one:?} and {other:?}");
            }
        }
        let unaware = style("fixed-point-unaware");
        assert_eq!(unaware.rgb, style("fixed-point").rgb);
        assert!(unaware.dashes.is_some() && style("fixed-point").dashes.is_none());
        assert_eq!([-5.6e-17, 0.2].map(|value| axis_number(value, [-1.0, 1.0])), ["0", "0.2"]);
        assert_eq!(axis_number(-5.6e-17, [-1e-16, 1e-16]), "-6e-17");
        assert_eq!([0.5, 20.0, 0.0, 1e-7, 123.4].map(short_number), ["0.5", "20", "0", "1e-7", "123"]);
    }
}
