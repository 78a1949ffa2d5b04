//! Prints of targets: the sheet that is drawn, as a scanner sees it, is detected whole and to scale.

use boresight_data::{CircleLayout, Dictionary, Geometry, GrayImage, GrayPixels, PointId, Shape, Target};
use boresight_detect::{Missed, Pattern, detect};
use boresight_synthetic::{FirstSquare, Paper, Print, sheet};

/// Pixels for each millimetre: 101.6 dpi.
const PX_PER_MM: f64 = 4.0;
/// The desk on which the sheet lies shows so far around it, in millimetres.
const DESK_MM: f64 = 7.3;

/// Returns the rectangles (left, top, right, bottom) and circles (x, y, radius) of a drawing, in millimetres.
fn shapes(svg: &str) -> (Vec<[f64; 4]>, Vec<[f64; 3]>) {
    let rectangle = |line: &str| -> Option<[f64; 4]> {
        let parts = line.strip_prefix('M')?.strip_suffix('z')?.split([' ', 'H', 'V']);
        let all: Vec<f64> = parts.map(|part| part.parse().ok()).collect::<Option<_>>()?;
        // M left top H right V bottom H left z
        (all.len() == 5 && all[4] == all[0]).then(|| [all[0], all[1], all[2], all[3]])
    };
    let circle = |line: &str| -> Option<[f64; 3]> {
        let value = |key: &str| line.split_once(key)?.1.split('"').next()?.parse::<f64>().ok();
        Some([value("cx=\"")?, value("cy=\"")?, value("r=\"")?])
    };
    let circles = svg.lines().filter(|line| line.starts_with("<circle")).map(|line| circle(line).unwrap());
    (svg.lines().filter_map(rectangle).collect(), circles.collect())
}

/// Returns the sheet as a scanner sees it, each pixel the mean over its square.
fn scanned(svg: &str, size_mm: [f64; 2]) -> GrayImage {
    let [width, height] = size_mm.map(|side| ((side + 2.0 * DESK_MM) * PX_PER_MM).round() as usize);
    let px = |mm: f64| (mm + DESK_MM) * PX_PER_MM;
    // The share of the pixel from i to i + 1 that lies between two places.
    let share = |i: usize, from: f64, to: f64| (to.min(i as f64 + 1.0) - from.max(i as f64)).max(0.0);
    let touched = |from: f64, to: f64, most: usize| from.floor() as usize..(to.ceil() as usize).min(most);
    let mut values = vec![90.0; width * height];
    let mut lay = |[left, top, right, bottom]: [f64; 4], grey: f64| {
        for y in touched(top, bottom, height) {
            for x in touched(left, right, width) {
                let covered = share(x, left, right) * share(y, top, bottom);
                values[y * width + x] += covered * (grey - 255.0);
            }
        }
    };
    // Paper first: what it covers becomes white.
    let sheet = [0.0, 0.0, size_mm[0], size_mm[1]].map(px);
    lay(sheet, 255.0 + 220.0 - 90.0);
    let (rectangles, circles) = shapes(svg);
    assert!(rectangles.is_empty() != circles.is_empty());
    for rectangle in rectangles {
        lay(rectangle.map(px), 255.0 + 30.0 - 220.0);
    }
    for [x, y, radius] in circles {
        // In strips of a sixteenth of a pixel.
        let [x, y, radius] = [px(x), px(y), radius * PX_PER_MM];
        let strips = (32.0 * radius) as usize;
        for strip in 0..strips {
            let [from, to] = [strip, strip + 1].map(|i| y - radius + 2.0 * radius * i as f64 / strips as f64);
            let half = (radius * radius - (0.5 * (from + to) - y).powi(2)).max(0.0).sqrt();
            lay([x - half, from, x + half, to], 255.0 + 30.0 - 220.0);
        }
    }
    let eight = values.iter().map(|value| value.round() as u8).collect();
    GrayImage::new([width as u32, height as u32], GrayPixels::Eight(eight)).unwrap()
}

