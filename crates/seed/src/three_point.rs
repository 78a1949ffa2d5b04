//! The pose of three points from three rays: all of them, Eqs 8.15 and 8.16 of the textbook.
//!
//! Two poses explain most views of a triangle, four many, and only what else is known of the scene
//! tells which one is true. [`three_point_poses`] returns them all; [`backward_project`] does so for
//! the textbook's matrix H and side lengths.

mod distances;

use boresight_geometry::nalgebra::Matrix3x4;
use boresight_geometry::{Matrix3, Point3, Pose, Vector3};

use self::distances::distances;

/// The least height of a triangle over its longest side.
pub const LEAST_HEIGHT: f64 = 1e-9;

/// The least angle between two rays in radians.
pub const LEAST_ANGLE_RAD: f64 = 1e-9;

/// What keeps three points from having a pose.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ThreePointError {
    /// A number is NaN or infinite.
    #[error("point {index} (counted from 0) has a coordinate or ray that is not finite")]
    NotFinite {
        /// The position of the point, counted from 0.
        index: usize,
    },
    /// A side length is not positive.
    #[error("side {from}-{to} is {length_m} m long: a side must be positive", from = ends[0] + 1, to = ends[1] + 1)]
    BadSide {
        /// The points that the side joins, counted from 0.
        ends: [usize; 2],
        /// Its length in metres.
        length_m: f64,
    },
    /// No triangle has these sides.
    #[error(
        "no triangle has these sides: the longest is {longest_m} m, the other two together are {others_m} m"
    )]
    NoTriangle {
        /// The longest side in metres.
        longest_m: f64,
        /// The sum of the other two in metres.
        others_m: f64,
    },
    /// The points lie on a line, or coincide.
    #[error(
        "the three points lie on a line: their triangle is {ratio:.1e} as high as its longest side, at least {limit:.0e} is needed"
    )]
    Collinear {
        /// The height of the triangle over its longest side; zero if all points coincide.
        ratio: f64,
        /// The least ratio accepted.
        limit: f64,
    },
    /// Two points are seen in the same direction.
    #[error("points {first} and {second} (counted from 0) are seen {angle_rad:.1e} rad apart, at least {limit:.0e} rad is needed", first = pair[0], second = pair[1])]
    SameDirection {
        /// The two points, counted from 0.
        pair: [usize; 2],
        /// The angle between their rays in radians.
        angle_rad: f64,
        /// The least angle accepted.
        limit: f64,
    },
    /// The left 3x3 part of a calibration matrix has no inverse.
    #[error("the left 3x3 part of H is singular: no camera has such a calibration matrix")]
    SingularMatrix,
}

/// One of the poses of three points.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ThreePointPose {
    /// The pose.
    pub cam_from_target: Pose,
    /// The distances of the points from the centre of projection, in the unit of the points.
    pub distances: [f64; 3],
    /// The sensitivity of the solution: the condition number of the equations that determine the ratios
    /// of the distances. It is infinite where two solutions merge.
    pub condition: f64,
}

/// All poses of three points: none to four.
#[derive(Clone, Copy, Debug, Default)]
pub struct ThreePointPoses {
    poses: [ThreePointPose; 4],
    count: usize,
}

impl ThreePointPoses {
    /// Returns the poses.
    pub fn as_slice(&self) -> &[ThreePointPose] {
        &self.poses[..self.count]
    }
}

/// Returns all poses that put three points onto three unit rays, at positive distances.
///
/// Exact rays of a true pose always have that pose among the solutions; noisy ones of a pose where
/// two solutions merge may have none.
pub fn three_point_poses(
    rays_in_cam: &[Vector3<f64>; 3],
    points_in_target: &[Vector3<f64>; 3],
) -> Result<ThreePointPoses, ThreePointError> {
    let sides = checked_sides(rays_in_cam, points_in_target)?;
    Ok(placed(&sides, rays_in_cam, points_in_target))
}

