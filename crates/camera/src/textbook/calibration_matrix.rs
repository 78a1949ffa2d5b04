//! The calibration matrix `H` (Eq. 8.14) from points, and `P` and `M` from `H`.
//!
//! Algorithms 7.1 (normalised direct linear transformation, then minimal reprojection error) and
//! section 6.2.4 (RQ decomposition) of Hartley & Zisserman 2004.

mod check;
mod refine;

use boresight_geometry::nalgebra::{DMatrix, Matrix3x4, Matrix4, SMatrix, SVector};
use boresight_geometry::{Matrix3, Point3, Pose, Vector2, Vector3};

use super::m_matrix;

/// The number of distinct points that determine the 11 degrees of freedom of `H`.
pub const MIN_POINTS: usize = 6;

/// The smallest allowed thickness of the points, relative to their widest extent.
///
/// Below it, what tells focal length from distance is of the size of the errors with which points
/// are known: a board that sags a millimetre in 300 reaches 0.003.
pub const MIN_THICKNESS: f64 = 5e-3;

/// The smallest allowed second smallest singular value of the linear system, relative to the largest.
pub const MIN_RANK_RATIO: f64 = 1e-7;

/// The largest allowed ratio of the two smallest singular values of the linear system.
pub const MAX_GAP_RATIO: f64 = 0.5;

/// The smallest allowed ratio of the singular values of the left 3x3 part of `H`.
pub const MIN_DECOMPOSABLE: f64 = 1e-10;

/// What keeps `H` from being found or taken apart.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// There are fewer distinct points than unknowns need.
    #[error("{found} distinct points are given; {need} are needed")]
    TooFewPoints {
        /// How many distinct points are given.
        found: usize,
        /// How many are needed.
        need: usize,
    },
    /// A coordinate is NaN or infinite.
    #[error("point {index} (counted from 0) has a coordinate that is not finite")]
    PointNotFinite {
        /// The position of the point, counted from 0.
        index: usize,
    },
    /// The points lie in a plane, or nearly so, and leave focal length and distance open.
    #[error(
        "the points lie in a plane: their thickness is {ratio:.1e} of their extent, at least {limit:.1e} is needed; add points at other depths, or calibrate from several views of the plane"
    )]
    Coplanar {
        /// The thinnest extent of the points over their widest.
        ratio: f64,
        /// The least ratio accepted.
        limit: f64,
    },
    /// All points but one lie in a plane, or nearly so, which still leaves one unknown open.
    #[error(
        "all points but number {index} (counted from 0) lie in a plane: their thickness is {ratio:.1e} of their extent, at least {limit:.1e} is needed; add points at other depths"
    )]
    CoplanarButOne {
        /// The position of the point off the plane, counted from 0.
        index: usize,
        /// The thinnest extent of the other points over their widest.
        ratio: f64,
        /// The least ratio accepted.
        limit: f64,
    },
    /// The points leave more than the scale of `H` open, though they are not in a plane.
    #[error(
        "the points do not determine the matrix: the two smallest singular values are {smallest:.1e} and {second:.1e} of the largest, the second must exceed {limit:.1e}"
    )]
    BadRank {
        /// The smallest singular value over the largest; zero but for noise.
        smallest: f64,
        /// The second smallest singular value over the largest.
        second: f64,
        /// What the second smallest must exceed.
        limit: f64,
    },
    /// Points lie behind the camera that fits them best.
    #[error(
        "{behind} of {of} points lie behind the camera that fits them: if it is all of them, an axis is mirrored, else pixels and points are mismatched"
    )]
    BehindCamera {
        /// How many points lie behind.
        behind: usize,
        /// How many there are.
        of: usize,
    },
    /// The matrix has an entry that is NaN or infinite.
    #[error("entry ({row}, {column}) of the matrix, counted from 0, is not finite")]
    MatrixNotFinite {
        /// The row, counted from 0.
        row: usize,
        /// The column, counted from 0.
        column: usize,
    },
    /// The left 3x3 part of the matrix is singular: no camera at a finite place has it.
    #[error(
        "the left 3x3 part of the matrix is singular: its singular values have the ratio {ratio:.1e}, at least {limit:.1e} is needed"
    )]
    Singular {
        /// The smallest singular value over the largest.
        ratio: f64,
        /// The least ratio accepted.
        limit: f64,
    },
}

