//! A job whose corners are still in recordings, and the job once points are detected in their images.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::ControlFlow;
use std::path::PathBuf;

use boresight_data::{Finding, Severity, Target};

use super::names::assign_topics;
use super::survey::{contents_findings, time_findings};
use super::synchronise::{Shot, frames_of, usual_tolerance_ns};
use super::video::Videos;
use super::{Contents, EXTENSION, RecordedImage, Topic, read_recordings, read_topics};
use crate::image_job::{Findings, SeenImage, finish};
use crate::image_names::Listed;
use crate::job::{Head, Job, JobOverrides, head_beside, named_inputs};
use crate::robot_input::RobotOverrides;
use crate::seen::SeenView;
use crate::{Error, Place};

/// Which of the times of a message says when its image was taken.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Clock {
    /// The time stamp in the message, which the camera's driver set.
    #[default]
    Header,
    /// When the message was recorded.
    Log,
}

/// How recordings are read.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RecordingOptions {
    /// Which times are believed; `None` takes the job file's, or the messages' own.
    pub clock: Option<Clock>,
    /// How far apart in time images of different cameras are of one frame, in nanoseconds; `None` takes the job file's,
    /// or a quarter of the time from image to image, 15 ms at most.
    pub tolerance_ns: Option<i64>,
}

/// A job whose target is to be detected in the images of recordings.
pub struct RecordingJob {
    files: Vec<PathBuf>,
    head: Head,
    /// The cameras that the job lists, or those that were named with patterns in its place.
    listed: Vec<Listed>,
    robot: RobotOverrides,
    options: RecordingOptions,
}

/// What was seen in an image of a recording.
#[derive(Clone, Debug, PartialEq)]
pub struct SeenRecorded {
    /// Its topic, as an index into [`Contents::topics`].
    pub topic_idx: usize,
    /// How many images of its topic came before it.
    pub index: usize,
    /// When it was recorded, in nanoseconds.
    pub log_time_ns: i64,
    /// When it was taken, as its message says, in nanoseconds, with what was seen; or why it could not be read.
    pub seen: Result<(i64, SeenImage), String>,
}

/// Returns the job of the recordings among `inputs`, or `None` if there are none.
pub fn load_recordings(inputs: &[PathBuf], overrides: &JobOverrides) -> Result<Option<RecordingJob>, Error> {
    let is_recording = |path: &PathBuf| {
        path.extension().is_some_and(|found| found.eq_ignore_ascii_case(EXTENSION)) && !path.is_dir()
    };
    let (mut files, others): (Vec<PathBuf>, Vec<PathBuf>) = inputs.iter().cloned().partition(is_recording);
    if files.is_empty() {
        files = named_inputs(&others)?.recordings;
    }
    let Some(first) = files.first() else { return Ok(None) };
    let head = head_beside("recording", first, &others, overrides)?;
    let (listed, robot) = (head.listed(&overrides.cameras), overrides.robot.clone());
    Ok(Some(RecordingJob { files, head, listed, robot, options: overrides.recording }))
}

impl RecordingJob {
    /// Returns the target that is to be detected.
    pub fn target(&self) -> &Target {
        &self.head.target
    }

    /// Returns the job file's `[options]`, and where they begin.
    pub fn options(&self) -> (&toml::Table, Option<&Place>) {
        (&self.head.job.options, self.head.options_place.as_ref())
    }

