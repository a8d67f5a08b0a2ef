//! The report as one self-contained page: every figure with its verdicts and its origin.

use std::fmt::Write;

use crate::draw::interactive;
use crate::figure::Figure;
use crate::figures::Kind;
use crate::report::{Report, duration_text};
use crate::verdict::{Claim, Verdict};

/// The heading of a figure in the page.
fn heading(id: &str) -> &'static str {
    match Kind::ALL.into_iter().find(|kind| kind.id() == id) {
        Some(Kind::SumRateIterations) => "Sum rate against iterations (Fig. 4 of the paper)",
        Some(Kind::SumRatePower) => "Sum rate against optical power (Fig. 5 of the paper)",
        Some(Kind::BerSnr) => "Bit error rate against SNR (Fig. 6 of the paper)",
        Some(Kind::Inference) => "Decision time",
        Some(Kind::Outage) => "Outages and fairness in closed loop",
        Some(Kind::Map) => "Rate over the floor",
        None => "",
    }
}

/// The page.
pub fn html(report: &Report) -> String {
    let mut page = String::new();
    write(report, &mut page).expect("writing into a string does not fail");
    page
}

fn write(report: &Report, page: &mut String) -> std::fmt::Result {
    writeln!(
        page,
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n<meta name=\"viewport\" content=\"width=device-width\">\n\
         <title>Heliostat: the paper's figures</title>\n<style>{STYLE}</style>\n{}\n</head>\n<body>",
        interactive::library()
    )?;
    write_head(report, page)?;
    write_table(&report.claims, page)?;
    for kind in Kind::ALL {
        let figures: Vec<&Figure> = report.figures.iter().filter(|figure| figure.id == kind.id()).collect();
        let left_out: Vec<_> = report.left_out.iter().filter(|left_out| left_out.figure == kind.id()).collect();
        if figures.is_empty() && left_out.is_empty() {
            continue;
        }
        writeln!(page, "<h2 id=\"{}\">{}</h2>", kind.id(), heading(kind.id()))?;
        for figure in figures {
            write_figure(report, figure, page)?;
        }
        for left_out in left_out {
            let (room, why) = (escape(&left_out.room), escape(&left_out.why));
            writeln!(page, "<p class=\"left-out\"><b>Missing in room {room}:</b> {why}.</p>")?;
        }
    }
    write_parts(report, page)?;
    writeln!(page, "</body>\n</html>")
}

fn write_head(report: &Report, page: &mut String) -> std::fmt::Result {
    let meta = &report.meta;
    writeln!(page, "<h1>Reproduction of the paper's figures</h1>")?;
    writeln!(
        page,
        "<p>Hamad, Qidan, El-Gorashi, Elmirghani, <i>Adaptive DRL for IRS Mirror Orientation in Dynamic OWC Networks</i>. The paper is based on simulation; this report repeats it in three \
         rooms: <b>specular</b> (the law of reflection), <b>paper</b> (its equations (2) and (3) as printed) and <b>paper-calibrated</b> (the same with two parameters calibrated \
         to the paper's rates). Red marks are the values of the paper.</p>"
    )?;
    writeln!(page, "<table class=\"meta\">")?;
    let rows = [
        ("made", format!("{} UTC, {} run", meta.made.trim_end_matches('Z').replace('T', " "), meta.effort)),
        ("program", format!("heliostat {}, commit {}", meta.version, meta.commits.join(", "))),
        (
            "seeds",
            format!(
                "{} from {} without training, {} for training ({} episodes) and timing",
                meta.seeds, meta.first_seed, meta.training_seeds, meta.episodes
            ),
        ),
        ("machine", meta.machine.clone()),
        ("computing time", format!("{} of one core, over all parts", duration_text(meta.cpu_s))),
    ];
    for (name, value) in rows {
        writeln!(page, "<tr><th>{name}</th><td>{}</td></tr>", escape(&value))?;
    }
    writeln!(page, "<tr><th>command</th><td><code>{}</code></td></tr>\n</table>", escape(&meta.command))?;
    let ids = Kind::ALL.iter().map(|kind| kind.id()).filter(|id| report.figures.iter().any(|figure| figure.id == *id));
    let links: Vec<String> = ids.map(|id| format!("<a href=\"#{id}\">{}</a>", heading(id))).collect();
    writeln!(page, "<p>{} · <a href=\"#parts\">origin of the parts</a></p>", links.join(" · "))
}

