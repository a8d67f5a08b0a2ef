//! Rights of each role in a room, as Zenoh access control.
//!
//! A role is named by the common name of its certificate, `heliostat-ROOM-ROLE`. Zenoh compares
//! complete common names, so each room has its own.
//!
//! # Rules
//! Zenoh applies a rule to a message when the rule's key *includes* the key of the message. A rule
//! that denies `mirrors/command` therefore does not stop a subscription to `**`, and a denial wins
//! over any permission. So the default is denial, and each needed key is allowed.
//!
//! - Ingress rules give the rights of the remote process: a role publishes only its own keys.
//! - Egress rules allow everything of the room: each role may subscribe to all of its room.
//! - Keys that begin with `@`, such as Zenoh's administration space, are in no rule.

use std::fmt;
use std::str::FromStr;

use heliostat_proto::{NodeKind, Room, named};
use serde_json::{Value, json};

named! {
    /// What the holder of a certificate may do in its room.
    pub enum AccessRole {
        /// Reports positions, channel gains, also of branches and LEDs, obstacles and orientations.
        Tracker = "tracker",
        /// Commands the mirrors.
        Controller = "controller",
        /// Drives the mirrors and reports their state.
        Driver = "driver",
        /// A tracker and a driver in one process, which also publishes the truth of its room.
        Simulator = "simulator",
        /// Releases stops and gives orders to controller and simulator.
        Operator = "operator",
        /// Corrects the mounting of the mirrors.
        Calibrator = "calibrator",
        /// Tests a driver: publishes commands, calibrations and re-arms.
        Checker = "checker",
        /// Receives only; may stop the array.
        Viewer = "viewer",
        /// Forwards the messages of all roles. A process trusts it to check their senders.
        Router = "router",
    }
}

/// Every message about which Zenoh has rules, except `delete`: the contract has no deletions.
const ALL_MESSAGES: [&str; 8] = [
    "put",
    "declare_subscriber",
    "query",
    "reply",
    "declare_queryable",
    "liveliness_token",
    "liveliness_query",
    "declare_liveliness_subscriber",
];

/// Messages by which a process receives.
const RECEIVING: [&str; 4] = ["declare_subscriber", "query", "liveliness_query", "declare_liveliness_subscriber"];

impl AccessRole {
    /// Common name of its certificate in a room.
    pub fn common_name(self, room: &Room) -> String {
        format!("{COMMON_NAME_PREFIX}{room}-{self}")
    }

    /// Room and role of a common name; `None` for a name of another form.
    pub fn parse_common_name(name: &str) -> Option<(Room, Self)> {
        let (room, role) = name.strip_prefix(COMMON_NAME_PREFIX)?.rsplit_once('-')?;
        Some((Room::new(room).ok()?, role.parse().ok()?))
    }

    /// Keys on which it may publish.
    pub fn publishes(self, room: &Room) -> Vec<String> {
        let reports =
            || [room.users(), room.channel(), room.obstacles(), room.orientation(), room.branches(), room.leds()];
        let arrays = || [room.array(0), room.later_arrays()];
        let reported = || {
            arrays().into_iter().flat_map(|keys| [keys.telemetry(), keys.capabilities(), keys.safety(), keys.stops()])
        };
        let commands = || arrays().map(|keys| keys.command());
        let calibrations = || arrays().map(|keys| keys.calibration());
        let mut keys = match self {
            Self::Tracker => reports().to_vec(),
            Self::Controller => {
                let own = [room.geometry(NodeKind::Controller), room.belief(), room.controller_memory()];
                commands().into_iter().chain(own).collect()
            }
            Self::Driver => reported().collect(),
            Self::Simulator => {
                let own = [room.truth(), room.geometry(NodeKind::SimNode)];
                reports().into_iter().chain(reported()).chain(own).collect()
            }
            Self::Operator => vec![room.rearm(), room.simulator_control(), room.controller_control()],
            Self::Calibrator => calibrations().to_vec(),
            Self::Checker => commands().into_iter().chain(calibrations()).chain([room.rearm()]).collect(),
            Self::Viewer => Vec::new(),
            Self::Router => return vec![room.everything()],
        };
        // Every process that belongs to the room may stop the arrays, and repeat a stop.
        keys.push(room.stop());
        keys.extend(arrays().map(|keys| keys.stop_repetition()));
        keys.extend(self.nodes().iter().map(|node| room.status(*node)));
        if self.nodes().contains(&NodeKind::Driver) {
            keys.push(room.later_arrays().driver_status());
        }
        keys
    }

