//! The documents: their commands run, their links lead somewhere, and the tests that they name
//! exist.
//!
//! Bash runs each fenced block marked `sh`, block after block in one folder for each file, with the
//! built programs first on the path and the repository's folders beside it. `sh until-stopped`
//! marks commands that run until Ctrl-C: they run side by side for two seconds. `sh no-run` marks
//! commands that cannot run here; the text beside it says why. In a tested file, a command in any
//! other block fails the test.

use std::collections::BTreeMap;
use std::fs;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::process::Command;

use heliostat_tests::{programs, workspace};
use tempfile::TempDir;

/// Time limit for one block, in s; on an idle machine a block needs a small part of it.
const BLOCK_LIMIT_S: u32 = 900;

#[derive(Debug)]
struct Block {
    line: usize,
    info: String,
    text: String,
}

/// The fenced blocks of a Markdown file.
fn blocks(text: &str) -> Vec<Block> {
    let mut blocks: Vec<Block> = Vec::new();
    let mut open = false;
    for (index, line) in text.lines().enumerate() {
        match (line.strip_prefix("```"), open) {
            (Some(info), false) => {
                blocks.push(Block { line: index + 1, info: info.trim().to_owned(), text: String::new() });
                open = true;
            }
            (Some(_), true) => open = false,
            (None, true) => {
                let block = blocks.last_mut().expect("a block is open");
                block.text.push_str(line);
                block.text.push('\n');
            }
            (None, false) => {}
        }
    }
    blocks
}

fn is_command(line: &str) -> bool {
    ["heliostat ", "heliostat-lab "].iter().any(|program| line.trim_start().starts_with(program))
}

/// The command without its comment, for two seconds in the background.
fn stopped_soon(line: &str) -> String {
    let command = line.split(" #").next().unwrap_or(line).trim();
    format!("{command} --seconds 2 > /dev/null &\n")
}

/// Links the repository's folders into a folder, so that a command can name them.
fn stage(folder: &TempDir) {
    for name in ["deploy", "docs", "examples", "lab", "models", "tests"] {
        symlink(workspace().join(name), folder.path().join(name)).expect("a fresh folder takes a link");
    }
}

/// Runs a file's blocks; returns the number of commands.
fn run(file: &str) -> usize {
    let text = fs::read_to_string(workspace().join(file)).unwrap_or_else(|error| panic!("{file}: {error}"));
    let folder = TempDir::new().expect("a folder");
    stage(&folder);
    let path = format!("{}:{}", programs().display(), std::env::var("PATH").unwrap_or_default());
    let mut commands = 0;
    for block in blocks(&text) {
        let count = block.text.lines().filter(|line| is_command(line)).count();
        let script = match block.info.as_str() {
            "sh" => block.text.clone(),
            "sh until-stopped" => block.text.lines().filter(|line| is_command(line)).map(stopped_soon).collect(),
            info => {
                let marked = info.starts_with("sh no-run");
                assert!(marked || count == 0, "{file}, line {}: commands in a block that is not marked sh", block.line);
                continue;
            }
        };
        commands += count;
        // A command in the background must succeed too.
        let script = format!("set -eu\n{script}\nfor job in $(jobs -p); do wait $job; done\n");
        let output = Command::new("timeout")
            .args([&BLOCK_LIMIT_S.to_string(), "bash", "-c", &script])
            .env("PATH", &path)
            .current_dir(folder.path())
            .output()
            .expect("bash runs");
        let (out, errors) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
        assert!(output.status.success(), "{file}, line {}: {}\n{script}\n{out}\n{errors}", block.line, output.status);
    }
    commands
}

#[test]
fn the_readme_runs() {
    assert!(run("README.md") >= 4);
}

#[test]
fn first_run_runs() {
    assert!(run("docs/tutorials/first-run.md") >= 11);
}

/// Its processes together are in processes/trackers.rs.
#[test]
fn own_room_runs() {
    assert!(run("docs/tutorials/own-room.md") >= 3);
}

/// Its calibration takes minutes of the room's time; crates/calibrate/tests runs it in virtual time.
#[test]
fn your_wall_runs() {
    assert!(run("docs/tutorials/your-wall.md") >= 2);
}

#[test]
fn own_scenario_runs() {
    assert!(run("docs/tutorials/own-scenario.md") >= 6);
}

#[test]
fn own_policy_runs() {
    assert!(run("docs/tutorials/own-policy.md") >= 4);
}

