//! OpenCV's FileStorage YAML as a tree: `%YAML:1.0`, `%YAML 1.2` or no first line at all.

use std::borrow::Cow;

use saphyr_parser::{Event, Parser};

use crate::cursor::shown;
use crate::number::parse_number;
use crate::{Error, Place};

const DEEPEST: usize = 32;

/// A node with the line it begins on, counted from 1.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Node {
    pub line: usize,
    pub value: Value,
}

/// What a node holds.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Value {
    Scalar(String),
    List(Vec<Node>),
    Map(Vec<(String, Node)>),
}

/// A matrix of numbers, row by row; the channels of an element follow each other.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Matrix {
    pub rows: usize,
    pub cols: usize,
    pub data: Vec<f64>,
}

impl Node {
    /// Returns the entry of a map.
    pub(crate) fn get(&self, key: &str) -> Option<&Node> {
        let Value::Map(entries) = &self.value else { return None };
        entries.iter().find(|(other, _)| other == key).map(|(_, node)| node)
    }

    /// Returns the text of a scalar.
    pub(crate) fn text(&self) -> Option<&str> {
        if let Value::Scalar(text) = &self.value { Some(text) } else { None }
    }

    /// Returns the number that a scalar spells, OpenCV's `.Nan` and `-.Inf` included.
    pub(crate) fn number(&self) -> Option<f64> {
        let text = self.text()?.trim();
        match text.to_ascii_lowercase().as_str() {
            ".nan" | "-.nan" => Some(f64::NAN),
            ".inf" | "+.inf" => Some(f64::INFINITY),
            "-.inf" => Some(f64::NEG_INFINITY),
            // A number begins with one; words such as `inf` are text here.
            _ => text
                .starts_with(|c: char| c.is_ascii_digit() || "+-.".contains(c))
                .then(|| parse_number(text.as_bytes()))?,
        }
    }

    /// Returns the matrix of a map with `rows`, `cols` and `data`, or what is wrong with it.
    pub(crate) fn matrix(&self) -> Result<Matrix, String> {
        let size = |key: &str| {
            let number =
                self.get(key).and_then(Node::number).filter(|n| n.fract() == 0.0 && (0.0..=1e9).contains(n));
            number.map(|n| n as usize).ok_or_else(|| format!("a matrix without `{key}`"))
        };
        let (rows, cols) = (size("rows")?, size("cols")?);
        let channels = match self.get("dt").and_then(Node::text) {
            None => 1,
            Some(dt) => match dt.trim_end_matches(|c: char| c.is_ascii_alphabetic()) {
                "" => 1,
                digits => digits
                    .parse::<usize>()
                    .map_err(|_| format!("a matrix of type `{}`", shown(dt.as_bytes())))?,
            },
        };
        let Some(Value::List(items)) = self.get("data").map(|node| &node.value) else {
            return Err("a matrix without `data`".to_owned());
        };
        let need = rows.checked_mul(cols).and_then(|n| n.checked_mul(channels));
        if need != Some(items.len()) {
            return Err(format!("a matrix of {rows}x{cols} with {} numbers", items.len()));
        }
        let number = |node: &Node| {
            node.number()
                .ok_or_else(|| format!("a matrix with `{}`", shown(node.text().unwrap_or("?").as_bytes())))
        };
        Ok(Matrix { rows, cols, data: items.iter().map(number).collect::<Result<_, _>>()? })
    }
}

/// Reads a FileStorage file, whose first document must be a map.
pub(crate) fn read_file_storage(file: &str, bytes: &[u8]) -> Result<Node, Error> {
    let text = String::from_utf8_lossy(bytes);
    let text = text.strip_prefix('\u{feff}').unwrap_or(&text);
    // YAML parsers take OpenCV's directive for an error; its line stays, so that lines count right.
    let body = match text.split_once('\n') {
        Some((first, rest)) if first.starts_with("%YAML") => Cow::Owned(format!("\n{rest}")),
        _ => Cow::Borrowed(text),
    };
    let malformed = |line: usize, found: String| Error::Malformed {
        place: Place::line(file, line),
        found,
        need: "a file of this kind is YAML: a map of names to values",
    };
    // The nodes that are open, each map with the key whose value comes next.
    let mut open: Vec<(Node, Option<String>)> = Vec::new();
    let mut parser = Parser::new_from_str(&body);
    while let Some(event) = parser.next_event() {
        let (event, span) =
            event.map_err(|error| malformed(error.marker().line(), error.info().to_owned()))?;
        let line = span.start.line();
        let finished = match event {
            Event::Scalar(text, ..) => Node { line, value: Value::Scalar(text.into_owned()) },
            Event::SequenceStart(..) | Event::MappingStart(..) => {
                if open.len() >= DEEPEST {
                    return Err(malformed(line, format!("{} levels of nesting are there", open.len() + 1)));
                }
                let map = matches!(event, Event::MappingStart(..));
                let value = if map { Value::Map(Vec::new()) } else { Value::List(Vec::new()) };
                open.push((Node { line, value }, None));
                continue;
            }
            Event::SequenceEnd | Event::MappingEnd => match open.pop() {
                Some((node, _)) => node,
                None => return Err(malformed(line, "a value ends that did not begin".to_owned())),
            },
            Event::Alias(_) => return Err(malformed(line, "an alias is there".to_owned())),
            Event::DocumentEnd => break,
            _ => continue,
        };
        let Some((parent, key)) = open.last_mut() else {
            return match finished.value {
                Value::Map(_) => Ok(finished),
                _ => Err(malformed(line, "a single value is there".to_owned())),
            };
        };
        match (&mut parent.value, key.take(), finished) {
            (Value::List(items), _, node) => items.push(node),
            (Value::Map(entries), Some(name), node) => entries.push((name, node)),
            (Value::Map(_), None, Node { value: Value::Scalar(name), .. }) => *key = Some(name),
            (_, _, node) => return Err(malformed(node.line, "a key that is no word".to_owned())),
        }
    }
    Err(malformed(1, "no value is there".to_owned()))
}

