//! The files of a Zenoh router that serves several rooms with keys.
//!
//! Each room keeps an authority of its own, so the router listens at one endpoint for each room, with
//! the certificates of that room. The rights of all rooms are one table. Two such routers connect by
//! the certificate of the first room, and forward the messages of all rooms to each other.
//!
//! # Trust
//! A common name gives rights wherever it connects. The router thus trusts the authority of each of
//! its rooms not to sign the names of another one.

use std::net::IpAddr;
use std::path::{Path, PathBuf};

use heliostat_files::read_text;
use heliostat_proto::Room;

use crate::access::{AccessRole, access_control_of};
use crate::certificate::Certificate;
use crate::config::{BusConfig, make_router, nested_json};
use crate::error::{BusError, KeyError};
use crate::keys::{PRIVATE, PUBLIC, ROUTER_CONFIGURATION, create_folder, replace};
use crate::tls::{AUTHORITY_CERTIFICATE, Identity, certificate_file, key_file, tls_settings};

/// Encrypted protocols.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Protocol {
    /// TLS over TCP.
    #[default]
    Tls,
    /// QUIC over UDP.
    Quic,
}

impl Protocol {
    fn name(self) -> &'static str {
        match self {
            Self::Tls => "tls",
            Self::Quic => "quic",
        }
    }
}

/// What a router for several rooms needs to know.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BuildingRouter {
    /// A folder with the keys of role `router` for each room.
    pub folders: Vec<PathBuf>,
    /// Folder in which the router finds its files on its machine.
    pub installed: PathBuf,
    /// Protocol of all connections.
    pub protocol: Protocol,
    /// Port of the first room; each further room has the next one.
    pub first_port: u16,
    /// `HOST:PORT` of other routers of the building, with the port of the first room.
    pub peers: Vec<String>,
}

/// The endpoint of a room at a router.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RoomEndpoint {
    /// The room.
    pub room: Room,
    /// Port at which its processes connect.
    pub port: u16,
}

impl BuildingRouter {
    /// Writes `router.json5`, and `ROOM-ca.pem`, `ROOM-router.pem` and `ROOM-router.key` of each room, in place of
    /// older ones.
    ///
    /// # Errors
    /// [`KeyError`]: keys that cannot be used, a room that is named twice, a peer that the keys do not name, a path
    /// that an endpoint cannot hold, or files that cannot be written.
    pub fn write(&self, out: &Path) -> Result<Vec<RoomEndpoint>, BusError> {
        let identities: Vec<Identity> = self
            .folders
            .iter()
            .map(|folder| Identity::load(folder, &[AccessRole::Router]))
            .collect::<Result<_, _>>()?;
        let rooms: Vec<Room> = identities.iter().map(|identity| identity.room().clone()).collect();
        let first = identities.first().ok_or(BusError::NoEndpoint)?;
        if let Some(twice) = (1..rooms.len()).find(|index| rooms[..*index].contains(&rooms[*index])) {
            return Err(KeyError::SameRoom { room: rooms[twice].to_string() }.into());
        }
        self.check_peers(first)?;
        // These would end the path within an endpoint.
        if self.installed.display().to_string().contains([';', '#', '=', '?']) {
            return Err(KeyError::UnusablePath { path: self.installed.clone() }.into());
        }
        let endpoints: Vec<RoomEndpoint> = rooms
            .iter()
            .zip(self.first_port..=u16::MAX)
            .map(|(room, port)| RoomEndpoint { room: room.clone(), port })
            .collect();
        if endpoints.len() < rooms.len() {
            return Err(KeyError::NoPort { rooms: rooms.len(), first: self.first_port }.into());
        }
        let text = self.configuration(first, &rooms, &endpoints)?;
        create_folder(out)?;
        replace(&out.join(ROUTER_CONFIGURATION), &text, PUBLIC)?;
        for identity in &identities {
            let copies = [
                (identity.folder().join(AUTHORITY_CERTIFICATE), file(identity.room(), AUTHORITY_CERTIFICATE), PUBLIC),
                (identity.certificate(), file(identity.room(), &certificate_file(AccessRole::Router)), PUBLIC),
                (identity.private_key(), file(identity.room(), &key_file(AccessRole::Router)), PRIVATE),
            ];
            for (from, to, mode) in copies {
                let text = read_text(&from)
                    .map_err(|error| KeyError::CannotRead { path: from, problem: error.to_string() })?;
                replace(&out.join(to), &text, mode)?;
            }
        }
        Ok(endpoints)
    }