/// A known point and the pixel that sees it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PointPair {
    /// The point in the reference frame, in metres.
    pub point_in_ref: Point3<f64>,
    /// The pixel that sees it, free of distortion.
    pub pixel: [f64; 2],
}

/// A calibration matrix with how well it fits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// The matrix `H`, scaled so that the scale factor s of Eq. 8.13 is the depth in metres.
    pub h: Matrix3x4<f64>,
    /// The root mean square distance in pixels of the given pixels from the projected points.
    pub rms_px: f64,
}

/// A calibration matrix taken apart.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Parts {
    /// `[fx, fy, u0, v0]` in pixels.
    pub core: [f64; 4],
    /// The skew of the pixel axes, entry (0, 1) of `P`, in pixels; zero for a real sensor.
    pub skew_px: f64,
    /// The pose of the reference frame in the camera frame.
    pub cam_from_ref: Pose,
}

impl Parts {
    /// Returns the matrix `P` of Eq. 8.10, with the skew.
    pub fn p(&self) -> Matrix3x4<f64> {
        let mut p = super::p_matrix(self.core);
        p[(0, 1)] = self.skew_px;
        p
    }

    /// Returns the matrix `M` of Eq. 8.12.
    pub fn m(&self) -> Matrix4<f64> {
        m_matrix(&self.cam_from_ref)
    }
}

/// Returns the matrix `H` with the least reprojection error over at least [`MIN_POINTS`] points.
pub fn from_points(pairs: &[PointPair]) -> Result<Estimate, Error> {
    check::check_points(pairs)?;
    let points = Normalisation::of(pairs.iter().map(|pair| pair.point_in_ref.coords));
    let pixels = Normalisation::of(pairs.iter().map(|pair| Vector2::from(pair.pixel)));
    let (Some(points), Some(pixels)) = (points, pixels) else {
        // All pixels coincide.
        return Err(Error::BadRank { smallest: 0.0, second: 0.0, limit: MIN_RANK_RATIO });
    };
    let normalised: Vec<_> = pairs
        .iter()
        .map(|pair| (points.apply(pair.point_in_ref.coords).push(1.0), pixels.apply(pair.pixel.into())))
        .collect();

    let start = facing(&direct_linear_transformation(&normalised)?);
    let of = pairs.len();
    let behind = normalised.iter().filter(|(point, _)| (start * point).z <= 0.0).count();
    if behind > 0 && behind < of {
        return Err(Error::BehindCamera { behind, of });
    }
    let (best, cost) = refine::refine(&normalised, &start);
    let h = facing(&(pixels.inverse_matrix() * best * points.matrix()));
    let behind = pairs.iter().filter(|pair| (h * pair.point_in_ref.to_homogeneous()).z <= 0.0).count();
    if behind > 0 {
        return Err(Error::BehindCamera { behind, of });
    }
    let depth_scale = h.fixed_view::<1, 3>(2, 0).norm();
    Ok(Estimate { h: h / depth_scale, rms_px: (cost / of as f64).sqrt() / pixels.scale })
}

