//! The fields of each message in the order of their bytes, and what each may hold.
//!
//! Writing follows the order in which the types declare their fields; `read` here must follow the same order, and the round
//! trips in the tests hold the two together.

use crate::codec::{Kind, Message, Reader};
use crate::error::CodecError;
use crate::hardware::{AxisLimits, Calibration, Capabilities, EmergencyStop};
use crate::messages::{
    ChannelReport, MirrorCommand, MirrorTelemetry, NodeStatus, Obstacle, ObstacleReport, RoomTruth, UserReport,
};
use crate::operator::{ControllerControl, SimulatorControl};
use crate::{MAX_ENTRIES, MAX_MIRRORS, MAX_OBSTACLES, MAX_TEXT, MAX_USERS};

/// How a message is read field by field, and what its fields may hold.
pub trait Fields {
    /// Takes each field from the reader.
    ///
    /// # Errors
    /// [`CodecError`] where the bytes are not those of the field.
    fn read(&mut self, reader: &mut Reader<'_>) -> Result<(), CodecError>;

    /// Holds the contents against the contract.
    ///
    /// # Errors
    /// [`CodecError`] names the field that breaks it.
    fn check(&self, kind: Kind) -> Result<(), CodecError>;
}

impl Message for UserReport {
    const KIND: Kind = Kind::UserReport;
}

impl Fields for UserReport {
    fn read(&mut self, reader: &mut Reader<'_>) -> Result<(), CodecError> {
        reader.value("stamp", &mut self.stamp)?;
        reader.value("tick", &mut self.tick)?;
        reader.list("users", MAX_USERS, &mut self.users)
    }

    fn check(&self, kind: Kind) -> Result<(), CodecError> {
        let check = Check { kind };
        check.count("users", self.users.len(), MAX_USERS)?;
        for (index, user) in self.users.iter().enumerate() {
            check.finite_at("users.position_m", index, &user.position_m)?;
            check.finite_at("users.velocity_m_s", index, &user.velocity_m_s)?;
            check.not_negative("users.min_rate_bps", index, user.min_rate_bps)?;
        }
        Ok(())
    }
}

impl Message for ChannelReport {
    const KIND: Kind = Kind::ChannelReport;
}

impl Fields for ChannelReport {
    fn read(&mut self, reader: &mut Reader<'_>) -> Result<(), CodecError> {
        reader.value("stamp", &mut self.stamp)?;
        reader.value("tick", &mut self.tick)?;
        reader.list("users", MAX_USERS, &mut self.users)
    }

    fn check(&self, kind: Kind) -> Result<(), CodecError> {
        let check = Check { kind };
        check.count("users", self.users.len(), MAX_USERS)?;
        for (index, user) in self.users.iter().enumerate() {
            check.finite_at("users.los_gain", index, &[user.los_gain])?;
            check.finite_at("users.irs_gain", index, &[user.irs_gain])?;
            check.finite_at("users.sinr", index, &[user.sinr])?;
        }
        Ok(())
    }
}

impl Message for ObstacleReport {
    const KIND: Kind = Kind::ObstacleReport;
}

impl Fields for ObstacleReport {
    fn read(&mut self, reader: &mut Reader<'_>) -> Result<(), CodecError> {
        reader.value("stamp", &mut self.stamp)?;
        reader.list("obstacles", MAX_OBSTACLES, &mut self.obstacles)
    }

    fn check(&self, kind: Kind) -> Result<(), CodecError> {
        Check { kind }.obstacles(&self.obstacles)
    }
}

impl Message for MirrorCommand {
    const KIND: Kind = Kind::MirrorCommand;
}

impl Fields for MirrorCommand {
    fn read(&mut self, reader: &mut Reader<'_>) -> Result<(), CodecError> {
        reader.value("epoch", &mut self.epoch)?;
        reader.value("sequence", &mut self.sequence)?;
        reader.value("answers", &mut self.answers)?;
        reader.value("time_ns", &mut self.time_ns)?;
        reader.value("validity_ms", &mut self.validity_ms)?;
        reader.list("roll", MAX_MIRRORS, &mut self.roll)?;
        reader.list("yaw", MAX_MIRRORS, &mut self.yaw)
    }

