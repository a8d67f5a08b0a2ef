use heliostat_channel::Vec3;

use super::*;

const FLOOR: Floor = Floor { length_x_m: 5.0, length_y_m: 5.0 };
const TWO: &str = "time,user,x,y\n# a comment\n10,0,0,0\n10, 1, 1, 1\n\n12,0,2,0\n14,0,2,2\n";

fn at(trace: &Trace) -> Vec<Walker> {
    let mut out = vec![Walker { position: Vec3::new(9.0, 9.0, 0.85), direction: [0.0, 1.0], velocity: [9.0, 9.0] }; 2];
    trace.write(&mut out);
    out
}

#[test]
fn interpolates_holds_and_repeats() {
    let mut trace = Trace::parse(TWO, 2, &FLOOR).unwrap();
    assert_eq!(at(&trace)[0].position, Vec3::new(0.0, 0.0, 0.85));
    trace.step(0.5);
    let now = at(&trace);
    assert_eq!((now[0].position, now[0].velocity), (Vec3::new(0.5, 0.0, 0.85), [1.0, 0.0]));
    assert_eq!(now[0].direction, [1.0, 0.0]);
    // User 1 has one sample: it stands still and keeps its heading.
    assert_eq!((now[1].position, now[1].velocity), (Vec3::new(1.0, 1.0, 0.85), [0.0, 0.0]));
    assert_eq!(now[1].direction, [0.0, 1.0]);
    trace.step(2.5);
    assert_eq!(at(&trace)[0].position, Vec3::new(2.0, 1.0, 0.85));
    trace.step(1.0 + 4.0 + 0.25);
    assert_eq!(at(&trace)[0].position, Vec3::new(0.25, 0.0, 0.85));
}

#[test]
fn a_user_who_creeps_keeps_the_direction_of_the_last_walk() {
    // A walk along x, then a tracker's noise of some millimetres, then a walk along -y.
    let text = "time,user,x,y\n0,0,0,0\n1,0,1,0\n2,0,1.01,0.02\n3,0,1,-0.01\n4,0,1,-0.51\n";
    let mut trace = Trace::parse(text, 1, &FLOOR).unwrap();
    let mut facing = |time_s| {
        trace.seek(time_s);
        let mut walkers = [Walker { position: Vec3::zeros(), direction: [0.0, 1.0], velocity: [0.0, 0.0] }];
        trace.write(&mut walkers);
        walkers[0].direction
    };
    for (time_s, expected) in [(0.5, [1.0, 0.0]), (1.5, [1.0, 0.0]), (2.5, [1.0, 0.0]), (3.5, [0.0, -1.0])] {
        assert_eq!(facing(time_s), expected, "after {time_s} s");
    }
    // A place in the recording is found from both sides.
    assert_eq!((facing(-0.5), trace.duration_s()), ([0.0, -1.0], 4.0));
}

#[test]
fn a_recorded_heading_replaces_the_direction_of_movement_and_turns_along_the_shortest_arc() {
    // A user who walks along x, first turned to 170 degrees, then to -170 degrees.
    let text = "time,user,x,y,heading_deg\n0,0,0,0,170\n2,0,2,0,-170\n";
    let mut trace = Trace::parse(text, 1, &FLOOR).unwrap();
    for (time_s, expected_deg) in [(0.0, 170.0_f64), (0.5, 175.0), (1.5, 185.0)] {
        trace.seek(time_s);
        let mut walkers = [Walker { position: Vec3::zeros(), direction: [0.0, 1.0], velocity: [0.0, 0.0] }];
        trace.write(&mut walkers);
        let (y, x) = expected_deg.to_radians().sin_cos();
        let [u, v] = walkers[0].direction;
        assert!((u - x).hypot(v - y) < 1e-12, "{u} {v} after {time_s} s");
        assert_eq!(walkers[0].velocity, [1.0, 0.0]);
    }
    let error = |body: &str| {
        let text = format!("time,user,x,y,heading_deg\n{body}");
        Trace::parse(&text, 1, &FLOOR).unwrap_err().to_string()
    };
    assert!(error("0,0,1,1").contains("line 2: number of columns 4: expected 5"));
    assert!(error("0,0,1,1,").contains("line 2: invalid heading_deg ``"));
}

