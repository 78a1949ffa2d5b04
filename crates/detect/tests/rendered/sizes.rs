//! Targets declared with the wrong size: never a wrong label, whatever is seen of the board.

use std::collections::BTreeSet;

use boresight_data::{CircleLayout, GrayImage, PointId, Target};
use boresight_detect::{Detection, Missed, detect};
use boresight_geometry::Pose;
use boresight_synthetic::{Exposure, render};

use super::dots::dots;
use super::tags::facing;
use super::{board, camera, truth};

/// Returns images of a board that show all of it, sharp and blurred, with wide and with narrow white margins.
fn whole_views(printed: &Target) -> Vec<(GrayImage, Pose)> {
    let views = (0..8u32).map(|i| {
        let t = f64::from(i);
        let middle = [0.02 * (1.7 * t).sin(), 0.015 * (2.3 * t).cos(), 0.50 + 0.03 * (0.9 * t).sin()];
        let pose = facing(printed, middle, 5.0 * t, 0.37 * t, 50.0 * t);
        let exposure = Exposure {
            margin_squares: [1.0, 0.4, 0.12, 0.05][i as usize % 4],
            background: [110.0, 60.0, 30.0, 200.0][i as usize / 2],
            blur_px: [0.4, 1.5][i as usize % 2],
            ..Exposure::default()
        };
        (render(&camera(), &pose, printed, &[], &exposure, u64::from(i)).unwrap(), pose)
    });
    views.collect()
}

/// Returns images of a board that is cut by the border of the image, on all sides in turn.
fn cut_views(printed: &Target) -> Vec<(GrayImage, Pose)> {
    let views = (0..12u32).map(|i| {
        let t = f64::from(i);
        let (sin, cos) = (t / 12.0 * std::f64::consts::TAU).sin_cos();
        let pose = facing(printed, [0.2 * cos, 0.15 * sin, 0.40], 20.0, 0.37 * t, 30.0 * (1.3 * t).sin());
        (render(&camera(), &pose, printed, &[], &Exposure::default(), u64::from(i)).unwrap(), pose)
    });
    views.collect()
}

/// Returns by which turn of the printed board all labels are right, of a board declared with its sides exchanged or not;
/// `None` if there is none.
fn right_turn(found: &Detection, pose: &Pose, printed: &Target, declared: [u32; 2]) -> Option<usize> {
    let [columns, rows] = printed.geometry.grid().unwrap();
    let place = |point: PointId, turn: usize| {
        let (column, row) = (point.0 % declared[0], point.0 / declared[0]);
        match turn {
            0 => (column, row),
            1 => (row, declared[0] - 1 - column),
            2 => (declared[0] - 1 - column, declared[1] - 1 - row),
            _ => (declared[1] - 1 - row, column),
        }
    };
    (0..4).find(|turn| {
        found.observations.iter().all(|observation| {
            let (column, row) = place(observation.point, *turn);
            let is_there = column < columns && row < rows;
            is_there && {
                let truth = truth(&camera(), pose, printed, PointId(row * columns + column));
                (observation.pixel[0] - truth[0]).hypot(observation.pixel[1] - truth[1]) < 0.5
            }
        })
    })
}

#[test]
fn chessboards_of_another_size_are_never_labelled() {
    let printed = board(9, 6);
    let views = whole_views(&printed);
    let mut n_named = 0;
    for (i, (image, pose)) in views.iter().enumerate() {
        let found = detect(image, &printed);
        assert_eq!((found.observations.len(), found.missed), (54, None), "image {i}");
        assert_eq!(right_turn(&found, pose, &printed, [9, 6]), Some(0), "image {i}");
        for (columns, rows) in [(10, 6), (9, 7), (8, 6), (9, 5), (10, 7), (11, 8), (6, 10), (7, 9), (12, 12)]
        {
            let found = detect(image, &board(columns, rows));
            assert!(found.observations.is_empty(), "image {i} as {columns}x{rows}: {found:?}");
            let seen = match found.missed {
                Some(Missed::OtherSize { columns, rows } | Missed::TooLarge { columns, rows }) => {
                    [columns, rows]
                }
                Some(Missed::Short { columns, rows }) => [columns, rows],
                other => panic!("image {i} as {columns}x{rows}: {other:?}"),
            };
            assert_eq!(seen, [9, 6], "image {i} as {columns}x{rows}");
            n_named += 1;
        }
    }
    assert_eq!(n_named, 9 * views.len());
}

