//! A job whose corners are still in images: which images there are, and the job once points are detected in them.

use std::collections::BTreeMap;
use std::path::PathBuf;

use boresight_data::{Finding, Observation, Severity, Target};

use crate::assemble::{CameraSpec, assemble, natural_order};
use crate::image_files::{ImageFile, find_images};
use crate::image_names::{Listed, Taken, assign};
use crate::image_pixels::{ReadImage, image_from_bytes};
use crate::job::{Head, Job, JobOverrides, hash, head_beside, named_inputs, read, robot_of, set_times};
use crate::robot_input::RobotOverrides;
use crate::seen::{SeenFile, SeenView, describe};
use crate::size_seen::{SizeSeen, Tally, refuse_other_size, resized};
use crate::target_spec::target_spec;
use crate::{Error, Place};

/// A job whose target is to be detected in images.
pub struct ImageJob {
    /// The images, in natural order of their names.
    pub images: Vec<ImageFile>,
    head: Head,
    /// The cameras that the job lists, or those that were named with patterns in its place.
    listed: Vec<Listed>,
    /// Who took each image.
    taken: Vec<Option<Taken>>,
    /// What replaces the job's robot.
    robot: RobotOverrides,
}

/// What was seen in an image.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SeenImage {
    /// The blake3 hash of the file in hexadecimal.
    pub hash: String,
    /// Width and height in pixels.
    pub image_size: [u32; 2],
    /// Whether the file asks for the image to be turned or mirrored when it is shown.
    pub is_turned: bool,
    /// The points that were detected, in increasing order of their ids.
    pub observations: Vec<Observation>,
    /// Why there are none, in words, where there are none.
    pub missed: Option<String>,
    /// What it says of the target's size.
    pub size: SizeSeen,
    /// Whether it shows a ChArUco board of the legacy pattern, whose first square is white.
    pub is_legacy: bool,
}

/// Returns the job of the images among `inputs` (files, folders, patterns), or `None` if there are none.
///
/// A job file beside the images tells target, cameras and options. Names that do not tell which camera took an image
/// are an error here, before anybody looks at the images.
pub fn load_images(inputs: &[PathBuf], overrides: &JobOverrides) -> Result<Option<ImageJob>, Error> {
    let (mut images, others) = find_images(inputs)?;
    if images.is_empty() {
        images = find_images(&named_inputs(inputs)?.images)?.0;
    }
    let Some(first) = images.first() else { return Ok(None) };
    let head = head_beside("image", &first.path, &others, overrides)?;
    let robot = overrides.robot.clone();
    let listed = head.listed(&overrides.cameras);
    let names: Vec<&str> = images.iter().map(|image| image.name.as_str()).collect();
    let taken = assign("the images", &names, &listed)?;
    Ok(Some(ImageJob { images, head, listed, taken, robot }))
}

/// Reads an image, and returns the hash of its file with it.
pub fn read_image(image: &ImageFile) -> Result<(ReadImage, String), Error> {
    let bytes = read(&image.path)?;
    Ok((image_from_bytes(&image.path.display().to_string(), &bytes)?, hash(&bytes)))
}

impl ImageJob {
    /// Returns the target that is to be detected.
    pub fn target(&self) -> &Target {
        &self.head.target
    }

    /// Returns the job file's `[options]`, and where they begin.
    pub fn options(&self) -> (&toml::Table, Option<&Place>) {
        (&self.head.job.options, self.head.options_place.as_ref())
    }

    /// Returns the job, with what was seen in each image in the order of [`images`](Self::images).
    ///
    /// What cannot be used becomes a finding: unreadable images, copies, and those of another size than most of their
    /// camera. It is an error if nothing was detected at all.
    pub fn with_detections(self, seen: Vec<Result<SeenImage, Error>>) -> Result<Job, Error> {
        let Self { images, mut head, listed, taken, robot } = self;
        let mut findings = Findings::default();
        let mut hashes = std::mem::take(&mut head.hashes);
        let mut first_of: BTreeMap<String, &str> = BTreeMap::new();
        let mut views: Vec<(SeenImage, SeenView)> = Vec::new();
        for ((image, taken), seen) in images.iter().zip(taken).zip(seen) {
            let seen = match seen {
                Ok(seen) => seen,
                Err(error) => {
                    findings.unreadable(&image.name, &error);
                    continue;
                }
            };
            let Some(taken) = taken else {
                findings.without_camera.push(&image.name);
                continue;
            };
            hashes.push((image.name.clone(), seen.hash.clone()));
            // Two cameras may well see the same nothing; one camera does not see the same twice.
            let key = format!("{} {}", taken.camera, seen.hash);
            if let Some(first) = first_of.insert(key, &image.name) {
                findings.copies.push((&image.name, first));
                continue;
            }
            let view = SeenView {
                camera: Some(taken.camera),
                frame: Some(taken.frame),
                image: Some(image.name.clone()),
                line: 1,
                observations: Vec::new(),
            };
            views.push((seen, view));
        }
        finish(Head { hashes, ..head }, &robot, &listed, images.len(), views, findings)
    }
}

