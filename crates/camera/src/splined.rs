//! mrcal's splined stereographic lens: a stereographic projection moved by a spline surface.
//!
//! `LENSMODEL_SPLINED_STEREOGRAPHIC_order=N_Nx=.._Ny=.._fov_x_deg=..` of mrcal's documentation ("Lens
//! models"). With the stereographic image-plane point `u` the pixel is `f (u + Δu(u)) + c`, where `Δu` is a
//! uniform B-spline of order 2 or 3 over `u`. The knots are spaced alike along x and y; the surface
//! is centred and spans `fov_x_deg` along x.

use std::sync::LazyLock;

use boresight_geometry::{MAX_LANES, Scalar};

use crate::pinhole::{CORE_GROUPS, CORE_NAMES, image_plane_point};
use crate::stereographic::{from_plane, linearize_to_plane, to_plane};
use crate::{CameraModel, LocalLinear, LocalSupport, MAX_LOCAL, ParamGroup};

/// The largest number of knots along an axis.
const MAX_KNOTS: u16 = 100;

/// How many cells beyond its edge the surface is continued, by the polynomial of its outermost cell.
///
/// mrcal continues without end. A cubic grows to anything within few cells, so that nothing seen
/// further out is worth its name.
const CONTINUED_CELLS: f64 = 2.0;

/// A splined stereographic lens of order `N`, 2 or 3.
///
/// Parameters: `fx fy cx cy`, then for each knot, row by row from the top left, how far the surface
/// moves the image along x and along y, in units of the focal length. Core and surface say the same
/// thing twice where all knots agree, so a solve holds the core or regularises the knots.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Splined<const N: usize> {
    n_columns: u16,
    n_rows: u16,
    fov_x_deg: u16,
}

impl<const N: usize> Splined<N> {
    /// Returns the lens with `columns` by `rows` knots over `fov_x_deg` degrees from left to right, or
    /// `None` for fewer than `N + 1` or more than 100 knots along an axis, or 360 degrees and more.
    pub fn new(columns: u16, rows: u16, fov_x_deg: u16) -> Option<Self> {
        let knots = N as u16 + 1..=MAX_KNOTS;
        let is_possible = knots.contains(&columns) && knots.contains(&rows) && (1..360).contains(&fov_x_deg);
        is_possible.then_some(Self { n_columns: columns, n_rows: rows, fov_x_deg })
    }

    /// Returns the number of columns and of rows of knots.
    pub fn knots(&self) -> [u16; 2] {
        [self.n_columns, self.n_rows]
    }

    /// Returns the angle that the surface spans from left to right, in degrees.
    pub fn fov_x_deg(&self) -> u16 {
        self.fov_x_deg
    }

    /// Returns the stereographic image-plane point of a knot.
    pub fn knot_in_plane(&self, column: u16, row: u16) -> [f64; 2] {
        let middle = self.middle();
        [
            (f64::from(column) - middle[0]) / self.cells_per_unit(),
            (f64::from(row) - middle[1]) / self.cells_per_unit(),
        ]
    }

    /// Returns the largest stereographic coordinates, along x and y, at which the surface is defined.
    pub fn edge_in_plane(&self) -> [f64; 2] {
        let half = |knots: u16| 0.5 * (f64::from(knots) - N as f64);
        [half(self.n_columns) / self.cells_per_unit(), half(self.n_rows) / self.cells_per_unit()]
    }

    /// Returns how many knots there are along a unit of the stereographic image plane.
    fn cells_per_unit(&self) -> f64 {
        let edge = 2.0 * (0.25 * f64::from(self.fov_x_deg).to_radians()).tan();
        // Of n knots, the outermost ones have only part of their weight inside the surface.
        0.5 * (f64::from(self.n_columns) - N as f64) / edge
    }

    /// Returns the grid coordinates of the middle of the image plane.
    fn middle(&self) -> [f64; 2] {
        [0.5 * (f64::from(self.n_columns) - 1.0), 0.5 * (f64::from(self.n_rows) - 1.0)]
    }