#[test]
fn own_driver_runs() {
    assert!(run("docs/tutorials/own-driver.md") >= 5);
}

/// Its commands in Python run in python/tests/test_track_*.py.
#[test]
fn own_tracker_runs() {
    assert!(run("docs/tutorials/own-tracker.md") >= 1);
}

/// Its figure and its table are made in python/tests/test_documents.py.
#[test]
fn own_study_runs() {
    assert!(run("docs/tutorials/own-study.md") >= 1);
}

/// Its blocks in Python run in python/tests/test_documents.py.
#[test]
fn python_runs() {
    assert!(run("docs/tutorials/python.md") >= 1);
}

#[test]
fn latency_report_runs() {
    assert!(run("docs/tutorials/latency-report.md") >= 6);
}

#[test]
fn evaluation_runs() {
    assert!(run("docs/evaluation.md") >= 3);
}

#[test]
fn actuators_run() {
    assert!(run("docs/actuators.md") >= 3);
}

#[test]
fn recording_runs() {
    assert!(run("docs/recording.md") >= 8);
}

#[test]
fn every_tutorial_is_run() {
    let tests =
        fs::read_to_string(workspace().join("tests/tests/project/documentation.rs")).expect("this file is there");
    for entry in fs::read_dir(workspace().join("docs/tutorials")).expect("there are tutorials") {
        let name = entry.expect("a folder can be read").file_name().to_string_lossy().into_owned();
        assert!(tests.contains(&format!("run(\"docs/tutorials/{name}\")")), "{name} is not run by any test here");
    }
}

/// Markdown files of the repository: at its root, and in docs, deploy and models.
fn documents() -> Vec<PathBuf> {
    fn collect(folder: &Path, depth: usize, found: &mut Vec<PathBuf>) {
        for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
            let path = entry.path();
            if path.is_dir() && depth > 0 {
                collect(&path, depth - 1, found);
            } else if path.extension().is_some_and(|extension| extension == "md") {
                found.push(path);
            }
        }
    }
    let mut found = Vec::new();
    collect(&workspace(), 0, &mut found);
    ["docs", "deploy", "models", "examples"]
        .iter()
        .for_each(|folder| collect(&workspace().join(folder), 4, &mut found));
    found
}

/// The lines of a Markdown file outside of fenced blocks, without code in backticks.
fn prose(text: &str) -> Vec<String> {
    let mut fenced = false;
    let mut lines = Vec::new();
    for line in text.lines() {
        if line.trim_start().starts_with("```") {
            fenced = !fenced;
        } else if !fenced {
            lines.push(line.split('`').step_by(2).collect::<Vec<_>>().join("`"));
        }
    }
    lines
}

/// Targets of the links and pictures of a Markdown file.
fn links(text: &str) -> Vec<String> {
    let lines = prose(text);
    let targets = lines.iter().flat_map(|line| line.split("](").skip(1));
    targets.filter_map(|rest| Some(rest.split_once(')')?.0.to_owned())).collect()
}

/// The anchors of a Markdown file's headings, as GitHub makes them.
fn anchors(text: &str) -> Vec<String> {
    let mut fenced = false;
    let mut anchors = Vec::new();
    for line in text.lines() {
        fenced ^= line.starts_with("```");
        if let (false, Some(heading)) = (fenced, line.strip_prefix('#')) {
            let heading = heading.trim_start_matches('#').trim().to_lowercase();
            let kept = heading.chars().filter(|letter| letter.is_alphanumeric() || matches!(letter, ' ' | '-' | '_'));
            anchors.push(kept.map(|letter| if letter == ' ' { '-' } else { letter }).collect());
        }
    }
    anchors
}

#[test]
fn internal_links_lead_to_files_and_headings_that_exist() {
    let (mut broken, mut checked) = (Vec::new(), 0);
    for document in documents() {
        let text = fs::read_to_string(&document).expect("a document is readable");
        for link in links(&text).iter().filter(|link| !link.contains("://")) {
            checked += 1;
            let (file, anchor) = link.split_once('#').unwrap_or((link, ""));
            let target =
                if file.is_empty() { document.clone() } else { document.parent().expect("a folder").join(file) };
            let leads = target.exists()
                && (anchor.is_empty()
                    || fs::read_to_string(&target)
                        .is_ok_and(|text| anchors(&text).iter().any(|found| found == anchor)));
            if !leads {
                broken.push(format!("{}: {link}", document.strip_prefix(workspace()).unwrap_or(&document).display()));
            }
        }
    }
    assert!(broken.is_empty(), "broken links:\n{}", broken.join("\n"));
    assert!(checked >= 50, "only {checked} links were found");
}

