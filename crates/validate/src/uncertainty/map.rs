//! The uncertainty of a camera's projections over its image, and with distance.

use boresight_geometry::nalgebra::SymmetricEigen;
use serde::{Deserialize, Serialize};

use super::{ProjectionUncertainty, Room, Spread};
use crate::Error;
use crate::compare::grid::Grid;
use crate::slopes::Slopes;
use crate::statistics::quantile;

/// Grids have two points or more along each side, and no more than this.
const MOST_POINTS: usize = 1000;

/// The uncertainty of projections over an image.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct UncertaintyMap {
    /// Width and height of the image in pixels.
    pub image_size: [u32; 2],
    /// The number of grid points across; the first and last are on the image's outermost pixels.
    pub columns: usize,
    /// The number of grid points down.
    pub rows: usize,
    /// The distance of what is seen in metres; `None` is infinity.
    pub distance_m: Option<f64>,
    /// The scatter at each grid point, row by row; `None` where the lens sees nothing.
    pub spreads: Vec<Option<Spread>>,
}

/// How well a pixel's ray is known at a distance.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct AtDistance {
    /// The distance in metres; `None` is infinity.
    pub distance_m: Option<f64>,
    /// The standard deviation along the worst direction, in pixels.
    pub worst_px: f64,
    /// That direction's angle from u towards v, in degrees.
    pub worst_direction_deg: f64,
    /// The same in millimetres across the ray at that distance; `None` at infinity.
    pub worst_mm: Option<f64>,
}

impl ProjectionUncertainty {
    /// Returns the uncertainty over the image at a distance in metres; `None` is infinity.
    pub fn map(&self, columns: usize, rows: usize, distance_m: Option<f64>) -> Result<UncertaintyMap, Error> {
        for points in [columns, rows] {
            if !(2..=MOST_POINTS).contains(&points) {
                return Err(Error::Columns { columns: points, least: 2, most: MOST_POINTS });
            }
        }
        check_distance(distance_m)?;
        let image_size = self.camera.image_size;
        let grid = Grid { image_size, columns, rows };
        let mut room = Room::default();
        let spreads = (0..grid.len()).map(|i| self.at_with(grid.pixel(i), distance_m, &mut room)).collect();
        Ok(UncertaintyMap { image_size, columns, rows, distance_m, spreads })
    }

    /// Returns how well a pixel's ray is known at some distances in metres; those at which the pixel
    /// sees nothing are left out.
    pub fn with_distance(
        &self,
        pixel: [f64; 2],
        distances_m: &[Option<f64>],
    ) -> Result<Vec<AtDistance>, Error> {
        let mut found = Vec::new();
        for &distance_m in distances_m {
            check_distance(distance_m)?;
            let Some(spread) = self.at(pixel, distance_m) else { continue };
            found.push(AtDistance {
                distance_m,
                worst_px: spread.worst_px(),
                worst_direction_deg: spread.worst_direction_deg(),
                worst_mm: distance_m.and_then(|distance| self.worst_mm(pixel, distance, &spread)),
            });
        }
        Ok(found)
    }

    /// Returns the standard deviation across the ray in millimetres.
    fn worst_mm(&self, pixel: [f64; 2], distance_m: f64, spread: &Spread) -> Option<f64> {
        let point = self.camera.unproject(pixel)? * distance_m;
        let mut slopes = Slopes::default();
        slopes.fill(&self.camera, &point)?;
        let by_pixel = slopes.point_by_pixel()?;
        let covariance = by_pixel * spread.matrix() * by_pixel.transpose();
        Some(1e3 * SymmetricEigen::new(covariance).eigenvalues.max().max(0.0).sqrt())
    }
}

impl UncertaintyMap {
    /// Returns each grid point's pixel with the scatter there, row by row.
    pub fn points(&self) -> impl Iterator<Item = ([f64; 2], Option<Spread>)> {
        let grid = Grid { image_size: self.image_size, columns: self.columns, rows: self.rows };
        self.spreads.iter().enumerate().map(move |(i, spread)| (grid.pixel(i), *spread))
    }

    /// Returns what a share of the grid's worst directions does not exceed, in pixels; `None` if the
    /// lens sees nothing at all.
    pub fn quantile_px(&self, share: f64) -> Option<f64> {
        quantile(self.spreads.iter().flatten().map(Spread::worst_px), share)
    }
}

/// Refuses distances that are none.
pub(crate) fn check_distance(distance_m: Option<f64>) -> Result<(), Error> {
    match distance_m.filter(|distance| !(*distance > 0.0 && distance.is_finite())) {
        Some(value) => Err(Error::NotPositive { option: "distance_m", value }),
        None => Ok(()),
    }
}
