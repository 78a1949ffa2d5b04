//! The records of an MCAP file, one at a time: whatever can be read of it, and where it is damaged.
//!
//! Memory does not grow with the file: a chunk is unpacked while it is read. Damage costs what it hit: a spoilt chunk
//! ends at its own end, and where the length of a record cannot be believed, reading goes on at the next chunk that the
//! file's own summary names. The layout is that of <https://mcap.dev/spec>.

use std::collections::BTreeMap;
use std::fmt;
use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::ops::ControlFlow;

use mcap::records::{Record, op};
use mcap::sans_io::{
    LinearReadEvent, LinearReader, LinearReaderOptions, SummaryReadEvent, SummaryReader, SummaryReaderOptions,
};
use mcap::{McapError, Summary};

/// The first and the last bytes of a file.
pub(crate) const MAGIC: [u8; 8] = *b"\x89MCAP0\r\n";
/// The largest record that is read, in bytes; a message is one.
const RECORD_LIMIT: usize = 1 << 28;
/// The length of a record's kind and length.
const PREFIX: u64 = 9;
/// Kinds of records from here to [`PRIVATE`] are kept for later versions, and none was ever made.
const RESERVED: u8 = 0x10;
/// From here on, kinds are those of applications.
const PRIVATE: u8 = 0x80;

/// What a file says of the messages of a channel.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct ChannelRecord {
    pub id: u16,
    pub schema_id: u16,
    pub topic: String,
    pub message_encoding: String,
}

/// Who hears of the records of a file.
pub(crate) trait Listener {
    /// Hears of a schema; the same may be told again.
    fn schema(&mut self, id: u16, name: String);
    /// Hears of a channel; the same may be told again.
    fn channel(&mut self, channel: ChannelRecord);
    /// Says whether the data of a message are wanted.
    fn wants(&mut self, channel_id: u16) -> bool;
    /// Takes a message that was wanted, or says that nothing more is.
    fn message(&mut self, channel_id: u16, log_time_ns: u64, data: Vec<u8>) -> ControlFlow<()>;
}

/// Where a file is not as it should be; bytes count from its beginning.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Damage {
    /// The file ends before its end.
    CutOff { at: u64 },
    /// A record cannot be one: its kind or its length is impossible.
    NoRecord { at: u64, skipped: u64 },
    /// What begins here cannot be read to its end.
    Spoilt { at: u64, why: String },
    /// The bytes of a chunk are not those that were written.
    Checksum { at: u64 },
    /// A record is larger than any that is read.
    TooLarge { at: u64, bytes: u64 },
}

impl fmt::Display for Damage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Damage::CutOff { at } => write!(f, "the file ends at byte {at} without its end: it was cut off"),
            Damage::NoRecord { at, skipped } => {
                write!(f, "byte {at} begins no record; {skipped} bytes were skipped")
            }
            Damage::Spoilt { at, why } => {
                write!(f, "the record at byte {at} cannot be read to its end: {why}")
            }
            Damage::Checksum { at } => {
                write!(f, "the chunk at byte {at} is not as it was written: its checksum differs")
            }
            Damage::TooLarge { at, bytes } => {
                write!(f, "a record at byte {at} has {bytes} bytes; at most {RECORD_LIMIT} are read")
            }
        }
    }
}