    /// Kinds of process that it runs: their status and their liveliness tokens are its own.
    fn nodes(self) -> &'static [NodeKind] {
        match self {
            Self::Tracker => &[NodeKind::Tracker],
            Self::Controller => &[NodeKind::Controller],
            Self::Driver => &[NodeKind::Driver],
            // A replay takes the place of the room's trackers.
            Self::Simulator => &[NodeKind::SimNode, NodeKind::Tracker],
            Self::Operator | Self::Calibrator | Self::Checker | Self::Viewer => &[NodeKind::Viewer],
            Self::Router => &[],
        }
    }

    /// Keys whose queries it answers.
    fn answers(self, room: &Room) -> Vec<String> {
        match self {
            Self::Driver | Self::Simulator => {
                let arrays = [room.array(0), room.later_arrays()];
                arrays.iter().flat_map(|keys| [keys.capabilities(), keys.safety(), keys.stops()]).collect()
            }
            _ => Vec::new(),
        }
    }

    /// Rules for what a process accepts from the holder of this role.
    fn ingress_rules(self, room: &Room) -> Vec<Value> {
        if self == Self::Router {
            return vec![rule(format!("{self} forwards"), "ingress", &ALL_MESSAGES, &[room.everything()])];
        }
        let mut tokens: Vec<String> = self.nodes().iter().map(|node| room.alive_of(*node)).collect();
        if self == Self::Driver {
            tokens.push(room.later_arrays().drivers_alive());
        }
        let mut rules = vec![
            rule(format!("{self} publishes"), "ingress", &["put"], &self.publishes(room)),
            rule(format!("{self} is alive"), "ingress", &["liveliness_token"], &tokens),
        ];
        let answers = self.answers(room);
        if !answers.is_empty() {
            rules.push(rule(format!("{self} answers"), "ingress", &["declare_queryable", "reply"], &answers));
        }
        rules
    }
}

/// Zenoh's `access_control` for a router of several rooms: each process has its rights in its own room,
/// and the routers of the building forward the messages of all rooms.
pub(crate) fn access_control_of(rooms: &[Room]) -> Value {
    let (mut rules, mut subjects, mut policies) = (Vec::new(), Vec::new(), Vec::new());
    let mut forwarded: Vec<Value> = Vec::new();
    for room in rooms {
        let mut own = access_control(room);
        let named = |id: &Value| Value::from(format!("{room}: {}", id.as_str().unwrap_or_default()));
        let mut take = |list: &str| match own[list].take() {
            Value::Array(entries) => entries,
            _ => Vec::new(),
        };
        rules.extend(take("rules").into_iter().map(|mut rule| {
            rule["id"] = named(&rule["id"]);
            rule
        }));
        subjects.extend(take("subjects").into_iter().map(|mut subject| {
            subject["id"] = named(&subject["id"]);
            subject
        }));
        for mut policy in take("policies") {
            let is_router = policy["id"] == AccessRole::Router.name();
            policy["id"] = named(&policy["id"]);
            for list in ["subjects", "rules"] {
                let ids = policy[list].as_array().map(|ids| ids.iter().map(named).collect::<Vec<_>>());
                policy[list] = Value::from(ids.unwrap_or_default());
            }
            if is_router {
                forwarded.extend(policy["rules"].as_array().cloned().unwrap_or_default());
            }
            policies.push((is_router, policy));
        }
    }
    let policies = policies.into_iter().map(|(is_router, mut policy)| {
        if is_router {
            policy["rules"] = Value::from(forwarded.clone());
        }
        policy
    });
    json!({
        "enabled": true,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies.collect::<Vec<Value>>(),
    })
}

