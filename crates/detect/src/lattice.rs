//! From saddles to lattices: corners that are joined by edges of squares, with whole coordinates.

use std::collections::{BTreeMap, VecDeque};
use std::f64::consts::{PI, TAU};
use std::num::NonZero;

use kiddo::{ImmutableKdTree, SquaredEuclidean};

use crate::plane::Plane;
use crate::saddles::Saddle;

/// The nearest saddles among which a corner's neighbours are looked for.
const NEIGHBOURS: usize = 24;
/// Two saddles closer than this are one.
const SAME_PX: f64 = 1.5;
/// By how much a ray may miss the neighbour it leads to, in radians.
const MISS_RAD: f64 = 0.30;
/// How far aside of an edge between plain squares is looked, as a share of its length.
pub(crate) const ASIDE: f64 = 0.2;
/// The least contrast across an edge, as a share of that of its ends.
const EDGE_SHARE: f64 = 0.3;

/// Corners of one board with whole coordinates: the second axis is the first turned from +u towards +v.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Lattice {
    /// Where each corner is, by its coordinates.
    pub corners: BTreeMap<[i32; 2], Corner>,
    /// Whether the square from (0, 0) to (1, 1) is bright; every other one is.
    pub is_bright: bool,
}

/// A corner of a lattice.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Corner {
    /// Where it is.
    pub pixel: [f64; 2],
    /// The difference between bright and dark squares around it in grey values.
    pub contrast: f64,
}

/// One end of an edge: a saddle and the ray that leaves it.
type End = (usize, usize);

/// Returns the lattices that the saddles make, the one with most corners first.
///
/// An edge joins two saddles if each is the nearest along a ray of the other, their colours agree, and bright stays on
/// one side all the way between, looked at aside of the edge by `aside` of its length. A corner counts if it is one of
/// four around a square.
pub(crate) fn find_lattices(saddles: &[Saddle], smooth: &Plane, aside: f64) -> Vec<Lattice> {
    let saddles = without_doubles(saddles);
    let edges = edges(&saddles, smooth, aside);
    let mut taken = vec![false; saddles.len()];
    let mut lattices = Vec::new();
    for start in 0..saddles.len() {
        if taken[start] {
            continue;
        }
        let placed = walk(start, &saddles, &edges, &mut taken);
        lattices.extend(of_squares(&placed, &saddles));
    }
    lattices.sort_by_key(|lattice: &Lattice| std::cmp::Reverse(lattice.corners.len()));
    lattices
}

/// Returns the saddles without those that coincide with a stronger one.
fn without_doubles(saddles: &[Saddle]) -> Vec<Saddle> {
    let mut order: Vec<usize> = (0..saddles.len()).collect();
    order.sort_by(|&a, &b| saddles[b].contrast.total_cmp(&saddles[a].contrast).then(a.cmp(&b)));
    // Buckets of the size of the limit: a double is in one of nine.
    let bucket = |pixel: [f64; 2]| pixel.map(|c| (c / SAME_PX).floor() as i64);
    let mut kept: BTreeMap<[i64; 2], Vec<usize>> = BTreeMap::new();
    for &i in &order {
        let [u, v] = bucket(saddles[i].pixel);
        let is_double = (0..9).any(|k| {
            let near = kept.get(&[u + k % 3 - 1, v + k / 3 - 1]);
            near.is_some_and(|near| {
                near.iter().any(|&j| distance(saddles[i].pixel, saddles[j].pixel) < SAME_PX)
            })
        });
        if !is_double {
            kept.entry([u, v]).or_default().push(i);
        }
    }
    let mut indices: Vec<usize> = kept.into_values().flatten().collect();
    indices.sort_unstable();
    indices.into_iter().map(|i| saddles[i]).collect()
}

/// Returns, for each ray of each saddle, the ray of its neighbour that meets it.
fn edges(saddles: &[Saddle], smooth: &Plane, aside: f64) -> Vec<[Option<End>; 4]> {
    let points: Vec<[f64; 2]> = saddles.iter().map(|saddle| saddle.pixel).collect();
    let mut wanted = vec![[None; 4]; saddles.len()];
    let count = NonZero::new(NEIGHBOURS + 1).expect("a constant above zero");
    let Ok(tree) = ImmutableKdTree::<f64, 2>::new_from_slice(&points) else { return wanted };
    for (a, wanted) in wanted.iter_mut().enumerate() {
        let mut near: Vec<(f64, usize)> = tree
            .query(&points[a])
            .nearest_n::<SquaredEuclidean<f64>>(count)
            .execute()
            .into_iter()
            .map(|found| (found.distance, found.item as usize))
            .filter(|(_, b)| *b != a)
            .collect();
        near.sort_by(|x, y| x.0.total_cmp(&y.0).then(x.1.cmp(&y.1)));
        for (k, wanted) in wanted.iter_mut().enumerate() {
            *wanted = near.iter().find_map(|&(_, b)| meets(saddles, (a, k), b, smooth, aside));
        }
    }
    let mutual = |from: End, to: &End| wanted[to.0][to.1] == Some(from);
    (0..saddles.len())
        .map(|a| std::array::from_fn(|k| wanted[a][k].filter(|to| mutual((a, k), to))))
        .collect()
}

