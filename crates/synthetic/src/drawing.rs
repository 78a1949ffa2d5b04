//! What is printed on targets: ink or paper at any place.
//!
//! A drawing has units of its own: squares, tags with the gap beside them, or distances between dots. The origin is the
//! target's first point.

use boresight_data::{CircleLayout, Geometry, Target, quarter_turned};

/// What a target's geometry leaves open about its print.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Print {
    /// The colour of the square in the first corner of a ChArUco board.
    pub first_square: FirstSquare,
    /// The width of the black border of the tags of an AprilGrid, in modules.
    pub tag_border: usize,
    /// The radius of dots, as a share of the distance between rows.
    pub dot_radius: f64,
}

/// The colour of the square in the first corner of a ChArUco board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FirstSquare {
    /// Dark: the current pattern.
    Dark,
    /// White, with a marker: that of OpenCV before 4.6 on boards with an even number of rows.
    White,
}

impl Default for Print {
    fn default() -> Self {
        Self { first_square: FirstSquare::Dark, tag_border: 2, dot_radius: 0.3 }
    }
}

/// A target's print.
pub(crate) struct Drawing {
    kind: Kind,
    /// A unit in metres.
    pub unit_m: f64,
    /// Where the last point is, in units.
    pub extent: [f64; 2],
    /// How far the print reaches beyond the first and the last point, in units.
    rim: f64,
    /// The sign of z on the side that is printed.
    pub front: f64,
    /// Where along a unit the ink may change, for both axes alike; empty for dots.
    edges: Vec<f64>,
}

enum Kind {
    Squares { first_is_white: bool, markers: Option<Markers> },
    Tags { columns: i64, rows: i64, tag: f64, tags: Markers },
    Dots { dots: Vec<[f64; 2]>, radius: f64 },
}

/// Marker bits with a border, of each cell that has one.
struct Markers {
    /// Columns of cells.
    columns: i64,
    /// The code of each cell, row by row.
    codes: Vec<Option<u64>>,
    /// Bits along a side.
    side: usize,
    /// The border in modules.
    border: usize,
    /// From the side of a cell to the marker, in units.
    inset: f64,
}

impl Drawing {
    /// Returns the print of a target, or `None` for a set of points.
    pub fn new(target: &Target, print: &Print) -> Option<Self> {
        let last = boresight_data::PointId(u32::try_from(target.point_count()).ok()?.checked_sub(1)?);
        let in_units = |unit_m: f64| {
            let at = target.drawn_point(last);
            [at.x / unit_m, at.y / unit_m]
        };
        match target.geometry {
            Geometry::Chessboard { columns, rows, spacing_m } => Some(Self {
                kind: Kind::Squares { first_is_white: false, markers: None },
                unit_m: spacing_m,
                extent: [f64::from(columns) - 1.0, f64::from(rows) - 1.0],
                rim: 1.0,
                front: -1.0,
                edges: vec![0.0],
            }),
            Geometry::Charuco { columns, rows, spacing_m, marker_m, dictionary } => {
                let inset = 0.5 * (1.0 - marker_m / spacing_m);
                let first_is_white = print.first_square == FirstSquare::White;
                let mut codes = dictionary.codes().iter();
                let cells = (0..rows).flat_map(|row| (0..columns).map(move |column| row + column));
                let code = |sum: u32| {
                    if sum.is_multiple_of(2) == first_is_white { codes.next().copied() } else { None }
                };
                let markers = Markers {
                    columns: i64::from(columns),
                    codes: cells.map(code).collect(),
                    side: dictionary.bits_across(),
                    border: 1,
                    inset,
                };
                let mut edges = markers.edges(1.0);
                edges.push(0.0);
                Some(Self {
                    kind: Kind::Squares { first_is_white, markers: Some(markers) },
                    unit_m: spacing_m,
                    extent: [f64::from(columns) - 2.0, f64::from(rows) - 2.0],
                    rim: 1.0,
                    front: -1.0,
                    edges,
                })
            }
            Geometry::AprilGrid { columns, rows, tag_m, spacing, dictionary } => {
                let unit_m = tag_m * (1.0 + spacing);
                let tag = 1.0 / (1.0 + spacing);
                let side = dictionary.bits_across();
                // Tags lie upside down, so that in the frame of the grid, whose y is up, their bits are mirrored.
                let upside_down = |code: &u64| Some(quarter_turned(quarter_turned(*code, side), side));
                let n = columns as usize * rows as usize;
                let tags = Markers {
                    columns: i64::from(columns),
                    codes: dictionary.codes().iter().take(n).map(upside_down).collect(),
                    side,
                    border: print.tag_border,
                    inset: 0.0,
                };
                let mut edges = tags.edges(tag);
                edges.extend([0.0, tag]);
                Some(Self {
                    kind: Kind::Tags { columns: i64::from(columns), rows: i64::from(rows), tag, tags },
                    unit_m,
                    extent: in_units(unit_m),
                    rim: spacing * tag,
                    front: 1.0,
                    edges,
                })
            }
            Geometry::Circles { columns, rows, spacing_m, layout } => {
                let at = |i: u32| {
                    let at = target.drawn_point(boresight_data::PointId(i));
                    [at.x / spacing_m, at.y / spacing_m]
                };
                let mut extent = in_units(spacing_m);
                if layout == CircleLayout::Asymmetric {
                    extent[0] = f64::from(2 * columns - 1);
                }
                Some(Self {
                    kind: Kind::Dots {
                        dots: (0..columns * rows).map(at).collect(),
                        radius: print.dot_radius,
                    },
                    unit_m: spacing_m,
                    extent,
                    rim: print.dot_radius,
                    front: -1.0,
                    edges: Vec::new(),
                })
            }
            Geometry::Points { .. } => None,
        }
    }

