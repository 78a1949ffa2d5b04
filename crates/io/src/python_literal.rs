//! The part of Python's literals that a `.cameramodel` is made of: a dictionary of strings, numbers and lists.

use crate::cursor::shown;
use crate::number::parse_number;
use crate::{Error, Place};

const DEEPEST: usize = 16;

/// A value.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Literal {
    Text(String),
    Number(f64),
    List(Vec<Literal>),
}

/// A key with its value and the line the value begins on, counted from 1.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Entry {
    pub key: String,
    pub line: usize,
    pub value: Literal,
}

impl Literal {
    /// Returns the numbers of a flat list.
    pub(crate) fn all_numbers(&self) -> Option<Vec<f64>> {
        let Literal::List(items) = self else { return None };
        items.iter().map(|item| if let Literal::Number(value) = item { Some(*value) } else { None }).collect()
    }

    /// Returns the numbers of a flat list of `N`.
    pub(crate) fn numbers<const N: usize>(&self) -> Option<[f64; N]> {
        self.all_numbers()?.try_into().ok()
    }

    /// Returns the value as a short text for a message.
    pub(crate) fn describe(&self) -> String {
        match self {
            Literal::Text(text) => format!("'{}'", shown(text.as_bytes())),
            Literal::Number(value) => value.to_string(),
            Literal::List(items) if items.len() <= 8 => {
                format!("[{}]", items.iter().map(Literal::describe).collect::<Vec<_>>().join(", "))
            }
            Literal::List(items) => format!("a list of {}", items.len()),
        }
    }
}

/// Reads a file that is one dictionary; strings of bytes and long strings are left out of the values.
pub(crate) fn read_dict(file: &str, bytes: &[u8]) -> Result<Vec<Entry>, Error> {
    let mut reader = Reader { file, bytes, at: 0 };
    let mut entries: Vec<Entry> = Vec::new();
    reader.expect(b'{', "a .cameramodel begins with `{`")?;
    loop {
        reader.skip();
        if reader.take(b'}') {
            break;
        }
        let key = reader.string()?;
        reader.expect(b':', "a key is followed by `:`")?;
        reader.skip();
        let line = reader.line();
        let value = reader.value(0)?;
        if entries.iter().any(|entry| entry.key == key) {
            return Err(reader.error(format!("the key `{}` is given twice", shown(key.as_bytes()))));
        }
        entries.push(Entry { key, line, value });
        reader.skip();
        if !reader.take(b',') {
            reader.expect(b'}', "an entry is followed by `,` or `}`")?;
            break;
        }
    }
    reader.skip();
    if reader.at < bytes.len() {
        return Err(reader.malformed("nothing follows the closing `}`"));
    }
    Ok(entries)
}

struct Reader<'a> {
    file: &'a str,
    bytes: &'a [u8],
    at: usize,
}

impl Reader<'_> {
    /// Moves over blanks, newlines and comments.
    fn skip(&mut self) {
        while let Some(&byte) = self.bytes.get(self.at) {
            if byte == b'#' {
                let rest = &self.bytes[self.at..];
                self.at += rest.iter().position(|&byte| byte == b'\n').unwrap_or(rest.len());
            } else if byte.is_ascii_whitespace() {
                self.at += 1;
            } else {
                break;
            }
        }
    }

    fn take(&mut self, byte: u8) -> bool {
        let found = self.bytes.get(self.at) == Some(&byte);
        self.at += usize::from(found);
        found
    }

    fn expect(&mut self, byte: u8, need: &'static str) -> Result<(), Error> {
        self.skip();
        if self.take(byte) { Ok(()) } else { Err(self.malformed(need)) }
    }

    fn value(&mut self, depth: usize) -> Result<Literal, Error> {
        self.skip();
        match self.bytes.get(self.at) {
            Some(b'\'' | b'"' | b'b') => Ok(Literal::Text(self.string()?)),
            Some(b'[' | b'(') if depth < DEEPEST => {
                self.at += 1;
                let mut items = Vec::new();
                loop {
                    self.skip();
                    if self.take(b']') || self.take(b')') {
                        return Ok(Literal::List(items));
                    }
                    items.push(self.value(depth + 1)?);
                    self.skip();
                    if !self.take(b',') && !matches!(self.bytes.get(self.at), Some(b']' | b')')) {
                        return Err(self.malformed("the items of a list are separated by `,`"));
                    }
                }
            }
            _ => {
                let rest = &self.bytes[self.at..];
                let length = rest
                    .iter()
                    .position(|byte| !matches!(byte, b'0'..=b'9' | b'-' | b'+' | b'.' | b'e' | b'E'));
                let token = &rest[..length.unwrap_or(rest.len())];
                let value = parse_number(token).filter(|value| value.is_finite());
                let value =
                    value.ok_or_else(|| self.malformed("a value is a string, a finite number or a list"))?;
                self.at += token.len();
                Ok(Literal::Number(value))
            }
        }
    }

    /// Reads a string; that of bytes is skipped and empty unless it is as short as a name.
    fn string(&mut self) -> Result<String, Error> {
        const LONGEST_NAME: usize = 1000;
        self.take(b'b');
        if !(self.take(b'\'') || self.take(b'"')) {
            return Err(self.malformed("a string is quoted"));
        }
        let rest = &self.bytes[self.at..];
        let Some(length) = rest.iter().position(|byte| matches!(byte, b'\'' | b'"')) else {
            return Err(self.malformed("a string ends with a quote: was the file cut off?"));
        };
        self.at += length + 1;
        let text = if length <= LONGEST_NAME {
            String::from_utf8_lossy(&rest[..length]).into_owned()
        } else {
            String::new()
        };
        Ok(text)
    }

    fn line(&self) -> usize {
        1 + self.bytes[..self.at.min(self.bytes.len())].iter().filter(|&&byte| byte == b'\n').count()
    }

    fn malformed(&self, need: &'static str) -> Error {
        let rest = &self.bytes[self.at..];
        let end = rest.iter().take(30).position(|&byte| byte == b'\n').unwrap_or(rest.len().min(30));
        let found = if rest.is_empty() {
            "the file ends".to_owned()
        } else {
            format!("`{}` is there", shown(&rest[..end]))
        };
        Error::Malformed { place: Place::line(self.file, self.line()), found, need }
    }

    fn error(&self, found: String) -> Error {
        let place = Place::line(self.file, self.line());
        Error::Malformed { place, found, need: "each key is given once" }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dictionaries_are_read() {
        let text = "#{\n{ 'a': 'x', \"b\": [1, (2.5,), []], b'c': -1e-3 }#";
        let entries = read_dict("f", text.as_bytes()).unwrap();
        let described: Vec<_> =
            entries.iter().map(|entry| (entry.key.as_str(), entry.value.describe())).collect();
        assert_eq!(
            described,
            [("a", "'x'".to_owned()), ("b", "[1, [2.5], []]".to_owned()), ("c", "-0.001".to_owned())]
        );
        assert!(entries.iter().all(|entry| entry.line == 2));
    }

    #[test]
    fn what_is_no_dictionary_is_refused() {
        let deep = format!("{{'a': {}", "[".repeat(100_000));
        for text in [
            "",
            "{",
            "{'a'",
            "{'a': }",
            "{'a': 1 'b': 2}",
            "{'a': 1}}",
            "{'a': [1 2]}",
            "{'a': 'x}",
            "{'a': nan}",
            "{'a': 1, 'a': 2}",
            &deep,
        ] {
            assert!(read_dict("f", text.as_bytes()).is_err(), "{}", shown(text.as_bytes()));
        }
    }
}