    /// Returns the squares of knots around points of the stereographic image plane with their weights,
    /// or `None` where the surface has ended.
    #[inline(always)]
    fn patch<T: Scalar>(&self, plane: [T; 2]) -> Option<Patch<T>> {
        let [middle_x, middle_y] = self.middle();
        let per_unit = self.cells_per_unit();
        let x = plane[0].mul_add(plane[0].like(per_unit), plane[0].like(middle_x));
        let y = plane[1].mul_add(plane[1].like(per_unit), plane[1].like(middle_y));
        let (columns, x) = cells::<T, N>(x, self.n_columns)?;
        let (rows, y) = cells::<T, N>(y, self.n_rows)?;
        let mut first = [0; MAX_LANES];
        for lane in 0..T::LANES {
            first[lane] = 4 + 2 * (rows[lane] * usize::from(self.n_columns) + columns[lane]);
        }
        let (across, across_slope) = basis::<T, N>(x, per_unit);
        let (down, down_slope) = basis::<T, N>(y, per_unit);
        Some(Patch { first, across, across_slope, down, down_slope })
    }

    /// Returns the image-plane point of a stereographic point, and its derivatives by that.
    fn surface(&self, params: &[f64], plane: [f64; 2]) -> Option<([f64; 2], [[f64; 2]; 2])> {
        let patch = self.patch(plane)?;
        let moved = patch.linearize::<N>(params, 2 * usize::from(self.n_columns), plane);
        Some((moved.plane, moved.d_plane))
    }

    /// Solves `surface(plane) = target` by Newton's method with step halving, and returns the solution
    /// if there the surface does not turn over.
    fn newton(&self, params: &[f64], start: [f64; 2], target: [f64; 2], tolerance: f64) -> Option<[f64; 2]> {
        // Steps are halved only far from the solution; the last few converge quadratically.
        const MAX_STEPS: usize = 40;
        let evaluate = |plane: [f64; 2]| {
            let (moved, slope) = self.surface(params, plane)?;
            let residual = [moved[0] - target[0], moved[1] - target[1]];
            Some((residual, residual[0].hypot(residual[1]), slope))
        };
        let mut plane = start;
        let (mut residual, mut size, mut slope) = evaluate(plane)?;
        'steps: for _ in 0..MAX_STEPS {
            if size == 0.0 {
                break;
            }
            let [[a, b], [c, d]] = slope;
            let determinant = a * d - b * c;
            let step = [
                (b * residual[1] - d * residual[0]) / determinant,
                (c * residual[0] - a * residual[1]) / determinant,
            ];
            let mut fraction = 1.0;
            for _ in 0..30 {
                let trial = [plane[0] + fraction * step[0], plane[1] + fraction * step[1]];
                if let Some(found) = evaluate(trial)
                    && found.1 < size
                {
                    plane = trial;
                    (residual, size, slope) = found;
                    continue 'steps;
                }
                if size <= 1e-3 * tolerance {
                    break;
                }
                fraction *= 0.5;
            }
            // No step improves: either rounding is reached, or nothing is there.
            break;
        }
        let [[a, b], [c, d]] = slope;
        (size <= tolerance && a > 0.0 && a * d - b * c > 0.0).then_some(plane)
    }
}

/// 24 columns of knots; rows and angle are left open.
impl<const N: usize> Default for Splined<N> {
    fn default() -> Self {
        Self { n_columns: 24, n_rows: 0, fov_x_deg: 0 }
    }
}

