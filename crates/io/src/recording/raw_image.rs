//! Pixels as cameras deliver them to grey values: grey, colours, colours behind a Bayer filter, luma with colour beside it.

use std::borrow::Cow;

use boresight_data::{GrayImage, GrayPixels};

use super::message::MessageError;
use crate::image_pixels::{PIXEL_LIMIT, grey_of, grey_of_colours};

/// Pixels, row by row, and how they are encoded.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct RawImage<'a> {
    pub width: u32,
    pub height: u32,
    /// One of the names that ROS and OpenCV give encodings.
    pub encoding: Cow<'a, str>,
    /// Whether the higher byte of a number comes first.
    pub is_big_endian: bool,
    /// The distance from row to row in bytes.
    pub step: u32,
    pub data: Cow<'a, [u8]>,
}

/// Where the grey value of a pixel comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Source {
    /// From every so many numbers, the one at this place.
    Every { channels: usize, at: usize },
    /// From red, green and blue, which are at these places of so many.
    Colours { channels: usize, places: [usize; 3] },
    /// From a mosaic: the column and the row of red in each square of two by two.
    Mosaic { red: [usize; 2] },
}

/// Bytes in a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Depth {
    One,
    Two,
}

/// Returns how an encoding is read.
fn source_of(encoding: &str) -> Option<(Source, Depth)> {
    use Depth::{One, Two};
    const GREY: Source = Source::Every { channels: 1, at: 0 };
    let colours = |channels, places| Source::Colours { channels, places };
    let mosaic = |column, row| Source::Mosaic { red: [column, row] };
    Some(match encoding {
        // The luma of these comes first, whole, and the colours behind it.
        "mono8" | "8UC1" | "nv12" | "nv21" | "nv24" | "NV12" | "NV21" | "i420" => (GREY, One),
        "mono16" | "16UC1" => (GREY, Two),
        "rgb8" => (colours(3, [0, 1, 2]), One),
        "bgr8" | "8UC3" => (colours(3, [2, 1, 0]), One),
        "rgba8" => (colours(4, [0, 1, 2]), One),
        "bgra8" | "8UC4" => (colours(4, [2, 1, 0]), One),
        "rgb16" => (colours(3, [0, 1, 2]), Two),
        "bgr16" | "16UC3" => (colours(3, [2, 1, 0]), Two),
        "rgba16" => (colours(4, [0, 1, 2]), Two),
        "bgra16" | "16UC4" => (colours(4, [2, 1, 0]), Two),
        "yuv422" | "uyvy" | "UYVY" => (Source::Every { channels: 2, at: 1 }, One),
        "yuv422_yuy2" | "yuyv" | "YUYV" | "yuy2" => (Source::Every { channels: 2, at: 0 }, One),
        "bayer_rggb8" => (mosaic(0, 0), One),
        "bayer_grbg8" => (mosaic(1, 0), One),
        "bayer_gbrg8" => (mosaic(0, 1), One),
        "bayer_bggr8" => (mosaic(1, 1), One),
        "bayer_rggb16" => (mosaic(0, 0), Two),
        "bayer_grbg16" => (mosaic(1, 0), Two),
        "bayer_gbrg16" => (mosaic(0, 1), Two),
        "bayer_bggr16" => (mosaic(1, 1), Two),
        _ => return None,
    })
}

