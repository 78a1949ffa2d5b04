//! MCAP recordings: which topics there are, and the images of those that hold images, one at a time.
//!
//! Images of ROS 2 (CDR), ROS 1 and Foxglove (protobuf, JSON, CDR) are read, raw and compressed, and video with the feature
//! `h264`. Each image topic is a camera. What is damaged is left out and told.

mod cdr;
mod message;
mod names;
mod protobuf;
mod raw_image;
mod recording_job;
mod records;
mod survey;
mod synchronise;
#[cfg(test)]
mod tests;
mod video;
mod write;

use std::collections::BTreeMap;
use std::fs::File;
use std::io::Read as _;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

use boresight_data::{GrayImage, GrayPixels};

pub use message::StatedCamera;
pub use recording_job::{Clock, RecordingJob, RecordingOptions, SeenRecorded, load_recordings};
pub use survey::{ImageTopic, Survey, survey_recordings};
pub use synchronise::CameraPair;
#[cfg(test)]
pub(crate) use write::image_to_cdr;
pub use write::{Packing, RecordedValue, RecordingWriter};

use crate::{Error, Place};
use message::{Content, Kind, Pixels, read_camera_info, read_image_message};
use records::{ChannelRecord, Damage, Listener, MAGIC, read_counts, read_records};

/// The ending of the name of a recording.
pub(crate) const EXTENSION: &str = "mcap";

/// An image of a recording as it was recorded, not yet decoded unless it is a frame of a video.
#[derive(Clone, Debug)]
pub struct RecordedImage {
    /// Its topic, as an index into [`Contents::topics`].
    pub topic_idx: usize,
    /// How many images of its topic came before it.
    pub index: usize,
    /// When it was recorded, in nanoseconds.
    pub log_time_ns: i64,
    held: Held,
}

/// What is there of an image.
#[derive(Clone, Debug)]
enum Held {
    Message {
        kind: Kind,
        bytes: Vec<u8>,
    },
    Frame {
        stamp_ns: i64,
        image: GrayImage,
    },
    /// Nothing, and why.
    Lost(String),
}

/// The message of an image, read once: its pixels are where they were.
#[derive(Clone, Debug)]
pub struct OpenedImage<'a> {
    /// When it was taken, as its message says, in nanoseconds.
    pub stamp_ns: i64,
    pixels: Pixels<'a>,
}

impl RecordedImage {
    /// Returns how many bytes it holds.
    pub fn bytes(&self) -> usize {
        match &self.held {
            Held::Message { bytes, .. } => bytes.len(),
            Held::Frame { image, .. } => match image.pixels() {
                GrayPixels::Eight(values) => values.len(),
                GrayPixels::Sixteen(values) => 2 * values.len(),
            },
            Held::Lost(why) => why.len(),
        }
    }

    /// Reads its message, or returns why it cannot be read.
    pub fn open(&self) -> Result<OpenedImage<'_>, String> {
        match &self.held {
            Held::Message { kind, bytes } => {
                let message = read_image_message(*kind, bytes).map_err(|error| error.to_string())?;
                Ok(OpenedImage { stamp_ns: message.stamp_ns, pixels: message.pixels })
            }
            Held::Frame { stamp_ns, image } => {
                Ok(OpenedImage { stamp_ns: *stamp_ns, pixels: Pixels::Decoded(image) })
            }
            Held::Lost(why) => Err(why.clone()),
        }
    }
}

impl OpenedImage<'_> {
    /// Returns the hash of all that decides its grey values, in hexadecimal.
    pub fn hash(&self) -> String {
        self.pixels.hash()
    }

    /// Returns its grey values, or why they cannot be had.
    pub fn decode(&self) -> Result<GrayImage, String> {
        self.pixels.decode().map_err(|error| error.to_string())
    }
}

/// A topic of a recording.
#[derive(Clone, Debug, PartialEq)]
pub struct Topic {
    /// Its name.
    pub name: String,
    /// The name of its messages' schema.
    pub schema: String,
    /// How its messages are written, such as `cdr`.
    pub encoding: String,
    /// The number of its messages.
    pub messages: usize,
    /// The camera that its last message describes, where it is of such a kind.
    pub camera_info: Option<StatedCamera>,
    kind: Option<Kind>,
}

impl Topic {
    /// Tells whether its messages are images that are read.
    pub fn is_of_images(&self) -> bool {
        self.kind.is_some_and(|kind| kind.is_read() && kind.content != Content::CameraInfo)
    }

    /// Tells whether its messages are video, and written in a way that would be read with the feature `h264`.
    pub(crate) fn is_video(&self) -> bool {
        self.kind.is_some_and(|kind| kind.is_video())
    }

    /// Tells whether its messages are images or video that are not read.
    pub fn is_unread(&self) -> bool {
        self.kind.is_some_and(|kind| !kind.is_read() && kind.content != Content::CameraInfo)
    }
}

