//! Scenes with known truth, and what cameras would have seen of them.
//!
//! A [`Recipe`] says which cameras, which target, how it is waved about, and how bad the corners
//! are. [`simulate`] turns it and a seed into a [`Synthetic`]: truth, dataset, clean pixels, and
//! which observations are outliers. The same recipe and seed give the same bytes. [`simulate_moving`]
//! does so for cameras that look at different times, [`render`] makes images of a target, and [`sheet`] draws one for
//! print.
//!
//! Architecture invariant: nothing here estimates anything, and nothing is random without a seed.

mod drawing;
mod lenses;
mod moving;
mod paper;
mod place;
mod recipe;
mod render;
mod robot;
mod simulate;
mod svg;

pub use drawing::{FirstSquare, Print};
pub use moving::{Timing, simulate_moving};
pub use paper::Paper;
pub use recipe::{Outliers, PlacedCamera, Placement, Recipe};
pub use render::{Depth, Exposure, render};
pub use robot::{RobotRecipe, add_robot};
pub use simulate::{Synthetic, simulate};
pub use svg::{NotDrawn, Sheet, sheet};
