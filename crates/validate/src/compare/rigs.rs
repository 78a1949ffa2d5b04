//! The difference of two calibrations of several cameras: lens by lens, and where the cameras sit.

use boresight_camera::Camera;
use boresight_data::Uncertainty;
use boresight_geometry::Pose;
use serde::{Deserialize, Serialize};

use super::significance::{
    EyePair, Known, PoseSignificance, Significance, TransferDifference, of_lenses, of_poses, of_transfer,
};
use crate::uncertainty::Eye;
use crate::{CompareOptions, Comparison, Error, compare};

/// A camera of a calibration, from whatever file it came.
#[derive(Clone, Debug, PartialEq)]
pub struct ComparedCamera {
    /// The name, by which it finds its counterpart.
    pub name: String,
    /// The lens.
    pub camera: Camera,
    /// Where it sits in its rig; `None` where the source does not tell.
    pub cam_from_rig: Option<Pose>,
}

/// The difference of two calibrations a and b.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RigComparison {
    /// The difference of each camera that both have, in the order of a.
    pub cameras: Vec<CameraComparison>,
    /// The difference of the relative pose of each two such cameras whose poses both have.
    pub pairs: Vec<PairDifference>,
    /// The cameras that only a has.
    pub only_in_a: Vec<String>,
    /// The cameras that only b has.
    pub only_in_b: Vec<String>,
}

/// The difference of one camera's lens.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CameraComparison {
    /// The camera's name in a.
    pub name: String,
    /// The camera's name in b; another only where either calibration has a single camera.
    pub name_in_b: String,
    /// The difference.
    pub comparison: Comparison,
    /// The difference against what both calibrations' uncertainties predict; `None` where either is unknown.
    pub significance: Option<Significance>,
}

/// The difference of the pose of one camera relative to another.
///
/// A lens is calibrated up to the turn of its frame that its parameters make up for, so part of a
/// difference in pose is none of the geometry. The `aligned` figures are what is left after the
/// implied transforms of both cameras.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PairDifference {
    /// The camera whose frame is the reference, by its name in a.
    pub from: String,
    /// The camera whose pose is compared, by its name in a.
    pub to: String,
    /// The distance of the two cameras' centres in a, in millimetres.
    pub baseline_a_mm: f64,
    /// The same in b.
    pub baseline_b_mm: f64,
    /// The angle between the two relative orientations in degrees.
    pub rotation_deg: f64,
    /// The distance of the two positions of camera `to`, seen from `from`, in millimetres.
    pub translation_mm: f64,
    /// The angle in degrees after the implied transforms.
    pub aligned_rotation_deg: f64,
    /// The distance in millimetres after the implied transforms.
    pub aligned_translation_mm: f64,
    /// The difference of the poses as they are against what both uncertainties predict; `None` where either
    /// is unknown.
    pub significance: Option<PoseSignificance>,
    /// Where camera `to` sees what `from` sees; `None` where they see nothing in common.
    pub transfer: Option<TransferDifference>,
}

/// Returns how far two calibrations differ.
///
/// Cameras are paired by name; if both calibrations have a single camera, these two are a pair
/// whatever their names.
pub fn compare_rigs(
    a: &[ComparedCamera],
    b: &[ComparedCamera],
    options: &CompareOptions,
) -> Result<RigComparison, Error> {
    compare_known_rigs(a, b, [None, None], options)
}

/// Does what [`compare_rigs`] does, and tells how significant the differences are where both
/// calibrations tell how well they are known. Cameras have the names that the uncertainties know them by.
pub fn compare_known_rigs(
    a: &[ComparedCamera],
    b: &[ComparedCamera],
    uncertainties: [Option<&Uncertainty>; 2],
    options: &CompareOptions,
) -> Result<RigComparison, Error> {
    let known = uncertainties.map(|uncertainty| uncertainty.and_then(Known::new));
    let pairs = paired(a, b);
    let names = |cameras: &[ComparedCamera]| cameras.iter().map(|camera| camera.name.clone()).collect();
    if pairs.is_empty() {
        return Err(Error::NoCommonCamera { a: names(a), b: names(b) });
    }
    let compared: Result<Vec<CameraComparison>, Error> = pairs
        .iter()
        .map(|(in_a, in_b)| {
            let comparison = compare(&in_a.camera, &in_b.camera, options)
                .map_err(|error| Error::Camera { name: in_a.name.clone(), source: Box::new(error) })?;
            let significance = match &known {
                [Some(of_a), Some(of_b)] => {
                    let (eye_a, eye_b) = (eye(in_a, Some(of_a)), eye(in_b, Some(of_b)));
                    of_lenses(&comparison, [(of_a, &eye_a), (of_b, &eye_b)])
                }
                _ => None,
            };
            Ok(CameraComparison {
                name: in_a.name.clone(),
                name_in_b: in_b.name.clone(),
                comparison,
                significance,
            })
        })
        .collect();
    let cameras = compared?;
    let mut differences = Vec::new();
    for (first, from) in pairs.iter().enumerate() {
        for (second, to) in pairs.iter().enumerate().skip(first + 1) {
            let implied = [first, second].map(|i| cameras[i].comparison.b_from_a());
            differences.extend(pair_difference(*from, *to, implied, &known, options));
        }
    }
    let without = |side: &[ComparedCamera], is_paired: &dyn Fn(&ComparedCamera) -> bool| {
        side.iter().filter(|camera| !is_paired(camera)).map(|camera| camera.name.clone()).collect()
    };
    Ok(RigComparison {
        only_in_a: without(a, &|camera| pairs.iter().any(|(in_a, _)| std::ptr::eq(*in_a, camera))),
        only_in_b: without(b, &|camera| pairs.iter().any(|(_, in_b)| std::ptr::eq(*in_b, camera))),
        cameras,
        pairs: differences,
    })
}

