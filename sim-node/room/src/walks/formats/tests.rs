//! Small synthetic texts in the published layout of each format.

use super::*;

type Rows = Vec<Result<Row, RowRefusal>>;

fn rows(source: Source, text: &str) -> Result<Rows, ReadError> {
    let mut rows = Vec::new();
    read(source, text.as_bytes(), &mut |row| rows.push(row))?;
    Ok(rows)
}

fn of(format: WalkFormat) -> Source {
    Source { format, frame_rate_hz: None }
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
    let at_25_hz = rows(Source { frame_rate_hz: Some(25.0), ..of(WalkFormat::EthUcy) }, OBSMAT).expect("readable");
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
    let endless = "0".repeat(2 << 20);
    assert!(error(WalkFormat::Atc, &endless).contains("line 1: the line does not end"));
    let mut latin = Vec::from(*b"0,0,1,2\n");
    latin.push(0xff);
    assert!(read(of(WalkFormat::Atc), &latin[..], &mut |_| {}).is_err());
}