impl<const N: usize> CameraModel for Splined<N> {
    const LOCAL_SIDE: Option<usize> = Some(N + 1);
    const NAME: &'static str = match N {
        2 => "splined2",
        3 => "splined3",
        _ => panic!("splines are of order 2 or 3"),
    };

    const CONFIGURATION: Option<&'static str> = Some(
        "the columns and rows of knots, at most 100, and the angle they span across, such as 30x20:150deg; or \
         the columns alone",
    );

    fn configured(text: &str) -> Option<Self> {
        if let Ok(columns) = text.parse() {
            return Self::new(columns, MAX_KNOTS, 1).map(|_| Self { n_columns: columns, ..Self::default() });
        }
        let (knots, fov) = text.split_once(':')?;
        let (columns, rows) = knots.split_once('x')?;
        Self::new(columns.parse().ok()?, rows.parse().ok()?, fov.strip_suffix("deg")?.parse().ok()?)
    }

    fn configuration(&self) -> Option<String> {
        let Self { n_columns, n_rows, fov_x_deg } = self;
        Some(if self.is_complete() {
            format!("{n_columns}x{n_rows}:{fov_x_deg}deg")
        } else {
            n_columns.to_string()
        })
    }

    fn is_complete(&self) -> bool {
        self.n_rows > 0
    }

    /// Returns the surface that covers the directions, with half a cell to spare.
    fn completed(&self, directions: &[[f64; 3]]) -> Self {
        if self.is_complete() {
            return *self;
        }
        let mut reach = [0.0_f64; 2];
        for plane in directions.iter().filter_map(|direction| to_plane(*direction)) {
            reach = [reach[0].max(plane[0].abs()), reach[1].max(plane[1].abs())];
        }
        let n_cells = f64::from(self.n_columns) - N as f64;
        let edge = reach[0] * n_cells / (n_cells - 1.0).max(0.5);
        // Beyond 350 degrees the plane is so large that knots would be wasted.
        let fov_x_deg = (4.0 * (0.5 * edge).atan()).to_degrees().ceil().clamp(1.0, 350.0) as u16;
        let across = Self { fov_x_deg, ..*self };
        let n_cells = (2.0 * reach[1] * across.cells_per_unit() + 1.0).ceil();
        let n_rows = (n_cells as u16).saturating_add(N as u16).clamp(N as u16 + 1, MAX_KNOTS);
        Self { n_rows, ..across }
    }

    fn param_count(&self) -> usize {
        4 + 2 * usize::from(self.n_columns) * usize::from(self.n_rows)
    }

    /// Returns `fx fy cx cy`, then `x_3_7 y_3_7` and so on for column 3 and row 7 of the knots.
    fn param_names(&self) -> Vec<&'static str> {
        static KNOT_NAMES: LazyLock<Vec<[String; 2]>> = LazyLock::new(|| {
            let of_row = |row| {
                (0..MAX_KNOTS).map(move |column| ["x", "y"].map(|axis| format!("{axis}_{column}_{row}")))
            };
            (0..MAX_KNOTS).flat_map(of_row).collect()
        });
        let mut names = CORE_NAMES.to_vec();
        for row in KNOT_NAMES.chunks_exact(usize::from(MAX_KNOTS)).take(usize::from(self.n_rows)) {
            let row = row[..usize::from(self.n_columns)].as_flattened();
            names.extend(row.iter().map(String::as_str));
        }
        names
    }

    fn param_groups(&self) -> Vec<ParamGroup> {
        let mut groups = CORE_GROUPS.to_vec();
        groups.resize(self.param_count(), ParamGroup::Spline);
        groups
    }

    #[inline(always)]
    fn project<T: Scalar>(&self, params: &[T], point_in_cam: [T; 3]) -> Option<[T; 2]> {
        let [mut x, mut y] = to_plane(point_in_cam)?;
        let patch = self.patch([x, y])?;
        let row_stride = 2 * usize::from(self.n_columns);
        for row in 0..=N {
            for column in 0..=N {
                let weight = patch.down[row] * patch.across[column];
                let knot = row * row_stride + 2 * column;
                x = weight.mul_add(look_up(params, &patch.first, knot), x);
                y = weight.mul_add(look_up(params, &patch.first, knot + 1), y);
            }
        }
        Some([params[0].mul_add(x, params[2]), params[1].mul_add(y, params[3])])
    }

    #[inline(always)]
    fn linearize<T: Scalar>(
        &self,
        params: &[f64],
        point_in_cam: [T; 3],
        d_point: &mut [[T; 3]; 2],
        d_lens: [&mut [T]; 2],
    ) -> Option<[T; 2]> {
        let linear = self.linearize_locally(params, point_in_cam)?;
        *d_point = linear.d_point;
        let support = LocalSupport { side: N + 1, columns: self.n_columns.into(), rows: self.n_rows.into() };
        for (row, out) in d_lens.into_iter().enumerate() {
            out.fill(linear.pixel[0].like(0.0));
            for lane in 0..T::LANES {
                for k in 0..(N + 1) * (N + 1) {
                    let entry = &mut out[support.param(linear.first[lane], k, row) - 4];
                    *entry = entry.with_lane(lane, linear.weights[k].scale(params[row]));
                }
            }
        }
        Some(linear.pixel)
    }

    fn local_support(&self) -> Option<LocalSupport> {
        Some(LocalSupport { side: N + 1, columns: self.n_columns.into(), rows: self.n_rows.into() })
    }

    #[inline(always)]
    fn linearize_locally<T: Scalar>(&self, params: &[f64], point_in_cam: [T; 3]) -> Option<LocalLinear<T>> {
        let (plane, by_point) = linearize_to_plane(point_in_cam)?;
        let patch = self.patch(plane)?;
        let moved = patch.linearize::<N>(params, 2 * usize::from(self.n_columns), plane);
        let zero = plane[0].like(0.0);
        let mut linear = LocalLinear {
            pixel: moved.plane,
            d_point: [[zero; 3]; 2],
            first: patch.first,
            weights: [zero; MAX_LOCAL],
        };
        for row in 0..2 {
            linear.pixel[row] = zero.like(params[row]).mul_add(moved.plane[row], zero.like(params[2 + row]));
            let along_x = moved.d_plane[row][0].scale(params[row]);
            let along_y = moved.d_plane[row][1].scale(params[row]);
            for (axis, by_axis) in linear.d_point[row].iter_mut().enumerate() {
                *by_axis = along_x.mul_add(by_point[0][axis], along_y * by_point[1][axis]);
            }
        }
        for row in 0..=N {
            for column in 0..=N {
                linear.weights[row * (N + 1) + column] = patch.down[row] * patch.across[column];
            }
        }
        Some(linear)
    }

    /// Returns the surface that is the quasi-interpolant of the wanted one (de Boor & Fix 1973).
    fn following(&self, core: [f64; 4], pixel_of: &dyn Fn([f64; 3]) -> Option<[f64; 2]>) -> Option<Vec<f64>> {
        let (columns, rows) = (usize::from(self.n_columns), usize::from(self.n_rows));
        let mut wanted = Vec::with_capacity(columns * rows);
        for row in 0..self.n_rows {
            for column in 0..self.n_columns {
                let plane = self.knot_in_plane(column, row);
                let pixel = pixel_of(from_plane(plane))?;
                let moved = image_plane_point(&core, pixel);
                wanted.push([moved[0] - plane[0], moved[1] - plane[1]]);
            }
        }
        // A knot's own value is the surface's less this share of its second differences, which makes
        // parabolas exact; at the edge, those of the neighbour serve.
        let share = if N == 2 { 1.0 / 8.0 } else { 1.0 / 6.0 };
        let mut params = core.to_vec();
        for row in 0..rows {
            for column in 0..columns {
                let (x, y) = (column.clamp(1, columns - 2), row.clamp(1, rows - 2));
                params.extend([0, 1].map(|axis| {
                    let at = |column: usize, row: usize| wanted[row * columns + column][axis];
                    let across = at(x - 1, row) - 2.0 * at(x, row) + at(x + 1, row);
                    let down = at(column, y - 1) - 2.0 * at(column, y) + at(column, y + 1);
                    at(column, row) - share * (across + down)
                }));
            }
        }
        Some(params)
    }

    /// Returns a point on the ray that `pixel` sees, where the surface or its continuation by two cells
    /// leads there without turning over.
    fn unproject(&self, params: &[f64], pixel: [f64; 2]) -> Option<[f64; 3]> {
        let target = image_plane_point(params, pixel);
        // A millionth of a millipixel: far above rounding, far below what anyone measures.
        let tolerance = 1e-9 / params[0].max(params[1]);
        let inside = |plane: [f64; 2]| {
            let edge = self.edge_in_plane();
            [plane[0].clamp(-edge[0], edge[0]), plane[1].clamp(-edge[1], edge[1])]
        };
        if !target.iter().all(|x| x.is_finite()) {
            return None;
        }
        if let Some(plane) = self.newton(params, inside(target), target, tolerance) {
            return Some(from_plane(plane));
        }
        // The surface moves the image far: start at the knots that come nearest.
        let mut starts: Vec<(f64, [f64; 2])> = (0..self.n_rows)
            .flat_map(|row| (0..self.n_columns).map(move |column| (column, row)))
            .filter_map(|(column, row)| {
                let plane = inside(self.knot_in_plane(column, row));
                let (moved, [[a, b], [c, d]]) = self.surface(params, plane)?;
                let distance = (moved[0] - target[0]).hypot(moved[1] - target[1]);
                (a * d - b * c > 0.0).then_some((distance, plane))
            })
            .collect();
        starts.sort_by(|a, b| a.0.total_cmp(&b.0));
        starts
            .iter()
            .take(8)
            .find_map(|(_, start)| self.newton(params, *start, target, tolerance))
            .map(from_plane)
    }

    /// Returns `None`: where the surface ends depends on the direction, and `project` and `unproject` tell.
    fn monotonic_limit(&self, _: &[f64]) -> Option<f64> {
        None
    }

    /// Returns the stereographic projection with the same core: a flat surface.
    fn undistorted(&self, core: [f64; 4]) -> Vec<f64> {
        let mut params = core.to_vec();
        params.resize(self.param_count(), 0.0);
        params
    }

    fn examples() -> Vec<(Self, Vec<f64>)> {
        let common = Self { n_columns: 10, n_rows: 8, fov_x_deg: 100 };
        let wide = Self { n_columns: 9, n_rows: 7, fov_x_deg: 200 };
        let barrel = |[x, y]: [f64; 2]| {
            let r2 = x * x + y * y;
            [x * -0.06 * r2 + 0.004 * (5.0 * y).sin(), y * -0.06 * r2 + 0.003 * (4.0 * x + y).cos()]
        };
        let pincushion = |[x, y]: [f64; 2]| {
            let r2 = x * x + y * y;
            [x * 0.03 * r2 - 0.02 * (2.0 * x * y).sin(), y * 0.03 * r2 + 0.01 * x * y]
        };
        let example = |lens: Self, core: [f64; 4], move_by: &dyn Fn([f64; 2]) -> [f64; 2]| {
            let mut params = core.to_vec();
            for row in 0..lens.n_rows {
                params
                    .extend((0..lens.n_columns).flat_map(|column| move_by(lens.knot_in_plane(column, row))));
            }
            (lens, params)
        };
        vec![
            example(common, [900.0, 905.0, 790.0, 610.0], &barrel),
            example(wide, [420.0, 418.0, 805.0, 590.0], &pincushion),
            example(wide, [400.0, 400.0, 799.5, 599.5], &|_| [0.0; 2]),
        ]
    }
}

