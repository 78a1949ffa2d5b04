//! From what corner files say to a checked dataset: ids, order, and what a dataset must not hold.

use std::cmp::Ordering;
use std::collections::BTreeMap;

use boresight_data::{
    CameraId, CameraInfo, Dataset, Finding, Frame, FrameId, Id as _, IdVec, Severity, Target, TargetId, View,
};

use crate::image_names::{Listed, assign};
use crate::seen::{SeenFile, SeenView};
use crate::{Error, Place};

/// How far outside the image a pixel may lie, as a share of the image's size, before it is noticed.
const MARGIN: f64 = 0.1;

/// A camera as the job describes it.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct CameraSpec {
    /// Its name, and the pattern of its images.
    pub listed: Listed,
    /// Width and height of its image in pixels.
    pub image_size: [u32; 2],
}

/// Builds the dataset of some targets from corner files, each of one target, with what was noticed.
///
/// Where the job lists no cameras, those of the files are taken, in natural order of their names, with
/// the image size `default_size`.
pub(crate) fn assemble(
    files: Vec<SeenFile>,
    specs: &[CameraSpec],
    default_size: Option<[u32; 2]>,
    targets: Vec<Target>,
) -> Result<(Dataset, Vec<Finding>), Error> {
    let mut findings = Vec::new();
    let listed: Vec<Listed> = specs.iter().map(|spec| spec.listed.clone()).collect();
    let mut found = Vec::new();
    for file in files {
        note_file(&file, &mut findings);
        let (name, left_out) = gather(file, &listed, &mut found)?;
        if left_out > 0 {
            findings.push(Finding {
                code: "images-without-camera".to_owned(),
                severity: Severity::Note,
                place: name,
                message: format!("{left_out} images match the pattern of no camera and were left out"),
                measured: Some(left_out as f64),
                limit: None,
                fix: "change the patterns (`images`) of the cameras in the job if they should be used"
                    .to_owned(),
            });
        }
    }

    let infos = cameras(&found, specs, default_size)?;
    let camera_ids: BTreeMap<&str, CameraId> =
        infos.enumerate().map(|(id, info)| (info.name.as_str(), id)).collect();
    let mut frame_names: Vec<String> = found.iter().map(|located| located.frame.clone()).collect();
    frame_names.sort_by(|a, b| natural_order(a, b));
    frame_names.dedup();
    let frame_ids: BTreeMap<&str, FrameId> =
        frame_names.iter().enumerate().map(|(i, name)| (name.as_str(), FrameId::from_index(i))).collect();

    found.sort_by_cached_key(|located| {
        (frame_ids[located.frame.as_str()], camera_ids.get(located.camera.as_str()), located.target_idx)
    });
    for pair in found.windows(2) {
        let key = |located: &Located| (located.frame.clone(), located.camera.clone(), located.target_idx);
        if key(&pair[0]) == key(&pair[1]) {
            return Err(Error::DuplicateView {
                place: Place::line(&pair[1].file, pair[1].view.line),
                frame: pair[1].frame.clone(),
                camera: pair[1].camera.clone(),
                first: pair[0].view.image.as_deref().unwrap_or(&pair[0].file).into(),
                second: pair[1].view.image.as_deref().unwrap_or(&pair[1].file).into(),
            });
        }
    }
    check_pixels(&found, &infos, &mut findings)?;
    let mut views = Vec::with_capacity(found.len());
    for located in found {
        let known = || infos.iter().map(|info| info.name.clone()).collect();
        let Some(&camera) = camera_ids.get(located.camera.as_str()) else {
            let place = Place::line(&located.file, located.view.line);
            return Err(Error::UnknownCamera { place, name: located.camera, known: known() });
        };
        let frame = frame_ids[located.frame.as_str()];
        let SeenView { image, observations, .. } = located.view;
        let target = TargetId::from_index(located.target_idx);
        views.push(View { camera, frame, target, image, observations });
    }
    for (id, info) in infos.enumerate() {
        if !views.iter().any(|view: &View| view.camera == id) {
            findings.push(Finding {
                code: "camera-without-views".to_owned(),
                severity: Severity::Caution,
                place: info.name.clone(),
                message: format!("no corner file has a view of camera {}", info.name),
                measured: Some(0.0),
                limit: Some(1.0),
                fix: "add its corners to [input].corners, or take the camera out of the job".to_owned(),
            });
        }
    }
    drop((camera_ids, frame_ids));
    let frames =
        frame_names.into_iter().map(|name| Frame { name, time_ns: None, base_from_flange: None }).collect();
    let dataset = Dataset { cameras: infos, targets: IdVec::from(targets), frames, views };
    Ok((dataset, findings))
}

/// A view that knows its camera, frame and file.
struct Located {
    file: String,
    camera: String,
    frame: String,
    target_idx: usize,
    view: SeenView,
}

