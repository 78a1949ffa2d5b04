//! Grids of dark dots, symmetric and asymmetric.
//!
//! Dark blobs that are ellipses are measured by their moments, joined to a lattice by prediction from dot to dot, and
//! labelled where the lattice is the whole grid in one way. The middle of an ellipse is not where the middle of the dot
//! is: what perspective makes of a circle is known from the grid around it, and taken away.

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use boresight_data::{CircleLayout, Geometry, GrayImage, Observation, PointId, Target};
use boresight_geometry::nalgebra::{Matrix3, Vector3};

use crate::blobs::{Blob, find_blobs};
use crate::detection::{Detection, Missed};
use crate::lattice::distance;
use crate::local_map::LocalMap;
use crate::statistics::median;

/// Shares of the image's shorter side over which the grey values around a place are averaged, to tell dark from bright.
const WINDOW_SHARES: [f64; 4] = [0.05, 0.12, 0.025, 0.3];
/// A dot may be off by this share of a step.
const MISS_SHARE: f64 = 0.3;
/// Lattices begin at this many dots at most.
const SEEDS: usize = 12;
/// How the steps of a lattice may have to be added to each other, the plain way first: a lattice that began at the rim may
/// have a step of the grid and the sum of two, which make up the same lattice.
const SHEARS: [[i32; 2]; 5] = [[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]];
/// A dot is seen if its middle is at least this share of a step away from the border of the image: no dot is wider.
const ROOM: f64 = 0.5;
/// The scatter of a measured dot that noise does not explain, in pixels.
const MODEL_SIGMA_PX: f64 = 0.01;

/// Tells whether a target is a grid of dots.
pub(crate) fn handles(geometry: &Geometry) -> bool {
    matches!(geometry, Geometry::Circles { .. })
}

/// Detects the dots of a grid.
pub(crate) fn detect(image: &GrayImage, target: &Target) -> Detection {
    let Geometry::Circles { columns, rows, spacing_m, layout } = target.geometry else {
        return Detection::missed(Missed::NoBoard);
    };
    let places: Vec<[i32; 2]> = (0..target.point_count() as u32)
        .map(|i| {
            let at = target.drawn_point(PointId(i));
            [at.x, at.y].map(|metres| (metres / spacing_m).round() as i32)
        })
        .collect();
    let mut best = Detection::missed(Missed::NoBoard);
    for share in WINDOW_SHARES {
        let blobs = find_blobs(image, share);
        let found = label(&blobs, &places, [columns, rows], layout, image.size());
        if found.is_better_than(&best) {
            best = found;
        }
        if !best.observations.is_empty() {
            break;
        }
    }
    best
}

/// Returns the dots at `places` (in distances between rows) among blobs.
fn label(
    blobs: &[Blob],
    places: &[[i32; 2]],
    [columns, rows]: [u32; 2],
    layout: CircleLayout,
    image_size: [u32; 2],
) -> Detection {
    let largest = lattices(blobs).into_iter().max_by_key(|lattice| lattice.len()).unwrap_or_default();
    if largest.len() < 4 {
        return Detection::missed(Missed::NoBoard);
    }
    let wanted: BTreeSet<[i32; 2]> = places.iter().copied().collect();
    let possible = arrangements(&largest, &wanted, layout);
    // Of turns that the grid does not tell apart, the most upright is taken.
    let upright = |dots: &BTreeMap<[i32; 2], usize>| {
        let first = blobs[dots[&places[0]]].pixel;
        let along = blobs[dots[&places[columns as usize - 1]]].pixel;
        (along[0] - first[0]) / distance(first, along).max(1e-9)
    };
    let Some(dots) = possible.into_iter().max_by(|a, b| upright(a).total_cmp(&upright(b))) else {
        return Detection::missed(misfit(&largest, blobs, [columns, rows], layout, image_size));
    };
    let pixels = pixels(&dots, blobs);
    // The radius of a dot in units, from its area and the local scale.
    let maps: Vec<Option<LocalMap>> = places.iter().map(|at| map_near(&pixels, *at)).collect();
    let squares = places.iter().zip(&maps).filter_map(|(at, map)| {
        let [[a, b], [c, d]] = map.as_ref()?.steps_px(1.0);
        Some(blobs[dots[at]].area_px / (std::f64::consts::PI * (a * d - b * c).abs()))
    });
    let radius2 = median(squares).unwrap_or(0.0);
    let observations: Vec<Observation> = places
        .iter()
        .zip(&maps)
        .enumerate()
        .map(|(i, (at, map))| {
            let blob = &blobs[dots[at]];
            let bias = map.as_ref().map_or([0.0; 2], |map| centre_bias(map, radius2));
            let sigma_px = blob.sigma_px.hypot(MODEL_SIGMA_PX);
            Observation {
                point: PointId(i as u32),
                pixel: [0, 1].map(|axis| blob.pixel[axis] - bias[axis]),
                sigma_px,
            }
        })
        .collect();
    let shows_size = ends_inside(&pixels, image_size);
    Detection { observations, missed: None, pattern: None, shows_size }
}

