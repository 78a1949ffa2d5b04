//! The conformance sets that OpenCV's answers are known for, as datasets.

use std::collections::BTreeMap;
use std::path::Path;
use std::{fs, io};

use boresight_data::{
    CameraId, CameraInfo, Dataset, Frame, FrameId, Geometry, Observation, PointId, Shape, Target, TargetId,
    View,
};

use crate::npz::Npz;

/// Reads the recorded left/right corners: one square is one metre, so that lengths are in squares.
///
/// # Panics
/// If the file is not as the conformance data has it.
pub fn read_corners(path: &Path, cameras: &[&str]) -> io::Result<Dataset> {
    let text = fs::read_to_string(path)?;
    let mut views: BTreeMap<(u32, u32), Vec<Observation>> = BTreeMap::new();
    for line in text.lines().skip(1) {
        let fields: Vec<&str> = line.split(',').collect();
        let Some(camera) = cameras.iter().position(|name| *name == fields[0]) else { continue };
        let number = |field: usize| fields[field].parse::<f64>().expect("a number");
        let observation =
            Observation { point: PointId(number(3) as u32), pixel: [number(7), number(8)], sigma_px: 1.0 };
        views.entry((number(2) as u32, camera as u32)).or_default().push(observation);
    }
    let n_frames = views.keys().map(|(frame, _)| frame + 1).max().unwrap_or(0);
    let views = views.into_iter().map(|((frame, camera), observations)| View {
        camera: CameraId(camera),
        frame: FrameId(frame),
        target: TargetId(0),
        image: None,
        observations,
    });
    Ok(dataset(cameras, [640, 480], [9, 6], 1.0, n_frames as usize, views.collect()))
}

/// Reads a synthetic rig: `img` (cameras, frames, points, 2), NaN where unseen.
pub fn read_rig(path: &Path) -> io::Result<(Dataset, Npz)> {
    let arrays = Npz::read(path)?;
    let shape = arrays.shape("img");
    let (n_cameras, n_frames, n_points) = (shape[0], shape[1], shape[2]);
    let pixels = arrays.numbers("img");
    let mut views = Vec::new();
    for frame in 0..n_frames {
        for camera in 0..n_cameras {
            let first = 2 * n_points * (camera * n_frames + frame);
            let observations = observations(&pixels[first..first + 2 * n_points]);
            if arrays.numbers("mask")[camera * n_frames + frame] > 0.0 && !observations.is_empty() {
                let (camera, frame) = (CameraId(camera as u32), FrameId(frame as u32));
                views.push(View { camera, frame, target: TargetId(0), image: None, observations });
            }
        }
    }
    let names: Vec<String> = (0..n_cameras).map(|camera| format!("camera{camera}")).collect();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let size = [0, 1].map(|axis| arrays.numbers("image_size")[axis] as u32);
    let spacing = arrays.numbers("obj")[3];
    Ok((dataset(&names, size, [10, 10], spacing, n_frames, views), arrays))
}

/// Reads views `first..first + count` of the synthetic fisheye: `img` (views, points, 2), NaN where unseen.
pub fn read_fisheye(path: &Path, first: usize, count: usize) -> io::Result<Dataset> {
    let arrays = Npz::read(path)?;
    let n_points = arrays.shape("img")[1];
    let pixels = arrays.numbers("img").chunks_exact(2 * n_points).skip(first).take(count);
    let views = pixels.enumerate().map(|(frame, pixels)| View {
        camera: CameraId(0),
        frame: FrameId(frame as u32),
        target: TargetId(0),
        image: None,
        observations: observations(pixels),
    });
    let size = [0, 1].map(|axis| arrays.numbers("image_size")[axis] as u32);
    let spacing = arrays.numbers("obj")[3];
    Ok(dataset(
        &["fisheye"],
        size,
        [10, 10],
        spacing,
        count,
        views.filter(|v| !v.observations.is_empty()).collect(),
    ))
}

fn observations(pixels: &[f64]) -> Vec<Observation> {
    let points = pixels.chunks_exact(2).enumerate().filter(|(_, p)| p[0].is_finite() && p[1].is_finite());
    points
        .map(|(i, p)| Observation { point: PointId(i as u32), pixel: [p[0], p[1]], sigma_px: 1.0 })
        .collect()
}

fn dataset(
    cameras: &[&str],
    image_size: [u32; 2],
    [columns, rows]: [u32; 2],
    spacing_m: f64,
    n_frames: usize,
    views: Vec<View>,
) -> Dataset {
    let target = Target {
        name: "target".to_owned(),
        geometry: Geometry::Chessboard { columns, rows, spacing_m },
        shape: Shape::Rigid,
    };
    Dataset {
        cameras: cameras.iter().map(|name| CameraInfo { name: (*name).to_owned(), image_size }).collect(),
        targets: vec![target].into(),
        frames: (0..n_frames).map(|frame| Frame { name: frame.to_string(), ..Frame::default() }).collect(),
        views,
    }
}
