//! One run of `heliostat-lab reproduce`: checks, computation of the parts, report.

use std::io::IsTerminal;
use std::io::Write;
use std::path::Path;
use std::time::Duration;

use anyhow::{Result, ensure};
use heliostat_learn::networks::on_one_thread;
use heliostat_service::exit::{self, UnusableInput};
use heliostat_service::{outln, whole_file};
use indicatif::{ProgressBar, ProgressStyle};

use crate::args::{ReproduceArgs, command_of_report};
use crate::claims::claims;
use crate::document;
use crate::figures::finished_parts::Done;
use crate::figures::{self, Kind};
use crate::part::Part;
use crate::plan::Room;
use crate::progress::Progress;
use crate::report::{LeftOut, Meta, Report, Source, duration_text};
use crate::store::{Origin, Store};
use crate::{files, machine};

/// Runs the command.
///
/// # Errors
/// An unwritable folder, an invalid scenario or figure, or a missing actor, before any part is
/// computed; then an error of a part. Parts finished before remain stored. Standard output that cannot be written.
pub fn run_reproduce(args: ReproduceArgs, progress: &Progress) -> Result<()> {
    let report = reproduce(&args, progress)?;
    let kept = report.parts.iter().filter(|part| part.kept).count();
    let page = args.out.join(files::REPORT);
    if args.json {
        let summary = serde_json::json!({
            "page": page, "parts": report.parts.len(), "kept": kept, "claims": report.claims, "left_out": report.left_out, "meta": report.meta,
        });
        outln!("{summary}")?;
        return Ok(());
    }
    for claim in &report.claims {
        outln!("{} (paper: {})", claim.statement, claim.paper)?;
        for finding in &claim.findings {
            outln!("  {:<17} {}: {}; {}", finding.room, finding.verdict.words(), finding.ours, finding.why)?;
        }
    }
    for left_out in &report.left_out {
        outln!("{} in room {}: {}", left_out.figure, left_out.room, left_out.why)?;
    }
    outln!("{}: {} parts, {kept} of them from an earlier run", page.display(), report.parts.len())?;
    Ok(())
}

/// Computes the missing parts and writes the report.
///
/// # Errors
/// As [`run_reproduce`].
pub fn reproduce(args: &ReproduceArgs, progress: &Progress) -> Result<Report> {
    let effort = args.effort();
    let plan = args.plan(effort);
    let rooms = args.rooms().map_err(exit::unusable)?;
    let (chosen, mut left_out) = args.choose(&rooms).map_err(exit::unusable)?;
    let mut figures: Vec<(Kind, &Room, Vec<Part>)> = Vec::new();
    for (kind, room) in chosen {
        figures.push((kind, room, kind.parts(room, &plan).map_err(exit::unusable)?));
    }
    let store = Store::open(&args.out)?;
    if let Some(folder) = &args.write_docs {
        let expected = || format!("--write-docs {}: expected an existing folder", folder.display());
        ensure!(folder.is_dir(), UnusableInput::new(expected()));
    }
    let mut done: Vec<(Kind, &Room, Vec<Done>)> = Vec::new();
    if args.finished {
        for (kind, room, parts) in figures {
            let all = parts.len();
            let found: Vec<Done> = parts.into_iter().filter_map(|part| found(&store, part)).collect();
            if found.len() < all {
                let why = format!("{} of its {all} parts are not finished", all - found.len());
                left_out.push(LeftOut { figure: kind.id().into(), room: room.name.clone(), why });
            }
            if !found.is_empty() {
                done.push((kind, room, found));
            }
        }
    } else {
        let bar = estimate(&store, &figures, progress)?;
        for (kind, room, parts) in figures {
            let parts = parts.into_iter().map(|part| finish(&store, part, (&bar, progress)));
            let parts = parts.collect::<Result<_>>()?;
            done.push((kind, room, parts));
        }
        bar.finish_and_clear();
    }
    let figures: Vec<_> = done.iter().map(|(kind, room, parts)| kind.figure(room, parts)).collect();
    let parts: Vec<Origin> =
        done.iter().flat_map(|(_, _, parts)| parts).map(|(_, finished)| finished.origin.clone()).collect();
    let report = Report {
        meta: meta(args, &parts),
        claims: claims(&figures),
        figures,
        left_out,
        sources: Source::of(&parts),
        parts,
    };
    files::write(&report, &args.out)?;
    if let Some(folder) = &args.write_docs {
        write_docs(&report, folder)?;
    }
    Ok(report)
}

/// Prints the number of parts and the estimated time; the progress bar counts the estimated time.
fn estimate(store: &Store, figures: &[(Kind, &Room, Vec<Part>)], progress: &Progress) -> Result<ProgressBar> {
    let (mut count, mut missing, mut cost_s) = (0, 0, 0.0);
    for part in figures.iter().flat_map(|(_, _, parts)| parts) {
        count += 1;
        if store.find(part)?.is_none() {
            missing += 1;
            cost_s += part.cost_s;
        }
    }
    drop(writeln!(
        std::io::stderr(),
        "{count} parts, {} of them finished; the others take about {} of one core",
        count - missing,
        duration_text(cost_s)
    ));
    let bar = ProgressBar::new((1e3 * cost_s) as u64);
    bar.set_style(ProgressStyle::with_template("{bar:32} {percent} %, {eta} left  {msg}")?);
    bar.enable_steady_tick(Duration::from_millis(200));
    progress.start(count - missing, count, &bar);
    Ok(bar)
}

fn found(store: &Store, part: Part) -> Option<Done> {
    let finished = store.find(&part).ok()??;
    Some((part, finished))
}

fn finish(store: &Store, part: Part, (bar, progress): (&ProgressBar, &Progress)) -> Result<Done> {
    if let Some(finished) = store.find(&part)? {
        return Ok((part, finished));
    }
    bar.set_message(part.label());
    let finished = on_one_thread(|| store.compute(&part, figures::compute))??;
    if !std::io::stderr().is_terminal() {
        drop(writeln!(std::io::stderr(), "{}: {:.1} s", part.label(), finished.origin.cpu_s));
    }
    bar.inc((1e3 * part.cost_s) as u64);
    progress.finish_part();
    Ok((part, finished))
}

fn meta(args: &ReproduceArgs, parts: &[Origin]) -> Meta {
    let effort = args.effort();
    Meta {
        version: env!("CARGO_PKG_VERSION").into(),
        commits: commits(parts),
        made: machine::now(),
        machine: machine::hardware(),
        command: command_of_report(args),
        effort: match args.quick {
            true => "quick",
            false if effort.is_full() => "full",
            false => "reduced",
        }
        .into(),
        first_seed: args.seed,
        seeds: effort.seeds,
        training_seeds: effort.training_seeds,
        episodes: effort.episodes,
        cpu_s: parts.iter().map(|part| part.cpu_s).sum(),
    }
}

/// Each commit once.
fn commits(parts: &[Origin]) -> Vec<String> {
    let mut commits: Vec<String> = parts.iter().map(|part| part.commit.clone()).collect();
    commits.sort_unstable();
    commits.dedup();
    commits
}

fn write_docs(report: &Report, folder: &Path) -> Result<()> {
    let report = document::reduced(report);
    whole_file::write(&folder.join("reproduction.json"), document::json(&report)?.as_bytes())?;
    whole_file::write(&folder.join("reproduction.md"), document::markdown(&report, false).as_bytes())
}
