//! Geometries of targets in `calibration.json`.

use boresight_data::{CircleLayout, Dictionary, Geometry, Target};

use crate::Error;
use crate::calibration_document::{GeometryDocument, LayoutDocument};

/// Returns the document of a target's geometry.
pub(crate) fn write(target: &Target) -> Result<GeometryDocument, Error> {
    let check = |value: f64, what: &str| match value.is_finite() {
        true => Ok(()),
        false => Err(Error::NotFinite { at: format!("{what} of {}", target.name), value }),
    };
    Ok(match target.geometry {
        Geometry::Chessboard { columns, rows, spacing_m } => {
            check(spacing_m, "the spacing")?;
            GeometryDocument::Chessboard { columns, rows, spacing_m }
        }
        Geometry::Charuco { columns, rows, spacing_m, marker_m, dictionary } => {
            check(spacing_m, "the spacing")?;
            check(marker_m, "the marker")?;
            let dictionary = dictionary.name().to_owned();
            GeometryDocument::Charuco { columns, rows, spacing_m, marker_m, dictionary }
        }
        Geometry::AprilGrid { columns, rows, tag_m, spacing, dictionary } => {
            check(tag_m, "the tag")?;
            check(spacing, "the spacing")?;
            let dictionary = dictionary.name().to_owned();
            GeometryDocument::AprilGrid { columns, rows, tag_m, spacing, dictionary }
        }
        Geometry::Circles { columns, rows, spacing_m, layout } => {
            check(spacing_m, "the spacing")?;
            let layout = match layout {
                CircleLayout::Symmetric => LayoutDocument::Symmetric,
                CircleLayout::Asymmetric => LayoutDocument::Asymmetric,
            };
            GeometryDocument::Circles { columns, rows, spacing_m, layout }
        }
        Geometry::Points { ref points_m } => {
            points_m.iter().flatten().try_for_each(|value| check(*value, "a point"))?;
            GeometryDocument::Points { points_m: points_m.clone() }
        }
    })
}

/// Returns the geometry of a document, or the value that is wrong and what is needed.
pub(crate) fn read(document: GeometryDocument) -> Result<Geometry, (String, &'static str)> {
    let grid = |columns: u32, rows: u32, least: u32, lengths: &[f64]| {
        let is_grid = columns >= least
            && rows >= least
            && u64::from(columns) * u64::from(rows) <= crate::seen::LIMIT as u64 / 4
            && lengths.iter().all(|length| *length > 0.0 && length.is_finite());
        let value = || format!("{columns}x{rows} at {} m", lengths[0]);
        if is_grid { Ok(()) } else { Err((value(), "a grid has corners and a spacing")) }
    };
    let dictionary =
        |name: String| Dictionary::named(&name).ok_or((name, "a dictionary of markers that is known"));
    Ok(match document {
        GeometryDocument::Chessboard { columns, rows, spacing_m } => {
            grid(columns, rows, 1, &[spacing_m])?;
            Geometry::Chessboard { columns, rows, spacing_m }
        }
        GeometryDocument::Charuco { columns, rows, spacing_m, marker_m, dictionary: name } => {
            grid(columns, rows, 2, &[spacing_m, marker_m])?;
            Geometry::Charuco { columns, rows, spacing_m, marker_m, dictionary: dictionary(name)? }
        }
        GeometryDocument::AprilGrid { columns, rows, tag_m, spacing, dictionary: name } => {
            grid(columns, rows, 1, &[tag_m, spacing])?;
            Geometry::AprilGrid { columns, rows, tag_m, spacing, dictionary: dictionary(name)? }
        }
        GeometryDocument::Circles { columns, rows, spacing_m, layout } => {
            grid(columns, rows, 1, &[spacing_m])?;
            let layout = match layout {
                LayoutDocument::Symmetric => CircleLayout::Symmetric,
                LayoutDocument::Asymmetric => CircleLayout::Asymmetric,
            };
            Geometry::Circles { columns, rows, spacing_m, layout }
        }
        GeometryDocument::Points { points_m } => Geometry::Points { points_m },
    })
}

#[cfg(test)]
mod tests {
    use boresight_data::Shape;

    use super::*;

    #[test]
    fn every_kind_comes_back() {
        for spec in [
            "chessboard:9x6:25mm",
            "charuco:14x9:40mm:30mm:5x5_1000",
            "aprilgrid:6x6:88mm:0.3",
            "circles:7x6:20mm",
            "acircles:4x11:20mm",
        ] {
            let target = crate::parse_target(spec).unwrap();
            let text = serde_json::to_string(&write(&target).unwrap()).unwrap();
            assert_eq!(read(serde_json::from_str(&text).unwrap()), Ok(target.geometry), "{text}");
        }
        let geometry =
            Geometry::Circles { columns: 2, rows: 2, spacing_m: f64::NAN, layout: CircleLayout::Symmetric };
        let target = Target { name: "dots".to_owned(), geometry, shape: Shape::Rigid };
        assert!(write(&target).is_err());
    }

    #[test]
    fn nonsense_is_refused() {
        for text in [
            r#"{"kind":"charuco","columns":1,"rows":5,"spacing_m":0.1,"marker_m":0.05,"dictionary":"4x4_50"}"#,
            r#"{"kind":"charuco","columns":5,"rows":5,"spacing_m":0.1,"marker_m":0.05,"dictionary":"9x9_50"}"#,
            r#"{"kind":"april_grid","columns":5,"rows":5,"tag_m":0.1,"spacing":0,"dictionary":"36h11"}"#,
            r#"{"kind":"circles","columns":0,"rows":5,"spacing_m":0.1,"layout":"symmetric"}"#,
            r#"{"kind":"chessboard","columns":4294967295,"rows":4294967295,"spacing_m":0.1}"#,
        ] {
            assert!(read(serde_json::from_str(text).unwrap()).is_err(), "{text}");
        }
    }
}
