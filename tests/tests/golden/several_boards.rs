//! Cameras that never see the same, joined by the motion of a rig among boards whose places nobody knows.

use std::f64::consts::TAU;

use boresight_adjust::{AdjustOptions, adjust};
use boresight_camera::Camera;
use boresight_data::{
    CameraId, CameraInfo, Dataset, Frame, Geometry, Id as _, IdVec, Observation, PointId, Shape, Target,
    TargetId, View,
};
use boresight_geometry::{Pose, Vector3};
use boresight_seed::{SeedOptions, seed};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng as _, SeedableRng as _};
use rand_distr::{Distribution as _, StandardNormal};

const SIGMA_PX: f64 = 0.2;

/// A ring of cameras that look outward, and boards around them that do not move.
struct Ring {
    dataset: Dataset,
    cam_from_rig: Vec<Pose>,
    first_from_target: Vec<Pose>,
}

/// Four cameras 90 degrees apart with 60 degrees of view each, and three boards on three sides of a room.
fn ring(frames: usize, seed: u64) -> Ring {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut uniform = |half: f64| half * (2.0 * (rng.next_u32() as f64 / f64::from(u32::MAX)) - 1.0);
    let params = vec![1110.0, 1112.0, 640.0, 482.0, -0.1, 0.04, 3e-4, -4e-4, -0.01];
    let camera = Camera { model: "opencv5".parse().unwrap(), params, image_size: [1280, 960] };
    let turned = |about_y: f64| Pose::from_rodrigues(Vector3::new(0.0, about_y, 0.0), Vector3::zeros());
    // Each camera sits 0.1 m from the middle of the rig and looks away from it.
    let cam_from_middle: Vec<Pose> = (0..4)
        .map(|i| {
            let forward = Pose::new(Pose::identity().rotation, Vector3::new(0.0, 0.0, -0.1));
            forward * turned(-TAU / 4.0 * f64::from(i))
        })
        .collect();
    let geometry = Geometry::Chessboard { columns: 10, rows: 8, spacing_m: 0.06 };
    let (width_m, height_m) = (0.54, 0.42);
    // Boards stand 1.5 m from the middle of the room, each leaning another way.
    let room_from_target: Vec<Pose> = (0..3)
        .map(|i| {
            let lean =
                Vector3::new(0.25 - 0.2 * f64::from(i), 0.3 - 0.25 * f64::from(i), 0.05 * f64::from(i));
            let centred =
                Pose::new(Pose::identity().rotation, Vector3::new(-width_m / 2.0, -height_m / 2.0, 0.0));
            let away = Pose::new(Pose::identity().rotation, Vector3::new(0.0, 0.0, 1.5));
            turned(TAU / 4.0 * f64::from(i)) * away * Pose::from_rodrigues(lean, Vector3::zeros()) * centred
        })
        .collect();
    let targets: IdVec<TargetId, Target> = (0..3)
        .map(|i| Target { name: format!("board{i}"), geometry: geometry.clone(), shape: Shape::Rigid })
        .collect();
    let mut views = Vec::new();
    let mut sigmas = ChaCha8Rng::seed_from_u64(seed + 1);
    for frame in 0..frames {
        // A quarter turn from frame to frame, so that every camera meets every board, and some more about all axes.
        let turn = Vector3::new(uniform(0.3), uniform(0.3), uniform(0.4));
        let shift = Vector3::new(uniform(0.25), uniform(0.2), uniform(0.25));
        let room_from_middle = Pose::new(Pose::identity().rotation, shift)
            * turned(TAU / 4.0 * (frame % 4) as f64)
            * Pose::from_rodrigues(turn, Vector3::zeros());
        for (i, cam_from_middle) in cam_from_middle.iter().enumerate() {
            for (j, room_from_target) in room_from_target.iter().enumerate() {
                let cam_from_target = *cam_from_middle * room_from_middle.inverse() * *room_from_target;
                let target = &targets[TargetId::from_index(j)];
                let mut see = |point: u32| {
                    let point_in_cam = cam_from_target * target.drawn_point(PointId(point));
                    // What is beside the field of view must not come back through the lens's polynomial.
                    if point_in_cam.z < 0.3 || point_in_cam.xy().norm() > 0.8 * point_in_cam.z {
                        return None;
                    }
                    let pixel = camera.project(&point_in_cam)?;
                    let inside = (0..2)
                        .all(|axis| (0.0..f64::from(camera.image_size[axis]) - 1.0).contains(&pixel[axis]));
                    let mut noisy = |value: f64| {
                        let normal: f64 = StandardNormal.sample(&mut sigmas);
                        value + SIGMA_PX * normal
                    };
                    let pixel = [noisy(pixel[0]), noisy(pixel[1])];
                    inside.then_some(Observation { point: PointId(point), pixel, sigma_px: SIGMA_PX })
                };
                let observations: Vec<Observation> = (0..80).filter_map(&mut see).collect();
                if observations.len() >= 20 {
                    views.push(View {
                        camera: CameraId::from_index(i),
                        frame: boresight_data::FrameId::from_index(frame),
                        target: TargetId::from_index(j),
                        image: None,
                        observations,
                    });
                }
            }
        }
    }
    // No board may be seen by two cameras at once: only motion joins them.
    let shared = views.iter().enumerate().any(|(k, view)| {
        views[..k].iter().any(|other: &View| {
            other.frame == view.frame && other.target == view.target && other.camera != view.camera
        })
    });
    assert!(!shared, "two cameras see one board at once");
    let info = |i| CameraInfo { name: format!("cam{i}"), image_size: camera.image_size };
    let dataset = Dataset {
        cameras: (0..4).map(info).collect(),
        targets,
        frames: (0..frames).map(|i| Frame { name: i.to_string(), ..Frame::default() }).collect(),
        views,
    };
    let rig_from_middle = cam_from_middle[0];
    Ring {
        dataset,
        cam_from_rig: cam_from_middle.iter().map(|pose| *pose * rig_from_middle.inverse()).collect(),
        first_from_target: room_from_target
            .iter()
            .map(|pose| room_from_target[0].inverse() * *pose)
            .collect(),
    }
}

