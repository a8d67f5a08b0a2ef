//! Tests of the lines and of the full-screen view.

use heliostat_proto::{Quantiles, StopName};
use ratatui::Terminal;
use ratatui::backend::TestBackend;

use super::*;
use crate::array_faults::faults_note;
use crate::figures::{ArrayFigures, Count, NodeFigures, Origin, TimeFigures, UserFigures};
use heliostat_proto::reported_stops::{RoomStop, Standing};

use crate::stop_watch::RoomStops;
use crate::sums::SumFigures;
use texts::line;

impl Lines {
    /// The texts of the next lines.
    fn next(&mut self, figures: &Figures, stops: &[String]) -> Vec<String> {
        self.take(figures, stops).into_iter().map(|line| line.text).collect()
    }
}

#[test]
fn a_log_has_one_line_about_a_lost_connection() {
    for (is_log, expected) in [(true, &["no driver"][..]), (false, &["no router", "no driver"])] {
        let lines = Lines { is_log, ..Lines::default() };
        let mut notes = vec!["no router".to_owned(), "no driver".to_owned()];
        lines.leave_out(&mut notes, || vec!["no router".to_owned()]);
        assert_eq!(notes, expected);
    }
}

fn figures(users: u32) -> Figures {
    let user = |user: u32| UserFigures {
        user,
        rate_mbps: if user == 1 { 0.25 } else { 12.5 + user as f32 },
        is_rate_known: true,
        blocked: Some(user == 0),
        min_rate_mbps: 1.0,
        ..UserFigures::default()
    };
    let us = |p99| Some(Quantiles { count: 9, p50: p99 / 2.0, p99, max: p99 * 20.0, ..Quantiles::default() });
    let counts = ["decisions", "commands", "over 0.5 ms", "ticks lost", "ticks late", "fallbacks", "reports refused"];
    let counts = counts.into_iter().chain(["array refused", "unreadable"]).zip(700_001..);
    Figures {
        origin: Origin::Simulated,
        tick: 4711,
        policy: "greedy".into(),
        controller_alive: true,
        users: (0..users).map(user).collect(),
        sum_mbps: Some(SumFigures {
            policy: 40.0,
            no_irs: Some(10.0),
            flat: Some(20.0),
            oracle: Some(50.0),
            is_modelled: false,
        }),
        array: ArrayFigures {
            silent: Vec::new(),
            state: "stopped".into(),
            arrays: 1,
            mirrors: 100,
            unusable: 25,
            faults: vec!["mirror"],
        },
        nodes: vec![NodeFigures {
            node: "controller".into(),
            problem: "a policy failed".into(),
            ..NodeFigures::default()
        }],
        times: vec![
            TimeFigures { name: "decision", of: "controller", us: us(300.0) },
            TimeFigures { name: "loop", of: "room", us: us(900.0) },
            TimeFigures { name: "age", of: "controller", us: None },
        ],
        counts: counts
            .map(|(name, value)| Count {
                name: name.into(),
                of: "room",
                value: Some(value),
                is_problem: true,
                ..Count::default()
            })
            .collect(),
        notes: vec!["no driver receives the commands".into()],
        ..Figures::default()
    }
}

fn drawn(width: u16, height: u16, figures: &Figures) -> String {
    drawn_with(width, height, figures, &[])
}

fn drawn_with(width: u16, height: u16, figures: &Figures, stops: &[String]) -> String {
    drawn_under("room demo", (width, height), figures, stops)
}

fn drawn_under(title: &str, (width, height): (u16, u16), figures: &Figures, stops: &[String]) -> String {
    let mut terminal = Terminal::new(TestBackend::new(width, height)).expect("a backend in memory");
    let sum = figures.sum_mbps.unwrap_or_default();
    terminal
        .draw(|frame| draw(frame, title, (figures, stops), &[(0.0, sum), (9.0, sum)]))
        .expect("drawing into memory does not fail");
    terminal.backend().to_string()
}