/// Returns the poses that put three points onto three rays.
fn placed(
    Sides { turn, versines, squares }: &Sides,
    rays_in_cam: &[Vector3<f64>; 3],
    points_in_target: &[Vector3<f64>; 3],
) -> ThreePointPoses {
    let found = distances(versines, squares);
    let corners_in_target = turn.map(|i| points_in_target[i]);
    let normals = Normals::of(&corners_in_target);
    let target = triangle_frame(&corners_in_target, &normals);
    let [first, second, third] = corners_in_target;
    let centre_in_target = (first + second + third) / 3.0;
    let mut poses = ThreePointPoses::default();
    for solution in &found.items[..found.count] {
        let along = solution.along;
        let corners_in_cam = [0, 1, 2].map(|k| rays_in_cam[turn[k]] * along[k]);
        let rotation = triangle_frame(&corners_in_cam, &normals) * target.transpose();
        let [first, second, third] = corners_in_cam;
        let translation = (first + second + third) / 3.0 - rotation * centre_in_target;
        let mut distances = [0.0; 3];
        for k in 0..3 {
            distances[turn[k]] = along[k];
        }
        poses.poses[poses.count] = ThreePointPose {
            cam_from_target: Pose::from_matrix(&rotation, translation),
            distances,
            condition: solution.condition,
        };
        poses.count += 1;
    }
    poses
}

/// Returns the triangle with the sides 12, 23 and 31, in a frame of its own: the first point at the
/// origin, the second on the x axis, the third on the side of +y.
pub fn triangle_from_sides(sides_m: [f64; 3]) -> Result<[Vector3<f64>; 3], ThreePointError> {
    for (k, &length_m) in sides_m.iter().enumerate() {
        if !(length_m.is_finite() && length_m > 0.0) {
            return Err(ThreePointError::BadSide { ends: [k, (k + 1) % 3], length_m });
        }
    }
    let [ab, bc, ca] = sides_m;
    let longest_m = ab.max(bc).max(ca);
    let others_m = ab + bc + ca - longest_m;
    if longest_m > others_m {
        return Err(ThreePointError::NoTriangle { longest_m, others_m });
    }
    let x = (ab * ab + ca * ca - bc * bc) / (2.0 * ab);
    // Heron's formula, as Kahan writes it, keeps thin triangles.
    let mut sorted = sides_m;
    sorted.sort_by(f64::total_cmp);
    let [c, b, a] = sorted;
    let area_16 = (a + (b + c)) * (c - (a - b)) * (c + (a - b)) * (a + (b - c));
    let y = area_16.max(0.0).sqrt() / (2.0 * ab);
    let points = [Vector3::zeros(), Vector3::new(ab, 0.0, 0.0), Vector3::new(x, y, 0.0)];
    check_triangle(&points)?;
    Ok(points)
}

/// Returns every triangle with the sides 12, 23 and 31, in metres, that the calibration matrix `h`
/// projects to three pixels: its corners in the reference frame, by Eqs 8.15 and 8.16.
///
/// The pixels are free of distortion, as `h` is. Points behind the camera are not returned, where the
/// determinant of the left part of `h` is positive, as that of a camera's `P M` is.
pub fn backward_project(
    h: &Matrix3x4<f64>,
    pixels: &[[f64; 2]; 3],
    sides_m: [f64; 3],
) -> Result<Vec<[Point3<f64>; 3]>, ThreePointError> {
    let triangle = triangle_from_sides(sides_m)?;
    let left: Matrix3<f64> = h.fixed_columns::<3>(0).into_owned();
    let inverse = left.try_inverse().ok_or(ThreePointError::SingularMatrix)?;
    let centre = -(inverse * h.column(3));
    let side = left.determinant().signum();
    // Eq. 8.15 solved for the point: centre + s * left⁻¹ (u, v, 1).
    let rays = pixels.map(|[u, v]| (inverse * Vector3::new(u, v, 1.0) * side).normalize());
    let poses = three_point_poses(&rays, &triangle)?;
    let corners = |pose: &ThreePointPose| {
        let mut k = 0;
        rays.map(|ray| {
            k += 1;
            Point3::from(centre + ray * pose.distances[k - 1])
        })
    };
    Ok(poses.as_slice().iter().map(corners).collect())
}

