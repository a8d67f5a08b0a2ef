//! Checks of NumPy arrays, and their conversion to the types of the channel.

use heliostat_channel::{Cylinder, MirrorAngles, Orientation, Vec3};
use heliostat_scenario::USERS_MAX;
use numpy::{PyArray1, PyReadonlyArray1, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;

use crate::error::refused;

/// Roll and yaw as arrays of shape (M,).
pub type AnglePair<'py> = (Bound<'py, PyArray1<f64>>, Bound<'py, PyArray1<f64>>);

/// Positions from an array of shape (K, 3), in m.
pub fn positions(array: &PyReadonlyArray2<'_, f64>, name: &str) -> PyResult<Vec<Vec3>> {
    if array.shape()[1] != 3 {
        return Err(refused(format!("{name} has the shape {:?}, expected (users, 3): x, y, z in m", array.shape())));
    }
    let rows: Vec<Vec3> = array.as_array().rows().into_iter().map(|row| Vec3::new(row[0], row[1], row[2])).collect();
    if rows.is_empty() {
        return Err(refused(format!("{name} holds no user, expected at least one row")));
    }
    all_finite(rows.iter().flat_map(|row| row.iter().copied()), name)?;
    Ok(rows)
}

/// Orientations from the normals of receivers, an array of shape (K, 3) of vectors of any length: the smallest
/// rotations from an upright receiver.
pub fn orientations(normals: &PyReadonlyArray2<'_, f64>) -> PyResult<Vec<Orientation>> {
    let normals = positions(normals, "normals")?;
    if let Some(user) = normals.iter().position(|normal| *normal == Vec3::zeros()) {
        return Err(refused(format!(
            "normals holds a vector of length 0 for user {user}, expected a direction, such as 0, 0, 1 for a receiver that faces up"
        )));
    }
    let orientation = |normal: &Vec3| {
        Orientation::from_polar_azimuth(normal.x.hypot(normal.y).atan2(normal.z), normal.y.atan2(normal.x))
    };
    Ok(normals.iter().map(orientation).collect())
}

/// Refuses more users than a room may have: the tables of the solver grow with their square.
pub fn few_users(users: usize) -> PyResult<()> {
    if users > USERS_MAX {
        return Err(refused(format!("positions holds {users} users, expected at most {USERS_MAX}")));
    }
    Ok(())
}

/// Cylinders from an array of shape (N, 4): x, y, radius and height in m; none without the array.
pub fn cylinders(array: Option<&PyReadonlyArray2<'_, f64>>) -> PyResult<Vec<Cylinder>> {
    let Some(array) = array else { return Ok(Vec::new()) };
    if array.shape()[1] != 4 {
        let shape = array.shape();
        return Err(refused(format!("blockers has the shape {shape:?}, expected (n, 4): x, y, radius, height in m")));
    }
    let rows = array.as_array();
    all_finite(rows.iter().copied(), "blockers")?;
    for (column, quantity) in [(2, "radius"), (3, "height")] {
        if let Some(value) = rows.column(column).iter().find(|value| **value < 0.0) {
            return Err(refused(format!("blockers holds the {quantity} {value}, expected metres from 0")));
        }
    }
    let cylinder = |row: numpy::ndarray::ArrayView1<'_, f64>| Cylinder {
        x_m: row[0],
        y_m: row[1],
        radius_m: row[2],
        height_m: row[3],
    };
    Ok(rows.rows().into_iter().map(cylinder).collect())
}

/// Finite numbers of an array of this length.
pub fn numbers(array: &PyReadonlyArray1<'_, f64>, length: usize, name: &str) -> PyResult<Vec<f64>> {
    if array.len() != length {
        return Err(refused(format!("{name} has the length {}, expected {length}", array.len())));
    }
    let values: Vec<f64> = array.as_array().iter().copied().collect();
    all_finite(values.iter().copied(), name)?;
    Ok(values)
}

/// Minimum rates in bit/s from those of this number of users in Mbit/s.
pub fn min_rates_bps(array: &PyReadonlyArray1<'_, f64>, users: usize) -> PyResult<Vec<f64>> {
    let rates = numbers(array, users, "min_rate_mbps")?;
    match rates.iter().find(|rate| **rate < 0.0) {
        Some(rate) => Err(refused(format!("min_rate_mbps holds {rate}, expected 0 or more"))),
        None => Ok(rates.iter().map(|rate| 1e6 * rate).collect()),
    }
}

/// Roll and yaw of this number of mirrors, in rad.
pub fn angles(
    roll: &PyReadonlyArray1<'_, f64>,
    yaw: &PyReadonlyArray1<'_, f64>,
    mirrors: usize,
) -> PyResult<MirrorAngles> {
    Ok(MirrorAngles { roll: numbers(roll, mirrors, "roll")?, yaw: numbers(yaw, mirrors, "yaw")? })
}

/// Angles as a pair of arrays.
pub fn pair<'py>(py: Python<'py>, angles: MirrorAngles) -> AnglePair<'py> {
    (PyArray1::from_vec(py, angles.roll), PyArray1::from_vec(py, angles.yaw))
}

fn all_finite(mut values: impl Iterator<Item = f64>, name: &str) -> PyResult<()> {
    match values.find(|value| !value.is_finite()) {
        Some(value) => Err(refused(format!("{name} holds {value}, expected finite numbers"))),
        None => Ok(()),
    }
}