fn check(screen: &str, texts: &[&str]) {
    for text in texts {
        assert!(screen.contains(text), "no {text:?} in\n{screen}");
    }
}

const USERS: [&str; 7] = ["direct path", "minimum", "blocked", "12.50", "below", "15.50", "16.50"];

#[test]
fn the_screen_is_complete_at_80_by_24() {
    let screen = drawn(80, 24, &figures(5));
    check(&screen, &USERS);
    check(&screen, &["room demo", "policy greedy", "tick 4711", "stopped, 25 of 100 mirrors unusable"]);
    check(&screen, &["policy     40.00   80.0 %", "oracle     50.00  100.0 %", "150 us", "300 us", "18000 us", "age"]);
    check(&screen, &["decisions                700001", "fallbacks", "reports refused", "array refused", "700009"]);
    check(&screen, &["a policy failed", "no driver receives the commands"]);
    check(&screen, &["q quits", "■ minimum met", "■ below", "■ policy", "■ no IRS", "■ flat", "■ oracle"]);
    assert!(screen.contains('⠉') || screen.contains('⠒'), "no chart in\n{screen}");
}

#[test]
fn all_users_and_sum_rates_are_visible_at_60_by_15() {
    let screen = drawn(60, 15, &figures(5));
    check(&screen, &USERS);
    check(&screen, &["policy     40.00", "oracle     50.00", "no driver receives", "q quits", "■ minimum met"]);
}

#[test]
fn the_second_line_of_a_title_is_drawn_where_the_window_is_high_enough() {
    let command = "heliostat status --room demo --connect tcp/127.0.0.1:17447";
    let title = format!("room demo\n{command}");
    let screen = drawn_under(&title, (80, 24), &figures(5), &[]);
    check(&screen, &["room demo", command, "policy greedy", "oracle     50.00", "fallbacks", "q quits"]);
    check(&screen, &USERS);
    let low = drawn_under(&title, (60, 15), &figures(5), &[]);
    assert!(!low.contains(command), "{low}");
    check(&low, &USERS);
}

#[test]
fn a_command_that_is_wider_than_the_window_is_complete_in_rows_that_a_shell_joins() {
    let command = "heliostat controller --scenario hall --room demo --connect tcp/127.0.0.1:17447 --listen \
                   tcp/127.0.0.1:17448 --policy fixed-point";
    for size in [(80, 24), (60, 15)] {
        let screen = drawn_under(&format!("{command}\nroom demo"), size, &figures(5), &[]);
        let mut joined = String::new();
        for row in screen.lines() {
            let row = row.trim_matches('"').trim_start_matches("Heliostat  ").trim();
            joined += row.trim_end_matches('\\');
            if !row.ends_with('\\') {
                break;
            }
        }
        assert_eq!(joined, command, "{screen}");
        check(&screen, &["policy greedy", "q quits"]);
    }
    assert_eq!(title_after("a command\n", "room demo", &figures(1)), "a command\nroom demo");
    let healthy = Figures { notes: Vec::new(), ..figures(1) };
    assert_eq!(title_after("a command\n", "room demo", &healthy), "room demo", "the process runs again");
}

#[test]
fn users_beyond_the_screen_are_counted() {
    check(&drawn(60, 15, &figures(20)), &["\"0    ", "\"3    ", "16 more", "oracle     50.00"]);
    check(&drawn(80, 24, &figures(20)), &["\"7    ", "12 more", "oracle     50.00", "fallbacks    700006"]);
}

#[test]
fn a_small_window_causes_no_panic() {
    for (width, height) in [(1, 1), (20, 5), (40, 12)] {
        drawn(width, height, &figures(5));
    }
}