/// Returns the grey values of an image.
pub(crate) fn gray_of_raw(raw: &RawImage<'_>) -> Result<GrayImage, MessageError> {
    let RawImage { width, height, step, .. } = *raw;
    let (columns, rows) = (u64::from(width), u64::from(height));
    if columns * rows == 0 || columns * rows > PIXEL_LIMIT {
        return Err(MessageError::Size { width, height, limit: PIXEL_LIMIT });
    }
    let Some((source, depth)) = source_of(&raw.encoding) else {
        return Err(MessageError::Encoding { encoding: raw.encoding.to_string() });
    };
    let channels = match source {
        Source::Every { channels, .. } | Source::Colours { channels, .. } => channels,
        Source::Mosaic { .. } => 1,
    };
    let bytes = match depth {
        Depth::One => 1,
        Depth::Two => 2,
    };
    let row_bytes = columns * channels as u64 * bytes;
    if u64::from(step) < row_bytes {
        return Err(MessageError::Step { width, step, need: row_bytes });
    }
    let (need, have) = ((rows - 1) * u64::from(step) + row_bytes, raw.data.len() as u64);
    if have < need {
        return Err(MessageError::Pixels { width, height, step, need, have });
    }
    // Both fit, as the data are there.
    let (step, row_bytes) = (step as usize, row_bytes as usize);
    let rows = raw.data.chunks(step).take(height as usize).map(|row| &row[..row_bytes]);
    let size = [width, height];
    let pixels = match depth {
        Depth::One => {
            let mut numbers = Vec::with_capacity(row_bytes * height as usize);
            rows.for_each(|row| numbers.extend_from_slice(row));
            GrayPixels::Eight(grey_values(numbers, source, size))
        }
        Depth::Two => {
            let number = if raw.is_big_endian { u16::from_be_bytes } else { u16::from_le_bytes };
            let numbers =
                rows.flat_map(move |row| row.as_chunks::<2>().0.iter().map(move |bytes| number(*bytes)));
            GrayPixels::Sixteen(grey_values(numbers.collect(), source, size))
        }
    };
    GrayImage::new(size, pixels).ok_or(MessageError::Size { width, height, limit: PIXEL_LIMIT })
}

fn grey_values<P: Copy + Into<u64> + TryFrom<u64>>(
    numbers: Vec<P>,
    source: Source,
    size: [u32; 2],
) -> Vec<P> {
    match source {
        Source::Every { channels: 1, .. } => numbers,
        Source::Every { channels, at } => numbers.iter().skip(at).step_by(channels).copied().collect(),
        Source::Colours { channels, places } => grey_of_colours(&numbers, channels, places),
        Source::Mosaic { red } => grey_of_mosaic(&numbers, red, size),
    }
}