    /// Reads the recordings, and hands out the images that are used in the order of the files. Reading ends early if
    /// `deliver` says so.
    ///
    /// Which topics are used is known beforehand where the summaries tell what there is; else images are handed out
    /// that are not used.
    pub fn read(&self, deliver: &mut dyn FnMut(RecordedImage) -> ControlFlow<()>) -> Result<Contents, Error> {
        let unused = |contents: &Contents| -> BTreeSet<usize> {
            let used = cameras_of(contents, &self.listed, &mut Vec::new()).unwrap_or_default();
            let is_idle = |idx: &usize| !used.is_empty() && !used.contains_key(idx);
            (0..contents.topics.len()).filter(is_idle).collect()
        };
        let key = |topic: &Topic| (topic.name.clone(), topic.schema.clone(), topic.encoding.clone());
        let told = read_topics(&self.files)?.unwrap_or_default();
        let skipped: BTreeSet<_> = unused(&told).into_iter().map(|idx| key(&told.topics[idx])).collect();
        let mut flow = ControlFlow::Continue(());
        let mut videos = Videos::default();
        let mut handed = |image| {
            flow = deliver(videos.decoded(image));
            flow
        };
        let contents = read_recordings(&self.files, &|topic| !skipped.contains(&key(topic)), &mut handed)?;
        // Where a file is damaged, nothing may be left of a topic that was to be used, and another takes its place.
        let still_unused = unused(&contents);
        let topics = contents.topics.iter().enumerate();
        let missed: BTreeSet<_> = topics
            .filter(|(idx, topic)| topic.messages > 0 && !still_unused.contains(idx))
            .map(|(_, topic)| key(topic))
            .filter(|key| skipped.contains(key))
            .collect();
        if flow.is_continue() && !missed.is_empty() {
            let mut videos = Videos::default();
            let mut handed = |image| deliver(videos.decoded(image));
            read_recordings(&self.files, &|topic| missed.contains(&key(topic)), &mut handed)?;
        }
        Ok(contents)
    }

    /// Returns the job, with what was seen in each image, in any order.
    ///
    /// What cannot be used becomes a finding. It is an error if there is no image or nothing was detected at all.
    pub fn with_detections(self, contents: Contents, mut seen: Vec<SeenRecorded>) -> Result<Job, Error> {
        let Self { files, mut head, listed, robot, options } = self;
        if image_topics(&contents).is_empty() {
            let file = files.iter().map(|path| path.display().to_string()).collect::<Vec<_>>().join(", ");
            let topic =
                |topic: &super::Topic| format!("{} ({}, {})", topic.name, topic.schema, topic.encoding);
            return Err(Error::NoImageTopic { file, topics: contents.topics.iter().map(topic).collect() });
        }
        let mut findings = Findings { all: contents_findings(&contents), ..Findings::default() };
        let camera_of = cameras_of(&contents, &listed, &mut findings.all)?;

        seen.retain(|seen| camera_of.contains_key(&seen.topic_idx));
        seen.sort_by_key(|seen| (seen.topic_idx, seen.index));
        note_unreadable(&contents, &seen, &mut findings.all);
        let clock = options.clock.or(head.job.clock).unwrap_or_default();
        let n_images = seen.len();
        let mut shots = timed_shots(seen, &camera_of, clock, &mut findings.all);

        // Cameras count in the order of their names, and images in that of time.
        let mut camera_names: Vec<String> = camera_of.values().cloned().collect();
        camera_names.sort_by(|a, b| crate::assemble::natural_order(a, b));
        camera_names.dedup();
        let camera_id = |name: &str| camera_names.iter().position(|known| known == name).unwrap_or(0);
        shots.sort_by(|a, b| {
            (a.time_ns, camera_id(&a.camera), a.index).cmp(&(b.time_ns, camera_id(&b.camera), b.index))
        });
        drop_repeated(&mut shots, &mut findings.all);

        let mut times_ns: Vec<Vec<i64>> = vec![Vec::new(); camera_names.len()];
        for shot in &shots {
            times_ns[camera_id(&shot.camera)].push(shot.time_ns);
        }
        let usual = usual_tolerance_ns(&times_ns);
        let tolerance_ns = options.tolerance_ns.or(head.job.tolerance_ns).unwrap_or(usual);
        findings.all.extend(time_findings(&camera_names, &times_ns, tolerance_ns));
        let plain: Vec<Shot> = shots
            .iter()
            .map(|shot| Shot { camera: camera_id(&shot.camera), time_ns: shot.time_ns })
            .collect();
        let frames = frames_of(&plain, tolerance_ns);
        let frame_names = name_frames(&plain, &frames);

        head.hashes.extend(contents.hashes.iter().cloned());
        let images: Vec<String> = shots.iter().map(Timed::image_name).collect();
        let mut first_of: BTreeMap<(String, String), usize> = BTreeMap::new();
        let mut views = Vec::with_capacity(shots.len());
        let mut frame_times: BTreeMap<String, i64> = BTreeMap::new();
        for (i, (shot, frame)) in shots.into_iter().zip(&frames).enumerate() {
            let name = &frame_names[*frame];
            frame_times.entry(name.clone()).or_insert(shot.time_ns);
            // A camera that hands out the same image again has seen nothing new.
            let first = *first_of.entry((shot.camera.clone(), shot.seen.hash.clone())).or_insert(i);
            if first != i {
                findings.copies.push((&images[i], &images[first]));
                continue;
            }
            let view = SeenView {
                camera: Some(shot.camera),
                frame: Some(name.clone()),
                image: Some(images[i].clone()),
                line: 1,
                observations: Vec::new(),
            };
            views.push((shot.seen, view));
        }
        let cameras: Vec<Listed> =
            camera_names.into_iter().map(|name| Listed { name, images: None }).collect();
        let mut job = finish(head, &robot, &cameras, n_images, views, findings)?;
        for frame in job.dataset.frames.iter_mut() {
            frame.time_ns = frame_times.get(&frame.name).copied();
        }
        Ok(job)
    }
}