    fn check(&self, kind: Kind) -> Result<(), CodecError> {
        let check = Check { kind };
        check.count("roll", self.roll.len(), MAX_MIRRORS)?;
        check.same_length(("yaw", self.yaw.len()), ("roll", self.roll.len()))?;
        check.finite("roll", &self.roll)?;
        check.finite("yaw", &self.yaw)
    }
}

impl Message for MirrorTelemetry {
    const KIND: Kind = Kind::MirrorTelemetry;
}

impl Fields for MirrorTelemetry {
    fn read(&mut self, reader: &mut Reader<'_>) -> Result<(), CodecError> {
        reader.value("stamp", &mut self.stamp)?;
        reader.value("state", &mut self.state)?;
        reader.value("epoch", &mut self.epoch)?;
        reader.value("applied_sequence", &mut self.applied_sequence)?;
        reader.value("answers", &mut self.answers)?;
        reader.value("received_ns", &mut self.received_ns)?;
        reader.value("applied_ns", &mut self.applied_ns)?;
        reader.value("calibration", &mut self.calibration)?;
        reader.value("faults", &mut self.faults)?;
        reader.value("counters", &mut self.counters)?;
        reader.value("temperature_c", &mut self.temperature_c)?;
        reader.list("roll_commanded", MAX_MIRRORS, &mut self.roll_commanded)?;
        reader.list("yaw_commanded", MAX_MIRRORS, &mut self.yaw_commanded)?;
        reader.list("roll_measured", MAX_MIRRORS, &mut self.roll_measured)?;
        reader.list("yaw_measured", MAX_MIRRORS, &mut self.yaw_measured)?;
        reader.list("unusable", MAX_MIRRORS, &mut self.unusable)
    }

    fn check(&self, kind: Kind) -> Result<(), CodecError> {
        let check = Check { kind };
        let commanded = ("roll_commanded", self.roll_commanded.len());
        check.count(commanded.0, commanded.1, MAX_MIRRORS)?;
        check.count("unusable", self.unusable.len(), MAX_MIRRORS)?;
        check.same_length(("yaw_commanded", self.yaw_commanded.len()), commanded)?;
        for measured in [("roll_measured", self.roll_measured.len()), ("yaw_measured", self.yaw_measured.len())] {
            if measured.1 > 0 {
                check.same_length(measured, commanded)?;
            }
        }
        check.finite("temperature_c", self.temperature_c.as_slice())?;
        check.finite("roll_commanded", &self.roll_commanded)?;
        check.finite("yaw_commanded", &self.yaw_commanded)?;
        check.finite("roll_measured", &self.roll_measured)?;
        check.finite("yaw_measured", &self.yaw_measured)
    }
}

impl Message for NodeStatus {
    const KIND: Kind = Kind::NodeStatus;
}

impl Fields for NodeStatus {
    fn read(&mut self, reader: &mut Reader<'_>) -> Result<(), CodecError> {
        reader.value("stamp", &mut self.stamp)?;
        reader.value("node", &mut self.node)?;
        reader.value("name", &mut self.name)?;
        reader.value("software", &mut self.software)?;
        reader.value("state", &mut self.state)?;
        reader.value("scenario", &mut self.scenario)?;
        reader.value("policy", &mut self.policy)?;
        reader.value("started_ns", &mut self.started_ns)?;
        reader.list("counters", MAX_ENTRIES, &mut self.counters)?;
        reader.list("gauges", MAX_ENTRIES, &mut self.gauges)?;
        reader.list("timings", MAX_ENTRIES, &mut self.timings)?;
        reader.value("last_problem", &mut self.last_problem)
    }

    fn check(&self, kind: Kind) -> Result<(), CodecError> {
        let check = Check { kind };
        check.text("name", &self.name)?;
        check.text("software", &self.software)?;
        check.text("state", &self.state)?;
        check.text("scenario", &self.scenario)?;
        check.text("policy", &self.policy)?;
        check.text("last_problem", &self.last_problem)?;
        check.count("counters", self.counters.len(), MAX_ENTRIES)?;
        check.count("gauges", self.gauges.len(), MAX_ENTRIES)?;
        check.count("timings", self.timings.len(), MAX_ENTRIES)?;
        for (name, _) in &self.counters {
            check.text("counters", name)?;
        }
        for (index, (name, value)) in self.gauges.iter().enumerate() {
            check.text("gauges", name)?;
            check.finite_at("gauges", index, &[*value])?;
        }
        for (index, (name, times)) in self.timings.iter().enumerate() {
            check.text("timings", name)?;
            check.finite_at("timings", index, &[times.p50, times.p90, times.p99, times.p999, times.max])?;
        }
        Ok(())
    }
}

impl Message for RoomTruth {
    const KIND: Kind = Kind::RoomTruth;
}

impl Fields for RoomTruth {
    fn read(&mut self, reader: &mut Reader<'_>) -> Result<(), CodecError> {
        reader.value("stamp", &mut self.stamp)?;
        reader.value("tick", &mut self.tick)?;
        reader.list("users", MAX_USERS, &mut self.users)?;
        reader.list("obstacles", MAX_OBSTACLES, &mut self.obstacles)?;
        reader.value("sum_rate_bps", &mut self.sum_rate_bps)
    }

