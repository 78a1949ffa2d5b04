//! A target's print as a drawing to scale.

use std::fmt::Write as _;

use boresight_data::Target;

use crate::drawing::{Drawing, Print};

/// The length of the line by which a print is checked, in millimetres.
const RULER_MM: f64 = 100.0;
/// The least white margin around what is printed, in millimetres.
const LEAST_MARGIN_MM: f64 = 10.0;
/// The room below the target for the line and its caption, in millimetres.
const FOOT_MM: f64 = 12.0;

/// Returns an SVG of a target in millimetres, as it looks from its printed side: black on white with a margin of a square, tag or
/// distance of dots, and below it `caption` and a line of 100 mm to check the print by. `None` for a set of points.
pub fn svg(target: &Target, print: &Print, caption: &str) -> Option<String> {
    let drawing = Drawing::new(target, print)?;
    let unit_mm = 1e3 * drawing.unit_m;
    let (low, high) = drawing.printed();
    let margin_mm = unit_mm.max(LEAST_MARGIN_MM);
    let size_mm = [0, 1].map(|axis| (high[axis] - low[axis]) * unit_mm + 2.0 * margin_mm);
    // A narrow target must leave room for the line.
    let width_mm = size_mm[0].max(RULER_MM + 2.0 * LEAST_MARGIN_MM);
    let left_mm = 0.5 * (width_mm - (high[0] - low[0]) * unit_mm);
    let is_up = drawing.front > 0.0;
    // From units of the drawing to millimetres on paper, which count down.
    let x_mm = |x: f64| left_mm + (x - low[0]) * unit_mm;
    let y_mm = |y: f64| margin_mm + if is_up { high[1] - y } else { y - low[1] } * unit_mm;
    let height_mm = size_mm[1] + FOOT_MM;
    let mut text = String::new();
    // Writing to a string cannot fail.
    let _ = writeln!(
        text,
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{0}mm\" height=\"{1}mm\" viewBox=\"0 0 {0} {1}\">",
        short(width_mm),
        short(height_mm)
    );
    let _ = writeln!(text, "<title>{}</title>", escaped(caption));
    text.push_str("<rect width=\"100%\" height=\"100%\" fill=\"#fff\"/>\n");
    if let Some((dots, radius)) = drawing.dots() {
        text.push_str("<g fill=\"#000\">\n");
        for [x, y] in dots {
            let [x, y, r] = [x_mm(*x), y_mm(*y), radius * unit_mm].map(short);
            let _ = writeln!(text, "<circle cx=\"{x}\" cy=\"{y}\" r=\"{r}\"/>");
        }
        text.push_str("</g>\n");
    } else {
        // Runs of ink along each row between two edges; crisp, so that no seams show between rows.
        text.push_str("<path fill=\"#000\" shape-rendering=\"crispEdges\" d=\"\n");
        let [columns, rows] = [0, 1].map(|axis| drawing.boundaries(low[axis], high[axis]));
        for row in rows.windows(2) {
            let middle_y = 0.5 * (row[0] + row[1]);
            let mut begin = None;
            for column in columns.windows(2) {
                let is_ink = drawing.is_ink([0.5 * (column[0] + column[1]), middle_y]);
                match (is_ink, begin) {
                    (true, None) => begin = Some(column[0]),
                    (false, Some(from)) => {
                        push_rectangle(
                            &mut text,
                            [x_mm(from), x_mm(column[0])],
                            [y_mm(row[0]), y_mm(row[1])],
                        );
                        begin = None;
                    }
                    _ => {}
                }
            }
            if let (Some(from), Some(to)) = (begin, columns.last()) {
                push_rectangle(&mut text, [x_mm(from), x_mm(*to)], [y_mm(row[0]), y_mm(row[1])]);
            }
        }
        text.push_str("\"/>\n");
    }
    let (line_y, line_x) = (short(height_mm - 9.0), [LEAST_MARGIN_MM, LEAST_MARGIN_MM + RULER_MM].map(short));
    let _ = writeln!(
        text,
        "<path stroke=\"#000\" stroke-width=\"0.2\" d=\"M{0} {y}H{1}M{0} {top}v2M{1} {top}v2\"/>",
        line_x[0],
        line_x[1],
        y = line_y,
        top = short(height_mm - 10.0)
    );
    let _ = writeln!(
        text,
        "<text x=\"{}\" y=\"{}\" font-family=\"sans-serif\" font-size=\"3\">{}; print at 100 %: the line is {RULER_MM} mm long</text>",
        line_x[0],
        short(height_mm - 4.0),
        escaped(caption)
    );
    text.push_str("</svg>\n");
    Some(text)
}

