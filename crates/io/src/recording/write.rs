//! Recordings out: images as ROS 2 messages, and anything as JSON with a schema.
//!
//! Messages are packed in chunks by zstd, with checksums, and the summary at the end of the file tells viewers where
//! they are. The same messages give the same bytes.

use std::collections::BTreeMap;
use std::io::{self, Write};
use std::path::Path;

use boresight_data::{GrayImage, GrayPixels};

use super::lz4_frame::lz4_frame;
use super::records::{MAGIC, kind};
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

/// A chunk is closed when it has this many bytes.
const CHUNK_BYTES: usize = 1 << 22;

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
    sink: Counted<W>,
    packing: Packing,
    /// The records that describe schemas and channels, which the summary repeats.
    descriptions: Vec<u8>,
    schemas: BTreeMap<String, u16>,
    channels: BTreeMap<String, u16>,
    /// The number of messages of each channel.
    counts: BTreeMap<u16, u64>,
    chunk: OpenChunk,
    chunks: Vec<ChunkIndex>,
    sequence: u32,
    span_ns: Option<[u64; 2]>,
}

/// The records of the chunk that is not yet written.
#[derive(Default)]
struct OpenChunk {
    records: Vec<u8>,
    span_ns: Option<[u64; 2]>,
    /// Time and place of each message, by channel.
    messages: BTreeMap<u16, Vec<(u64, u64)>>,
}

/// Where a chunk is.
struct ChunkIndex {
    span_ns: [u64; 2],
    begin: u64,
    bytes: u64,
    message_indexes: Vec<(u16, u64)>,
    message_index_bytes: u64,
    packed_bytes: u64,
    unpacked_bytes: u64,
}

impl<W: Write> RecordingWriter<W> {
    /// Begins a recording; `file` is named in errors.
    pub fn new(file: &Path, sink: W, packing: Packing) -> Result<Self, Error> {
        let file = file.display().to_string();
        let mut sink = Counted { sink, bytes: 0 };
        let mut header = Record::new(kind::HEADER);
        header.text("").text(concat!("boresight ", env!("CARGO_PKG_VERSION")));
        let begun = sink.write_all(&MAGIC).and_then(|()| sink.write_all(&header.finish()));
        begun.map_err(|source| Error::Write { file: file.clone(), source })?;
        Ok(Self {
            file,
            sink,
            packing,
            descriptions: Vec::new(),
            schemas: BTreeMap::new(),
            channels: BTreeMap::new(),
            counts: BTreeMap::new(),
            chunk: OpenChunk::default(),
            chunks: Vec::new(),
            sequence: 0,
            span_ns: None,
        })
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
        let channel = self.channel(topic, [schema, "jsonschema", schema_text], "json");
        self.append(channel, time_ns, json)
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
        let channel = self.channel(topic, [schema, "ros2msg", schema_text], "cdr");
        self.append(channel, log_time_ns, message)
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
        let channel = self.channel(topic, [schema, "", ""], encoding);
        self.append(channel, log_time_ns, message)
    }

    /// Ends the recording, and returns what it was written to.
    pub fn finish(mut self) -> Result<W, Error> {
        let ended = self.close_chunk().and_then(|()| self.write_summary());
        ended.map_err(|source| Error::Write { file: self.file, source })?;
        Ok(self.sink.sink)
    }

    fn channel(&mut self, topic: &str, [schema, schema_encoding, text]: [&str; 3], encoding: &str) -> u16 {
        if let Some(id) = self.channels.get(topic) {
            return *id;
        }
        let mut described = Vec::new();
        let schema_id = match self.schemas.get(schema) {
            Some(id) => *id,
            None => {
                // Zero is no schema.
                let id = self.schemas.len() as u16 + 1;
                let mut record = Record::new(kind::SCHEMA);
                record
                    .u16(id)
                    .text(schema)
                    .text(schema_encoding)
                    .u32(text.len() as u32)
                    .bytes(text.as_bytes());
                described.extend(record.finish());
                self.schemas.insert(schema.to_owned(), id);
                id
            }
        };
        let id = self.channels.len() as u16;
        let mut record = Record::new(kind::CHANNEL);
        record.u16(id).u16(schema_id).text(topic).text(encoding).u32(0);
        described.extend(record.finish());
        self.channels.insert(topic.to_owned(), id);
        self.chunk.records.extend_from_slice(&described);
        self.descriptions.extend(described);
        id
    }

    fn append(&mut self, channel: u16, time_ns: i64, data: &[u8]) -> Result<(), Error> {
        // A recording knows no times before 1970.
        let time = u64::try_from(time_ns).unwrap_or(0);
        let widened = |span: Option<[u64; 2]>| span.map_or([time; 2], |[a, b]| [a.min(time), b.max(time)]);
        self.span_ns = Some(widened(self.span_ns));
        self.chunk.span_ns = Some(widened(self.chunk.span_ns));
        let place = self.chunk.records.len() as u64;
        self.chunk.messages.entry(channel).or_default().push((time, place));
        let mut record = Record::new(kind::MESSAGE);
        record.u16(channel).u32(self.sequence).u64(time).u64(time).bytes(data);
        self.chunk.records.extend(record.finish());
        self.sequence = self.sequence.wrapping_add(1);
        *self.counts.entry(channel).or_default() += 1;
        if self.chunk.records.len() >= CHUNK_BYTES {
            self.close_chunk().map_err(|source| Error::Write { file: self.file.clone(), source })?;
        }
        Ok(())
    }

