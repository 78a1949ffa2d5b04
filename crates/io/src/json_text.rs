//! JSON laid out for people: objects over lines, numbers of an array on one.

use std::io;

use serde::Serialize;
use serde_json::ser::Formatter;

/// Returns a value as JSON text with a newline at its end: the same bytes for the same value.
pub(crate) fn to_json(value: &impl Serialize) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut serializer = serde_json::Serializer::with_formatter(&mut bytes, Layout { depth: 0 });
    value.serialize(&mut serializer).expect("a vector takes all bytes, and all keys are strings");
    bytes.push(b'\n');
    bytes
}

struct Layout {
    depth: usize,
}

impl Layout {
    fn new_line<W: ?Sized + io::Write>(&self, writer: &mut W) -> io::Result<()> {
        writer.write_all(b"\n")?;
        (0..self.depth).try_for_each(|_| writer.write_all(b"  "))
    }
}

impl Formatter for Layout {
    fn begin_object<W: ?Sized + io::Write>(&mut self, writer: &mut W) -> io::Result<()> {
        self.depth += 1;
        writer.write_all(b"{")
    }

    fn end_object<W: ?Sized + io::Write>(&mut self, writer: &mut W) -> io::Result<()> {
        self.depth -= 1;
        self.new_line(writer)?;
        writer.write_all(b"}")
    }

    fn begin_object_key<W: ?Sized + io::Write>(&mut self, writer: &mut W, first: bool) -> io::Result<()> {
        if !first {
            writer.write_all(b",")?;
        }
        self.new_line(writer)
    }

    fn begin_object_value<W: ?Sized + io::Write>(&mut self, writer: &mut W) -> io::Result<()> {
        writer.write_all(b": ")
    }

    fn begin_array_value<W: ?Sized + io::Write>(&mut self, writer: &mut W, first: bool) -> io::Result<()> {
        if first { Ok(()) } else { writer.write_all(b", ") }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn objects_take_lines_and_numbers_share_one() {
        let value = serde_json::json!({"a": [1.0, 2.5], "b": [{"c": 0.1}, {"c": -0.0}], "d": {}});
        let text = String::from_utf8(to_json(&value)).unwrap();
        let expected = "{\n  \"a\": [1.0, 2.5],\n  \"b\": [{\n    \"c\": 0.1\n  }, {\n    \"c\": -0.0\n  }],\n  \"d\": {\n  }\n}\n";
        assert_eq!(text, expected);
    }
}