#[test]
fn tests_that_the_documents_name_exist() {
    // Test functions, and test targets by the names of their files.
    let (mut sources, mut targets) = (String::new(), Vec::new());
    let mut folders = vec![workspace()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
            let path = entry.path();
            let name = entry.file_name();
            if path.is_dir() && name != "target" && name != ".git" {
                folders.push(path);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                sources += &fs::read_to_string(&path).expect("a source is readable");
                targets.extend(path.file_stem().map(|stem| stem.to_string_lossy().into_owned()));
            }
        }
    }
    let text = fs::read_to_string(workspace().join("docs/physics.md")).expect("the physics is there");
    let spans: Vec<&str> = text.split('`').skip(1).step_by(2).collect();
    let named = spans.iter().filter_map(|span| {
        let test = span.strip_prefix("test ").or_else(|| span.starts_with("cargo test ").then_some(*span))?;
        test.split(' ').next_back().filter(|word| word.contains('_') && !word.contains('-'))
    });
    let named: Vec<&str> = named.collect();
    let exists = |name: &str| sources.contains(&format!("fn {name}")) || targets.iter().any(|target| target == name);
    let missing: Vec<&&str> = named.iter().filter(|name| !exists(name)).collect();
    assert!(missing.is_empty(), "docs/physics.md names tests that do not exist: {missing:?}");
    assert!(named.len() >= 40, "only {} tests are named", named.len());
}

/// The pages of results, which a report writes, have commands of their own.
#[test]
fn comparisons_in_closed_loop_have_more_than_one_episode() {
    let (mut single, mut checked) = (Vec::new(), 0);
    for document in documents() {
        let text = fs::read_to_string(&document).expect("a document is readable");
        for line in text.lines().filter(|line| is_command(line) && line.contains(" --closed-loop")) {
            let words: Vec<&str> = line.split_whitespace().collect();
            let after = |flag: &str| Some(words[words.iter().position(|word| *word == flag)? + 1]);
            let number = |flag, absent| after(flag).map_or(absent, |value| value.parse::<usize>().expect("a number"));
            let several = ["--policies", "--beliefs"].map(after).into_iter().flatten().any(|value| value.contains(','));
            checked += usize::from(several);
            // An episode has 20 states.
            if several && number("--seeds", 3) * number("--episodes", 1).max(number("--states", 1).div_ceil(20)) == 1 {
                single.push(format!("{}: {line}", document.display()));
            }
        }
    }
    assert!(single.is_empty(), "one episode gives no interval, give --episodes:\n{}", single.join("\n"));
    assert!(checked >= 10, "only {checked} comparisons were found");
}

#[test]
fn the_readme_is_short() {
    let text = fs::read_to_string(workspace().join("README.md")).expect("there is a README");
    assert!(text.lines().count() <= 120, "the README has {} lines; expected at most 120", text.lines().count());
}

#[test]
fn no_room_or_tutorial_has_the_name_of_a_built_in_scenario() {
    let builtin = |text: &str| {
        let name = text.lines().find_map(|line| line.strip_prefix("name = \""))?.trim_end_matches('"').to_owned();
        heliostat_scenario::BUILTIN_NAMES.contains(&name.as_str()).then_some(name)
    };
    let mut checked = 0;
    for folder in ["deploy/rooms", "docs/tutorials"] {
        for entry in fs::read_dir(workspace().join(folder)).expect("a folder").flatten() {
            let text = fs::read_to_string(entry.path()).expect("a text");
            assert_eq!(builtin(&text), None, "{}", entry.path().display());
            checked += 1;
        }
    }
    assert!(checked >= 8, "only {checked} files were checked");
}