/// What the distances along three rays follow from.
struct Sides {
    /// The order in which the points stand: the longest side joins the last and the first.
    turn: [usize; 3],
    /// For the sides 12, 23 and 31 in that order, 1 - cos of the angle between the rays.
    versines: [f64; 3],
    /// Their squares.
    squares: [f64; 3],
}

/// Returns the sides of a triangle and of its rays, unless it has no pose.
fn checked_sides(rays: &[Vector3<f64>; 3], points: &[Vector3<f64>; 3]) -> Result<Sides, ThreePointError> {
    for index in 0..3 {
        if !(rays[index].norm_squared().is_finite() && points[index].norm_squared().is_finite()) {
            return Err(ThreePointError::NotFinite { index });
        }
    }
    let sides = check_triangle(points)?;
    // 1 - cos of the angle between unit vectors, without loss for small angles.
    let versine = |i: usize, j: usize| 0.5 * (rays[i] - rays[j]).norm_squared();
    let versines = [versine(0, 1), versine(1, 2), versine(2, 0)];
    for (k, versine) in versines.iter().enumerate() {
        // The square of the angle, so that no root is taken of what passes.
        if 2.0 * versine < LEAST_ANGLE_RAD * LEAST_ANGLE_RAD {
            return Err(ThreePointError::SameDirection {
                pair: [k, (k + 1) % 3],
                angle_rad: (2.0 * versine).sqrt(),
                limit: LEAST_ANGLE_RAD,
            });
        }
    }
    let turn = if sides[0] >= sides[1] && sides[0] >= sides[2] {
        [1, 2, 0]
    } else if sides[1] >= sides[2] {
        [2, 0, 1]
    } else {
        [0, 1, 2]
    };
    Ok(Sides { turn, versines: turn.map(|k| versines[k]), squares: turn.map(|k| sides[k]) })
}

/// Returns the squares of the sides 12, 23 and 31, unless the points lie on a line.
fn check_triangle(points: &[Vector3<f64>; 3]) -> Result<[f64; 3], ThreePointError> {
    let [a, b, c] = [points[1] - points[0], points[2] - points[1], points[0] - points[2]];
    let sides = [a.norm_squared(), b.norm_squared(), c.norm_squared()];
    let longest = sides[0].max(sides[1]).max(sides[2]);
    // Twice the area is the height times the longest side; squares spare the root.
    let square = a.cross(&b).norm_squared();
    let least = LEAST_HEIGHT * longest;
    if longest > 0.0 && square >= least * least {
        return Ok(sides);
    }
    let ratio = if longest > 0.0 { square.sqrt() / longest } else { 0.0 };
    Err(ThreePointError::Collinear { ratio, limit: LEAST_HEIGHT })
}

/// The inverse lengths of a triangle's longest side and of its normal, which it has wherever it stands.
struct Normals {
    side: f64,
    normal: f64,
}

impl Normals {
    fn of([first, second, third]: &[Vector3<f64>; 3]) -> Self {
        let side = third - first;
        let normal = side.cross(&(second - first));
        Self { side: 1.0 / side.norm(), normal: 1.0 / normal.norm() }
    }
}

/// Returns the axes of the frame of a triangle: from the first to the last point, in the plane, and normal to it.
#[inline]
fn triangle_frame([first, second, third]: &[Vector3<f64>; 3], normals: &Normals) -> Matrix3<f64> {
    let side = third - first;
    let normal = side.cross(&(second - first));
    let x = side * inverse_norm(&side, normals.side);
    let z = normal * inverse_norm(&normal, normals.normal);
    Matrix3::from_columns(&[x, z.cross(&x), z])
}

/// Returns the inverse length of a vector, where a number is nearly it.
fn inverse_norm(v: &Vector3<f64>, nearly: f64) -> f64 {
    let square = v.norm_squared();
    let off = square * nearly * nearly - 1.0;
    // A step of Newton's, which leaves 3/8 of the square; needles may be further off.
    if off.abs() < 1e-8 { nearly * (1.0 - 0.5 * off) } else { 1.0 / square.sqrt() }
}
