//! What images say of the size of the target: each for itself, and all of them together.
//!
//! An image in which only a part of the target shows has labels that are right if the target is as declared. Whether it is
//! can often be told from other images, so that it is judged over all of them before any label is used.

use std::collections::BTreeMap;

use boresight_data::{Geometry, Target};
use serde::{Deserialize, Serialize};

use crate::SeenImage;
use crate::seen::describe;

/// So many images that show less than the target alike are no accident.
const ALIKE: usize = 2;

/// What an image says of the size of the target, in columns and rows as targets are declared.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum SizeSeen {
    /// Nothing: labels are right if the target is as declared.
    #[default]
    Open,
    /// The target ends on all sides where it should, or its markers are numbered as declared.
    AsDeclared,
    /// A board of this size is seen, or of this size at least.
    Other([u32; 2]),
    /// So much of a board is seen, and nothing where the target should have more.
    Short([u32; 2]),
}

/// Takes all labels away if the images say together that the target has another size than was declared.
///
/// They do if more of them show another size than the declared one, or if none shows the declared size and several alike
/// show less.
pub fn refuse_other_size(target: &Target, images: &mut [&mut SeenImage]) {
    let Some((size, n)) = Tally::of(images.iter().map(|image| image.size)).refuted_by(target) else { return };
    let (size, declared) = (describe(&resized(target, size)), describe(target));
    let others = if n == 1 { "another image shows".to_owned() } else { format!("{n} other images show") };
    for image in images.iter_mut().filter(|image| !image.observations.is_empty()) {
        image.observations.clear();
        image.missed = Some(format!("{others} {size} in place of {declared}"));
    }
}

/// How many images say what.
#[derive(Default)]
pub(crate) struct Tally {
    n_declared: usize,
    others: BTreeMap<[u32; 2], usize>,
    shorts: BTreeMap<[u32; 2], usize>,
}

impl Tally {
    pub fn of(said: impl Iterator<Item = SizeSeen>) -> Self {
        let mut tally = Self::default();
        for size in said {
            match size {
                SizeSeen::Open => {}
                SizeSeen::AsDeclared => tally.n_declared += 1,
                SizeSeen::Other(size) => *tally.others.entry(size).or_default() += 1,
                SizeSeen::Short(size) => *tally.shorts.entry(size).or_default() += 1,
            }
        }
        tally
    }

    /// Returns the size that most images give the target, and how many do, if it is not as declared.
    pub fn refuted_by(&self, target: &Target) -> Option<([u32; 2], usize)> {
        self.named(target).filter(|_| self.refutes())
    }

    /// Tells whether the target is not as declared.
    fn refutes(&self) -> bool {
        let n_other: usize = self.others.values().sum();
        let n_alike = self.shorts.values().copied().max().unwrap_or(0);
        n_other > self.n_declared || (self.n_declared == 0 && n_alike >= ALIKE)
    }

    /// Returns the size that most images give the target in place of the declared one, and how many do.
    fn named(&self, target: &Target) -> Option<([u32; 2], usize)> {
        let sizes = if self.others.is_empty() { &self.shorts } else { &self.others };
        let is_numbered = matches!(target.geometry, Geometry::Charuco { .. } | Geometry::AprilGrid { .. });
        if !is_numbered {
            let most = sizes.iter().max_by_key(|(size, n)| (**n, **size));
            return most.map(|(size, n)| (*size, *n));
        }
        // Markers tell the columns; of the rows each image shows some.
        let mut of_columns: BTreeMap<u32, (usize, u32)> = BTreeMap::new();
        for ([columns, rows], n) in sizes {
            let (count, most_rows) = of_columns.entry(*columns).or_default();
            (*count, *most_rows) = (*count + n, *rows.max(most_rows));
        }
        let most = of_columns.into_iter().max_by_key(|(columns, (n, _))| (*n, *columns));
        most.map(|(columns, (n, rows))| ([columns, rows], n))
    }
}

/// Returns a target as declared, but of another size.
pub(crate) fn resized(target: &Target, size: [u32; 2]) -> Target {
    let mut target = target.clone();
    match &mut target.geometry {
        Geometry::Chessboard { columns, rows, .. }
        | Geometry::Charuco { columns, rows, .. }
        | Geometry::AprilGrid { columns, rows, .. }
        | Geometry::Circles { columns, rows, .. } => [*columns, *rows] = size,
        Geometry::Points { .. } => {}
    }
    target
}

#[cfg(test)]
mod tests {
    use boresight_data::{Observation, PointId};

    use super::SizeSeen::{AsDeclared, Open, Other, Short};
    use super::*;

    /// Checks which size is named for the images that say this, and whether their labels are refused.
    fn check(target: &str, said: &[SizeSeen], expected: Option<([u32; 2], bool)>) {
        let target = crate::parse_target(target).unwrap();
        let named = Tally::of(said.iter().copied()).named(&target).map(|(size, _)| size);
        assert_eq!(named, expected.map(|(size, _)| size), "{said:?}");
        let observation = Observation { point: PointId(0), pixel: [1.0; 2], sigma_px: 0.1 };
        let image = |size: &SizeSeen| SeenImage {
            observations: match size {
                Open | AsDeclared => vec![observation],
                Other(_) | Short(_) => Vec::new(),
            },
            size: *size,
            ..SeenImage::default()
        };
        let mut images: Vec<SeenImage> = said.iter().map(image).collect();
        let before = images.clone();
        refuse_other_size(&target, &mut images.iter_mut().collect::<Vec<_>>());
        let is_refused = expected.is_some_and(|(_, is_refused)| is_refused);
        assert_eq!(images.iter().all(|image| image.observations.is_empty()), is_refused, "{said:?}");
        assert_eq!(images == before, !is_refused || !said.contains(&Open), "{said:?}");
    }

    #[test]
    fn labels_are_refused_where_the_images_show_another_size() {
        let board = "chessboard:10x6:25mm";
        check(board, &[Open, Open], None);
        check(board, &[Open, AsDeclared, Other([9, 6])], Some(([9, 6], false)));
        check(board, &[Open, Other([9, 6])], Some(([9, 6], true)));
        check(board, &[Open, AsDeclared, Other([9, 6]), Other([9, 6]), Other([4, 4])], Some(([9, 6], true)));
        // What covers a row in one image is no other board, nor in many where the whole is seen in one.
        check(board, &[Open, Short([9, 6])], Some(([9, 6], false)));
        check(board, &[Open, Short([9, 6]), Short([9, 6])], Some(([9, 6], true)));
        check(board, &[AsDeclared, Open, Short([9, 6]), Short([9, 6])], Some(([9, 6], false)));
        check(board, &[Open, Short([9, 6]), Short([9, 5])], Some(([9, 6], false)));
    }

    #[test]
    fn rows_of_numbered_boards_are_those_that_any_image_shows() {
        let said = [Open, Other([10, 5]), Other([10, 5]), Other([10, 7]), Other([8, 9])];
        check("charuco:11x7:40mm:30mm:5x5_1000", &said, Some(([10, 7], true)));
        check("aprilgrid:6x6:88mm:0.3", &[Open, Other([5, 6])], Some(([5, 6], true)));
    }
}