/// Reads the records of a file from its first to its last, and returns where it is damaged.
///
/// An error is one of the system's. The file must begin with [`MAGIC`].
pub(crate) fn read_records<R: Read + Seek>(file: R, listener: &mut dyn Listener) -> io::Result<Vec<Damage>> {
    let mut file = BufReader::with_capacity(1 << 16, file);
    let mut damages = Vec::new();
    let end = file.seek(SeekFrom::End(0))?;
    let summary = read_summary(&mut file, end)?;
    let chunks = tell_summary(&summary, listener);
    let mut at = MAGIC.len() as u64;
    loop {
        if end.saturating_sub(at) < PREFIX {
            damages.push(Damage::CutOff { at: end });
            break;
        }
        // Seeking from where it is keeps what is in the buffer.
        let here = file.stream_position()?;
        file.seek_relative(at.wrapping_sub(here) as i64)?;
        let mut prefix = [0; PREFIX as usize];
        file.read_exact(&mut prefix)?;
        let [kind, length @ ..] = prefix;
        let length = u64::from_le_bytes(length);
        if matches!(kind, op::FOOTER | op::DATA_END) {
            break;
        }
        let next = (at + PREFIX).checked_add(length).filter(|next| *next <= end);
        let later = || chunks.iter().copied().find(|chunk| *chunk >= at + PREFIX);
        // Of other kinds nothing is needed, and an attachment may be larger than any record that is read.
        let is_needed = matches!(kind, op::SCHEMA | op::CHANNEL | op::MESSAGE | op::CHUNK);
        if is_needed && (next.is_some() || kind == op::CHUNK) {
            // A chunk that is longer than the file is no longer than the place of the next one allows.
            let next = next.or_else(later);
            let room = next.unwrap_or(end) - at - PREFIX;
            let head = if kind == op::CHUNK { read_chunk_head(&mut file, room)? } else { Vec::new() };
            // What a chunk has behind its records is not needed, and a record in it that is longer than the chunk finds its
            // end there.
            let length = chunk_length(&head).map_or(room, |length| length.min(room));
            if next.is_some() || length < room {
                prefix[1..].copy_from_slice(&length.to_le_bytes());
            }
            let rest = (&mut file).take(length - head.len() as u64);
            let mut record = (&prefix[..]).chain(&head[..]).chain(rest);
            match read_record(&mut record, at, listener)? {
                Ok(ControlFlow::Continue(())) => {}
                Ok(ControlFlow::Break(())) => break,
                Err(damage) => damages.push(damage),
            }
        }
        let is_record = !is_no_kind(kind) && next.is_some();
        at = match (next, later()) {
            (Some(next), _) if is_record => next,
            // Only its length is wrong, as a later chunk shows.
            (_, Some(chunk)) => {
                if is_no_kind(kind) || kind != op::CHUNK {
                    damages.push(Damage::NoRecord { at, skipped: chunk - at });
                }
                chunk
            }
            // Where no chunk is known to follow, a record that is longer than the file is one that was cut off.
            (None, None) if !is_no_kind(kind) => {
                damages.push(Damage::CutOff { at: end });
                break;
            }
            _ => {
                damages.push(Damage::NoRecord { at, skipped: end - at });
                break;
            }
        };
    }
    Ok(damages)
}

/// The length of what a chunk begins with: its times, the size of its records and their checksum, and the length of the name of
/// the way in which they are packed.
const CHUNK_START: usize = 8 + 8 + 8 + 4 + 4;
/// Names of ways to pack are no longer than this.
const LONGEST_NAME: usize = 64;

/// Reads what a chunk begins with up to its records, as far as `room` goes.
fn read_chunk_head(file: &mut impl Read, room: u64) -> io::Result<Vec<u8>> {
    let mut head = Vec::new();
    file.by_ref().take(room.min(CHUNK_START as u64)).read_to_end(&mut head)?;
    if let Some(name) = length_of_name(&head) {
        let rest = (room - head.len() as u64).min((name + 8) as u64);
        file.by_ref().take(rest).read_to_end(&mut head)?;
    }
    Ok(head)
}

/// Returns the length of the name of the way in which a chunk is packed; `None` where that cannot be one.
fn length_of_name(head: &[u8]) -> Option<usize> {
    let name = u32::from_le_bytes(head.get(CHUNK_START - 4..CHUNK_START)?.try_into().ok()?) as usize;
    (name <= LONGEST_NAME).then_some(name)
}

/// Returns the length of a chunk as its head has it; `None` where that is not there.
fn chunk_length(head: &[u8]) -> Option<u64> {
    let records = CHUNK_START + length_of_name(head)?;
    let packed = u64::from_le_bytes(head.get(records..records + 8)?.try_into().ok()?);
    (head.len() as u64).checked_add(packed)
}

/// Tells of the schemas and channels in a file's summary, and returns how many messages each channel has; `None` where the
/// summary does not say.
pub(crate) fn read_counts<R: Read + Seek>(
    file: R,
    listener: &mut dyn Listener,
) -> io::Result<Option<BTreeMap<u16, u64>>> {
    let mut file = BufReader::with_capacity(1 << 16, file);
    let end = file.seek(SeekFrom::End(0))?;
    let summary = read_summary(&mut file, end)?;
    tell_summary(&summary, listener);
    Ok(summary.and_then(|summary| summary.stats).map(|statistics| statistics.channel_message_counts))
}

