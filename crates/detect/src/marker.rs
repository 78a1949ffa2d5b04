//! Square markers: bits read from a cell whose four corners are known, and what their dictionary says of them.

use boresight_data::{Dictionary, GrayImage, GrayPixels, quarter_turned};

use crate::statistics::median;

/// Where in a cell the bits of a marker are, in shares of the cell's side.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct MarkerCell {
    /// From the side of the cell to the border of the marker.
    pub inset: f64,
    /// Width of the border in modules.
    pub border: usize,
    /// From the side of the cell to a place that is white; negative is outside the cell.
    pub white_at: f64,
}

/// What was read in a cell: a marker of the dictionary.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Marker {
    /// Its id.
    pub id: u32,
    /// By how many quarters from +x towards +y it lies turned in the cell.
    pub turn: usize,
    /// How likely it is to read any marker, or this one, in a cell full of chance.
    pub chance_of_any: f64,
    /// See `chance_of_any`.
    pub chance_of_this: f64,
}

/// Reads the marker in the cell with corners at (0, 0), (1, 0), (1, 1) and (0, 1).
///
/// `None` if there is no dark border, or the bits are not those of a marker.
pub(crate) fn read_marker(
    image: &GrayImage,
    corners: [[f64; 2]; 4],
    cell: &MarkerCell,
    dictionary: Dictionary,
    least_contrast: f64,
) -> Option<Marker> {
    let side = dictionary.bits_across();
    let modules = side + 2 * cell.border;
    let pixel_of = square_to_quad(corners)?;
    let grey = |x: f64, y: f64| sample(image, pixel_of([x, y]));
    let module = (1.0 - 2.0 * cell.inset) / modules as f64;
    let mut greys = Vec::with_capacity(modules * modules);
    for row in 0..modules {
        for column in 0..modules {
            let mut sum = 0.0;
            for k in 0..9 {
                let at = |n: usize, k: usize| cell.inset + (n as f64 + 0.25 + 0.25 * k as f64) * module;
                sum += grey(at(column, k % 3), at(row, k / 3))?;
            }
            greys.push(sum / 9.0);
        }
    }
    let is_border = |i: usize| {
        let inside = |n: usize| (cell.border..cell.border + side).contains(&n);
        !inside(i % modules) || !inside(i / modules)
    };
    let black = median((0..greys.len()).filter(|i| is_border(*i)).map(|i| greys[i]))?;
    let beside = (1..6).map(|k| f64::from(k) / 6.0).flat_map(|t| {
        let w = cell.white_at;
        [[t, w], [t, 1.0 - w], [w, t], [1.0 - w, t]]
    });
    let white = median(beside.filter_map(|[x, y]| grey(x, y)))?;
    if white - black < least_contrast {
        return None;
    }
    // Where both colours are seen among the bits, their means are nearer to the truth than what is around them.
    let mut middle = 0.5 * (black + white);
    let mean = |bright: bool| {
        let of: Vec<f64> = greys.iter().copied().filter(|grey| (*grey > middle) == bright).collect();
        (!of.is_empty()).then(|| of.iter().sum::<f64>() / of.len() as f64)
    };
    if let (Some(low), Some(high)) = (mean(false), mean(true)) {
        middle = 0.5 * (low + high);
    }
    let n_border = modules * modules - side * side;
    let n_wrong = (0..greys.len()).filter(|i| is_border(*i) && greys[*i] > middle).count();
    if 8 * n_wrong > n_border {
        return None;
    }
    let bits = (0..greys.len()).filter(|i| !is_border(*i));
    let code = bits.fold(0, |code, i| code << 1 | u64::from(greys[i] > middle));
    identify(code, dictionary)
}

/// Returns the marker whose code this is, turned or not, with no more wrong bits than can be told.
fn identify(code: u64, dictionary: Dictionary) -> Option<Marker> {
    let side = dictionary.bits_across();
    let mut best: Option<(u32, u32, usize)> = None;
    let mut upright = code;
    for turned_back in 0..4 {
        for (id, marker) in dictionary.codes().iter().enumerate() {
            let wrong = (marker ^ upright).count_ones();
            if wrong <= dictionary.correctable_bits() && best.is_none_or(|(least, ..)| wrong < least) {
                best = Some((wrong, id as u32, (4 - turned_back) % 4));
            }
        }
        upright = quarter_turned(upright, side);
    }
    let (wrong, id, turn) = best?;
    // The share of all codes that differ from one by so many bits or fewer.
    let n_bits = (side * side) as f64;
    let (mut ways, mut sum) = (1.0, 1.0);
    for k in 1..=wrong {
        ways *= (n_bits - f64::from(k) + 1.0) / f64::from(k);
        sum += ways;
    }
    let chance_of_this = sum / n_bits.exp2();
    let chance_of_any = 4.0 * dictionary.codes().len() as f64 * chance_of_this;
    Some(Marker { id, turn, chance_of_any, chance_of_this })
}

/// Returns the grey value between pixels, or `None` beyond the border.
fn sample(image: &GrayImage, [u, v]: [f64; 2]) -> Option<f64> {
    let [width, height] = image.size().map(|side| side as usize);
    let is_inside = u >= 0.0 && v >= 0.0 && u + 1.0 < width as f64 && v + 1.0 < height as f64;
    if !is_inside {
        return None;
    }
    let (x, y) = (u as usize, v as usize);
    let value = |x: usize, y: usize| match image.pixels() {
        GrayPixels::Eight(values) => f64::from(values[y * width + x]),
        GrayPixels::Sixteen(values) => f64::from(values[y * width + x]),
    };
    let (across, down) = (u - x as f64, v - y as f64);
    let top = value(x, y) + across * (value(x + 1, y) - value(x, y));
    let bottom = value(x, y + 1) + across * (value(x + 1, y + 1) - value(x, y + 1));
    Some(top + down * (bottom - top))
}

