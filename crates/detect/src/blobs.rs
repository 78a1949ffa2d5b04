//! Dark ellipses on a bright ground, measured by their moments.

use boresight_data::{GrayImage, GrayPixels};

use crate::statistics::median;

/// The fewest pixels of a blob.
const FEWEST_PX: usize = 12;
/// The largest blob, as a share of the image.
const LARGEST_SHARE: f64 = 0.05;
/// How much darker than its surroundings a pixel of a blob is, as a share of the range of grey values.
const DARKER_SHARE: f64 = 0.06;
/// The longest ellipse: the ratio of its axes.
const LONGEST: f64 = 6.0;

/// A dark ellipse.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Blob {
    /// Its middle: the mean place of what is dark.
    pub pixel: [f64; 2],
    /// Its area in pixels.
    pub area_px: f64,
    /// The standard deviation of either coordinate that noise around it makes.
    pub sigma_px: f64,
}

/// Returns the dark ellipses of an image; grey values are compared with their mean over a window of this share of the
/// image's shorter side.
pub(crate) fn find_blobs(image: &GrayImage, window_share: f64) -> Vec<Blob> {
    let [width, height] = image.size().map(|side| side as usize);
    if width < 16 || height < 16 {
        return Vec::new();
    }
    let grey: Vec<f64> = match image.pixels() {
        GrayPixels::Eight(values) => values.iter().map(|&value| f64::from(value)).collect(),
        GrayPixels::Sixteen(values) => values.iter().map(|&value| f64::from(value)).collect(),
    };
    let (low, high) = grey.iter().fold((f64::MAX, f64::MIN), |(low, high), &v| (low.min(v), high.max(v)));
    let reach = (window_share * width.min(height) as f64).max(4.0) as usize;
    let is_dark = darker(&grey, width, height, reach, DARKER_SHARE * (high - low));
    let mut seen = vec![false; grey.len()];
    let mut blobs = Vec::new();
    for start in 0..grey.len() {
        if !is_dark[start] || seen[start] {
            continue;
        }
        let region = flood(start, &is_dark, &mut seen, width);
        if let Some(region) = region.filter(|region| region.len() >= FEWEST_PX) {
            blobs.extend(measure(&region, &grey, width, height));
        }
    }
    blobs
}

/// Tells of each pixel whether it is darker than the mean around it, by at least so much.
fn darker(grey: &[f64], width: usize, height: usize, reach: usize, by: f64) -> Vec<bool> {
    let mut sums = vec![0.0; (width + 1) * (height + 1)];
    for y in 0..height {
        let mut row = 0.0;
        for x in 0..width {
            row += grey[y * width + x];
            sums[(y + 1) * (width + 1) + x + 1] = sums[y * (width + 1) + x + 1] + row;
        }
    }
    let mut dark = Vec::with_capacity(grey.len());
    for y in 0..height {
        let (top, bottom) = (y.saturating_sub(reach), (y + reach + 1).min(height));
        for x in 0..width {
            let (left, right) = (x.saturating_sub(reach), (x + reach + 1).min(width));
            let at = |x: usize, y: usize| sums[y * (width + 1) + x];
            let sum = at(right, bottom) - at(left, bottom) - at(right, top) + at(left, top);
            let mean = sum / ((right - left) * (bottom - top)) as f64;
            dark.push(grey[y * width + x] < mean - by);
        }
    }
    dark
}

/// Returns the dark pixels joined to one, or `None` if they reach the border of the image or are too many.
fn flood(start: usize, is_dark: &[bool], seen: &mut [bool], width: usize) -> Option<Vec<usize>> {
    let height = is_dark.len() / width;
    let most = (LARGEST_SHARE * is_dark.len() as f64) as usize;
    let mut region = vec![start];
    let mut is_whole = true;
    seen[start] = true;
    let mut next = 0;
    while let Some(&at) = region.get(next) {
        next += 1;
        let (x, y) = (at % width, at / width);
        if x == 0 || y == 0 || x + 1 == width || y + 1 == height {
            is_whole = false;
            continue;
        }
        for other in [at - 1, at + 1, at - width, at + width] {
            if is_dark[other] && !seen[other] {
                seen[other] = true;
                region.push(other);
            }
        }
    }
    (is_whole && region.len() <= most).then_some(region)
}

