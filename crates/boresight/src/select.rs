//! A part of a dataset: some of its cameras.

use std::collections::BTreeMap;

use boresight_data::{CameraId, CameraInfo, Dataset, Frame, FrameId, IdVec, View};

use crate::error::Error;

/// Returns what the named cameras saw, in the order of the dataset; all of it for no names.
///
/// Frames that none of them saw are gone.
pub(crate) fn select_cameras(dataset: &Dataset, names: &[String]) -> Result<Dataset, Error> {
    if names.is_empty() {
        return Ok(dataset.clone());
    }
    let known = || dataset.cameras.iter().map(|camera| camera.name.clone()).collect();
    if let Some(name) = names.iter().find(|name| !dataset.cameras.iter().any(|camera| camera.name == **name))
    {
        return Err(Error::UnknownCamera { name: name.clone(), known: known() });
    }
    let mut cameras = IdVec::default();
    let mut new_camera: BTreeMap<CameraId, CameraId> = BTreeMap::new();
    for (id, camera) in dataset.cameras.enumerate().filter(|(_, camera)| names.contains(&camera.name)) {
        new_camera.insert(id, cameras.push(camera.clone()));
    }
    let mut frames: IdVec<FrameId, Frame> = IdVec::default();
    let mut new_frame: BTreeMap<FrameId, FrameId> = BTreeMap::new();
    let mut views = Vec::new();
    for view in &dataset.views {
        let Some(&camera) = new_camera.get(&view.camera) else { continue };
        let frame =
            *new_frame.entry(view.frame).or_insert_with(|| frames.push(dataset.frames[view.frame].clone()));
        views.push(View { camera, frame, ..view.clone() });
    }
    Ok(Dataset { cameras, targets: dataset.targets.clone(), frames, views })
}

/// Returns what cameras that share one lens saw as what one camera saw: each view in a frame of its own.
pub(crate) fn as_one_camera(dataset: &Dataset, cameras: &[CameraId]) -> Dataset {
    let views = dataset.views.iter().filter(|view| cameras.contains(&view.camera));
    let names: Vec<&str> = cameras.iter().map(|camera| dataset.cameras[*camera].name.as_str()).collect();
    let (mut one, mut new_frame) = (Dataset::default(), BTreeMap::new());
    for view in views {
        let frame = *new_frame.entry((view.camera, view.frame)).or_insert_with(|| {
            // The robot's pose is of the first camera at most, and nothing here needs it.
            one.frames.push(Frame { base_from_flange: None, ..dataset.frames[view.frame].clone() })
        });
        one.views.push(View { camera: CameraId(0), frame, ..view.clone() });
    }
    let first = cameras.first().map(|camera| dataset.cameras[*camera].clone());
    one.cameras = first.map(|first| CameraInfo { name: names.join("+"), ..first }).into_iter().collect();
    one.targets = dataset.targets.clone();
    one
}

#[cfg(test)]
mod tests {
    use boresight_data::TargetId;

    use super::*;

    fn dataset() -> Dataset {
        let camera = |name: &str| CameraInfo { name: name.to_owned(), image_size: [640, 480] };
        let frame = |name: &str| Frame { name: name.to_owned(), ..Frame::default() };
        let view = |frame, camera| View {
            camera: CameraId(camera),
            frame: FrameId(frame),
            target: TargetId(0),
            image: None,
            observations: Vec::new(),
        };
        Dataset {
            cameras: ["a", "b", "c"].map(camera).into_iter().collect(),
            frames: ["0", "1", "2"].map(frame).into_iter().collect(),
            views: vec![view(0, 0), view(1, 2), view(2, 1), view(2, 2)],
            ..Dataset::default()
        }
    }

    #[test]
    fn cameras_keep_their_order_and_unseen_frames_go() {
        let part = select_cameras(&dataset(), &["c".to_owned(), "b".to_owned()]).unwrap();
        let names: Vec<&str> = part.cameras.iter().map(|camera| camera.name.as_str()).collect();
        assert_eq!(names, ["b", "c"]);
        let frames: Vec<&str> = part.frames.iter().map(|frame| frame.name.as_str()).collect();
        assert_eq!(frames, ["1", "2"]);
        let views: Vec<_> = part.views.iter().map(|view| (view.frame.0, view.camera.0)).collect();
        assert_eq!(views, [(0, 1), (1, 0), (1, 1)]);
        assert_eq!(select_cameras(&dataset(), &[]).unwrap(), dataset());
    }

    #[test]
    fn cameras_of_one_lens_become_one_with_a_frame_for_each_view() {
        let one = as_one_camera(&dataset(), &[CameraId(1), CameraId(2)]);
        assert_eq!(one.cameras.as_slice()[0].name, "b+c");
        let views: Vec<_> = one.views.iter().map(|view| (view.frame.0, view.camera.0)).collect();
        assert_eq!(views, [(0, 0), (1, 0), (2, 0)]);
        let frames: Vec<&str> = one.frames.iter().map(|frame| frame.name.as_str()).collect();
        assert_eq!(frames, ["1", "2", "2"]);
    }

    #[test]
    fn unknown_cameras_are_answered_with_the_known() {
        let error = select_cameras(&dataset(), &["d".to_owned()]).unwrap_err();
        assert_eq!(error.to_string(), "there is no camera `d`; known: a, b, c");
    }
}
