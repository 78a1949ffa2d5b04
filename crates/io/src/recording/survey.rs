//! What is in recordings, without detecting anything in them.

use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::path::PathBuf;

use boresight_data::{Finding, Severity};

use super::names::{assign_topics, cameras_of_topics};
use super::recording_job::unused_topic;
use super::records::Damage;
use super::synchronise::{CameraPair, period_ns, relate, usual_tolerance_ns};
use super::{Clock, Contents, RecordingOptions, StatedCamera, Topic, read_recordings};
use crate::Error;
use crate::image_names::Listed;

/// What is in recordings.
#[derive(Clone, Debug)]
pub struct Survey {
    /// All topics.
    pub topics: Vec<Topic>,
    /// The topics that hold images, by camera.
    pub images: Vec<ImageTopic>,
    /// How each two cameras are related in time.
    pub pairs: Vec<CameraPair>,
    /// How far apart in time images of different cameras are of one frame, in nanoseconds.
    pub tolerance_ns: i64,
    /// What was noticed.
    pub findings: Vec<Finding>,
}

/// A topic that holds images.
#[derive(Clone, Debug, PartialEq)]
pub struct ImageTopic {
    /// The name of its camera.
    pub camera: String,
    /// Its name.
    pub topic: String,
    /// The number of its messages.
    pub messages: usize,
    /// How its pixels are encoded, each way once.
    pub encodings: Vec<String>,
    /// The sizes that messages state, each once; none for files such as JPEG, which state it inside.
    pub sizes: Vec<[u32; 2]>,
    /// The first and the last time, in nanoseconds; `None` if no message could be read.
    pub span_ns: Option<[i64; 2]>,
    /// The median time from image to image, in nanoseconds.
    pub period_ns: Option<i64>,
    /// What a message of the same camera says of it.
    pub camera_info: Option<StatedCamera>,
}

/// What is gathered of a topic.
#[derive(Default)]
struct Gathered {
    encodings: Vec<String>,
    sizes: Vec<[u32; 2]>,
    stamps_ns: Vec<i64>,
    log_times_ns: Vec<i64>,
    /// How many messages cannot be read, with the first reason.
    unreadable: Option<(usize, String)>,
}

/// Reads recordings from begin to end, without decoding images.
///
/// `cameras` are names with patterns of the names of their topics; topics of none of them are left out. Without any,
/// each topic is a camera.
pub fn survey_recordings(
    files: &[PathBuf],
    options: &RecordingOptions,
    cameras: &[(String, String)],
) -> Result<Survey, Error> {
    let mut gathered: BTreeMap<usize, Gathered> = BTreeMap::new();
    let mut look = |image: super::RecordedImage| {
        let gathered = gathered.entry(image.topic_idx).or_default();
        match image.open() {
            Ok(message) => {
                let encoding = message.pixels.encoding();
                if !gathered.encodings.iter().any(|known| known == encoding) && gathered.encodings.len() < 16
                {
                    gathered.encodings.push(encoding.to_owned());
                }
                let size = message.pixels.stated_size();
                gathered.sizes.extend(size.filter(|size| !gathered.sizes.contains(size)));
                gathered.stamps_ns.push(message.stamp_ns);
                gathered.log_times_ns.push(image.log_time_ns);
            }
            Err(why) => gathered.unreadable.get_or_insert((0, why)).0 += 1,
        }
        ControlFlow::Continue(())
    };
    let contents = read_recordings(files, &|_| true, &mut look)?;
    let mut findings = contents_findings(&contents);
    let mut images = Vec::new();
    let mut times_ns = Vec::new();
    let with_images: Vec<usize> =
        (0..contents.topics.len()).filter(|idx| contents.topics[*idx].is_of_images()).collect();
    let names: Vec<&str> = with_images.iter().map(|idx| contents.topics[*idx].name.as_str()).collect();
    let listed: Vec<Listed> =
        cameras.iter().cloned().map(|(name, images)| Listed { name, images: Some(images) }).collect();
    for (camera, topic_idx) in assign_topics(&names, &listed)?.into_iter().zip(&with_images) {
        let topic = &contents.topics[*topic_idx];
        let Some(camera) = camera else {
            findings.push(unused_topic(&topic.name));
            continue;
        };
        let gathered = gathered.remove(topic_idx).unwrap_or_default();
        if let Some((count, why)) = gathered.unreadable {
            findings.push(Finding {
                code: "unreadable-messages".to_owned(),
                severity: Severity::Caution,
                place: topic.name.clone(),
                message: format!("{count} of its messages cannot be read: {why}"),
                measured: Some(count as f64),
                limit: Some(0.0),
                fix: "record raw or JPEG or PNG images, as ROS or Foxglove define them".to_owned(),
            });
        }
        let by_log = options.clock == Some(Clock::Log) || gathered.stamps_ns.iter().all(|stamp| *stamp == 0);
        let mut times = if by_log { gathered.log_times_ns } else { gathered.stamps_ns };
        times.sort_unstable();
        images.push(ImageTopic {
            camera,
            topic: topic.name.clone(),
            messages: topic.messages,
            encodings: gathered.encodings,
            sizes: gathered.sizes,
            span_ns: times.first().zip(times.last()).map(|(first, last)| [*first, *last]),
            period_ns: period_ns(&times),
            camera_info: camera_info_of(&contents, &topic.name),
        });
        times_ns.push(times);
    }
    let tolerance_ns = options.tolerance_ns.unwrap_or_else(|| usual_tolerance_ns(&times_ns));
    let cameras: Vec<String> = images.iter().map(|image| image.camera.clone()).collect();
    findings.extend(time_findings(&cameras, &times_ns, tolerance_ns));
    let pairs = pairs_of(&cameras, &times_ns, tolerance_ns);
    Ok(Survey { topics: contents.topics, images, pairs, tolerance_ns, findings })
}

