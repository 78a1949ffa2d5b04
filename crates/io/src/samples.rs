//! A small calibration with something of everything, and the files beside the project, for tests.

use std::collections::BTreeMap;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use boresight_camera::Camera;
use boresight_data::{
    Calibration, CameraFit, Geometry, HeldOut, IdVec, LooseDirection, Motions, Mount, PointId, Provenance,
    Regularization, Rejection, RejectionReason, Rig, RigCamera, Robot, Scene, Shape, SolveRecord, Target,
    TargetBelief, TargetMount, Transfer, Uncertainty, ViewFit,
};
use boresight_geometry::{Pose, Vector3};

/// Returns a file of the folder `shared` beside the project, or `None`, saying so, where it is not there.
pub(crate) fn shared_file(name: &str) -> Option<PathBuf> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared").join(name);
    if path.is_file() {
        return Some(path);
    }
    // Past the harness, which keeps to itself what passing tests print.
    let _ = writeln!(std::io::stderr(), "skipped: {} is not there", path.display());
    None
}

/// Returns a rig of these lens models, given with parameters, for 640x480 images.
pub(crate) fn rig(lenses: &[(&str, Vec<f64>)]) -> Vec<Option<RigCamera>> {
    let camera = |(i, (model, params)): (usize, &(&str, Vec<f64>))| {
        let camera = Camera::new(model.parse().unwrap(), params.clone(), [640, 480]).unwrap();
        let i = i as f64;
        let cam_from_rig = match i {
            0.0 => Pose::identity(),
            _ => Pose::from_rodrigues(
                Vector3::new(0.01, -0.02, 0.1 * i),
                Vector3::new(-0.1 * i, 1.0 / 3.0, 1e-7),
            ),
        };
        Some(RigCamera { camera, cam_from_rig, time_offset_s: 0.001 * i / 3.0, line_delay_s: 2e-5 * i / 7.0 })
    };
    lenses.iter().enumerate().map(camera).collect()
}

/// Returns the parameters fx, fy, cx, cy and as many small coefficients as are asked for.
pub(crate) fn lens(coefficients: usize) -> Vec<f64> {
    let core = [536.073456789012, 536.0162345678901, 342.37, 235.53];
    let coefficient = |i: usize| -0.265 / (i * i + 1) as f64 / 3.0;
    core.into_iter().chain((0..coefficients).map(coefficient)).collect()
}

/// Returns a calibration of these cameras, named left, right, and camN.
pub(crate) fn calibration(cameras: Vec<Option<RigCamera>>) -> Calibration {
    let name = |i: usize| ["left", "right"].get(i).map_or(format!("cam{i}"), |name| (*name).to_owned());
    let fits = (0..cameras.len())
        .map(|i| CameraFit { name: name(i), rms_px: 0.1 + 0.2, views: 2, observations: 9, rejected: 1 })
        .collect();
    let scene = Scene { rig: Rig { cameras: IdVec::from(cameras) }, ..Scene::default() };
    let unsolved = Calibration::unsolved(scene, Vec::new(), "not asked for");
    Calibration { cameras: fits, rms_px: 0.215111, ..unsolved }
}