    /// Returns the lowest and the highest place of the print along x and y.
    pub fn printed(&self) -> ([f64; 2], [f64; 2]) {
        ([-self.rim; 2], self.extent.map(|last| last + self.rim))
    }

    /// Returns the middles of the dots and their radius, or `None` if there are none.
    pub fn dots(&self) -> Option<(&[[f64; 2]], f64)> {
        match &self.kind {
            Kind::Dots { dots, radius } => Some((dots, *radius)),
            _ => None,
        }
    }

    /// Returns where the ink may change along an axis between two places, both included, ascending.
    pub fn boundaries(&self, low: f64, high: f64) -> Vec<f64> {
        let cells = low.floor() as i64..=high.ceil() as i64;
        let inner = cells.flat_map(|cell| self.edges.iter().map(move |edge| cell as f64 + edge));
        let mut boundaries: Vec<f64> = inner.filter(|at| *at > low && *at < high).collect();
        boundaries.extend([low, high]);
        boundaries.sort_by(f64::total_cmp);
        // Edges that rounding tells apart are one.
        boundaries.dedup_by(|later, earlier| *later - *earlier < 1e-9);
        boundaries
    }

    /// Tells whether a place is further than `width` units beyond the print.
    pub fn is_beyond(&self, at: [f64; 2], width: f64) -> bool {
        let rim = self.rim + width;
        (0..2).any(|axis| at[axis] < -rim || at[axis] > self.extent[axis] + rim)
    }

    /// Tells whether nothing changes within `reach` of a place along either axis; margins are not looked at.
    pub fn is_plain(&self, at: [f64; 2], reach: [f64; 2]) -> bool {
        if let Kind::Dots { dots, radius } = &self.kind {
            let reach = reach[0].hypot(reach[1]);
            return dots.iter().all(|dot| {
                let distance = (at[0] - dot[0]).hypot(at[1] - dot[1]);
                (distance - radius).abs() > reach
            });
        }
        (0..2).all(|axis| {
            self.edges.iter().all(|edge| {
                let from = at[axis] - edge;
                (from - from.round()).abs() > reach[axis]
            })
        })
    }

    /// Tells whether there is ink at a place.
    pub fn is_ink(&self, at: [f64; 2]) -> bool {
        if self.is_beyond(at, 0.0) {
            return false;
        }
        let [x, y] = at;
        match &self.kind {
            Kind::Squares { first_is_white, markers } => {
                let is_even = (x.floor() + y.floor()).rem_euclid(2.0) == 0.0;
                let is_white = is_even == *first_is_white;
                let cell = [x.floor() as i64 + 1, y.floor() as i64 + 1];
                let inside = [x - x.floor(), y - y.floor()];
                !is_white || markers.as_ref().is_some_and(|markers| markers.is_ink(cell, inside))
            }
            Kind::Tags { columns, rows, tag, tags } => {
                let cell = [x.floor() as i64, y.floor() as i64];
                let inside = [(x - x.floor()) / tag, (y - y.floor()) / tag];
                let is_tag = [inside[0] < 1.0, inside[1] < 1.0];
                let has_tag = (0..*columns).contains(&cell[0]) && (0..*rows).contains(&cell[1]);
                match is_tag {
                    // Rows of bits go downwards; the grid's y is up, and the codes are turned for that.
                    [true, true] => has_tag && tags.is_ink(cell, [inside[0], 1.0 - inside[1]]),
                    [false, false] => true,
                    _ => false,
                }
            }
            Kind::Dots { dots, radius } => dots.iter().any(|dot| (x - dot[0]).hypot(y - dot[1]) < *radius),
        }
    }
}

impl Markers {
    /// Returns where along a cell that is `width` units wide modules begin and end.
    fn edges(&self, width: f64) -> Vec<f64> {
        let modules = self.side + 2 * self.border;
        let at = |i: usize| self.inset + (1.0 - 2.0 * self.inset) * i as f64 / modules as f64;
        (0..=modules).map(|i| width * at(i)).collect()
    }

