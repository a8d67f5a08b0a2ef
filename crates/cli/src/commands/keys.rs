//! `heliostat keys`: makes, renews and lists the certificates of a room.

use std::path::{Path, PathBuf};

use anyhow::Result;
use heliostat_bus::{AccessRole, BuildingRouter, BusError, Certificate, Protocol, RoomEndpoint, keys};
use heliostat_proto::Room;
use serde_json::{Value, json};

use heliostat_service::outln;

/// Make, renew and list the certificates of a room, for --tls.
///
/// A folder of keys holds the authority of one room (ca.pem, ca.key). For each role it holds a
/// certificate, a private key and a configuration for Zenoh (zenoh-ROLE.json5). A process with
/// --tls DIR has the rights of its role in DIR. Keep ca.key on one machine: with it anyone can make
/// certificates.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, clap::Subcommand)]
enum Action {
    /// Make the authority of a room, and the keys of every role
    Init {
        /// Name of the room
        #[arg(long, value_name = "NAME")]
        room: Room,
        /// The folder of keys; it is created, and may not hold keys
        #[arg(long, value_name = "DIR")]
        out: PathBuf,
        #[command(flatten)]
        terms: TermsArgs,
        /// Print the certificates as one JSON object
        #[arg(long)]
        json: bool,
    },
    /// Make the keys of one role, for one machine
    Issue {
        /// Role that gives the rights
        #[arg(long, value_name = "ROLE")]
        role: AccessRole,
        /// The folder of keys with the authority
        #[arg(long, value_name = "DIR")]
        dir: PathBuf,
        /// The folder to write, to be copied to the machine; without it the folder of the authority
        #[arg(long, value_name = "DIR")]
        out: Option<PathBuf>,
        #[command(flatten)]
        terms: TermsArgs,
        /// Print the certificates in the folder as one JSON object
        #[arg(long)]
        json: bool,
    },
    /// Replace all certificates of a folder by new ones for the same roles and hosts
    ///
    /// Restart the processes that listen afterwards: they keep the certificate of their start.
    Renew {
        /// The folder of keys with the authority
        #[arg(long, value_name = "DIR")]
        dir: PathBuf,
        /// The folder whose certificates are replaced; without it the folder of the authority
        #[arg(long, value_name = "DIR")]
        out: Option<PathBuf>,
        #[command(flatten)]
        days: DaysArgs,
        /// Print the certificates in the folder as one JSON object
        #[arg(long)]
        json: bool,
    },
    /// Write the files of a router that serves several rooms
    ///
    /// The router listens at one port for each room, in the order of --dir. It needs the router's
    /// keys of each room, and trusts each of their authorities for all of its rooms. After a renewal of
    /// these keys the same command replaces the files.
    Router {
        /// A folder with the router's keys of a room (repeatable)
        #[arg(long, value_name = "DIR", required = true)]
        dir: Vec<PathBuf>,
        /// The folder to write, to be copied to the machine of the router
        #[arg(long, value_name = "DIR")]
        out: PathBuf,
        /// Where that machine has the folder, if it is another path
        #[arg(long, value_name = "DIR")]
        installed: Option<PathBuf>,
        /// Port of the first room; each further room has the next one
        #[arg(long, value_name = "PORT", default_value_t = 7448)]
        port: u16,
        /// Another router of the building, with its port of the first room (repeatable)
        #[arg(long, value_name = "HOST:PORT")]
        peer: Vec<String>,
        /// QUIC over UDP in place of TLS over TCP, for all connections
        #[arg(long)]
        quic: bool,
        /// Print the ports as one JSON object
        #[arg(long)]
        json: bool,
    },
    /// List the certificates of a folder: names, roles, hosts, expiry
    Show {
        /// The folder of keys
        #[arg(long, value_name = "DIR")]
        dir: PathBuf,
        /// Print the certificates as one JSON object
        #[arg(long)]
        json: bool,
    },
}

#[derive(Debug, clap::Args)]
struct TermsArgs {
    /// Host name or address at which the holder may listen (repeatable), apart from loopback
    #[arg(long, value_name = "HOST")]
    host: Vec<String>,
    #[command(flatten)]
    days: DaysArgs,
}

#[derive(Debug, clap::Args)]
struct DaysArgs {
    /// Validity of a certificate in days. Certificates cannot be revoked: a lost key is of use
    /// until then
    #[arg(long, value_name = "N", default_value_t = keys::DEFAULT_DAYS, value_parser = clap::value_parser!(u32).range(1..=825))]
    days: u32,
}

impl TermsArgs {
    fn terms(&self) -> keys::Terms {
        keys::Terms::of_days(self.days.days, &self.host)
    }
}

/// As many days before the end of a certificate, `heliostat doctor` and `heliostat status` name it, and the alerts fire.
const ENDS_SOON_DAYS: i64 = 14;

