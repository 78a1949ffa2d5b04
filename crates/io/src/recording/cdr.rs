//! Numbers, strings and sequences as ROS serialises them: ROS 2 by CDR, ROS 1 one after the other.
//!
//! CDR (the plain one of DDS, also called XCDR1) begins with four bytes that say which byte comes first; from the byte
//! after these, every number stands at a multiple of its own size. A string counts its terminating zero, a ROS 1 string
//! has none. Whatever is read is checked against the bytes there are.

use super::message::MessageError;

/// How values are laid out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Layout {
    /// ROS 2: aligned, behind a header of four bytes.
    Cdr,
    /// ROS 1: packed, little-endian, without a header.
    Packed,
}

/// Reads values one after the other.
#[derive(Clone, Debug)]
pub(crate) struct Values<'a> {
    /// What follows the header.
    bytes: &'a [u8],
    at: usize,
    layout: Layout,
    is_big_endian: bool,
}

impl<'a> Values<'a> {
    /// Begins with the first value of a message.
    pub(crate) fn new(message: &'a [u8], layout: Layout) -> Result<Self, MessageError> {
        if layout == Layout::Packed {
            return Ok(Self { bytes: message, at: 0, layout, is_big_endian: false });
        }
        let Some(([_, representation, ..], bytes)) = message.split_first_chunk::<4>() else {
            return Err(MessageError::CutOff { what: "header", need: 4, have: message.len() });
        };
        // The first byte of the identifier is zero for all that are known.
        let identifier = u16::from_be_bytes([message[0], *representation]);
        match identifier {
            0 | 1 => Ok(Self { bytes, at: 0, layout, is_big_endian: identifier == 0 }),
            _ => Err(MessageError::Representation { identifier }),
        }
    }

