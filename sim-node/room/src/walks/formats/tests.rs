//! Small synthetic texts in the published layout of each format.

use super::*;

type Rows = Vec<Result<Row, RowRefusal>>;

fn rows(source: &Source, text: &str) -> Result<Rows, ReadError> {
    let mut rows = Vec::new();
    read(source, text.as_bytes(), &mut |row| rows.push(row))?;
    Ok(rows)
}

fn of(format: WalkFormat) -> &'static Source {
    Box::leak(Box::new(Source::of(format)))
}

/// Time, pedestrian and position of each row that can be used.
fn positions(rows: &Rows) -> Vec<(f64, &str, [f64; 2])> {
    rows.iter().flatten().map(|row| (row.time_s, row.pedestrian.as_str(), row.at_m)).collect()
}

fn refusals(rows: &Rows) -> Vec<(u64, &str)> {
    rows.iter().filter_map(|row| row.as_ref().err()).map(|refusal| (refusal.line, refusal.reason.as_str())).collect()
}

/// obsmat.txt: frame number, pedestrian, x, z, y, and velocities, as floating-point numbers.
const OBSMAT: &str = "  7.8000000e+02   1.0000000e+00   8.4568443e+00   0.0000000e+00   3.5880664e+00   1.6  0.0  0.1
  7.9000000e+02   1.0000000e+00   9.1256812e+00   0.0000000e+00   3.6591530e+00   1.6  0.0  0.1
  8.1000000e+02   2.0000000e+00   1.0000000e+00   0.0000000e+00   2.0000000e+00   0.0  0.0  0.0
";

#[test]
fn eth_ucy_takes_the_third_and_fifth_column_and_frames_of_0_4_s() {
    let read = rows(of(WalkFormat::EthUcy), OBSMAT).expect("readable");
    let found = positions(&read);
    assert_eq!((found[0].1, found[0].2), ("1", [8.4568443, 3.5880664]));
    assert!((found[1].0 - found[0].0 - 0.4).abs() < 1e-9 && (found[2].0 - found[0].0 - 1.2).abs() < 1e-9);
    let at_25_hz =
        rows(&Source { frame_rate_hz: Some(25.0), ..Source::of(WalkFormat::EthUcy) }, OBSMAT).expect("readable");
    assert_eq!(positions(&at_25_hz)[0].0, 31.2);
    let four = rows(of(WalkFormat::EthUcy), "0\t3\t1.5\t-2\n10\t3\t1.6\t-2\n").expect("readable");
    assert_eq!(positions(&four), [(0.0, "3", [1.5, -2.0]), (0.4, "3", [1.6, -2.0])]);
}

#[test]
fn atc_positions_are_in_mm_and_the_facing_angle_is_the_heading() {
    let text = "1351039728.980,9123700,41345,-22531,1602.5,1155.6,2.768,2.751\n\
                1351039729.013,9123700,41300,-22500,1602.5,1155.6,2.768,nan\n\
                1351039729.046,9123700,41255\n";
    let read = rows(of(WalkFormat::Atc), text).expect("readable");
    assert_eq!(positions(&read), [(1351039728.98, "9123700", [41.345, -22.531])]);
    assert_eq!(read[0].as_ref().expect("a row").heading_rad, Some(2.751));
    let refused = refusals(&read);
    assert_eq!((refused[0].0, refused[1].0), (2, 3));
    assert!(refused[0].1.contains("invalid facing angle `nan`") && refused[1].1.contains("number of columns 3"));
}

/// Metadata, column names, two frames: helmet 1 has a centroid, helmet 2 has markers only, the
/// robot is no pedestrian.
const THOR_MAGNI: &str = "FILE_ID,THOR-Magni_120522_SC1B_R1,,,
N_FRAMES_QTM,3
BODY_NAMES,DARKO_Robot,Helmet_1,Helmet_2
Frame,Time,DARKO_Robot - 1 X,DARKO_Robot - 1 Y,Helmet_1 - 1 X,Helmet_1 - 1 Y,Helmet_1 Centroid_X,Helmet_1 Centroid_Y,Helmet_1 Centroid_Z,Helmet_1 R0,Helmet_2 - 1 X,Helmet_2 - 1 Y,Helmet_2 - 2 X,Helmet_2 - 2 Y
1,0.00,-4234.196,-779.604,9,9,1000.5,2000,1700,1,-1000,500,-2000,700
2,0.01,-4234.196,-779.604,9,9,,,,,-1000,500,NaN,NaN
3,x,-4234.196,-779.604,9,9,,,,,-1000,500,NaN,NaN
";