type Pair<'a> = (&'a ComparedCamera, &'a ComparedCamera);

fn paired<'a>(a: &'a [ComparedCamera], b: &'a [ComparedCamera]) -> Vec<Pair<'a>> {
    if let ([in_a], [in_b]) = (a, b) {
        return vec![(in_a, in_b)];
    }
    a.iter().filter_map(|in_a| Some((in_a, b.iter().find(|in_b| in_b.name == in_a.name)?))).collect()
}

/// Returns the difference of the poses of camera `to` relative to `from`, or `None` if any is unknown.
fn pair_difference(
    from: Pair,
    to: Pair,
    [b_from_a_of_from, b_from_a_of_to]: [Pose; 2],
    known: &[Option<Known<'_>>; 2],
    options: &CompareOptions,
) -> Option<PairDifference> {
    let in_a = to.0.cam_from_rig? * from.0.cam_from_rig?.inverse();
    let in_b = to.1.cam_from_rig? * from.1.cam_from_rig?.inverse();
    let aligned = b_from_a_of_to * in_a * b_from_a_of_from.inverse();
    let position = |to_from_from: &Pose| to_from_from.inverse().translation;
    let rotation_deg = |pose: &Pose| angle_between(&in_b, pose).to_degrees();
    let translation_mm = |pose: &Pose| 1e3 * (position(&in_b) - position(pose)).norm();
    let eyes = [
        [eye(from.0, known[0].as_ref()), eye(to.0, known[0].as_ref())],
        [eye(from.1, known[1].as_ref()), eye(to.1, known[1].as_ref())],
    ];
    let pair =
        |which: usize| EyePair { from: &eyes[which][0], to: &eyes[which][1], known: known[which].as_ref() };
    let pairs = [pair(0), pair(1)];
    let pairs = [&pairs[0], &pairs[1]];
    Some(PairDifference {
        significance: of_poses(pairs),
        transfer: of_transfer(pairs, options),
        from: from.0.name.clone(),
        to: to.0.name.clone(),
        baseline_a_mm: 1e3 * in_a.translation.norm(),
        baseline_b_mm: 1e3 * in_b.translation.norm(),
        rotation_deg: rotation_deg(&in_a),
        translation_mm: translation_mm(&in_a),
        aligned_rotation_deg: rotation_deg(&aligned),
        aligned_translation_mm: translation_mm(&aligned),
    })
}

/// Returns a camera with the places of what is known of it: none if nothing is.
fn eye(camera: &ComparedCamera, known: Option<&Known<'_>>) -> Eye {
    let pose = camera.cam_from_rig.unwrap_or_default();
    match known {
        Some(known) => Eye::of(&known.joint, camera.name.clone(), camera.camera.clone(), pose),
        None => Eye {
            name: camera.name.clone(),
            camera: camera.camera.clone(),
            cam_from_rig: pose,
            lens: Vec::new(),
            pose: Vec::new(),
        },
    }
}

/// Returns the angle between two orientations in radians: exactly zero for equal ones.
fn angle_between(one: &Pose, other: &Pose) -> f64 {
    let (one, other) = (one.rotation.coords, other.rotation.coords);
    // A quaternion and its negative are one rotation; the arc between them is half its angle.
    let chord = (one - other).norm().min((one + other).norm());
    4.0 * (0.5 * chord).min(1.0).asin()
}

#[cfg(test)]
mod tests {
    use boresight_camera::Model;
    use boresight_geometry::Vector3;

    use super::*;

    fn camera(name: &str, fx: f64, cam_from_rig: Option<Pose>) -> ComparedCamera {
        let camera = Camera::new(Model::Pinhole(Default::default()), vec![fx, fx, 320.0, 240.0], [640, 480]);
        ComparedCamera { name: name.to_owned(), camera: camera.unwrap(), cam_from_rig }
    }

    fn stereo() -> [ComparedCamera; 2] {
        let right = Pose::from_rodrigues(Vector3::new(0.01, -0.2, 0.03), Vector3::new(-0.1, 0.01, 0.02));
        [camera("left", 500.0, Some(Pose::identity())), camera("right", 510.0, Some(right))]
    }

    #[test]
    fn a_rig_equals_itself() {
        let rig = stereo();
        let same = compare_rigs(&rig, &rig, &CompareOptions::default()).unwrap();
        assert!(same.cameras.iter().all(|camera| camera.comparison.max_px == 0.0));
        let pair = &same.pairs[0];
        assert_eq!((pair.from.as_str(), pair.to.as_str()), ("left", "right"));
        assert_eq!((pair.rotation_deg, pair.translation_mm), (0.0, 0.0));
        assert_eq!((pair.aligned_rotation_deg, pair.aligned_translation_mm), (0.0, 0.0));
        assert!((pair.baseline_a_mm - 102.4695).abs() < 1e-3);
    }

    #[test]
    fn a_moved_camera_is_measured_whatever_the_rig_frame() {
        let rig = stereo();
        // The right camera of b is turned by 0.5 degrees about its own centre and then moved by 3 mm.
        let turn = Pose::from_rodrigues(Vector3::new(0.0, 0.5f64.to_radians(), 0.0), Vector3::zeros());
        let shift_in_left = Pose::new(Pose::identity().rotation, Vector3::new(0.0, -0.003, 0.0));
        let rig_from_elsewhere =
            Pose::from_rodrigues(Vector3::new(0.3, 0.1, 2.0), Vector3::new(1.0, 2.0, 3.0));
        let mut moved = rig.clone();
        moved[1].cam_from_rig = Some(turn * rig[1].cam_from_rig.unwrap() * shift_in_left);
        for camera in &mut moved {
            camera.cam_from_rig = camera.cam_from_rig.map(|cam_from_rig| cam_from_rig * rig_from_elsewhere);
        }
        let difference = compare_rigs(&rig, &moved, &CompareOptions::default()).unwrap();
        let pair = &difference.pairs[0];
        assert!((pair.rotation_deg - 0.5).abs() < 1e-9, "{pair:?}");
        assert!((pair.translation_mm - 3.0).abs() < 1e-9, "{pair:?}");
        let back = compare_rigs(&moved, &rig, &CompareOptions::default()).unwrap();
        assert!((back.pairs[0].translation_mm - 3.0).abs() < 1e-9);
    }

    #[test]
    fn a_turn_that_the_lens_implies_is_not_geometry() {
        let rig = stereo();
        let mut shifted = rig.clone();
        // A shift of cx by one pixel is, about the axis, a yaw of 1/fx: the frame turns the other way.
        shifted[1].camera.params[2] += 1.0;
        let yaw = Pose::from_rodrigues(Vector3::new(0.0, -1.0 / 510.0, 0.0), Vector3::zeros());
        shifted[1].cam_from_rig = rig[1].cam_from_rig.map(|cam_from_rig| yaw * cam_from_rig);
        let pair = &compare_rigs(&rig, &shifted, &CompareOptions::default()).unwrap().pairs[0];
        assert!((pair.rotation_deg - (1.0f64 / 510.0).to_degrees()).abs() < 1e-9);
        // What the lens' yaw leaves of the shift off axis is small, not nothing.
        assert!(pair.aligned_rotation_deg < 0.2 * pair.rotation_deg, "{pair:?}");
    }

    #[test]
    fn cameras_find_their_names() {
        let [left, right] = stereo();
        let third = camera("third", 500.0, None);
        let options = CompareOptions::default();
        let a = [third.clone(), right.clone(), left.clone()];
        let b = [left.clone(), camera("fourth", 1.0, None), third.clone()];
        let difference = compare_rigs(&a, &b, &options).unwrap();
        let names: Vec<&str> = difference.cameras.iter().map(|camera| camera.name.as_str()).collect();
        assert_eq!(names, ["third", "left"]);
        // The third has no pose.
        assert_eq!(difference.pairs, []);
        assert_eq!(
            (difference.only_in_a, difference.only_in_b),
            (vec!["right".into()], vec!["fourth".into()])
        );

        let single =
            compare_rigs(std::slice::from_ref(&left), std::slice::from_ref(&third), &options).unwrap();
        assert_eq!(single.cameras[0].name_in_b, "third");
        let none = compare_rigs(&[left.clone(), right], &[third], &options).unwrap_err();
        assert_eq!(
            none.to_string(),
            "no camera is in both calibrations: one has left, right; the other has third"
        );
        let mut small = left.clone();
        small.camera.image_size = [320, 240];
        let error = compare_rigs(&[left], &[small], &options).unwrap_err();
        assert_eq!(error.to_string(), "camera left cannot be compared");
    }
}