/// Returns the job of views that know their cameras and frames, and have no observations yet: those of the images are
/// theirs once all images are judged. What was noticed so far is told with what is noticed here.
pub(crate) fn finish(
    head: Head,
    robot: &RobotOverrides,
    listed: &[Listed],
    n_images: usize,
    mut views: Vec<(SeenImage, SeenView)>,
    mut findings: Findings<'_>,
) -> Result<Job, Error> {
    let mut hashes = head.hashes;
    let specs = specs(listed, &views);
    findings.note_sizes(&specs, &mut views);
    let mut images: Vec<&mut SeenImage> = views.iter_mut().map(|(seen, _)| seen).collect();
    refuse_other_size(&head.target, &mut images);
    findings.note_missed(&views);
    findings.note_legacy(&views);
    if views.iter().all(|(seen, _)| seen.observations.is_empty()) {
        return Err(nothing_detected(&head.target, n_images, &views));
    }
    let view = |(seen, view): (SeenImage, SeenView)| SeenView { observations: seen.observations, ..view };
    let file = SeenFile {
        file: "the images".to_owned(),
        views: views.into_iter().map(view).collect(),
        ..SeenFile::default()
    };
    let (mut dataset, noticed) = assemble(vec![file], &specs, None, vec![head.target])?;
    set_times(&head.folder, head.job.frame_times.as_deref(), &mut dataset, &mut hashes)?;
    let robot = robot_of(&head.folder, head.job.robot.as_ref(), robot, &mut dataset, &mut hashes)?;
    let mut findings = findings.into_findings();
    findings.extend(noticed);
    let (options, options_place) = (head.job.options, head.options_place);
    let known_lenses = head.job.known_lenses;
    Ok(Job { dataset, options, options_place, inputs: hashes, findings, robot, known_lenses })
}

/// Returns the cameras with the size that most of their images have.
fn specs(listed: &[Listed], views: &[(SeenImage, SeenView)]) -> Vec<CameraSpec> {
    let mut sizes: BTreeMap<&str, BTreeMap<[u32; 2], usize>> = BTreeMap::new();
    for (seen, view) in views {
        let camera = view.camera.as_deref().unwrap_or_default();
        *sizes.entry(camera).or_default().entry(seen.image_size).or_default() += 1;
    }
    let most = |counts: &BTreeMap<[u32; 2], usize>| {
        counts.iter().max_by_key(|(size, count)| (**count, **size)).map(|(size, _)| *size)
    };
    let mut names: Vec<String> = if listed.is_empty() {
        sizes.keys().map(|name| (*name).to_owned()).collect()
    } else {
        listed.iter().map(|listed| listed.name.clone()).collect()
    };
    if listed.is_empty() {
        names.sort_by(|a, b| natural_order(a, b));
    }
    let spec = |name: String| {
        let image_size = sizes.get(name.as_str()).and_then(most).unwrap_or([1, 1]);
        CameraSpec { listed: Listed { name, images: None }, image_size }
    };
    names.into_iter().map(spec).collect()
}

fn nothing_detected(target: &Target, images: usize, views: &[(SeenImage, SeenView)]) -> Error {
    let mut reasons: BTreeMap<&str, usize> = BTreeMap::new();
    for (seen, _) in views {
        if let Some(missed) = &seen.missed {
            *reasons.entry(missed).or_default() += 1;
        }
    }
    let refuted = Tally::of(views.iter().map(|(seen, _)| seen.size)).refuted_by(target);
    let seen = refuted.map(|(size, n)| (resized(target, size), n));
    let most = reasons.iter().max_by_key(|(_, count)| **count);
    let why = match (&seen, most) {
        (Some((seen, n)), _) => format!("in {n} of them the board has {}", describe(seen)),
        (None, Some((reason, count))) => format!("of {count} it is said that {reason}"),
        (None, None) => "none could be read".to_owned(),
    };
    let seen = seen.and_then(|(seen, _)| target_spec(&seen));
    Error::NothingDetected { target: describe(target), images, why, seen }
}