#[test]
fn a_line_holds_the_figures_or_reports_their_absence() {
    let text = line(&figures(2));
    assert!(
        text.contains("tick   4711") && text.contains("40.0 Mbit/s (no IRS 10.0, flat 20.0, oracle 50.0)"),
        "{text}"
    );
    assert!(text.contains("blocked 1/2") && text.contains("decision p99 300 us"), "{text}");
    assert_eq!(line(&Figures::default()), "no messages from the room");
}

#[test]
fn a_line_is_not_repeated_while_nothing_changes() {
    let mut lines = Lines::default();
    assert_eq!(lines.next(&Figures::default(), &[]), ["no messages from the room"]);
    assert!(lines.next(&Figures::default(), &[]).is_empty());
    let running = figures(2);
    assert_eq!(lines.next(&running, &[]).len(), 2, "a note and a line");
    assert!(lines.next(&running, &[]).is_empty());
    let stops = stops(&room());
    assert_eq!(lines.next(&running, &stops), stops);
    assert!(lines.next(&running, &stops).is_empty());
    assert_eq!(lines.next(&running, &[]), ["no stop is in force"]);
    let over = "over: no driver receives the commands";
    assert_eq!(lines.next(&Figures::default(), &[]), [over, "no messages from the room"]);
}

#[test]
fn a_flood_of_stops_writes_a_bounded_number_of_lines_and_its_end_is_one() {
    let Display::Lines(mut lines) = Display::log(true) else { panic!("lines") };
    let mut printed = 0;
    for number in 0..10_000 {
        printed += lines.next(&figures(3), &[format!("stop {number}")]).len();
    }
    assert!(printed < 200, "{printed}");
    assert_eq!(lines.next(&figures(3), &[]), ["no stop is in force"]);
}

#[test]
fn the_lines_for_a_log_have_stops_and_notes_and_no_figures() {
    let Display::Lines(mut lines) = Display::log(true) else { panic!("lines") };
    assert!(lines.is_log && lines.next(&Figures::default(), &[]).is_empty());
    assert_eq!(lines.next(&figures(2), &[]), ["no driver receives the commands"]);
    assert_eq!(lines.next(&figures(3), &stops(&room())), stops(&room()));
}

#[test]
fn of_the_lines_for_a_log_the_stops_and_the_notes_of_faults_are_problems() {
    let Display::Lines(mut lines) = Display::log(false) else { panic!("lines") };
    let mut problems = |figures: &Figures, stops: &[String]| {
        lines.take(figures, stops).iter().map(|line| line.is_problem).collect::<Vec<_>>()
    };
    let remarks = vec!["another scenario outside the geometry".to_owned()];
    let begun = Figures { remarks, ..figures(2) };
    assert_eq!(problems(&begun, &["a stop".to_owned()]), [true, true, false, false], "stop, note, remark, figures");
    assert_eq!(problems(&Figures { notes: Vec::new(), ..figures(2) }, &[]), [false; 3], "each is over");
}

#[test]
fn a_note_is_printed_when_it_begins_and_ends_and_not_for_each_of_its_figures() {
    let mut lines = Lines::default();
    let mut next = |notes: &[&str]| {
        let notes = notes.iter().map(|note| (*note).to_owned()).collect();
        lines.next(&Figures { notes, ..figures(2) }, &[])
    };
    assert_eq!(next(&["LED 0 brings 0.61"])[0], "LED 0 brings 0.61");
    assert!(next(&["LED 0 brings 0.60"]).is_empty());
    assert_eq!(next(&["LED 1 brings 0.60"]), ["LED 1 brings 0.60", "over: LED 0 brings 0.60"]);
    assert_eq!(next(&[]), ["over: LED 1 brings 0.60"]);
}

