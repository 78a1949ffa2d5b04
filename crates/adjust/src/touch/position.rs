//! From a pixel to a position in the robot's base frame, and how well it is known.

use boresight_camera::Camera;
use boresight_data::{PlaneModel, RobotPlane};
use boresight_geometry::nalgebra::{DMatrix, Quaternion};
use boresight_geometry::{Pose, UnitQuaternion, Vector3, Vector6};

use super::map::{Kind, mapped, ray_on_plane};

/// A position in the robot's base frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Position {
    /// The position, in metres.
    pub in_base_m: [f64; 3],
    /// How far a part's height moves it sideways, in metres per metre, along x and y; `None` where the
    /// camera's place is not known.
    pub shift_per_height: Option<[f64; 2]>,
}

/// Returns the position of a point that is seen at a pixel, `height_m` above the plane (along the
/// base frame's z). `None` where the pixel has no direction or does not meet the plane.
///
/// Without the camera's place, a height moves the position up only.
pub fn plane_position(
    plane: &RobotPlane,
    lens: Option<&Camera>,
    pixel: [f64; 2],
    height_m: f64,
) -> Option<Position> {
    let image = if plane.model.needs_lens() {
        let ray = lens?.unproject(pixel)?;
        (ray.z > 1e-3).then(|| [ray.x / ray.z, ray.y / ray.z])?
    } else {
        pixel
    };
    let kind = Kind::of(plane.model);
    let [cx, cy] = plane.robot_centre_m;
    let [x, y] = match kind {
        Kind::Pose => {
            ray_on_plane(&pose_of(&plane.map), &[0.0; 6], image, &plane.height_m, plane.robot_centre_m)?
        }
        _ => {
            let normalised = [0, 1].map(|i| (image[i] - plane.image_centre[i]) / plane.image_scale);
            let [x, y] = mapped(kind, plane.facing, &plane.map, normalised)?;
            [x * plane.robot_scale_m + cx, y * plane.robot_scale_m + cy]
        }
    };
    let [level, along_x, along_y] = plane.height_m;
    let z = level + along_x * (x - cx) + along_y * (y - cy);
    let place = match (kind, plane.camera_in_base_m) {
        // The pose's own place moves with it.
        (Kind::Pose, _) => Some([plane.map[4], plane.map[5], plane.map[6]]),
        (_, place) => place,
    };
    let shift_per_height = place.map(|camera| {
        // Back along the ray until it is one metre higher above the sloping plane.
        let ray = [camera[0] - x, camera[1] - y, camera[2] - z];
        let rise = ray[2] - along_x * ray[0] - along_y * ray[1];
        [ray[0] / rise, ray[1] / rise]
    });
    let [dx, dy] = shift_per_height.unwrap_or([0.0; 2]).map(|shift| shift * height_m);
    let in_base_m = [x + dx, y + dy, z + along_x * dx + along_y * dy + height_m];
    in_base_m.iter().all(|value| value.is_finite()).then_some(Position { in_base_m, shift_per_height })
}

/// Returns the pose that the map of [`PlaneModel::Pose`] holds.
pub(super) fn pose_of(map: &[f64]) -> Pose {
    let rotation = UnitQuaternion::new_normalize(Quaternion::new(map[3], map[0], map[1], map[2]));
    Pose::new(rotation, Vector3::new(map[4], map[5], map[6]))
}

/// Returns the names of the columns of a plane's covariance.
pub fn plane_columns(model: PlaneModel, lens: Option<&Camera>) -> Vec<String> {
    let kind = Kind::of(model);
    let mut names: Vec<String> = match kind {
        Kind::Pose => ["rx_rad", "ry_rad", "rz_rad", "tx_m", "ty_m", "tz_m"]
            .map(|name| format!("base_from_cam.{name}"))
            .to_vec(),
        _ => (0..kind.columns()).map(|i| format!("map{i}")).collect(),
    };
    names.extend(["height_m", "slope_x", "slope_y"].map(str::to_owned));
    if let Some(lens) = lens.filter(|_| model.needs_lens()) {
        names.extend(lens.model.param_names().iter().map(|name| (*name).to_owned()));
    }
    names
}

/// A function of a plane and its lens; `None` where it is not defined.
pub type PlaneFunction<'a> = dyn Fn(&RobotPlane, Option<&Camera>) -> Option<Vec<f64>> + 'a;

/// Returns the covariance of `f`, a function of plane and lens, by the joint covariance of both.
///
/// Derivatives are differences over a tenth of a sigma, over which such functions are all but linear.
/// `None` where the function is not defined so near, or the plane's covariance is not of one piece.
pub fn plane_spread(
    plane: &RobotPlane,
    lens: Option<&Camera>,
    f: &PlaneFunction<'_>,
) -> Option<DMatrix<f64>> {
    let n = plane.names.len();
    if plane.covariance.len() != n * n {
        return None;
    }
    let rows = f(plane, lens)?.len();
    let covariance = DMatrix::from_row_slice(n, n, &plane.covariance);
    let mut gain = DMatrix::zeros(rows, n);
    for column in 0..n {
        let sigma = covariance[(column, column)].max(0.0).sqrt();
        if sigma == 0.0 {
            continue;
        }
        let step = 0.1 * sigma;
        let at = |step: f64| {
            let (plane, lens) = moved(plane, lens, column, step);
            f(&plane, lens.as_ref())
        };
        let (up, down) = (at(step)?, at(-step)?);
        for row in 0..rows {
            gain[(row, column)] = (up[row] - down[row]) / (2.0 * step);
        }
    }
    Some(&gain * covariance * gain.transpose())
}

/// Returns plane and lens with one column of their covariance moved.
fn moved(
    plane: &RobotPlane,
    lens: Option<&Camera>,
    column: usize,
    step: f64,
) -> (RobotPlane, Option<Camera>) {
    let (mut plane, mut lens) = (plane.clone(), lens.cloned());
    let map_columns = Kind::of(plane.model).columns();
    if column < map_columns {
        if plane.model == PlaneModel::Pose {
            let mut tangent = Vector6::zeros();
            tangent[column] = step;
            let pose = pose_of(&plane.map).perturbed(&tangent);
            let [x, y, z] = pose.translation.into();
            plane.map = pose.rotation.coords.iter().copied().chain([x, y, z]).collect();
        } else {
            plane.map[column] += step;
        }
    } else if column < map_columns + 3 {
        plane.height_m[column - map_columns] += step;
    } else if let Some(lens) = &mut lens {
        lens.params[column - map_columns - 3] += step;
    }
    (plane, lens)
}
