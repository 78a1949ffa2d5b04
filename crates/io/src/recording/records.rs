//! The records of an MCAP file, one at a time: whatever can be read of it, and where it is damaged.
//!
//! Memory does not grow with the file: a chunk is unpacked while it is read, and a message that nobody wants is skipped.
//! Damage costs what it hit: a spoilt chunk ends at its own end, and where the length of a record cannot be believed,
//! reading goes on at the next chunk that the file's own summary names.
//! The layout is that of <https://mcap.dev/spec>.

use std::fmt;
use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::ops::ControlFlow;

use super::lz4_frame::Lz4Reader;

/// The first and the last bytes of a file.
pub(crate) const MAGIC: [u8; 8] = *b"\x89MCAP0\r\n";
/// The largest message that is read, in bytes.
pub(crate) const MESSAGE_LIMIT: u64 = 1 << 28;
/// The largest record that describes a schema or a channel, in bytes.
const DESCRIPTION_LIMIT: u64 = 1 << 24;
/// The length of a record's kind and length.
const PREFIX: u64 = 9;
/// The length of what stands before the data of a message.
const MESSAGE_HEADER: u64 = 22;
/// The bytes at the end of a file from its footer on.
const TAIL: u64 = PREFIX + 20 + MAGIC.len() as u64;

/// The kinds of records.
pub(crate) mod kind {
    pub(crate) const HEADER: u8 = 0x01;
    pub(crate) const FOOTER: u8 = 0x02;
    pub(crate) const SCHEMA: u8 = 0x03;
    pub(crate) const CHANNEL: u8 = 0x04;
    pub(crate) const MESSAGE: u8 = 0x05;
    pub(crate) const CHUNK: u8 = 0x06;
    pub(crate) const MESSAGE_INDEX: u8 = 0x07;
    pub(crate) const CHUNK_INDEX: u8 = 0x08;
    pub(crate) const STATISTICS: u8 = 0x0b;
    pub(crate) const DATA_END: u8 = 0x0f;
    /// Kinds from here to 0x7f are kept for later versions, and none was ever made.
    pub(crate) const RESERVED: u8 = 0x10;
    pub(crate) const PRIVATE: u8 = 0x80;
}

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
    /// A chunk cannot be unpacked to its end.
    Chunk { at: u64, why: String },
    /// The bytes of a chunk are not those that were written.
    Checksum { at: u64 },
    /// A message is larger than any that is read.
    TooLarge { at: u64, bytes: u64 },
}

impl fmt::Display for Damage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Damage::CutOff { at } => write!(f, "the file ends at byte {at} without its end: it was cut off"),
            Damage::NoRecord { at, skipped } => {
                write!(f, "byte {at} begins no record; {skipped} bytes were skipped")
            }
            Damage::Chunk { at, why } => write!(f, "the chunk at byte {at} cannot be read to its end: {why}"),
            Damage::Checksum { at } => {
                write!(f, "the chunk at byte {at} is not as it was written: its checksum differs")
            }
            Damage::TooLarge { at, bytes } => {
                write!(f, "the message at byte {at} has {bytes} bytes; at most {MESSAGE_LIMIT} are read")
            }
        }
    }
}