/// What is noticed about images; findings of one kind are told together.
#[derive(Default)]
pub(crate) struct Findings<'a> {
    pub(crate) all: Vec<Finding>,
    pub(crate) without_camera: Vec<&'a str>,
    /// Each copy with what it is a copy of.
    pub(crate) copies: Vec<(&'a str, &'a str)>,
}

impl Findings<'_> {
    fn push(
        &mut self,
        code: &str,
        severity: Severity,
        place: &str,
        message: String,
        measured: usize,
        fix: &str,
    ) {
        self.all.push(Finding {
            code: code.to_owned(),
            severity,
            place: place.to_owned(),
            message,
            measured: Some(measured as f64),
            limit: Some(0.0),
            fix: fix.to_owned(),
        });
    }

    fn unreadable(&mut self, name: &str, error: &Error) {
        let fix = "copy it again from its source, or take it away";
        self.push("unreadable-image", Severity::Caution, name, error.to_string(), 1, fix);
    }

    /// Notes and removes images of another size than most of their camera, and notes those that are to be turned.
    fn note_sizes(&mut self, specs: &[CameraSpec], views: &mut Vec<(SeenImage, SeenView)>) {
        for spec in specs {
            let name = &spec.listed.name;
            let [width, height] = spec.image_size;
            let is_of = |view: &SeenView| view.camera.as_deref() == Some(name.as_str());
            let other =
                |(seen, view): &&(SeenImage, SeenView)| is_of(view) && seen.image_size != spec.image_size;
            let others: Vec<&(SeenImage, SeenView)> = views.iter().filter(other).collect();
            if let Some((seen, view)) = others.first() {
                let message = format!(
                    "{} of its images are not {width}x{height} as most are, such as {} ({}x{}); they were left out",
                    others.len(),
                    view.image.as_deref().unwrap_or_default(),
                    seen.image_size[0],
                    seen.image_size[1],
                );
                let fix = "images of one camera have one size: calibrate the others apart, or take them away";
                self.push("mixed-image-sizes", Severity::Caution, name, message, others.len(), fix);
            }
            views.retain(|(seen, view)| !is_of(view) || seen.image_size == spec.image_size);
            let turned = views.iter().filter(|(seen, view)| is_of(view) && seen.is_turned).count();
            if turned > 0 {
                let message = format!(
                    "{turned} of its images ask to be turned when shown (EXIF); they were taken as stored"
                );
                let fix = "undistort and measure in images as they are stored too, or store them turned";
                self.push("image-orientation", Severity::Note, name, message, turned, fix);
            }
        }
    }

    /// Notes in how many images of each camera the target was not detected and why. Boards of another size, in several
    /// images, are told apart: who sees them beside the target may take them away.
    fn note_missed(&mut self, views: &[(SeenImage, SeenView)]) {
        let mut of_camera: BTreeMap<&str, BTreeMap<&str, Vec<&str>>> = BTreeMap::new();
        for (seen, view) in views {
            if let Some(missed) = &seen.missed {
                let reasons = of_camera.entry(view.camera.as_deref().unwrap_or_default()).or_default();
                reasons.entry(missed).or_default().push(view.image.as_deref().unwrap_or_default());
            }
        }
        for (camera, reasons) in of_camera {
            for (reason, images) in reasons {
                let message = format!("{reason}, in {} of its images: {}", images.len(), some_of(&images));
                let is_other = |(seen, _): &(SeenImage, SeenView)| {
                    matches!(seen.size, SizeSeen::Other(_)) && seen.missed.as_deref() == Some(reason)
                };
                if images.len() >= OTHER_SIZE_IMAGES && views.iter().any(is_other) {
                    let fix =
                        "take the other board out of sight; more images show the target as it was declared";
                    self.push("other-board-size", Severity::Caution, camera, message, images.len(), fix);
                    continue;
                }
                let fix = "look at them with `boresight detect`; images without the target do no harm";
                self.push("target-not-detected", Severity::Note, camera, message, images.len(), fix);
            }
        }
    }

    /// Notes which cameras see ChArUco boards of the legacy pattern.
    fn note_legacy(&mut self, views: &[(SeenImage, SeenView)]) {
        let mut of_camera: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
        for (_, view) in views.iter().filter(|(seen, _)| seen.is_legacy) {
            let images = of_camera.entry(view.camera.as_deref().unwrap_or_default()).or_default();
            images.push(view.image.as_deref().unwrap_or_default());
        }
        for (camera, images) in of_camera {
            let message = format!(
                "the ChArUco board has the legacy pattern, with a white first square, in {} of its images: {}",
                images.len(),
                some_of(&images)
            );
            let fix =
                "nothing needs to be done here; tell other programs, as with setLegacyPattern in OpenCV";
            self.push("legacy-charuco", Severity::Note, camera, message, images.len(), fix);
        }
    }

    fn into_findings(mut self) -> Vec<Finding> {
        if let Some(first) = self.without_camera.first() {
            let message = format!(
                "{} images match the pattern of no camera and were left out",
                self.without_camera.len()
            );
            let (place, n) = ((*first).to_owned(), self.without_camera.len());
            let fix = "change the patterns (`images`) of the cameras if they should be used";
            self.push("images-without-camera", Severity::Note, &place, message, n, fix);
        }
        if let Some((copy, first)) = self.copies.first() {
            let message = format!(
                "{} images are copies of others, such as this of {first}; they were left out",
                self.copies.len()
            );
            let (place, n) = ((*copy).to_owned(), self.copies.len());
            self.push("duplicate-images", Severity::Note, &place, message, n, "take them away");
        }
        self.all
    }
}