fn write_table(claims: &[Claim], page: &mut String) -> std::fmt::Result {
    if claims.is_empty() {
        return Ok(());
    }
    writeln!(page, "<h2 id=\"table\">Statements of the paper and findings</h2>")?;
    writeln!(
        page,
        "<table class=\"claims\"><thead><tr><th>statement</th><th>paper</th><th>room</th><th>here</th><th>verdict</th><th>calibrated to the paper</th></tr></thead>"
    )?;
    for claim in claims {
        writeln!(page, "<tbody>")?;
        for (index, finding) in claim.findings.iter().enumerate() {
            write!(page, "<tr>")?;
            if index == 0 {
                let rows = claim.findings.len();
                let (statement, paper) = (escape(&claim.statement), escape(&claim.paper));
                write!(page, "<td rowspan=\"{rows}\">{statement}</td><td rowspan=\"{rows}\">{paper}</td>")?;
            }
            writeln!(
                page,
                "<td>{}</td><td>{}</td><td class=\"{}\"><b>{}</b>: {}</td><td>{}</td></tr>",
                escape(&finding.room),
                escape(&finding.ours),
                class(finding.verdict),
                finding.verdict.words(),
                escape(&finding.why),
                escape(&finding.calibrated)
            )?;
        }
        writeln!(page, "</tbody>")?;
    }
    writeln!(page, "</table>")
}

fn class(verdict: Verdict) -> &'static str {
    match verdict {
        Verdict::Reproduced => "reproduced",
        Verdict::ConsistentWith | Verdict::InPart => "in-part",
        Verdict::NotReproduced => "not-reproduced",
    }
}

fn write_figure(report: &Report, figure: &Figure, page: &mut String) -> std::fmt::Result {
    writeln!(page, "<section>\n<h3>{}</h3>", escape(&figure.room))?;
    writeln!(page, "{}", interactive::draw(figure, &figure.stem()))?;
    for line in &figure.caption {
        writeln!(page, "<p class=\"caption\">{}</p>", code(&escape(line)))?;
    }
    let findings = report.claims.iter().filter(|claim| claim.figure == figure.id);
    let findings = findings.flat_map(|claim| claim.findings.iter().map(move |finding| (claim, finding)));
    writeln!(page, "<ul>")?;
    for (claim, finding) in findings.filter(|(_, finding)| finding.room == figure.room) {
        writeln!(
            page,
            "<li>{} (paper: {}): <b class=\"{}\">{}</b>. {}; {}.</li>",
            escape(&claim.statement),
            escape(&claim.paper),
            class(finding.verdict),
            finding.verdict.words(),
            escape(&finding.ours),
            escape(&finding.why)
        )?;
    }
    let stem = figure.stem();
    writeln!(
        page,
        "</ul>\n<p class=\"files\"><a href=\"{stem}.svg\">SVG</a> · <a href=\"{stem}.csv\">CSV</a> · <a href=\"{stem}.json\">JSON</a> · \
         <code>{}</code></p>\n</section>",
        escape(&figure.command)
    )
}

fn write_parts(report: &Report, page: &mut String) -> std::fmt::Result {
    let kept = report.parts.iter().filter(|part| part.kept).count();
    writeln!(
        page,
        "<h2 id=\"parts\">Origin of the parts</h2>\n<p>{} parts, {} computed in this run and {kept} from an earlier run.</p>\n<details><summary>All parts</summary>\n\
         <table class=\"parts\"><tr><th>figure</th><th>room</th><th>part</th><th>seed</th><th>origin</th><th>commit</th><th>machine</th><th>processor time (s)</th></tr>",
        report.parts.len(),
        report.parts.len() - kept
    )?;
    for part in &report.parts {
        let from = if part.kept { format!("earlier run, {}", part.made) } else { format!("this run, {}", part.made) };
        writeln!(
            page,
            "<tr><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{from}</td><td>{}</td><td>{}</td><td>{:.1}</td></tr>",
            part.figure,
            escape(&part.room),
            escape(&part.name),
            part.seed,
            part.commit,
            escape(&part.machine),
            part.cpu_s
        )?;
    }
    writeln!(page, "</table></details>")
}

/// A text for an element or an attribute of a page.
pub fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// Text between backticks as code.
fn code(text: &str) -> String {
    let parts = text.split('`').enumerate();
    parts.map(|(index, part)| if index % 2 == 1 { format!("<code>{part}</code>") } else { part.to_owned() }).collect()
}

/// The look of every page of results.
pub const STYLE: &str = "
body { font: 15px/1.5 system-ui, sans-serif; margin: 2rem auto; max-width: 1280px; padding: 0 1.5rem; color: #222; }
h1 { font-size: 1.7rem; } h2 { margin-top: 2.5rem; border-bottom: 1px solid #ccc; } h3 { margin-bottom: 0; }
section { margin: 1rem 0 2.5rem; } .plot { width: 100%; }
table { border-collapse: collapse; font-size: 0.9rem; } td, th { text-align: left; vertical-align: top; padding: 0.3rem 0.7rem; }
.claims td, .claims th { border: 1px solid #ddd; } .claims tbody { border-top: 2px solid #888; } .meta th { color: #666; font-weight: normal; }
.reproduced { color: #00634a; } .in-part { color: #8a5a00; } .not-reproduced { color: #a3003c; }
.caption { max-width: 62rem; margin: 0.4rem 0; color: #444; } .files, .left-out { color: #555; font-size: 0.9rem; }
code { background: #f2f2f2; padding: 0 0.25em; border-radius: 3px; }
";