    /// Checks that the certificates of the first room name the other routers, which have them too.
    fn check_peers(&self, first: &Identity) -> Result<(), BusError> {
        let hosts = Certificate::read(&first.certificate())?.hosts;
        for peer in &self.peers {
            let host = peer.rsplit_once(':').map_or(peer.as_str(), |(host, _)| host);
            let host = host.trim_start_matches('[').trim_end_matches(']');
            let address: Option<IpAddr> = host.parse().ok();
            let is_address = |known: &String| address.is_some() && known.parse().ok() == address;
            if !hosts.iter().any(|known| known.eq_ignore_ascii_case(host) || is_address(known)) {
                let (folder, host, hosts) = (first.folder().into(), host.to_owned(), hosts.join(", "));
                return Err(KeyError::UnnamedHost { folder, host, hosts }.into());
            }
        }
        Ok(())
    }

    fn configuration(&self, first: &Identity, rooms: &[Room], endpoints: &[RoomEndpoint]) -> Result<String, BusError> {
        let protocol = self.protocol.name();
        let base = BusConfig::new(first.room().clone()).secured_by(first.clone());
        let base = base.listen_at(&format!("{protocol}/0.0.0.0:{}", self.first_port));
        let peers = self.peers.iter().map(|peer| format!("{protocol}/{peer}"));
        let base = BusConfig { connect: peers.collect(), ..base };
        let mut settings = base.settings()?;
        let of_first = tls_settings(
            &self.installed_file(first.room(), AUTHORITY_CERTIFICATE),
            &self.installed_file(first.room(), &certificate_file(AccessRole::Router)),
            &self.installed_file(first.room(), &key_file(AccessRole::Router)),
        );
        settings.retain(|(key, _)| !of_first.iter().any(|(own, _)| own == key));
        settings.extend(of_first);
        make_router(&mut settings);
        let listen: Vec<String> = endpoints.iter().map(|endpoint| self.listen_endpoint(endpoint)).collect();
        for (key, value) in &mut settings {
            match key.as_str() {
                "listen/endpoints" => *value = serde_json::json!(listen).to_string(),
                "access_control" => *value = access_control_of(rooms).to_string(),
                _ => {}
            }
        }
        let names: Vec<String> = rooms.iter().map(Room::to_string).collect();
        Ok(format!(
            "// Zenoh configuration of a router for the rooms {}: zenohd --config FILE\n\
             // `heliostat keys router` made it. Its files belong in {}.\n{}\n",
            names.join(", "),
            self.installed.display(),
            nested_json(&settings)?
        ))
    }

    /// The endpoint at which the processes of a room connect, with the certificates of the room.
    fn listen_endpoint(&self, RoomEndpoint { room, port }: &RoomEndpoint) -> String {
        let path = |name: &str| self.installed_file(room, name).display().to_string();
        format!(
            "{}/0.0.0.0:{port}#root_ca_certificate_file={};listen_certificate_file={};listen_private_key_file={}",
            self.protocol.name(),
            path(AUTHORITY_CERTIFICATE),
            path(&certificate_file(AccessRole::Router)),
            path(&key_file(AccessRole::Router)),
        )
    }

    fn installed_file(&self, room: &Room, name: &str) -> PathBuf {
        self.installed.join(file(room, name))
    }
}

/// Name of a room's file in the folder of the router.
fn file(room: &Room, name: &str) -> String {
    format!("{room}-{name}")
}