#[test]
fn a_user_who_stands_faces_the_recorded_heading_before_and_after_its_samples() {
    let text = "time,user,x,y,heading_deg\n0,0,0,0,0\n1,1,1,1,90\n2,0,0,0,0\n";
    let mut trace = Trace::parse(text, 2, &FLOOR).unwrap();
    for time_s in [0.5, 1.5] {
        trace.seek(time_s);
        let [u, v] = at(&trace)[1].direction;
        assert!(u.abs() < 1e-12 && v == 1.0, "{u} {v} after {time_s} s");
    }
}

#[test]
fn a_recording_of_one_row_is_refused_with_what_is_expected() {
    let error = |text: &str, users| Trace::parse(text, users, &FLOOR).unwrap_err().to_string();
    for (rows, users) in [("3,0,1,1\n", 1), ("3,0,1,1\n3,1,0,0\n", 2)] {
        let text = error(&format!("time,user,x,y\n{rows}"), users);
        assert!(text.contains("time 3 s") && text.contains("at least two times"), "{text}");
    }
    assert!(error("time,user,x,y\n", 1).contains("user 0 has no sample"));
    assert_eq!(Trace::problems("", 5, &FLOOR), [TraceError::Empty], "once, not for each user");
}

#[test]
fn all_problems_of_a_recording_are_listed() {
    let text = "time,user,x,y\n0,0,9,0\n0,1,1,1\n1,1,a,1\n0,1,1,1\n2,7,0,0\n";
    let lines: Vec<String> = Trace::problems(text, 2, &FLOOR).iter().map(ToString::to_string).collect();
    assert_eq!(lines.len(), 4, "{lines:?}");
    for (line, number) in lines.iter().zip([2, 4, 5, 6]) {
        assert!(line.starts_with(&format!("line {number}: ")), "{line}");
    }
    assert!(Trace::problems(TWO, 2, &FLOOR).is_empty());
}

#[test]
fn a_user_faster_than_a_report_may_say_is_refused_at_any_small_time() {
    let problems = |body: &str| {
        let found = Trace::problems(&format!("time,user,x,y\n0,0,0,0\n{body}"), 1, &FLOOR);
        found.iter().map(ToString::to_string).collect::<Vec<_>>()
    };
    for time in ["1e-300", "1e-9", "0.02"] {
        let found = problems(&format!("{time},0,2,1\n1,0,2,1\n"));
        let [problem] = &found[..] else { panic!("{found:?} at {time} s") };
        assert!(problem.starts_with("line 3: user 0 moves 2.236 m within "), "{problem}");
        assert!(problem.contains("expected at most 100 m/s; check the times"), "{problem}");
    }
    assert_eq!(problems("0.03,0,2,1\n1,0,2,1\n"), [""; 0], "75 m/s");
    assert_eq!(problems("1e-300,0,0,0\n1,0,2,1\n"), [""; 0], "a user who stands");
}

#[test]
fn errors_name_the_line() {
    let error = |body: &str| Trace::parse(&format!("time,user,x,y\n{body}"), 2, &FLOOR).unwrap_err().to_string();
    assert!(error("0,0,1").contains("line 2: number of columns 3"));
    assert!(error("0,0,1,1\n0,0,x,1").contains("line 3: invalid x `x`"));
    assert!(error("0,0,1,NaN").contains("line 2: invalid y `NaN`"));
    assert!(error("0,-1,1,1").contains("line 2: invalid user `-1`"));
    assert!(error("0,2,1,1").contains("line 2: unknown user 2: expected 0 to 1"));
    assert!(error("0,0,2.6,1").contains("line 2: (2.6, 1) is outside"));
    assert!(error("1,0,1,1\n1,0,1,1").contains("line 3: time 1 of user 0 is not after 1"));
    assert!(error("1,0,1,1\n1,0,1,1").ends_with("sort the rows by time"));
    assert!(error("12:00:00,0,1,1").ends_with("write a date or a time of day as seconds"));
    assert!(error("1,0,1,1").contains("user 1 has no sample"));
    assert!(Trace::parse(&"t,".repeat(1000), 1, &FLOOR).unwrap_err().to_string().len() < 500);
    assert!(Trace::parse("t,u,x,y\n", 1, &FLOOR).unwrap_err().to_string().contains("line 1: invalid header `t,u,x,y`"));
}
