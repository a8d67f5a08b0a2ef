//! What a controller shows of itself: reports, counters, figures, the last observation and the
//! belief.

use heliostat_proto::{BeliefReport, Nanos, gauges::TrackerNoise};

use super::Controller;
use crate::{
    belief::{Belief, innovations::Innovations, light::LightWatch},
    input::inbox::Inbox,
    observe::{observation::Observation, observer::Observer},
    output::outcome::Counters,
    policy::{Policy, PolicyError, Tally},
};

impl Controller {
    /// The latest reports, and the counters of refusals.
    pub fn inbox(&self) -> &Inbox {
        &self.inbox
    }

    /// Counters since the start.
    pub fn counters(&self) -> &Counters {
        &self.counters
    }

    /// The policy in charge.
    pub fn policy(&self) -> &dyn Policy {
        self.policy.policy()
    }

    /// The name and the counts of each policy since the start.
    pub fn tallies(&self) -> &[(String, Tally)] {
        self.policy.tallies.all()
    }

    /// The last failure of the policy.
    pub fn last_failure(&self) -> Option<&PolicyError> {
        self.policy.last_failure()
    }

    /// How well the belief's predictions agreed with the reports; absent where `control.belief`
    /// names no filter.
    pub fn innovations(&self) -> Option<Innovations> {
        self.observer.belief().map(Belief::innovations)
    }

    /// The noise of the tracker; absent where `control.belief` names no filter.
    pub fn tracker_noise(&self) -> Option<TrackerNoise> {
        self.observer.belief().map(|belief| {
            let ([position_m, velocity_m_s], stated) = (belief.noise(), belief.stated_noise());
            let [position_stated_m, velocity_stated_m_s] = stated;
            TrackerNoise { position_m, position_stated_m, velocity_m_s, velocity_stated_m_s }
        })
    }

    /// How the light of served users compares with the expected one; absent where `control.belief` names
    /// no filter.
    pub fn light(&self) -> Option<&LightWatch> {
        self.observer.belief().map(Belief::light)
    }

    /// The last observation, with the angles of the last command.
    pub fn observation(&self) -> &Observation {
        &self.observation
    }

    /// Fills a report with the belief about the users in the decision that was polled last, at
    /// `now`; its stamp is the caller's. False, without a change, where `control.belief` names no
    /// filter. Does not allocate in a report with memory for all users.
    pub fn report_beliefs(&self, now: Nanos, report: &mut BeliefReport) -> bool {
        self.observer.report_beliefs(&self.model, &self.inbox, (&self.observation, now), report)
    }

    /// What fills the observation: the belief of the filter, and the headings of the users.
    pub fn observer(&self) -> &Observer {
        &self.observer
    }
}
