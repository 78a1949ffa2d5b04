//! A target's print as a drawing to scale.

use std::fmt::Write as _;

use boresight_data::Target;

use crate::drawing::{Drawing, Print};
use crate::paper::Paper;

/// The lengths of the line by which a print is checked, in millimetres: the longest that the sheet has room for.
const RULERS_MM: [f64; 4] = [200.0, 100.0, 50.0, 20.0];
/// What printers leave white around a sheet, in millimetres.
const LEAST_MARGIN_MM: f64 = 10.0;
/// The room below the target for the line and its caption, in millimetres; as much is left above it for looks.
const FOOT_MM: f64 = 12.0;
/// The width of a letter in units of its height, at most on average.
const LETTER_WIDTH: f64 = 0.6;
/// The height of letters in millimetres, where there is room.
const LETTERS_MM: f64 = 3.0;
/// More points than any print has, and as many as are drawn at once.
const MOST_POINTS: usize = 100_000;

/// A target on paper.
#[derive(Clone, Debug, PartialEq)]
pub struct Sheet {
    /// The drawing, in millimetres.
    pub svg: String,
    /// The paper, its sides as width and height.
    pub paper: Paper,
    /// Width and height of all that is printed of the target, in millimetres.
    pub printed_mm: [f64; 2],
    /// The length of the line by which the print is checked, in millimetres.
    pub ruler_mm: f64,
}

/// Why a target is not drawn.
#[derive(Clone, Debug, PartialEq)]
pub enum NotDrawn {
    /// A set of points has no drawing.
    OnlyPoints,
    /// The paper is too small.
    TooLarge {
        /// Width and height that are needed, margins and the line to check the print by included, in millimetres.
        needed_mm: [f64; 2],
        /// The paper; the largest that was tried, if none was named.
        paper: Paper,
    },
    /// There are more points than anybody prints.
    TooMany {
        /// The number of points.
        points: usize,
        /// How many there may be.
        most: usize,
    },
}

/// Returns a target as it looks from its printed side, black on white and to scale, in the middle of a sheet; below it
/// a caption and a line to check the print by. The sheet lies or stands, whichever leaves the wider margin. Without a
/// paper it is the smallest of A4 to A0 with room.
pub fn sheet(
    target: &Target,
    print: &Print,
    paper: Option<&Paper>,
    caption: &str,
) -> Result<Sheet, NotDrawn> {
    let points = target.point_count();
    if points > MOST_POINTS {
        return Err(NotDrawn::TooMany { points, most: MOST_POINTS });
    }
    let drawing = Drawing::new(target, print).ok_or(NotDrawn::OnlyPoints)?;
    let (low, high) = drawing.printed();
    let printed_mm = [0, 1].map(|axis| (high[axis] - low[axis]) * 1e3 * drawing.unit_m);
    let shortest_mm = RULERS_MM.iter().copied().fold(f64::INFINITY, f64::min);
    let needed_mm = [
        printed_mm[0].max(shortest_mm) + 2.0 * LEAST_MARGIN_MM,
        printed_mm[1] + 2.0 * LEAST_MARGIN_MM + FOOT_MM,
    ];
    let has_room = |size: &[f64; 2]| (0..2).all(|axis| size[axis] >= needed_mm[axis] - 1e-9);
    let spare = |size: &[f64; 2]| (size[0] - needed_mm[0]).min(size[1] - needed_mm[1]);
    let turned = |paper: &Paper| {
        let [a, b] = paper.size_mm;
        let either = [[a, b], [b, a]].into_iter().filter(has_room);
        let size_mm = either.reduce(|one, other| if spare(&other) > spare(&one) { other } else { one })?;
        Some(Paper { name: paper.name.clone(), size_mm })
    };
    let too_large = |paper: Paper| NotDrawn::TooLarge { needed_mm, paper };
    let paper = match paper {
        Some(paper) => turned(paper).ok_or_else(|| too_large(paper.clone()))?,
        None => {
            let mut found = Err(NotDrawn::OnlyPoints);
            for tried in Paper::tried() {
                found = turned(&tried).ok_or_else(|| too_large(tried));
                if found.is_ok() {
                    break;
                }
            }
            found?
        }
    };
    let room_mm = paper.size_mm[0] - 2.0 * LEAST_MARGIN_MM;
    let ruler_mm = RULERS_MM.into_iter().find(|ruler| *ruler <= room_mm).unwrap_or(shortest_mm);
    let svg = drawn(&drawing, paper.size_mm, printed_mm, ruler_mm, caption);
    Ok(Sheet { svg, paper, printed_mm, ruler_mm })
}

