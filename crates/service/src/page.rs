//! The metrics of one moment.

use std::collections::BTreeMap;
use std::fmt;

use prometheus_client::collector::Collector;
use prometheus_client::encoding::text::encode;
use prometheus_client::encoding::{DescriptorEncoder, NoLabelSet};
use prometheus_client::metrics::MetricType;
use prometheus_client::registry::Registry;

use crate::process::usage;

/// Upper ends of the buckets of times, in s: fine around the 0.5 ms budget of a decision, then coarser.
const TIME_BUCKETS_S: [f64; 17] = [
    20e-6, 50e-6, 100e-6, 150e-6, 200e-6, 300e-6, 400e-6, 500e-6, 700e-6, 1e-3, 2e-3, 5e-3, 10e-3, 20e-3, 50e-3, 0.1,
    0.5,
];

/// A distribution of times since the start.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Histogram {
    sum_s: f64,
    /// By bucket, not cumulated; the last one has no upper end.
    counts: [u64; TIME_BUCKETS_S.len() + 1],
}

impl Histogram {
    /// Converts a histogram of times in ns. At the edge of a bucket the precision of that histogram decides.
    pub fn of_ns(times: &hdrhistogram::Histogram<u64>) -> Self {
        let mut histogram = Self { sum_s: times.mean() * 1e-9 * times.len() as f64, ..Self::default() };
        for step in times.iter_recorded() {
            let seconds = step.value_iterated_to() as f64 * 1e-9;
            let bucket = TIME_BUCKETS_S.partition_point(|end| *end < seconds);
            histogram.counts[bucket] += step.count_at_value();
        }
        histogram
    }

    fn buckets(&self) -> Vec<(f64, u64)> {
        let ends = TIME_BUCKETS_S.into_iter().chain([f64::INFINITY]);
        ends.zip(self.counts).collect()
    }
}

#[derive(Clone, Debug, PartialEq)]
enum Value {
    Counter(u64),
    Gauge(f64),
    Histogram(Histogram),
}

impl Value {
    fn metric_type(&self) -> MetricType {
        match self {
            Self::Counter(_) => MetricType::Counter,
            Self::Gauge(_) => MetricType::Gauge,
            Self::Histogram(_) => MetricType::Histogram,
        }
    }
}

type Labels = Vec<(String, String)>;

#[derive(Clone, Debug)]
struct Family {
    name: &'static str,
    help: &'static str,
    samples: Vec<(Labels, Value)>,
}

/// The metrics of one moment. Names carry their unit; a counter is written with `_total` after its name.
#[derive(Clone, Debug, Default)]
pub struct Page {
    families: Vec<Family>,
    common: Labels,
}

impl Page {
    /// An empty page; every sample gets the common labels.
    pub fn new(common: &[(&str, &str)]) -> Self {
        Self { families: Vec::new(), common: owned(common) }
    }

    /// From now on samples get these common labels.
    pub fn set_common(&mut self, common: &[(&str, &str)]) {
        self.common = owned(common);
    }

    /// Adds a count since the start.
    pub fn counter(&mut self, name: &'static str, help: &'static str, labels: &[(&str, &str)], value: u64) {
        self.add(name, help, labels, Value::Counter(value));
    }

    /// Adds a current value.
    pub fn gauge(&mut self, name: &'static str, help: &'static str, labels: &[(&str, &str)], value: f64) {
        self.add(name, help, labels, Value::Gauge(value));
    }

    /// Adds whether something holds at present, as 1 or 0.
    pub fn flag(&mut self, name: &'static str, help: &'static str, labels: &[(&str, &str)], is_set: bool) {
        self.gauge(name, help, labels, f64::from(u8::from(is_set)));
    }

    /// Adds a distribution of times in s since the start.
    pub fn histogram(&mut self, name: &'static str, help: &'static str, labels: &[(&str, &str)], value: Histogram) {
        self.add(name, help, labels, Value::Histogram(value));
    }

    /// Adds `heliostat_build_info` with the version and the name of the process; its value is always 1.
    /// Adds the present usage of memory, files and threads under the standard names of Prometheus.
    pub fn build_info(&mut self, process: &str, version: &str) {
        let labels = [("process", process), ("version", version)];
        self.gauge("heliostat_build_info", "Name and version of the process; the value is always 1", &labels, 1.0);
        let Some(usage) = usage() else { return };
        let gauges = [
            ("process_resident_memory_bytes", "Resident memory of the process in bytes", usage.resident_bytes),
            ("process_open_fds", "Open file descriptors of the process", usage.files),
            ("process_threads", "Threads of the process", usage.threads),
        ];
        for (name, help, value) in gauges {
            self.gauge(name, help, &[], value as f64);
        }
    }

    /// Adds for a process with mirrors whether its emergency stop is on the disk.
    pub fn stop_recorded(&mut self, labels: &[(&str, &str)], is_recorded: bool) {
        let help = "1 while the state of the emergency stop is on the disk, 0 after a write that failed";
        self.flag("heliostat_stop_recorded", help, labels, is_recorded);
    }

