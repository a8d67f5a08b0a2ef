//! Version and limits of the contract.

use std::time::Duration;

/// Version of the contract: part of each key and the first byte of each payload.
pub const VERSION: u8 = 1;

/// Longest payload in bytes, header included.
pub const MAX_PAYLOAD: usize = 1 << 20;

/// Largest number of users in one report.
pub const MAX_USERS: usize = 64;

/// Largest number of branches of one receiver.
pub const MAX_BRANCHES: usize = 16;

/// Largest number of gains in one LED report: of 64 users by 64 LEDs.
pub const MAX_LED_GAINS: usize = 4096;

/// Largest number of mirror arrays in one room.
pub const MAX_ARRAYS: usize = 16;

/// Largest number of mirrors in one array.
pub const MAX_MIRRORS: usize = 16_384;

/// Largest number of obstacles in one report.
pub const MAX_OBSTACLES: usize = 1024;

/// Largest number of entries in each list of a [`NodeStatus`](crate::NodeStatus).
pub const MAX_ENTRIES: usize = 256;

/// Longest text in bytes of UTF-8.
pub const MAX_TEXT: usize = 1024;

/// The beginning of a text, as long as a message may hold it.
pub fn cut(text: &str) -> &str {
    let end = (0..=text.len().min(MAX_TEXT)).rev().find(|at| text.is_char_boundary(*at));
    &text[..end.unwrap_or(0)]
}

/// Each controller uses only the epochs with its own remainder modulo this number. A new epoch is
/// the first of them above its base, so it exceeds the base by at most this number of ms.
pub const EPOCH_SLOTS: u64 = 1024;

/// Largest lead of a sender's clock in ns. A receiver refuses a message whose time is later than
/// this.
pub const CLOCK_LEAD_MAX_NS: Nanos = 50_000_000;

/// Time in ns from the liveliness token of a driver in which another token is that of a driver that started together
/// with it: the one with the higher source id ends.
pub const START_WINDOW_NS: Nanos = 5_000_000_000;

/// Time in which a process publishes its status at least once, and a controller twice.
pub const STATUS_WITHIN: Duration = Duration::from_millis(1200);

/// Largest speed of a reported user in m/s: far beyond any walk and its noise, and within the bounds of
/// a state that can be restored. A controller leaves a faster user out.
pub const SPEED_MAX_M_S: f64 = 100.0;

/// Largest difference of the length of a quaternion from 1.
pub const LENGTH_TOLERANCE: f64 = 1e-3;

/// Longest text of a [`RoomGeometry`](crate::RoomGeometry) in bytes of UTF-8.
pub const MAX_GEOMETRY: usize = 16_384;

/// Largest number of inputs in a [`ControllerMemory`](crate::ControllerMemory).
pub const MAX_INPUTS: usize = 4096;

/// Longest state in a [`ControllerMemory`](crate::ControllerMemory) in bytes.
pub const MAX_STATE: usize = 786_432;

/// Largest number of emergency stops that an array lists, and of the released ones that it names.
pub const MAX_STOPS: usize = 16;

/// Beginning of the reason of the stop without sender that stands for the stops that an array cannot list.
pub const UNLISTED_STOPS: &str = "more stops than an array can list";

/// Room time in ns: UTC since 1970 in live operation, simulated time in lockstep.
pub type Nanos = u64;

/// Room time before this is simulated, as in lockstep: a stamp of the year 1970.
pub const SIMULATED_UNTIL_NS: Nanos = 365 * NS_PER_DAY;

const NS_PER_DAY: Nanos = 86_400_000_000_000;

/// Date and time of day of a room time in ns, in UTC and in words; simulated time has no date.
pub fn clock_time(time_ns: Nanos) -> String {
    let seconds = time_ns % NS_PER_DAY / 1_000_000_000;
    let time = format!("{:02}:{:02}:{:02} UTC", seconds / 3600, seconds / 60 % 60, seconds % 60);
    if time_ns < SIMULATED_UNTIL_NS {
        return time;
    }
    let (year, month, day) = date(time_ns / NS_PER_DAY);
    format!("{year:04}-{month:02}-{day:02} {time}")
}

/// Year, month and day of a number of days since 1970-01-01, by years that begin in March.
fn date(days: u64) -> (u64, u64, u64) {
    let since_march_0 = days + 719_468;
    let (era, day_of_era) = (since_march_0 / 146_097, since_march_0 % 146_097);
    let year_of_era = (day_of_era - day_of_era / 1460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let month_of_year = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * month_of_year + 2) / 5 + 1;
    let month = if month_of_year < 10 { month_of_year + 3 } else { month_of_year - 9 };
    (400 * era + year_of_era + u64::from(month <= 2), month, day)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_time_of_yesterday_differs_from_one_of_today_and_simulated_time_has_no_date() {
        let at = |seconds: u64| clock_time(seconds * 1_000_000_000);
        assert_eq!(at(43_384), "12:03:04 UTC");
        for (seconds, expected) in [
            (31_536_000, "1971-01-01 00:00:00 UTC"),
            (951_782_399, "2000-02-28 23:59:59 UTC"),
            (951_782_400, "2000-02-29 00:00:00 UTC"),
            (951_868_800, "2000-03-01 00:00:00 UTC"),
            (1_767_323_045, "2026-01-02 03:04:05 UTC"),
            (1_798_761_599, "2026-12-31 23:59:59 UTC"),
            (1_798_761_600, "2027-01-01 00:00:00 UTC"),
            (4_107_542_400, "2100-03-01 00:00:00 UTC"),
        ] {
            assert_eq!(at(seconds), expected);
        }
    }
}
