//! A container engine of its own for a test: `dockerd` with its data in a temporary folder and its
//! networks in a network namespace, and base images made by `debootstrap`, because a test reaches no
//! image registry.

use std::fs;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::{Mutex, MutexGuard};

use heliostat_service::locks::lock;
use tempfile::TempDir;

use crate::process::programs;
use crate::wait::wait_until;

mod host;

pub use host::{Host, built_programs, metric};

/// The Debian release of the base images in deploy/container/Containerfile.
const RELEASE: &str = "bookworm";

/// A running engine; its containers, images and networks end with it.
pub struct Engine {
    daemon: Child,
    folder: TempDir,
    /// The words before the arguments of compose.
    compose: Vec<&'static str>,
    _alone: MutexGuard<'static, ()>,
}

/// Engines share the archive of the base image: a test process has one at a time.
static ALONE: Mutex<()> = Mutex::new(());

impl Engine {
    /// Starts an engine.
    ///
    /// # Panics
    /// When it is impossible.
    pub fn start() -> Self {
        Self::compose_words().and_then(Self::started).unwrap_or_else(|reason| panic!("{reason}"))
    }

    fn started(compose: Vec<&'static str>) -> Result<Self, String> {
        let alone = lock(&ALONE);
        let folder = tempfile::tempdir().expect("a folder");
        let path = |name: &str| folder.path().join(name);
        let log = fs::File::create(path("log")).expect("a log");
        // A new engine sets up the firewall, and deletes the bridge docker0 of another one: both are
        // those of its own network namespace. The shell replaces itself, so the id is dockerd's.
        let mut daemon = Command::new("unshare");
        daemon.args(["--net", "sh", "-c", "ip link set lo up && exec dockerd \"$@\"", "dockerd"]);
        daemon.arg("--data-root").arg(path("data")).arg("--exec-root").arg(path("exec"));
        daemon.arg("--pidfile").arg(path("pid")).arg("--host").arg(format!("unix://{}", path("socket").display()));
        // Compose makes networks of its own, and the default one could be another engine's.
        daemon.arg("--bridge=none").stdin(Stdio::null()).stdout(Stdio::null()).stderr(log);
        let mut engine = Self { daemon: daemon.spawn().expect("dockerd starts"), folder, compose, _alone: alone };
        let mut has_ended = false;
        wait_until("dockerd", || {
            has_ended = engine.daemon.try_wait().is_ok_and(|status| status.is_some());
            has_ended || runs(engine.command("docker").arg("info"))
        });
        if has_ended {
            let log = fs::read_to_string(engine.folder.path().join("log")).unwrap_or_default();
            return Err(format!("dockerd cannot run here: {}", log.lines().last().unwrap_or_default()));
        }
        let network = |process: &str| fs::read_link(format!("/proc/{process}/ns/net")).expect("a network namespace");
        assert_ne!(network(&engine.daemon.id().to_string()), network("self"), "dockerd shares the network of the test");
        Ok(engine)
    }

    /// How compose is called, or why no engine can run here.
    fn compose_words() -> Result<Vec<&'static str>, String> {
        let is_root = fs::metadata("/proc/self").is_ok_and(|own| own.uid() == 0);
        if !is_root {
            return Err("dockerd and debootstrap need root".into());
        }
        let programs = [
            ("dockerd", "docker.io"),
            ("docker", "docker.io"),
            ("debootstrap", "debootstrap"),
            ("unshare", "util-linux"),
            ("nsenter", "util-linux"),
        ];
        for (program, package) in programs {
            if !runs(Command::new(program).arg("--version")) {
                return Err(format!("there is no {program} (Debian's package {package})"));
            }
        }
        let ways = [vec!["docker", "compose"], vec!["docker-compose"]];
        let found = ways.into_iter().find(|words| runs(Command::new(words[0]).args(&words[1..]).arg("version")));
        found.ok_or_else(|| "there is no compose (Debian's package docker-compose)".into())
    }

    /// The program and arguments that start another program in the network of the engine, where the
    /// published ports of its containers are.
    pub fn wrapper(&self) -> [String; 2] {
        ["nsenter".into(), format!("--net=/proc/{}/ns/net", self.daemon.id())]
    }

    /// The answer to a request for a path at a port of the loopback address in the network of the
    /// engine; `None` if the port is closed.
    pub fn get(&self, port: &str, path: &str) -> Option<String> {
        let [program, network] = self.wrapper();
        let script = format!(
            "exec 3<>/dev/tcp/127.0.0.1/{port} && \
             printf 'GET {path} HTTP/1.0\\r\\nHost: 127.0.0.1:{port}\\r\\n\\r\\n' >&3 && cat <&3"
        );
        let answer = Command::new(program).args([&network, "bash", "-c", &script]).output().ok()?;
        answer.status.success().then(|| String::from_utf8_lossy(&answer.stdout).into_owned())
    }

    /// A base image of Debian with systemd, under this name; made once, and kept in the target
    /// folder.
    ///
    /// # Panics
    /// When it cannot be made.
    pub fn import_base(&self, name: &str) {
        let file = base().unwrap_or_else(|reason| panic!("{reason}"));
        self.docker(&["import", file.to_str().expect("a plain path"), name]);
    }

    /// Runs `docker` with these arguments, and returns its standard output.
    ///
    /// # Panics
    /// When it fails.
    pub fn docker(&self, arguments: &[&str]) -> String {
        let output = self.command("docker").args(arguments).output().expect("docker runs");
        text("docker", arguments, &output)
    }

    /// Builds the images of deploy/container from a folder that holds their programs; the base image
    /// has the name of the Debian release.
    ///
    /// # Panics
    /// When a build fails.
    pub fn build_images(&self, context: &Path) {
        let file = crate::process::workspace().join("deploy/container/Containerfile");
        for service in ["router", "sim-node", "controller"] {
            let tag = format!("heliostat-{service}");
            let words = ["build", "--build-arg", "RUST_IMAGE=debian:bookworm-slim", "--target", service, "--tag", &tag];
            let place = ["--file", file.to_str().expect("a plain path"), context.to_str().expect("a plain path")];
            self.docker(&[&words[..], &place].concat());
        }
    }

    /// Runs compose for deploy/container/compose.yaml with these arguments and environment variables.
    ///
    /// # Panics
    /// When it fails.
    pub fn compose(&self, variables: &[(&str, String)], arguments: &[&str]) -> String {
        self.compose_file("heliostat", "deploy/container/compose.yaml", variables, arguments)
    }

    /// The same for a project and a file of the repository.
    ///
    /// # Panics
    /// When it fails.
    pub fn compose_file(&self, project: &str, file: &str, variables: &[(&str, String)], arguments: &[&str]) -> String {
        let file = crate::process::workspace().join(file);
        let mut command = self.command(self.compose[0]);
        command.args(&self.compose[1..]).args(["-p", project, "-f"]).arg(file).args(arguments);
        let output = command.envs(variables.iter().cloned()).output().expect("compose runs");
        text("compose", arguments, &output)
    }

    fn command(&self, program: &str) -> Command {
        let mut command = Command::new(program);
        command.env("DOCKER_HOST", format!("unix://{}", self.folder.path().join("socket").display()));
        // The old builder: the new one is a package of its own for some clients.
        command.env("DOCKER_BUILDKIT", "0");
        command
    }
}