#[test]
fn thor_magni_helmets_are_pedestrians_with_their_centroid_or_the_mean_of_their_markers() {
    let read = rows(of(WalkFormat::ThorMagni), THOR_MAGNI).expect("readable");
    let expected = [(0.0, "Helmet_1", [1.0005, 2.0]), (0.0, "Helmet_2", [-1.5, 0.6]), (0.01, "Helmet_2", [-1.0, 0.5])];
    assert_eq!(positions(&read), expected);
    assert_eq!(refusals(&read), [(7, "invalid Time `x`: expected a finite number")]);
}

#[test]
fn csv_columns_are_found_by_name_and_headings_are_optional() {
    let text = "user,time,x,y,z,heading_deg\nann,0,1,2,9,90\n# a comment\nann,0.1,1,inf,9,90\n";
    let read = rows(of(WalkFormat::Csv), text).expect("readable");
    assert_eq!(positions(&read), [(0.0, "ann", [1.0, 2.0])]);
    assert_eq!(read[0].as_ref().expect("a row").heading_rad, Some(std::f64::consts::FRAC_PI_2));
    assert_eq!(refusals(&read), [(4, "invalid y `inf`: expected a finite number")]);
    let without = rows(of(WalkFormat::Csv), "time,user,x,y\n0,0,1,2\n").expect("readable");
    assert_eq!(without[0].as_ref().expect("a row").heading_rad, None);
}

#[test]
fn a_file_without_rows_or_columns_is_refused_with_what_is_expected() {
    let error = |format, text: &str| rows(of(format), text).expect_err("refused").to_string();
    for format in [WalkFormat::EthUcy, WalkFormat::Atc, WalkFormat::Csv] {
        assert!(error(format, "").contains("no rows"), "{format:?}");
    }
    assert!(error(WalkFormat::Csv, "time,user,x\n0,0,1\n").contains("line 1: missing column y: expected the header"));
    assert!(error(WalkFormat::Csv, "time,user,x,y\n").contains("no rows"));
    assert!(error(WalkFormat::ThorMagni, "a,b\n1,2\n").contains("missing column Time"));
    assert!(error(WalkFormat::ThorMagni, "Frame,Time,DARKO_Robot - 1 X\n").contains("missing column Helmet_1"));
    let twice = error(WalkFormat::Csv, "time,user,x,y,x\n0,0,1,2,3\n");
    assert!(twice.contains("line 1: two columns have the name x: expected one"), "{twice}");
    let returns = "time,user,x,y\r".to_owned() + &"0,0,1,2\r".repeat(1 << 18);
    for text in [returns.as_str(), "# comment\rtime,user,x,y\r0,0,1,2\r"] {
        let found = error(WalkFormat::Csv, text);
        assert!(found.starts_with("line 1: its lines end with a carriage return alone"), "{found}");
    }
    assert!(error(WalkFormat::Csv, &format!("{}\n", "name,".repeat(9999))).len() < 500);
    let endless = "0".repeat(2 << 20);
    assert!(error(WalkFormat::Atc, &endless).contains("line 1: the line does not end"));
    let mut latin = Vec::from(*b"0,0,1,2\n");
    latin.push(0xff);
    assert!(read(of(WalkFormat::Atc), &latin[..], &mut |_| {}).is_err());
}

#[test]
fn the_most_frequent_step_of_a_pedestrian_is_the_annotation_interval() {
    let text = "0 1 0 0\n0 2 5 0\n10 1 1 0\n11 2 6 0\n20 1 2 0\n20 2 7 0\n30 1 3 0\n30 2 8 0\n";
    let read = rows(of(WalkFormat::EthUcy), text).expect("readable");
    let times: Vec<f64> = positions(&read).iter().map(|(time_s, _, _)| *time_s).collect();
    assert!((times[7] - 1.2).abs() < 1e-9 && (times[3] - 0.44).abs() < 1e-9, "{times:?}");
}

#[test]
fn separators_and_decimal_commas_are_recognised() {
    for (format, text) in [
        (WalkFormat::EthUcy, "0,3,1.5,-2\n10,3,1.6,-2\n"),
        (WalkFormat::EthUcy, "0;3;1,5;-2\n10;3;1,6;-2\n"),
        (WalkFormat::Csv, "\u{feff}time;user;x;y\r\n0,0;3;1,5;-2\r\n0,4;3;1,6;-2\r\n"),
        (WalkFormat::Csv, "time\tuser\tx\ty\n0\t3\t1.5\t-2\n0.4\t3\t1.6\t-2\n"),
        (WalkFormat::Csv, "time|user|x|y\n0|3|1,5|-2\n0,4|3|1,6|-2\n"),
        (WalkFormat::Csv, "\"\",\"time\",\"user\",\"x\",\"y\"\n\"1\",0,3,1.5,-2\n\"2\",0.4,3,1.6,-2\n"),
    ] {
        let read = rows(of(format), text).expect("readable");
        assert_eq!(positions(&read), [(0.0, "3", [1.5, -2.0]), (0.4, "3", [1.6, -2.0])], "{text}");
    }
    let thousands = rows(of(WalkFormat::Csv), "time;user;x;y\n0;3;1,234.5;0\n").expect("readable");
    assert_eq!(refusals(&thousands), [(2, "invalid x `1,234.5`: expected a finite number")]);
}