/// Reads the records of a file from its first to its last, and returns where it is damaged.
///
/// An error is one of the system's. The file must begin with [`MAGIC`].
pub(crate) fn read_records<R: Read + Seek>(file: R, listener: &mut dyn Listener) -> io::Result<Vec<Damage>> {
    let mut reader = Reader { file: BufReader::with_capacity(1 << 16, file), damages: Vec::new() };
    let end = reader.file.seek(SeekFrom::End(0))?;
    let chunks = reader.read_summary(end, listener)?;
    let mut at = MAGIC.len() as u64;
    loop {
        reader.file.seek(SeekFrom::Start(at))?;
        let Some((kind, length)) = reader.prefix(at, end)? else { break };
        let begin = at + PREFIX;
        let fits = begin.checked_add(length).is_some_and(|next| next <= end);
        if is_no_kind(kind) || !(fits || kind == kind::CHUNK) {
            // Where no chunk is known to follow, a record that is longer than the file is one that was cut off.
            match chunks.iter().find(|chunk| **chunk > at) {
                Some(&next) => {
                    reader.damages.push(Damage::NoRecord { at, skipped: next - at });
                    at = next;
                    continue;
                }
                None if fits || is_no_kind(kind) => {
                    reader.damages.push(Damage::NoRecord { at, skipped: end - at });
                }
                None => reader.damages.push(Damage::CutOff { at: end }),
            }
            break;
        }
        let available = length.min(end - begin);
        let flow = match kind {
            kind::FOOTER | kind::DATA_END => break,
            kind::CHUNK => reader.chunk(at, available, listener)?,
            _ => {
                let mut record = (&mut reader.file).take(available);
                match one_record(&mut record, kind, length, at, listener)? {
                    Ok(flow) => flow,
                    Err(damage) => {
                        reader.damages.push(damage);
                        ControlFlow::Continue(())
                    }
                }
            }
        };
        if flow.is_break() {
            break;
        }
        if !fits {
            // A chunk that was cut off, unless a later one shows that only its length is wrong.
            match chunks.iter().find(|chunk| **chunk > at) {
                Some(&next) => {
                    at = next;
                    continue;
                }
                None => reader.damages.push(Damage::CutOff { at: end }),
            }
            break;
        }
        at = begin + length;
    }
    Ok(reader.damages)
}

struct Reader<R> {
    file: BufReader<R>,
    damages: Vec<Damage>,
}

impl<R: Read + Seek> Reader<R> {
    /// Reads the kind and the length of the record at a byte; `None` at the end of the file, which is noted.
    fn prefix(&mut self, at: u64, end: u64) -> io::Result<Option<(u8, u64)>> {
        if end.saturating_sub(at) < PREFIX {
            self.damages.push(Damage::CutOff { at: end });
            return Ok(None);
        }
        let mut bytes = [0; PREFIX as usize];
        self.file.read_exact(&mut bytes)?;
        Ok(Some(split_prefix(bytes)))
    }

    /// Reads the file's summary, if it has one: schemas and channels are told, and where chunks begin is returned.
    fn read_summary(&mut self, end: u64, listener: &mut dyn Listener) -> io::Result<Vec<u64>> {
        let mut chunks = Vec::new();
        if end < MAGIC.len() as u64 + TAIL {
            return Ok(chunks);
        }
        let footer = end - TAIL;
        self.file.seek(SeekFrom::Start(footer))?;
        let mut tail = [0; TAIL as usize];
        self.file.read_exact(&mut tail)?;
        let mut fields = Fields(&tail[PREFIX as usize..]);
        let summary = fields.u64().unwrap_or(0);
        if tail[0] != kind::FOOTER || !tail.ends_with(&MAGIC) || summary == 0 || summary >= footer {
            return Ok(chunks);
        }
        let mut at = summary;
        while at + PREFIX <= footer {
            self.file.seek(SeekFrom::Start(at))?;
            let mut prefix = [0; PREFIX as usize];
            self.file.read_exact(&mut prefix)?;
            let (kind, length) = split_prefix(prefix);
            let Some(next) = (at + PREFIX).checked_add(length).filter(|next| *next <= footer) else { break };
            match kind {
                kind::SCHEMA | kind::CHANNEL => {
                    let mut record = (&mut self.file).take(length);
                    // What is wrong with it is found again where it matters.
                    let _ = one_record(&mut record, kind, length, at, listener)?;
                }
                kind::CHUNK_INDEX if length >= 24 => {
                    let mut bytes = [0; 24];
                    self.file.read_exact(&mut bytes)?;
                    chunks.push(Fields(&bytes[16..]).u64().unwrap_or(0));
                }
                _ => {}
            }
            at = next;
        }
        chunks.sort_unstable();
        chunks.dedup();
        Ok(chunks)
    }