/// What recordings hold besides images.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Contents {
    /// The topics, in the order in which they were first heard of.
    pub topics: Vec<Topic>,
    /// Each file as it was named, with the blake3 hash of its bytes in hexadecimal.
    pub hashes: Vec<(String, String)>,
    /// Where each file is damaged.
    damages: Vec<(String, Damage)>,
    /// How many messages were of a channel that no record describes, by file.
    strays: Vec<(String, usize)>,
}

/// Returns the topics of recordings with the numbers of their messages as the files' summaries tell, without reading
/// any; `None` if the summary of one does not.
pub(crate) fn read_topics(files: &[PathBuf]) -> Result<Option<Contents>, Error> {
    let mut contents = Contents::default();
    let mut topics = BTreeMap::new();
    for path in files {
        check_begin(path)?;
        let wrong = |source| Error::Read { file: path.display().to_string(), source };
        let mut deliver = |_| ControlFlow::Break(());
        let mut gatherer = Gatherer::new(&mut contents, &mut topics, &|_| false, &mut deliver);
        let opened = File::open(path).map_err(wrong)?;
        let Some(counts) = read_counts(opened, &mut gatherer).map_err(wrong)? else { return Ok(None) };
        let channels = gatherer.channels;
        for (channel, count) in counts {
            let Some((topic_idx, _)) = channels.get(&channel) else { return Ok(None) };
            contents.topics[*topic_idx].messages += usize::try_from(count).unwrap_or(usize::MAX);
        }
    }
    Ok(Some(contents))
}

/// Reads recordings one after the other, and hands out the images of topics that are wanted in the order of the files.
///
/// Reading ends early if `deliver` says so.
pub(crate) fn read_recordings(
    files: &[PathBuf],
    is_wanted: &dyn Fn(&Topic) -> bool,
    deliver: &mut dyn FnMut(RecordedImage) -> ControlFlow<()>,
) -> Result<Contents, Error> {
    let mut contents = Contents::default();
    let mut topics = BTreeMap::new();
    for path in files {
        let file = path.display().to_string();
        let wrong = |source| Error::Read { file: file.clone(), source };
        check_begin(path)?;
        let opened = File::open(path).map_err(wrong)?;
        // The hash is of every byte, damaged or not, which reading skips over.
        let hash = std::thread::scope(|scope| {
            let hash = scope.spawn(|| hash_of_file(path));
            let mut gatherer = Gatherer::new(&mut contents, &mut topics, is_wanted, deliver);
            let damages = read_records(opened, &mut gatherer).map_err(wrong)?;
            let strays = gatherer.strays;
            contents.damages.extend(damages.into_iter().map(|damage| (file.clone(), damage)));
            if strays > 0 {
                contents.strays.push((file.clone(), strays));
            }
            match hash.join() {
                Ok(hash) => hash.map_err(wrong),
                Err(panic) => std::panic::resume_unwind(panic),
            }
        })?;
        contents.hashes.push((file, hash));
    }
    Ok(contents)
}

/// Reads the bytes of a recording, and hands out its images.
#[cfg(any(test, feature = "fuzzing"))]
pub(crate) fn read_recording_bytes<R: std::io::Read + std::io::Seek>(
    source: R,
    deliver: &mut dyn FnMut(RecordedImage) -> ControlFlow<()>,
) -> std::io::Result<Contents> {
    let (mut contents, mut topics) = (Contents::default(), BTreeMap::new());
    let mut gatherer = Gatherer::new(&mut contents, &mut topics, &|_| true, deliver);
    read_records(source, &mut gatherer)?;
    Ok(contents)
}

/// Reads bytes as a message of one of the kinds that are read.
#[cfg(any(test, feature = "fuzzing"))]
pub(crate) fn read_any_message(kind: u8, bytes: &[u8]) {
    let kinds = [
        ("sensor_msgs/msg/Image", "cdr"),
        ("sensor_msgs/msg/CompressedImage", "cdr"),
        ("sensor_msgs/msg/CameraInfo", "cdr"),
        ("sensor_msgs/Image", "ros1"),
        ("sensor_msgs/CameraInfo", "ros1"),
        ("foxglove.RawImage", "protobuf"),
        ("foxglove.CompressedImage", "protobuf"),
        ("foxglove.CameraCalibration", "protobuf"),
        ("foxglove.RawImage", "json"),
        ("foxglove.CompressedImage", "json"),
        ("foxglove.CameraCalibration", "json"),
        ("foxglove_msgs/msg/RawImage", "cdr"),
        ("foxglove.CompressedVideo", "protobuf"),
    ];
    let (schema, encoding) = kinds[usize::from(kind) % kinds.len()];
    if let Some(kind) = Kind::of_channel(schema, encoding) {
        let _ = read_camera_info(kind, bytes);
        let _ = read_image_message(kind, bytes).map(|message| message.pixels.decode());
    }
}

