//! `heliostat calibrate`: measures the mirrors, the LEDs and the tracker's frame of a running room,
//! over the messages of the contract alone; and brings the result to a running driver.

mod apply;
mod args;
mod commander;
mod conditions;
mod files;
mod idle;
mod interruption;
mod readings;
mod refinement;
mod remaining;
mod room;
mod show;
mod status;

use std::path::Path;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail, ensure};
use heliostat_array::calibration::check_corrections;
use heliostat_array::calibration_file::CalibrationFile;
use heliostat_bus::{AccessRole, Bus};
use heliostat_calibrate::{Outcome, Prior, Session, Setup, Stage};
use heliostat_proto::Stamp;
use heliostat_scenario::{ChannelMode, Scenario};
use heliostat_service::clock::utc_ns;
use heliostat_service::exit::UnusableInput;
use heliostat_service::output::note;
use heliostat_service::whole_file;

use super::join::check_connected;
pub use args::Args;
use args::Step;
use interruption::Watchdog;
use readings::Readings;
use refinement::Refinement;
use remaining::Remaining;
use room::{LiveRoom, Received};

/// Longest wait for a report before the session looks at its own times again.
const LOOK_EVERY: Duration = Duration::from_millis(20);

/// Time between two files of readings, and two lines of progress.
const SAVE_EVERY: Duration = Duration::from_secs(2);
const SHOW_EVERY: Duration = Duration::from_secs(5);

/// Time without channel reports after which a note says so.
const SILENCE: Duration = Duration::from_secs(3);

/// A slow process that is there accepts a connection within this time.
const CONNECTED_WITHIN: Duration = Duration::from_secs(5);

/// Relative error of an axis' scale that is expected where scales are estimated.
const SCALE_SPREAD: f64 = 0.01;

/// Runs the command.
///
/// # Errors
/// An invalid flag or file, a room that does not answer, another controller that leads, an array that
/// is stopped, and a calibration that does not improve the light. Those of [`apply::run`] where it follows.
pub fn run(mut args: Args) -> Result<()> {
    match args.step.take() {
        Some(Step::Apply(apply)) => apply::run(&apply),
        None => measure(args),
    }
}

fn measure(args: Args) -> Result<()> {
    let scenario = args.scenario.load_arrays()?;
    ensure!(
        scenario.channel.mode == ChannelMode::Specular,
        UnusableInput::new(format!("channel.mode = \"{}\": expected \"specular\"", scenario.channel.mode.name()))
    );
    conditions::conditions(&scenario, args.array, &args.spots(&scenario)?).iter().for_each(note);
    let _held = files::hold(&args)?;
    let file = args.base.as_deref().filter(|file| *file != Path::new("none"));
    let base = file.map(heliostat_driver::calibration_store::load).transpose()?;
    let config = args.bus.config_or_connect(&[AccessRole::Controller])?;
    let stop = args.end.stop()?;
    let bus = Bus::open(&config)?;
    if config.listen.is_empty() {
        check_connected(&bus, &config, CONNECTED_WITHIN).map_err(anyhow::Error::msg)?;
    }
    let mut room = LiveRoom::open(&bus, &args, &scenario)?;
    ensure!(
        room.calibration_in_use() == 0 || args.base.is_some(),
        "the array uses a calibration already: give its file with --base, so that the result includes it; or \
         --base none, if it is the one without effect that `heliostat driver check` leaves"
    );
    ensure!(
        room.calibration_in_use() != 0 || base.is_none(),
        "the array uses no calibration, and --base names one: start its driver with this file, or leave --base out"
    );
    if let Some(base) = &base {
        base.check_array(room.capabilities()).context("in --base")?;
    }
    let readings = Readings::new(args.readings.as_deref(), (bus.room(), &scenario), (args.array, base.as_ref()));
    // The log of an earlier session is estimated too.
    let watchdog = Watchdog::start(&stop, args.end.seconds, args.readings.as_deref());
    let mut refinement = match (&args.refine, &base, args.user) {
        (Some(file), Some(base), Some(user)) => Some(Refinement::new(user, readings.load_former(file)?, base)?),
        (Some(_), ..) => bail!(UnusableInput::new("--base none: expected the file of the calibration to refine")),
        (None, ..) => None,
    };
    let mut session = new_session(&args, &scenario, &room, refinement.as_ref())?;
    if let Some(log) = readings.load()? {
        note(format_args!("continued: {} spots complete, {} readings", log.complete, log.readings.len()));
        session.resume(log).with_context(|| readings.unusable())?;
    }
    // Only now, so that no refused file or flag takes the room from its controller.
    if refinement.is_none() {
        room.take()?;
    }
    let run = drive(&args, (&mut session, &readings), (&mut room, refinement.as_mut()), &stop);
    let saved = readings.save(&session);
    room.release();
    drop(watchdog);
    run?;
    saved?;
    let outcome = session.outcome().with_context(|| interruption::advice(args.readings.as_deref()))?;
    // A refinement includes the calibration in use, because it measures as the former calibration did.
    let measured_with = refinement.as_ref().map(Refinement::measured_with).or(base.as_ref());
    match args.refine {
        Some(_) => finish_refinement(&args, &scenario, outcome, measured_with)?,
        None => finish(&args, &scenario, outcome, measured_with)?,
    }
    Ok(bus.close()?)
}