    /// Reads the records of the chunk whose content of `length` bytes comes next; what stops that is noted.
    fn chunk(&mut self, at: u64, length: u64, listener: &mut dyn Listener) -> io::Result<ControlFlow<()>> {
        let mut content = (&mut self.file).take(length);
        let Some(header) = ChunkHeader::read(&mut content)? else {
            let why = "its header is not one".to_owned();
            self.damages.push(Damage::Chunk { at, why });
            return Ok(ControlFlow::Continue(()));
        };
        let packed = content.take(header.packed_bytes);
        let unpacked: Box<dyn Read + '_> = match header.compression.as_str() {
            "" => Box::new(packed),
            "zstd" => match zstd::stream::read::Decoder::with_buffer(io::BufReader::new(packed)) {
                Ok(decoder) => Box::new(decoder),
                Err(error) => {
                    self.damages.push(Damage::Chunk { at, why: error.to_string() });
                    return Ok(ControlFlow::Continue(()));
                }
            },
            "lz4" => Box::new(Lz4Reader::new(packed)),
            other => {
                let why = format!("it is packed by `{other}`; zstd and lz4 are read");
                self.damages.push(Damage::Chunk { at, why });
                return Ok(ControlFlow::Continue(()));
            }
        };
        let mut records =
            Hashed { source: unpacked.take(header.bytes), hash: crc32fast::Hasher::new(), bytes: 0 };
        let flow = match records_of_chunk(&mut records, &header, at, listener, &mut self.damages) {
            Ok(flow) => flow,
            Err(damage) => {
                self.damages.push(damage);
                return Ok(ControlFlow::Continue(()));
            }
        };
        let is_whole = records.bytes == header.bytes;
        if header.checksum != 0 && is_whole && records.hash.finalize() != header.checksum {
            self.damages.push(Damage::Checksum { at });
        }
        Ok(flow)
    }
}

/// Reads the records in a chunk until nothing more is wanted or something fails; messages that are too large are noted.
fn records_of_chunk(
    records: &mut Hashed<impl Read>,
    header: &ChunkHeader,
    at: u64,
    listener: &mut dyn Listener,
    too_large: &mut Vec<Damage>,
) -> Result<ControlFlow<()>, Damage> {
    let broken = |why: String| Damage::Chunk { at, why };
    let failed = |error: io::Error| broken(error.to_string());
    while records.bytes < header.bytes {
        let mut prefix = [0; PREFIX as usize];
        records.read_exact(&mut prefix).map_err(failed)?;
        let (kind, length) = split_prefix(prefix);
        if is_no_kind(kind) {
            return Err(broken(format!("there is no record of kind {kind}")));
        }
        if length > header.bytes - records.bytes {
            return Err(broken(format!("a record of {length} bytes does not fit into it")));
        }
        let next = records.bytes + length;
        match one_record(&mut records.by_ref().take(length), kind, length, at, listener).map_err(failed)? {
            Ok(ControlFlow::Break(())) => return Ok(ControlFlow::Break(())),
            Ok(ControlFlow::Continue(())) => {}
            Err(damage @ Damage::TooLarge { .. }) => too_large.push(damage),
            Err(damage) => return Err(damage),
        }
        let rest = next - records.bytes;
        if io::copy(&mut records.by_ref().take(rest), &mut io::sink()).map_err(failed)? != rest {
            return Err(broken("it ends too early".to_owned()));
        }
    }
    Ok(ControlFlow::Continue(()))
}

/// Tells whether no record has this kind: zero, or one of those that are kept for later versions.
fn is_no_kind(kind: u8) -> bool {
    kind == 0 || (kind::RESERVED..kind::PRIVATE).contains(&kind)
}

