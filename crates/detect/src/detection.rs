//! What a detector says of an image.

use std::fmt;

use boresight_data::Observation;

/// The points seen in an image, or why there are none.
#[derive(Clone, Debug, PartialEq)]
pub struct Detection {
    /// The points, in increasing order of their ids; the sigma of each is what the image says.
    pub observations: Vec<Observation>,
    /// Why there are none; `None` if there are some.
    pub missed: Option<Missed>,
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
    /// No detector knows targets of this kind.
    NoDetector,
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
            Missed::Ambiguous { corners } => {
                write!(f, "{corners} corners of a board are seen, but not enough of its rim to tell which")
            }
            Missed::Contradiction { corners } => {
                write!(f, "{corners} corners of a board are seen that cannot be the target's")
            }
            Missed::NoDetector => f.write_str("targets of this kind cannot be detected"),
        }
    }
}

impl Detection {
    /// Returns that nothing was detected.
    pub(crate) fn missed(missed: Missed) -> Self {
        Self { observations: Vec::new(), missed: Some(missed) }
    }

    /// Tells whether this says more: more points, or without any a better reason.
    pub(crate) fn is_better_than(&self, other: &Self) -> bool {
        let rank = |missed: &Option<Missed>| match missed {
            None => (5, 0),
            Some(Missed::OtherSize { .. }) => (4, 0),
            Some(Missed::TooLarge { .. }) => (3, 0),
            Some(Missed::Ambiguous { corners } | Missed::Contradiction { corners }) => (2, *corners),
            Some(Missed::NoBoard) => (1, 0),
            Some(Missed::NoDetector) => (0, 0),
        };
        (self.observations.len(), rank(&self.missed)) > (other.observations.len(), rank(&other.missed))
    }
}