/// Returns the drawing on a sheet that has room for it.
fn drawn(
    drawing: &Drawing,
    [width_mm, height_mm]: [f64; 2],
    printed_mm: [f64; 2],
    ruler_mm: f64,
    caption: &str,
) -> String {
    let unit_mm = 1e3 * drawing.unit_m;
    let (low, high) = drawing.printed();
    let left_mm = 0.5 * (width_mm - printed_mm[0]);
    // In the middle of the sheet, unless the foot is in the way.
    let top_mm =
        (0.5 * (height_mm - printed_mm[1])).min(height_mm - FOOT_MM - LEAST_MARGIN_MM - printed_mm[1]);
    let is_up = drawing.front > 0.0;
    // From units of the drawing to millimetres on paper, which count down.
    let x_mm = |x: f64| left_mm + (x - low[0]) * unit_mm;
    let y_mm = |y: f64| top_mm + if is_up { high[1] - y } else { y - low[1] } * unit_mm;
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
        // Runs of ink along each row between two edges; all in one path, so that no seams show between rows.
        text.push_str("<path fill=\"#000\" d=\"\n");
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
    let foot_mm = height_mm - LEAST_MARGIN_MM;
    let line_x = [LEAST_MARGIN_MM, LEAST_MARGIN_MM + ruler_mm].map(short);
    let _ = writeln!(
        text,
        "<path fill=\"none\" stroke=\"#000\" stroke-width=\"0.2\" d=\"M{0} {y}H{1}M{0} {top}v3M{1} {top}v3\"/>",
        line_x[0],
        line_x[1],
        y = short(foot_mm - 6.0),
        top = short(foot_mm - 7.5)
    );
    let words = format!("{caption}; print at 100 %: from stroke to stroke {} mm", short(ruler_mm));
    let room = (width_mm - 2.0 * LEAST_MARGIN_MM) / (LETTER_WIDTH * words.chars().count() as f64);
    let _ = writeln!(
        text,
        "<text x=\"{}\" y=\"{}\" font-family=\"sans-serif\" font-size=\"{}\">{}</text>",
        line_x[0],
        short(foot_mm - 1.0),
        short(room.min(LETTERS_MM)),
        escaped(&words)
    );
    text.push_str("</svg>\n");
    text
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

    fn on_paper(geometry: Geometry, paper: &str) -> Result<Sheet, NotDrawn> {
        let target = Target { name: "t".to_owned(), geometry, shape: Shape::Rigid };
        let paper = Paper::parse(paper);
        sheet(&target, &Print::default(), paper.as_ref(), "a < b")
    }

    fn chessboard(columns: u32, rows: u32, spacing_m: f64) -> Geometry {
        Geometry::Chessboard { columns, rows, spacing_m }
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
        let made = on_paper(chessboard(9, 6, 0.025), "300x237mm").unwrap();
        let text = &made.svg;
        assert!(text.contains("width=\"300mm\" height=\"237mm\" viewBox=\"0 0 300 237\""), "{text}");
        assert_eq!((made.printed_mm, made.ruler_mm), ([250.0, 175.0], 200.0));
        let found = rectangles(text);
        assert_eq!(found.len(), 35);
        let area: f64 = found.iter().map(|[left, top, right, bottom]| (right - left) * (bottom - top)).sum();
        assert!((area - 35.0 * 625.0).abs() < 1e-6, "{area}");
        // In the middle, (300 - 250) / 2 and (237 - 175) / 2 from the corner.
        assert!(is_ink(&found, 26.0, 32.0) && !is_ink(&found, 51.0, 32.0) && is_ink(&found, 51.0, 57.0));
        assert!(!is_ink(&found, 24.9, 32.0) && !is_ink(&found, 26.0, 30.9));
        assert!(text.contains("a &lt; b"));
    }

    #[test]
    fn sheets_have_room_or_are_refused() {
        let made = on_paper(chessboard(9, 6, 0.025), "").unwrap();
        // 270 x 207 mm with margins and foot: A4 on its side has room.
        assert_eq!((made.paper.name.as_str(), made.paper.size_mm), ("A4", [297.0, 210.0]));
        let lowest = rectangles(&made.svg).iter().map(|[.., bottom]| *bottom).fold(0.0, f64::max);
        assert!(lowest <= 210.0 - LEAST_MARGIN_MM - FOOT_MM + 1e-9, "{lowest}");
        assert_eq!(on_paper(chessboard(6, 9, 0.025), "a4").unwrap().paper.size_mm, [210.0, 297.0]);
        assert_eq!(on_paper(chessboard(9, 6, 0.04), "").unwrap().paper.name, "A2");
        let Err(NotDrawn::TooLarge { needed_mm, paper }) = on_paper(chessboard(9, 6, 0.026), "letter") else {
            panic!("a board of 260 x 182 mm with its margins and foot is no letter");
        };
        assert_eq!((needed_mm.map(f64::round), paper.size_mm), ([280.0, 214.0], [215.9, 279.4]));
        assert!(on_paper(chessboard(9, 6, 0.025), "letter").is_ok());
        let Err(NotDrawn::TooLarge { paper, .. }) = on_paper(chessboard(9, 6, 0.2), "") else {
            panic!("2000 x 1400 mm are more than A0");
        };
        assert_eq!(paper.name, "A0");
        // A small sheet has a short line.
        let small = on_paper(chessboard(2, 2, 0.01), "80x80mm").unwrap();
        assert_eq!(small.ruler_mm, 50.0);
        assert!(on_paper(chessboard(2, 2, 0.001), "36x90mm").is_ok_and(|made| made.ruler_mm == 50.0));
        // What is told to be needed is more than there is.
        let Err(NotDrawn::TooLarge { needed_mm, .. }) = on_paper(chessboard(2, 2, 0.001), "30x35mm") else {
            panic!("the line is 20 mm long and has 10 mm to either side");
        };
        assert_eq!(needed_mm, [40.0, 35.0]);
    }

    #[test]
    fn markers_and_tags_stand_upright() {
        let dictionary = Dictionary::named("4x4_50").unwrap();
        let geometry = Geometry::Charuco { columns: 5, rows: 4, spacing_m: 0.06, marker_m: 0.03, dictionary };
        // 300 x 240 mm with 60 mm around it.
        let found = rectangles(&on_paper(geometry, "420x360mm").unwrap().svg);
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
        // 275 x 150 mm with the small squares, with 125 mm around it.
        let found = rectangles(&on_paper(geometry, "525x400mm").unwrap().svg);
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
        let text = on_paper(geometry, "").unwrap().svg;
        assert_eq!(text.matches("<circle").count(), 12);
        assert!(text.contains("r=\"6\""), "{text}");
        let points = Geometry::Points { points_m: vec![[0.0; 3]; 4] };
        assert_eq!(on_paper(points, ""), Err(NotDrawn::OnlyPoints));
    }

    #[test]
    fn what_nobody_prints_is_refused_before_it_is_drawn() {
        let drawn = on_paper(chessboard(100_000, 100_000, 1e-5), "2000x2000mm");
        assert_eq!(drawn, Err(NotDrawn::TooMany { points: 10_000_000_000, most: 100_000 }));
    }
}