fn push_rectangle(text: &mut String, x_mm: [f64; 2], y_mm: [f64; 2]) {
    let (top, bottom) = (y_mm[0].min(y_mm[1]), y_mm[0].max(y_mm[1]));
    let [x, to, y, down] = [x_mm[0], x_mm[1], top, bottom].map(short);
    let _ = writeln!(text, "M{x} {y}H{to}V{down}H{x}z");
}

/// Returns a number of millimetres to a hundred-thousandth, without zeros at its end.
fn short(mm: f64) -> String {
    let text = format!("{mm:.5}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}

#[cfg(test)]
mod tests {
    use boresight_data::{CircleLayout, Dictionary, Geometry, Shape};

    use super::*;

    fn drawn(geometry: Geometry) -> String {
        let target = Target { name: "t".to_owned(), geometry, shape: Shape::Rigid };
        svg(&target, &Print::default(), "a < b").unwrap()
    }

    /// Returns the rectangles as [left, top, right, bottom].
    fn rectangles(svg: &str) -> Vec<[f64; 4]> {
        let numbers = |line: &str| {
            let parts = line.strip_prefix('M')?.strip_suffix('z')?;
            let all: Vec<f64> =
                parts.split([' ', 'H', 'V']).map(|part| part.parse().ok()).collect::<Option<_>>()?;
            Some([all[0], all[1], all[2], all[3]])
        };
        svg.lines().filter_map(numbers).collect()
    }

    /// Returns the ink at a place in millimetres.
    fn is_ink(rectangles: &[[f64; 4]], x: f64, y: f64) -> bool {
        rectangles.iter().any(|[left, top, right, bottom]| x > *left && x < *right && y > *top && y < *bottom)
    }

    #[test]
    fn a_chessboard_is_to_scale() {
        let text = drawn(Geometry::Chessboard { columns: 9, rows: 6, spacing_m: 0.025 });
        // 10x7 squares of 25 mm, a margin of one on each side, and the foot.
        assert!(text.contains("width=\"300mm\" height=\"237mm\" viewBox=\"0 0 300 237\""), "{text}");
        let found = rectangles(&text);
        assert_eq!(found.len(), 35);
        let area: f64 = found.iter().map(|[left, top, right, bottom]| (right - left) * (bottom - top)).sum();
        assert!((area - 35.0 * 625.0).abs() < 1e-6, "{area}");
        assert!(is_ink(&found, 26.0, 26.0) && !is_ink(&found, 51.0, 26.0) && is_ink(&found, 51.0, 51.0));
        assert!(text.contains("a &lt; b"));
    }

    #[test]
    fn markers_and_tags_stand_upright() {
        let dictionary = Dictionary::named("4x4_50").unwrap();
        let geometry = Geometry::Charuco { columns: 5, rows: 4, spacing_m: 0.06, marker_m: 0.03, dictionary };
        let found = rectangles(&drawn(geometry));
        // Marker 0, 1011 0101 0011 0010 with white ones, in the middle of the second square; modules of 5 mm.
        let letters = |row: usize| -> String {
            let at = |column: usize| {
                [120.0 + 15.0 + 5.0 * column as f64 + 2.5, 60.0 + 15.0 + 5.0 * row as f64 + 2.5]
            };
            (0..6)
                .map(|column| if is_ink(&found, at(column)[0], at(column)[1]) { '#' } else { '.' })
                .collect()
        };
        assert_eq!(
            [0, 1, 2, 3, 4, 5].map(letters),
            ["######", "#.#..#", "##.#.#", "###..#", "###.##", "######"]
        );
        let dictionary = Dictionary::APRILTAG_36H11;
        let geometry = Geometry::AprilGrid { columns: 2, rows: 1, tag_m: 0.1, spacing: 0.25, dictionary };
        let found = rectangles(&drawn(geometry));
        // Kalibr's tags lie upside down; of the first, the last row of bits is at the top, from its end.
        let last_row = dictionary.codes()[0] & 0b11_1111;
        let module = 10.0;
        // Margin of a unit of 125 mm and the small square of 25 mm, then a border of two modules.
        let from = 125.0 + 25.0 + 2.0 * module;
        for bit in 0..6 {
            let is_white = last_row >> bit & 1 == 1;
            let x = from + module * (bit as f64 + 0.5);
            assert_eq!(is_ink(&found, x, from + 0.5 * module), !is_white, "{bit}");
        }
    }

    #[test]
    fn dots_are_circles() {
        let geometry =
            Geometry::Circles { columns: 4, rows: 3, spacing_m: 0.02, layout: CircleLayout::Asymmetric };
        let text = drawn(geometry);
        assert_eq!(text.matches("<circle").count(), 12);
        assert!(text.contains("r=\"6\""), "{text}");
        let points = Geometry::Points { points_m: vec![[0.0; 3]; 4] };
        let target = Target { name: "t".to_owned(), geometry: points, shape: Shape::Rigid };
        assert_eq!(svg(&target, &Print::default(), ""), None);
    }
}
