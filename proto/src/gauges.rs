//! Gauges in the status of a controller or a simulated room that other processes read by their names.

use std::fmt;

use serde::{Deserialize, Serialize};

use crate::messages::NodeStatus;

/// Standard deviations of one axis of a tracker's reports.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TrackerNoise {
    /// Of a coordinate in m, as the belief learned it.
    pub position_m: f64,
    /// The same as the scenario states it.
    pub position_stated_m: f64,
    /// Of a velocity component in m/s, as the belief learned it.
    pub velocity_m_s: f64,
    /// The same as the scenario states it.
    pub velocity_stated_m_s: f64,
}

impl TrackerNoise {
    /// The names of the gauges, in the order of the fields.
    const NAMES: [&'static str; 4] = [
        "tracker_position_noise_m",
        "tracker_position_noise_stated_m",
        "tracker_velocity_noise_m_s",
        "tracker_velocity_noise_stated_m_s",
    ];

    /// Name and value of each gauge.
    pub fn gauges(&self) -> [(&'static str, f64); 4] {
        let Self { position_m, position_stated_m, velocity_m_s, velocity_stated_m_s } = *self;
        let values = [position_m, position_stated_m, velocity_m_s, velocity_stated_m_s];
        std::array::from_fn(|index| (Self::NAMES[index], values[index]))
    }

    /// The noise in a status; `None` where its controller learns none.
    pub fn of(status: &NodeStatus) -> Option<Self> {
        let [position_m, position_stated_m, velocity_m_s, velocity_stated_m_s] =
            Self::NAMES.map(|name| status.gauge(name));
        Some(Self {
            position_m: position_m?,
            position_stated_m: position_stated_m?,
            velocity_m_s: velocity_m_s?,
            velocity_stated_m_s: velocity_stated_m_s?,
        })
    }
}

impl fmt::Display for TrackerNoise {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { position_m, position_stated_m, velocity_m_s, velocity_stated_m_s } = self;
        write!(
            formatter,
            "positions {position_m:.3} m (stated {position_stated_m:.3}), \
             velocities {velocity_m_s:.3} m/s (stated {velocity_stated_m_s:.3})"
        )
    }
}

/// The light that served users receive over the mirrors, or from one LED over its direct path.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ServedLight {
    /// `mirrors`, or `led-` and the index of the LED.
    pub of: String,
    /// Median of the measured light relative to the expected one.
    pub ratio: f64,
    /// The time of the room in s since which it is not the expected light; absent while it is.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub off_since_s: Option<f64>,
}

impl ServedLight {
    /// Beginning of the names of the gauges, and their ends: of the ratio, and of the time.
    const NAME: [&'static str; 3] = ["light:", ":ratio", ":off_since_s"];

    /// What follows the ratio in words.
    pub const IN_WORDS: &'static str = " of the expected light";

    /// Name and value of each gauge.
    pub fn gauges(&self) -> impl Iterator<Item = (String, f64)> {
        let [start, ratio, since] = Self::NAME;
        let name = |end: &str| format!("{start}{}{end}", self.of);
        [Some((name(ratio), self.ratio)), self.off_since_s.map(|since_s| (name(since), since_s))].into_iter().flatten()
    }

    /// All light in a status.
    pub fn all_of(status: &NodeStatus) -> Vec<Self> {
        let [start, end, since] = Self::NAME;
        let of = |(name, ratio): &(String, f64)| {
            let of = name.strip_prefix(start)?.strip_suffix(end)?;
            let off_since_s = status.gauge(&format!("{start}{of}{since}"));
            Some(Self { of: of.to_owned(), ratio: *ratio, off_since_s })
        };
        status.gauges.iter().filter_map(of).collect()
    }

    /// What to do where it is not the expected light.
    pub fn advice(&self) -> &'static str {
        match self.of.as_str() {
            _ if self.ratio > 1.0 => {
                "look for receivers that users hold at an angle, and for an LED, a detector or mirrors that are not those of \
                 the scenario: report orientations, or measure the room with heliostat calibrate"
            }
            "mirrors" => {
                "clean the mirrors, look for mirrors that do not follow, then measure again: heliostat calibrate"
            }
            _ => {
                "look for an LED that was moved or dimmed, and for covered receivers, then measure again: heliostat calibrate"
            }
        }
    }
}

