//! Recordings out: images as ROS 2 messages, and anything as JSON with a schema.
//!
//! Messages are packed in chunks by zstd, with checksums, and the summary at the end of the file tells viewers where
//! they are. The same messages give the same bytes.

use std::collections::BTreeMap;
use std::io::{self, Write};
use std::path::Path;

use boresight_data::{GrayImage, GrayPixels};

use mcap::records::MessageHeader;
use mcap::write::NoSeek;
use mcap::{Compression, McapError, WriteOptions, Writer};

use crate::Error;

/// A message that is JSON.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RecordedValue<'a> {
    /// The topic.
    pub topic: &'a str,
    /// The name of the schema.
    pub schema: &'a str,
    /// The JSON schema itself.
    pub schema_text: &'a str,
    /// When, in nanoseconds.
    pub time_ns: i64,
    /// The message.
    pub json: &'a [u8],
}

/// How the chunks of a recording are packed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Packing {
    /// Not at all.
    Stored,
    /// By zstd, fast.
    #[default]
    Zstd,
    /// By LZ4.
    Lz4,
}

/// A chunk is closed when it has more bytes.
const CHUNK_BYTES: u64 = 1 << 22;

/// The definition of `sensor_msgs/msg/Image` as ROS 2 states it in recordings.
const IMAGE_DEFINITION: &str = "std_msgs/Header header\nuint32 height\nuint32 width\nstring encoding\n\
    uint8 is_bigendian\nuint32 step\nuint8[] data\n\
    ================================================================================\n\
    MSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n\
    ================================================================================\n\
    MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n";

/// Writes a recording.
pub struct RecordingWriter<W: Write> {
    file: String,
    writer: Writer<NoSeek<W>>,
    sequence: u32,
}

impl<W: Write> RecordingWriter<W> {
    /// Begins a recording; `file` is named in errors.
    pub fn new(file: &Path, sink: W, packing: Packing) -> Result<Self, Error> {
        let file = file.display().to_string();
        let compression = match packing {
            Packing::Stored => None,
            Packing::Zstd => Some(Compression::Zstd),
            Packing::Lz4 => Some(Compression::Lz4),
        };
        // Threads of the packer would show in its bytes.
        let options = WriteOptions::new()
            .profile("")
            .library(concat!("boresight ", env!("CARGO_PKG_VERSION")))
            .compression(compression)
            .compression_level(1)
            .compression_threads(0)
            .chunk_size(Some(CHUNK_BYTES))
            .disable_seeking(true);
        let writer = options.create(NoSeek::new(sink)).map_err(|error| failed(&file, error))?;
        Ok(Self { file, writer, sequence: 0 })
    }

    /// Appends a grey image as `sensor_msgs/msg/Image`, taken and recorded at these times in nanoseconds.
    pub fn image(
        &mut self,
        topic: &str,
        stamp_ns: i64,
        log_time_ns: i64,
        image: &GrayImage,
    ) -> Result<(), Error> {
        self.cdr(
            topic,
            "sensor_msgs/msg/Image",
            IMAGE_DEFINITION,
            log_time_ns,
            &image_to_cdr(stamp_ns, image),
        )
    }

    /// Appends a JSON message.
    pub fn json(&mut self, value: &RecordedValue<'_>) -> Result<(), Error> {
        let RecordedValue { topic, schema, schema_text, time_ns, json } = *value;
        self.append(topic, [schema, "jsonschema", schema_text], "json", time_ns, json)
    }

    /// Appends a message that is serialised already, with its schema in the language of ROS 2.
    pub fn cdr(
        &mut self,
        topic: &str,
        schema: &str,
        schema_text: &str,
        log_time_ns: i64,
        message: &[u8],
    ) -> Result<(), Error> {
        self.append(topic, [schema, "ros2msg", schema_text], "cdr", log_time_ns, message)
    }

    /// Appends a message in any encoding, with a schema that is only named.
    pub fn message(
        &mut self,
        topic: &str,
        schema: &str,
        encoding: &str,
        log_time_ns: i64,
        message: &[u8],
    ) -> Result<(), Error> {
        self.append(topic, [schema, "", ""], encoding, log_time_ns, message)
    }

    /// Ends the recording, and returns what it was written to.
    pub fn finish(mut self) -> Result<W, Error> {
        self.writer.finish().map_err(|error| failed(&self.file, error))?;
        Ok(self.writer.into_inner().into_inner())
    }

    fn append(
        &mut self,
        topic: &str,
        [schema, schema_encoding, text]: [&str; 3],
        encoding: &str,
        time_ns: i64,
        data: &[u8],
    ) -> Result<(), Error> {
        // A recording knows no times before 1970.
        let time = u64::try_from(time_ns).unwrap_or(0);
        let header =
            |channel_id, sequence| MessageHeader { channel_id, sequence, log_time: time, publish_time: time };
        let sequence = self.sequence;
        self.sequence = sequence.wrapping_add(1);
        // Schemas and channels that are known are found again by the writer.
        let schema_id = self.writer.add_schema(schema, schema_encoding, text.as_bytes());
        schema_id
            .and_then(|schema_id| self.writer.add_channel(schema_id, topic, encoding, &BTreeMap::new()))
            .and_then(|channel_id| self.writer.write_to_known_channel(&header(channel_id, sequence), data))
            .map_err(|error| failed(&self.file, error))
    }
}

fn failed(file: &str, error: McapError) -> Error {
    let source = match error {
        McapError::Io(source) => source,
        other => io::Error::other(other),
    };
    Error::Write { file: file.to_owned(), source }
}

/// Returns an image as CDR, little-endian.
pub(crate) fn image_to_cdr(stamp_ns: i64, image: &GrayImage) -> Vec<u8> {
    let [width, height] = image.size();
    let (encoding, pixel_bytes, data): (&str, u32, Vec<u8>) = match image.pixels() {
        GrayPixels::Eight(values) => ("mono8", 1, values.clone()),
        GrayPixels::Sixteen(values) => {
            ("mono16", 2, values.iter().flat_map(|value| value.to_le_bytes()).collect())
        }
    };
    let mut bytes = vec![0, 1, 0, 0];
    let number = |bytes: &mut Vec<u8>, value: u32| {
        // The header of four bytes does not count, and is a multiple of four.
        bytes.resize(bytes.len().next_multiple_of(4), 0);
        bytes.extend(value.to_le_bytes());
    };
    let text = |bytes: &mut Vec<u8>, text: &str| {
        number(bytes, text.len() as u32 + 1);
        bytes.extend(text.as_bytes());
        bytes.push(0);
    };
    number(&mut bytes, u32::try_from(stamp_ns.div_euclid(1_000_000_000)).unwrap_or(0));
    number(&mut bytes, stamp_ns.rem_euclid(1_000_000_000) as u32);
    text(&mut bytes, "");
    number(&mut bytes, height);
    number(&mut bytes, width);
    text(&mut bytes, encoding);
    bytes.push(0);
    number(&mut bytes, width * pixel_bytes);
    number(&mut bytes, data.len() as u32);
    bytes.extend(data);
    bytes
}
