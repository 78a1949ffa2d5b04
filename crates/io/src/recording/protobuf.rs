//! The fields of a protobuf message, without its schema: what Foxglove's messages need.

use super::message::MessageError;

/// The value of a field.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Value<'a> {
    /// A whole number of varying length.
    Varint(u64),
    /// Four bytes.
    Four([u8; 4]),
    /// Eight bytes.
    Eight([u8; 8]),
    /// A text, bytes, a message, or packed numbers.
    Bytes(&'a [u8]),
}

/// Fields, one after the other: the number of each with its value.
#[derive(Clone, Debug)]
pub(crate) struct Fields<'a>(pub &'a [u8]);

impl<'a> Fields<'a> {
    /// Returns the next field, or `None` at the end.
    pub(crate) fn next(&mut self) -> Result<Option<(u64, Value<'a>)>, MessageError> {
        if self.0.is_empty() {
            return Ok(None);
        }
        let key = self.varint()?;
        let value = match key & 7 {
            0 => Value::Varint(self.varint()?),
            1 => Value::Eight(self.array()?),
            2 => {
                let bytes = self.varint()?;
                let bytes = usize::try_from(bytes).unwrap_or(usize::MAX);
                Value::Bytes(self.take(bytes)?)
            }
            5 => Value::Four(self.array()?),
            wire => return Err(MessageError::Protobuf { wire }),
        };
        Ok(Some((key >> 3, value)))
    }

    fn take(&mut self, bytes: usize) -> Result<&'a [u8], MessageError> {
        let Some((taken, rest)) = self.0.split_at_checked(bytes) else {
            return Err(MessageError::CutOff { what: "field", need: bytes, have: self.0.len() });
        };
        self.0 = rest;
        Ok(taken)
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], MessageError> {
        let mut array = [0; N];
        array.copy_from_slice(self.take(N)?);
        Ok(array)
    }

    fn varint(&mut self) -> Result<u64, MessageError> {
        let mut number = 0;
        for shift in (0..70).step_by(7) {
            let byte = self.take(1)?[0];
            // The tenth byte has one bit that counts; others are dropped, as others do.
            number |= u64::from(byte & 0x7f).checked_shl(shift).unwrap_or(0);
            if byte < 0x80 {
                return Ok(number);
            }
        }
        Err(MessageError::Protobuf { wire: 8 })
    }
}

impl<'a> Value<'a> {
    /// Returns the bytes of a field that has some.
    pub(crate) fn bytes(self) -> &'a [u8] {
        match self {
            Value::Bytes(bytes) => bytes,
            _ => &[],
        }
    }

    /// Returns the text of a field.
    pub(crate) fn text(self, what: &'static str) -> Result<&'a str, MessageError> {
        std::str::from_utf8(self.bytes()).map_err(|_| MessageError::NotText { what })
    }

    /// Returns a number that is not negative, however it is written.
    pub(crate) fn u32(self) -> u32 {
        match self {
            Value::Varint(number) => u32::try_from(number).unwrap_or(u32::MAX),
            Value::Four(bytes) => u32::from_le_bytes(bytes),
            _ => 0,
        }
    }

    /// Appends numbers of eight bytes: one, or many that are packed.
    pub(crate) fn numbers(self, to: &mut Vec<f64>) {
        match self {
            Value::Eight(bytes) => to.push(f64::from_le_bytes(bytes)),
            Value::Bytes(bytes) => {
                to.extend(bytes.as_chunks::<8>().0.iter().map(|bytes| f64::from_le_bytes(*bytes)));
            }
            _ => {}
        }
    }

    /// Returns the time that a `google.protobuf.Timestamp` states, in nanoseconds.
    pub(crate) fn time_ns(self) -> Result<i64, MessageError> {
        let (mut seconds, mut nanoseconds) = (0_i64, 0_i64);
        let mut fields = Fields(self.bytes());
        while let Some((number, value)) = fields.next()? {
            match (number, value) {
                (1, Value::Varint(value)) => seconds = value.cast_signed(),
                (2, Value::Varint(value)) => nanoseconds = value.cast_signed(),
                _ => {}
            }
        }
        let time = seconds.checked_mul(1_000_000_000).and_then(|time| time.checked_add(nanoseconds));
        time.ok_or(MessageError::Time { seconds })
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn fields_are_read() {
        // 1: 300; 2: "hi"; 3: 2.0 as eight bytes; 4: 7 as four bytes.
        let mut bytes = vec![0x08, 0xac, 0x02, 0x12, 2, b'h', b'i', 0x19];
        bytes.extend(2.0_f64.to_le_bytes());
        bytes.extend([0x25, 7, 0, 0, 0]);
        let mut fields = Fields(&bytes);
        assert_eq!(fields.next().unwrap(), Some((1, Value::Varint(300))));
        let (number, value) = fields.next().unwrap().unwrap();
        assert_eq!((number, value.text("x").unwrap()), (2, "hi"));
        let mut numbers = Vec::new();
        fields.next().unwrap().unwrap().1.numbers(&mut numbers);
        assert_eq!(numbers, [2.0]);
        assert_eq!(fields.next().unwrap().unwrap().1.u32(), 7);
        assert_eq!(fields.next().unwrap(), None);
    }

    #[test]
    fn what_is_no_field_is_refused() {
        for bytes in [&[0x12, 5, b'a'][..], &[0x0b], &[0x08], &[0xff; 12], &[0x09, 1, 2]] {
            assert!(Fields(bytes).next().is_err(), "{bytes:?}");
        }
        let seconds = [0x08, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0x7f];
        assert!(Value::Bytes(&seconds).time_ns().is_err());
    }

    proptest! {
        #[test]
        fn any_bytes_are_read_or_refused(bytes in proptest::collection::vec(any::<u8>(), 0..64)) {
            let mut fields = Fields(&bytes);
            while let Ok(Some((_, value))) = fields.next() {
                let _ = (value.time_ns(), value.text("x"), value.u32());
            }
        }
    }
}