/// Returns a calibration with something of everything.
pub(crate) fn sample() -> Calibration {
    let mut cameras = rig(&[("opencv5", lens(5)), ("opencv8", lens(8))]);
    cameras.push(None);
    let pose = |z: f64| Pose::from_rodrigues(Vector3::new(0.3, 0.1, -2.0), Vector3::new(1.0 / 7.0, -0.0, z));
    let strings = |pairs: &[(&str, &str)]| -> BTreeMap<String, String> {
        pairs.iter().map(|(key, value)| ((*key).to_owned(), (*value).to_owned())).collect()
    };
    let geometry = Geometry::Chessboard { columns: 3, rows: 2, spacing_m: 0.025 };
    let second = Geometry::Points { points_m: vec![[0.1, 0.2, 0.3]; 3] };
    Calibration {
        targets: IdVec::from(vec![
            Target { name: "board".to_owned(), geometry, shape: Shape::Parabolic2 },
            Target { name: "points".to_owned(), geometry: second, shape: Shape::Rigid },
        ]),
        frame_names: vec!["01".to_owned(), "02".to_owned()],
        views: vec![
            ViewFit { rms_px: Some(0.1), residuals_px: vec![[0.1, -0.2], [1e-17, 3.0]] },
            ViewFit { rms_px: None, residuals_px: Vec::new() },
        ],
        uncertainty: Uncertainty {
            noise_factor: 1.0 / 3.0,
            degrees_of_freedom: 12,
            names: vec!["left.fx".to_owned(), "target.shape0_m".to_owned()],
            covariance: vec![0.25, 1e-300, 1e-300, 1.0 / 3.0],
            unavailable: None,
            baselines_m: BTreeMap::from([("right".to_owned(), [0.083, 1e-5])]),
            regularization_information: vec![0.0, 1.0 / 7.0],
            regularization_pairs: vec![(0, 1, -1.0 / 9.0)],
            motions: Motions {
                names: vec!["mean.rx_rad".to_owned()],
                covariance: vec![1e-7, -0.0, 1.0 / 3.0e6],
            },
            loose: vec![LooseDirection {
                inflation: 1e4 / 3.0,
                parts: vec![("left.fx".to_owned(), 0.9)],
                words: "fx of left is not determined".to_owned(),
            }],
        },
        rejected: vec![
            Rejection {
                view_idx: 0,
                point: PointId(1),
                reason: RejectionReason::Outlier { sigmas: f64::INFINITY, limit: 4.0 },
            },
            Rejection {
                view_idx: 1,
                point: PointId(0),
                reason: RejectionReason::LeftOut { why: "alone".to_owned() },
            },
        ],
        regularization: Regularization { kind: "default".to_owned(), rows: 3, chi2: 0.01 },
        solve: SolveRecord {
            chi2: 1234.5,
            iterations: 7,
            evaluations: 8,
            passes: 2,
            stop: "predicted decrease 3.1e-9 below 1e-6".to_owned(),
            converged: true,
        },
        held_out: Some(HeldOut {
            folds: 2,
            frames: 2,
            views: 3,
            observations: 9,
            degrees_of_freedom: 6,
            rms_px: 0.3,
            in_sample_rms_px: 1.0 / 3.0,
            ratio: 0.9,
            cameras_px: BTreeMap::from([("left".to_owned(), 0.31)]),
            transfer: Some(Transfer { observations: 4, rms_px: 0.5, rms_mm: 1.0 / 3.0 }),
            untested_views: 1,
        }),
        provenance: Provenance {
            version: "0.1.0".to_owned(),
            inputs: strings(&[("a.csv", "00ff")]),
            options: strings(&[("model", "opencv5")]),
        },
        scene: Scene {
            rig: Rig { cameras: IdVec::from(cameras.clone()) },
            robot: Some(Robot {
                mount: Mount::OnFlange { flange_from_rig: pose(0.1) },
                target_mount: TargetMount::Fixed { base_from_target: pose(0.2) },
                tip_in_flange: Some(Vector3::new(0.0, 0.1, 0.2)),
                stretch: Some(boresight_data::Stretch {
                    centre_in_base: Vector3::new(0.3, 0.2, 0.1),
                    matrix: boresight_geometry::Matrix3::new(
                        1e-3,
                        0.0,
                        2.0 / 3.0,
                        0.0,
                        1e-4,
                        0.0,
                        0.1,
                        0.0,
                        0.0,
                    ),
                }),
            }),
            targets: IdVec::from(vec![
                TargetBelief { shape_m: vec![1e-4, -2.0 / 3.0 * 1e-4], first_from_target: Pose::identity() },
                TargetBelief { shape_m: Vec::new(), first_from_target: pose(0.3) },
            ]),
            rig_from_target: IdVec::from(vec![Some(pose(1.5)), None]),
            motion: IdVec::from(vec![
                Some(boresight_data::FrameMotion {
                    velocity: boresight_geometry::Vector6::repeat(1.0 / 3.0),
                    acceleration: boresight_geometry::Vector6::repeat(-2.0 / 7.0),
                }),
                None,
            ]),
        },
        ..calibration(cameras)
    }
}