#[test]
fn exchanged_sides_are_the_same_board_turned_alike_in_all_images() {
    for (columns, rows) in [(9, 6), (8, 5), (7, 4)] {
        let printed = board(columns, rows);
        let swapped = board(rows, columns);
        let mut turns = BTreeSet::new();
        for (i, (image, pose)) in whole_views(&printed).iter().enumerate() {
            let found = detect(image, &swapped);
            assert_eq!(found.observations.len(), (columns * rows) as usize, "image {i}");
            let turn = right_turn(&found, pose, &printed, [rows, columns]);
            assert!(turn.is_some(), "image {i} of {columns}x{rows}");
            turns.extend(turn);
        }
        // Sums that are odd tell half a turn: then the same corner of the board is the first in every image.
        assert_eq!(turns.len(), 1, "{columns}x{rows}: {turns:?}");
    }
}

#[test]
fn parts_of_boards_of_another_size_say_that_they_rely_on_the_declared_one() {
    let printed = board(9, 6);
    let mut n_labelled = 0;
    for (i, (image, pose)) in cut_views(&printed).iter().enumerate() {
        let found = detect(image, &printed);
        assert!(!found.shows_size, "image {i}");
        if !found.observations.is_empty() {
            assert_eq!(right_turn(&found, pose, &printed, [9, 6]), Some(0), "image {i}");
            n_labelled += 1;
        }
        for (columns, rows) in [(10, 6), (9, 7), (8, 6), (9, 5), (10, 7), (6, 9)] {
            let found = detect(image, &board(columns, rows));
            assert!(!found.shows_size, "image {i} as {columns}x{rows}: {found:?}");
        }
    }
    assert!(n_labelled >= 8, "{n_labelled} of the cut boards are used");
    // A whole board says that it is as declared.
    assert!(detect(&whole_views(&printed)[0].0, &printed).shows_size);
}

#[test]
fn dots_of_another_size_or_layout_are_named() {
    let camera = camera();
    let (symmetric, asymmetric) = (CircleLayout::Symmetric, CircleLayout::Asymmetric);
    for (columns, rows, layout) in [(7, 5, symmetric), (4, 11, asymmetric), (5, 8, asymmetric)] {
        let printed = dots(columns, rows, layout);
        let seen = Some(Missed::OtherDots { columns, rows, layout });
        for i in 0..3u32 {
            let t = f64::from(i);
            let pose = facing(&printed, [0.01, -0.01, 0.42], 12.0 * t, 0.37 * t, 100.0 * t);
            let image = render(&camera, &pose, &printed, &[], &Exposure::default(), u64::from(i)).unwrap();
            let found = detect(&image, &printed);
            assert_eq!((found.missed, found.shows_size), (None, true), "{layout:?} {i}");
            for (across, down) in [(1, 0), (0, 1), (-1, 0), (0, -1), (1, 1), (-1, 2)] {
                let size = [columns.wrapping_add_signed(across), rows.wrapping_add_signed(down)];
                let found = detect(&image, &dots(size[0], size[1], layout));
                assert!(found.observations.is_empty(), "{layout:?} {i} as {size:?}");
                assert_eq!(found.missed, seen, "{layout:?} {i} as {size:?}");
            }
            // Sides exchanged: another grid where rows are shifted, the same one turned where not.
            let swapped = detect(&image, &dots(rows, columns, layout));
            match layout {
                CircleLayout::Symmetric => assert_eq!(swapped.observations.len(), 35, "{i}"),
                CircleLayout::Asymmetric => assert_eq!(swapped.missed, seen, "{i}"),
            }
            let other = if layout == symmetric { asymmetric } else { symmetric };
            assert_eq!(detect(&image, &dots(columns, rows, other)).missed, seen, "{layout:?} {i}");
        }
    }
}
#[test]
fn dots_cut_by_the_border_rely_on_the_declared_size() {
    // A column is out of the image: what is left is a whole grid of one column less.
    let printed = dots(7, 5, CircleLayout::Symmetric);
    let pose = facing(&printed, [0.17, 0.0, 0.40], 0.0, 0.0, 0.0);
    let image = render(&camera(), &pose, &printed, &[], &Exposure::default(), 1).unwrap();
    let n_in = (0..35).filter(|i| truth(&camera(), &pose, &printed, PointId(*i))[0] < 636.0).count();
    assert_eq!(n_in, 30, "six columns are in the image");
    let missed = detect(&image, &printed).missed;
    assert!(matches!(missed, Some(Missed::Ambiguous { .. })), "{missed:?}");
    let found = detect(&image, &dots(6, 5, CircleLayout::Symmetric));
    assert!(!found.shows_size, "{found:?}");
}