#[test]
fn units_and_rooms_of_the_deployment_agree_with_the_programs() {
    let deploy = workspace().join("deploy");
    for room in ["studio", "foyer"] {
        let toml = fs::read_to_string(deploy.join(format!("rooms/{room}.toml"))).expect("a room has a scenario");
        heliostat_scenario::Scenario::from_toml(&toml).unwrap_or_else(|error| panic!("{room}: {error}"));
        let environment =
            fs::read_to_string(deploy.join(format!("rooms/{room}.env"))).expect("a room has an environment");
        let variables: BTreeMap<&str, &str> =
            environment.lines().filter(|line| !line.starts_with('#')).filter_map(|line| line.split_once('=')).collect();
        for unit in ["controller", "sim-node", "standby", "driver", "page", "recorder"] {
            // The array of studio is simulated.
            let (program, words): (&str, &[&str]) = match unit {
                "driver" if room == "studio" => continue,
                "driver" | "page" | "recorder" => ("heliostat", &["--help"]),
                _ => ("heliostat", &[]),
            };
            let config: &[&str] = match unit {
                "controller" | "standby" => &["config", "controller"],
                "sim-node" => &["config", "sim-node"],
                _ => &[],
            };
            let text = fs::read_to_string(deploy.join(format!("systemd/heliostat-{unit}@.service"))).expect("a unit");
            let start = text.lines().find(|line| line.starts_with("ExecStart=")).expect("a unit starts something");
            let command = start.split_whitespace().skip(1).flat_map(|word| {
                let name = word.trim_start_matches('$').trim_start_matches('{').trim_end_matches('}');
                match word.strip_prefix('$') {
                    Some(_) => {
                        let value = variables.get(name).unwrap_or_else(|| panic!("{room}.env lacks {name}"));
                        value.split(' ').map(str::to_owned).collect()
                    }
                    None => vec![word.replace("%i", room)],
                }
            });
            // The flags of the unit are those that the program has.
            let scenario = format!("/etc/heliostat/{room}.toml");
            let here = deploy.join(format!("rooms/{room}.toml")).display().to_string();
            let arguments: Vec<String> =
                command.map(|word| if word == scenario { here.clone() } else { word }).collect();
            let output = Command::new(programs().join(program)).args(config).args(&arguments).args(words).output();
            let output = output.expect("the program runs");
            assert!(output.status.success(), "{room}, {unit}: {}", String::from_utf8_lossy(&output.stderr));
        }
    }
}

#[test]
fn the_rooms_of_a_building_have_the_variables_and_the_keys_of_every_unit() {
    let deploy = workspace().join("deploy");
    let read = |file: &str| fs::read_to_string(deploy.join(file)).unwrap_or_else(|error| panic!("{file}: {error}"));
    let script = read("building/make-keys");
    for room in ["studio", "foyer"] {
        let environment = read(&format!("building/rooms/{room}.env"));
        let variables: BTreeMap<&str, &str> = environment.lines().filter_map(|line| line.split_once('=')).collect();
        let mut ports: Vec<&str> =
            variables.iter().filter(|(name, _)| name.ends_with("_METRICS")).map(|(_, at)| *at).collect();
        ports.sort_unstable();
        assert!(ports.windows(2).all(|two| two[0] != two[1]), "{room}: one port of two processes: {ports:?}");
        for unit in ["controller", "standby", "sim-node", "driver", "tracker", "page", "recorder"] {
            let text = read(&format!("systemd/heliostat-{unit}@.service"));
            let start = text.lines().find(|line| line.starts_with("ExecStart=")).expect("a unit starts something");
            let names = start.split_whitespace().filter_map(|word| word.strip_prefix('$'));
            let values: Vec<&str> = names
                .map(|name| {
                    let name = name.trim_matches(['{', '}']);
                    *variables.get(name).unwrap_or_else(|| panic!("{unit} needs {name} in {room}.env"))
                })
                .collect();
            let bus = values.last().expect("the endpoints are the last flags");
            assert!(bus.contains(&format!("--tls /run/credentials/heliostat-{unit}@{room}.service ")), "{bus}");
            let keys = read(&format!("building/systemd/heliostat-{unit}@.service.d/keys.conf"));
            let role = keys.lines().find_map(|line| line.split_once('=')?.1.split_once(".key:")).expect("a key").0;
            assert!(script.contains(&format!("{role} ")) || script.contains(&format!("{role})")), "{unit}: {role}");
        }
    }
}

#[test]
fn the_containers_of_a_building_have_the_names_of_their_hosts_and_a_standby_starts_after_its_leader() {
    let compose = fs::read_to_string(workspace().join("deploy/building/compose.yaml")).expect("a compose file");
    for (room, of_leader, of_standby) in [("studio", "a", "b"), ("foyer", "b", "a")] {
        for (service, host) in [("room", of_leader), ("controller", of_leader), ("standby", of_standby)] {
            let part = compose.split_once(&format!("\n  {room}-{service}:\n")).expect("a service").1;
            let part = part.split("\n\n").next().unwrap_or_default();
            assert!(part.contains(&format!("\n    hostname: {service}-on-host-{host}\n")), "{part}");
            assert!(part.contains(&format!("\n    networks: [host-{host}]\n")), "{part}");
            let waits = part.contains(&format!("\n      {room}-controller: {{ condition: service_healthy }}"));
            assert_eq!(waits, service == "standby", "{part}");
        }
    }
}