/// Returns what a topic beside an image topic says of its camera.
fn camera_info_of(contents: &Contents, image_topic: &str) -> Option<StatedCamera> {
    let infos: Vec<&Topic> = contents.topics.iter().filter(|topic| topic.camera_info.is_some()).collect();
    let names: Vec<&str> =
        std::iter::once(image_topic).chain(infos.iter().map(|topic| topic.name.as_str())).collect();
    let cameras = cameras_of_topics(&names);
    let of_same = infos.iter().zip(&cameras[1..]).find(|(_, camera)| **camera == cameras[0]);
    of_same.and_then(|(topic, _)| topic.camera_info.clone())
}

fn pairs_of(cameras: &[String], times_ns: &[Vec<i64>], tolerance_ns: i64) -> Vec<CameraPair> {
    let mut pairs = Vec::new();
    for second in 0..cameras.len() {
        for first in 0..second {
            let names = [cameras[first].as_str(), cameras[second].as_str()];
            pairs.extend(relate(names, [&times_ns[first], &times_ns[second]], tolerance_ns));
        }
    }
    pairs
}

/// Notes cameras whose images are not of the same instants.
pub(crate) fn time_findings(cameras: &[String], times_ns: &[Vec<i64>], tolerance_ns: i64) -> Vec<Finding> {
    let apart = |pair: CameraPair| {
        if 2 * pair.within >= pair.pairs {
            return None;
        }
        let is_constant = pair.spread_ns <= tolerance_ns;
        let reach = pair.apart_ns.saturating_abs().saturating_add(pair.spread_ns.saturating_mul(3));
        let reach_ms = reach.div_euclid(1_000_000).saturating_add(1);
        let what = if is_constant {
            pair.describe()
        } else {
            let [from, to] = pair.histogram_range_ns.map(|time| time as f64 / 1e6);
            let [first, second] = &pair.cameras;
            format!(
                "{first} and {second} are not synchronised: the one's images are {from:.0} to {to:.0} ms from the other's"
            )
        };
        let tolerance = super::synchronise::milliseconds(tolerance_ns);
        Some(Finding {
            code: "cameras-apart-in-time".to_owned(),
            severity: Severity::Caution,
            place: pair.cameras[1].clone(),
            message: format!(
                "{what}; {} of {} images have a partner within {tolerance} ms",
                pair.within, pair.pairs
            ),
            measured: Some(pair.apart_ns as f64 / 1e6),
            limit: Some(tolerance_ns as f64 / 1e6),
            fix: format!(
                "trigger them together; if they are, and only the stamps differ, or if the board stood still, \
                 --sync-tolerance {reach_ms}ms takes them together"
            ),
        })
    };
    pairs_of(cameras, times_ns, tolerance_ns).into_iter().filter_map(apart).collect()
}

/// Notes where recordings are damaged and what of them is not read.
pub(crate) fn contents_findings(contents: &Contents) -> Vec<Finding> {
    let mut findings = Vec::new();
    let mut note = |code: &str, severity, place: &str, message: String, measured: usize, fix: &str| {
        findings.push(Finding {
            code: code.to_owned(),
            severity,
            place: place.to_owned(),
            message,
            measured: Some(measured as f64),
            limit: Some(0.0),
            fix: fix.to_owned(),
        });
    };
    for (file, _) in &contents.hashes {
        let damages: Vec<&Damage> =
            contents.damages.iter().filter(|(of, _)| of == file).map(|(_, damage)| damage).collect();
        let (cut, spoilt): (Vec<&Damage>, Vec<&Damage>) =
            damages.into_iter().partition(|damage| matches!(damage, Damage::CutOff { .. }));
        if let Some(damage) = cut.first() {
            let fix =
                "what is there was used; copy the file again, or let the recorder end before it is copied";
            note("recording-cut-off", Severity::Caution, file, damage.to_string(), 1, fix);
        }
        if let Some(damage) = spoilt.first() {
            let more = match spoilt.len() {
                1 => String::new(),
                n => format!(" ({n} such places)"),
            };
            let fix = "what can be read was used; copy the file again from its source";
            note("recording-damaged", Severity::Caution, file, format!("{damage}{more}"), spoilt.len(), fix);
        }
        if let Some((_, strays)) = contents.strays.iter().find(|(of, _)| of == file) {
            let message =
                format!("{strays} messages are of channels that nothing describes; they were left out");
            let fix = "copy the file again from its source";
            note("recording-damaged", Severity::Caution, file, message, *strays, fix);
        }
    }
    for topic in contents.topics.iter().filter(|topic| topic.is_unread()) {
        let (what, fix) = if topic.is_video() {
            (
                ": this program was built without the feature h264",
                "build it with `cargo build --release --features h264`, which takes a C++ compiler; or record images",
            )
        } else {
            ("", "record images as ROS 2 (cdr), ROS 1 or Foxglove (protobuf, json) messages")
        };
        let message = format!("images as {} in {} are not read{what}", topic.schema, topic.encoding);
        note("topic-not-read", Severity::Note, &topic.name, message, topic.messages, fix);
    }
    findings
}