/// Returns the grey of a mosaic: each colour is the mean of the nearest of its kind, mirrored at the image's border.
fn grey_of_mosaic<P: Copy + Into<u64> + TryFrom<u64>>(
    mosaic: &[P],
    red: [usize; 2],
    size: [u32; 2],
) -> Vec<P> {
    let [width, height] = size.map(|side| side as usize);
    // The neighbour beyond the border is that before it, which has the same colour.
    let before = |i: usize, n: usize| if i > 0 { i - 1 } else { 1.min(n - 1) };
    let after = |i: usize, n: usize| if i + 1 < n { i + 1 } else { n.saturating_sub(2) };
    let mut grey = Vec::with_capacity(mosaic.len());
    for y in 0..height {
        let [above, here, below] =
            [before(y, height), y, after(y, height)].map(|row| &mosaic[row * width..(row + 1) * width]);
        for x in 0..width {
            let (left, right) = (before(x, width), after(x, width));
            let value = |row: &[P], column: usize| -> u64 { row[column].into() };
            let own = value(here, x);
            let across = (value(here, left) + value(here, right)).div_ceil(2);
            let along = (value(above, x) + value(below, x)).div_ceil(2);
            let beside = (value(here, left) + value(here, right) + value(above, x) + value(below, x) + 2) / 4;
            let corners =
                (value(above, left) + value(above, right) + value(below, left) + value(below, right) + 2) / 4;
            let colours = match (x % 2 == red[0], y % 2 == red[1]) {
                (true, true) => [own, beside, corners],
                (false, false) => [corners, beside, own],
                // Green, with red in its row or in its column.
                (false, true) => [across, own, along],
                (true, false) => [along, own, across],
            };
            grey.push(P::try_from(grey_of(colours)).unwrap_or(here[x]));
        }
    }
    grey
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn raw(encoding: &str, [width, height]: [u32; 2], step: u32, data: &[u8]) -> RawImage<'static> {
        let encoding = Cow::Owned(encoding.to_owned());
        RawImage { width, height, encoding, is_big_endian: false, step, data: Cow::Owned(data.to_vec()) }
    }

    fn eight(encoding: &str, size: [u32; 2], step: u32, data: &[u8]) -> Vec<u8> {
        match gray_of_raw(&raw(encoding, size, step, data)).unwrap().pixels() {
            GrayPixels::Eight(values) => values.clone(),
            GrayPixels::Sixteen(_) => panic!("eight bits"),
        }
    }

    #[test]
    fn encodings_become_grey() {
        // Rows may be longer than their pixels, the last one as long as they are.
        assert_eq!(eight("mono8", [2, 2], 3, &[1, 2, 99, 3, 4]), [1, 2, 3, 4]);
        // OpenCV's grey of (R, G, B) = (133, 20, 136) is 67.
        assert_eq!(eight("rgb8", [1, 1], 3, &[133, 20, 136]), [67]);
        assert_eq!(eight("bgr8", [1, 1], 3, &[136, 20, 133]), [67]);
        assert_eq!(eight("rgba8", [1, 1], 4, &[133, 20, 136, 0]), [67]);
        assert_eq!(eight("bgra8", [1, 1], 4, &[136, 20, 133, 0]), [67]);
        assert_eq!(eight("uyvy", [2, 1], 4, &[9, 1, 9, 2]), [1, 2]);
        assert_eq!(eight("yuyv", [2, 1], 4, &[1, 9, 2, 9]), [1, 2]);
        assert_eq!(eight("nv12", [2, 2], 2, &[1, 2, 3, 4, 9, 9]), [1, 2, 3, 4]);
        let mut sixteen = raw("mono16", [1, 1], 2, &[1, 2]);
        assert_eq!(gray_of_raw(&sixteen).unwrap().pixels(), &GrayPixels::Sixteen(vec![0x201]));
        sixteen.is_big_endian = true;
        assert_eq!(gray_of_raw(&sixteen).unwrap().pixels(), &GrayPixels::Sixteen(vec![0x102]));
    }

    #[test]
    fn mosaics_give_back_the_colours_they_were_made_of() {
        let size = [6_u32, 4];
        for (encoding, red) in [
            ("bayer_rggb8", [0, 0]),
            ("bayer_grbg8", [1, 0]),
            ("bayer_gbrg8", [0, 1]),
            ("bayer_bggr8", [1, 1]),
        ] {
            let mosaic = |colour: &dyn Fn(usize, usize) -> [u8; 3]| -> Vec<u8> {
                let at = |i: usize| {
                    let (x, y) = (i % 6, i / 6);
                    let channel = match (x % 2 == red[0], y % 2 == red[1]) {
                        (true, true) => 0,
                        (false, false) => 2,
                        _ => 1,
                    };
                    colour(x, y)[channel]
                };
                (0..24).map(at).collect()
            };
            let flat = mosaic(&|_, _| [133, 20, 136]);
            assert_eq!(eight(encoding, size, 6, &flat), [67; 24], "{encoding}");
            // A grey slope stays what it is, away from the border.
            let slope = mosaic(&|x, y| [(10 * x + 20 * y) as u8; 3]);
            let grey = eight(encoding, size, 6, &slope);
            for (x, y) in [(1, 1), (2, 1), (3, 2), (4, 2)] {
                assert_eq!(grey[y * 6 + x], (10 * x + 20 * y) as u8, "{encoding}");
            }
        }
        assert_eq!(eight("bayer_rggb8", [1, 1], 1, &[7]), [7]);
    }

    #[test]
    fn what_cannot_be_is_refused() {
        let error = |encoding: &str, size, step, data: &[u8]| {
            gray_of_raw(&raw(encoding, size, step, data)).unwrap_err().to_string()
        };
        assert!(error("mono8", [2, 2], 2, &[1, 2, 3]).contains("need 4 bytes, it has 3"));
        assert!(error("rgb8", [2, 1], 2, &[1, 2, 3, 4, 5, 6]).contains("needs 6 bytes, its step is 2"));
        assert!(error("32FC1", [1, 1], 4, &[0; 4]).contains("`32FC1`"));
        assert!(error("mono8", [0, 7], 0, &[]).contains("0x7"));
        assert!(error("mono8", [30_000, 30_000], 30_000, &[]).contains("30000x30000"));
        assert!(error("mono8", [u32::MAX, u32::MAX], u32::MAX, &[]).contains("pixels"));
    }

    proptest! {
        #[test]
        fn any_pixels_are_read_or_refused(
            encoding in "mono8|mono16|rgb8|bgra8|bayer_rggb8|bayer_bggr16|uyvy|nv12|[a-z]{0,4}",
            size in (0_u32..5, 0_u32..5),
            step in 0_u32..20,
            data in proptest::collection::vec(any::<u8>(), 0..80),
        ) {
            if let Ok(image) = gray_of_raw(&raw(&encoding, [size.0, size.1], step, &data)) {
                prop_assert_eq!(image.size(), [size.0, size.1]);
            }
        }
    }
}
