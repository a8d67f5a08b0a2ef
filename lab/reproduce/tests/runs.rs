//! Complete small runs: their files, the reuse of parts, and the refusals before the start.

use std::fs;
use std::path::Path;

use clap::Parser;
use heliostat_reproduce::figures::{self, Kind, outage};
use heliostat_reproduce::report::Report;
use heliostat_reproduce::store::Store;
use heliostat_reproduce::verdict::Verdict;
use heliostat_reproduce::{Progress, ReproduceArgs, run};

#[derive(Parser)]
struct Command {
    #[command(flatten)]
    args: ReproduceArgs,
}

fn args(what: &str, out: &Path, more: &[&str]) -> ReproduceArgs {
    let out = out.display().to_string();
    Command::parse_from([&["reproduce", what, "--out", &out, "--quick"], more].concat()).args
}

fn reproduce(args: &ReproduceArgs) -> anyhow::Result<Report> {
    run::reproduce(args, &Progress::default())
}

fn refusal(what: &str, out: &Path, more: &[&str]) -> String {
    format!("{:#}", reproduce(&args(what, out, more)).expect_err("a refusal"))
}

fn kept(report: &Report) -> usize {
    report.parts.iter().filter(|part| part.kept).count()
}

const TINY: [&str; 6] = ["--mode", "specular", "--blocked", "2", "--seeds", "2"];

#[test]
fn an_interrupted_run_continues_and_another_seed_starts_again() {
    let folder = tempfile::tempdir().unwrap();
    let first = args("sum-rate-power", folder.path(), &TINY);
    // Interrupted after one part.
    let (plan, rooms) = (first.plan(first.effort()), first.rooms().unwrap());
    let parts = Kind::SumRatePower.parts(&rooms[0], &plan).unwrap();
    let done = Store::open(folder.path()).unwrap().compute(&parts[0], figures::compute).unwrap();
    let so_far = reproduce(&args("sum-rate-power", folder.path(), &[&TINY[..], &["--finished"]].concat())).unwrap();
    assert_eq!((so_far.parts.len(), so_far.left_out.len()), (1, 1));
    assert!(so_far.left_out[0].why.contains("1 of its 2 parts"), "{}", so_far.left_out[0].why);
    let report = reproduce(&first).unwrap();
    assert_eq!((report.parts.len(), kept(&report)), (2, 1));
    assert_eq!((report.parts[0].kept, &report.parts[0].made), (true, &done.origin.made));
    // No part is computed twice, and the figures are equal.
    let again = reproduce(&first).unwrap();
    assert_eq!((kept(&again), &again.figures), (2, &report.figures));
    // An unreadable part is computed again, with the same result.
    let file = fs::read_dir(folder.path().join("parts")).unwrap().next().unwrap().unwrap().path();
    fs::write(&file, "{").unwrap();
    let mended = reproduce(&first).unwrap();
    assert_eq!((kept(&mended), &mended.figures), (1, &report.figures));
    let other = reproduce(&args("sum-rate-power", folder.path(), &[&TINY[..], &["--seed", "7"]].concat())).unwrap();
    assert_eq!(kept(&other), 0);
    assert_ne!(other.figures[0].panels, report.figures[0].panels);
}

#[test]
fn the_files_of_a_report_agree() {
    let folder = tempfile::tempdir().unwrap();
    let report = reproduce(&args("sum-rate-power", folder.path(), &TINY)).unwrap();
    let read = |name: &str| fs::read_to_string(folder.path().join(name)).unwrap();
    let page = read("report.md");
    let command = "heliostat-lab reproduce sum-rate-power --out DIR --mode specular --seeds 2 --blocked 2 --quick";
    assert!(page.contains(command), "{page}");
    for figure in &report.figures {
        assert!(
            page.contains(&format!("]({}.svg)", figure.stem())) && page.contains(&figure.panels[0].title),
            "{page}"
        );
    }
    let written: Report = serde_json::from_str(&read("report.json")).unwrap();
    assert_eq!((written.claims, written.meta.commits), (report.claims.clone(), report.meta.commits.clone()));
    assert!(read("sum-rate-power-specular.svg").contains("optical power (W)"));
    let panel = &report.figures[0].panels[0];
    let ddpg = panel.series.iter().find(|series| series.name == "ddpg").unwrap();
    let line = format!("{},ddpg,{},{},", panel.title, ddpg.points[0].x, ddpg.points[0].y);
    assert!(read("sum-rate-power-specular.csv").contains(&line));
    // The trained policy exceeds the room without mirrors, and exceeds the oracle by the light on
    // other users at most.
    let at = |name: &str| report.figures[0].series("2 blocked", name).unwrap().at(2.0).unwrap().y;
    assert!(at("ddpg") > 1.3 * at("no-irs") && at("ddpg") < 1.05 * at("oracle"));
    assert!(report.claims.iter().any(|claim| claim.findings[0].verdict == Verdict::NotReproduced));
}