/// Returns the topics that hold images.
fn image_topics(contents: &Contents) -> Vec<usize> {
    let is_one = |idx: &usize| contents.topics[*idx].is_of_images() && contents.topics[*idx].messages > 0;
    (0..contents.topics.len()).filter(is_one).collect()
}

/// Returns the camera of each topic that is used, and notes the others.
fn cameras_of(
    contents: &Contents,
    listed: &[Listed],
    findings: &mut Vec<Finding>,
) -> Result<BTreeMap<usize, String>, Error> {
    let image_topics = image_topics(contents);
    let names: Vec<&str> = image_topics.iter().map(|idx| contents.topics[*idx].name.as_str()).collect();
    let mut camera_of: BTreeMap<usize, String> = BTreeMap::new();
    for (topic_idx, camera) in image_topics.iter().zip(assign_topics(&names, listed)?) {
        match camera {
            None => findings.push(unused_topic(&contents.topics[*topic_idx].name)),
            Some(camera) => {
                camera_of.insert(*topic_idx, camera);
            }
        }
    }
    one_topic_per_camera(contents, &mut camera_of, findings);
    Ok(camera_of)
}

/// An image with the time that is believed.
struct Timed {
    camera: String,
    topic: usize,
    index: usize,
    time_ns: i64,
    seen: SeenImage,
}

impl Timed {
    fn image_name(&self) -> String {
        format!("{}[{}]", self.camera, self.index)
    }
}

/// Returns images with their times, and notes topics without time stamps, whose times of recording are taken.
fn timed_shots(
    seen: Vec<SeenRecorded>,
    camera_of: &BTreeMap<usize, String>,
    clock: Clock,
    findings: &mut Vec<Finding>,
) -> Vec<Timed> {
    let mut stamped: BTreeMap<usize, (usize, usize)> = BTreeMap::new();
    for seen in &seen {
        if let Ok((stamp_ns, _)) = &seen.seen {
            let counts = stamped.entry(seen.topic_idx).or_default();
            counts.0 += usize::from(*stamp_ns != 0);
            counts.1 += 1;
        }
    }
    let is_unstamped = |topic_idx: usize| stamped.get(&topic_idx).is_some_and(|(with, _)| *with == 0);
    if clock == Clock::Header {
        for (topic_idx, (_, messages)) in stamped.iter().filter(|(idx, _)| is_unstamped(**idx)) {
            findings.push(Finding {
                code: "no-time-stamps".to_owned(),
                severity: Severity::Caution,
                place: camera_of.get(topic_idx).cloned().unwrap_or_default(),
                message: "its messages have no time stamps; the times of recording were taken".to_owned(),
                measured: Some(*messages as f64),
                limit: Some(0.0),
                fix: "let the camera's driver set header.stamp: times of recording vary with the load"
                    .to_owned(),
            });
        }
    }
    let timed = |shot: SeenRecorded| {
        let (stamp_ns, seen) = shot.seen.ok()?;
        let by_log = clock == Clock::Log || is_unstamped(shot.topic_idx);
        let time_ns = if by_log { shot.log_time_ns } else { stamp_ns };
        let camera = camera_of.get(&shot.topic_idx)?.clone();
        Some(Timed { camera, topic: shot.topic_idx, index: shot.index, time_ns, seen })
    };
    seen.into_iter().filter_map(timed).collect()
}