/// Prints a target, scans it, and holds what is detected against where it should be.
fn check(geometry: Geometry, print: &Print, paper: &str) -> Option<Pattern> {
    let target = Target { name: "t".to_owned(), geometry, shape: Shape::Rigid };
    let made = sheet(&target, print, Paper::parse(paper).as_ref(), "a print").unwrap();
    let found = detect(&scanned(&made.svg, made.paper.size_mm), &target);
    let of = format!("{:?} on {}", target.geometry, made.paper.name);
    assert_eq!(found.missed, None, "{of}");
    assert_eq!(found.observations.len(), target.point_count(), "{of}");
    // The frame of an AprilGrid has y upwards; symmetric grids may be taken upside down.
    let up = if matches!(target.geometry, Geometry::AprilGrid { .. }) { -1.0 } else { 1.0 };
    let drawn_px = |point: PointId| {
        let at = target.drawn_point(point);
        [at.x * 1e3 * PX_PER_MM, up * at.y * 1e3 * PX_PER_MM]
    };
    let n = found.observations.len() as f64;
    let worst = [1.0, -1.0].map(|sense| {
        let off = |axis: usize| {
            let each = found.observations.iter();
            let off = move |o: &boresight_data::Observation| o.pixel[axis] - sense * drawn_px(o.point)[axis];
            each.map(off).collect::<Vec<f64>>()
        };
        let spread = |off: Vec<f64>| {
            let mean = off.iter().sum::<f64>() / n;
            off.iter().map(|off| (off - mean).abs()).fold(0.0, f64::max)
        };
        spread(off(0)).max(spread(off(1)))
    });
    // To a fifteenth of a pixel, 0.017 mm, over the whole sheet: positions on paper are what the job says.
    let worst = worst[0].min(worst[1]);
    assert!(worst < 0.07, "{of}: {worst} px");
    found.pattern
}

#[test]
fn whatever_is_printed_is_detected_whole_and_to_scale() {
    let print = Print::default();
    let chessboard = |columns, rows, spacing_m| Geometry::Chessboard { columns, rows, spacing_m };
    // With as little margin as a sheet may leave, too.
    for (columns, rows, spacing_m, paper) in
        [(9, 6, 0.025, "A4"), (6, 9, 0.025, "A4"), (10, 7, 0.02, "letter")]
    {
        check(chessboard(columns, rows, spacing_m), &print, paper);
    }
    let charuco = |columns, rows, name: &str| {
        let dictionary = Dictionary::named(name).unwrap();
        Geometry::Charuco { columns, rows, spacing_m: 0.03, marker_m: 0.022, dictionary }
    };
    assert_eq!(check(charuco(8, 6, "5x5_1000"), &print, ""), Some(Pattern::Current));
    assert_eq!(check(charuco(5, 7, "4x4_50"), &print, ""), Some(Pattern::Current));
    let legacy = Print { first_square: FirstSquare::White, ..print };
    assert_eq!(check(charuco(8, 6, "5x5_1000"), &legacy, ""), Some(Pattern::Legacy));
    for tag_border in [1, 2] {
        let dictionary = Dictionary::APRILTAG_36H11;
        let grid = Geometry::AprilGrid { columns: 5, rows: 3, tag_m: 0.04, spacing: 0.3, dictionary };
        check(grid, &Print { tag_border, ..print }, "");
    }
    let circles = |columns, rows, layout| Geometry::Circles { columns, rows, spacing_m: 0.02, layout };
    check(circles(8, 6, CircleLayout::Symmetric), &print, "");
    check(circles(4, 11, CircleLayout::Asymmetric), &print, "");
}

#[test]
fn a_print_of_another_size_is_not_taken_for_the_target() {
    let board = |columns, rows| {
        let geometry = Geometry::Chessboard { columns, rows, spacing_m: 0.02 };
        Target { name: "t".to_owned(), geometry, shape: Shape::Rigid }
    };
    let made = sheet(&board(9, 6), &Print::default(), None, "").unwrap();
    let found = detect(&scanned(&made.svg, made.paper.size_mm), &board(8, 6));
    assert_eq!(found.missed, Some(Missed::OtherSize { columns: 9, rows: 6 }));
}
