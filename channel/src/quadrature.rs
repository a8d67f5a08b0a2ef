//! Fewer points for the mean over an LED panel, where what is averaged is smooth.
//!
//! A square grid of m x m points, a cell d apart, has the moments E[x^2] = (m^2 - 1) d^2 / 12, E[x^4] = (m^2 - 1)(3 m^2 - 7) d^4 / 240 and
//! E[x^2 y^2] = E[x^2]^2, and no odd ones. Four points on the axes at (+-r, 0), (0, +-r) and four on the diagonals at (+-s, +-s) with the weights
//! A and B have the same ones up to the fifth degree where, with a = E[x^2] and c^2 = (E[x^4] - a^2) / 2,
//!
//! r^2 = (a^2 + c^2) / a,  s^2 = a (a^2 + c^2) / (a^2 - c^2),  A = (a c / (a^2 + c^2))^2,  B = ((a^2 - c^2) / (a^2 + c^2))^2 / 4.
//!
//! So their mean of a function differs from the grid's in terms of the sixth degree only.

/// Relative difference from the mean over all points that is let pass: what rounding leaves of it is not much less.
const TOLERANCE: f64 = 1e-11;

/// A grid of at least this many points a side has more than eight points, and by enough to matter.
const LEAST_SIDE: usize = 4;

/// Eight points in place of a grid.
#[derive(Clone, Debug)]
pub(crate) struct FewPoints {
    /// Offsets from the grid's centre.
    pub x: [f64; 8],
    pub y: [f64; 8],
    /// Their sum is 1.
    pub weight: [f64; 8],
}

impl FewPoints {
    /// The eight points for a grid of `side` x `side` points, `cell` apart; none where they would not be fewer.
    pub fn of_grid(side: usize, cell: f64) -> Option<Self> {
        if side < LEAST_SIDE || cell == 0.0 {
            return None;
        }
        let m2 = (side * side) as f64;
        let second = (m2 - 1.0) / 12.0;
        let fourth = (m2 - 1.0) * (3.0 * m2 - 7.0) / 240.0;
        let (a2, c2) = (second * second, (fourth - second * second) / 2.0);
        let r = cell * ((a2 + c2) / second).sqrt();
        let s = cell * (second * (a2 + c2) / (a2 - c2)).sqrt();
        let on_axis = a2 * c2 / (a2 + c2).powi(2);
        let on_diagonal = ((a2 - c2) / (a2 + c2)).powi(2) / 4.0;
        Some(Self {
            x: [r, -r, 0.0, 0.0, s, s, -s, -s],
            y: [0.0, 0.0, r, -r, s, -s, s, -s],
            weight: [on_axis, on_axis, on_axis, on_axis, on_diagonal, on_diagonal, on_diagonal, on_diagonal],
        })
    }
}

/// Square of the distance from which on the eight points give the mean of 1 / D^(n + 3) to within the tolerance, for a grid of this half side
/// and a Lambertian order n.
///
/// With t = (2 x . d + x^2) / D^2, at most about 2 h / D, the terms of the sixth degree of (1 + t)^-q, q = (n + 3) / 2, are at most
/// 64 q (q + 1) ... (q + 5) / 6! (h / D)^6; the moments of sixth degree differ by less than a twentieth of h^6.
pub(crate) fn smooth_from_squared(half_side: f64, order: f64) -> f64 {
    let q = (order + 3.0) / 2.0;
    let coefficient: f64 = (0..6).map(|k| (q + f64::from(k)) / f64::from(k + 1)).product();
    let ratio = (0.05 * 64.0 * coefficient / TOLERANCE).cbrt();
    half_side * half_side * ratio
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The grid's points.
    fn grid(side: usize, cell: f64) -> impl Iterator<Item = (f64, f64)> {
        let offset = move |index: usize| (index as f64 - 0.5 * (side - 1) as f64) * cell;
        (0..side * side).map(move |index| (offset(index % side), offset(index / side)))
    }

    fn means(side: usize, cell: f64, value: impl Fn(f64, f64) -> f64) -> (f64, f64) {
        let few = FewPoints::of_grid(side, cell).expect("fewer");
        let found = (0..8).map(|point| few.weight[point] * value(few.x[point], few.y[point])).sum();
        (found, grid(side, cell).map(|(x, y)| value(x, y)).sum::<f64>() / (side * side) as f64)
    }

    #[test]
    fn eight_points_have_the_moments_of_the_grid() {
        for side in [4, 5, 8, 15] {
            for (i, j) in (0..=5).flat_map(|i| (0..=5 - i).map(move |j| (i, j))) {
                let (found, expected) = means(side, 0.7, |x, y| x.powi(i) * y.powi(j));
                assert!(
                    (found - expected).abs() < 1e-12 * (1.0 + expected.abs()),
                    "{side} x^{i} y^{j}: {found}, {expected}"
                );
            }
            let (found, expected) = means(side, 0.7, |x, _| x.powi(6));
            assert!((found - expected).abs() > 1e-3 * expected, "no rule of eight points has them all");
        }
        assert!(FewPoints::of_grid(3, 0.7).is_none() && FewPoints::of_grid(5, 0.0).is_none());
    }

    #[test]
    fn from_the_stated_distance_on_the_mean_is_the_grids() {
        for order in [1.0, 3.5, 12.0] {
            for side in [4, 5, 12] {
                let half = 0.5 * (side - 1) as f64;
                let distance = smooth_from_squared(half, order).sqrt();
                for step in 0..60 {
                    let (up, round) = (f64::from(step % 6) / 6.0 * 1.5, f64::from(step));
                    let (x0, y0, z) =
                        (distance * up.sin() * round.cos(), distance * up.sin() * round.sin(), distance * up.cos());
                    let value =
                        |x: f64, y: f64| ((x0 + x).powi(2) + (y0 + y).powi(2) + z * z).powf(-(order + 3.0) / 2.0);
                    let (found, expected) = means(side, 1.0, value);
                    assert!((found / expected - 1.0).abs() < 2.0 * TOLERANCE, "{order} {side}: {found} {expected}");
                }
            }
        }
    }
}
