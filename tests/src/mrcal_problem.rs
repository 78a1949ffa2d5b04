//! The conformance problems: mrcal's arrays as a dataset and scenes.

use std::collections::BTreeSet;
use std::io;
use std::path::Path;

use boresight_camera::{Camera, Model};
use boresight_data::{
    CameraId, CameraInfo, Dataset, Frame, FrameId, Geometry, Observation, PointId, Rig, RigCamera, Scene,
    Shape, Target, TargetBelief, TargetId, View,
};
use boresight_geometry::{Pose, Vector3};

use crate::npz::Npz;

/// A problem with its seed, or a solution.
#[derive(Debug)]
pub struct MrcalProblem {
    /// The observations.
    pub dataset: Dataset,
    /// The stored start.
    pub seed: Scene,
    /// The arrays.
    pub arrays: Npz,
}

/// The outliers of a problem, as view and point.
#[derive(Clone, Debug, Default)]
pub struct TrueOutliers {
    /// All corners that were displaced, however little.
    pub all: BTreeSet<(usize, u32)>,
    /// Those that are far from the truth.
    pub above: BTreeSet<(usize, u32)>,
}

impl MrcalProblem {
    /// Reads a parametric problem file; `with_outliers` adds the stored displacements.
    pub fn read(path: &Path, model: Model, with_outliers: bool) -> io::Result<Self> {
        let arrays = Npz::read(path)?;
        let n_cameras = arrays.shape("intrinsics_seed")[0];
        let n_frames = arrays.shape("frames_rt_toref_seed")[0];
        let [columns, rows] = [0, 1].map(|i| arrays.numbers("board_wh")[i] as u32);
        let size = |camera: usize| [0, 1].map(|axis| arrays.numbers("imagersizes")[2 * camera + axis] as u32);
        let mut pixels = arrays.numbers("observations").to_vec();
        if with_outliers {
            let moved = arrays.numbers("outlier_dq").chunks_exact(2);
            for (&corner, by) in arrays.numbers("outlier_flat_index").iter().zip(moved) {
                pixels[3 * corner as usize] += by[0];
                pixels[3 * corner as usize + 1] += by[1];
            }
        }
        let n_points = (columns * rows) as usize;
        let views = arrays
            .numbers("indices_frame_camintrinsics_camextrinsics")
            .chunks_exact(3)
            .zip(pixels.chunks_exact(3 * n_points));
        let views = views.map(|(index, pixels)| View {
            camera: CameraId(index[1] as u32),
            frame: FrameId(index[0] as u32),
            target: TargetId(0),
            image: None,
            observations: pixels
                .chunks_exact(3)
                .enumerate()
                .map(|(point, p)| Observation {
                    point: PointId(point as u32),
                    pixel: [p[0], p[1]],
                    sigma_px: 1.0 / p[2],
                })
                .collect(),
        });
        let target = Target {
            name: "target".to_owned(),
            geometry: Geometry::Chessboard { columns, rows, spacing_m: arrays.number("spacing") },
            shape: Shape::Parabolic2,
        };
        let dataset = Dataset {
            cameras: (0..n_cameras)
                .map(|camera| CameraInfo { name: format!("camera{camera}"), image_size: size(camera) })
                .collect(),
            targets: vec![target].into(),
            frames: (0..n_frames)
                .map(|frame| Frame { name: format!("{frame}"), ..Frame::default() })
                .collect(),
            views: views.collect(),
        };
        let seed = scene(&arrays, "_seed", model, &dataset);
        Ok(Self { dataset, seed, arrays })
    }

    /// Returns the corners that were displaced, and those of them that lie more than `sigmas` away from where the
    /// truth says, which must be of opencv8; a corner that it does not see goes by the displacement alone.
    pub fn true_outliers(&self, sigma_px: f64, sigmas: f64) -> TrueOutliers {
        let n_points = self.dataset.targets[TargetId(0)].point_count();
        let mut outliers = TrueOutliers::default();
        let moved = self.arrays.numbers("outlier_dq").chunks_exact(2);
        let truth = scene(&self.arrays, "_true", "opencv8".parse().expect("a model"), &self.dataset);
        for (&corner, by) in self.arrays.numbers("outlier_flat_index").iter().zip(moved) {
            let (view_idx, point) = (corner as usize / n_points, corner as usize % n_points);
            let view = &self.dataset.views[view_idx];
            let camera = truth.rig.cameras[view.camera].as_ref().expect("all cameras have a truth");
            let rig_from_target = truth.rig_from_target[view.frame].expect("all frames have a truth");
            let point_id = PointId(point as u32);
            let shape_m = &truth.targets[TargetId(0)].shape_m;
            let point_in_target = self.dataset.targets[TargetId(0)].point(point_id, shape_m);
            let clean = camera.camera.project(&(camera.cam_from_rig * rig_from_target * point_in_target));
            let seen = view.observations[point].pixel;
            let error = clean.map_or(by[0].hypot(by[1]), |c| (seen[0] - c[0]).hypot(seen[1] - c[1]));
            outliers.all.insert((view_idx, point as u32));
            if error > sigmas * sigma_px {
                outliers.above.insert((view_idx, point as u32));
            }
        }
        outliers
    }

    /// Returns the scene stored under names that end in `suffix`: `_seed`, `_true`, or none in a solution file.
    pub fn scene_of(&self, arrays: &Npz, suffix: &str, model: Model) -> Scene {
        scene(arrays, suffix, model, &self.dataset)
    }
}

fn scene(arrays: &Npz, suffix: &str, model: Model, dataset: &Dataset) -> Scene {
    let intrinsics = arrays.numbers(&format!("intrinsics{suffix}"));
    let n_params = intrinsics.len() / dataset.cameras.len();
    let cam_from_ref = arrays.numbers(&format!("extrinsics_rt_fromref{suffix}"));
    let cameras = dataset.cameras.iter().enumerate().map(|(idx, info)| {
        Some(RigCamera {
            camera: Camera {
                model,
                params: intrinsics[idx * n_params..(idx + 1) * n_params].to_vec(),
                image_size: info.image_size,
            },
            cam_from_rig: match idx {
                0 => Pose::identity(),
                _ => pose(&cam_from_ref[6 * (idx - 1)..6 * idx]),
            },
            time_offset_s: 0.0,
            line_delay_s: 0.0,
        })
    });
    Scene {
        rig: Rig { cameras: cameras.collect() },
        robot: None,
        targets: vec![TargetBelief {
            shape_m: arrays.numbers(&format!("calobject_warp{suffix}")).to_vec(),
            first_from_target: Pose::identity(),
        }]
        .into(),
        rig_from_target: arrays
            .numbers(&format!("frames_rt_toref{suffix}"))
            .chunks_exact(6)
            .map(|rt| Some(pose(rt)))
            .collect(),
        ..Scene::default()
    }
}

/// Returns the pose of mrcal's `rt`: a Rodrigues vector and a translation.
fn pose(rt: &[f64]) -> Pose {
    Pose::from_rodrigues(Vector3::new(rt[0], rt[1], rt[2]), Vector3::new(rt[3], rt[4], rt[5]))
}
