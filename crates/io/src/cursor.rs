//! A position in the bytes of a text file: tokens and numbers without a copy, lines counted.

use crate::number::{leading_number, parse_number};

/// A position in the bytes of a text file.
pub(crate) struct Cursor<'a> {
    bytes: &'a [u8],
    at: usize,
    line: usize,
}

impl<'a> Cursor<'a> {
    /// Returns the start of `bytes`, after a byte order mark if there is one.
    pub(crate) fn new(bytes: &'a [u8]) -> Self {
        let at = if bytes.starts_with(b"\xef\xbb\xbf") { 3 } else { 0 };
        Self { bytes, at, line: 1 }
    }

    /// Returns the number of the current line, counted from 1.
    pub(crate) fn line(&self) -> usize {
        self.line
    }

    /// Tells whether everything was read.
    pub(crate) fn at_end(&self) -> bool {
        self.at >= self.bytes.len()
    }

    /// Tells whether the last line has no newline at its end.
    pub(crate) fn ends_without_newline(&self) -> bool {
        self.bytes.last().is_some_and(|&byte| byte != b'\n')
    }

    /// Returns what is left to read.
    #[inline(always)]
    pub(crate) fn rest(&self) -> &'a [u8] {
        &self.bytes[self.at..]
    }

    /// Moves over blanks within the line.
    #[inline(always)]
    pub(crate) fn skip_blanks(&mut self) {
        while matches!(self.bytes.get(self.at), Some(b' ' | b'\t' | b'\r')) {
            self.at += 1;
        }
    }

    /// Tells whether the line has ended.
    #[inline(always)]
    pub(crate) fn at_line_end(&self) -> bool {
        matches!(self.bytes.get(self.at), None | Some(b'\n'))
    }

    /// Moves to the next line and returns what was left of this one, without its end.
    pub(crate) fn take_line(&mut self) -> &'a [u8] {
        let rest = self.rest();
        let length = rest.iter().position(|&byte| byte == b'\n').unwrap_or(rest.len());
        self.at += length;
        self.finish_line();
        rest[..length].trim_ascii_end()
    }

    /// Moves over the end of the line.
    #[inline(always)]
    pub(crate) fn finish_line(&mut self) {
        if self.at < self.bytes.len() {
            self.at += 1;
            self.line += 1;
        }
    }

    /// Returns the bytes up to the next blank or end of line and moves behind them.
    #[inline]
    pub(crate) fn take_token(&mut self) -> &'a [u8] {
        let rest = self.rest();
        let length = rest.iter().position(|&byte| byte <= b' ').unwrap_or(rest.len());
        self.at += length;
        &rest[..length]
    }

    /// Moves over a digit that stands alone before a blank or the end of the line, and returns its value.
    #[inline(always)]
    pub(crate) fn take_single_digit(&mut self) -> Option<u8> {
        let (&byte, next) = (self.bytes.get(self.at)?, self.bytes.get(self.at + 1));
        let digit = byte.wrapping_sub(b'0');
        (digit < 10 && next.is_none_or(|&byte| byte <= b' ')).then(|| {
            self.at += 1;
            digit
        })
    }

    /// Moves over `word` if it comes next and `ends` holds for the byte behind it, or nothing is there.
    #[inline(always)]
    pub(crate) fn take_word(&mut self, word: &[u8], ends: impl Fn(u8) -> bool) -> bool {
        let rest = self.rest();
        let found = starts_with(rest, word) && rest.get(word.len()).is_none_or(|&byte| ends(byte));
        self.at += if found { word.len() } else { 0 };
        found
    }

    /// Returns the number up to the next blank, comma or end of line, or else the token that is no number.
    #[inline(always)]
    pub(crate) fn take_number(&mut self) -> Result<f64, &'a [u8]> {
        let rest = self.rest();
        if let Some((value, length)) = leading_number(rest)
            && rest.get(length).is_none_or(|&byte| ends_number(byte))
        {
            self.at += length;
            return Ok(value);
        }
        self.take_unusual_number()
    }

    #[inline(never)]
    fn take_unusual_number(&mut self) -> Result<f64, &'a [u8]> {
        let rest = self.rest();
        let length = rest.iter().position(|&byte| ends_number(byte)).unwrap_or(rest.len());
        self.at += length;
        let token = &rest[..length];
        parse_number(token).ok_or(token)
    }

    /// Returns the comma-separated field and moves behind it, over the comma if there is one.
    ///
    /// A field in double quotes may hold commas, but neither quotes nor newlines.
    #[inline]
    pub(crate) fn take_field(&mut self) -> &'a [u8] {
        self.skip_blanks();
        let rest = self.rest();
        if let [b'"', quoted @ ..] = rest
            && let Some(length) = quoted.iter().position(|&byte| byte == b'"' || byte == b'\n')
            && quoted[length] == b'"'
        {
            self.at += length + 2;
            self.finish_field();
            return &quoted[..length];
        }
        let length = rest.iter().position(|&byte| byte == b',' || byte == b'\n').unwrap_or(rest.len());
        self.at += length;
        self.finish_field();
        rest[..length].trim_ascii_end()
    }

    /// Returns the field as [`take_field`](Self::take_field) does, quickly if it is equal to `likely`.
    #[inline(always)]
    pub(crate) fn take_field_like(&mut self, likely: &'a [u8]) -> &'a [u8] {
        if !likely.is_empty() && self.take_word(likely, |byte| byte == b',') {
            self.at += usize::from(!self.at_end());
            return likely;
        }
        self.take_field()
    }

    /// Moves over blanks and one comma.
    #[inline(always)]
    pub(crate) fn finish_field(&mut self) {
        self.skip_blanks();
        if self.bytes.get(self.at) == Some(&b',') {
            self.at += 1;
        }
    }
}

/// Tells whether `bytes` begin with `word`, eight bytes at a time: words are too short for a call.
#[inline(always)]
fn starts_with(bytes: &[u8], word: &[u8]) -> bool {
    let Some(bytes) = bytes.get(..word.len()) else { return false };
    let (words, rest) = word.as_chunks::<8>();
    let (others, other_rest) = bytes.as_chunks::<8>();
    words.iter().zip(others).all(|(a, b)| u64::from_ne_bytes(*a) == u64::from_ne_bytes(*b))
        && rest.iter().zip(other_rest).all(|(a, b)| a == b)
}

#[inline(always)]
fn ends_number(byte: u8) -> bool {
    byte <= b' ' || byte == b','
}

/// Returns bytes as text for a message: shortened, and with what is no text replaced.
pub(crate) fn shown(bytes: &[u8]) -> String {
    const LONGEST: usize = 60;
    let text: String = String::from_utf8_lossy(&bytes[..bytes.len().min(4 * LONGEST)])
        .chars()
        .map(|c| if c.is_control() { char::REPLACEMENT_CHARACTER } else { c })
        .collect();
    match text.char_indices().nth(LONGEST) {
        Some((end, _)) => format!("{}...", &text[..end]),
        None => text,
    }
}
