//! Targets on the command line: `chessboard:9x6:25mm`.

use boresight_data::{CircleLayout, Dictionary, Geometry, Shape, Target};

use crate::Error;
use crate::number::parse_number;
use crate::seen::LIMIT;

/// The name of the target where a job has only one.
pub(crate) const TARGET_NAME: &str = "target";
/// The spacings that are believed, in metres: beyond them the unit was mistaken.
const SPACINGS_M: std::ops::RangeInclusive<f64> = 1e-4..=1.0;

/// Returns the target that `spec` describes. It is rigid; its shape is an option of the solve.
///
/// - `chessboard:9x6:25mm`: inner corners and spacing;
/// - `charuco:14x9:40mm:30mm:5x5_1000`: squares, sides of a square and of a marker, dictionary;
/// - `aprilgrid:6x6:88mm:0.3`: tags, side of a tag, the gap between tags as a share of it or as a length, and
///   `:36h11` or another family;
/// - `circles:7x6:20mm`, `acircles:4x11:20mm`: dots in a row and rows, distance of rows.
///
/// The unit (mm, cm, m or in) of a length is required.
pub fn parse_target(spec: &str) -> Result<Target, Error> {
    let wrong = |why: String| Error::TargetSpec { spec: spec.to_owned(), why };
    let parts: Vec<&str> = spec.trim().split(':').collect();
    let need = |counts: std::ops::RangeInclusive<usize>| {
        let (n, need) = (parts.len(), counts.start());
        let message = || wrong(format!("it has {n} parts separated by `:`, {need} are needed"));
        if counts.contains(&n) { Ok(()) } else { Err(message()) }
    };
    match parts[0] {
        "chessboard" => {
            need(3..=3)?;
            let [columns, rows] = size(parts[1]).map_err(wrong)?;
            chessboard(columns, rows, length_m(parts[2]).map_err(wrong)?).map_err(wrong)
        }
        "charuco" => {
            need(5..=5)?;
            let [columns, rows] = size(parts[1]).map_err(wrong)?;
            let (spacing_m, marker_m) =
                (length_m(parts[2]).map_err(wrong)?, length_m(parts[3]).map_err(wrong)?);
            check_grid([columns, rows], "squares", 3, spacing_m).map_err(wrong)?;
            if !(0.1 * spacing_m..spacing_m).contains(&marker_m) {
                return Err(wrong(format!(
                    "a marker of {marker_m} m does not fit in a square of {spacing_m} m: the square comes first"
                )));
            }
            let dictionary = dictionary(parts[4]).map_err(wrong)?;
            Ok(target(Geometry::Charuco { columns, rows, spacing_m, marker_m, dictionary }))
        }
        "aprilgrid" => {
            need(4..=5)?;
            let [columns, rows] = size(parts[1]).map_err(wrong)?;
            let tag_m = length_m(parts[2]).map_err(wrong)?;
            check_grid([columns, rows], "tags", 1, tag_m).map_err(wrong)?;
            let share = parse_number(parts[3].trim().as_bytes());
            let spacing = match share {
                Some(share) => share,
                None => length_m(parts[3]).map_err(wrong)? / tag_m,
            };
            if !(0.05..1.0).contains(&spacing) {
                return Err(wrong(format!(
                    "a gap of {spacing} of a tag is outside 0.05 to 1: the side of a tag comes first, then the gap"
                )));
            }
            let dictionary = match parts.get(4) {
                Some(name) => dictionary(name).map_err(wrong)?,
                None => Dictionary::APRILTAG_36H11,
            };
            Ok(target(Geometry::AprilGrid { columns, rows, tag_m, spacing, dictionary }))
        }
        "circles" | "acircles" => {
            need(3..=3)?;
            let [columns, rows] = size(parts[1]).map_err(wrong)?;
            let spacing_m = length_m(parts[2]).map_err(wrong)?;
            check_grid([columns, rows], "circles", 2, spacing_m).map_err(wrong)?;
            let layout = match parts[0] {
                "circles" => CircleLayout::Symmetric,
                _ => CircleLayout::Asymmetric,
            };
            Ok(target(Geometry::Circles { columns, rows, spacing_m, layout }))
        }
        kind => Err(wrong(format!("there is no target kind `{kind}`; known: {}", KINDS.join(", ")))),
    }
}

/// Returns how a target is written for [`parse_target`], lengths to a nanometre; `None` for a set of points.
pub fn target_spec(target: &Target) -> Option<String> {
    let short = |number: f64| {
        let text = format!("{number:.6}");
        text.trim_end_matches('0').trim_end_matches('.').to_owned()
    };
    let mm = |metres: f64| format!("{}mm", short(1e3 * metres));
    Some(match &target.geometry {
        Geometry::Chessboard { columns, rows, spacing_m } => {
            format!("chessboard:{columns}x{rows}:{}", mm(*spacing_m))
        }
        Geometry::Charuco { columns, rows, spacing_m, marker_m, dictionary } => {
            format!("charuco:{columns}x{rows}:{}:{}:{}", mm(*spacing_m), mm(*marker_m), dictionary.name())
        }
        Geometry::AprilGrid { columns, rows, tag_m, spacing, dictionary } => {
            format!("aprilgrid:{columns}x{rows}:{}:{}:{}", mm(*tag_m), short(*spacing), dictionary.name())
        }
        Geometry::Circles { columns, rows, spacing_m, layout } => {
            let kind = match layout {
                CircleLayout::Symmetric => "circles",
                CircleLayout::Asymmetric => "acircles",
            };
            format!("{kind}:{columns}x{rows}:{}", mm(*spacing_m))
        }
        Geometry::Points { .. } => return None,
    })
}