/// Returns the ray of `b` that meets a ray of another saddle, if an edge joins them.
fn meets(saddles: &[Saddle], (a, k): End, b: usize, smooth: &Plane, aside: f64) -> Option<End> {
    let (from, to) = (&saddles[a], &saddles[b]);
    let along = [to.pixel[0] - from.pixel[0], to.pixel[1] - from.pixel[1]];
    let direction = along[1].atan2(along[0]);
    if angle_between(direction, from.rays_rad[k]) > MISS_RAD {
        return None;
    }
    let back = (0..4).find(|&m| angle_between(direction + PI, to.rays_rad[m]) < MISS_RAD)?;
    // Looking back, what was on one side is on the other.
    if to.is_bright_after(back) == from.is_bright_after(k) {
        return None;
    }
    let contrast = from.contrast.min(to.contrast);
    if contrast < 0.25 * from.contrast.max(to.contrast) {
        return None;
    }
    let length = along[0].hypot(along[1]);
    let aside = (aside * length).clamp(1.5, 4.0) / length;
    let sense = if from.is_bright_after(k) { 1.0 } else { -1.0 };
    let is_edge = [0.25, 0.5, 0.75].iter().all(|share| {
        let at = [from.pixel[0] + share * along[0], from.pixel[1] + share * along[1]];
        // The side after the ray is the one towards which +u turns to +v.
        let side = |sign: f64| {
            smooth.sample([at[0] - sign * aside * along[1], at[1] + sign * aside * along[0]], 2.0)
        };
        let (Some(after), Some(before)) = (side(1.0), side(-1.0)) else { return false };
        f64::from(after - before) * sense > EDGE_SHARE * contrast
    });
    is_edge.then_some((b, back))
}

/// Walks along edges from a saddle and returns the coordinates of all it reaches, with the ray along the first axis.
fn walk(
    start: usize,
    saddles: &[Saddle],
    edges: &[[Option<End>; 4]],
    taken: &mut [bool],
) -> BTreeMap<[i32; 2], End> {
    const STEPS: [[i32; 2]; 4] = [[1, 0], [0, 1], [-1, 0], [0, -1]];
    let mut placed = BTreeMap::from([([0, 0], (start, 0))]);
    let mut open = VecDeque::from([[0, 0]]);
    taken[start] = true;
    while let Some(at) = open.pop_front() {
        let Some(&(a, first)) = placed.get(&at) else { continue };
        for (axis, step) in STEPS.iter().enumerate() {
            let Some((b, back)) = edges[a][(first + axis) % 4] else { continue };
            let next = [at[0] + step[0], at[1] + step[1]];
            if taken[b] || placed.contains_key(&next) {
                continue;
            }
            taken[b] = true;
            // The ray back is along minus the axis that led here.
            placed.insert(next, (b, (back + 6 - axis) % 4));
            open.push_back(next);
        }
    }
    debug_assert!(placed.values().all(|&(a, _)| a < saddles.len()));
    placed
}

/// Returns the lattice of those corners that are one of four around a square, if there are any.
fn of_squares(placed: &BTreeMap<[i32; 2], End>, saddles: &[Saddle]) -> Option<Lattice> {
    let is_in_square = |at: &[i32; 2]| {
        [[0, 0], [-1, 0], [0, -1], [-1, -1]].iter().any(|shift| {
            let corner = |i: i32, j: i32| placed.contains_key(&[at[0] + shift[0] + i, at[1] + shift[1] + j]);
            corner(0, 0) && corner(1, 0) && corner(0, 1) && corner(1, 1)
        })
    };
    let corners: BTreeMap<[i32; 2], Corner> = placed
        .iter()
        .filter(|(at, _)| is_in_square(at))
        .map(|(at, (a, _))| (*at, Corner { pixel: saddles[*a].pixel, contrast: saddles[*a].contrast }))
        .collect();
    let (at, (a, first)) = placed.iter().find(|(at, _)| corners.contains_key(*at))?;
    let is_even = (at[0] + at[1]).rem_euclid(2) == 0;
    Some(Lattice { corners, is_bright: saddles[*a].is_bright_after(*first) == is_even })
}

/// Returns the angle between two directions in radians, at most π.
fn angle_between(a: f64, b: f64) -> f64 {
    ((a - b + PI).rem_euclid(TAU) - PI).abs()
}

/// Returns the distance between two pixels.
pub(crate) fn distance(a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}