    fn check(&self, kind: Kind) -> Result<(), CodecError> {
        let check = Check { kind };
        check.count("users", self.users.len(), MAX_USERS)?;
        for (index, user) in self.users.iter().enumerate() {
            check.finite_at("users.position_m", index, &user.position_m)?;
            check.finite_at("users.heading_rad", index, &[user.heading_rad])?;
            check.finite_at("users.los_gain", index, &[user.los_gain])?;
            check.finite_at("users.irs_gain", index, &[user.irs_gain])?;
            check.finite_at("users.sinr", index, &[user.sinr])?;
            check.finite_at("users.rate_bps", index, &[user.rate_bps])?;
            check.not_negative("users.min_rate_bps", index, user.min_rate_bps)?;
        }
        check.obstacles(&self.obstacles)?;
        let rates = &self.sum_rate_bps;
        check.finite("sum_rate_bps", &[rates.policy, rates.no_irs, rates.flat, rates.oracle])
    }
}

impl Message for Capabilities {
    const KIND: Kind = Kind::Capabilities;
}

impl Fields for Capabilities {
    fn read(&mut self, reader: &mut Reader<'_>) -> Result<(), CodecError> {
        reader.value("stamp", &mut self.stamp)?;
        reader.value("hardware", &mut self.hardware)?;
        reader.value("driver", &mut self.driver)?;
        reader.value("rows", &mut self.rows)?;
        reader.value("columns", &mut self.columns)?;
        reader.value("roll", &mut self.roll)?;
        reader.value("yaw", &mut self.yaw)?;
        reader.value("feedback", &mut self.feedback)?;
        reader.value("validity_clock", &mut self.validity_clock)?;
        reader.value("command_rate_max_hz", &mut self.command_rate_max_hz)?;
        reader.value("park_after_ms", &mut self.park_after_ms)?;
        reader.value("park_rad", &mut self.park_rad)
    }

    fn check(&self, kind: Kind) -> Result<(), CodecError> {
        let check = Check { kind };
        check.text("hardware", &self.hardware)?;
        check.text("driver", &self.driver)?;
        let mirrors = u64::from(self.rows) * u64::from(self.columns);
        if mirrors > MAX_MIRRORS as u64 {
            return Err(CodecError::TooMany { kind, field: "rows * columns", found: mirrors, limit: MAX_MIRRORS });
        }
        check.axis("roll", &self.roll)?;
        check.axis("yaw", &self.yaw)?;
        check.not_negative("command_rate_max_hz", 0, self.command_rate_max_hz)?;
        check.finite("park_rad", &self.park_rad)
    }
}

impl Message for EmergencyStop {
    const KIND: Kind = Kind::EmergencyStop;
}

impl Fields for EmergencyStop {
    fn read(&mut self, reader: &mut Reader<'_>) -> Result<(), CodecError> {
        reader.value("stamp", &mut self.stamp)?;
        reader.value("action", &mut self.action)?;
        reader.value("operator", &mut self.operator)?;
        reader.value("reason", &mut self.reason)
    }

    fn check(&self, kind: Kind) -> Result<(), CodecError> {
        Check { kind }.text("operator", &self.operator)?;
        Check { kind }.text("reason", &self.reason)
    }
}

impl Message for Calibration {
    const KIND: Kind = Kind::Calibration;
}

impl Fields for Calibration {
    fn read(&mut self, reader: &mut Reader<'_>) -> Result<(), CodecError> {
        reader.value("stamp", &mut self.stamp)?;
        reader.list("roll_offset_rad", MAX_MIRRORS, &mut self.roll_offset_rad)?;
        reader.list("roll_gain", MAX_MIRRORS, &mut self.roll_gain)?;
        reader.list("yaw_offset_rad", MAX_MIRRORS, &mut self.yaw_offset_rad)?;
        reader.list("yaw_gain", MAX_MIRRORS, &mut self.yaw_gain)
    }

    fn check(&self, kind: Kind) -> Result<(), CodecError> {
        let check = Check { kind };
        let first = ("roll_offset_rad", self.roll_offset_rad.len());
        check.count(first.0, first.1, MAX_MIRRORS)?;
        check.finite(first.0, &self.roll_offset_rad)?;
        let others =
            [("roll_gain", &self.roll_gain), ("yaw_offset_rad", &self.yaw_offset_rad), ("yaw_gain", &self.yaw_gain)];
        for (field, values) in others {
            check.same_length((field, values.len()), first)?;
            check.finite(field, values)?;
        }
        Ok(())
    }
}

impl Message for SimulatorControl {
    const KIND: Kind = Kind::SimulatorControl;
}

impl Fields for SimulatorControl {
    fn read(&mut self, reader: &mut Reader<'_>) -> Result<(), CodecError> {
        reader.value("stamp", &mut self.stamp)?;
        reader.value("forced_users", &mut self.forced_users)?;
        reader.value("power_w", &mut self.power_w)?;
        reader.value("speed_m_s", &mut self.speed_m_s)?;
        reader.list("faults", MAX_ENTRIES, &mut self.faults)
    }