/// Returns the homography from the unit square to four corners, or `None` if they make none.
///
/// Heckbert 1989, "Fundamentals of texture mapping and image warping", 2.2.3.
fn square_to_quad(corners: [[f64; 2]; 4]) -> Option<impl Fn([f64; 2]) -> [f64; 2]> {
    let [a, b, c, d] = corners;
    let sum = [0, 1].map(|i| a[i] - b[i] + c[i] - d[i]);
    let (one, two) = ([0, 1].map(|i| b[i] - c[i]), [0, 1].map(|i| d[i] - c[i]));
    let determinant = one[0] * two[1] - one[1] * two[0];
    let g = (sum[0] * two[1] - sum[1] * two[0]) / determinant;
    let h = (one[0] * sum[1] - one[1] * sum[0]) / determinant;
    let map = move |[x, y]: [f64; 2]| {
        let w = g * x + h * y + 1.0;
        [0, 1].map(|i| ((b[i] - a[i] + g * b[i]) * x + (d[i] - a[i] + h * d[i]) * y + a[i]) / w)
    };
    // The corner opposite the first is not behind the viewer.
    (g.is_finite() && h.is_finite() && g > -0.9 && h > -0.9 && g + h > -0.9).then_some(map)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns an image of a marker between `corners` of a slanted cell, and reads it.
    fn read(dictionary: &str, id: usize, turn: usize, wrong_bits: &[usize], border: usize) -> Option<Marker> {
        let dictionary = Dictionary::named(dictionary).unwrap();
        let side = dictionary.bits_across();
        let mut code = dictionary.codes()[id];
        (0..turn).for_each(|_| code = quarter_turned(code, side));
        wrong_bits.iter().for_each(|bit| code ^= 1 << bit);
        let modules = side + 2 * border;
        let cell = MarkerCell { inset: 0.125, border, white_at: 0.06 };
        let (width, step) = (120, [[80.0, 6.0], [-4.0, 72.0]]);
        let value = |i: usize| {
            let [u, v] = [(i % width) as f64 - 20.0, (i / width) as f64 - 15.0];
            let determinant = step[0][0] * step[1][1] - step[0][1] * step[1][0];
            let x = (u * step[1][1] - v * step[1][0]) / determinant;
            let y = (step[0][0] * v - step[0][1] * u) / determinant;
            let [column, row] = [x, y].map(|t| ((t - 0.125) / 0.75 * modules as f64).floor() as isize);
            let inside = |n: isize, from: usize, to: usize| (from as isize..to as isize).contains(&n);
            if !inside(column, 0, modules) || !inside(row, 0, modules) {
                200
            } else if inside(column, border, side + border) && inside(row, border, side + border) {
                let at = (row as usize - border) * side + column as usize - border;
                if code >> (side * side - 1 - at) & 1 == 1 { 190 } else { 60 }
            } else {
                50
            }
        };
        let image =
            GrayImage::new([120, 120], GrayPixels::Eight((0..120 * 120).map(value).collect())).unwrap();
        let at =
            |x: f64, y: f64| [20.0 + x * step[0][0] + y * step[1][0], 15.0 + x * step[0][1] + y * step[1][1]];
        read_marker(&image, [at(0.0, 0.0), at(1.0, 0.0), at(1.0, 1.0), at(0.0, 1.0)], &cell, dictionary, 20.0)
    }

    #[test]
    fn markers_are_read_whichever_way_they_lie() {
        for (dictionary, id) in [("4x4_50", 17), ("5x5_1000", 999), ("7x7_250", 3), ("36h11", 586)] {
            for turn in 0..4 {
                for border in [1, 2] {
                    let marker = read(dictionary, id, turn, &[], border).unwrap();
                    assert_eq!((marker.id as usize, marker.turn), (id, turn), "{dictionary}");
                }
            }
        }
    }

    #[test]
    fn wrong_bits_are_corrected_as_far_as_the_code_allows() {
        let marker = read("36h11", 100, 1, &[3, 9, 20, 30, 33], 1).unwrap();
        assert_eq!((marker.id, marker.turn), (100, 1));
        assert!(marker.chance_of_any > 0.001 && marker.chance_of_any < 0.1, "{marker:?}");
        assert!(read("36h11", 100, 1, &[], 1).unwrap().chance_of_any < 1e-7);
        assert_eq!(read("36h11", 100, 1, &[1, 3, 9, 20, 30, 33], 1), None);
        assert_eq!(read("4x4_1000", 100, 1, &[5], 1).filter(|marker| marker.id == 100), None);
    }

    #[test]
    fn plain_cells_and_cells_beyond_the_border_hold_no_marker() {
        let image = GrayImage::new([60, 60], GrayPixels::Eight(vec![90; 3600])).unwrap();
        let dictionary = Dictionary::named("4x4_50").unwrap();
        let cell = MarkerCell { inset: 0.1, border: 1, white_at: 0.05 };
        for to in [50.0, 80.0] {
            let corners = [[10.0, 10.0], [to, 10.0], [to, to], [10.0, to]];
            assert_eq!(read_marker(&image, corners, &cell, dictionary, 10.0), None);
        }
        assert!(square_to_quad([[0.0; 2]; 4]).is_none());
    }
}