    fn take(&mut self, bytes: usize, what: &'static str) -> Result<&'a [u8], MessageError> {
        let rest = &self.bytes[self.at.min(self.bytes.len())..];
        let Some(taken) = rest.get(..bytes) else {
            return Err(MessageError::CutOff { what, need: bytes, have: rest.len() });
        };
        self.at += bytes;
        Ok(taken)
    }

    fn number<const N: usize>(&mut self, what: &'static str) -> Result<[u8; N], MessageError> {
        if self.layout == Layout::Cdr {
            self.at = self.at.next_multiple_of(N);
        }
        let mut bytes = [0; N];
        bytes.copy_from_slice(self.take(N, what)?);
        if self.is_big_endian {
            bytes.reverse();
        }
        Ok(bytes)
    }

    pub(crate) fn u8(&mut self, what: &'static str) -> Result<u8, MessageError> {
        Ok(self.number::<1>(what)?[0])
    }

    pub(crate) fn u32(&mut self, what: &'static str) -> Result<u32, MessageError> {
        self.number(what).map(u32::from_le_bytes)
    }

    pub(crate) fn f64(&mut self, what: &'static str) -> Result<f64, MessageError> {
        self.number(what).map(f64::from_le_bytes)
    }

    /// Returns a time in nanoseconds: seconds and nanoseconds in 32 bits each.
    pub(crate) fn time_ns(&mut self, what: &'static str) -> Result<i64, MessageError> {
        let (seconds, nanoseconds) = (self.u32(what)?, self.u32(what)?);
        // ROS 2 has signed seconds, ROS 1 unsigned ones; they agree until 2038, and none are negative in a recording.
        Ok(i64::from(seconds) * 1_000_000_000 + i64::from(nanoseconds))
    }

    pub(crate) fn string(&mut self, what: &'static str) -> Result<&'a str, MessageError> {
        let bytes = self.u32(what)? as usize;
        let text = self.take(bytes, what)?;
        let text = match (self.layout, text) {
            (Layout::Cdr, [text @ .., 0]) => text,
            (_, text) => text,
        };
        std::str::from_utf8(text).map_err(|_| MessageError::NotText { what })
    }

    pub(crate) fn bytes(&mut self, what: &'static str) -> Result<&'a [u8], MessageError> {
        let bytes = self.u32(what)? as usize;
        self.take(bytes, what)
    }

    /// Returns a sequence of numbers that states its length.
    pub(crate) fn numbers(&mut self, what: &'static str) -> Result<Vec<f64>, MessageError> {
        let count = self.u32(what)? as usize;
        let have = self.bytes.len().saturating_sub(self.at);
        // A stated length is not believed before the bytes are there.
        if count.saturating_mul(8) > have {
            return Err(MessageError::CutOff { what, need: count.saturating_mul(8), have });
        }
        (0..count).map(|_| self.f64(what)).collect()
    }

    /// Returns `N` numbers.
    pub(crate) fn array<const N: usize>(&mut self, what: &'static str) -> Result<[f64; N], MessageError> {
        let mut numbers = [0.0; N];
        for number in &mut numbers {
            *number = self.f64(what)?;
        }
        Ok(numbers)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const LITTLE: [u8; 4] = [0, 1, 0, 0];

    fn message(header: [u8; 4], rest: &[u8]) -> Vec<u8> {
        [&header[..], rest].concat()
    }

    #[test]
    fn numbers_are_aligned_from_behind_the_header() {
        // A byte, three of padding, a number of four; then one of eight, aligned to the eighth byte.
        let bytes = message(LITTLE, &[7, 0, 0, 0, 1, 2, 0, 0, 0, 0, 0, 0, 0, 0, 0xf0, 0x3f]);
        let mut values = Values::new(&bytes, Layout::Cdr).unwrap();
        assert_eq!((values.u8("a").unwrap(), values.u32("b").unwrap()), (7, 0x201));
        assert_eq!(values.f64("c").unwrap(), 1.0);
        assert!(values.u8("d").is_err());
        let mut values = Values::new(&bytes[4..], Layout::Packed).unwrap();
        assert_eq!((values.u8("a").unwrap(), values.u32("b").unwrap()), (7, 0x0100_0000));
    }

    #[test]
    fn either_byte_may_come_first() {
        let bytes = message([0, 0, 0, 0], &[0, 0, 0, 3, b'a', b'b', 0, 9, 0x3f, 0xf0, 0, 0, 0, 0, 0, 0]);
        let mut values = Values::new(&bytes, Layout::Cdr).unwrap();
        assert_eq!((values.string("text").unwrap(), values.u8("byte").unwrap()), ("ab", 9));
        assert_eq!(values.f64("number").unwrap(), 1.0);
    }

    #[test]
    fn other_representations_are_refused_by_name() {
        for (identifier, part) in [(7, "XCDR2"), (6, "XCDR2"), (3, "parameter list"), (200, "200")] {
            let error = Values::new(&[0, identifier, 0, 0, 1, 2], Layout::Cdr).unwrap_err().to_string();
            assert!(error.contains(part), "{error}");
        }
        assert!(Values::new(&[0, 1], Layout::Cdr).is_err());
    }

    #[test]
    fn lengths_that_are_not_there_are_refused() {
        let bytes = message(LITTLE, &[255, 255, 255, 255, 1]);
        let values = Values::new(&bytes, Layout::Cdr).unwrap();
        assert!(values.clone().string("a").is_err());
        assert!(values.clone().bytes("a").is_err());
        assert!(values.clone().numbers("a").is_err());
        let not_text = message(LITTLE, &[2, 0, 0, 0, 0xff, 0]);
        let error = Values::new(&not_text, Layout::Cdr).unwrap().string("frame").unwrap_err();
        assert!(matches!(error, MessageError::NotText { what: "frame" }));
    }

    proptest! {
        #[test]
        fn any_bytes_are_read_or_refused(
            bytes in proptest::collection::vec(any::<u8>(), 0..64),
            calls in proptest::collection::vec(0..6, 0..12),
            packed in any::<bool>(),
        ) {
            let layout = if packed { Layout::Packed } else { Layout::Cdr };
            let Ok(mut values) = Values::new(&bytes, layout) else { return Ok(()) };
            for call in calls {
                let _ = match call {
                    0 => values.u8("x").is_ok(),
                    1 => values.u32("x").is_ok(),
                    2 => values.f64("x").is_ok(),
                    3 => values.string("x").is_ok(),
                    4 => values.bytes("x").is_ok(),
                    _ => values.numbers("x").is_ok(),
                };
                prop_assert!(values.at <= bytes.len() + 8);
            }
        }
    }
}