/// Returns intrinsics and pose such that `P M` is `h` up to its scale, with positive focal lengths
/// and a right-handed rotation.
///
/// Scale and sign of `h` are free; the sign is chosen by the rotation's right-handedness.
pub fn decompose(h: &Matrix3x4<f64>) -> Result<Parts, Error> {
    if let Some(i) = h.iter().position(|entry| !entry.is_finite()) {
        return Err(Error::MatrixNotFinite { row: i % 3, column: i / 3 });
    }
    let left = h.fixed_view::<3, 3>(0, 0).into_owned();
    let singular_values = left.singular_values();
    let ratio = if singular_values[0] > 0.0 { singular_values[2] / singular_values[0] } else { 0.0 };
    if ratio < MIN_DECOMPOSABLE {
        return Err(Error::Singular { ratio, limit: MIN_DECOMPOSABLE });
    }
    let h = facing(h) / left.row(2).norm();

    // The rows of the left part are the rows of K R with an upper triangular K: RQ decomposition
    // by Gram and Schmidt from the bottom, each row twice so that the rest is orthogonal to the last bit.
    let row = |i: usize| Vector3::new(h[(i, 0)], h[(i, 1)], h[(i, 2)]);
    let r3 = row(2).normalize();
    let v0 = row(1).dot(&r3);
    let rest = row(1) - r3 * v0;
    let r2 = (rest - r3 * rest.dot(&r3)).normalize();
    let r1 = r2.cross(&r3);
    let (fx, skew_px, u0) = (row(0).dot(&r1), row(0).dot(&r2), row(0).dot(&r3));
    let fy = row(1).dot(&r2);

    let z = h[(2, 3)];
    let y = (h[(1, 3)] - v0 * z) / fy;
    let x = (h[(0, 3)] - u0 * z - skew_px * y) / fx;
    let rotation = Matrix3::from_rows(&[r1.transpose(), r2.transpose(), r3.transpose()]);
    let cam_from_ref = Pose::from_matrix(&rotation, Vector3::new(x, y, z));
    Ok(Parts { core: [fx, fy, u0, v0], skew_px, cam_from_ref })
}

/// A shift and scale that bring points to mean zero and mean distance √D: section 4.4.4 of Hartley
/// & Zisserman 2004.
struct Normalisation<const D: usize> {
    mean: SVector<f64, D>,
    scale: f64,
}

impl<const D: usize> Normalisation<D> {
    fn of(points: impl Iterator<Item = SVector<f64, D>> + Clone) -> Option<Self> {
        let n = points.clone().count() as f64;
        let mean = points.clone().sum::<SVector<f64, D>>() / n;
        let distance = points.map(|point| (point - mean).norm()).sum::<f64>() / n;
        (distance > 0.0).then(|| Self { mean, scale: (D as f64).sqrt() / distance })
    }

    fn apply(&self, point: SVector<f64, D>) -> SVector<f64, D> {
        (point - self.mean) * self.scale
    }
}

impl Normalisation<3> {
    fn matrix(&self) -> Matrix4<f64> {
        let Self { mean, scale } = self;
        Matrix4::new_scaling(*scale).prepend_translation(&-mean)
    }
}

impl Normalisation<2> {
    fn inverse_matrix(&self) -> Matrix3<f64> {
        let Self { mean, scale } = self;
        Matrix3::new(1.0 / scale, 0.0, mean.x, 0.0, 1.0 / scale, mean.y, 0.0, 0.0, 1.0)
    }
}

/// A homogeneous point in the reference frame and a pixel, both normalised.
type NormalisedPair = (SVector<f64, 4>, Vector2<f64>);

/// Returns the matrix of unit norm that minimises the algebraic error: Eq. 7.2 of Hartley &
/// Zisserman 2004.
fn direct_linear_transformation(pairs: &[NormalisedPair]) -> Result<Matrix3x4<f64>, Error> {
    let mut system = DMatrix::zeros(2 * pairs.len(), 12);
    for (i, (point, pixel)) in pairs.iter().enumerate() {
        for row in 0..2 {
            for k in 0..4 {
                system[(2 * i + row, 4 * row + k)] = point[k];
                system[(2 * i + row, 8 + k)] = -pixel[row] * point[k];
            }
        }
    }
    // The triangular factor has the singular values and right vectors of the system, and 12 rows.
    let triangle: SMatrix<f64, 12, 12> = system.qr().r().fixed_view::<12, 12>(0, 0).into_owned();
    let svd = triangle.svd(false, true);
    let values = svd.singular_values;
    let (smallest, second) = (values[11] / values[0], values[10] / values[0]);
    let limit = MIN_RANK_RATIO.max(smallest / MAX_GAP_RATIO);
    match svd.v_t {
        Some(v_t) if second > limit => Ok(Matrix3x4::from_row_iterator(v_t.row(11).iter().copied())),
        _ => Err(Error::BadRank { smallest, second, limit }),
    }
}

/// Returns the matrix with the sign for which its left 3x3 part is right-handed.
fn facing(h: &Matrix3x4<f64>) -> Matrix3x4<f64> {
    if h.fixed_view::<3, 3>(0, 0).determinant() < 0.0 { -h } else { *h }
}

#[cfg(test)]
mod tests;
