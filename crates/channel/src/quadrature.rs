//! A quadrature rule of eight points for the mean of a smooth function over an LED panel.
//!
//! A square grid of m x m points with spacing d has the moments E[x^2] = (m^2 - 1) d^2 / 12, E[x^4]
//! = (m^2 - 1)(3 m^2 - 7) d^4 / 240 and E[x^2 y^2] = E[x^2]^2; its odd moments are zero. The rule
//! has four points on the axes, (+-r, 0) and (0, +-r), with weight A, and four on the diagonals,
//! (+-s, +-s), with weight B. Its moments equal those of the grid up to the fifth degree where,
//! with a = E[x^2] and c^2 = (E[x^4] - a^2) / 2,
//!
//! r^2 = (a^2 + c^2) / a,  s^2 = a (a^2 + c^2) / (a^2 - c^2),  A = (a c / (a^2 + c^2))^2,  B =
//! ((a^2 - c^2) / (a^2 + c^2))^2 / 4.
//!
//! The mean of a function by this rule therefore differs from the mean over the grid in terms of
//! the sixth degree only.

use crate::geometry::Vec3;

/// Number of points of a panel that one pass of the inner loops evaluates together.
pub(crate) const POINT_LANES: usize = 4;

/// Accepted relative difference from the mean over the grid; rounding errors are not much smaller.
const TOLERANCE: f64 = 1e-11;

/// Smallest number of points per side for which the rule saves enough evaluations.
const LEAST_SIDE: usize = 4;

/// A group of points of a panel: offsets from its centre in m, and weights.
#[derive(Clone, Debug)]
pub(crate) struct PointLanes<const N: usize> {
    pub x: [f64; N],
    pub y: [f64; N],
    pub weight: [f64; N],
}

impl PointLanes<1> {
    /// The only point of a point LED.
    pub const CENTRE: Self = Self { x: [0.0], y: [0.0], weight: [1.0] };
}

impl PointLanes<POINT_LANES> {
    /// The eight points, with the total weight of `all` points.
    pub fn of_few(few: &FewPoints, all: usize) -> Vec<Self> {
        let lanes = |values: &[f64; 8], first: usize| std::array::from_fn(|lane| values[first + lane]);
        (0..few.x.len())
            .step_by(POINT_LANES)
            .map(|first| Self {
                x: lanes(&few.x, first),
                y: lanes(&few.y, first),
                weight: lanes(&few.weight, first).map(|weight: f64| weight * all as f64),
            })
            .collect()
    }
}

impl<const N: usize> PointLanes<N> {
    /// At most `N` points of a panel with weight 1; the remaining lanes have weight 0.
    pub fn new(points: &[Vec3], centre: &Vec3) -> Self {
        let offset = |index: usize| points.get(index).map_or(Vec3::zeros(), |point| point - centre);
        Self {
            x: std::array::from_fn(|index| offset(index).x),
            y: std::array::from_fn(|index| offset(index).y),
            weight: std::array::from_fn(|index| if index < points.len() { 1.0 } else { 0.0 }),
        }
    }
}

/// The eight points that replace a grid.
#[derive(Clone, Debug)]
pub(crate) struct FewPoints {
    /// Offsets from the centre of the grid, in the unit of `cell`.
    pub x: [f64; 8],
    pub y: [f64; 8],
    /// Weights with the sum 1.
    pub weight: [f64; 8],
}

impl FewPoints {
    /// The eight points for a grid of `side` x `side` points with spacing `cell`; `None` for a grid
    /// of few points.
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

/// Square of the smallest distance D at which the rule gives the mean of 1 / D^(n + 3) within the
/// tolerance.
///
/// `half_side`: half side h of the grid; `order`: Lambertian order n. With t = (2 x . d + x^2) /
/// D^2, at most about 2 h / D, the terms of the sixth degree of (1 + t)^-q, q = (n + 3) / 2, are at
/// most 64 q (q + 1) ... (q + 5) / 6! (h / D)^6. The moments of the sixth degree differ by less
/// than h^6 / 20.
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
            assert!((found - expected).abs() > 1e-3 * expected, "the moments of the sixth degree differ");
        }
        assert!(FewPoints::of_grid(3, 0.7).is_none() && FewPoints::of_grid(5, 0.0).is_none());
    }

    #[test]
    fn beyond_the_stated_distance_the_mean_is_that_of_the_grid() {
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