impl Drop for Engine {
    fn drop(&mut self) {
        // The network bridges of the engine end with its containers and networks. Errors have no
        // effect on the result of the test.
        let all = self.command("docker").args(["ps", "--all", "--quiet"]).output();
        let all = all.map(|output| String::from_utf8_lossy(&output.stdout).into_owned()).unwrap_or_default();
        let _ = self.command("docker").args(["rm", "--force", "--volumes"]).args(all.split_whitespace()).output();
        let _ = self.command("docker").args(["network", "prune", "--force"]).output();
        let _ = Command::new("kill").arg(self.daemon.id().to_string()).status();
        let _ = self.daemon.wait();
    }
}

/// The router `zenohd` that HELIOSTAT_ZENOHD names, or the one on the path.
///
/// # Panics
/// When there is none.
pub fn zenohd() -> PathBuf {
    let named = std::env::var_os("HELIOSTAT_ZENOHD").map(PathBuf::from);
    let path = std::env::var_os("PATH").unwrap_or_default();
    let found =
        named.or_else(|| std::env::split_paths(&path).map(|folder| folder.join("zenohd")).find(|file| file.is_file()));
    let is_it = found.filter(|file| runs(Command::new(file).arg("--version")));
    is_it.expect("zenohd on the path or named by HELIOSTAT_ZENOHD: docs/deploy.md has the command that builds it")
}

/// The archive of the base image.
fn base() -> Result<PathBuf, String> {
    let archive = programs().join("../tmp").join(format!("heliostat-{RELEASE}.tar"));
    if archive.is_file() {
        return Ok(archive);
    }
    let folder = tempfile::tempdir().map_err(|error| error.to_string())?;
    let root = folder.path().join(RELEASE);
    let mut make = Command::new("debootstrap");
    make.args(["--variant=minbase", "--include=systemd,dbus", RELEASE]).arg(&root);
    let output = make.output().map_err(|error| error.to_string())?;
    if !output.status.success() {
        let last = String::from_utf8_lossy(&output.stdout).lines().last().unwrap_or_default().to_owned();
        return Err(format!("debootstrap cannot make a base image: {last}"));
    }
    pack(&root, &archive)
}

/// Packs a folder; a file that is not complete never has the name of the archive.
fn pack(root: &Path, archive: &Path) -> Result<PathBuf, String> {
    let part = archive.with_extension("part");
    fs::create_dir_all(archive.parent().expect("a folder")).map_err(|error| error.to_string())?;
    let packed =
        Command::new("tar").arg("--create").arg("--file").arg(&part).arg("--directory").arg(root).arg(".").status();
    match packed {
        Ok(status) if status.success() => fs::rename(&part, archive).map_err(|error| error.to_string())?,
        _ => return Err("tar cannot pack the base image".into()),
    }
    Ok(archive.to_path_buf())
}

fn runs(command: &mut Command) -> bool {
    command.output().is_ok_and(|output| output.status.success())
}

fn text(program: &str, arguments: &[&str], output: &Output) -> String {
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{program} {arguments:?}: {errors}");
    String::from_utf8_lossy(&output.stdout).trim().to_owned()
}
