//! A Rust source taken apart: code here, comments there, line by line in the same places.

/// The parts of a Rust source. Each is as long as the source; what belongs to another is blank.
#[derive(Debug, Default)]
pub(crate) struct RustText {
    /// The code without comments and without the insides of literals.
    pub code: String,
    /// The comments.
    pub comments: String,
}

/// What the next bytes of a source are.
enum Piece {
    Code(usize),
    Comment(usize),
    Literal(usize),
}

impl RustText {
    pub(crate) fn new(text: &str) -> Self {
        let bytes = text.as_bytes();
        let blank = |byte: &u8| if *byte == b'\n' { b'\n' } else { b' ' };
        let (mut code, mut comments) = (Vec::with_capacity(bytes.len()), Vec::with_capacity(bytes.len()));
        let mut at = 0;
        while at < bytes.len() {
            let after_word = at > 0 && is_word(bytes[at - 1]);
            let (piece_to, is_code, is_comment) = match next_piece(&bytes[at..], after_word) {
                Piece::Code(n) => (at + n, true, false),
                Piece::Comment(n) => (at + n, false, true),
                Piece::Literal(n) => (at + n, false, false),
            };
            let piece = &bytes[at..piece_to.min(bytes.len())];
            if is_code {
                code.extend_from_slice(piece)
            } else {
                code.extend(piece.iter().map(blank))
            }
            if is_comment {
                comments.extend_from_slice(piece)
            } else {
                comments.extend(piece.iter().map(blank))
            }
            at += piece.len();
        }
        // Pieces end at ASCII bytes, so nothing is lost here.
        let text = |bytes: Vec<u8>| String::from_utf8_lossy(&bytes).into_owned();
        Self { code: text(code), comments: text(comments) }
    }

    /// Returns the code up to the tests at the end of the file.
    pub(crate) fn code_without_tests(&self) -> &str {
        let mut from = 0;
        while let Some(found) = self.code[from..].find("#[cfg(test)]") {
            let start = from + found;
            let rest = self.code[start + "#[cfg(test)]".len()..].trim_start();
            // A test module with a body ends the file in this house; `mod x;` and helpers do not.
            if rest.starts_with("mod ")
                && rest.split(['{', ';']).next().is_some_and(|head| rest[head.len()..].starts_with('{'))
            {
                return &self.code[..start];
            }
            from = start + 1;
        }
        &self.code
    }
}

fn is_word(byte: u8) -> bool {
    byte == b'_' || byte.is_ascii_alphanumeric()
}

fn next_piece(bytes: &[u8], after_word: bool) -> Piece {
    match bytes {
        [b'/', b'/', ..] => {
            Piece::Comment(bytes.iter().position(|&byte| byte == b'\n').unwrap_or(bytes.len()))
        }
        [b'/', b'*', ..] => Piece::Comment(block_comment(bytes)),
        [b'"', ..] => Piece::Literal(string(bytes, 1)),
        [b'b' | b'c', b'"', ..] if !after_word => Piece::Literal(string(bytes, 2)),
        [b'r', b'"' | b'#', ..] if !after_word => raw_string(bytes, 1),
        [b'b' | b'c', b'r', b'"' | b'#', ..] if !after_word => raw_string(bytes, 2),
        [b'\'', ..] => character(bytes),
        _ => Piece::Code(1),
    }
}

fn block_comment(bytes: &[u8]) -> usize {
    let (mut depth, mut at) = (0, 0);
    while at < bytes.len() {
        match &bytes[at..] {
            [b'/', b'*', ..] => (depth, at) = (depth + 1, at + 2),
            [b'*', b'/', ..] => (depth, at) = (depth - 1, at + 2),
            _ => at += 1,
        }
        if depth == 0 {
            break;
        }
    }
    at
}

fn string(bytes: &[u8], opened: usize) -> usize {
    let mut at = opened;
    while at < bytes.len() {
        match bytes[at] {
            b'\\' => at += 2,
            b'"' => return at + 1,
            _ => at += 1,
        }
    }
    bytes.len()
}

fn raw_string(bytes: &[u8], prefix: usize) -> Piece {
    let hashes = bytes[prefix..].iter().take_while(|&&byte| byte == b'#').count();
    if bytes.get(prefix + hashes) != Some(&b'"') {
        // A raw identifier such as r#type.
        return Piece::Code(1);
    }
    let close: Vec<u8> = std::iter::once(b'"').chain(std::iter::repeat_n(b'#', hashes)).collect();
    let body = &bytes[prefix + hashes + 1..];
    let end = body.windows(close.len()).position(|window| window == close);
    Piece::Literal(end.map_or(bytes.len(), |end| prefix + hashes + 1 + end + close.len()))
}

/// Tells a character from a lifetime.
fn character(bytes: &[u8]) -> Piece {
    match bytes.get(1) {
        Some(b'\\') => {
            let end = bytes.iter().skip(3).position(|&byte| byte == b'\'').map_or(bytes.len(), |end| end + 4);
            Piece::Literal(end)
        }
        Some(&byte) => {
            let length = match byte {
                0xf0.. => 4,
                0xe0.. => 3,
                0xc0.. => 2,
                _ => 1,
            };
            if bytes.get(1 + length) == Some(&b'\'') { Piece::Literal(2 + length) } else { Piece::Code(1) }
        }
        None => Piece::Code(1),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[track_caller]
    fn check(text: &str, code: &str, comments: &str) {
        let found = RustText::new(text);
        let squeeze = |text: &str| text.split_whitespace().collect::<Vec<_>>().join(" ");
        assert_eq!((squeeze(&found.code).as_str(), squeeze(&found.comments).as_str()), (code, comments));
        assert_eq!(found.code.lines().count(), text.lines().count());
    }

    #[test]
    fn code_and_comments_are_told_apart() {
        check("let a = 1; // one", "let a = 1;", "// one");
        check("a /* b /* c */ d */ e", "a e", "/* b /* c */ d */");
        check(r#"f("not // a \" comment", x)"#, "f( , x)", "");
        check("g(r#\"a\"b\"#, br\"c\", r#type)", "g( , , r#type)", "");
        check("h('\"', '\\'', 'µ', &'a str) // µ", "h( , , , &'a str)", "// µ");
        check("let s = \"a\nb\";\nlet t;", "let s = ; let t;", "");
    }

    #[test]
    fn tests_at_the_end_are_cut_off() {
        let text = "#[cfg(test)]\nmod conformance;\nfn a() {}\n#[cfg(test)]\nmod tests {\n fn b() {}\n}\n";
        assert_eq!(RustText::new(text).code_without_tests(), "#[cfg(test)]\nmod conformance;\nfn a() {}\n");
    }
}