#[test]
fn a_map_is_drawn_without_and_with_the_array() {
    let folder = tempfile::tempdir().unwrap();
    let report = reproduce(&args("map", folder.path(), &["--mode", "specular"])).unwrap();
    let mean = |panel: usize| {
        let values = &report.figures[0].panels[panel].floor.as_ref().unwrap().values;
        values.iter().sum::<f64>() / values.len() as f64
    };
    assert!(mean(1) > mean(0));
    assert!(fs::read_to_string(folder.path().join("map-specular.svg")).unwrap().contains("y (m)"));
}

#[test]
fn outages_grow_with_the_blocked_users_and_the_mirrors_shorten_them() {
    let folder = tempfile::tempdir().unwrap();
    let more = ["--mode", "specular", "--blocked", "0,5", "--seeds", "2"];
    let report = reproduce(&args("outage", folder.path(), &more)).unwrap();
    let figure = &report.figures[0];
    let at = |panel: &str, name: &str, blocked: f64| figure.series(panel, name).unwrap().at(blocked).unwrap().y;
    let below = |name: &str, blocked: f64| at(outage::TIME_BELOW, name, blocked);
    // Without mirrors a blocked user has no rate at all.
    assert_eq!(below("no-irs", 5.0), 1.0);
    assert!(below("no-irs", 0.0) < 0.9 && below("greedy", 5.0) < 0.5, "{:?}", figure.panels);
    // Every outage without mirrors lasts as long as its episode.
    assert_eq!(at(&outage::longer_than(2.0), "no-irs", 5.0), 1.0);
    let [short, medium, long] = [0.1, 0.5, 2.0].map(|length_s| at(&outage::longer_than(length_s), "greedy", 5.0));
    assert!(short >= medium && medium >= long && long < 1.0, "{short} {medium} {long}");
    assert!(at(outage::FAIRNESS, "greedy", 5.0) > 0.5 && figure.series(&outage::longer_than(0.1), "oracle").is_none());
    assert!(fs::read_to_string(folder.path().join("outage-specular.svg")).unwrap().contains("longer than 2 s"));
    // The table of statements does not need it.
    assert!(!args("table", folder.path(), &[]).what.kinds().contains(&Kind::Outage));
    let blocked = refusal("outage", folder.path(), &["--set", "users.count=2", "--blocked", "0,3"]);
    assert!(blocked.contains("outage blocks up to 3 users"), "{blocked}");
}

#[test]
fn invalid_arguments_are_refused_before_the_start() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path();
    let blocked = refusal("sum-rate-power", out, &["--set", "users.count=2", "--blocked", "0,3"]);
    assert!(blocked.contains("3 users") && blocked.contains("--blocked numbers up to 2"), "{blocked}");
    let many = refusal("sum-rate-power", out, &["--set", "users.count=8", "--blocked", "0,1,2,3,4,5,6,7,8"]);
    assert!(many.contains("--blocked has 9") && many.contains("give 8 numbers or fewer"), "{many}");
    let mirrors = refusal("sum-rate-power", out, &["--set", "mirrors.rows=0"]);
    assert!(mirrors.contains("mirrors.rows"), "{mirrors}");
    let not_applicable = refusal("ber-snr", out, &["--mode", "paper"]);
    assert!(not_applicable.contains("law of reflection"), "{not_applicable}");
    let twice = refusal("map", out, &["--mode", "paper,paper"]);
    assert!(twice.contains("twice"), "{twice}");
    let file = out.join("file");
    fs::write(&file, "").unwrap();
    let unwritable = refusal("map", &file, &[]);
    assert!(unwritable.contains("expected a writable folder for --out"), "{unwritable}");
    assert!(!out.join("report.md").exists());
}

#[test]
fn a_figure_that_does_not_apply_to_a_room_is_omitted_and_reported() {
    let folder = tempfile::tempdir().unwrap();
    let all = args("all", folder.path(), &[]);
    let rooms = all.rooms().unwrap();
    let (chosen, left_out) = all.choose(&rooms).unwrap();
    assert_eq!(chosen.len(), 3 * Kind::ALL.len() - 2);
    assert_eq!(
        left_out.iter().map(|left_out| left_out.room.as_str()).collect::<Vec<_>>(),
        ["paper", "paper-calibrated"]
    );
}
