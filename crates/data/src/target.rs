//! Calibration targets: what is printed, and how far the real object departs from it.

use boresight_geometry::Vector3;
use serde::{Deserialize, Serialize};

use crate::{Dictionary, PointId};

/// A calibration target as it was made.
#[derive(Clone, Debug, PartialEq)]
pub struct Target {
    /// The name, unique in a dataset.
    pub name: String,
    /// Where its points are meant to be.
    pub geometry: Geometry,
    /// How the real object may depart from that.
    pub shape: Shape,
}

/// Where a target's points are meant to be, in its own frame.
#[derive(Clone, Debug, PartialEq)]
pub enum Geometry {
    /// A grid of inner corners: point `row * columns + column` at `(column, row, 0) * spacing_m`.
    Chessboard {
        /// Inner corners along x.
        columns: u32,
        /// Inner corners along y.
        rows: u32,
        /// The distance between neighbouring corners in metres.
        spacing_m: f64,
    },
    /// A chessboard with a marker in each of its white squares. Its points are the inner corners, as on a chessboard
    /// of one column and one row less.
    ///
    /// The square at the origin's far side from the board, its first, is dark on boards of the current pattern; on
    /// those of OpenCV before 4.6 (legacy) with an even number of rows it is white.
    Charuco {
        /// Squares along x.
        columns: u32,
        /// Squares along y.
        rows: u32,
        /// The side of a square in metres.
        spacing_m: f64,
        /// The side of a marker with its black border, in metres.
        marker_m: f64,
        /// The dictionary of its markers; their ids increase along x, then along y.
        dictionary: Dictionary,
    },
    /// Kalibr's grid of AprilTags, with small black squares between their corners. x is to the right of the first tag
    /// and y upwards, so that z is towards who reads it. Its points are the corners of the tags, row by row from
    /// below: two for each tag in a row.
    AprilGrid {
        /// Tags along x.
        columns: u32,
        /// Tags along y.
        rows: u32,
        /// The side of a tag with its black border, in metres.
        tag_m: f64,
        /// The gap between two tags, as a share of the side of a tag.
        spacing: f64,
        /// The family of its tags; their ids increase along x, then along y.
        dictionary: Dictionary,
    },
    /// Dark dots in rows. Point `row * columns + column` is the middle of a dot.
    Circles {
        /// Dots in a row.
        columns: u32,
        /// Rows of dots along y.
        rows: u32,
        /// The distance between rows in metres.
        spacing_m: f64,
        /// How the rows lie beside each other.
        layout: CircleLayout,
    },
    /// Any set of points, in metres.
    Points {
        /// The points in the target's frame.
        points_m: Vec<[f64; 3]>,
    },
}

/// How rows of dots lie beside each other.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CircleLayout {
    /// Dot `column` of each row is at x = `column * spacing_m`.
    Symmetric,
    /// Dot `column` of row `row` is at x = `(2 * column + row % 2) * spacing_m`: every other row is shifted.
    Asymmetric,
}

impl Geometry {
    /// Returns columns and rows of the points of a grid, or `None` for a set of points.
    pub fn grid(&self) -> Option<[u32; 2]> {
        match *self {
            Geometry::Chessboard { columns, rows, .. } | Geometry::Circles { columns, rows, .. } => {
                Some([columns, rows])
            }
            Geometry::Charuco { columns, rows, .. } => {
                Some([columns.saturating_sub(1), rows.saturating_sub(1)])
            }
            Geometry::AprilGrid { columns, rows, .. } => {
                Some([columns.saturating_mul(2), rows.saturating_mul(2)])
            }
            Geometry::Points { .. } => None,
        }
    }
}

/// How the real target departs from its drawing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Shape {
    /// Exactly as drawn.
    #[default]
    Rigid,
    /// Two coefficients in metres, mrcal's board warp: the deflection along +z at the centre of a
    /// parabola along x and of one along y, zero at the grid's four edges.
    Parabolic2,
    /// Six coefficients in metres: those two, then a twist, how each parabola differs between the edges beside it, and
    /// what both make together in the middle. Each is the largest deflection along +z of its kind, or near to it.
    Twisted6,
}

impl Shape {
    /// All of them, each with more coefficients than the one before; the first of those are the same.
    pub const ALL: [Shape; 3] = [Shape::Rigid, Shape::Parabolic2, Shape::Twisted6];

    /// The largest number of coefficients.
    pub const MOST_COEFFICIENTS: usize = 6;

    /// Returns the number of coefficients.
    pub const fn coefficient_count(self) -> usize {
        match self {
            Shape::Rigid => 0,
            Shape::Parabolic2 => 2,
            Shape::Twisted6 => 6,
        }
    }