fn pixels(dots: &BTreeMap<[i32; 2], usize>, blobs: &[Blob]) -> BTreeMap<[i32; 2], [f64; 2]> {
    dots.iter().map(|(at, blob)| (*at, blobs[*blob].pixel)).collect()
}

/// Returns the ways in which a lattice is the dots at these places, up to turns of the drawing.
fn arrangements(
    lattice: &BTreeMap<[i32; 2], usize>,
    wanted: &BTreeSet<[i32; 2]>,
    layout: CircleLayout,
) -> Vec<BTreeMap<[i32; 2], usize>> {
    // The steps of an asymmetric grid are its diagonals; either of them may have been the first.
    let straight = |at: &[i32; 2]| match layout {
        CircleLayout::Symmetric => *at,
        CircleLayout::Asymmetric => [at[0] - at[1], at[0] + at[1]],
    };
    let mut possible: Vec<BTreeMap<[i32; 2], usize>> = Vec::new();
    for (shear, quarters) in SHEARS.iter().flat_map(|shear| (0..4).map(move |quarters| (shear, quarters))) {
        if quarters == 0 && !possible.is_empty() {
            break;
        }
        let turned: BTreeMap<[i32; 2], usize> = lattice
            .iter()
            .map(|([a, b], blob)| {
                let [x, y] = straight(&[a + shear[0] * b, b + shear[1] * a]);
                let turned = [[x, y], [y, -x], [-x, -y], [-y, x]][quarters];
                (turned, *blob)
            })
            .collect();
        let low = |axis: usize| turned.keys().map(|at| at[axis]).min().unwrap_or(0);
        let low = [low(0), low(1)];
        let moved: BTreeMap<[i32; 2], usize> =
            turned.iter().map(|(at, blob)| ([at[0] - low[0], at[1] - low[1]], *blob)).collect();
        if moved.len() == wanted.len() && moved.keys().all(|at| wanted.contains(at)) {
            possible.push(moved);
        }
    }
    possible
}

/// Tells whether a further row of dots would be seen on each side, so that the grid is seen to end there.
fn ends_inside(pixels: &BTreeMap<[i32; 2], [f64; 2]>, image_size: [u32; 2]) -> bool {
    [[1, 0], [0, 1], [-1, 0], [0, -1]].iter().all(|out| {
        // The outermost dots along this direction, and whether the next ones would be seen. Dots of one line are two apart
        // where every other row is shifted.
        let next = pixels.iter().filter_map(|(at, here)| {
            let inwards = |n: i32| pixels.get(&[at[0] - n * out[0], at[1] - n * out[1]]);
            let is_last = (1..=2).all(|n| !pixels.contains_key(&[at[0] + n * out[0], at[1] + n * out[1]]));
            let inner = inwards(1).or(inwards(2)).filter(|_| is_last)?;
            let step = [0, 1].map(|i| here[i] - inner[i]);
            let room_px = ROOM * step[0].hypot(step[1]);
            Some((0..2).all(|i| {
                let next = here[i] + step[i];
                room_px <= next && next <= f64::from(image_size[i]) - 1.0 - room_px
            }))
        });
        let inside: Vec<bool> = next.collect();
        !inside.is_empty() && 4 * inside.iter().filter(|is_in| **is_in).count() >= 3 * inside.len()
    })
}