/// The squares of knots that points depend on.
struct Patch<T> {
    /// In each lane, the parameter that moves the image along x at the corner of the square.
    first: [usize; MAX_LANES],
    /// The weights of the columns, their derivatives by x, and the same for rows and y.
    across: [T; 4],
    across_slope: [T; 4],
    down: [T; 4],
    down_slope: [T; 4],
}

/// An image-plane point and its derivatives by the stereographic one.
struct Moved<T> {
    plane: [T; 2],
    d_plane: [[T; 2]; 2],
}

impl<T: Scalar> Patch<T> {
    /// Returns where the surface moves `plane`, and the derivatives of that.
    #[inline(always)]
    fn linearize<const N: usize>(&self, params: &[f64], row_stride: usize, plane: [T; 2]) -> Moved<T> {
        let (zero, one) = (plane[0].like(0.0), plane[0].like(1.0));
        let mut moved = Moved { plane, d_plane: [[one, zero], [zero, one]] };
        for axis in 0..2 {
            for row in 0..=N {
                let (mut sum, mut slope) = (zero, zero);
                for column in 0..=N {
                    let knot = row * row_stride + 2 * column + axis;
                    let coefficient = zero.look_up(&params[knot..], &self.first);
                    sum = self.across[column].mul_add(coefficient, sum);
                    slope = self.across_slope[column].mul_add(coefficient, slope);
                }
                moved.plane[axis] = self.down[row].mul_add(sum, moved.plane[axis]);
                moved.d_plane[axis][0] = self.down[row].mul_add(slope, moved.d_plane[axis][0]);
                moved.d_plane[axis][1] = self.down_slope[row].mul_add(sum, moved.d_plane[axis][1]);
            }
        }
        moved
    }
}