    /// Returns the displacement along +z by a unit of each coefficient there can be, at `across` of a grid: from 0 to 1
    /// along x and along y.
    ///
    /// The first two are mrcal's, `4 x (1 - x)` and `4 y (1 - y)`. No sum of them is a motion of a flat target.
    pub fn bends(across: [f64; 2]) -> [f64; Self::MOST_COEFFICIENTS] {
        let [x, y] = across.map(|position| 2.0 * position - 1.0);
        let [a, b] = across.map(|position| 4.0 * position * (1.0 - position));
        [a, b, x * y, a * y, x * b, a * b]
    }
}

impl Target {
    /// Returns the number of points.
    pub fn point_count(&self) -> usize {
        match (&self.geometry, self.geometry.grid()) {
            (Geometry::Points { points_m }, _) => points_m.len(),
            (_, grid) => grid.map_or(0, |[columns, rows]| columns as usize * rows as usize),
        }
    }

    /// Returns where `point` is drawn, in the target's frame, in metres.
    ///
    /// # Panics
    /// If the target has no such point; a checked [`Dataset`](crate::Dataset) holds none.
    pub fn drawn_point(&self, point: PointId) -> Vector3<f64> {
        let place = |columns: u32, rows: u32| {
            assert!(point.0 < columns * rows, "point {point} is on a {columns}x{rows} grid");
            [point.0 % columns, point.0 / columns]
        };
        let [columns, rows] = self.geometry.grid().unwrap_or_default();
        let (x, y) = match &self.geometry {
            Geometry::Chessboard { spacing_m, .. } | Geometry::Charuco { spacing_m, .. } => {
                let [column, row] = place(columns, rows);
                (f64::from(column) * spacing_m, f64::from(row) * spacing_m)
            }
            Geometry::AprilGrid { tag_m, spacing, .. } => {
                let along = |n: u32| {
                    let side = f64::from(n % 2);
                    (f64::from(n / 2) * (1.0 + spacing) + side) * tag_m
                };
                let [column, row] = place(columns, rows);
                (along(column), along(row))
            }
            Geometry::Circles { spacing_m, layout, .. } => {
                let [column, row] = place(columns, rows);
                let steps = match layout {
                    CircleLayout::Symmetric => column,
                    CircleLayout::Asymmetric => 2 * column + row % 2,
                };
                (f64::from(steps) * spacing_m, f64::from(row) * spacing_m)
            }
            Geometry::Points { points_m } => return Vector3::from(points_m[point.0 as usize]),
        };
        Vector3::new(x, y, 0.0)
    }

    /// Returns the displacement of `point` along +z by a unit of each shape coefficient.
    ///
    /// Zero for coefficients that its shape does not have. See [`Shape::bends`].
    pub fn shape_basis(&self, point: PointId) -> [f64; Shape::MOST_COEFFICIENTS] {
        let mut basis = [0.0; Shape::MOST_COEFFICIENTS];
        let n = self.shape.coefficient_count();
        if n > 0
            && let Some(across) = self.across(point)
        {
            basis[..n].copy_from_slice(&Shape::bends(across)[..n]);
        }
        basis
    }

    /// Returns where `point` is across the grid, from 0 to 1 along x and along y; `None` for a free set of points, which
    /// has no grid to bend along.
    fn across(&self, point: PointId) -> Option<[f64; 2]> {
        let across = |position: f64, extent: f64| if extent > 0.0 { position / extent } else { 0.0 };
        match (&self.geometry, self.geometry.grid()) {
            // A grid of one step is measured in steps, others in metres.
            (Geometry::Chessboard { .. } | Geometry::Charuco { .. }, Some([columns, rows])) => {
                let (column, row) = (point.0 % columns, point.0 / columns);
                Some([
                    across(f64::from(column), f64::from(columns - 1)),
                    across(f64::from(row), f64::from(rows - 1)),
                ])
            }
            (Geometry::AprilGrid { .. } | Geometry::Circles { .. }, Some([columns, rows])) => {
                // Of an asymmetric grid, the rows that are shifted reach furthest.
                let in_row = |row: u32| self.drawn_point(PointId(row * columns + columns - 1)).x;
                let end =
                    [in_row(0).max(in_row(1.min(rows - 1))), self.drawn_point(PointId(columns * rows - 1)).y];
                let at = self.drawn_point(point);
                Some([across(at.x, end[0]), across(at.y, end[1])])
            }
            _ => None,
        }
    }

