//! The maps from image coordinates to the robot's plane, and their closed-form starts.

use boresight_data::PlaneModel;
use boresight_geometry::nalgebra::{DMatrix, DVector};
use boresight_geometry::{Matrix3, Pose, Scalar, Vector3};

/// What kind of numbers a map has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Similarity,
    Affine,
    Homography,
    Pose,
}

impl Kind {
    pub(super) fn of(model: PlaneModel) -> Self {
        match model {
            PlaneModel::Similarity | PlaneModel::UndistortedSimilarity => Self::Similarity,
            PlaneModel::Affine | PlaneModel::UndistortedAffine => Self::Affine,
            PlaneModel::Homography | PlaneModel::UndistortedHomography => Self::Homography,
            PlaneModel::Pose => Self::Pose,
        }
    }

    /// The number of columns, which is that of unknowns.
    pub(super) fn columns(self) -> usize {
        match self {
            Self::Similarity => 4,
            Self::Affine | Self::Pose => 6,
            Self::Homography => 8,
        }
    }

    /// The number of touches that a closed-form start needs.
    pub(super) fn least_touches(self) -> usize {
        match self {
            Self::Similarity => 2,
            Self::Affine => 3,
            Self::Homography | Self::Pose => 4,
        }
    }
}

/// Returns where a map of normalised image coordinates leads, or `None` at or beyond its horizon.
pub(super) fn mapped<T: Scalar>(kind: Kind, facing: f64, map: &[T], [x, y]: [T; 2]) -> Option<[T; 2]> {
    match kind {
        Kind::Similarity => {
            let y = y.scale(facing);
            Some([map[0] * x - map[1] * y + map[2], map[1] * x + map[0] * y + map[3]])
        }
        Kind::Affine => Some([map[0] * x + map[1] * y + map[2], map[3] * x + map[4] * y + map[5]]),
        Kind::Homography => {
            let w = map[6] * x + map[7] * y + x.like(1.0);
            let ahead = w.all_above(1e-6);
            ahead.then(|| [(map[0] * x + map[1] * y + map[2]) / w, (map[3] * x + map[4] * y + map[5]) / w])
        }
        Kind::Pose => None,
    }
}

/// Returns where a ray of the camera, moved by a left perturbation of `base_from_cam`, meets the plane
/// `z = height[0] + height[1] (x - centre x) + height[2] (y - centre y)`; `None` if it does not, ahead.
pub(super) fn ray_on_plane<T: Scalar>(
    base_from_cam: &Pose,
    perturbation: &[T],
    ray_in_cam: [f64; 2],
    height: &[T],
    centre: [f64; 2],
) -> Option<[T; 2]> {
    let ray = base_from_cam.rotation * Vector3::new(ray_in_cam[0], ray_in_cam[1], 1.0);
    let [from, ray] = [base_from_cam.translation, ray].map(|v| moved(&v, &perturbation[..3]));
    let from = [0, 1, 2].map(|i| from[i] + perturbation[3 + i]);
    let [cx, cy] = centre.map(|x| from[0].like(x));
    // How far above the plane the centre of projection is, and how fast the ray comes down.
    let above = from[2] - height[0] - height[1] * (from[0] - cx) - height[2] * (from[1] - cy);
    let down = height[1] * ray[0] + height[2] * ray[1] - ray[2];
    let along = above / down;
    along.all_above(0.0).then(|| [from[0] + along * ray[0], from[1] + along * ray[1]])
}

/// Returns `v + ω × v`.
fn moved<T: Scalar>(v: &Vector3<f64>, turn: &[T]) -> [T; 3] {
    let [x, y, z] = [v.x, v.y, v.z].map(|c| turn[0].like(c));
    [x + turn[1] * z - turn[2] * y, y + turn[2] * x - turn[0] * z, z + turn[0] * y - turn[1] * x]
}

/// Returns the map that leads normalised image coordinates to normalised positions, by linear least squares.
pub(super) fn linear_start(
    kind: Kind,
    facing: f64,
    image: &[[f64; 2]],
    robot: &[[f64; 2]],
) -> Option<Vec<f64>> {
    let columns = if kind == Kind::Pose { 8 } else { kind.columns() };
    let mut matrix = DMatrix::zeros(2 * image.len(), columns);
    let mut right = DVector::zeros(2 * image.len());
    for (i, (&[x, y], target)) in image.iter().zip(robot).enumerate() {
        for row in 0..2 {
            let mut set = |column: usize, value: f64| matrix[(2 * i + row, column)] = value;
            match kind {
                Kind::Similarity => {
                    let y = facing * y;
                    let (a, b) = if row == 0 { (x, -y) } else { (y, x) };
                    set(0, a);
                    set(1, b);
                    set(2 + row, 1.0);
                }
                _ => {
                    set(3 * row, x);
                    set(3 * row + 1, y);
                    set(3 * row + 2, 1.0);
                    if columns == 8 {
                        set(6, -x * target[row]);
                        set(7, -y * target[row]);
                    }
                }
            }
            right[2 * i + row] = target[row];
        }
    }
    let svd = matrix.svd(true, true);
    let (least, most) = (svd.singular_values.min(), svd.singular_values.max());
    // NaN is not determined either.
    let is_determined = least > 1e-9 * most;
    let solved = is_determined.then(|| svd.solve(&right, 0.0).ok()).flatten()?;
    Some(solved.iter().copied().collect())
}

/// Returns `base_from_cam` of a camera whose directions `x / z, y / z` a homography leads to the plane.
///
/// `base_from_image` takes `(x / z, y / z, 1)` to multiples of `(X, Y, 1)`, both less the centre.
pub(super) fn pose_of_homography(
    base_from_image: &Matrix3<f64>,
    height: &[f64; 3],
    centre: [f64; 2],
) -> Option<Pose> {
    let inverse = base_from_image.try_inverse()?;
    // The columns of the inverse are multiples of where the plane's two directions and its centre are in the camera.
    let sign = inverse[(2, 2)].signum();
    let columns = [0, 1, 2].map(|i| inverse.column(i) * sign);
    let directions = [Vector3::new(1.0, 0.0, height[1]), Vector3::new(0.0, 1.0, height[2])];
    let scale =
        ((columns[0].norm() * columns[1].norm()) / (directions[0].norm() * directions[1].norm())).sqrt();
    let [a, b] = [columns[0] / scale, columns[1] / scale];
    // The rotation that takes the plane's directions and normal to the camera's.
    let plane = Matrix3::from_columns(&[directions[0], directions[1], directions[0].cross(&directions[1])]);
    let guess = Matrix3::from_columns(&[a, b, a.cross(&b)]) * plane.try_inverse()?;
    let svd = guess.try_svd(true, true, 1e-14, 100)?;
    let (u, v_t) = (svd.u?, svd.v_t?);
    let mirror = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, (u * v_t).determinant().signum()));
    let rotation = u * mirror * v_t;
    let centre_in_cam = columns[2] / scale;
    let centre_in_base = Vector3::new(centre[0], centre[1], height[0]);
    Some(Pose::from_matrix(&rotation, centre_in_cam - rotation * centre_in_base).inverse())
}
