//! The final report as a table for a terminal.

use std::{collections::BTreeMap, fmt};

use heliostat_core::{core::Stage, policy::Tally};
use heliostat_proto::Quantiles;
use heliostat_service::printable::printable;

use super::{BeliefSummary, Summary};

impl fmt::Display for Summary {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(formatter, "policy {} at the end, epoch {}", self.policy, self.epoch)?;
        writeln!(
            formatter,
            "decisions {}, commands {}, unsent {}, dropped {}",
            self.decisions, self.commands, self.unsent, self.dropped
        )?;
        writeln!(formatter, "over 0.5 ms: {}, by longest stage:{}", self.over_budget, list(&self.over_budget_by))?;
        writeln!(formatter, "{:<12}{:>10}{:>10}{:>10}{:>10}{:>10}", "time in us", "p50", "p90", "p99", "p99.9", "max")?;
        let stages = Stage::ALL.iter().filter_map(|stage| Some((stage.name(), self.stages_us.get(stage.name())?)));
        let rows = [("decision", &self.decision_us)].into_iter().chain(stages).chain([("age", &self.age_us)]);
        for (name, times) in rows {
            let Quantiles { count, p50, p90, p99, p999, max, .. } = times;
            if *count == 0 {
                writeln!(formatter, "{name:<12}{:>10}{:>10}{:>10}{:>10}{:>10}", "-", "-", "-", "-", "-")?;
                continue;
            }
            writeln!(formatter, "{name:<12}{p50:>10.1}{p90:>10.1}{p99:>10.1}{p999:>10.1}{max:>10.1}")?;
        }
        self.write_policies(formatter)?;
        writeln!(formatter, "fallbacks:{}", list(&self.fallbacks))?;
        if !self.withheld.is_empty() {
            writeln!(formatter, "commands not sent:{}", list(&self.withheld))?;
        }
        writeln!(formatter, "refused:{}", list(&self.refused))?;
        writeln!(formatter, "reports that did not arrive:{}", list(&self.missed))?;
        write!(formatter, "angles limited: {} by range, {} by slew", self.clipped.range, self.clipped.slew)?;
        if !self.users.is_empty() {
            write!(
                formatter,
                "\nusers without a measured gain, or beyond the policy's capacity, summed over decisions:{}",
                list(&self.users)
            )?;
        }
        if self.modelled > 0 {
            write!(formatter, "\ndecisions on modelled gains, in a room that reports none: {}", self.modelled)?;
        }
        if let Some(BeliefSummary { reports, innovation_mean, noise }) = self.belief {
            if reports > 0 {
                write!(
                    formatter,
                    "\nbelief: mean normalised innovation squared {innovation_mean:.2} over {reports} reported positions"
                )?;
            }
            if let Some(noise) = noise {
                write!(formatter, "\ntracker noise: {noise}")?;
            }
        }
        for light in &self.light {
            write!(formatter, "\n{light}")?;
        }
        if !self.epoch_events.is_empty() {
            write!(formatter, "\nchanges of the epoch:{}", list(&self.epoch_events))?;
        }
        if self.standby {
            write!(formatter, "\nstandby: the array follows another controller")?;
        }
        if self.driver_absent {
            let arrays = self.arrays.iter().filter(|array| array.driver_absent);
            let names: Vec<&str> = arrays.map(|array| array.name.as_str()).collect();
            let to = if names.is_empty() { String::new() } else { format!(" to {}", names.join(" and ")) };
            write!(formatter, "\nat the end no driver received the commands{to}")?;
        }
        if self.geometry_differs {
            write!(formatter, "\nroom and controller have different geometries")?;
        }
        if let Some(unfit) = &self.unfit {
            write!(formatter, "\nno commands: {unfit}")?;
        }
        for granted in &self.machine {
            write!(formatter, "\n{granted}")?;
        }
        for (room, summary) in &self.rooms {
            write!(formatter, "\nroom {room}: decisions {}", summary.decisions)?;
            let Quantiles { count, p50, p99, .. } = summary.decision_us;
            if count > 0 {
                write!(formatter, ", p50 {p50:.1} us, p99 {p99:.1} us")?;
            }
        }
        if self.unanswered > 0 {
            write!(formatter, "\nthe policy had not returned for 0.1 s at {} status checks", self.unanswered)?;
        }
        if !self.last_problem.is_empty() {
            write!(formatter, "\nlast problem: {}", printable(&self.last_problem))?;
        }
        Ok(())
    }
}

impl Summary {
    /// One line for each policy that was in charge.
    fn write_policies(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let names = ["decisions", "commands", "fallbacks", "limited", "p50 (us)", "p99 (us)"];
        write!(formatter, "{:<14}", "policy")?;
        names.iter().try_for_each(|name| write!(formatter, "{name:>10}"))?;
        writeln!(formatter)?;
        for (name, policy) in &self.policies {
            let Tally { decisions, commands, fallbacks, clipped } = policy.tally;
            let counts = [decisions, commands, fallbacks, clipped.range + clipped.slew];
            write!(formatter, "{name:<14}")?;
            counts.iter().try_for_each(|count| write!(formatter, "{count:>10}"))?;
            let Quantiles { count, p50, p99, .. } = policy.decision_us;
            match count {
                0 => writeln!(formatter, "{:>10}{:>10}", "-", "-")?,
                _ => writeln!(formatter, "{p50:>10.1}{p99:>10.1}")?,
            }
        }
        Ok(())
    }
}

/// Counts with their names, in one line.
fn list(counts: &BTreeMap<String, u64>) -> String {
    if counts.is_empty() {
        return " none".into();
    }
    counts.iter().map(|(name, count)| format!(" {name} {count}")).collect()
}
