//! A target whose outermost points no view shows, though those beside them are seen.

use boresight_data::{Geometry, Id as _, Severity, Target, TargetId};

use super::case::Case;
#[cfg(test)]
use super::example::Example;
use super::{Diagnostic, Found, count};

/// So many views must show the last row that is seen; fewer may have lost the next one by chance.
const LEAST_VIEWS: usize = 5;

/// A target whose outermost points no view shows, though those beside them are seen.
pub(super) struct UnseenRim;

impl Diagnostic for UnseenRim {
    const CODE: &'static str = "unseen-rim";

    const EXPLANATION: &'static str = "\
What it means: the outermost row or column of the target as it was declared is
seen in no view at all, although most of the row beside it is seen in five views
or more. The real target is probably smaller than declared, and its size as seen
is told.

Why it matters: labels are right where markers tell them, so the calibration may
be good. But the bend of the target is modelled over its declared size, and the
report counts points that do not exist. If the target does have the row, no view
shows it: something covers it, or the board is always cut off there.

How to fix it: count the squares or tags of the target and declare what is
there. If it is as declared, show all of it in some views.";

    fn find(case: &Case) -> Vec<Found> {
        let targets = case.dataset.targets.enumerate();
        targets.filter_map(|(id, target)| of_target(case, id, target)).collect()
    }

    #[cfg(test)]
    fn examples() -> Vec<(Example, Severity)> {
        let mut example = Example::mono();
        let target = example.dataset.targets.iter().next().expect("it has a target").clone();
        let [columns, _] = target.geometry.grid().expect("it is a board");
        for view in &mut example.dataset.views {
            view.observations.retain(|observation| observation.point.0 >= columns);
        }
        example.refit();
        vec![(example, Severity::Note)]
    }
}

/// Returns what is found of a target: the first and the last lines of its grid that no view shows.
fn of_target(case: &Case, id: TargetId, target: &Target) -> Option<Found> {
    let size = target.geometry.grid()?.map(|n| n as usize);
    // For each view, the points seen on each column and on each row.
    let views = case.dataset.views.iter().filter(|view| view.target == id && !view.observations.is_empty());
    let counts: Vec<[Vec<usize>; 2]> = views
        .map(|view| {
            let mut lines = size.map(|n| vec![0; n]);
            for observation in &view.observations {
                let point = observation.point.index();
                lines[0][point % size[0]] += 1;
                lines[1][point / size[0]] += 1;
            }
            lines
        })
        .collect();
    let (mut seen, mut n_beside) = (size, usize::MAX);
    for axis in 0..2 {
        let is_seen = |line: &usize| counts.iter().any(|lines| lines[axis][*line] > 0);
        let (first, last) = ((0..size[axis]).find(is_seen)?, (0..size[axis]).rev().find(is_seen)?);
        for (line, is_unseen) in [(first, first > 0), (last, last + 1 < size[axis])] {
            let is_full = |lines: &&[Vec<usize>; 2]| 2 * lines[axis][line] > size[1 - axis];
            let n_full = counts.iter().filter(is_full).count();
            if is_unseen {
                n_beside = n_beside.min(n_full);
            }
        }
        seen[axis] = last + 1 - first;
    }
    if seen == size || n_beside < LEAST_VIEWS {
        return None;
    }
    let [was, is] = [size, seen].map(|size| in_words(&target.geometry, size));
    Some(Found {
        severity: Severity::Note,
        place: target.name.clone(),
        message: format!(
            "it seems to have {is}, not {was}: no view shows more, while {} what is beside",
            match n_beside {
                1 => "1 view shows".to_owned(),
                n => format!("{} show", count(n, "view")),
            }
        ),
        measured: Some(n_beside as f64),
        limit: Some(LEAST_VIEWS as f64),
        fix: format!("Declare the target with {is}, or show all of it in some views."),
    })
}

/// Returns the size of a grid of points as its kind of target is declared.
fn in_words(geometry: &Geometry, [columns, rows]: [usize; 2]) -> String {
    match geometry {
        Geometry::Charuco { .. } => format!("{}x{} squares", columns + 1, rows + 1),
        Geometry::AprilGrid { .. } => format!("{}x{} tags", columns.div_ceil(2), rows.div_ceil(2)),
        Geometry::Circles { .. } => format!("{columns}x{rows} dots"),
        _ => format!("{columns}x{rows} inner corners"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns what is found where only these columns and rows of a board are seen, in so many views.
    fn check(columns: std::ops::Range<u32>, rows: std::ops::Range<u32>, n_views: usize) -> Option<String> {
        let mut example = Example::mono();
        example.retain_views(|view_idx| view_idx < n_views);
        let target = example.dataset.targets.iter().next().unwrap().clone();
        let [across, _] = target.geometry.grid().unwrap();
        for view in &mut example.dataset.views {
            let points = rows.clone().flat_map(|row| columns.clone().map(move |c| row * across + c));
            let observation = view.observations[0];
            view.observations = points
                .map(|point| boresight_data::Observation {
                    point: boresight_data::PointId(point),
                    ..observation
                })
                .collect();
        }
        let found = UnseenRim::find(&Case::new(&example.dataset, &example.calibration));
        found.first().map(|found| found.message.clone())
    }

    #[test]
    fn the_size_that_is_seen_is_told() {
        let example = Example::mono();
        let [columns, rows] = example.dataset.targets.iter().next().unwrap().geometry.grid().unwrap();
        let told = |message: Option<String>, columns: u32, rows: u32| {
            message
                .is_some_and(|m| m.starts_with(&format!("it seems to have {columns}x{rows} inner corners")))
        };
        assert_eq!(check(0..columns, 0..rows, 9), None);
        assert!(told(check(0..columns, 0..rows - 1, 9), columns, rows - 1));
        assert!(told(check(1..columns, 0..rows - 2, 9), columns - 1, rows - 2));
        assert_eq!(check(0..columns, 0..rows - 1, 3), None);
    }

    #[test]
    fn sizes_are_told_as_they_are_declared() {
        let dictionary = boresight_data::Dictionary::APRILTAG_36H11;
        let charuco = Geometry::Charuco { columns: 1, rows: 1, spacing_m: 1.0, marker_m: 0.5, dictionary };
        let tags = Geometry::AprilGrid { columns: 1, rows: 1, tag_m: 1.0, spacing: 0.3, dictionary };
        assert_eq!(in_words(&charuco, [9, 6]), "10x7 squares");
        assert_eq!(in_words(&tags, [10, 8]), "5x4 tags");
    }
}