/// Returns how far each number of cameras and boards is from the truth, in its stated sigmas, with its name.
fn errors_in_sigmas(ring: &Ring) -> Vec<(String, f64)> {
    let options = SeedOptions { models: vec!["opencv5".parse().unwrap()], ..SeedOptions::default() };
    let seed = seed(&ring.dataset, &options).unwrap();
    assert_eq!(seed.left_out, []);
    let calibration = adjust(&ring.dataset, &seed.scene, &AdjustOptions::default(), None).unwrap();
    assert!(calibration.solve.converged, "{}", calibration.solve.stop);
    assert_eq!(calibration.uncertainty.unavailable, None);

    let names = &calibration.uncertainty.names;
    let n = names.len();
    let scene = &calibration.scene;
    let cameras = scene.rig.cameras.iter().flatten().zip(&ring.cam_from_rig).enumerate();
    let cameras =
        cameras.map(|(i, (camera, truth))| (format!("cam{i}.cam_from_rig"), camera.cam_from_rig, *truth));
    let boards = scene.targets.iter().zip(&ring.first_from_target).enumerate();
    let boards = boards
        .map(|(i, (board, truth))| (format!("board{i}.first_from_target"), board.first_from_target, *truth));
    let mut errors = Vec::new();
    for (what, found, truth) in cameras.chain(boards) {
        // The true pose is the found one after a left perturbation, whose covariance is stated.
        let error = (truth * found.inverse()).log();
        for (k, column) in ["rx_rad", "ry_rad", "rz_rad", "tx_m", "ty_m", "tz_m"].iter().enumerate() {
            let name = format!("{what}.{column}");
            let Some(i) = names.iter().position(|known| *known == name) else { continue };
            errors.push((name, error[k] / calibration.uncertainty.covariance[i * n + i].sqrt()));
        }
    }
    // Three cameras and two boards, six numbers each.
    assert_eq!(errors.len(), 30);
    errors
}

#[test]
fn rings_without_common_view_are_recovered_from_three_boards() {
    let (mut square, mut worst): (f64, f64) = (0.0, 0.0);
    let (mut within, mut all) = (0, 0);
    for seed in 0..10 {
        let errors = errors_in_sigmas(&ring(60, 5 + 2 * seed));
        let (name, most) = errors.iter().max_by(|a, b| a.1.abs().total_cmp(&b.1.abs())).unwrap();
        println!("seed {seed}: at most {:.2} sigmas from the truth ({name})", most.abs());
        worst = worst.max(most.abs());
        square += errors.iter().map(|(_, error)| error * error).sum::<f64>();
        within += errors.iter().filter(|(_, error)| error.abs() <= 3.0).count();
        all += errors.len();
    }
    let rms = (square / all as f64).sqrt();
    println!("{within} of {all} numbers within 3 sigmas, {rms:.3} sigmas RMS, at most {worst:.2}");
    // Chance leaves 0.27 % outside, and numbers of one ring go together: 2 % are four times the scatter of that.
    assert!(within as f64 >= 0.98 * f64::from(all as u32), "{within} of {all}");
    // Of 300 normal numbers the largest is beyond 4.5 once in 500 times.
    assert!(worst < 4.5, "{worst}");
    // Ten rings of 30 numbers, of which those of one ring are far from independent.
    assert!((0.8..1.2).contains(&rms), "{rms}");
}

#[test]
fn the_ring_is_calibrated_from_a_job_with_three_boards() {
    let ring = ring(60, 5);
    let folder = tempfile::tempdir().unwrap();
    let mut job = String::new();
    for board in ring.dataset.targets.ids() {
        let own = |view: &&View| view.target == board;
        let views =
            ring.dataset.views.iter().filter(own).map(|view| View { target: TargetId(0), ..view.clone() });
        let of_board = Dataset { views: views.collect(), ..ring.dataset.clone() };
        let name = format!("board{}.csv", board.0);
        std::fs::write(folder.path().join(&name), boresight_io::corners_to_csv(&of_board)).unwrap();
        job += &match board.0 {
            0 => format!("[target]\nkind = \"chessboard:10x8:60mm\"\n[input]\ncorners = [\"{name}\"]\n"),
            n => format!(
                "[[board]]\nname = \"board{n}\"\nkind = \"chessboard:10x8:60mm\"\ncorners = [\"{name}\"]\n"
            ),
        };
    }
    for i in 0..4 {
        job += &format!("[[camera]]\nname = \"cam{i}\"\nimage_size = [1280, 960]\n");
    }
    std::fs::write(folder.path().join("boresight.toml"), job).unwrap();
    let job = boresight_io::load_job(&[folder.path().to_owned()], &Default::default()).unwrap();
    assert_eq!(job.dataset.views.len(), ring.dataset.views.len());
    let options = boresight::CalibrateOptions { shape: "none".parse().unwrap(), ..Default::default() };
    let outcome = boresight::calibrate(&job, &options, &Default::default()).unwrap();
    assert_eq!(outcome.left_out, [] as [String; 0]);
    let scene = &outcome.calibration.scene;
    for (camera, truth) in scene.rig.cameras.iter().flatten().zip(&ring.cam_from_rig) {
        let error = (camera.cam_from_rig * truth.inverse()).log();
        // A millimetre and a milliradian are several sigmas.
        assert!(error.norm() < 2e-3, "{error}");
    }
}