#[test]
fn a_time_that_is_a_date_and_a_repeated_header_are_named() {
    let text = "time,user,x,y\n2026-03-01T12:00:00Z,3,1,2\n12:00:00,3,1,2\n01/03/2026,3,1,2\ntime,user,x,y\n-x,3,1,2\n";
    let read = rows(of(WalkFormat::Csv), text).expect("readable");
    let found = refusals(&read);
    for (line, reason) in &found[..3] {
        assert!(
            reason.ends_with("expected a finite number; write a date or a time of day as seconds"),
            "{line}: {reason}"
        );
    }
    assert!(found[3].1.ends_with("the header stands here again: import joined files one by one"), "{found:?}");
    assert_eq!(found[4], (6, "invalid time `-x`: expected a finite number"));
}

#[test]
fn an_experiment_has_the_pedestrian_first_and_its_rate_and_unit_in_comments() {
    let text = "# framerate: 16.00 fps\n# ID FR X Y Z\n3\t0\t150\t-200\t175\n3\t16\t160\t-200\t175\n";
    let expected = [(0.0, "3", [1.5, -2.0]), (1.0, "3", [1.6, -2.0])];
    assert_eq!(positions(&rows(of(WalkFormat::Experiment), text).expect("readable")), expected);
    let in_m = "# framerate: 16\n# id frame x/m y/m\n3 0 1.5 -2\n3 16 1.6 -2\n";
    assert_eq!(positions(&rows(of(WalkFormat::Experiment), in_m).expect("readable")), expected);
    let without = rows(of(WalkFormat::Experiment), "3 0 150 -200 175\n").expect_err("no rate").to_string();
    assert!(without.contains("the frame rate is not known"), "{without}");
    let as_eth = rows(of(WalkFormat::EthUcy), text).expect("read");
    assert!(refusals(&as_eth)[0].1.contains("the layout id frame x y z of the format experiment"));
}

#[test]
fn a_lost_marker_of_thor_enters_no_mean() {
    let text = "NO_OF_FRAMES\t2\nTIME_STAMP\t2024-05-01, 10:00:00\nFrame\tTime\tHelmet_1 - 1 X\tHelmet_1 - 1 Y\t\
                Helmet_1 - 2 X\tHelmet_1 - 2 Y\n1\t0\t2040\t0\t0.000\t0.000\n2\t0.4\t0\t0\t0\t0\n";
    let read = rows(of(WalkFormat::ThorMagni), text).expect("readable");
    assert_eq!(positions(&read), [(0.0, "Helmet_1", [2.04, 0.0])]);
}

#[test]
fn columns_of_a_csv_are_mapped_by_name_or_by_number_and_times_have_a_unit() {
    let map = |text: &str| ColumnMap::parse(text).expect("a map");
    let named = Source {
        columns: map("time=Timestamp [ms],user=Person ID,x=X [m],y=Y [m]"),
        time_unit_s: 1e-3,
        ..Source::of(WalkFormat::Csv)
    };
    let text = "Timestamp [ms],Person ID,X [m],Y [m]\n400,3,1.5,-2\n";
    let expected = [(0.4, "3", [1.5, -2.0])];
    assert_eq!(positions(&rows(&named, text).expect("readable")), expected);
    let numbered = Source { columns: map("time=1,user=2,x=3,y=4"), time_unit_s: 1e-3, ..Source::of(WalkFormat::Csv) };
    assert_eq!(positions(&rows(&numbered, "400,3,1.5,-2\n").expect("readable")), expected);
    let missing = rows(of(WalkFormat::Csv), text).expect_err("no such columns").to_string();
    assert!(missing.contains("missing column time") && missing.contains("`Person ID`"), "{missing}");
    let beyond = Source { columns: map("time=1,user=2,x=3,y=5"), ..Source::of(WalkFormat::Csv) };
    assert!(rows(&beyond, "0,3,1.5,-2\n").expect_err("no fifth").to_string().contains("number 5 (y)"));
    for wrong in ["time", "when=1", "time=0", "time=", "time=1,time=2"] {
        assert!(ColumnMap::parse(wrong).expect_err("refused").contains("expected time=COLUMN"), "{wrong}");
    }
}