#[test]
fn the_containers_pass_flags_that_the_programs_accept() {
    let deploy = workspace().join("deploy");
    let read = |file: &str| fs::read_to_string(deploy.join(file)).unwrap_or_else(|error| panic!("{file}: {error}"));
    let (compose, image) = (read("container/compose.yaml"), read("container/Containerfile"));
    for service in ["controller", "sim-node"] {
        let part = compose.split_once(&format!("\n  {service}:\n")).expect("a service").1;
        assert!(
            part.contains(&format!("target: {service}")) && image.contains(&format!(" AS {service}\n")),
            "{service}"
        );
        assert!(image.contains(&format!("ENTRYPOINT [\"heliostat-{service}\"]")), "{service}");
        // The words of a command are a list in YAML as in JSON.
        let words = part.lines().find(|line| line.trim_start().starts_with("[\"--room\"")).expect("a command");
        let words: Vec<String> = serde_json::from_str(words.trim()).expect("a list of words");
        let rooms = deploy.join("rooms").display().to_string();
        let words = words.iter().map(|word| word.replace("/etc/heliostat", &rooms));
        let output = Command::new(programs().join("heliostat")).args(["config", service]).args(words).output();
        let output = output.expect("heliostat runs");
        assert!(output.status.success(), "{service}: {}", String::from_utf8_lossy(&output.stderr));
    }
    let lock = fs::read_to_string(workspace().join("Cargo.lock")).expect("a lock file");
    let zenoh = lock.split_once("name = \"zenoh\"\nversion = \"").expect("zenoh is there").1;
    let version = zenoh.split('"').next().expect("a version");
    // The build of the router reads the version with this command.
    let command = image.lines().find_map(|line| Some(line.split_once("version=$(")?.1)).expect("a command");
    let command = command.trim_end_matches([' ', '\\']);
    let command = command.strip_suffix(')').expect("the command ends its line");
    let output = Command::new("bash").args(["-c", command]).current_dir(workspace()).output().expect("bash runs");
    assert_eq!(String::from_utf8_lossy(&output.stdout).trim(), version, "{command}");
}

/// The text of the element whose tag ends first.
fn content(rest: &str) -> &str {
    rest.split_once('>').and_then(|(_, text)| text.split('<').next()).unwrap_or_default()
}

#[test]
fn the_plan_of_the_page_has_the_sections_of_the_page_in_their_order() {
    let read =
        |file: &str| fs::read_to_string(workspace().join(file)).unwrap_or_else(|error| panic!("{file}: {error}"));
    let [plan, page, guide] = ["docs/images/page-parts.svg", "crates/ui/page/index.html", "docs/page.md"].map(read);
    let after = |text: &str, mark: &str| text.split_once(mark).map(|(_, rest)| content(rest).to_owned());
    let parts: Vec<(String, String)> = plan
        .split("class=\"number\"")
        .skip(1)
        .map(|part| (content(part).to_owned(), after(part, "class=\"name\"").expect("a part has a name")))
        .collect();
    // The title of a section is its label, else its heading.
    let titles: Vec<String> = page
        .split("<section ")
        .skip(1)
        .map(|section| {
            let tag = section.split('>').next().unwrap_or_default();
            let label = tag.split_once(" aria-label=\"").and_then(|(_, rest)| rest.split('"').next());
            label.map(str::to_owned).or_else(|| after(section, "<h2")).expect("a section has a title")
        })
        .collect();
    let sections: Vec<_> = parts.iter().filter(|(number, _)| number.ends_with(char::is_alphabetic)).collect();
    assert_eq!(sections.len(), titles.len(), "{sections:?}, but the page has {titles:?}");
    for ((number, name), title) in sections.into_iter().zip(&titles) {
        assert!(title.starts_with(name.as_str()), "{number} {name} of the plan is {title} on the page");
        assert!(guide.contains(&format!("**{number} {name}**")), "docs/page.md lacks {number} {name}");
    }
}
