//! Publishes the truth of the room with reference rates, the status of the simulator, and the
//! geometry of the room.
//!
//! In live operation this runs on a separate thread, so that the oracle does not delay a tick.

use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::thread::JoinHandle;
use std::time::Instant;

use heliostat_proto::gauges::OracleRate;
use heliostat_proto::{NodeStatus, RoomGeometry, RoomTruth, Stamp, TruthUser};
use heliostat_room::baselines::{Baselines, Measured, RateCounters, Snapshot};
use heliostat_room::reports;
use heliostat_room::world::World;
use heliostat_service::{Exporter, Page};

use crate::error::NodeError;
use crate::metrics;
use crate::session::{RoomSession, ViewerPublishers};

/// Capacity for jobs of the thread; beyond it a job is skipped and counted.
const JOBS_MAX: usize = 4;

/// Status messages for each announcement of the geometry, which is due once a second.
const GEOMETRY_EVERY: u64 = 2;

/// Computes the reference rates and publishes truth, status and metrics.
pub(crate) struct TruthPublisher {
    baselines: Baselines,
    counters: RateCounters,
    cost_s: f64,
    source: u64,
    publishers: ViewerPublishers,
    /// Its stamp is that of the last publication.
    geometry: RoomGeometry,
    exporter: Option<Exporter>,
    /// The latest computed instant.
    measured: Option<Measured>,
    /// The users' rates with the angles of the oracle at that instant.
    oracle: Vec<OracleRate>,
    truth_sequence: u64,
    status_sequence: u64,
}

/// The results of all computed instants.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Measurements {
    pub counters: RateCounters,
    /// Mean time to compute one instant, in s.
    pub mean_cost_s: f64,
}

impl TruthPublisher {
    /// `geometry` is that of the scenario, as TOML.
    pub fn new(
        world: &World,
        session: &RoomSession,
        geometry: String,
        exporter: Option<Exporter>,
    ) -> Result<Self, NodeError> {
        Ok(Self {
            baselines: Baselines::new(world),
            counters: RateCounters::default(),
            cost_s: 0.0,
            source: session.source(),
            publishers: session.viewer_publishers()?,
            geometry: RoomGeometry { scenario: geometry, ..RoomGeometry::default() },
            exporter,
            measured: None,
            oracle: Vec::new(),
            truth_sequence: 0,
            status_sequence: 0,
        })
    }

    /// Computes an instant and publishes it; the instant counts once the array has accepted a
    /// command.
    pub fn truth(&mut self, at: &Snapshot) -> Result<&Measured, NodeError> {
        let begun = Instant::now();
        let measured = self.baselines.measure(at);
        if at.commanded {
            self.counters.add(measured);
            self.cost_s += begun.elapsed().as_secs_f64();
        }
        let of_user = |(user, bps): (&u32, &f64)| OracleRate { user: *user, mbps: bps * 1e-6 };
        self.oracle = at.ids.iter().zip(&measured.oracle_rates_bps).map(of_user).collect();
        if self.exporter.is_some() {
            self.measured = Some(measured.clone());
        }
        self.truth_sequence += 1;
        let stamp = Stamp { source: self.source, sequence: self.truth_sequence, time_ns: at.time_ns };
        self.publishers.truth.encode(&room_truth(stamp, at, measured))?.put()?;
        Ok(measured)
    }

    /// Publishes a status and, if they are served, metrics; adds the present rates to both.
    pub fn status(&mut self, (mut status, page): (NodeStatus, Option<Page>)) -> Result<(), NodeError> {
        if let (Some(exporter), Some(mut page)) = (&self.exporter, page) {
            if let Some(measured) = &self.measured {
                metrics::add_rates(&mut page, measured);
            }
            exporter.publish(page);
        }
        self.status_sequence += 1;
        status.stamp.source = self.source;
        status.stamp.sequence = self.status_sequence;
        let mean = self.counters.mean_sum_rates_bps();
        let rates = [
            ("policy_mbps", mean.policy),
            ("no_irs_mbps", mean.no_irs),
            ("flat_mbps", mean.flat),
            ("oracle_mbps", mean.oracle),
        ];
        // Without an instant there is no mean.
        let rates = rates.into_iter().filter(|_| self.counters.samples > 0);
        status.gauges.extend(rates.map(|(name, bps)| (name.to_owned(), bps * 1e-6)));
        status.gauges.extend(self.oracle.iter().map(OracleRate::gauge));
        if self.status_sequence % GEOMETRY_EVERY == 1 {
            self.announce_geometry(status.stamp.time_ns)?;
        }
        Ok(self.publishers.status.encode(&status)?.put()?)
    }