    fn check(&self, kind: Kind) -> Result<(), CodecError> {
        let check = Check { kind };
        if let Some(power_w) = self.power_w {
            check.not_negative("power_w", 0, power_w)?;
        }
        for (index, speed_m_s) in self.speed_m_s.iter().flatten().enumerate() {
            check.not_negative("speed_m_s", index, *speed_m_s)?;
        }
        check.count("faults", self.faults.len(), MAX_ENTRIES)?;
        for (index, fault) in self.faults.iter().enumerate() {
            check.not_negative("faults.seconds", index, fault.seconds)?;
            check.not_negative("faults.share", index, fault.share)?;
            check.count("faults.mirrors", fault.mirrors.len(), MAX_MIRRORS)?;
            if fault.share > 1.0 {
                let (field, value, wanted) = ("faults.share", fault.share.into(), "a share from 0 to 1");
                return Err(CodecError::OutOfDomain { kind, field, index, value, wanted });
            }
        }
        Ok(())
    }
}

impl Message for ControllerControl {
    const KIND: Kind = Kind::ControllerControl;
}

impl Fields for ControllerControl {
    fn read(&mut self, reader: &mut Reader<'_>) -> Result<(), CodecError> {
        reader.value("stamp", &mut self.stamp)?;
        reader.value("policy", &mut self.policy)
    }

    fn check(&self, kind: Kind) -> Result<(), CodecError> {
        Check { kind }.text("policy", &self.policy)
    }
}

/// The tests that fields share.
struct Check {
    kind: Kind,
}

impl Check {
    fn count(&self, field: &'static str, found: usize, limit: usize) -> Result<(), CodecError> {
        if found <= limit {
            return Ok(());
        }
        Err(CodecError::TooMany { kind: self.kind, field, found: found as u64, limit })
    }

    fn text(&self, field: &'static str, text: &str) -> Result<(), CodecError> {
        self.count(field, text.len(), MAX_TEXT)
    }

    fn same_length(&self, one: (&'static str, usize), other: (&'static str, usize)) -> Result<(), CodecError> {
        let ((field, found), (like, wanted)) = (one, other);
        if found == wanted {
            return Ok(());
        }
        Err(CodecError::LengthMismatch { kind: self.kind, field, found, like, wanted })
    }

    /// Each value of a list.
    fn finite<T: Copy + Into<f64>>(&self, field: &'static str, values: &[T]) -> Result<(), CodecError> {
        match values.iter().position(|value| !(*value).into().is_finite()) {
            None => Ok(()),
            Some(index) => Err(self.not_finite(field, index, values[index].into())),
        }
    }

    /// The values of one entry of a list.
    fn finite_at<T: Copy + Into<f64>>(
        &self,
        field: &'static str,
        index: usize,
        values: &[T],
    ) -> Result<(), CodecError> {
        match values.iter().find(|value| !(**value).into().is_finite()) {
            None => Ok(()),
            Some(value) => Err(self.not_finite(field, index, (*value).into())),
        }
    }

    fn not_negative(&self, field: &'static str, index: usize, value: f32) -> Result<(), CodecError> {
        self.finite_at(field, index, &[value])?;
        if value >= 0.0 {
            return Ok(());
        }
        Err(CodecError::OutOfDomain {
            kind: self.kind,
            field,
            index,
            value: value.into(),
            wanted: "a number that is not negative",
        })
    }

    fn obstacles(&self, obstacles: &[Obstacle]) -> Result<(), CodecError> {
        self.count("obstacles", obstacles.len(), MAX_OBSTACLES)?;
        for (index, obstacle) in obstacles.iter().enumerate() {
            self.finite_at("obstacles.x_m", index, &[obstacle.x_m])?;
            self.finite_at("obstacles.y_m", index, &[obstacle.y_m])?;
            self.not_negative("obstacles.radius_m", index, obstacle.radius_m)?;
            self.not_negative("obstacles.height_m", index, obstacle.height_m)?;
        }
        Ok(())
    }

    fn axis(&self, field: &'static str, limits: &AxisLimits) -> Result<(), CodecError> {
        self.finite_at(field, 0, &[limits.min_rad, limits.max_rad])?;
        for value in [limits.slew_rad_s, limits.settling_s, limits.resolution_rad] {
            self.not_negative(field, 0, value)?;
        }
        if limits.min_rad <= limits.max_rad {
            return Ok(());
        }
        Err(CodecError::OutOfDomain {
            kind: self.kind,
            field,
            index: 0,
            value: limits.min_rad.into(),
            wanted: "a smallest angle that is not above the largest",
        })
    }

    fn not_finite(&self, field: &'static str, index: usize, value: f64) -> CodecError {
        CodecError::NotFinite { kind: self.kind, field, index, value }
    }
}
