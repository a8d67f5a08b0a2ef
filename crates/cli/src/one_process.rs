//! A controller and an array in one process: a position report reaches the device over one socket.
//!
//! Each of the two has its session, and the array has a thread of its own: it handles stops while a
//! policy does not return. The sessions exchange everything that the contract specifies, over a link of
//! this process or over the router of both. Only the controller's commands take the short way; other
//! controllers command the array through its session.

use std::thread::{self, JoinHandle};

use anyhow::{Context, Result, anyhow};
use heliostat_bus::{AccessRole, BusConfig, Identity, Role, free_loopback_port, private_endpoint};
use heliostat_controller::cli::Prepared;
use heliostat_controller::report::summary::Summary;
use heliostat_controller::room_runtime::transport::{LocalArray, TakeCommand};
use heliostat_driver::direct_commands::DirectCommands;
use heliostat_driver::run::{ArrayDriver, RunError, Settings};
use heliostat_driver::summary::Summary as DriverSummary;
use heliostat_driver::{Device, Kit};
use heliostat_service::Stop;

/// The session of the array beside that of the controller; `listen` are endpoints of its own.
///
/// Clients of a router meet there. Peers get a link: the controller's session then connects to an
/// endpoint of the array's session that no other process knows.
///
/// # Errors
/// The keys of the controller's folder lack the role of a driver, or no endpoint is free.
pub fn array_session(controller: &mut BusConfig, listen: &[String]) -> Result<BusConfig> {
    let identity = controller.identity.as_ref().map(|identity| identity.of_role(AccessRole::Driver));
    let identity: Option<Identity> = identity.transpose().context("--driver needs the keys of a driver too")?;
    let mut array = BusConfig { identity, listen: listen.to_vec(), ..controller.clone() };
    if array.role == Role::Peer {
        let link = match array.identity {
            Some(_) => format!("tls/127.0.0.1:{}", free_loopback_port()?),
            None => private_endpoint()?,
        };
        array.listen.push(link.clone());
        controller.connect.push(link);
    }
    array.check()?;
    Ok(array)
}

/// Runs both until the controller ends; `entry` may wrap the entry of the commands.
///
/// # Errors
/// One of them cannot start, or the session of the array fails.
pub fn run<D: Device + Send + 'static>(
    controller: &Prepared,
    kit: Kit<D>,
    settings: &Settings,
    entry: impl FnOnce(DirectCommands<D>) -> TakeCommand,
) -> Result<(Summary, DriverSummary)> {
    let driver = ArrayDriver::open(kit, settings, &controller.stop).context("the driver cannot start")?;
    let Some(driver) = driver else { return Ok(Default::default()) };
    let local = LocalArray {
        array: settings.array,
        take_command: entry(driver.direct_commands()),
        is_recorded: driver.is_recorded(),
    };
    let array = ArrayThread::start(driver, &controller.stop)?;
    let summary = controller.run(vec![local]);
    // Also after an error of the controller: its thread sends the device to no new angles.
    let driven = array.end();
    Ok((summary?, driven?))
}

/// The thread of the array.
struct ArrayThread {
    stop: Stop,
    thread: JoinHandle<Result<DriverSummary, RunError>>,
}

/// Ends the controller when the array's thread ends, also by a panic.
struct EndsController(Stop);

impl Drop for EndsController {
    fn drop(&mut self) {
        self.0.request();
    }
}

impl ArrayThread {
    fn start<D: Device + Send + 'static>(driver: ArrayDriver<D>, controller: &Stop) -> Result<Self> {
        let (stop, ends) = (Stop::default(), EndsController(controller.clone()));
        let until = stop.clone();
        let run = move || {
            let _ends = ends;
            driver.run(None, &until)
        };
        let thread =
            thread::Builder::new().name("array".into()).spawn(run).context("cannot start the array's thread")?;
        Ok(Self { stop, thread })
    }

    fn end(self) -> Result<DriverSummary> {
        self.stop.request();
        let ended = self.thread.join().map_err(|_| anyhow!("the array's thread has panicked"))?;
        ended.context("the driver has failed")
    }
}