/// Says why a lattice is not the grid.
fn misfit(
    lattice: &BTreeMap<[i32; 2], usize>,
    blobs: &[Blob],
    [columns, rows]: [u32; 2],
    layout: CircleLayout,
    image_size: [u32; 2],
) -> Missed {
    let n = lattice.len();
    // Fewer dots than these would look like a grid by chance.
    const LEAST: u32 = 9;
    let count = u32::try_from(n).unwrap_or(u32::MAX);
    let other = match layout {
        CircleLayout::Symmetric => CircleLayout::Asymmetric,
        CircleLayout::Asymmetric => CircleLayout::Symmetric,
    };
    let shapes = [layout, other].into_iter().flat_map(|layout| {
        // The shorter side of a symmetric grid comes last; the rows of an asymmetric one are told by their shifts.
        let widths = (2..=count / 2).rev().filter(move |width| count.is_multiple_of(*width));
        let is_first = move |width: &u32| layout == CircleLayout::Asymmetric || width * width >= count;
        widths.filter(is_first).map(move |width| (width, count / width, layout))
    });
    let is_shape = |(columns, rows, layout): &(u32, u32, CircleLayout)| {
        let at = |column: u32, row: u32| match layout {
            CircleLayout::Symmetric => [column as i32, row as i32],
            CircleLayout::Asymmetric => [(2 * column + row % 2) as i32, row as i32],
        };
        let places = (0..*rows).flat_map(|row| (0..*columns).map(move |column| at(column, row)));
        // A grid that is cut by the border of the image is one of fewer dots, too.
        let dots = arrangements(lattice, &places.collect(), *layout);
        dots.first().is_some_and(|dots| ends_inside(&pixels(dots, blobs), image_size))
    };
    match shapes.into_iter().filter(|_| count >= LEAST).find(is_shape) {
        Some((columns, rows, layout)) => Missed::OtherDots { columns, rows, layout },
        None if n == columns as usize * rows as usize => Missed::Contradiction { corners: n },
        None => Missed::Ambiguous { corners: n },
    }
}

/// Returns the lattices of blobs: whole coordinates, the second axis turned from the first as +v from +u.
fn lattices(blobs: &[Blob]) -> Vec<BTreeMap<[i32; 2], usize>> {
    let mut taken = vec![false; blobs.len()];
    let mut found = Vec::new();
    let near: Vec<Vec<usize>> = (0..blobs.len()).map(|i| nearest(blobs, i, 8)).collect();
    // Blobs among alike blobs come first.
    let mut order: Vec<usize> = (0..blobs.len()).collect();
    let spread = |i: usize| {
        let ratio = |j: &usize| (blobs[*j].area_px / blobs[i].area_px).ln().abs();
        near[i].iter().take(4).map(ratio).fold(0.0, f64::max)
    };
    order.sort_by(|&a, &b| spread(a).total_cmp(&spread(b)).then(a.cmp(&b)));
    for &seed in order.iter().filter(|seed| near[**seed].len() >= 3) {
        if taken[seed] || found.len() >= SEEDS {
            continue;
        }
        let step = |j: usize| [0, 1].map(|axis| blobs[j].pixel[axis] - blobs[seed].pixel[axis]);
        let a = step(near[seed][0]);
        let across = |b: [f64; 2]| a[0] * b[1] - a[1] * b[0];
        let is_across = |b: &[f64; 2]| across(*b).abs() > 0.5 * a[0].hypot(a[1]) * b[0].hypot(b[1]);
        let Some(b) = near[seed].iter().skip(1).map(|j| step(*j)).find(is_across) else { continue };
        let b = if across(b) > 0.0 { b } else { b.map(|c| -c) };
        let lattice = grow(blobs, seed, [a, b]);
        lattice.values().for_each(|blob| taken[*blob] = true);
        found.push(lattice);
    }
    found
}

