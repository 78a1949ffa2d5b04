//! Calibration targets: what is printed, and how far the real object departs from it.

use boresight_geometry::Vector3;
use serde::{Deserialize, Serialize};

use crate::PointId;

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
    /// Any set of points, in metres.
    Points {
        /// The points in the target's frame.
        points_m: Vec<[f64; 3]>,
    },
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
}

impl Shape {
    /// Returns the number of coefficients.
    pub fn coefficient_count(self) -> usize {
        match self {
            Shape::Rigid => 0,
            Shape::Parabolic2 => 2,
        }
    }
}

impl Target {
    /// Returns the number of points.
    pub fn point_count(&self) -> usize {
        match &self.geometry {
            Geometry::Chessboard { columns, rows, .. } => *columns as usize * *rows as usize,
            Geometry::Points { points_m } => points_m.len(),
        }
    }

    /// Returns where `point` is drawn, in the target's frame, in metres.
    ///
    /// # Panics
    /// If the target has no such point; a checked [`Dataset`](crate::Dataset) holds none.
    pub fn drawn_point(&self, point: PointId) -> Vector3<f64> {
        match &self.geometry {
            Geometry::Chessboard { columns, rows, spacing_m } => {
                assert!(point.0 < columns * rows, "point {point} is on a {columns}x{rows} grid");
                let (column, row) = (point.0 % columns, point.0 / columns);
                Vector3::new(f64::from(column) * spacing_m, f64::from(row) * spacing_m, 0.0)
            }
            Geometry::Points { points_m } => Vector3::from(points_m[point.0 as usize]),
        }
    }

    /// Returns the displacement of `point` along +z by a unit of each shape coefficient.
    ///
    /// Empty for a rigid target. mrcal's formula: `4 x (1 - x)` and `4 y (1 - y)` for positions x, y
    /// in [0, 1] across the grid.
    pub fn shape_basis(&self, point: PointId) -> [f64; 2] {
        let Shape::Parabolic2 = self.shape else { return [0.0; 2] };
        let across = |position: f64, extent: f64| {
            let relative = if extent > 0.0 { position / extent } else { 0.0 };
            4.0 * relative * (1.0 - relative)
        };
        match &self.geometry {
            Geometry::Chessboard { columns, rows, .. } => {
                let (column, row) = (point.0 % columns, point.0 / columns);
                [
                    across(f64::from(column), f64::from(columns - 1)),
                    across(f64::from(row), f64::from(rows - 1)),
                ]
            }
            // A free set of points has no grid to bow along.
            Geometry::Points { .. } => [0.0; 2],
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