/// Measures a region that is an ellipse; `None` for other shapes.
fn measure(region: &[usize], grey: &[f64], width: usize, height: usize) -> Option<Blob> {
    let n = region.len() as f64;
    let mean = |of: &dyn Fn(usize) -> f64| region.iter().map(|&at| of(at)).sum::<f64>() / n;
    let place = |at: usize| [(at % width) as f64, (at / width) as f64];
    let middle = [mean(&|at| place(at)[0]), mean(&|at| place(at)[1])];
    let away = |at: usize| [place(at)[0] - middle[0], place(at)[1] - middle[1]];
    // A pixel's own extent adds a twelfth.
    let (xx, yy) =
        (mean(&|at| away(at)[0].powi(2)) + 1.0 / 12.0, mean(&|at| away(at)[1].powi(2)) + 1.0 / 12.0);
    let xy = mean(&|at| away(at)[0] * away(at)[1]);
    let determinant = xx * yy - xy * xy;
    let root = (0.25 * (xx - yy).powi(2) + xy * xy).sqrt();
    let (major, minor) = (0.5 * (xx + yy) + root, 0.5 * (xx + yy) - root);
    // The area of an ellipse with these moments: no other shape of the same moments has less.
    let area = 4.0 * std::f64::consts::PI * determinant.max(0.0).sqrt();
    let is_ellipse = (n / area - 1.0).abs() < 0.12 + 1.0 / n.sqrt();
    if !is_ellipse || minor <= 0.0 || (major / minor).sqrt() > LONGEST {
        return None;
    }
    // Distances in units of the ellipse: 1 is its rim, wherever the threshold put that.
    let relative =
        |[x, y]: [f64; 2]| ((yy * x * x - 2.0 * xy * x * y + xx * y * y) / (4.0 * determinant)).sqrt();
    let minor_px = 2.0 * minor.sqrt();
    let (inner, outer) = (1.0 - (1.5 / minor_px).min(0.5), 1.0 + 2.0 / minor_px);
    let far = outer + 2.0 / minor_px;
    let half = [(far * 2.0 * xx.sqrt()).ceil() as isize + 1, (far * 2.0 * yy.sqrt()).ceil() as isize + 1];
    let corner = middle.map(|c| c.round() as isize);
    let mut around: Vec<([f64; 2], f64, f64)> = Vec::new();
    for y in corner[1] - half[1]..=corner[1] + half[1] {
        for x in corner[0] - half[0]..=corner[0] + half[0] {
            if x < 0 || y < 0 || x as usize >= width || y as usize >= height {
                return None;
            }
            let [dx, dy] = [x as f64 - middle[0], y as f64 - middle[1]];
            let at = relative([dx, dy]);
            if at <= far {
                around.push(([dx, dy], at, grey[y as usize * width + x as usize]));
            }
        }
    }
    let of = |from: f64, to: f64| -> Vec<f64> {
        around.iter().filter(|(_, at, _)| (from..=to).contains(at)).map(|(_, _, grey)| *grey).collect()
    };
    let (dark, bright) = (of(0.0, inner), of(outer, far));
    let (black, white) = (median(dark)?, median(bright.iter().copied())?);
    let contrast = white - black;
    if contrast <= 0.0 {
        return None;
    }
    // How much of each pixel is dark; the mean place of that is the middle, whatever the blur.
    let (mut sum, mut moment) = (0.0, [0.0; 2]);
    for ([x, y], at, grey) in &around {
        if *at <= outer {
            let share = (white - grey) / contrast;
            sum += share;
            moment = [moment[0] + share * x, moment[1] + share * y];
        }
    }
    let pixel = [0, 1].map(|i| middle[i] + moment[i] / sum);
    let noise = (bright.iter().map(|grey| (grey - white).powi(2)).sum::<f64>() / bright.len() as f64).sqrt();
    let square: f64 =
        around.iter().filter(|(_, at, _)| *at <= outer).map(|([x, y], ..)| 0.5 * (x * x + y * y)).sum();
    let sigma_px = noise / contrast * square.sqrt() / sum;
    let is_sane = sum > 0.0 && pixel.iter().chain([&sigma_px]).all(|value| value.is_finite());
    is_sane.then_some(Blob { pixel, area_px: sum, sigma_px })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns an image with ink where a test says, of 80 by 60 pixels.
    fn image(is_ink: impl Fn(f64, f64) -> bool) -> GrayImage {
        let share = |x: f64, y: f64| {
            let inked = (0..64).filter(|i| {
                let [du, dv] = [i % 8, i / 8].map(|k| (f64::from(k) + 0.5) / 8.0 - 0.5);
                is_ink(x + du, y + dv)
            });
            inked.count() as f64 / 64.0
        };
        let value = |i: usize| (200.0 - 150.0 * share((i % 80) as f64, (i / 80) as f64)).round() as u8;
        GrayImage::new([80, 60], GrayPixels::Eight((0..80 * 60).map(value).collect())).unwrap()
    }

    #[test]
    fn the_middle_of_an_ellipse_is_found() {
        let at = [33.3, 28.8];
        let ellipse = |x: f64, y: f64| {
            let (along, across) =
                (0.8 * (x - at[0]) + 0.6 * (y - at[1]), 0.8 * (y - at[1]) - 0.6 * (x - at[0]));
            (along / 10.0).powi(2) + (across / 5.0).powi(2) < 1.0
        };
        let blobs = find_blobs(&image(ellipse), 0.3);
        let [blob] = blobs[..] else { panic!("{blobs:?}") };
        assert!((blob.pixel[0] - at[0]).hypot(blob.pixel[1] - at[1]) < 0.01, "{blob:?}");
        assert!((blob.area_px / (50.0 * std::f64::consts::PI) - 1.0).abs() < 0.01, "{blob:?}");
    }

    #[test]
    fn other_shapes_and_what_is_cut_by_the_border_are_left_out() {
        let shapes: [fn(f64, f64) -> bool; 4] = [
            |x, y| {
                (10.0..30.0).contains(&x) && (20.0..24.0).contains(&y)
                    || (10.0..14.0).contains(&x) && (20.0..40.0).contains(&y)
            },
            |x, y| x.hypot(y - 30.0) < 9.0,
            |x, y| (x - 40.0).hypot(y - 30.0) < 1.2,
            |x, y| (8.0..12.0).contains(&(x - 40.0).hypot(y - 30.0)),
        ];
        for (i, shape) in shapes.iter().enumerate() {
            assert_eq!(find_blobs(&image(shape), 0.3), [], "shape {i}");
        }
        let plain = GrayImage::new([3, 3], GrayPixels::Eight(vec![0; 9])).unwrap();
        assert_eq!(find_blobs(&plain, 0.3), []);
    }
}