    /// Adds for a process with mirrors the state of an array, by its name.
    pub fn array_state(&mut self, labels: &[(&str, &str)], state: &str) {
        let labels = [labels, &[("state", state)]].concat();
        self.gauge("heliostat_array_state_info", "State of the array; the value is always 1", &labels, 1.0);
    }

    /// Adds for a process with mirrors the commands that its arrays accepted, and what they refused by its reason.
    pub fn commands(&mut self, accepted: u64, clipped: u64, refused: &BTreeMap<String, u64>) {
        self.counter("heliostat_room_commands", "Commands that the array accepted", &[], accepted);
        let help = "Accepted commands with an angle beyond the range";
        self.counter("heliostat_room_commands_clipped", help, &[], clipped);
        let help = "Payloads and commands refused, by reason";
        for (reason, count) in refused {
            self.counter("heliostat_room_refused", help, &[("reason", reason.as_str())], *count);
        }
    }

    /// The page as text.
    pub fn text(&self) -> String {
        let mut registry = Registry::default();
        registry.register_collector(Box::new(self.clone()));
        let mut text = String::new();
        encode(&mut text, &registry).expect("a string takes whatever it is given");
        text
    }

    fn add(&mut self, name: &'static str, help: &'static str, labels: &[(&str, &str)], value: Value) {
        let labels = self.common.iter().cloned().chain(owned(labels)).collect();
        match self.families.iter_mut().find(|family| family.name == name) {
            Some(family) => family.samples.push((labels, value)),
            None => self.families.push(Family { name, help, samples: vec![(labels, value)] }),
        }
    }
}

impl Collector for Page {
    fn encode(&self, mut encoder: DescriptorEncoder) -> fmt::Result {
        for family in &self.families {
            let Some((_, first)) = family.samples.first() else { continue };
            let mut metric = encoder.encode_descriptor(family.name, family.help, None, first.metric_type())?;
            for (labels, value) in &family.samples {
                let mut sample = metric.encode_family(labels)?;
                match value {
                    Value::Counter(count) => sample.encode_counter::<NoLabelSet, _, u64>(count, None)?,
                    Value::Gauge(value) => sample.encode_gauge(value)?,
                    Value::Histogram(histogram) => {
                        let count = histogram.counts.iter().sum();
                        sample.encode_histogram::<NoLabelSet>(histogram.sum_s, count, &histogram.buckets(), None)?;
                    }
                }
            }
        }
        Ok(())
    }
}

fn owned(labels: &[(&str, &str)]) -> Labels {
    labels.iter().map(|(name, value)| ((*name).to_owned(), (*value).to_owned())).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_page_reads_as_open_metrics() {
        let mut times =
            hdrhistogram::Histogram::<u64>::new_with_bounds(1, 60_000_000_000, 3).expect("constants in range");
        for ns in [10_000, 450_000, 450_000, 2_000_000_000] {
            times.record(ns).expect("within the bounds");
        }
        let mut page = Page::new(&[("room", "a")]);
        page.counter("heliostat_misses", "Late decisions", &[("cause", "infer")], 3);
        page.counter("heliostat_misses", "Late decisions", &[("cause", "observe")], 0);
        page.gauge("heliostat_rate_bps", "Rate", &[], 1.5e6);
        page.histogram("heliostat_decision_seconds", "Decision", &[], Histogram::of_ns(&times));
        page.build_info("test", "1.2.3");
        page.array_state(&[("array", "mirrors-1")], "stopped");
        let text = page.text();
        for wanted in [
            "# TYPE heliostat_misses counter\nheliostat_misses_total{room=\"a\",cause=\"infer\"} 3\nheliostat_misses_total{room=\"a\",cause=\"observe\"} 0\n",
            "heliostat_rate_bps{room=\"a\"} 1500000.0\n",
            "heliostat_array_state_info{room=\"a\",array=\"mirrors-1\",state=\"stopped\"} 1.0\n",
            "heliostat_decision_seconds_count{room=\"a\"} 4\n",
            "heliostat_decision_seconds_bucket{le=\"0.0004\",room=\"a\"} 1\n",
            "heliostat_decision_seconds_bucket{le=\"0.0005\",room=\"a\"} 3\n",
            "heliostat_decision_seconds_bucket{le=\"0.5\",room=\"a\"} 3\n",
            "heliostat_decision_seconds_bucket{le=\"+Inf\",room=\"a\"} 4\n",
            "heliostat_build_info{room=\"a\",process=\"test\",version=\"1.2.3\"} 1.0\n",
            #[cfg(target_os = "linux")]
            "\nprocess_resident_memory_bytes{room=\"a\"} ",
        ] {
            assert!(text.contains(wanted), "{wanted} is not in\n{text}");
        }
        assert!(text.ends_with("# EOF\n"));
        assert_eq!(text.matches("# TYPE heliostat_misses ").count(), 1, "one description a name");
    }
}
