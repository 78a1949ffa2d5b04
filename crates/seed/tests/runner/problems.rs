//! Seeds of the conformance problems, with no focal length given.

use boresight_data::{Dataset, Id as _};

use crate::support::{array, board_dataset, conformance, reprojection, seed_with, view};

/// Reads a problem of `conformance/mrcal/problems`; see field/mrcal.md 5.1.
fn mrcal_problem(name: &str) -> Option<(Dataset, Vec<f64>)> {
    let path = conformance(&format!("mrcal/problems/{name}.npz"))?;
    let sizes = array(&path, "imagersizes");
    let board = array(&path, "board_wh");
    let spacing_m = array(&path, "spacing").values[0];
    let observations = array(&path, "observations");
    let indices = array(&path, "indices_frame_camintrinsics_camextrinsics");
    let n_frames = array(&path, "frames_rt_toref_true").shape[0];
    let names: Vec<String> = (0..sizes.shape[0]).map(|i| format!("cam{i}")).collect();
    let cameras: Vec<_> = names
        .iter()
        .zip(sizes.values.chunks(2))
        .map(|(name, size)| (name.as_str(), [size[0] as u32, size[1] as u32]))
        .collect();
    let mut dataset =
        board_dataset(&cameras, n_frames, [board.values[0] as u32, board.values[1] as u32], spacing_m);
    let n_points = observations.shape[1] * observations.shape[2];
    for (index, corners) in indices.values.chunks(3).zip(observations.values.chunks(3 * n_points)) {
        let pixels: Vec<[f64; 2]> = corners.chunks(3).map(|corner| [corner[0], corner[1]]).collect();
        dataset.views.push(view(index[1] as usize, index[0] as usize, &pixels));
    }
    let intrinsics = array(&path, "intrinsics_true");
    let focal = intrinsics.values.chunks(intrinsics.shape[1]).map(|params| params[0]).collect();
    Some((dataset, focal))
}

fn check_mrcal(name: &str, focal_tolerance: f64) {
    let Some((dataset, focal)) = mrcal_problem(name) else { return };
    let seeded = seed_with(name, &dataset, "opencv8");
    assert_eq!(seeded.left_out, []);
    for (camera, focal) in seeded.scene.rig.cameras.iter().zip(focal) {
        let found = camera.as_ref().unwrap().camera.params[0];
        assert!((found / focal - 1.0).abs() < focal_tolerance, "{name}: {found} for {focal}");
    }
    let (rms, ..) = reprojection(&dataset, &seeded.scene, &seeded.left_out);
    // The board is bowed by 3 mm, up to 4 px, and the seed takes it for flat.
    assert!(rms < 3.0, "{name}: {rms}");
}

#[test]
fn mrcal_problems() {
    for name in [
        "c1_f50_b10_opencv8",
        "c1_f50_b14_opencv8",
        "c1_f200_b10_opencv8",
        "c2_f50_b10_opencv8",
        "c8_f50_b10_opencv8",
        "c8_f200_b10_opencv8",
    ] {
        check_mrcal(name, 0.02);
    }
}

#[test]
fn fisheye_chunks_of_twenty_views() {
    let Some(path) = conformance("opencv/syn_fisheye.npz") else { return };
    let objects = array(&path, "obj");
    println!("object {:?}", &objects.values[..6]);
    let image_size = array(&path, "image_size").values;
    let image = array(&path, "img");
    let focal = array(&path, "K").values[0];
    let n_points = image.shape[1];
    let spacing_m = objects.values[3] - objects.values[0];
    for chunk in 0..image.shape[0] / 20 {
        let size = [image_size[0] as u32, image_size[1] as u32];
        let mut dataset = board_dataset(&[("fisheye", size)], 20, [10, 10], spacing_m);
        for frame in 0..20 {
            let first = (chunk * 20 + frame) * n_points * 2;
            let pixels: Vec<[f64; 2]> =
                image.values[first..first + 2 * n_points].chunks(2).map(|p| [p[0], p[1]]).collect();
            dataset.views.push(view(0, frame, &pixels));
        }
        let seeded = seed_with(&format!("fisheye {chunk}"), &dataset, "kannala-brandt4");
        let found = seeded.scene.rig.cameras.as_slice()[0].as_ref().unwrap().camera.params[0];
        assert!((found / focal - 1.0).abs() < 0.02, "chunk {chunk}: {found} for {focal}");
        assert!(seeded.left_out.is_empty(), "chunk {chunk}");
        let (rms, ..) = reprojection(&dataset, &seeded.scene, &seeded.left_out);
        assert!(rms < 0.7, "chunk {chunk}: {rms}");
    }
}

#[test]
fn the_recorded_stereo_set() {
    for corners in ["classic5", "classic11", "sb"] {
        let Some(path) = conformance(&format!("opencv/real_corners_{corners}_cv5.0.0.csv")) else { return };
        let text = std::fs::read_to_string(path).unwrap();
        let mut dataset = board_dataset(&[("left", [640, 480]), ("right", [640, 480])], 14, [9, 6], 1.0);
        let rows: Vec<Vec<&str>> = text.lines().skip(1).map(|line| line.split(',').collect()).collect();
        for rows in rows.chunk_by(|a, b| a[..2] == b[..2]) {
            let camera = usize::from(rows[0][0] == "right");
            let frame: usize = rows[0][2].parse().unwrap();
            let mut pixels = vec![[f64::NAN; 2]; 54];
            for row in rows {
                pixels[row[3].parse::<usize>().unwrap()] = [row[7].parse().unwrap(), row[8].parse().unwrap()];
            }
            dataset.views.push(view(camera, frame, &pixels));
        }
        for model in ["opencv5", "opencv8", "kannala-brandt4", "opencv14", "pinhole"] {
            let seeded = seed_with(corners, &dataset, model);
            for (id, camera) in seeded.scene.rig.cameras.enumerate() {
                let found = camera.as_ref().unwrap().camera.params[0];
                let expected = [533.0, 537.3][id.index()];
                // The undistorted pinhole cannot follow the lens.
                let tolerance = if model == "pinhole" { 0.1 } else { 0.02 };
                assert!(
                    (found / expected - 1.0).abs() < tolerance,
                    "{corners} {model}: {found} for {expected}"
                );
            }
        }
    }
}

/// Prints times; `cargo test --release -p boresight-seed -- --ignored --nocapture speed`.
#[test]
#[ignore = "prints times, checks nothing"]
fn speed() {
    for name in ["c1_f50_b10_opencv8", "c8_f50_b10_opencv8", "c8_f200_b10_opencv8"] {
        let Some((dataset, _)) = mrcal_problem(name) else { return };
        for _ in 0..8 {
            seed_with(name, &dataset, "opencv8");
        }
    }
}