/// Reads the file's summary; `None` where it has none that can be read.
fn read_summary(file: &mut (impl Read + Seek), end: u64) -> io::Result<Option<Summary>> {
    let options = SummaryReaderOptions::default().with_file_size(end).with_record_length_limit(RECORD_LIMIT);
    let mut reader = SummaryReader::new_with_options(options);
    while let Some(event) = reader.next_event() {
        match event {
            Ok(SummaryReadEvent::ReadRequest(n)) => {
                let n = file.read(reader.insert(n))?;
                reader.notify_read(n);
            }
            Ok(SummaryReadEvent::SeekRequest(to)) => {
                // A damaged file may point to before its beginning.
                let Ok(place) = file.seek(to) else { return Ok(None) };
                reader.notify_seeked(place);
            }
            // What is wrong with it is found again where it matters.
            Err(_) => return Ok(None),
        }
    }
    Ok(reader.finish())
}

/// Tells of the schemas and channels in a summary, and returns where chunks begin.
fn tell_summary(summary: &Option<Summary>, listener: &mut dyn Listener) -> Vec<u64> {
    let Some(summary) = summary else { return Vec::new() };
    let mut schema_ids: Vec<u16> = summary.schemas.keys().copied().collect();
    schema_ids.sort_unstable();
    for id in schema_ids {
        listener.schema(id, summary.schemas[&id].name.clone());
    }
    let mut channel_ids: Vec<u16> = summary.channels.keys().copied().collect();
    channel_ids.sort_unstable();
    for id in channel_ids {
        let channel = &summary.channels[&id];
        listener.channel(ChannelRecord {
            id,
            schema_id: channel.schema.as_ref().map_or(0, |schema| schema.id),
            topic: channel.topic.clone(),
            message_encoding: channel.message_encoding.clone(),
        });
    }
    let mut chunks: Vec<u64> = summary.chunk_indexes.iter().map(|chunk| chunk.chunk_start_offset).collect();
    chunks.sort_unstable();
    chunks.dedup();
    chunks
}

/// Reads one record of the file, and of a chunk the records in it, until nothing more is wanted or something fails.
fn read_record(
    source: &mut impl Read,
    at: u64,
    listener: &mut dyn Listener,
) -> io::Result<Result<ControlFlow<()>, Damage>> {
    let options = LinearReaderOptions::default()
        .with_skip_start_magic(true)
        .with_skip_end_magic(true)
        .with_validate_chunk_crcs(true)
        .with_record_length_limit(RECORD_LIMIT);
    let mut reader = LinearReader::new_with_options(options);
    while let Some(event) = reader.next_event() {
        match event {
            Ok(LinearReadEvent::ReadRequest(n)) => {
                let n = source.read(reader.insert(n))?;
                reader.notify_read(n);
            }
            Ok(LinearReadEvent::Record { data, opcode }) => match tell_record(opcode, data, listener) {
                Ok(ControlFlow::Continue(())) => {}
                Ok(ControlFlow::Break(())) => return Ok(Ok(ControlFlow::Break(()))),
                Err(why) => return Ok(Err(Damage::Spoilt { at, why })),
            },
            Err(McapError::BadChunkCrc { .. }) => return Ok(Err(Damage::Checksum { at })),
            Err(McapError::RecordTooLarge { len, .. }) => {
                return Ok(Err(Damage::TooLarge { at, bytes: len }));
            }
            Err(error) => return Ok(Err(Damage::Spoilt { at, why: error.to_string() })),
        }
    }
    Ok(Ok(ControlFlow::Continue(())))
}

/// Tells of a record, or says why it is none.
fn tell_record(kind: u8, data: &[u8], listener: &mut dyn Listener) -> Result<ControlFlow<()>, String> {
    if is_no_kind(kind) {
        return Err(format!("there is no record of kind {kind}"));
    }
    // Other kinds are not looked at, as nothing of them is needed.
    if !matches!(kind, op::SCHEMA | op::CHANNEL | op::MESSAGE) {
        return Ok(ControlFlow::Continue(()));
    }
    match mcap::parse_record(kind, data).map_err(|error| error.to_string())? {
        Record::Schema { header, .. } => listener.schema(header.id, header.name),
        Record::Channel(channel) => listener.channel(ChannelRecord {
            id: channel.id,
            schema_id: channel.schema_id,
            topic: channel.topic,
            message_encoding: channel.message_encoding,
        }),
        Record::Message { header, data } if listener.wants(header.channel_id) => {
            return Ok(listener.message(header.channel_id, header.log_time, data.into_owned()));
        }
        _ => {}
    }
    Ok(ControlFlow::Continue(()))
}

/// Tells whether no record has this kind: zero, or one of those that are kept for later versions.
fn is_no_kind(kind: u8) -> bool {
    kind == 0 || (RESERVED..PRIVATE).contains(&kind)
}