#[test]
fn faults_that_change_or_whose_array_is_silent_are_not_over() {
    let mut lines = Lines { is_quiet: true, ..Lines::default() };
    let mut next = |faults: &[&str], silent: &[&str]| {
        let silent = silent.iter().map(|array| (*array).to_owned()).collect();
        let array = ArrayFigures { silent, ..ArrayFigures::default() };
        let notes = faults_note(faults, false).into_iter().collect();
        lines.next(&Figures { array, notes, ..Figures::default() }, &[])
    };
    assert_eq!(next(&["mirror"], &[]), [faults_note(&["mirror"], false).expect("a note")]);
    let both = faults_note(&["link", "mirror"], false).expect("a note");
    assert_eq!(next(&["link", "mirror"], &[]), [both]);
    assert_eq!(next(&[], &["mirrors"]), [""; 0]);
    assert_eq!(next(&[], &[]), ["over: faults of the array"]);
}

/// A room with two stops, of which the second array has executed none.
fn room() -> RoomStops {
    let stop = |source, operator: &str, arrays: &[usize]| RoomStop {
        name: StopName { source, sequence: 4 },
        operator: operator.into(),
        reason: "person on the ladder".into(),
        arrays: arrays.to_vec(),
        known: Duration::ZERO,
        stands_for_unlisted: false,
    };
    RoomStops {
        stops: vec![stop(3, "ann", &[0, 1]), stop(5, "b\u{1b}ob", &[0])],
        standings: vec![(0, Standing::Stopped), (1, Standing::Silent), (2, Standing::Free)],
        has_geometry: true,
        ..RoomStops::default()
    }
}

#[test]
fn the_stops_are_listed_with_the_arrays_that_have_executed_them() {
    let stops = stops(&room());
    let expected = [
        "array 0 of 0, 1 has stopped: stop 0000000000000003/4 of ann (person on the ladder)",
        "array 0 has stopped: stop 0000000000000005/4 of b\\u001bob (person on the ladder)",
        "array 1 does not answer: cut its power",
        "array 2 is not stopped: no stop holds it",
    ];
    assert_eq!(stops, expected);
    let screen = drawn_with(100, 24, &figures(5), &stops);
    check(&screen, &expected);
    check(&screen, &USERS);
    check(
        &drawn_with(60, 15, &figures(5), &stops),
        &["has stopped: stop 0000000000000003/4 of ann", "oracle     50.00"],
    );
    let many: Vec<String> = (0..9).map(|number| format!("stop {number}")).collect();
    check(&drawn_with(80, 24, &figures(5), &many), &["stop 0", "5 more", "oracle     50.00"]);
}

#[test]
fn several_arrays_that_have_stopped_are_named_in_the_plural() {
    let standings = (0..3).map(|array| (array, Standing::Stopped)).collect();
    let lines = stops(&RoomStops { standings, ..room() });
    let of_both = "arrays 0, 1 have stopped: stop 0000000000000003/4 of ann (person on the ladder)";
    assert_eq!(lines[0], of_both);
}

#[test]
fn a_modelled_sum_rate_is_marked() {
    let sum = SumFigures { policy: 121.0, no_irs: Some(105.0), is_modelled: true, ..SumFigures::default() };
    let modelled = Figures { origin: Origin::Real, sum_mbps: Some(sum), ..figures(2) };
    assert!(line(&modelled).contains("  modelled sum rate  121.0 Mbit/s (no IRS 105.0)"), "{}", line(&modelled));
    check(&drawn(80, 24, &modelled), &["Modelled sum rate, Mbit/s", "121.00", "105.00"]);
}

#[test]
fn an_unknown_rate_is_shown_as_unknown_and_not_as_zero() {
    let users = vec![UserFigures { user: 7, ..UserFigures::default() }];
    let measured = Figures { origin: Origin::Real, sum_mbps: None, users, ..figures(0) };
    assert_eq!(line(&measured), "tick   4711  stopped  sum rate unknown: no measured gains");
    let screen = drawn(80, 24, &measured);
    check(&screen, &["sum rate unknown", "7     0.00,  0.00 unknown          unknown"]);
    assert!(!screen.contains("below\n") && !screen.contains("0.00 %"), "{screen}");
}