/// Leaves out images of a camera at a time at which it has another already, and notes them.
fn drop_repeated(shots: &mut Vec<Timed>, findings: &mut Vec<Finding>) {
    let mut repeated: BTreeMap<String, usize> = BTreeMap::new();
    shots.dedup_by(|later, earlier| {
        let is_repeated = later.time_ns == earlier.time_ns
            && later.camera == earlier.camera
            && later.topic == earlier.topic;
        if is_repeated {
            *repeated.entry(later.camera.clone()).or_default() += 1;
        }
        is_repeated
    });
    for (camera, count) in repeated {
        findings.push(Finding {
            code: "repeated-time-stamps".to_owned(),
            severity: Severity::Caution,
            message: format!("{count} of its images have the time stamp of another; they were left out"),
            place: camera,
            measured: Some(count as f64),
            limit: Some(0.0),
            fix: "set the time stamp of each image when it is taken, or take the times of recording"
                .to_owned(),
        });
    }
}

pub(crate) fn unused_topic(topic: &str) -> Finding {
    Finding {
        code: "topic-without-camera".to_owned(),
        severity: Severity::Note,
        place: topic.to_owned(),
        message: "it is of no camera that the job lists and was left out".to_owned(),
        measured: None,
        limit: None,
        fix: "add a [[camera]] with its name, or with images = \"TOPIC\"".to_owned(),
    }
}

/// Keeps one topic of each camera: the raw images before compressed ones and these before video, and notes the others.
///
/// Topics of one name are of one camera, such as those of several recordings.
fn one_topic_per_camera(
    contents: &Contents,
    camera_of: &mut BTreeMap<usize, String>,
    findings: &mut Vec<Finding>,
) {
    let mut chosen: BTreeMap<String, usize> = BTreeMap::new();
    let rank = |idx: usize| {
        let topic = &contents.topics[idx];
        let kinds = ["CompressedImage", "CompressedVideo"];
        let lossy = kinds.iter().position(|kind| topic.schema.ends_with(kind)).map_or(0, |place| place + 1);
        (lossy, topic.name.len(), topic.name.clone())
    };
    for (idx, camera) in camera_of.iter() {
        let best = chosen.entry(camera.clone()).or_insert(*idx);
        if rank(*idx) < rank(*best) {
            *best = *idx;
        }
    }
    let is_kept = |idx: usize, camera: &str| {
        chosen.get(camera).is_some_and(|best| contents.topics[*best].name == contents.topics[idx].name)
    };
    for (idx, camera) in camera_of.iter().filter(|(idx, camera)| !is_kept(**idx, camera)) {
        let kept = chosen.get(camera).map_or("", |best| contents.topics[*best].name.as_str());
        findings.push(Finding {
            code: "camera-recorded-twice".to_owned(),
            severity: Severity::Note,
            place: contents.topics[*idx].name.clone(),
            message: format!("it is of camera {camera} like {kept}, which is used instead"),
            measured: None,
            limit: None,
            fix: "if it is another camera, name both: --camera NAME=TOPIC".to_owned(),
        });
    }
    camera_of.retain(|idx, camera| is_kept(*idx, camera));
}