/// Returns, in each lane, the parameter at `offset` from that lane's `first`.
#[inline(always)]
fn look_up<T: Scalar>(params: &[T], first: &[usize; MAX_LANES], offset: usize) -> T {
    let mut found = params[first[0] + offset];
    for lane in 1..T::LANES {
        found = found.with_lane(lane, params[first[lane] + offset]);
    }
    found
}

/// Returns the first of the `N + 1` knots that a grid coordinate depends on, in each lane, and the
/// coordinate within the cell; `None` where the surface has ended.
#[inline(always)]
fn cells<T: Scalar, const N: usize>(coordinate: T, n_knots: u16) -> Option<([usize; MAX_LANES], T)> {
    // A parabola belongs to the knot in its middle, a cubic to the cell between two knots.
    let (offset, lower) = if N == 2 { (0.5, 0.5) } else { (0.0, 1.0) };
    let upper = f64::from(n_knots) - 1.0 - lower;
    let is_inside =
        coordinate.all_above(lower - CONTINUED_CELLS) && (-coordinate).all_above(-(upper + CONTINUED_CELLS));
    if !is_inside {
        return None;
    }
    let last = usize::from(n_knots) - N;
    let mut first = [0; MAX_LANES];
    let mut origins = [0.0; MAX_LANES];
    for lane in 0..T::LANES {
        // Negative numbers become zero, on the safe side of the clamp.
        let cell = ((coordinate.lane(lane) + offset) as usize).clamp(1, last);
        first[lane] = cell - 1;
        origins[lane] = cell as f64;
    }
    const LANES: [usize; MAX_LANES] = [0, 1, 2, 3, 4, 5, 6, 7];
    Some((first, coordinate - coordinate.look_up(&origins, &LANES)))
}