/// Returns a number as OpenCV and PyYAML both read it as a double, lossless.
///
/// PyYAML takes a number without a point, or with an exponent without a sign, for text.
pub(crate) fn yaml_number(value: f64) -> String {
    if value.fract() == 0.0 && value.abs() < 1e15 {
        return format!("{value:.0}.");
    }
    let scientific = format!("{value:.16e}");
    let (mantissa, exponent) = scientific.split_once('e').unwrap_or((&scientific, "0"));
    let (sign, digits) = exponent.strip_prefix('-').map_or(('+', exponent), |digits| ('-', digits));
    format!("{mantissa}e{sign}{digits:0>2}")
}

/// Returns an `!!opencv-matrix` of doubles under this key.
pub(crate) fn yaml_matrix(key: &str, rows: usize, cols: usize, data: &[f64]) -> String {
    let numbers: Vec<String> = data.iter().map(|value| yaml_number(*value)).collect();
    let lines: Vec<String> = numbers.chunks(3).map(|chunk| chunk.join(", ")).collect();
    let data = lines.join(",\n       ");
    format!("{key}: !!opencv-matrix\n   rows: {rows}\n   cols: {cols}\n   dt: d\n   data: [ {data} ]\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    const BODY: &str = "a: 1.\nm: !!opencv-matrix\n   rows: 1\n   cols: 2\n   dt: \"2d\"\n   data: [ 1., .Nan, -.Inf,\n       -2.5e-01 ]\nnames:\n   - \"x y\"\n   - b\n";

    #[test]
    fn every_first_line_is_read() {
        for head in ["%YAML:1.0\n---\n", "%YAML 1.2\n---\n", "%YAML:1.0\n", "", "---\n"] {
            let root = read_file_storage("f.yml", format!("{head}{BODY}").as_bytes()).unwrap();
            let lines = head.lines().count();
            assert_eq!(root.get("a").unwrap().number(), Some(1.0));
            assert_eq!(root.get("a").unwrap().line, lines + 1, "{head}");
            let matrix = root.get("m").unwrap().matrix().unwrap();
            assert_eq!((matrix.rows, matrix.cols, matrix.data.len()), (1, 2, 4));
            assert!(
                matrix.data[1].is_nan() && matrix.data[2] == f64::NEG_INFINITY && matrix.data[3] == -0.25
            );
            let Value::List(names) = &root.get("names").unwrap().value else { panic!() };
            assert_eq!(names[0].text(), Some("x y"));
        }
    }

    #[test]
    fn what_is_no_map_is_refused_with_its_line() {
        let deep = "[".repeat(100_000);
        for text in
            ["", "%YAML:1.0\n---\n", "word", "- 1\n- 2\n", "a: [1, 2", "a: *b\n", "{[1]: 2}", "a: \"x", &deep]
        {
            let error = read_file_storage("f.yml", text.as_bytes()).unwrap_err();
            assert!(error.to_string().starts_with("f.yml:"), "{error}");
        }
        let matrix = |text: &str| read_file_storage("f", text.as_bytes()).unwrap().matrix().unwrap_err();
        assert!(matrix("rows: 2\ncols: 2\ndata: [1, 2, 3]\n").contains("2x2 with 3"));
        assert!(matrix("rows: 1\ncols: 1\ndata: [inf]\n").contains("`inf`"));
        assert!(matrix("rows: 1e9\ncols: 1e9\ndt: 4000000000d\ndata: []\n").contains("with 0 numbers"));
    }

    #[test]
    fn numbers_are_written_as_pyyaml_reads_them() {
        for (value, text) in [
            (0.0, "0."),
            (-3.0, "-3."),
            (536.0653752, "5.3606537519999995e+02"),
            (-1e-5, "-1.0000000000000001e-05"),
            (1e300, "1.0000000000000001e+300"),
        ] {
            assert_eq!(yaml_number(value), text);
            assert_eq!(parse_number(text.as_bytes()), Some(value));
        }
        assert_eq!(parse_number(yaml_number(-0.0).as_bytes()).map(f64::to_bits), Some((-0.0_f64).to_bits()));
    }
}
