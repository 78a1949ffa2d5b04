//! Makes a calibration problem by `synthetic` and prints its arrays as JSON, for `make_problem.py pack`:
//!
//! ```text
//! make_problem CAMERAS FRAMES BOARD [COLUMNS ROWS DEGREES]
//! ```
//!
//! A row of 4000x2200 cameras 0.3 m apart looks at a bowed board of BOARD by BOARD corners. With the last three a spline of
//! order 3 with so many knots, so wide, is to be found instead of the lens that made the pixels, from a flat surface.
#![allow(clippy::print_stdout, clippy::unwrap_used, reason = "a program for developers")]

use boresight_camera::Camera;
use boresight_data::{Geometry, Shape, Target};
use boresight_geometry::{Pose, Vector3};
use boresight_synthetic::{Outliers, PlacedCamera, Placement, Recipe, simulate};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use rand_distr::{Distribution, Normal};
use serde_json::json;

const IMAGE_SIZE: [u32; 2] = [4000, 2200];
const BOARD_M: f64 = 0.9;
const SIGMA_PX: f64 = 0.3;
const SEED: u64 = 1;

/// A typical lens, and how cameras of a kind differ.
const TYPICAL: [f64; 12] =
    [1760.0, 1760.0, 1960.0, 1070.0, -0.012, 0.035, -3e-4, 5e-4, 0.02, 0.014, -0.052, 0.05];
const SPREAD: [f64; 12] = [10.0, 10.0, 30.0, 20.0, 2e-3, 2e-3, 5e-5, 5e-5, 2e-3, 2e-3, 2e-3, 2e-3];

fn main() {
    let numbers: Vec<u32> = std::env::args().skip(1).map(|text| text.parse().unwrap()).collect();
    let [n_cameras, n_frames, board, knots @ ..] = numbers.as_slice() else {
        panic!("usage: make_problem CAMERAS FRAMES BOARD [COLUMNS ROWS DEGREES]");
    };
    let mut rng = ChaCha8Rng::seed_from_u64(SEED);
    let normal = Normal::new(0.0, 1.0).unwrap();
    let mut draw = |sigma: f64| sigma * normal.sample(&mut rng);
    let cameras: Vec<PlacedCamera> = (0..*n_cameras)
        .map(|i| {
            let params: Vec<f64> =
                TYPICAL.iter().zip(SPREAD).map(|(mean, sigma)| mean + draw(sigma)).collect();
            let turn = Vector3::from_fn(|_, _| draw(0.03));
            let centre = Vector3::new(0.3 * f64::from(i), draw(0.01), draw(0.01));
            let rig_from_cam = Pose::from_rodrigues(turn, centre);
            PlacedCamera {
                name: format!("camera{i}"),
                camera: Camera::new("opencv8".parse().unwrap(), params, IMAGE_SIZE).unwrap(),
                cam_from_rig: if i == 0 { Pose::identity() } else { rig_from_cam.inverse() },
            }
        })
        .collect();
    let spacing_m = BOARD_M / f64::from(board - 1);
    let recipe = Recipe {
        cameras,
        target: Target {
            name: "board".to_owned(),
            geometry: Geometry::Chessboard { columns: *board, rows: *board, spacing_m },
            shape: Shape::Parabolic2,
        },
        shape_m: vec![0.002, -0.003],
        frames: *n_frames as usize,
        placement: Placement { distance_m: [1.2, 3.5], tilt_rad: 0.7, roll_rad: 0.5, image_share: 0.7 },
        sigma_px: SIGMA_PX,
        outliers: Outliers { share: 0.0, sigma_px: 10.0 },
        hidden_share: 0.0,
        // The format knows whole boards only.
        min_points: (board * board) as usize,
    };
    let made = simulate(&recipe, SEED);
    assert!(made.truth.rig_from_target.iter().all(Option::is_some), "a frame shows no whole board");
    let rt = |pose: &Pose| -> Vec<f64> {
        pose.rotation.scaled_axis().iter().chain(pose.translation.iter()).copied().collect()
    };
    let true_cameras: Vec<_> = made.truth.rig.cameras.iter().flatten().collect();
    let cams_from_ref: Vec<Vec<f64>> =
        true_cameras.iter().skip(1).map(|camera| rt(&camera.cam_from_rig)).collect();
    let frames: Vec<Vec<f64>> = made.truth.rig_from_target.iter().flatten().map(rt).collect();
    let mut near = |rows: &[Vec<f64>], sigma: f64| -> Vec<Vec<f64>> {
        rows.iter().map(|row| row.iter().map(|value| value + draw(sigma)).collect()).collect()
    };
    let [columns, rows] = IMAGE_SIZE.map(f64::from);
    let core = [1700.0, 1700.0, (columns - 1.0) / 2.0, (rows - 1.0) / 2.0];
    let (lens, n_rest) = match knots {
        [columns, rows, degrees] => (
            format!("LENSMODEL_SPLINED_STEREOGRAPHIC_order=3_Nx={columns}_Ny={rows}_fov_x_deg={degrees}"),
            2 * columns * rows,
        ),
        _ => ("LENSMODEL_OPENCV8".to_owned(), 8),
    };
    let seed_lens: Vec<f64> = core.into_iter().chain((0..n_rest).map(|_| 0.0)).collect();
    let observations: Vec<Vec<[f64; 3]>> = made
        .dataset
        .views
        .iter()
        .map(|view| view.observations.iter().map(|seen| [seen.pixel[0], seen.pixel[1], 1.0]).collect())
        .collect();
    let index: Vec<[i64; 3]> = made
        .dataset
        .views
        .iter()
        .map(|view| [i64::from(view.frame.0), i64::from(view.camera.0), i64::from(view.camera.0) - 1])
        .collect();
    let document = json!({
        "lensmodel": lens,
        "lensmodel_true": "LENSMODEL_OPENCV8",
        "imagersizes": vec![IMAGE_SIZE; true_cameras.len()],
        "spacing": spacing_m,
        "board_wh": [board, board],
        "observations": observations,
        "indices_frame_camintrinsics_camextrinsics": index,
        "intrinsics_seed": vec![seed_lens; true_cameras.len()],
        "extrinsics_rt_fromref_seed": near(&cams_from_ref, 0.005),
        "frames_rt_toref_seed": near(&frames, 0.01),
        "calobject_warp_seed": [0.0, 0.0],
        "intrinsics_true": true_cameras.iter().map(|camera| camera.camera.params.clone()).collect::<Vec<_>>(),
        "extrinsics_rt_fromref_true": cams_from_ref,
        "frames_rt_toref_true": frames,
        "calobject_warp_true": recipe.shape_m,
        "noise_sigma": SIGMA_PX,
        "rng_seed": SEED,
    });
    println!("{document}");
}