/// Returns the weights of the `N + 1` knots at `t` in a cell, and their derivatives times `per_unit`.
#[inline(always)]
fn basis<T: Scalar, const N: usize>(t: T, per_unit: f64) -> ([T; 4], [T; 4]) {
    let (zero, one) = (t.like(0.0), t.like(1.0));
    if N == 2 {
        // t is in [-1/2, 1/2] about the middle knot.
        let (below, above) = (t.like(0.5) - t, t.like(0.5) + t);
        let weights = [(below * below).scale(0.5), t.like(0.75) - t * t, (above * above).scale(0.5), zero];
        let slopes = [below.scale(-per_unit), t.scale(-2.0 * per_unit), above.scale(per_unit), zero];
        return (weights, slopes);
    }
    let s = one - t;
    let sixth = 1.0 / 6.0;
    let (t2, s2) = (t * t, s * s);
    let weights = [
        (s2 * s).scale(sixth),
        t2.mul_add(t.scale(0.5) - one, t.like(4.0 * sixth)),
        s2.mul_add(s.scale(0.5) - one, t.like(4.0 * sixth)),
        (t2 * t).scale(sixth),
    ];
    let half = 0.5 * per_unit;
    let slopes = [
        s2.scale(-half),
        (t * (t.scale(3.0) - t.like(4.0))).scale(half),
        (s * (s.scale(3.0) - t.like(4.0))).scale(-half),
        t2.scale(half),
    ];
    (weights, slopes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Model;

    #[track_caller]
    fn check_name(text: &str, expected: Option<&str>) {
        let found = text.parse::<Model>();
        assert_eq!(found.as_ref().ok().map(Model::to_string).as_deref(), expected, "{found:?}");
        if let Err(error) = found {
            assert!(error.to_string().contains("30x20:150deg"), "{error}");
        }
    }

    #[test]
    fn a_surface_follows_another_lens_as_well_as_its_knots_resolve_it() {
        let other = |[x, y, z]: [f64; 3]| {
            let [x, y] = to_plane([x, y, z])?;
            let r2 = x * x + y * y;
            Some([820.0 * (x - 0.05 * x * r2) + 610.0, 815.0 * (y - 0.05 * y * r2 + 0.01 * x * y) + 400.0])
        };
        let core = [900.0, 900.0, 600.0, 405.0];
        let rays = || {
            (0..15).flat_map(|i| {
                (0..11).map(move |j| from_plane([-0.7 + 0.1 * f64::from(i), -0.5 + 0.1 * f64::from(j)]))
            })
        };
        let worst = |lens: Model, params: Vec<f64>| {
            let camera = crate::Camera::new(lens, params, [1200, 800]).unwrap();
            rays()
                .map(|ray| {
                    let (found, wanted) = (camera.project(&ray.into()).unwrap(), other(ray).unwrap());
                    (found[0] - wanted[0]).hypot(found[1] - wanted[1])
                })
                .fold(0.0, f64::max)
        };
        // A cubic is beyond parabolas only where second differences are those of a neighbour.
        let cubic = Splined::<3>::new(24, 18, 100).unwrap();
        let found = worst(cubic.into(), cubic.following(core, &other).unwrap());
        assert!(found < 1e-2, "{found}");
        let parabolic = Splined::<2>::new(24, 18, 100).unwrap();
        let found = worst(parabolic.into(), parabolic.following(core, &other).unwrap());
        assert!(found < 0.1, "{found}");
        assert_eq!(cubic.following(core, &|_| None), None);
    }

    #[test]
    fn the_configuration_is_part_of_the_name() {
        check_name("splined3:30x18:120deg", Some("splined3:30x18:120deg"));
        check_name("splined2:3x3:359deg", Some("splined2:3x3:359deg"));
        check_name("splined3:12", Some("splined3:12"));
        check_name("splined2", Some("splined2:24"));
        for bad in
            ["", "3", "30x18", "30x18:120", "3x18:120deg", "30x101:120deg", "30x18:360deg", "30x-1:9deg"]
        {
            check_name(&format!("splined3:{bad}"), None);
        }
        let error = "pinhole:3".parse::<Model>().unwrap_err().to_string();
        assert_eq!(error, "`3` is no configuration of lens model pinhole; it takes none");
    }

    #[test]
    fn what_is_open_is_chosen_to_cover_the_directions() {
        let open = Splined::<3>::default();
        let model = Model::from(open);
        let error = crate::Camera::new(model, vec![1.0; 4], [100, 100]).unwrap_err();
        assert_eq!(error.to_string(), "the configuration of lens model splined3:24 is not complete");
        assert_eq!(open.project(&[1.0; 4], [0.1, 0.0, 1.0]), None);
        assert_eq!(open.unproject(&[1.0; 4], [0.1, 0.0]), None);
        for [x, y] in [[0.5, 0.4], [0.3, 0.9], [3.0, 2.0]] {
            let directions = [[x, 0.2, 1.0], [0.1, -y, 1.0]];
            let lens = open.completed(&directions);
            let (edge, cell) = (lens.edge_in_plane(), 1.0 / lens.cells_per_unit());
            for (axis, direction) in directions.into_iter().enumerate() {
                let spare = (edge[axis] - to_plane(direction).unwrap()[axis].abs()) / cell;
                assert!((0.3..1.5).contains(&spare), "{lens:?} {axis}: {spare}");
            }
            assert_eq!(lens.completed(&[[9.0, 9.0, 1.0]]), lens);
        }
    }

    #[test]
    fn parameters_are_named_by_column_and_row() {
        let names = Splined::<3>::new(5, 4, 90).unwrap().param_names();
        assert_eq!(names[..8], ["fx", "fy", "cx", "cy", "x_0_0", "y_0_0", "x_1_0", "y_1_0"]);
        assert_eq!((names.len(), names[14], names[43]), (44, "x_0_1", "y_4_3"));
    }

    #[test]
    fn weights_sum_to_one_and_a_level_surface_only_shifts() {
        fn check<const N: usize>() {
            let lens = Splined::<N>::new(8, 6, 120).unwrap();
            let core = [500.0, 510.0, 800.0, 600.0];
            let mut params = lens.undistorted(core);
            params[4..].as_chunks_mut::<2>().0.fill([0.1, -0.2]);
            for point in [[0.0, 0.0, 1.0], [0.9, -0.3, 1.0], [-2.0, 0.1, 1.0], [0.2, 0.8, 1.0]] {
                let [u, v] = lens.project(&params, point).unwrap();
                let [flat_u, flat_v] = crate::stereographic::Stereographic.project(&core, point).unwrap();
                assert!((u - flat_u - 50.0).abs() < 1e-12 && (v - flat_v + 102.0).abs() < 1e-12);
                let linear = lens.linearize_locally(&params, point).unwrap();
                assert!((linear.weights.iter().sum::<f64>() - 1.0).abs() < 1e-14);
            }
        }
        check::<2>();
        check::<3>();
    }

    #[test]
    fn the_surface_ends_two_cells_beyond_its_edge() {
        fn check<const N: usize>() {
            let lens = Splined::<N>::new(12, 6, 90).unwrap();
            let params = lens.undistorted([500.0, 500.0, 800.0, 600.0]);
            let edge = lens.edge_in_plane();
            assert!((edge[0] - 2.0 * (0.25 * f64::to_radians(90.0)).tan()).abs() < 1e-15);
            let cell = 1.0 / lens.cells_per_unit();
            for axis in 0..2 {
                for sign in [-1.0, 1.0] {
                    let at = |cells: f64| {
                        let mut plane = [0.0; 2];
                        plane[axis] = sign * (edge[axis] + cells * cell);
                        lens.project(&params, from_plane(plane))
                    };
                    assert!(at(1.99).is_some() && at(2.01).is_none());
                    let [u, v] = at(1.99).unwrap();
                    assert!(lens.unproject(&params, [u, v]).is_some());
                    let beyond = [800.0 + 1.5 * (u - 800.0), 600.0 + 1.5 * (v - 600.0)];
                    assert_eq!(lens.unproject(&params, beyond), None);
                }
            }
        }
        check::<2>();
        check::<3>();
    }

    #[test]
    fn a_surface_that_moves_the_image_far_is_inverted() {
        // A surface that shifts the image by more than half of itself.
        let lens = Splined::<3>::new(16, 11, 120).unwrap();
        let mut params = lens.undistorted([1700.0, 1700.0, 1965.0, 1087.0]);
        for row in 0..11 {
            for column in 0..16 {
                let [x, y] = lens.knot_in_plane(column, row);
                let k = 4 + 2 * (usize::from(row) * 16 + usize::from(column));
                params[k] = -0.7 * x + 0.3 * y;
                params[k + 1] = 0.25 * x * x;
            }
        }
        for point in [[0.1, 0.2, 1.0], [-0.9, 0.3, 1.0], [0.6, -0.5, 1.0]] {
            let pixel = lens.project(&params, point).unwrap();
            let [x, y, z] = lens.unproject(&params, pixel).unwrap();
            assert!((x / z - point[0]).hypot(y / z - point[1]) < 1e-12);
        }
    }
}
