//! The grid of pixels at which cameras are compared.

use boresight_camera::Camera;

use crate::{CompareOptions, Error};

/// The numbers of columns that make sense.
const COLUMNS: [usize; 2] = [2, 1000];

/// Pixels evenly spread from the centre of the top-left pixel to that of the bottom-right one.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Grid {
    pub(crate) image_size: [u32; 2],
    pub(crate) columns: usize,
    pub(crate) rows: usize,
}

impl Grid {
    /// Returns the grid over the images of both cameras, with cells about as high as wide.
    pub(crate) fn new(a: &Camera, b: &Camera, options: &CompareOptions) -> Result<Self, Error> {
        if a.image_size != b.image_size {
            return Err(Error::ImageSizes { a: a.image_size, b: b.image_size });
        }
        let [least, most] = COLUMNS;
        let columns = options.columns;
        if !(least..=most).contains(&columns) {
            return Err(Error::Columns { columns, least, most });
        }
        let [width, height] = a.image_size.map(f64::from);
        let rows = (height / width * columns as f64).round();
        let rows = if rows.is_finite() { (rows as usize).clamp(least, most) } else { least };
        Ok(Self { image_size: a.image_size, columns, rows })
    }

    /// Returns the number of points.
    pub(crate) fn len(&self) -> usize {
        self.columns * self.rows
    }

    /// Returns the pixel of a point, counted row by row.
    pub(crate) fn pixel(&self, i: usize) -> [f64; 2] {
        let along = |index: usize, count: usize, size: u32| {
            f64::from(size.saturating_sub(1)) * index as f64 / (count.max(2) - 1) as f64
        };
        let columns = self.columns.max(1);
        let (column, row) = (i % columns, i / columns);
        [along(column, columns, self.image_size[0]), along(row, self.rows, self.image_size[1])]
    }

    /// Returns the distance in pixels of a point from the middle of the image.
    pub(crate) fn radius(&self, i: usize) -> f64 {
        let middle = self.image_size.map(|size| 0.5 * (f64::from(size) - 1.0));
        let [u, v] = self.pixel(i);
        (u - middle[0]).hypot(v - middle[1])
    }
}