/// Zenoh's `access_control` for every process of a room and for its router.
pub fn access_control(room: &Room) -> Value {
    let everything = [room.everything()];
    let shared = [
        rule("all receive".to_owned(), "ingress", &RECEIVING, &everything),
        rule("all are sent to".to_owned(), "egress", &ALL_MESSAGES, &everything),
    ];
    let subject = |role: AccessRole| json!({ "id": role.name(), "cert_common_names": [role.common_name(room)] });
    let policy = |role: AccessRole| {
        let own = role.ingress_rules(room);
        let rules: Vec<&Value> = shared.iter().chain(&own).map(|rule| &rule["id"]).collect();
        json!({ "id": role.name(), "subjects": [role.name()], "rules": rules })
    };
    let own = AccessRole::ALL.iter().flat_map(|role| role.ingress_rules(room));
    json!({
        "enabled": true,
        "default_permission": "deny",
        "rules": shared.iter().cloned().chain(own).collect::<Vec<Value>>(),
        "subjects": AccessRole::ALL.map(subject),
        "policies": AccessRole::ALL.map(policy),
    })
}

fn rule(id: String, flow: &str, messages: &[&str], keys: &[String]) -> Value {
    json!({ "id": id, "permission": "allow", "flows": [flow], "messages": messages, "key_exprs": keys })
}

const COMMON_NAME_PREFIX: &str = "heliostat-";

/// The text is not the name of a role.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("unknown role \"{name}\": expected {}", AccessRole::ALL.map(AccessRole::name).join(", "))]
pub struct UnknownRole {
    /// The text.
    name: String,
}

impl FromStr for AccessRole {
    type Err = UnknownRole;

    fn from_str(name: &str) -> Result<Self, UnknownRole> {
        let found = Self::ALL.into_iter().find(|role| role.name() == name);
        found.ok_or_else(|| UnknownRole { name: name.to_owned() })
    }
}

impl fmt::Display for AccessRole {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.pad(self.name())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_common_name_gives_room_and_role_and_back() {
        let room = Room::new("hall-2_b").expect("a valid name");
        for role in AccessRole::ALL {
            assert_eq!(AccessRole::parse_common_name(&role.common_name(&room)), Some((room.clone(), role)));
        }
        for foreign in
            ["", "heliostat-lab", "heliostat--viewer", "lab-viewer", "heliostat-lab-king", "heliostat-a b-viewer"]
        {
            assert_eq!(AccessRole::parse_common_name(foreign), None, "{foreign}");
        }
    }

    #[test]
    fn every_right_lies_in_the_room_and_the_default_is_denial() {
        let rights = access_control(&Room::new("lab").expect("a valid name"));
        assert_eq!(rights["default_permission"], "deny");
        let rules = rights["rules"].as_array().expect("a list");
        for rule in rules {
            assert_eq!(rule["permission"], "allow", "a denial would win over the rights of other roles: {rule}");
            let keys = rule["key_exprs"].as_array().expect("a list");
            assert!(
                !keys.is_empty()
                    && keys.iter().all(|key| key.as_str().is_some_and(|key| key.starts_with("heliostat/v1/lab/"))),
                "{rule}"
            );
            let messages = rule["messages"].as_array().expect("a list");
            assert!(!messages.contains(&json!("delete")), "{rule}");
        }
        // A room's name is no prefix of another one's keys.
        assert!(!rights.to_string().contains("heliostat/v1/lab*"));
    }
}