/// Notes, by topic and reason, how many messages could not be read.
fn note_unreadable(contents: &Contents, seen: &[SeenRecorded], findings: &mut Vec<Finding>) {
    let mut reasons: BTreeMap<(usize, &str), (usize, usize)> = BTreeMap::new();
    for seen in seen {
        if let Err(why) = &seen.seen {
            reasons.entry((seen.topic_idx, why)).or_insert((0, seen.index)).0 += 1;
        }
    }
    let mut by_topic: BTreeMap<usize, Vec<(&str, usize, usize)>> = BTreeMap::new();
    for ((topic_idx, why), (count, first)) in reasons {
        by_topic.entry(topic_idx).or_default().push((why, count, first));
    }
    for (topic_idx, mut reasons) in by_topic {
        reasons.sort_by_key(|(_, count, first)| (std::cmp::Reverse(*count), *first));
        let total: usize = reasons.iter().map(|(_, count, _)| count).sum();
        let Some((why, count, first)) = reasons.first() else { continue };
        let of = if reasons.len() > 1 { format!("; of {count} of them") } else { ":".to_owned() };
        findings.push(Finding {
            code: "unreadable-messages".to_owned(),
            severity: Severity::Caution,
            place: contents.topics[topic_idx].name.clone(),
            message: format!(
                "{total} of its messages cannot be read{of} {why} (the first is message {first})"
            ),
            measured: Some(total as f64),
            limit: Some(0.0),
            fix: "record raw or JPEG or PNG images, as ROS or Foxglove define them".to_owned(),
        });
    }
}

/// Returns the name of each frame: its time since the first in seconds, with as few decimals as tell frames apart.
fn name_frames(shots: &[Shot], frames: &[usize]) -> Vec<String> {
    let Some(begin_ns) = shots.first().map(|shot| shot.time_ns) else { return Vec::new() };
    let mut times = Vec::new();
    for (shot, frame) in shots.iter().zip(frames) {
        if times.len() == *frame {
            times.push(i128::from(shot.time_ns) - i128::from(begin_ns));
        }
    }
    let named = |decimals: usize| -> Vec<String> {
        let unit = 10_i128.pow(9 - decimals as u32);
        let name = |time: &i128| {
            let ticks = time / unit;
            let per_second = 10_i128.pow(decimals as u32);
            format!("{}.{:0decimals$}", ticks / per_second, ticks % per_second)
        };
        times.iter().map(name).collect()
    };
    // The times are in order, so equal names are neighbours. Two frames may have the same time to the nanosecond.
    let are_distinct = |names: &[String]| names.windows(2).all(|pair| pair[0] != pair[1]);
    for decimals in [3, 6, 9] {
        let names = named(decimals);
        if are_distinct(&names) {
            return names;
        }
    }
    named(9).into_iter().enumerate().map(|(i, name)| format!("{name}-{i}")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_named_by_time() {
        let shots = |times: &[i64]| -> Vec<Shot> {
            times.iter().map(|time_ns| Shot { camera: 0, time_ns: *time_ns }).collect()
        };
        let second = 1_000_000_000;
        let names = name_frames(&shots(&[5 * second, 5 * second + 1, 15 * second + second / 4]), &[0, 0, 1]);
        assert_eq!(names, ["0.000", "10.250"]);
        let names = name_frames(&shots(&[0, 1_000, 2_000_000]), &[0, 1, 2]);
        assert_eq!(names, ["0.000000", "0.000001", "0.002000"]);
        assert_eq!(name_frames(&shots(&[7, 7]), &[0, 1]), ["0.000000000-0", "0.000000000-1"]);
        assert_eq!(name_frames(&shots(&[i64::MIN, i64::MAX]), &[0, 1])[1], "18446744073.709");
        assert!(name_frames(&[], &[]).is_empty());
    }
}
