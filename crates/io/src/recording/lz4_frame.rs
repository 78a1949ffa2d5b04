//! LZ4 frames, block by block: <https://github.com/lz4/lz4/blob/dev/doc/lz4_Frame_format.md>.
//!
//! Checksums of the frame are skipped, as the chunk around it has its own. Unpacking a block is a library's.

use std::io::{self, Read, Write};

const MAGIC: [u8; 4] = 0x184d_2204_u32.to_le_bytes();
/// How far back a block may refer to those before it.
const WINDOW: usize = 1 << 16;
/// The bit of a block's length that says that it is not packed.
const STORED: u32 = 1 << 31;

/// Unpacks a frame.
pub(crate) struct Lz4Reader<R> {
    source: R,
    /// `None` before the header is read.
    header: Option<Header>,
    /// The window, and behind it the block at hand.
    unpacked: Vec<u8>,
    /// What of it was handed out.
    at: usize,
    is_over: bool,
}

#[derive(Clone, Copy)]
struct Header {
    blocks_are_linked: bool,
    blocks_have_checksums: bool,
    largest_block: usize,
}

fn wrong(what: &str) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, what)
}

impl<R: Read> Lz4Reader<R> {
    pub(crate) fn new(source: R) -> Self {
        Self { source, header: None, unpacked: Vec::new(), at: 0, is_over: false }
    }

    fn array<const N: usize>(&mut self) -> io::Result<[u8; N]> {
        let mut array = [0; N];
        self.source.read_exact(&mut array)?;
        Ok(array)
    }

    fn read_header(&mut self) -> io::Result<Header> {
        if self.array()? != MAGIC {
            return Err(wrong("it does not begin as an LZ4 frame does"));
        }
        let [flags, size] = self.array()?;
        if flags >> 6 != 1 {
            return Err(wrong("the LZ4 frame is of another version"));
        }
        // The size of the content and the name of a dictionary are of no use here.
        if flags & 0x08 != 0 {
            self.array::<8>()?;
        }
        if flags & 0x01 != 0 {
            return Err(wrong("the LZ4 frame needs a dictionary"));
        }
        self.array::<1>()?;
        let largest_block = match size >> 4 & 7 {
            size @ 4..=7 => 1 << (2 * size + 8),
            _ => return Err(wrong("the LZ4 frame has blocks of no known size")),
        };
        Ok(Header {
            blocks_are_linked: flags & 0x20 == 0,
            blocks_have_checksums: flags & 0x10 != 0,
            largest_block,
        })
    }

    /// Unpacks the next block behind the window.
    fn next_block(&mut self) -> io::Result<()> {
        let header = match self.header {
            Some(header) => header,
            None => self.read_header()?,
        };
        self.header = Some(header);
        let keep = if header.blocks_are_linked { WINDOW.min(self.unpacked.len()) } else { 0 };
        self.unpacked.drain(..self.unpacked.len() - keep);
        self.at = self.unpacked.len();
        let length = u32::from_le_bytes(self.array()?);
        if length == 0 {
            self.is_over = true;
            return Ok(());
        }
        let bytes = (length & !STORED) as usize;
        if bytes > header.largest_block {
            return Err(wrong("a block of the LZ4 frame is larger than it may be"));
        }
        let mut packed = vec![0; bytes];
        self.source.read_exact(&mut packed)?;
        if header.blocks_have_checksums {
            self.array::<4>()?;
        }
        if length & STORED != 0 {
            self.unpacked.append(&mut packed);
            return Ok(());
        }
        let mut block = vec![0; header.largest_block];
        let unpacked = lz4_flex::block::decompress_into_with_dict(&packed, &mut block, &self.unpacked);
        let unpacked = unpacked.map_err(|error| wrong(&format!("LZ4: {error}")))?;
        self.unpacked.extend_from_slice(&block[..unpacked]);
        Ok(())
    }
}

impl<R: Read> Read for Lz4Reader<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        while self.at == self.unpacked.len() && !self.is_over {
            self.next_block()?;
        }
        let n = (&self.unpacked[self.at..]).read(buffer)?;
        self.at += n;
        Ok(n)
    }
}

/// Packs bytes as a frame of blocks that stand alone.
pub(crate) fn lz4_frame(bytes: &[u8]) -> io::Result<Vec<u8>> {
    const BLOCK: usize = 1 << 22;
    let mut frame = Vec::new();
    frame.write_all(&MAGIC)?;
    // Version 1, blocks alone, of up to 4 MiB; then the header's checksum, the second byte of xxHash32 of these two.
    frame.write_all(&[0x60, 0x70, 0x73])?;
    for block in bytes.chunks(BLOCK) {
        let packed = lz4_flex::block::compress(block);
        if packed.len() < block.len() {
            frame.write_all(&(packed.len() as u32).to_le_bytes())?;
            frame.write_all(&packed)?;
        } else {
            frame.write_all(&(block.len() as u32 | STORED).to_le_bytes())?;
            frame.write_all(block)?;
        }
    }
    frame.write_all(&[0; 4])?;
    Ok(frame)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn unpacked(frame: &[u8]) -> io::Result<Vec<u8>> {
        let mut bytes = Vec::new();
        Lz4Reader::new(frame).read_to_end(&mut bytes)?;
        Ok(bytes)
    }

    #[test]
    fn what_is_packed_is_unpacked() {
        let bytes: Vec<u8> = (0..9_000_000_u32).map(|i| (i / 700 * 31) as u8).collect();
        let frame = lz4_frame(&bytes).unwrap();
        assert!(frame.len() < bytes.len() / 10);
        assert!(unpacked(&frame).unwrap() == bytes);
        assert!(unpacked(&lz4_frame(&[]).unwrap()).unwrap().is_empty());
        assert!(unpacked(&frame[..frame.len() / 2]).is_err());
        assert!(unpacked(b"nothing of the kind").is_err());
    }

    #[test]
    fn blocks_may_refer_to_those_before_and_have_checksums() {
        // Version 1, linked blocks with checksums, of up to 64 KiB.
        let mut frame = [&MAGIC[..], &[0x50, 0x40, 0]].concat();
        let bytes: Vec<u8> = (0..200_000_u32).map(|i| (i.wrapping_mul(i) / 977) as u8).collect();
        let mut before: &[u8] = &[];
        for (i, block) in bytes.chunks(1 << 16).enumerate() {
            let packed = lz4_flex::block::compress_with_dict(block, before);
            frame.extend((packed.len() as u32).to_le_bytes());
            frame.extend(packed);
            frame.extend([7; 4]);
            before = &bytes[i << 16..(i << 16) + block.len()];
        }
        frame.extend([0; 4]);
        assert!(unpacked(&frame).unwrap() == bytes);
    }
}