/// So many images with a whole board of one other size are no accident of detection.
const OTHER_SIZE_IMAGES: usize = 2;

/// Lists the first few names.
fn some_of(names: &[&str]) -> String {
    const SHOWN: usize = 4;
    let more = if names.len() > SHOWN { ", ..." } else { "" };
    format!("{}{more}", names[..names.len().min(SHOWN)].join(", "))
}

#[cfg(test)]
mod tests {
    use boresight_data::PointId;

    use super::*;

    fn seen(hash: &str, image_size: [u32; 2], n: u32) -> Result<SeenImage, Error> {
        let observation = |i| Observation { point: PointId(i), pixel: [f64::from(i), 1.0], sigma_px: 0.1 };
        let missed = (n == 0).then(|| "no board is seen".to_owned());
        let observations = (0..n).map(observation).collect();
        Ok(SeenImage {
            hash: hash.to_owned(),
            image_size,
            is_turned: false,
            observations,
            missed,
            size: SizeSeen::Open,
            is_legacy: false,
        })
    }

    fn job(names: &[&str], cameras: &[(&str, &str)]) -> (tempfile::TempDir, ImageJob) {
        let folder = tempfile::tempdir().unwrap();
        for name in names {
            std::fs::write(folder.path().join(name), name).unwrap();
        }
        let overrides = JobOverrides {
            target: Some(crate::parse_target("chessboard:3x2:1cm").unwrap()),
            cameras: cameras.iter().map(|(a, b)| ((*a).to_owned(), (*b).to_owned())).collect(),
            ..JobOverrides::default()
        };
        let job = load_images(&[folder.path().to_owned()], &overrides).unwrap().unwrap();
        (folder, job)
    }

    #[test]
    fn images_become_views_of_their_cameras() {
        let (_folder, images) = job(&["left1.png", "left2.png", "right1.png", "right2.png"], &[]);
        let made = ["a", "b", "c", "d"].map(|hash| seen(hash, [64, 48], 6));
        let job = images.with_detections(made.into()).unwrap();
        let names: Vec<&str> = job.dataset.cameras.iter().map(|camera| camera.name.as_str()).collect();
        assert_eq!((names, job.dataset.frames.len(), job.dataset.views.len()), (vec!["left", "right"], 2, 4));
        assert_eq!(job.dataset.cameras.as_slice()[0].image_size, [64, 48]);
        assert_eq!(job.dataset.views[0].image.as_deref(), Some("left1.png"));
        assert_eq!(
            (job.inputs[3].clone(), job.findings.len()),
            (("right2.png".to_owned(), "d".to_owned()), 0)
        );
        let (_folder, images) = job_of_patterns();
        let job = images.with_detections(vec![seen("a", [9, 9], 6), seen("b", [9, 9], 6)]).unwrap();
        assert_eq!(job.dataset.cameras.as_slice()[0].name, "wide");
        assert_eq!(job.findings[0].code, "images-without-camera");
    }

