//! Several mirror arrays in a scenario: `[[mirrors]]`.

use heliostat_scenario::{GeometryDifference, Scenario, ScenarioError, Wall};

const TWO: &str = "name = \"two\"\n\n[[mirrors]]\nrows = 4\ncolumns = 6\n\n\
                   [[mirrors]]\nrows = 3\ncolumns = 5\nwall = \"-x\"\nreflectivity = 0.8\n";

fn message(text: &str) -> String {
    Scenario::from_toml(text).expect_err("refused").to_string()
}

#[test]
fn two_tables_describe_two_arrays() {
    let two = Scenario::from_toml(TWO).expect("valid");
    assert_eq!((two.mirrors.arrays().len(), two.mirror_count(), two.mirrors.columns()), (2, 39, 11));
    assert_eq!(two.mirrors.to_string(), "4 x 6 and 3 x 5");
    assert_eq!(two.mirrors.arrays()[1].wall, Wall::MinusX);
    let model = two.channel_model().expect("a model");
    assert_eq!((model.mirrors.range(0), model.mirrors.range(1)), (0..24, 24..39));
    assert_eq!((model.mirrors.positions()[30].x, model.mirrors.reflectivity(30)), (-2.5, 0.8));
    assert_eq!(model.mirrors.reflectivity(3), 0.95);
}

#[test]
fn the_effective_configuration_of_several_arrays_can_be_read_again() {
    let two = Scenario::from_toml(TWO).expect("valid");
    assert_eq!(two.to_toml().matches("[[mirrors]]").count(), 2);
    assert_eq!(Scenario::from_toml(&two.to_toml()).expect("valid"), two);
}

#[test]
fn a_list_of_one_table_is_the_same_scenario_as_the_table() {
    let [list, table] =
        ["[[mirrors]]\nrows = 4\n", "[mirrors]\nrows = 4\n"].map(|text| Scenario::from_toml(text).expect("valid"));
    assert_eq!((list.hash(), list.geometry_hash()), (table.hash(), table.geometry_hash()));
    assert!(table.to_toml().contains("\n[mirrors]\n"));
}

#[test]
fn an_override_names_the_array() {
    let two = Scenario::from_toml(TWO).expect("valid");
    let changed = two.with_overrides(&["mirrors.1.rows=2"]).expect("valid");
    let rows: Vec<usize> = changed.mirrors.arrays().iter().map(|array| array.rows).collect();
    assert_eq!(rows, [4, 2]);
    let error = two.with_overrides(&["mirrors.rows=2"]).expect_err("refused");
    assert!(matches!(error, ScenarioError::Override { .. }), "{error}");
    let error = two.with_overrides(&["mirrors.2.rows=2"]).expect_err("refused");
    assert_eq!(error.to_string(), "mirrors has no entry 2: expected an index from 0 to 1");
}

#[test]
fn a_refusal_names_the_array_and_the_line() {
    let refused = message(&TWO.replace("0.8", "1.8"));
    assert_eq!(refused, "line 11: mirrors.1.reflectivity = 1.8: expected a number from 0 to 1");
    let unknown = message(&TWO.replace("reflectivity", "reflectvity"));
    assert!(unknown.contains("line 11") && unknown.contains("unknown field `reflectvity`"), "{unknown}");
    let wide = message(&TWO.replace("columns = 5", "columns = 50"));
    assert!(wide.starts_with("line 9: mirrors.1.columns = 50"), "{wide}");
    assert!(message("mirrors = []\n").contains("[[mirrors]]"));
    let many = "[[mirrors]]\nrows = 1\ncolumns = 1\n".repeat(17);
    assert!(message(&many).contains("mirrors (arrays) = 17: expected at most 16"));
}

#[test]
fn arrays_that_overlap_are_refused() {
    let same_wall = TWO.replace("\"-x\"", "\"+y\"");
    let refused = message(&same_wall);
    assert!(
        refused.contains("mirrors.1.centre_height_m") && refused.contains("overlaps that of mirrors.0"),
        "{refused}"
    );
    let above = same_wall.replace("reflectivity = 0.8", "centre_height_m = 2.7");
    assert!(Scenario::from_toml(&above).is_ok(), "one above the other");
}

#[test]
fn a_mirror_that_touches_the_ceiling_is_accepted() {
    // In floating point, 2.16 plus half of 0.48 is above 2.4.
    let place = ["mirrors.rows=1", "mirrors.height_m=0.48", "mirrors.centre_height_m=2.16"];
    let room = ["room.height_m=2.4", "led.positions_m=[[0,0,2.4]]"];
    assert_eq!(Scenario::default().with_overrides(&[&room[..], &place[..]].concat()).err(), None);
}

#[test]
fn the_check_lists_each_problem_of_several_arrays_once() {
    let text = TWO.replace("0.8", "1.8").replace("rows = 4", "rows = 0").replace("columns = 5", "colums = 5");
    let lines: Vec<_> = Scenario::check_all(&text).problems.iter().map(|problem| problem.line).collect();
    assert_eq!(lines, [Some(4), Some(9), Some(11)]);
}

#[test]
fn a_geometry_has_every_array_and_a_difference_names_the_array() {
    let two = Scenario::from_toml(TWO).expect("valid");
    let announced = Scenario::from_geometry_toml(&two.geometry_toml()).expect("valid");
    assert_eq!(announced.mirrors, two.mirrors);
    assert_eq!(two.geometry_difference(&announced), None);
    let difference = |text: &str| {
        let other = Scenario::from_toml(text).expect("valid");
        let GeometryDifference { key, here, there, .. } = two.geometry_difference(&other).expect("another geometry");
        (key, here, there)
    };
    let named = |key: &str, here: &str, there: &str| (key.to_owned(), here.to_owned(), there.to_owned());
    assert_eq!(difference(&TWO.replace("0.8", "0.7")), named("mirrors.1.reflectivity", "0.8", "0.7"));
    assert_eq!(difference("name = \"one\"\n"), named("number of mirror arrays", "2", "1"));
}

#[test]
fn a_command_for_one_array_refuses_several() {
    let two = Scenario::from_toml(TWO).expect("valid");
    assert_eq!(two.require_one_array().expect_err("refused"), ScenarioError::SeveralArrays { count: 2 });
    assert!(Scenario::default().require_one_array().is_ok());
}