    fn announce_geometry(&mut self, time_ns: u64) -> Result<(), NodeError> {
        let sequence = self.geometry.stamp.sequence + 1;
        self.geometry.stamp = Stamp { source: self.source, sequence, time_ns };
        Ok(self.publishers.geometry.encode(&self.geometry)?.put()?)
    }

    pub fn measurements(&self) -> Measurements {
        Measurements { counters: self.counters, mean_cost_s: self.cost_s / self.counters.samples.max(1) as f64 }
    }

    /// Continues on a separate thread.
    pub fn into_thread(self) -> PublisherThread {
        let (sender, jobs) = sync_channel(JOBS_MAX);
        let thread = std::thread::spawn(move || self.work(&jobs));
        PublisherThread { sender, thread, skipped: 0 }
    }

    fn work(mut self, jobs: &Receiver<Job>) -> Result<Measurements, NodeError> {
        for job in jobs {
            match job {
                Job::Truth(snapshot) => {
                    self.truth(&snapshot)?;
                }
                Job::Status(status) => self.status(*status)?,
            }
        }
        Ok(self.measurements())
    }
}

/// A job of the thread.
enum Job {
    Truth(Box<Snapshot>),
    Status(Box<(NodeStatus, Option<Page>)>),
}

/// A truth publisher on its own thread.
pub(crate) struct PublisherThread {
    sender: SyncSender<Job>,
    thread: JoinHandle<Result<Measurements, NodeError>>,
    skipped: u64,
}

impl PublisherThread {
    /// Queues the computation of an instant; does not wait.
    pub fn truth(&mut self, snapshot: Snapshot) {
        self.send(Job::Truth(Box::new(snapshot)));
    }

    /// Queues a status; does not wait.
    pub fn status(&mut self, status: (NodeStatus, Option<Page>)) {
        self.send(Job::Status(Box::new(status)));
    }

    /// Instants and statuses that were skipped because the queue was full.
    pub fn skipped(&self) -> u64 {
        self.skipped
    }

    /// Whether the thread has failed; [`PublisherThread::finish`] returns the error.
    pub fn has_failed(&self) -> bool {
        self.thread.is_finished()
    }

    /// Finishes the queued jobs and ends the thread.
    pub fn finish(self) -> Result<Measurements, NodeError> {
        drop(self.sender);
        self.thread.join().map_err(|_| NodeError::TruthPublisherPanicked)?
    }

    fn send(&mut self, job: Job) {
        match self.sender.try_send(job) {
            Ok(()) => {}
            Err(TrySendError::Full(_) | TrySendError::Disconnected(_)) => self.skipped += 1,
        }
    }
}

fn room_truth(stamp: Stamp, at: &Snapshot, measured: &Measured) -> RoomTruth {
    let user = |user: usize| TruthUser {
        user: at.ids[user],
        position_m: [at.positions[user].x as f32, at.positions[user].y as f32, at.positions[user].z as f32],
        heading_rad: at.headings[user] as f32,
        los_blocked: measured.los_blocked[user],
        forced: at.forced[user],
        los_gain: measured.los_gain[user] as f32,
        irs_gain: measured.irs_gain[user] as f32,
        sinr: measured.sinr[user] as f32,
        rate_bps: measured.rates_bps[user] as f32,
        min_rate_bps: at.min_rate_bps[user] as f32,
    };
    RoomTruth {
        stamp,
        tick: at.tick,
        users: (0..at.positions.len()).map(user).collect(),
        obstacles: at.blockers[..at.obstacles].iter().map(reports::obstacle).collect(),
        sum_rate_bps: measured.sum_rates_bps,
    }
}
