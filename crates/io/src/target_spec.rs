//! Targets on the command line: `chessboard:9x6:25mm`.

use boresight_data::{Geometry, Shape, Target};

use crate::Error;
use crate::number::parse_number;
use crate::seen::LIMIT;

/// The name of the target where a job has only one.
pub(crate) const TARGET_NAME: &str = "target";
/// The spacings that are believed, in metres: beyond them the unit was mistaken.
const SPACINGS_M: std::ops::RangeInclusive<f64> = 1e-4..=1.0;

/// Returns the target that `spec` describes, such as `chessboard:9x6:25mm`: inner corners and spacing.
///
/// The unit (mm, cm, m or in) is required. The target is rigid; its shape is an option of the solve.
pub fn parse_target(spec: &str) -> Result<Target, Error> {
    let wrong = |why: String| Error::TargetSpec { spec: spec.to_owned(), why };
    let parts: Vec<&str> = spec.trim().split(':').collect();
    let [kind, size, spacing] = parts[..] else {
        return Err(wrong(format!("it has {} parts separated by `:`, 3 are needed", parts.len())));
    };
    if kind != "chessboard" {
        return Err(wrong(format!("there is no target kind `{kind}`; known: chessboard")));
    }
    let sizes: Vec<&str> = size.split(['x', 'X', '×']).collect();
    let [columns, rows] = sizes[..] else {
        return Err(wrong(format!("the size `{size}` is not COLUMNSxROWS")));
    };
    let count =
        |text: &str| text.parse::<u32>().map_err(|_| wrong(format!("`{text}` is no number of corners")));
    let (columns, rows) = (count(columns)?, count(rows)?);
    let unit_at = spacing.find(|c: char| c.is_alphabetic()).unwrap_or(spacing.len());
    let (number, unit) = spacing.split_at(unit_at);
    let metres: f64 = match unit {
        "mm" => 1e-3,
        "cm" => 1e-2,
        "m" => 1.0,
        "in" => 0.0254,
        "" => return Err(wrong(format!("the spacing `{spacing}` has no unit (mm, cm, m or in)"))),
        other => {
            return Err(wrong(format!(
                "the spacing `{spacing}` has the unit `{other}`; known: mm, cm, m, in"
            )));
        }
    };
    let value = parse_number(number.trim().as_bytes()).filter(|value| value.is_finite());
    let value = value.ok_or_else(|| wrong(format!("`{number}` is no number")))?;
    // Dividing by 1000 is exact where multiplying by 0.001 is not.
    let spacing_m = if metres < 0.02 { value / (1.0 / metres).round() } else { value * metres };
    chessboard(columns, rows, spacing_m).map_err(wrong)
}

/// Returns the chessboard, or what is wrong with its numbers.
pub(crate) fn chessboard(columns: u32, rows: u32, spacing_m: f64) -> Result<Target, String> {
    for (name, value) in [("columns", columns), ("rows", rows)] {
        if value < 2 {
            return Err(format!("{name} = {value}: a board has at least 2 inner corners each way"));
        }
    }
    if columns as usize * rows as usize > LIMIT {
        return Err(format!("{columns}x{rows} corners are more than {LIMIT}"));
    }
    if !SPACINGS_M.contains(&spacing_m) {
        let question = if (0.1..=1000.0).contains(&spacing_m) {
            format!("were millimetres meant? Then it is {} m", spacing_m / 1000.0)
        } else {
            "which unit was meant?".to_owned()
        };
        return Err(format!(
            "a spacing of {spacing_m} m between corners is outside 0.0001 to 1 m; {question}"
        ));
    }
    let geometry = Geometry::Chessboard { columns, rows, spacing_m };
    Ok(Target { name: TARGET_NAME.to_owned(), geometry, shape: Shape::Rigid })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Kind;

    #[test]
    fn specifications_are_read() {
        for (spec, expected) in [
            ("chessboard:9x6:25mm", (9, 6, 0.025)),
            ("chessboard:9x6:30mm", (9, 6, 0.03)),
            ("chessboard:10x7:2.54cm", (10, 7, 0.0254)),
            ("chessboard:10X7:1in", (10, 7, 0.0254)),
            (" chessboard:2x2:0.1m ", (2, 2, 0.1)),
        ] {
            let target = parse_target(spec).unwrap();
            let Geometry::Chessboard { columns, rows, spacing_m } = target.geometry else {
                panic!("{target:?}")
            };
            assert_eq!((columns, rows, spacing_m), expected, "{spec}");
        }
    }

    #[test]
    fn mistakes_are_explained() {
        for (spec, part) in [
            ("", "1 parts"),
            ("chessboard:9x6", "2 parts"),
            ("chesboard:9x6:25mm", "no target kind `chesboard`"),
            ("chessboard:9:25mm", "`9` is not COLUMNSxROWS"),
            ("chessboard:9x-6:25mm", "`-6` is no number"),
            ("chessboard:9x1:25mm", "rows = 1"),
            ("chessboard:9x6:25", "no unit"),
            ("chessboard:9x6:25km", "unit `km`"),
            ("chessboard:9x6:mm", "`` is no number"),
            ("chessboard:9x6:25m", "were millimetres meant? Then it is 0.025 m"),
            ("chessboard:9x6:0.025mm", "outside 0.0001 to 1 m"),
            ("chessboard:9x6:nanmm", "unit"),
            ("chessboard:4294967295x4294967295:25mm", "more than"),
        ] {
            let error = parse_target(spec).unwrap_err();
            assert!(error.to_string().contains(part), "{spec}: {error}");
            assert_eq!(error.kind(), Kind::Usage);
            assert!(error.hint().unwrap().contains("chessboard:9x6:25mm"));
        }
    }
}