fn nearest(blobs: &[Blob], i: usize, count: usize) -> Vec<usize> {
    let mut others: Vec<usize> = (0..blobs.len()).filter(|j| *j != i).collect();
    let away = |j: usize| distance(blobs[i].pixel, blobs[j].pixel);
    let order = |a: &usize, b: &usize| away(*a).total_cmp(&away(*b)).then(a.cmp(b));
    if others.len() > count {
        others.select_nth_unstable_by(count, order);
        others.truncate(count);
    }
    others.sort_by(order);
    others
}

/// Grows a lattice from a blob by its first steps, each further one foretold by the last.
fn grow(blobs: &[Blob], seed: usize, steps: [[f64; 2]; 2]) -> BTreeMap<[i32; 2], usize> {
    let mut placed = BTreeMap::from([([0, 0], seed)]);
    let mut open = VecDeque::from([([0, 0], steps)]);
    let mut used = vec![false; blobs.len()];
    used[seed] = true;
    while let Some((at, steps)) = open.pop_front() {
        let here = blobs[placed[&at]];
        for (axis, sign) in [(0, 1), (1, 1), (0, -1), (1, -1)] {
            let mut next = at;
            next[axis] += sign;
            if placed.contains_key(&next) {
                continue;
            }
            // What the opposite neighbour shows is nearer to the truth than the step of the first dot.
            let mut behind = at;
            behind[axis] -= sign;
            let step = match placed.get(&behind) {
                Some(behind) => [0, 1].map(|i| here.pixel[i] - blobs[*behind].pixel[i]),
                None => steps[axis].map(|s| s * f64::from(sign)),
            };
            let foretold = [0, 1].map(|i| here.pixel[i] + step[i]);
            let length = step[0].hypot(step[1]);
            let away = |j: &usize| distance(blobs[*j].pixel, foretold);
            let is_like = |j: &usize| (0.5..2.0).contains(&(blobs[*j].area_px / here.area_px));
            let candidates =
                (0..blobs.len()).filter(|j| !used[*j] && away(j) < MISS_SHARE * length && is_like(j));
            let Some(found) = candidates.min_by(|a, b| away(a).total_cmp(&away(b)).then(a.cmp(b))) else {
                continue;
            };
            used[found] = true;
            placed.insert(next, found);
            let mut own = steps;
            own[axis] = [0, 1].map(|i| (blobs[found].pixel[i] - here.pixel[i]) * f64::from(sign));
            open.push_back((next, own));
        }
    }
    placed
}

/// Returns the map of the grid to the image near a dot.
fn map_near(pixels: &BTreeMap<[i32; 2], [f64; 2]>, at: [i32; 2]) -> Option<LocalMap> {
    let near = pixels
        .range([at[0] - 3, i32::MIN]..=[at[0] + 3, i32::MAX])
        .filter(|(place, _)| (place[1] - at[1]).abs() <= 3)
        .map(|(place, pixel)| ([place[0] - at[0], place[1] - at[1]].map(f64::from), *pixel));
    LocalMap::fitted(near)
}

/// Returns by how much the middle of the ellipse that a circle becomes is off the image of the circle's middle.
fn centre_bias(map: &LocalMap, radius2: f64) -> [f64; 2] {
    let h = Matrix3::from_row_slice(&map.homography());
    let Some(inverse) = h.try_inverse() else { return [0.0; 2] };
    let conic = inverse.transpose() * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, -radius2)) * inverse;
    // The middle is where the gradient of the conic vanishes.
    let determinant = conic[(0, 0)] * conic[(1, 1)] - conic[(0, 1)].powi(2);
    let middle = [
        (conic[(0, 1)] * conic[(1, 2)] - conic[(1, 1)] * conic[(0, 2)]) / determinant,
        (conic[(0, 1)] * conic[(0, 2)] - conic[(0, 0)] * conic[(1, 2)]) / determinant,
    ];
    let bias = [middle[0] - h[(0, 2)], middle[1] - h[(1, 2)]];
    if bias.iter().all(|b| b.is_finite()) { bias } else { [0.0; 2] }
}