    /// Returns where `point` really is, given the shape coefficients in metres.
    pub fn point(&self, point: PointId, coefficients_m: &[f64]) -> Vector3<f64> {
        let mut position = self.drawn_point(point);
        for (basis, coefficient) in self.shape_basis(point).iter().zip(coefficients_m) {
            position.z += basis * coefficient;
        }
        position
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Id as _;

    fn drawn(geometry: Geometry, point: u32) -> [f64; 2] {
        let target = Target { name: "board".to_owned(), geometry, shape: Shape::Rigid };
        let at = target.drawn_point(PointId(point));
        [at.x, at.y]
    }

    #[test]
    fn points_are_where_their_kind_has_them() {
        let dictionary = Dictionary::APRILTAG_36H11;
        let charuco = Geometry::Charuco { columns: 5, rows: 4, spacing_m: 0.5, marker_m: 0.3, dictionary };
        assert_eq!((charuco.grid(), drawn(charuco, 6)), (Some([4, 3]), [1.0, 0.5]));
        let tags = Geometry::AprilGrid { columns: 3, rows: 2, tag_m: 2.0, spacing: 0.25, dictionary };
        assert_eq!((tags.grid(), drawn(tags.clone(), 6 + 3)), (Some([6, 4]), [4.5, 2.0]));
        assert_eq!(drawn(tags, 12), [0.0, 2.5]);
        let circles = |layout| Geometry::Circles { columns: 4, rows: 11, spacing_m: 1.0, layout };
        assert_eq!(drawn(circles(CircleLayout::Symmetric), 5), [1.0, 1.0]);
        assert_eq!(drawn(circles(CircleLayout::Asymmetric), 5), [3.0, 1.0]);
        assert_eq!(drawn(circles(CircleLayout::Asymmetric), 9), [2.0, 2.0]);
    }

    #[test]
    fn boards_bow_between_their_outermost_points() {
        let dictionary = Dictionary::APRILTAG_36H11;
        let geometries = [
            Geometry::Chessboard { columns: 5, rows: 5, spacing_m: 1.0 },
            Geometry::Charuco { columns: 6, rows: 6, spacing_m: 1.0, marker_m: 0.5, dictionary },
            Geometry::AprilGrid { columns: 3, rows: 3, tag_m: 1.0, spacing: 0.3, dictionary },
            Geometry::Circles { columns: 4, rows: 5, spacing_m: 1.0, layout: CircleLayout::Asymmetric },
        ];
        for geometry in geometries {
            let target = Target { name: "board".to_owned(), geometry, shape: Shape::Parabolic2 };
            let bases: Vec<[f64; Shape::MOST_COEFFICIENTS]> =
                (0..target.point_count()).map(|i| target.shape_basis(PointId::from_index(i))).collect();
            for axis in 0..2 {
                let most = bases.iter().map(|basis| basis[axis]).fold(0.0, f64::max);
                assert!(
                    bases.iter().any(|basis| basis[axis] == 0.0) && (0.9..=1.0).contains(&most),
                    "{target:?}"
                );
            }
            assert_eq!(bases[0], [0.0; Shape::MOST_COEFFICIENTS]);
        }
    }

    #[test]
    fn no_sum_of_bends_is_a_motion() {
        let geometry = Geometry::Chessboard { columns: 7, rows: 5, spacing_m: 1.0 };
        let target = Target { name: "board".to_owned(), geometry, shape: Shape::Twisted6 };
        // What a small motion does to z of a flat target comes first.
        const N: usize = 3 + Shape::MOST_COEFFICIENTS;
        let rows = (0..target.point_count()).map(|i| {
            let point = PointId::from_index(i);
            let at = target.drawn_point(point);
            let mut row = vec![1.0, at.x / 6.0, at.y / 4.0];
            row.extend(target.shape_basis(point));
            row
        });
        let entries: Vec<f64> = rows.flatten().collect();
        let matrix = boresight_geometry::nalgebra::DMatrix::from_row_slice(entries.len() / N, N, &entries);
        let singular = matrix.singular_values();
        assert!(singular.min() > 0.02 * singular.max(), "{singular}");
    }

    #[test]
    fn shapes_with_more_coefficients_begin_with_those_with_fewer() {
        let geometry = Geometry::Chessboard { columns: 5, rows: 3, spacing_m: 1.0 };
        let basis = |shape| {
            let target = Target { name: "board".to_owned(), geometry: geometry.clone(), shape };
            target.shape_basis(PointId(1))
        };
        // The second of five points along x, at the first of three along y.
        let all = [0.75, 0.0, 0.5, -0.75, 0.0, 0.0];
        for shape in Shape::ALL {
            let (had, others) = all.split_at(shape.coefficient_count());
            let found = basis(shape);
            assert_eq!(found[..had.len()], *had);
            assert!(found[had.len()..].iter().all(|entry| *entry == 0.0));
            assert_eq!(others.is_empty(), shape == Shape::Twisted6);
        }
        assert!(Shape::ALL.is_sorted_by_key(|shape| shape.coefficient_count()));
    }
}