impl fmt::Display for ServedLight {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.of.strip_prefix("led-") {
            Some(index) => write!(formatter, "LED {index} brings"),
            None => write!(formatter, "the {} bring", self.of),
        }?;
        write!(formatter, " {:.2}{}", self.ratio, Self::IN_WORDS)
    }
}

/// The rate of a user with the angles of the oracle, which a simulated room computes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OracleRate {
    /// Number of the user.
    pub user: u32,
    /// Rate in Mbit/s.
    pub mbps: f64,
}

impl OracleRate {
    /// Beginning and end of the name of the gauge.
    const NAME: [&'static str; 2] = ["oracle:", ":rate_mbps"];

    /// Name and value of the gauge.
    pub fn gauge(&self) -> (String, f64) {
        let [start, end] = Self::NAME;
        (format!("{start}{}{end}", self.user), self.mbps)
    }

    /// The rates of all users in a status.
    pub fn all_of(status: &NodeStatus) -> Vec<Self> {
        let [start, end] = Self::NAME;
        let of = |(name, mbps): &(String, f64)| {
            let user = name.strip_prefix(start)?.strip_suffix(end)?.parse().ok()?;
            Some(Self { user, mbps: *mbps })
        };
        status.gauges.iter().filter_map(of).collect()
    }
}

/// How far a calibration is that commands a room in place of a controller.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CalibrationProgress {
    /// Number of the present place, from 1; the last place is that of the verification.
    pub place: u32,
    /// Number of places: the spots, and the place of the verification.
    pub places: u32,
    /// Whether the receiver is still to be carried to this place.
    pub is_waiting: bool,
    /// Whether the estimate of this place computes; no gauge of an earlier program says so.
    pub is_computing: bool,
    /// Mirrors that are located at this place.
    pub located: u32,
    /// Mirrors to be located at this place; 0 before its first probe.
    pub mirrors: u32,
    /// Estimated time until the end in s, without the walks.
    pub remaining_s: f64,
}

impl CalibrationProgress {
    /// The names of the gauges, in the order of the fields.
    const NAMES: [&'static str; 7] = [
        "calibration_place",
        "calibration_places",
        "calibration_waiting",
        "calibration_computing",
        "calibration_mirrors_located",
        "calibration_mirrors",
        "calibration_remaining_s",
    ];

    /// Name and value of each gauge.
    pub fn gauges(&self) -> [(&'static str, f64); 7] {
        let Self { place, places, is_waiting, is_computing, located, mirrors, remaining_s } = *self;
        let values = [
            f64::from(place),
            f64::from(places),
            f64::from(u8::from(is_waiting)),
            f64::from(u8::from(is_computing)),
            f64::from(located),
            f64::from(mirrors),
            remaining_s,
        ];
        std::array::from_fn(|index| (Self::NAMES[index], values[index]))
    }

    /// The progress in a status; `None` where its process is no calibration.
    pub fn of(status: &NodeStatus) -> Option<Self> {
        let [place, places, waiting, computing, located, mirrors, remaining_s] =
            Self::NAMES.map(|name| status.gauge(name));
        // A cast of a number from the network saturates.
        Some(Self {
            place: place? as u32,
            places: places? as u32,
            is_waiting: waiting? > 0.0,
            is_computing: computing.is_some_and(|computing| computing > 0.0),
            located: located? as u32,
            mirrors: mirrors? as u32,
            remaining_s: remaining_s?,
        })
    }

    /// The present place in a few words.
    pub fn place_name(&self) -> String {
        let name = if self.place >= self.places {
            "the verification".to_owned()
        } else {
            format!("spot {} of {}", self.place, self.places - 1)
        };
        match (self.is_waiting, self.is_computing) {
            (true, _) => format!("waits for the receiver at {name}"),
            (false, true) => format!("computes the estimate of {name}"),
            (false, false) => name,
        }
    }
}

impl fmt::Display for CalibrationProgress {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(&self.place_name())?;
        if self.mirrors > 0 && !self.is_waiting {
            write!(formatter, ", {} of {} mirrors located", self.located, self.mirrors)?;
        }
        write!(formatter, ", about {:.0} s of readings left", self.remaining_s)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_noise_is_read_from_the_gauges_that_it_wrote() {
        let noise =
            TrackerNoise { position_m: 0.1, position_stated_m: 0.05, velocity_m_s: 0.2, velocity_stated_m_s: 0.3 };
        let gauges = noise.gauges().map(|(name, value)| (name.to_owned(), value));
        let status = NodeStatus { gauges: gauges.to_vec(), ..NodeStatus::default() };
        assert_eq!(TrackerNoise::of(&status), Some(noise));
        assert_eq!(TrackerNoise::of(&NodeStatus { gauges: gauges[1..].to_vec(), ..status }), None);
    }