/// Reads a record of a kind that stands in chunks as well as outside of them; what is not wanted is left unread.
fn one_record(
    record: &mut impl Read,
    kind: u8,
    length: u64,
    at: u64,
    listener: &mut dyn Listener,
) -> io::Result<Result<ControlFlow<()>, Damage>> {
    let spoilt = |what: &str| Damage::Chunk { at, why: format!("{what} in it is none") };
    match kind {
        kind::SCHEMA | kind::CHANNEL => {
            let mut bytes = Vec::new();
            record.take(DESCRIPTION_LIMIT).read_to_end(&mut bytes)?;
            let mut fields = Fields(&bytes);
            if kind == kind::SCHEMA {
                let (Some(id), Some(name)) = (fields.u16(), fields.string()) else {
                    return Ok(Err(spoilt("a schema")));
                };
                listener.schema(id, name);
            } else {
                let read = (fields.u16(), fields.u16(), fields.string(), fields.string());
                let (Some(id), Some(schema_id), Some(topic), Some(message_encoding)) = read else {
                    return Ok(Err(spoilt("a channel")));
                };
                listener.channel(ChannelRecord { id, schema_id, topic, message_encoding });
            }
        }
        kind::MESSAGE => {
            let mut header = [0; MESSAGE_HEADER as usize];
            let Some(bytes) = length.checked_sub(MESSAGE_HEADER) else {
                return Ok(Err(spoilt("a message")));
            };
            record.read_exact(&mut header)?;
            let mut fields = Fields(&header);
            let channel_id = fields.u16().unwrap_or_default();
            let log_time_ns = Fields(&header[6..]).u64().unwrap_or_default();
            if !listener.wants(channel_id) {
                return Ok(Ok(ControlFlow::Continue(())));
            }
            if bytes > MESSAGE_LIMIT {
                return Ok(Err(Damage::TooLarge { at, bytes }));
            }
            // What is stated is not believed before it is there: the buffer grows with what is read.
            let mut data = Vec::with_capacity(usize::try_from(bytes.min(1 << 22)).unwrap_or(0));
            record.take(bytes).read_to_end(&mut data)?;
            if data.len() as u64 != bytes {
                return Err(io::ErrorKind::UnexpectedEof.into());
            }
            return Ok(Ok(listener.message(channel_id, log_time_ns, data)));
        }
        _ => {}
    }
    Ok(Ok(ControlFlow::Continue(())))
}

/// What stands before the records of a chunk.
struct ChunkHeader {
    bytes: u64,
    checksum: u32,
    compression: String,
    packed_bytes: u64,
}

impl ChunkHeader {
    /// Reads a header, or finds that it is none.
    fn read(source: &mut impl Read) -> io::Result<Option<Self>> {
        let mut start = [0; 32];
        if source.read_exact(&mut start).is_err() {
            return Ok(None);
        }
        let mut fields = Fields(&start[16..]);
        let (Some(bytes), Some(checksum), Some(name_bytes)) = (fields.u64(), fields.u32(), fields.u32())
        else {
            return Ok(None);
        };
        // No name of a compression is long.
        if name_bytes > 64 {
            return Ok(None);
        }
        let mut rest = vec![0; name_bytes as usize + 8];
        if source.read_exact(&mut rest).is_err() {
            return Ok(None);
        }
        let (name, packed) = rest.split_at(name_bytes as usize);
        let (Ok(compression), Some(packed_bytes)) = (String::from_utf8(name.to_vec()), Fields(packed).u64())
        else {
            return Ok(None);
        };
        Ok(Some(Self { bytes, checksum, compression, packed_bytes }))
    }
}

fn split_prefix(prefix: [u8; PREFIX as usize]) -> (u8, u64) {
    (prefix[0], Fields(&prefix[1..]).u64().unwrap_or_default())
}

/// Little-endian fields, one after the other.
struct Fields<'a>(&'a [u8]);

impl Fields<'_> {
    fn take<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (field, rest) = self.0.split_first_chunk::<N>()?;
        self.0 = rest;
        Some(*field)
    }

    fn u16(&mut self) -> Option<u16> {
        self.take().map(u16::from_le_bytes)
    }

    fn u32(&mut self) -> Option<u32> {
        self.take().map(u32::from_le_bytes)
    }

    fn u64(&mut self) -> Option<u64> {
        self.take().map(u64::from_le_bytes)
    }

    fn string(&mut self) -> Option<String> {
        let bytes = self.u32()? as usize;
        let (text, rest) = self.0.split_at_checked(bytes)?;
        self.0 = rest;
        String::from_utf8(text.to_vec()).ok()
    }
}

/// Counts and hashes what is read.
struct Hashed<R> {
    source: R,
    hash: crc32fast::Hasher,
    bytes: u64,
}

impl<R: Read> Read for Hashed<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let n = self.source.read(buffer)?;
        self.hash.update(&buffer[..n]);
        self.bytes += n as u64;
        Ok(n)
    }
}