    fn close_chunk(&mut self) -> io::Result<()> {
        let OpenChunk { records, span_ns, messages } = std::mem::take(&mut self.chunk);
        if records.is_empty() {
            return Ok(());
        }
        let (name, packed) = match self.packing {
            Packing::Stored => ("", records.clone()),
            Packing::Zstd => ("zstd", zstd::bulk::compress(&records, 1)?),
            Packing::Lz4 => ("lz4", lz4_frame(&records)?),
        };
        let span_ns = span_ns.unwrap_or_default();
        let mut record = Record::new(kind::CHUNK);
        record.u64(span_ns[0]).u64(span_ns[1]).u64(records.len() as u64).u32(crc32fast::hash(&records));
        record.text(name).u64(packed.len() as u64).bytes(&packed);
        let record = record.finish();
        let begin = self.sink.bytes;
        self.sink.write_all(&record)?;
        let indexes_begin = self.sink.bytes;
        let mut message_indexes = Vec::new();
        for (channel, entries) in &messages {
            message_indexes.push((*channel, self.sink.bytes));
            let mut index = Record::new(kind::MESSAGE_INDEX);
            index.u16(*channel).u32(entries.len() as u32 * 16);
            for (time, place) in entries {
                index.u64(*time).u64(*place);
            }
            self.sink.write_all(&index.finish())?;
        }
        self.chunks.push(ChunkIndex {
            span_ns,
            begin,
            bytes: record.len() as u64,
            message_indexes,
            message_index_bytes: self.sink.bytes - indexes_begin,
            packed_bytes: packed.len() as u64,
            unpacked_bytes: records.len() as u64,
        });
        Ok(())
    }

    fn write_summary(&mut self) -> io::Result<()> {
        // A checksum of zero is none: that of the data would cost a pass over every byte.
        let mut end = Record::new(kind::DATA_END);
        end.u32(0);
        self.sink.write_all(&end.finish())?;
        let begin = self.sink.bytes;
        let mut summary = self.descriptions.clone();
        let span_ns = self.span_ns.unwrap_or_default();
        let mut statistics = Record::new(kind::STATISTICS);
        statistics
            .u64(self.counts.values().sum())
            .u16(self.schemas.len() as u16)
            .u32(self.channels.len() as u32);
        statistics.u32(0).u32(0).u32(self.chunks.len() as u32).u64(span_ns[0]).u64(span_ns[1]);
        statistics.u32(self.counts.len() as u32 * 10);
        for (channel, count) in &self.counts {
            statistics.u16(*channel).u64(*count);
        }
        summary.extend(statistics.finish());
        let name = match self.packing {
            Packing::Stored => "",
            Packing::Zstd => "zstd",
            Packing::Lz4 => "lz4",
        };
        for chunk in &self.chunks {
            let mut index = Record::new(kind::CHUNK_INDEX);
            index.u64(chunk.span_ns[0]).u64(chunk.span_ns[1]).u64(chunk.begin).u64(chunk.bytes);
            index.u32(chunk.message_indexes.len() as u32 * 10);
            for (channel, place) in &chunk.message_indexes {
                index.u16(*channel).u64(*place);
            }
            index.u64(chunk.message_index_bytes).text(name).u64(chunk.packed_bytes).u64(chunk.unpacked_bytes);
            summary.extend(index.finish());
        }
        // The checksum is of the summary and of the footer up to itself.
        let mut footer = Record::new(kind::FOOTER);
        footer.u64(begin).u64(0).u32(0);
        let footer = footer.finish();
        summary.extend_from_slice(&footer[..footer.len() - 4]);
        let checksum = crc32fast::hash(&summary);
        self.sink.write_all(&summary)?;
        self.sink.write_all(&checksum.to_le_bytes())?;
        self.sink.write_all(&MAGIC)?;
        self.sink.flush()
    }
}

/// A record that is being made.
struct Record(Vec<u8>);

impl Record {
    fn new(kind: u8) -> Self {
        // The length comes last.
        Self([&[kind][..], &[0; 8]].concat())
    }

    fn bytes(&mut self, bytes: &[u8]) -> &mut Self {
        self.0.extend_from_slice(bytes);
        self
    }

    fn u16(&mut self, value: u16) -> &mut Self {
        self.bytes(&value.to_le_bytes())
    }

    fn u32(&mut self, value: u32) -> &mut Self {
        self.bytes(&value.to_le_bytes())
    }

    fn u64(&mut self, value: u64) -> &mut Self {
        self.bytes(&value.to_le_bytes())
    }

    fn text(&mut self, text: &str) -> &mut Self {
        self.u32(text.len() as u32).bytes(text.as_bytes())
    }

    fn finish(mut self) -> Vec<u8> {
        let length = (self.0.len() - 9) as u64;
        self.0[1..9].copy_from_slice(&length.to_le_bytes());
        self.0
    }
}

/// Counts what is written.
struct Counted<W> {
    sink: W,
    bytes: u64,
}

impl<W: Write> Write for Counted<W> {
    fn write(&mut self, buffer: &[u8]) -> io::Result<usize> {
        let n = self.sink.write(buffer)?;
        self.bytes += n as u64;
        Ok(n)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.sink.flush()
    }
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
