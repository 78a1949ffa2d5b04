//! What a detector says of an image.

use std::fmt;

use boresight_data::{CircleLayout, Dictionary, Observation};

/// The points seen in an image, or why there are none.
#[derive(Clone, Debug, PartialEq)]
pub struct Detection {
    /// The points, in increasing order of their ids; the sigma of each is what the image says.
    pub observations: Vec<Observation>,
    /// Why there are none; `None` if there are some.
    pub missed: Option<Missed>,
    /// Which of its two patterns a ChArUco board has; `None` for other targets.
    pub pattern: Option<Pattern>,
    /// Whether what is seen shows that the target has the size that was declared: it ends on all sides where it should,
    /// or its markers are numbered so, on more than one row. Without that, labels are right if the size is.
    pub shows_size: bool,
}

/// Where the markers of a ChArUco board are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pattern {
    /// The square in the first corner is dark.
    Current,
    /// The square in the first corner is white, as OpenCV before 4.6 had it on boards with an even number of rows.
    Legacy,
}

impl Pattern {
    /// Tells whether the square in the first corner is white.
    pub(crate) fn first_is_white(self) -> bool {
        self == Pattern::Legacy
    }
}

/// Why a target was not detected.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Missed {
    /// Nothing in the image looks like the target.
    NoBoard,
    /// A whole board is seen, of another size.
    OtherSize {
        /// Its inner corners along the longer side.
        columns: u32,
        /// Its inner corners along the shorter side.
        rows: u32,
    },
    /// What is seen of a board is larger than the target.
    TooLarge {
        /// The inner corners that are seen along the longer side.
        columns: u32,
        /// The inner corners that are seen along the shorter side.
        rows: u32,
    },
    /// A part of the target may be seen; but where the rest should be, in the image, there are no corners. It is a smaller
    /// board, or something covers it.
    Short {
        /// The inner corners that are seen along the longer side.
        columns: u32,
        /// The inner corners that are seen along the shorter side.
        rows: u32,
    },
    /// A part of a board is seen, and not which part.
    Ambiguous {
        /// The corners of the part.
        corners: usize,
    },
    /// A board is seen that cannot be the target: its ends or its colours are elsewhere.
    Contradiction {
        /// The corners that are seen.
        corners: usize,
    },
    /// A ChArUco board is seen whose markers are numbered as on a board of this width.
    OtherSquares {
        /// Its squares along x.
        columns: u32,
        /// The rows of squares that are seen; there may be more.
        rows: u32,
    },
    /// A grid of tags is seen whose tags are numbered as on a grid of this width.
    OtherTags {
        /// Its tags along x.
        columns: u32,
        /// The rows of tags that are seen; there may be more.
        rows: u32,
    },
    /// A whole grid of dots is seen, of another size or layout.
    OtherDots {
        /// Its dots in a row; along the longer side if it is symmetric.
        columns: u32,
        /// Its rows.
        rows: u32,
        /// Whether every other row is shifted.
        layout: CircleLayout,
    },
    /// The markers that are seen are those of another dictionary, or of one that is part of it.
    OtherDictionary(Dictionary),
    /// Corners are seen, and no markers of any dictionary among them.
    NoMarkers {
        /// How many corners.
        corners: usize,
    },
    /// No detector knows targets of this kind.
    NoDetector,
}

impl Missed {
    /// Tells whether it says for certain that another board is seen, so that nothing else need be tried.
    pub(crate) fn is_certain(&self) -> bool {
        matches!(self, Missed::OtherSquares { .. } | Missed::OtherTags { .. } | Missed::OtherDictionary(_))
    }
}

impl fmt::Display for Missed {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Missed::NoBoard => f.write_str("no board is seen"),
            Missed::OtherSize { columns, rows } => {
                write!(f, "the board has {columns}x{rows} inner corners")
            }
            Missed::TooLarge { columns, rows } => {
                write!(f, "a board is seen with {columns}x{rows} inner corners or more")
            }
            Missed::Short { columns, rows } => {
                write!(
                    f,
                    "{columns}x{rows} inner corners are seen, and none where the target should have more"
                )
            }
            Missed::Ambiguous { corners } => {
                write!(f, "{corners} corners of a board are seen, but not enough of its rim to tell which")
            }
            Missed::Contradiction { corners } => {
                write!(f, "{corners} corners of a board are seen that cannot be the target's")
            }
            Missed::OtherSquares { columns, rows } => {
                write!(
                    f,
                    "the markers are numbered as on a board {columns} squares wide, of which {rows} rows are seen"
                )
            }
            Missed::OtherTags { columns, rows } => {
                write!(
                    f,
                    "the tags are numbered as on a grid {columns} tags wide, of which {rows} rows are seen"
                )
            }
            Missed::OtherDots { columns, rows, layout } => {
                let kind = match layout {
                    CircleLayout::Symmetric => "symmetric",
                    CircleLayout::Asymmetric => "asymmetric",
                };
                write!(f, "the grid has {columns}x{rows} dots and is {kind}")
            }
            Missed::OtherDictionary(dictionary) => {
                write!(f, "the markers are of the dictionary {} or a larger one", dictionary.name())
            }
            Missed::NoMarkers { corners } => {
                write!(f, "{corners} corners are seen, but no marker of any dictionary between them")
            }
            Missed::NoDetector => f.write_str("targets of this kind cannot be detected"),
        }
    }
}

impl Detection {
    /// Returns that nothing was detected.
    pub(crate) fn missed(missed: Missed) -> Self {
        Self { observations: Vec::new(), missed: Some(missed), pattern: None, shows_size: false }
    }

    /// Tells whether this says more: more points, or without any a better reason.
    ///
    /// A whole board of another size is more than a part of the target with fewer points.
    pub(crate) fn is_better_than(&self, other: &Self) -> bool {
        let is_doubted = |labelled: &Self, doubt: &Self| {
            let n = labelled.observations.len();
            let n_other = match doubt.missed {
                Some(Missed::OtherSize { columns, rows }) => (columns * rows) as usize,
                _ => 0,
            };
            0 < n && n <= n_other && !labelled.shows_size
        };
        if is_doubted(self, other) {
            return false;
        }
        if is_doubted(other, self) {
            return true;
        }
        let rank = |missed: &Option<Missed>| match missed {
            None => (5, 0),
            Some(Missed::OtherSize { .. } | Missed::OtherSquares { .. } | Missed::OtherTags { .. }) => (4, 0),
            Some(Missed::OtherDictionary(_) | Missed::OtherDots { .. }) => (4, 0),
            Some(Missed::TooLarge { .. } | Missed::Short { .. }) => (3, 0),
            Some(
                Missed::Ambiguous { corners }
                | Missed::Contradiction { corners }
                | Missed::NoMarkers { corners },
            ) => (2, *corners),
            Some(Missed::NoBoard) => (1, 0),
            Some(Missed::NoDetector) => (0, 0),
        };
        (self.observations.len(), rank(&self.missed)) > (other.observations.len(), rank(&other.missed))
    }
}