/// Appends the views of a file that hold corners, and returns its name and how many images have no camera.
fn gather(file: SeenFile, listed: &[Listed], found: &mut Vec<Located>) -> Result<(String, usize), Error> {
    let SeenFile { file, target_idx, views, .. } = file;
    let unnamed = views.iter().any(|view| view.camera.is_none());
    // Images without a board take part, so that the same rule applies whatever was detected.
    let images: Vec<&str> = views.iter().map(|view| view.image.as_deref().unwrap_or_default()).collect();
    let mut taken = if unnamed { assign(&file, &images, listed)? } else { Vec::new() }.into_iter();
    let mut left_out = 0;
    for mut view in views {
        let (camera, frame) = match (view.camera.take(), view.frame.take()) {
            (Some(camera), Some(frame)) => {
                if !listed.is_empty() && !listed.iter().any(|known| known.name == camera) {
                    let known = listed.iter().map(|known| known.name.clone()).collect();
                    return Err(Error::UnknownCamera {
                        place: Place::line(&file, view.line),
                        name: camera,
                        known,
                    });
                }
                (camera, frame)
            }
            _ => match taken.next().flatten() {
                Some(taken) => (taken.camera, taken.frame),
                None => {
                    left_out += 1;
                    continue;
                }
            },
        };
        if !view.observations.is_empty() {
            found.push(Located { file: file.clone(), camera, frame, target_idx, view });
        }
    }
    Ok((file, left_out))
}

fn note_file(file: &SeenFile, findings: &mut Vec<Finding>) {
    if let Some((count, line)) = file.minus_one {
        findings.push(Finding {
            code: "corners-at-minus-one".to_owned(),
            severity: Severity::Note,
            place: Place::line(&file.file, line).to_string(),
            message: format!("{count} corners at (-1, -1) are taken as missing"),
            measured: Some(count as f64),
            limit: Some(0.0),
            fix: "leave missing corners out of the file".to_owned(),
        });
    }
    if file.cut_off {
        findings.push(Finding {
            code: "no-newline-at-end".to_owned(),
            severity: Severity::Caution,
            place: file.file.clone(),
            message: "the last line does not end in a newline: the file may have been cut off".to_owned(),
            measured: None,
            limit: None,
            fix: "compare the file with its source; a newline at its end silences this".to_owned(),
        });
    }
}

fn cameras(
    found: &[Located],
    specs: &[CameraSpec],
    default_size: Option<[u32; 2]>,
) -> Result<IdVec<CameraId, CameraInfo>, Error> {
    if !specs.is_empty() {
        let info =
            |spec: &CameraSpec| CameraInfo { name: spec.listed.name.clone(), image_size: spec.image_size };
        return Ok(specs.iter().map(info).collect());
    }
    let mut names: Vec<&str> = found.iter().map(|located| located.camera.as_str()).collect();
    names.sort_by(|a, b| natural_order(a, b));
    names.dedup();
    names
        .into_iter()
        .map(|name| match default_size {
            Some(image_size) => Ok(CameraInfo { name: name.to_owned(), image_size }),
            None => Err(Error::NoImageSize { camera: name.to_owned() }),
        })
        .collect()
}

/// Notices pixels far outside the image; where most are, the image size is wrong.
fn check_pixels(
    found: &[Located],
    infos: &IdVec<CameraId, CameraInfo>,
    findings: &mut Vec<Finding>,
) -> Result<(), Error> {
    for info in infos {
        let size = info.image_size.map(f64::from);
        let (mut outside, mut total, mut reach) = (0, 0, [0.0_f64; 2]);
        let mut worst: Option<(f64, &Located, u32)> = None;
        for located in found.iter().filter(|located| located.camera == info.name) {
            for observation in &located.view.observations {
                let beyond = |axis: usize| {
                    let pixel = observation.pixel[axis];
                    (-0.5 - pixel).max(pixel - (size[axis] - 0.5)) / size[axis]
                };
                let excess = beyond(0).max(beyond(1));
                total += 1;
                reach = [reach[0].max(observation.pixel[0]), reach[1].max(observation.pixel[1])];
                if excess > MARGIN {
                    outside += 1;
                    if worst.is_none_or(|(most, ..)| excess > most) {
                        worst = Some((excess, located, observation.point.0));
                    }
                }
            }
        }
        let Some((excess, located, point)) = worst else { continue };
        if 2 * outside > total {
            let (camera, image_size) = (info.name.clone(), info.image_size);
            return Err(Error::ImageSize { camera, image_size, reach, outside, total });
        }
        let image = located.view.image.as_deref().unwrap_or(&located.frame);
        findings.push(Finding {
            code: "pixels-outside-image".to_owned(),
            severity: Severity::Caution,
            place: info.name.clone(),
            message: format!(
                "{outside} of {total} corners lie outside the {}x{} image by more than 10 % of its size, the farthest \
                 being point {point} of {image} ({})",
                info.image_size[0],
                info.image_size[1],
                Place::line(&located.file, located.view.line),
            ),
            measured: Some(excess),
            limit: Some(MARGIN),
            fix: "is image_size right, and are the corners of this camera?".to_owned(),
        });
    }
    Ok(())
}