    fn job_of_patterns() -> (tempfile::TempDir, ImageJob) {
        job(&["a1.png", "b1.png"], &[("wide", "a*.png")])
    }

    #[test]
    fn what_cannot_be_used_is_told() {
        let (_folder, images) = job(&["1.png", "2.png", "3.png", "4.png", "5.png", "6.png"], &[]);
        let bad = Err(Error::Image { file: "5.png".to_owned(), why: "cut".to_owned() });
        let made = vec![
            seen("a", [64, 48], 6),
            seen("a", [64, 48], 6),
            seen("b", [48, 64], 6),
            seen("c", [64, 48], 0),
            bad,
            seen("d", [64, 48], 6),
        ];
        let job = images.with_detections(made).unwrap();
        assert_eq!(job.dataset.views.len(), 2);
        let codes: Vec<&str> = job.findings.iter().map(|finding| finding.code.as_str()).collect();
        assert_eq!(
            codes,
            ["unreadable-image", "mixed-image-sizes", "target-not-detected", "duplicate-images"]
        );
    }

    #[test]
    fn a_legacy_pattern_is_named() {
        let (_folder, images) = job(&["1.png", "2.png", "3.png"], &[]);
        let legacy = |hash: &str| seen(hash, [64, 48], 6).map(|seen| SeenImage { is_legacy: true, ..seen });
        let job = images.with_detections(vec![seen("a", [64, 48], 0), legacy("b"), legacy("c")]).unwrap();
        let finding = job.findings.iter().find(|finding| finding.code == "legacy-charuco").unwrap();
        assert_eq!((finding.measured, finding.severity), (Some(2.0), Severity::Note));
        assert!(finding.message.contains("legacy pattern") && finding.message.ends_with("2.png, 3.png"));
    }

    #[test]
    fn boards_of_another_size_among_others_are_a_caution() {
        let sized = |image: Result<SeenImage, Error>, size| image.map(|seen| SeenImage { size, ..seen });
        let missed = |hash: &str| {
            let missed = Some("the board has 9x6 inner corners".to_owned());
            let image = seen(hash, [64, 48], 0).map(|seen| SeenImage { missed, ..seen });
            sized(image, SizeSeen::Other([9, 6]))
        };
        let told = |second| {
            let (_folder, images) = job(&["1.png", "2.png", "3.png", "4.png"], &[]);
            let whole = ["c", "d"].map(|hash| sized(seen(hash, [64, 48], 6), SizeSeen::AsDeclared));
            let [third, fourth] = whole;
            let findings = images.with_detections(vec![missed("a"), second, third, fourth]).unwrap().findings;
            findings.into_iter().map(|finding| (finding.code, finding.severity)).collect::<Vec<_>>()
        };
        assert_eq!(told(missed("b")), [("other-board-size".to_owned(), Severity::Caution)]);
        assert_eq!(told(seen("b", [64, 48], 6)), [("target-not-detected".to_owned(), Severity::Note)]);
    }

    #[test]
    fn a_board_of_another_size_is_named() {
        let (_folder, images) = job(&["1.png", "2.png"], &[]);
        let other =
            |n| seen("a", [64, 48], n).map(|seen| SeenImage { size: SizeSeen::Other([9, 6]), ..seen });
        // What was labelled elsewhere is not believed.
        let labelled = seen("b", [64, 48], 6);
        let error = images.with_detections(vec![other(0), labelled]).unwrap_err();
        assert!(error.to_string().contains("in 1 of them the board has 9x6 inner corners"), "{error}");
        assert!(error.hint().unwrap().contains("--target chessboard:9x6:10mm"), "{:?}", error.hint());
        // A row that is covered in one image is no other board.
        let (_folder, images) = job(&["1.png", "2.png"], &[]);
        let short = seen("a", [64, 48], 0).map(|seen| SeenImage { size: SizeSeen::Short([9, 6]), ..seen });
        let error = images.with_detections(vec![short, seen("b", [64, 48], 0)]).unwrap_err();
        assert!(!error.hint().unwrap().contains("9x6"), "{error} {:?}", error.hint());
    }
}
