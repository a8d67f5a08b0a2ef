//! What a page shows, and where its orders go.

use std::hash::{DefaultHasher, Hash, Hasher};
use std::sync::Arc;

use heliostat_scenario::Scenario;
use serde::Serialize;

use crate::View;
use crate::orders::Operator;
use crate::scene::Plan;
use crate::shown_room::GeometrySource;

/// The data of the page and its connection to the room.
pub struct Page {
    /// The messages of the room.
    pub view: Arc<View>,
    /// Sends orders.
    pub operator: Operator,
    /// Name of the room in the keys.
    pub room: String,
    /// The policies that a controller of a scenario accepts.
    pub policies: PoliciesOf,
    /// The file of a network that the user gave; `None` without one.
    pub network: Option<NetworkFile>,
}

/// The file of a network. A controller reports its hash alone.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct NetworkFile {
    /// The hash, as in the status of a controller.
    pub hash: String,
    /// The name of the file, without its folder.
    pub name: String,
}

/// The policies that fit a scenario.
pub type PoliciesOf = Box<dyn Fn(&Scenario) -> Vec<PolicyChoice> + Send + Sync>;

/// A policy that the operator can choose.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct PolicyChoice {
    /// Its name in an order.
    pub name: String,
    /// What it does, in one line.
    pub description: String,
}

impl Page {
    /// Identifies this server and its room: it changes with a new process, and with the plan. The
    /// process that announces the geometry may change: an open page keeps its last picture.
    pub(crate) fn id(&self) -> String {
        let mut hasher = DefaultHasher::new();
        self.operator.source().hash(&mut hasher);
        // Serialization of a plan cannot fail: it holds only numbers, texts and lists.
        let plan = Plan { geometry_source: GeometrySource::Default, ..self.view.plan(&self.room) };
        serde_json::to_string(&plan).unwrap_or_default().hash(&mut hasher);
        format!("{:016x}", hasher.finish())
    }
}