/// Compares names so that `img2` comes before `img10`.
pub(crate) fn natural_order(a: &str, b: &str) -> Ordering {
    let (mut rest_a, mut rest_b) = (a.as_bytes(), b.as_bytes());
    loop {
        let (Some(first_a), Some(first_b)) = (rest_a.first(), rest_b.first()) else {
            return rest_a.len().cmp(&rest_b.len()).then_with(|| a.cmp(b));
        };
        let digits = |text: &[u8]| text.iter().take_while(|byte| byte.is_ascii_digit()).count();
        let (n_a, n_b) = (digits(rest_a), digits(rest_b));
        let order = if n_a > 0 && n_b > 0 {
            let significant = |text: &[u8], n: usize| -> Vec<u8> {
                text[..n].iter().copied().skip_while(|byte| *byte == b'0').collect()
            };
            let (value_a, value_b) = (significant(rest_a, n_a), significant(rest_b, n_b));
            value_a.len().cmp(&value_b.len()).then_with(|| value_a.cmp(&value_b))
        } else {
            first_a.cmp(first_b)
        };
        if order != Ordering::Equal {
            return order;
        }
        (rest_a, rest_b) = (&rest_a[n_a.max(1)..], &rest_b[n_b.max(1)..]);
    }
}

#[cfg(test)]
mod tests {
    use boresight_data::{Geometry, Observation, PointId, Shape};

    use super::*;

    fn view(camera: &str, frame: &str, pixels: &[[f64; 2]]) -> SeenView {
        let observation = |(i, &pixel)| Observation { point: PointId(i as u32), pixel, sigma_px: 1.0 };
        SeenView {
            camera: Some(camera.to_owned()),
            frame: Some(frame.to_owned()),
            image: None,
            line: 7,
            observations: pixels.iter().enumerate().map(observation).collect(),
        }
    }

    fn run(views: Vec<SeenView>, cameras: &[&str]) -> Result<(Dataset, Vec<Finding>), Error> {
        let listed = |name: &&str| Listed { name: (*name).to_owned(), images: None };
        let specs: Vec<CameraSpec> =
            cameras.iter().map(|name| CameraSpec { listed: listed(name), image_size: [100, 50] }).collect();
        let geometry = Geometry::Chessboard { columns: 3, rows: 2, spacing_m: 0.1 };
        let target = Target { name: "board".to_owned(), geometry, shape: Shape::Rigid };
        let file = SeenFile { file: "c.csv".to_owned(), views, ..SeenFile::default() };
        assemble(vec![file], &specs, None, vec![target])
    }

    #[test]
    fn views_are_ordered_and_frames_shared() {
        let one = [[1.0, 2.0]];
        let views =
            vec![view("b", "10", &one), view("b", "9", &one), view("a", "10", &one), view("a", "8", &[])];
        let (dataset, findings) = run(views, &["a", "b", "c"]).unwrap();
        let order: Vec<_> = dataset.views.iter().map(|view| (view.frame.0, view.camera.0)).collect();
        assert_eq!(order, [(0, 1), (1, 0), (1, 1)]);
        assert_eq!(dataset.frames.iter().map(|frame| frame.name.as_str()).collect::<Vec<_>>(), ["9", "10"]);
        assert_eq!(findings.len(), 1);
        assert_eq!((findings[0].code.as_str(), findings[0].place.as_str()), ("camera-without-views", "c"));
    }

    #[test]
    fn pixels_outside_the_image_are_noticed() {
        let inside = [[1.0, 2.0], [3.0, 4.0]];
        let (_, findings) = run(vec![view("a", "1", &[inside[0], inside[1], [-11.0, 5.0]])], &["a"]).unwrap();
        assert_eq!(findings[0].code, "pixels-outside-image");
        assert!(findings[0].message.contains("point 2 of 1 (c.csv:7)"), "{}", findings[0].message);
        let error = run(vec![view("a", "1", &[[1.0, 2.0], [190.0, 5.0], [180.0, 5.0]])], &["a"]).unwrap_err();
        assert!(error.to_string().contains("image_size is 100x50 but pixels reach (190, 5)"), "{error}");
    }

    #[test]
    fn strangers_and_repetitions_are_refused() {
        let one = [[1.0, 2.0]];
        let error = run(vec![view("lfet", "1", &one)], &["left", "right"]).unwrap_err();
        assert!(
            error.to_string().contains("c.csv:7: unknown camera `lfet`; the job lists left, right"),
            "{error}"
        );
        assert!(error.hint().unwrap().contains("`left`"));
        let error = run(vec![view("a", "1", &one), view("a", "1", &one)], &["a"]).unwrap_err();
        assert!(matches!(error, Error::DuplicateView { .. }), "{error}");
        assert!(matches!(run(vec![view("a", "1", &one)], &[]), Err(Error::NoImageSize { .. })));
    }

    #[test]
    fn numbers_are_ordered_by_value() {
        let mut names = vec!["img10", "img9", "img09", "a", "img", "img9b", "img1-2", "img1-10"];
        names.sort_by(|a, b| natural_order(a, b));
        assert_eq!(names, ["a", "img", "img1-2", "img1-10", "img09", "img9", "img9b", "img10"]);
    }
}
