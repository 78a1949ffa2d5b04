//! Planes of grey values as detectors work on them: at full size, at half, at a quarter.

use boresight_data::{GrayImage, GrayPixels};

/// Grey values, row by row.
#[derive(Clone, Debug)]
pub(crate) struct Plane {
    pub width: usize,
    pub height: usize,
    pub values: Vec<f32>,
}

impl Plane {
    /// Returns the values of an image.
    pub fn of(image: &GrayImage) -> Self {
        let [width, height] = image.size().map(|side| side as usize);
        let values = match image.pixels() {
            GrayPixels::Eight(values) => values.iter().map(|&value| f32::from(value)).collect(),
            GrayPixels::Sixteen(values) => values.iter().map(|&value| f32::from(value)).collect(),
        };
        Self { width, height, values }
    }

    /// Returns the image at half its size: each pixel is the mean of four.
    pub fn half_of(image: &GrayImage) -> Self {
        let width = image.size()[0] as usize;
        match image.pixels() {
            GrayPixels::Eight(values) => halve(values, width, f32::from),
            GrayPixels::Sixteen(values) => halve(values, width, f32::from),
        }
    }

    /// Returns the plane at half its size: each pixel is the mean of four.
    pub fn halved(&self) -> Self {
        halve(&self.values, self.width, |value| value)
    }

    /// Returns the plane convolved with the binomial [1 4 6 4 1] / 16 along rows and columns; its border of two is zero.
    pub fn smoothed(&self) -> Self {
        let (width, height) = (self.width, self.height);
        let mut smooth = Self { width, height, values: vec![0.0; self.values.len()] };
        if width < 5 || height < 5 {
            return smooth;
        }
        let mut column = vec![0.0f32; width];
        for y in 2..height - 2 {
            let row = |dy: usize| &self.values[(y + dy - 2) * width..][..width];
            let (a, b, c, d, e) = (row(0), row(1), row(2), row(3), row(4));
            for x in 0..width {
                column[x] = (a[x] + e[x] + 4.0 * (b[x] + d[x]) + 6.0 * c[x]) * (1.0 / 16.0);
            }
            let out = &mut smooth.values[y * width + 2..][..width - 4];
            let (a, b, c, d, e) = (
                &column[..width - 4],
                &column[1..width - 3],
                &column[2..width - 2],
                &column[3..width - 1],
                &column[4..],
            );
            for x in 0..width - 4 {
                out[x] = (a[x] + e[x] + 4.0 * (b[x] + d[x]) + 6.0 * c[x]) * (1.0 / 16.0);
            }
        }
        smooth
    }

    /// Tells whether a pixel of the image that this is at 1/`scale` of its size is at least `room_px` from its border.
    pub fn holds(&self, pixel: [f64; 2], scale: f64, room_px: f64) -> bool {
        let is_within = |at: f64, side: usize| at >= room_px && at <= scale * side as f64 - 1.0 - room_px;
        is_within(pixel[0], self.width) && is_within(pixel[1], self.height)
    }

    /// Returns the value at a place between pixels, or `None` within `border` pixels of the border or beyond.
    #[inline]
    pub fn sample(&self, [u, v]: [f64; 2], border: f64) -> Option<f32> {
        let inside = u >= border
            && v >= border
            && u < self.width as f64 - 1.0 - border
            && v < self.height as f64 - 1.0 - border;
        inside.then(|| self.sample_inside([u, v]))
    }

    /// Returns the value at a place between pixels that are all in the plane.
    #[inline]
    pub fn sample_inside(&self, [u, v]: [f64; 2]) -> f32 {
        let (x, y) = (u as usize, v as usize);
        let (across, down) = ((u - x as f64) as f32, (v - y as f64) as f32);
        let at = y * self.width + x;
        let (upper, lower) = (&self.values[at..at + 2], &self.values[at + self.width..at + self.width + 2]);
        let top = upper[0] + across * (upper[1] - upper[0]);
        let bottom = lower[0] + across * (lower[1] - lower[0]);
        top + down * (bottom - top)
    }

    /// Returns the values below and above which one percent of a coarse sample lies.
    pub fn range(&self) -> [f32; 2] {
        let step = (self.values.len() / 4096).max(1);
        let mut values: Vec<f32> = self.values.iter().step_by(step).copied().collect();
        values.sort_by(f32::total_cmp);
        let Some(last) = values.len().checked_sub(1) else { return [0.0; 2] };
        [values[last / 100], values[last - last / 100]]
    }
}

fn halve<P: Copy>(values: &[P], width: usize, grey: impl Fn(P) -> f32) -> Plane {
    let height = values.len() / width.max(1);
    let half = [width / 2, height / 2];
    let mut halved = Vec::with_capacity(half[0] * half[1]);
    for y in 0..half[1] {
        let upper = &values[2 * y * width..][..2 * half[0]];
        let lower = &values[(2 * y + 1) * width..][..2 * half[0]];
        let pairs = upper.chunks_exact(2).zip(lower.chunks_exact(2));
        halved.extend(pairs.map(|(a, b)| (grey(a[0]) + grey(a[1]) + grey(b[0]) + grey(b[1])) * 0.25));
    }
    Plane { width: half[0], height: half[1], values: halved }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ramp(width: usize, height: usize) -> Plane {
        let values = (0..width * height).map(|i| (3 * (i % width) + 5 * (i / width)) as f32).collect();
        Plane { width, height, values }
    }

    #[test]
    fn a_ramp_stays_a_ramp() {
        let plane = ramp(11, 9);
        let smooth = plane.smoothed();
        assert_eq!(smooth.values[4 * 11 + 5], plane.values[4 * 11 + 5]);
        assert_eq!(plane.sample([4.5, 3.25], 1.0), Some(3.0 * 4.5 + 5.0 * 3.25));
        assert_eq!((plane.sample([10.0, 3.0], 0.0), plane.sample([0.5, 3.0], 1.0)), (None, None));
        // The centre of a halved pixel is between the four that it was made of.
        let half = plane.halved();
        assert_eq!((half.width, half.height, half.values[0]), (5, 4, 0.5 * 3.0 + 0.5 * 5.0));
    }

    #[test]
    fn images_of_any_size_are_taken() {
        for size in [[0, 0], [1, 1], [1, 7], [4, 4], [5, 5]] {
            let image =
                GrayImage::new(size, GrayPixels::Eight(vec![9; (size[0] * size[1]) as usize])).unwrap();
            let plane = Plane::of(&image);
            assert_eq!(plane.smoothed().values.len(), plane.values.len());
            assert_eq!(Plane::half_of(&image).values.len(), (size[0] / 2 * (size[1] / 2)) as usize);
            assert_eq!(plane.range(), if size[0] == 0 { [0.0; 2] } else { [9.0; 2] });
        }
    }
}
