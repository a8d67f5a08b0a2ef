//! A container in which systemd is the first process, as a host of the units in deploy/.

use std::fs;
use std::path::{Path, PathBuf};

use super::Engine;
use crate::process::programs;
use crate::wait::wait_until;

/// A folder with the programs of the images: those of the deployment, and the router.
///
/// # Panics
/// When a program is not built.
pub fn built_programs(zenohd: &Path) -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("a folder");
    let own = ["heliostat-controller", "heliostat-sim-node"].map(|name| programs().join(name));
    for program in own.iter().map(PathBuf::as_path).chain([zenohd]) {
        let name = if program == zenohd { "zenohd".as_ref() } else { program.file_name().expect("a name") };
        let copied = fs::copy(program, folder.path().join(name));
        copied.unwrap_or_else(|error| panic!("{}: {error}; is it built?", program.display()));
    }
    folder
}

/// The value of a metric without regard to its labels; 0 where it is absent.
pub fn metric(page: &str, name: &str) -> f64 {
    let line = page.lines().find(|line| line.starts_with(&format!("{name}{{")));
    line.and_then(|line| line.rsplit(' ').next()?.parse().ok()).unwrap_or(0.0)
}

/// A container with systemd.
pub struct Host<'a> {
    engine: &'a Engine,
    name: String,
}

impl<'a> Host<'a> {
    /// Starts it in a network of the engine, with the programs of a folder.
    ///
    /// # Panics
    /// When it does not start.
    pub fn start(engine: &'a Engine, name: &str, network: &str, context: &Path) -> Self {
        // As --privileged, which needs a capability that not every machine has.
        let rights =
            ["--cap-add=ALL", "--cap-drop=SYS_RESOURCE", "--security-opt=seccomp=unconfined", "--cgroupns=host"];
        let folders =
            ["--volume=/sys/fs/cgroup:/sys/fs/cgroup:rw", "--tmpfs=/run", "--tmpfs=/run/lock", "--tmpfs=/tmp"];
        let (of_name, of_network) = (format!("--name={name}"), format!("--network={network}"));
        let words = ["run", "--detach", &of_name, "--hostname", name, &of_network, "--env=container=docker"];
        engine.docker(&[&words[..], &rights, &folders, &["systemd", "/lib/systemd/systemd"]].concat());
        let host = Self { engine, name: name.to_owned() };
        wait_until("systemd", || host.shell("systemctl is-system-running || true") == "running");
        host.install(context, "/usr/local/bin/");
        host
    }

    /// Copies the content of a folder into a folder of the host.
    ///
    /// # Panics
    /// When it cannot be copied.
    pub fn install(&self, from: &Path, to: &str) {
        self.shell(&format!("mkdir -p {to}"));
        let from = from.join(".");
        self.engine.docker(&["cp", from.to_str().expect("a plain path"), &format!("{}:{to}", self.name)]);
    }

    /// Runs a script in it, and returns its standard output.
    ///
    /// # Panics
    /// When it fails.
    pub fn shell(&self, script: &str) -> String {
        self.engine.docker(&["exec", &self.name, "bash", "-c", script])
    }

    /// A property of a unit.
    ///
    /// # Panics
    /// When systemd does not answer.
    pub fn property(&self, unit: &str, name: &str) -> String {
        self.shell(&format!("systemctl show --property={name} --value {unit}"))
    }

    /// The metrics at a port of its loopback address; empty where none answer.
    ///
    /// # Panics
    /// When the host does not run.
    pub fn metrics(&self, port: u16) -> String {
        self.shell(&format!(
            "exec 3<>/dev/tcp/127.0.0.1/{port} && printf 'GET /metrics HTTP/1.0\\r\\n\\r\\n' >&3 && cat <&3 || true"
        ))
    }

    /// The number of commands that the array of a room accepted.
    ///
    /// # Panics
    /// When the host does not run.
    pub fn commands(&self, port: u16) -> f64 {
        metric(&self.metrics(port), "heliostat_room_commands_total")
    }
}