fn new_session(args: &Args, scenario: &Scenario, room: &LiveRoom, refinement: Option<&Refinement>) -> Result<Session> {
    let mut prior = Prior::of_level(args.level);
    prior.scale = if args.scales { SCALE_SPREAD } else { 0.0 };
    let setup = Setup {
        model: scenario.channel_model()?,
        room: scenario.room.clone(),
        array: args.array,
        capabilities: match refinement {
            Some(refinement) => refinement.capabilities(room.capabilities().clone()),
            None => room.capabilities().clone(),
        },
        prior,
        spots: args.spots(scenario)?,
        verify: args.verification(scenario)?,
        user: args.user,
        unusable: room.unusable(),
    };
    let mut session = Session::new(setup)?;
    if let Some(refinement) = refinement {
        refinement.start(&mut session)?;
    }
    Ok(session)
}

/// Passes reports to the session and its commands to the array, until it ends or the process shall.
fn drive(
    args: &Args,
    (session, readings): (&mut Session, &Readings<'_>),
    (room, mut refinement): (&mut LiveRoom, Option<&mut Refinement>),
    stop: &heliostat_service::Stop,
) -> Result<()> {
    let begun = Instant::now();
    let mut user = args.user;
    let (mut saved, mut shown, mut published) = (begun, begun, None::<Instant>);
    // Time that was waited since the last channel report; an estimate takes time too.
    let mut waited = Duration::ZERO;
    let (mut stage, mut complete) = (None, session.log().complete);
    let (mut lines, mut remaining) = (show::Changing::default(), Remaining::default());
    let mut position = show::SteadyPosition::default();
    while session.stage() != Stage::Ended {
        if stop.is_requested() || args.end.seconds.is_some_and(|limit| begun.elapsed() >= limit) {
            return Ok(());
        }
        if stage != Some(session.stage()) && show::is_stage_said(session.stage(), room.is_commanding()) {
            stage = Some(session.stage());
            show::stage(session);
            let progress = session.log().complete;
            if progress != complete {
                complete = progress;
                readings.save(session)?;
            }
        }
        if let Some(confirmed_ns) = room.take_again()? {
            session.handle_pause(confirmed_ns);
            note("a controller had taken the lead: the calibration has taken it again");
        }
        let now = utc_ns();
        let wake = Duration::from_nanos(session.next_wake(now).saturating_sub(now)).min(LOOK_EVERY);
        let waits = Instant::now();
        let (at, received) = room.receive(wake)?.map_or_else(|| (Instant::now(), None), |(at, it)| (at, Some(it)));
        waited += waits.elapsed();
        match received {
            Some(Received::Users(report)) => {
                if user.is_none() {
                    let ids: Vec<u32> = report.users.iter().map(|user| user.user).collect();
                    ensure!(
                        ids.len() <= 1,
                        "the tracker reports the users {ids:?}: name the one who holds the receiver with --user"
                    );
                    // A user who enters later holds no receiver.
                    user = ids.first().copied();
                    user.into_iter().for_each(|user| session.set_user(user));
                }
                if let Some(refinement) = &mut refinement {
                    refinement.handle_users(at, &report);
                }
                session.handle_users(&report);
            }
            Some(Received::Channel(report)) => {
                waited = Duration::ZERO;
                // Without the lead the light is that of another controller's angles.
                if room.is_commanding() && !room.has_lost_lead() {
                    session.handle_channel(&report);
                }
            }
            Some(Received::CommandDelay(delay_ns)) => session.handle_command_delay(delay_ns),
            None => {}
        }
        // A pause or a search can make it due without a report.
        if session.is_estimate_due() {
            readings.save(session)?;
            status::run_estimate(session, room, &mut remaining)?;
            published = None;
        }
        if let Some(refinement) = &mut refinement {
            refinement.take_turns(at, session, room)?;
        }
        // A pause just before can make an estimate due again: the next round makes it, beside its status.
        if room.is_commanding()
            && !session.is_estimate_due()
            && let Some(angles) = session.next_command(utc_ns())
        {
            room.command(match &refinement {
                Some(refinement) => refinement.turned(angles),
                None => angles,
            })?;
        }
        if published.is_none_or(|at| at.elapsed() >= status::EVERY) {
            published = Some(Instant::now());
            room.publish_status(&status::progress(session, &mut remaining))?;
        }
        if saved.elapsed() >= SAVE_EVERY {
            saved = Instant::now();
            readings.save(session)?;
        }
        if shown.elapsed() >= SHOW_EVERY {
            shown = Instant::now();
            let waits_for = refinement.as_mut().and_then(|refinement| refinement.waits_for(at, session));
            let waits = waits_for.map(|cause| format!("waits until the room has been idle for some seconds: {cause}"));
            let silent = (waited >= SILENCE)
                .then(|| "no channel report for some seconds: is the receiver switched on?".to_owned());
            let mut progress = session.progress();
            remaining.follow(&mut progress, session.group()).iter().for_each(note);
            let carried =
                show::waits_for_receiver(session, &mut position).into_iter().chain(show::impossible_gains(session));
            let present = [show::progress(&progress)].into_iter().chain(carried).chain(waits).chain(silent);
            lines.changed(present.collect()).iter().for_each(note);
        }
    }
    Ok(())
}

/// Writes the files if the verification allows it, and prints the result.
fn finish(args: &Args, scenario: &Scenario, outcome: &Outcome, base: Option<&CalibrationFile>) -> Result<()> {
    let is_improvement = outcome.verification.is_improvement();
    let written = is_improvement.then(|| write(args, scenario, outcome, base));
    // Also where a file could not be written: the measurement took its time.
    show::outcome(args, outcome, matches!(written, Some(Ok(()))))?;
    written.transpose()?;
    if !is_improvement {
        bail!(
            "the calibrated aims give {} times the light of the nominal ones at the place of the verification: \
             expected an interval above 1. Nothing is written; repeat with another spot, or check the heights",
            show::plus_minus(&outcome.verification.ratio(), 3)
        );
    }
    Ok(())
}

/// The same for a refinement: without a mirror that has turned there is nothing to write.
fn finish_refinement(
    args: &Args,
    scenario: &Scenario,
    outcome: &Outcome,
    measured_with: Option<&CalibrationFile>,
) -> Result<()> {
    ensure!(
        outcome.rejected_places.len() < args.spots(scenario)?.len(),
        "most mirrors contradict the former calibration at every spot: an LED or the tracker was moved, or a height \
         is wrong. Nothing is written; check the heights, then calibrate without --refine"
    );
    let has_turned = outcome.changes.iter().any(|change| change.turned_deg.is_some());
    let is_improvement = has_turned && outcome.verification.is_improvement();
    let written = is_improvement.then(|| write(args, scenario, outcome, measured_with));
    show::refinement(args, outcome, matches!(written, Some(Ok(()))))?;
    written.transpose()?;
    if has_turned && !is_improvement {
        bail!(
            "the new aims of the mirrors that have turned give {} times the light of the former ones: expected an \
             interval above 1. Nothing is written; repeat with another spot",
            show::plus_minus(&outcome.verification.ratio(), 3)
        );
    }
    Ok(())
}

/// Writes the result, if a driver and a controller can use it: all files, or none.
fn write(args: &Args, scenario: &Scenario, outcome: &Outcome, base: Option<&CalibrationFile>) -> Result<()> {
    let own = outcome.calibration();
    let file = base.map_or(own.clone(), |base| own.after(base));
    check_corrections(&file.message(Stamp::default()))
        .context("a driver would refuse the result: align this mirror by hand, and repeat. Nothing is written")?;
    let mut measured = outcome.measured_room(scenario, args.array);
    // The file may be in another folder than the scenario.
    let absolute =
        |trace: String| std::path::absolute(&trace).map_or(trace, |path| path.to_string_lossy().into_owned());
    measured.users.trace = measured.users.trace.map(absolute);
    let room = args.room_out.as_ref().map(|path| (path, measured.to_toml()));
    if let Some((_, text)) = &room {
        let unusable =
            "the measured room is no scenario: repeat without --room-out, or check the heights. Nothing is written";
        Scenario::from_toml(text).context(unusable)?;
    }
    let out = args.out.as_ref().context("no --out: nothing is written")?;
    heliostat_driver::calibration_store::save(&file, out)?;
    let Some((path, text)) = room else { return Ok(()) };
    whole_file::write(path, text.as_bytes()).inspect_err(|_| {
        // The command began without this file. A calibration without its room would be half a result.
        drop(std::fs::remove_file(out));
    })
}