    /// Tells whether there is ink at a place in a cell, given in shares of its sides.
    fn is_ink(&self, [column, row]: [i64; 2], inside: [f64; 2]) -> bool {
        let at = usize::try_from(row * self.columns + column).ok();
        let Some(code) = at.and_then(|at| *self.codes.get(at)?) else { return false };
        let modules = (self.side + 2 * self.border) as f64;
        let [x, y] = inside.map(|t| ((t - self.inset) / (1.0 - 2.0 * self.inset) * modules).floor() as i64);
        let (side, border) = (self.side as i64, self.border as i64);
        let is_within = |range: std::ops::Range<i64>| range.contains(&x) && range.contains(&y);
        if is_within(border..border + side) {
            let bit = (y - border) * side + x - border;
            code >> (side * side - 1 - bit) & 1 == 0
        } else {
            is_within(0..2 * border + side)
        }
    }
}

#[cfg(test)]
mod tests {
    use boresight_data::{Dictionary, Shape};

    use super::*;

    fn drawing(geometry: Geometry, print: &Print) -> Drawing {
        let target = Target { name: "t".to_owned(), geometry, shape: Shape::Rigid };
        Drawing::new(&target, print).unwrap()
    }

    /// Returns the ink at the middles of `n` by `n` parts of a cell as letters, rows from the top of the paper.
    fn letters(drawing: &Drawing, low: [f64; 2], high: [f64; 2], n: usize) -> String {
        let at = |i: usize, axis: usize| low[axis] + (high[axis] - low[axis]) * (i as f64 + 0.5) / n as f64;
        let rows = (0..n).map(|row| {
            (0..n).map(|column| if drawing.is_ink([at(column, 0), at(row, 1)]) { '#' } else { '.' }).collect()
        });
        rows.collect::<Vec<String>>().join(" ")
    }

    #[test]
    fn markers_are_those_of_the_dictionary() {
        // Marker 0 of 4x4_50 is 1011 0101 0011 0010.
        let dictionary = Dictionary::named("4x4_50").unwrap();
        let geometry = Geometry::Charuco { columns: 5, rows: 4, spacing_m: 0.04, marker_m: 0.03, dictionary };
        let expected = "###### #.#..# ##.#.# ###..# ###.## ######";
        let print = Print::default();
        // The first marker is in the second square, which the first corner is the lower left end of.
        let current = drawing(geometry.clone(), &print);
        assert_eq!(letters(&current, [0.125, -0.875], [0.875, -0.125], 6), expected);
        assert!(current.is_ink([-0.5, -0.5]) && !current.is_ink([0.06, -0.06]) && current.is_ink([0.1, 0.1]));
        let legacy = drawing(geometry, &Print { first_square: FirstSquare::White, ..print });
        assert_eq!(letters(&legacy, [-0.875, -0.875], [-0.125, -0.125], 6), expected);
    }

    #[test]
    fn tags_lie_upside_down_in_a_frame_whose_y_is_up() {
        let dictionary = Dictionary::APRILTAG_36H11;
        let geometry = Geometry::AprilGrid { columns: 2, rows: 1, tag_m: 0.1, spacing: 0.25, dictionary };
        for tag_border in [1, 2] {
            let grid = drawing(geometry.clone(), &Print { tag_border, ..Print::default() });
            let from = 0.8 * tag_border as f64 / (6 + 2 * tag_border) as f64;
            // From high to low in both axes, as the tag lies upside down; its first row is 001000.
            let bits = letters(&grid, [0.8 - from, from], [from, 0.8 - from], 6);
            assert!(bits.starts_with("##.### #..#.# ###.#."), "{bits}");
            assert!(grid.is_ink([0.02, 0.4]) && !grid.is_ink([-0.1, 0.4]) && grid.is_ink([-0.1, -0.1]));
            assert!(grid.is_ink([0.9, 0.9]) && !grid.is_ink([0.9, 0.4]) && !grid.is_ink([0.9, 1.1]));
        }
    }

    #[test]
    fn dots_are_round() {
        let geometry = |layout| Geometry::Circles { columns: 3, rows: 2, spacing_m: 0.02, layout };
        let dots = drawing(geometry(CircleLayout::Asymmetric), &Print::default());
        assert!(dots.is_ink([1.2, 0.2 + 0.9]) && !dots.is_ink([1.25, 1.25]) && !dots.is_ink([0.0, 1.0]));
        assert_eq!(dots.extent, [5.0, 1.0]);
        assert!(dots.is_plain([0.0, 0.0], [0.1; 2]) && !dots.is_plain([0.3, 0.0], [0.1; 2]));
    }
}