/// The certificate of a folder that ends first, in words, and whether that is soon.
///
/// # Errors
/// A file that cannot be read or is no certificate.
pub fn first_end(folder: &Path) -> Result<Option<(String, bool)>, BusError> {
    let certificates = keys::list(folder)?;
    let first = certificates.iter().min_by_key(|(_, certificate)| certificate.days_left());
    Ok(first.map(|(role, certificate)| {
        let (days, expires, folder) = (certificate.days_left(), &certificate.expires, folder.display());
        let found = format!("that of the {role} in {folder} ends first: on {expires}, days left {days}");
        (found, days <= ENDS_SOON_DAYS)
    }))
}

/// Runs the subcommand.
pub fn run(args: Args) -> Result<()> {
    let (folder, json) = match args.action {
        Action::Init { room, out, terms, json } => {
            keys::init(&room, &out, &terms.terms())?;
            (out, json)
        }
        Action::Issue { role, dir, out, terms, json } => {
            let out = out.unwrap_or_else(|| dir.clone());
            keys::issue(role, &dir, &out, &terms.terms())?;
            (out, json)
        }
        Action::Renew { dir, out, days, json } => {
            let out = out.unwrap_or_else(|| dir.clone());
            keys::renew(&dir, &out, keys::end_after(days.days))?;
            (out, json)
        }
        Action::Router { dir, out, installed, port, peer, quic, json } => {
            let protocol = if quic { Protocol::Quic } else { Protocol::Tls };
            let installed = match installed {
                Some(installed) => installed,
                None => std::path::absolute(&out)?,
            };
            let router = BuildingRouter { folders: dir, installed, protocol, first_port: port, peers: peer };
            return show_router(&out, &router.write(&out)?, json);
        }
        Action::Show { dir, json } => (dir, json),
    };
    show(&folder, json)
}

fn show(folder: &Path, json: bool) -> Result<()> {
    let certificates = keys::list(folder)?;
    if json {
        let certificates: Vec<Value> =
            certificates.iter().map(|(role, certificate)| document(*role, certificate)).collect();
        outln!("{}", json!({ "folder": folder, "certificates": certificates }))?;
        return Ok(());
    }
    outln!("{:<11} {:<34} {:<11} {:>5}  hosts", "role", "name", "expires", "days")?;
    for (role, certificate) in &certificates {
        outln!("{}", row(*role, certificate))?;
    }
    Ok(())
}

/// A line of the list. Days below 0 are those since the expiry.
fn row(role: AccessRole, certificate: &Certificate) -> String {
    let Certificate { common_name, expires, hosts, valid_from, .. } = certificate;
    let (days, hosts) = (certificate.days_left(), hosts.join(", "));
    let later = match certificate.is_not_yet_valid() {
        true => format!("  not valid before {valid_from}: set the clock of this machine, or issue it again"),
        false => String::new(),
    };
    format!("{role:<11} {common_name:<34} {expires:<11} {days:>5}  {hosts}{later}")
}

fn show_router(folder: &Path, endpoints: &[RoomEndpoint], json: bool) -> Result<()> {
    if json {
        let rooms: Vec<Value> = endpoints
            .iter()
            .map(|RoomEndpoint { room, port }| json!({ "room": room.to_string(), "port": port }))
            .collect();
        outln!("{}", json!({ "folder": folder, "rooms": rooms }))?;
        return Ok(());
    }
    outln!("{:<24} port", "room")?;
    for RoomEndpoint { room, port } in endpoints {
        outln!("{:<24} {port}", room.to_string())?;
    }
    Ok(())
}

fn document(role: AccessRole, certificate: &Certificate) -> Value {
    json!({
        "role": role.name(),
        "room": certificate.room_and_role().map(|(room, _)| room.to_string()),
        "name": certificate.common_name,
        "hosts": certificate.hosts,
        "valid_from": certificate.valid_from,
        "expires": certificate.expires,
        "days_left": certificate.days_left(),
    })
}

#[cfg(test)]
mod tests {
    use std::time::{Duration, SystemTime};

    use super::*;

    #[test]
    fn a_certificate_that_is_not_valid_yet_says_so_in_its_row() {
        let day = Duration::from_secs(86_400);
        let room = Room::new("studio").expect("a valid name");
        let later =
            keys::Terms { hosts: Vec::new(), from: SystemTime::now() + 2 * day, until: SystemTime::now() + 9 * day };
        for (terms, is_later) in [(later, true), (keys::Terms::of_days(9, &[]), false)] {
            let folder = tempfile::tempdir().expect("a folder");
            keys::init(&room, folder.path(), &terms).expect("an empty folder");
            for (role, certificate) in keys::list(folder.path()).expect("certificates") {
                assert_eq!(certificate.days_left(), 9, "as it was asked for");
                let stated = format!("not valid before {}", certificate.valid_from);
                let row = row(role, &certificate);
                assert_eq!(row.contains(&stated), is_later, "{row}");
                assert_eq!(document(role, &certificate)["valid_from"], certificate.valid_from.as_str());
            }
        }
    }
}