    #[test]
    fn the_light_is_read_from_the_gauges_that_it_wrote() {
        let light = |of: &str, ratio, off_since_s| ServedLight { of: of.into(), ratio, off_since_s };
        let all = vec![light("mirrors", 0.6, Some(12.0)), light("led-0", 1.0, None)];
        let gauges = all.iter().flat_map(ServedLight::gauges).collect();
        assert_eq!(ServedLight::all_of(&NodeStatus { gauges, ..NodeStatus::default() }), all);
    }

    #[test]
    fn the_rates_of_the_oracle_are_read_from_the_gauges_that_it_wrote() {
        let all = vec![OracleRate { user: 0, mbps: 12.5 }, OracleRate { user: 41, mbps: 0.0 }];
        let mut gauges: Vec<_> = all.iter().map(OracleRate::gauge).collect();
        gauges.push(("oracle_mbps".to_owned(), 12.5));
        assert_eq!(OracleRate::all_of(&NodeStatus { gauges, ..NodeStatus::default() }), all);
    }

    #[test]
    fn more_light_than_expected_is_no_reason_to_clean_mirrors() {
        let advice = |ratio| ServedLight { of: "mirrors".into(), ratio, off_since_s: None }.advice();
        assert!(advice(0.6).contains("clean the mirrors") && !advice(1.4).contains("clean"), "{}", advice(1.4));
    }

    #[test]
    fn the_progress_of_a_calibration_is_read_from_the_gauges_that_it_wrote() {
        let progress = CalibrationProgress {
            place: 2,
            places: 4,
            is_waiting: false,
            is_computing: false,
            located: 57,
            mirrors: 100,
            remaining_s: 41.4,
        };
        let status = |progress: CalibrationProgress| NodeStatus {
            gauges: progress.gauges().map(|(name, value)| (name.to_owned(), value)).to_vec(),
            ..NodeStatus::default()
        };
        assert_eq!(CalibrationProgress::of(&status(progress)), Some(progress));
        assert_eq!(CalibrationProgress::of(&NodeStatus::default()), None);
        assert_eq!(progress.to_string(), "spot 2 of 3, 57 of 100 mirrors located, about 41 s of readings left");
        let computing = CalibrationProgress { is_computing: true, located: 100, ..progress };
        assert_eq!(CalibrationProgress::of(&status(computing)), Some(computing));
        assert_eq!(
            computing.to_string(),
            "computes the estimate of spot 2 of 3, 100 of 100 mirrors located, about 41 s of readings left"
        );
        let mut earlier = status(progress);
        earlier.gauges.retain(|(name, _)| name != "calibration_computing");
        assert_eq!(CalibrationProgress::of(&earlier), Some(progress));
        let last = CalibrationProgress { place: 4, is_waiting: true, mirrors: 0, ..progress };
        assert_eq!(last.to_string(), "waits for the receiver at the verification, about 41 s of readings left");
    }
}