/// The kinds of targets that can be written in a line.
const KINDS: [&str; 5] = ["chessboard", "charuco", "aprilgrid", "circles", "acircles"];

fn target(geometry: Geometry) -> Target {
    Target { name: TARGET_NAME.to_owned(), geometry, shape: Shape::Rigid }
}

fn size(text: &str) -> Result<[u32; 2], String> {
    let sizes: Vec<&str> = text.split(['x', 'X', '×']).collect();
    let [columns, rows] = sizes[..] else { return Err(format!("the size `{text}` is not COLUMNSxROWS")) };
    let count = |text: &str| text.parse::<u32>().map_err(|_| format!("`{text}` is no number of corners"));
    Ok([count(columns)?, count(rows)?])
}

fn length_m(text: &str) -> Result<f64, String> {
    let unit_at = text.find(|c: char| c.is_alphabetic()).unwrap_or(text.len());
    let (number, unit) = text.split_at(unit_at);
    let metres: f64 = match unit {
        "mm" => 1e-3,
        "cm" => 1e-2,
        "m" => 1.0,
        "in" => 0.0254,
        "" => return Err(format!("the spacing `{text}` has no unit (mm, cm, m or in)")),
        other => return Err(format!("the spacing `{text}` has the unit `{other}`; known: mm, cm, m, in")),
    };
    let value = parse_number(number.trim().as_bytes()).filter(|value| value.is_finite());
    let value = value.ok_or_else(|| format!("`{number}` is no number"))?;
    // Dividing by 1000 is exact where multiplying by 0.001 is not.
    Ok(if metres < 0.02 { value / (1.0 / metres).round() } else { value * metres })
}

fn dictionary(name: &str) -> Result<Dictionary, String> {
    let known = || Dictionary::all().map(|dictionary| dictionary.name()).collect::<Vec<_>>().join(", ");
    Dictionary::named(name.trim())
        .ok_or_else(|| format!("there is no dictionary `{name}`; known: {}", known()))
}

/// Checks the size of a grid whose spacing is that of its squares, tags or dots.
fn check_grid([columns, rows]: [u32; 2], what: &str, least: u32, spacing_m: f64) -> Result<(), String> {
    for (name, value) in [("columns", columns), ("rows", rows)] {
        if value < least {
            return Err(format!("{name} = {value}: such a board has at least {least} {what} each way"));
        }
    }
    if u64::from(columns) * u64::from(rows) > LIMIT as u64 / 4 {
        return Err(format!("{columns}x{rows} {what} are more than {}", LIMIT / 4));
    }
    if !SPACINGS_M.contains(&spacing_m) {
        return Err(format!("{what} of {spacing_m} m are outside 0.0001 to 1 m; which unit was meant?"));
    }
    Ok(())
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
    Ok(target(Geometry::Chessboard { columns, rows, spacing_m }))
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
    fn every_kind_is_read() {
        let geometry = |spec: &str| parse_target(spec).unwrap().geometry;
        let dictionary = Dictionary::named("5x5_1000").unwrap();
        assert_eq!(
            geometry("charuco:14x9:40mm:30mm:5x5_1000"),
            Geometry::Charuco { columns: 14, rows: 9, spacing_m: 0.04, marker_m: 0.03, dictionary }
        );
        let grid = Geometry::AprilGrid {
            columns: 6,
            rows: 5,
            tag_m: 0.088,
            spacing: 0.3,
            dictionary: Dictionary::APRILTAG_36H11,
        };
        assert_eq!(geometry("aprilgrid:6x5:88mm:0.3"), grid);
        assert_eq!(geometry("aprilgrid:6x5:88mm:0.3:t36h11"), grid);
        let Geometry::AprilGrid { spacing, .. } = geometry("aprilgrid:6x5:88mm:26.4mm") else {
            panic!("a grid")
        };
        assert!((spacing - 0.3).abs() < 1e-12);
        let circles = |layout| Geometry::Circles { columns: 4, rows: 11, spacing_m: 0.02, layout };
        assert_eq!(geometry("circles:4x11:20mm"), circles(CircleLayout::Symmetric));
        assert_eq!(geometry("acircles:4x11:2cm"), circles(CircleLayout::Asymmetric));
    }

    #[test]
    fn targets_are_written_as_they_are_read() {
        for spec in [
            "chessboard:9x6:25.4mm",
            "charuco:14x9:40mm:30.5mm:5x5_1000",
            "aprilgrid:6x5:88mm:0.3:36h11",
            "circles:4x11:20mm",
            "acircles:4x11:58.8mm",
        ] {
            assert_eq!(target_spec(&parse_target(spec).unwrap()).as_deref(), Some(spec));
        }
    }

    #[test]
    fn mistakes_are_explained() {
        for (spec, part) in [
            ("", "no target kind ``"),
            ("charuco:14x9:40mm:30mm", "4 parts"),
            ("charuco:14x9:30mm:40mm:5x5_1000", "the square comes first"),
            ("charuco:14x9:40mm:30mm:5x6_1000", "no dictionary `5x6_1000`; known: 4x4_50"),
            ("charuco:14x2:40mm:30mm:5x5_1000", "rows = 2"),
            ("aprilgrid:6x6:88mm:3", "a gap of 3 of a tag"),
            ("aprilgrid:6x6:88:0.3", "no unit"),
            ("circles:1x6:20mm", "columns = 1"),
            ("acircles:99999x99999:20mm", "are more than"),
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