fn hash_of_file(path: &Path) -> std::io::Result<String> {
    let mut hasher = blake3::Hasher::new();
    hasher.update_reader(File::open(path)?)?;
    Ok(hasher.finalize().to_hex().to_string())
}

/// Says what a file is that does not begin as a recording does.
fn check_begin(path: &Path) -> Result<(), Error> {
    let file = path.display().to_string();
    let mut begin = Vec::new();
    let read = File::open(path).and_then(|opened| opened.take(16).read_to_end(&mut begin));
    read.map_err(|source| Error::Read { file: file.clone(), source })?;
    if begin.is_empty() {
        return Err(Error::Empty { file });
    }
    if begin.starts_with(&MAGIC) {
        return Ok(());
    }
    let (found, need) = if begin.starts_with(b"#ROSBAG") {
        ("it is a ROS 1 bag", "MCAP recordings are read: `mcap convert in.bag out.mcap` makes one of it")
    } else if begin.starts_with(b"SQLite format 3") {
        ("it is a ROS 2 bag in SQLite", "MCAP recordings are read: `ros2 bag convert` makes one of it")
    } else {
        ("it does not begin as an MCAP recording does", "was it copied whole, and is it one?")
    };
    Err(Error::Malformed { place: Place::file(file), found: found.to_owned(), need })
}

/// Sorts messages by their topics.
struct Gatherer<'a> {
    contents: &'a mut Contents,
    /// The topics by name, schema and encoding.
    topics: &'a mut BTreeMap<(String, String, String), usize>,
    /// The names of this file's schemas.
    schemas: BTreeMap<u16, String>,
    /// The topics of this file's channels, and whether their messages are read.
    channels: BTreeMap<u16, (usize, bool)>,
    strays: usize,
    /// Whether the images of a topic are wanted.
    is_wanted: &'a dyn Fn(&Topic) -> bool,
    deliver: &'a mut dyn FnMut(RecordedImage) -> ControlFlow<()>,
}

impl<'a> Gatherer<'a> {
    /// Returns what sorts the messages of a file into `contents`.
    fn new(
        contents: &'a mut Contents,
        topics: &'a mut BTreeMap<(String, String, String), usize>,
        is_wanted: &'a dyn Fn(&Topic) -> bool,
        deliver: &'a mut dyn FnMut(RecordedImage) -> ControlFlow<()>,
    ) -> Self {
        let (schemas, channels) = (BTreeMap::new(), BTreeMap::new());
        Self { contents, topics, schemas, channels, strays: 0, is_wanted, deliver }
    }
}

impl Listener for Gatherer<'_> {
    fn schema(&mut self, id: u16, name: String) {
        self.schemas.insert(id, name);
    }

    fn channel(&mut self, channel: ChannelRecord) {
        let schema = self.schemas.get(&channel.schema_id).cloned().unwrap_or_default();
        let key = (channel.topic.clone(), schema.clone(), channel.message_encoding.clone());
        let topics = &mut self.contents.topics;
        let topic_idx = *self.topics.entry(key).or_insert_with(|| {
            topics.push(Topic {
                kind: Kind::of_channel(&schema, &channel.message_encoding),
                name: channel.topic,
                schema,
                encoding: channel.message_encoding,
                messages: 0,
                camera_info: None,
            });
            topics.len() - 1
        });
        let topic = &self.contents.topics[topic_idx];
        let is_read =
            topic.kind.is_some_and(Kind::is_read) && (!topic.is_of_images() || (self.is_wanted)(topic));
        self.channels.insert(channel.id, (topic_idx, is_read));
    }

    fn wants(&mut self, channel_id: u16) -> bool {
        let Some(&(topic_idx, is_read)) = self.channels.get(&channel_id) else {
            self.strays += 1;
            return false;
        };
        self.contents.topics[topic_idx].messages += 1;
        is_read
    }

    fn message(&mut self, channel_id: u16, log_time_ns: u64, data: Vec<u8>) -> ControlFlow<()> {
        let Some(&(topic_idx, _)) = self.channels.get(&channel_id) else { return ControlFlow::Continue(()) };
        let topic = &mut self.contents.topics[topic_idx];
        let Some(kind) = topic.kind else { return ControlFlow::Continue(()) };
        if kind.content == Content::CameraInfo {
            // One that cannot be read is no loss: nothing is calibrated from it.
            if let Ok(info) = read_camera_info(kind, &data) {
                topic.camera_info = Some(info);
            }
            return ControlFlow::Continue(());
        }
        let log_time_ns = i64::try_from(log_time_ns).unwrap_or(i64::MAX);
        // Messages are counted before they are read, so that one that is too large leaves its place.
        let index = topic.messages - 1;
        (self.deliver)(RecordedImage {
            topic_idx,
            index,
            log_time_ns,
            held: Held::Message { kind, bytes: data },
        })
    }
}
