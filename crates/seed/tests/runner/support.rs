//! Reading of the conformance data, and figures of merit.

use std::fs::File;
use std::io::BufReader;
use std::path::PathBuf;

use boresight_camera::Model;
use boresight_data::{
    CameraId, CameraInfo, Dataset, Frame, FrameId, Geometry, Observation, PointId, Scene, Shape, Target,
    TargetId, View,
};
use boresight_seed::{LeftOut, Seed, SeedOptions, seed};

/// An array of an npz file, in C order.
pub struct Array {
    pub shape: Vec<usize>,
    pub values: Vec<f64>,
}

/// Returns a file of the conformance data, or `None`, with a note, where it is not there.
pub fn conformance(path: &str) -> Option<PathBuf> {
    let root = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../../shared/conformance");
    let file = root.join(path);
    if !file.exists() {
        println!("skipped: {} is not there", file.display());
        return None;
    }
    Some(file)
}

/// Reads one array of an npz file.
pub fn array(path: &PathBuf, name: &str) -> Array {
    let mut archive = npyz::npz::NpzArchive::new(BufReader::new(File::open(path).unwrap())).unwrap();
    let npy = archive.by_name(name).unwrap().unwrap();
    let shape: Vec<usize> = npy.shape().iter().map(|&n| n as usize).collect();
    let is_fortran = npy.order() == npyz::Order::Fortran;
    let kind = npy.dtype().descr();
    let values: Vec<f64> = match kind.trim_matches('\'') {
        "<f8" => npy.into_vec::<f64>().unwrap(),
        "<f4" => npy.into_vec::<f32>().unwrap().into_iter().map(f64::from).collect(),
        "<i4" => npy.into_vec::<i32>().unwrap().into_iter().map(f64::from).collect(),
        "<i8" => npy.into_vec::<i64>().unwrap().into_iter().map(|v| v as f64).collect(),
        "|u1" => npy.into_vec::<u8>().unwrap().into_iter().map(f64::from).collect(),
        other => panic!("{name} has type {other}"),
    };
    if is_fortran && shape.len() == 2 {
        let (rows, columns) = (shape[0], shape[1]);
        let values = (0..rows * columns).map(|i| values[(i % columns) * rows + i / columns]).collect();
        return Array { shape, values };
    }
    Array { shape, values }
}

/// Returns a dataset of one chessboard without views.
pub fn board_dataset(
    cameras: &[(&str, [u32; 2])],
    n_frames: usize,
    [columns, rows]: [u32; 2],
    spacing_m: f64,
) -> Dataset {
    let geometry = Geometry::Chessboard { columns, rows, spacing_m };
    Dataset {
        cameras: cameras
            .iter()
            .map(|(name, image_size)| CameraInfo { name: (*name).to_owned(), image_size: *image_size })
            .collect(),
        targets: vec![Target { name: "board".into(), geometry, shape: Shape::Parabolic2 }].into(),
        frames: (0..n_frames).map(|i| Frame { name: i.to_string(), ..Frame::default() }).collect(),
        views: Vec::new(),
    }
}

/// Returns a view of all points that have finite pixels.
pub fn view(camera: usize, frame: usize, pixels: &[[f64; 2]]) -> View {
    let observations = pixels.iter().enumerate().filter(|(_, pixel)| pixel[0].is_finite());
    View {
        camera: CameraId(camera as u32),
        frame: FrameId(frame as u32),
        target: TargetId(0),
        image: None,
        observations: observations
            .map(|(point, &pixel)| Observation { point: PointId(point as u32), pixel, sigma_px: 1.0 })
            .collect(),
    }
}

/// Returns the RMS over all observations of views that were kept (OpenCV's definition), their median
/// length, and the number of observations that do not project.
pub fn reprojection(dataset: &Dataset, scene: &Scene, left_out: &[LeftOut]) -> (f64, f64, usize) {
    let mut squares = Vec::new();
    let mut lost = 0;
    for (view_idx, view) in dataset.views.iter().enumerate() {
        let Some(rig_camera) = &scene.rig.cameras[view.camera] else { continue };
        if left_out.iter().any(|fact| fact.view_idx() == Some(view_idx)) {
            continue;
        }
        let rig_from_target = scene.rig_from_target[view.frame].expect("a frame with kept views has a pose");
        let belief = &scene.targets[view.target];
        let cam_from_target = rig_camera.cam_from_rig * rig_from_target * belief.first_from_target;
        for observation in &view.observations {
            let point = dataset.targets[view.target].point(observation.point, &belief.shape_m);
            match rig_camera.camera.project(&(cam_from_target * point)) {
                Some([u, v]) => {
                    squares.push((u - observation.pixel[0]).powi(2) + (v - observation.pixel[1]).powi(2));
                }
                None => lost += 1,
            }
        }
    }
    let rms = (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
    squares.sort_by(f64::total_cmp);
    (rms, squares[squares.len() / 2].sqrt(), lost)
}

/// Returns the CPU time of this thread so far, zero where the system does not tell.
fn cpu_ms() -> f64 {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    text.split(' ').next().and_then(|ns| ns.parse::<f64>().ok()).map_or(0.0, |ns| ns * 1e-6)
}

/// Seeds with one lens model for all cameras, and prints figures.
pub fn seed_with(label: &str, dataset: &Dataset, model: &str) -> Seed {
    let model: Model = model.parse().unwrap();
    let options = SeedOptions { models: vec![model], ..SeedOptions::default() };
    let start = cpu_ms();
    let seeded = seed(dataset, &options).unwrap();
    let elapsed_ms = cpu_ms() - start;
    let (rms, median, lost) = reprojection(dataset, &seeded.scene, &seeded.left_out);
    let focal: Vec<f64> =
        seeded.scene.rig.cameras.iter().flatten().map(|camera| camera.camera.params[0].round()).collect();
    println!(
        "{label} {model}: rms {rms:.4} median {median:.4} lost {lost} left out {} f {focal:?} in {elapsed_ms:.2} ms",
        seeded.left_out.len()
    );
    for fact in seeded.left_out.iter().take(4) {
        println!("    {}", fact.describe(dataset));
    }
    assert_eq!(lost, 0, "{label}: every kept observation projects");
    seeded
}
