//! Images in and out: PNG, JPEG, TIFF and PNM to grey values, and grey values with marks to PNG.
//!
//! Colours become grey by BT.601, with the weights and the rounding that OpenCV uses. Pixels are taken as they are
//! stored: an EXIF orientation is told, and not applied.

use std::io::Cursor;

use boresight_data::{GrayImage, GrayPixels, Observation};
use image::{DynamicImage, ImageDecoder as _, ImageReader, Rgb, RgbImage};

use crate::Error;

/// The most pixels that an image may have: beyond the largest sensors, and within what memory bears.
pub(crate) const PIXEL_LIMIT: u64 = 160_000_000;

/// An image as it was read.
#[derive(Clone, Debug, PartialEq)]
pub struct ReadImage {
    /// Its grey values.
    pub image: GrayImage,
    /// Whether the file asks for the image to be turned or mirrored when it is shown.
    pub is_turned: bool,
}

/// Reads an image from the bytes of a file, which is named in errors.
pub fn image_from_bytes(file: &str, bytes: &[u8]) -> Result<ReadImage, Error> {
    let wrong = |why: String| Error::Image { file: file.to_owned(), why };
    if bytes.is_empty() {
        return Err(Error::Empty { file: file.to_owned() });
    }
    let reader = ImageReader::new(Cursor::new(bytes)).with_guessed_format();
    let reader = reader.map_err(|error| wrong(error.to_string()))?;
    let mut decoder = reader.into_decoder().map_err(|error| wrong(error.to_string()))?;
    // The size is stated before the pixels are there, and a small file may state any.
    let (width, height) = decoder.dimensions();
    let pixels = u64::from(width) * u64::from(height);
    if pixels == 0 || pixels > PIXEL_LIMIT {
        return Err(wrong(format!("it states {width}x{height} pixels; 1 to {PIXEL_LIMIT} are read")));
    }
    let orientation = decoder.orientation().unwrap_or(image::metadata::Orientation::NoTransforms);
    let decoded = DynamicImage::from_decoder(decoder).map_err(|error| wrong(error.to_string()))?;
    let size = [decoded.width(), decoded.height()];
    let pixels = match decoded {
        DynamicImage::ImageLuma8(image) => GrayPixels::Eight(image.into_raw()),
        DynamicImage::ImageLumaA8(image) => {
            GrayPixels::Eight(image.as_raw().chunks_exact(2).map(|pixel| pixel[0]).collect())
        }
        DynamicImage::ImageRgb8(image) => GrayPixels::Eight(grey_of_colours(image.as_raw(), 3, [0, 1, 2])),
        DynamicImage::ImageRgba8(image) => GrayPixels::Eight(grey_of_colours(image.as_raw(), 4, [0, 1, 2])),
        DynamicImage::ImageLuma16(image) => GrayPixels::Sixteen(image.into_raw()),
        DynamicImage::ImageLumaA16(image) => {
            GrayPixels::Sixteen(image.as_raw().chunks_exact(2).map(|pixel| pixel[0]).collect())
        }
        DynamicImage::ImageRgb16(image) => GrayPixels::Sixteen(grey_of_colours(image.as_raw(), 3, [0, 1, 2])),
        DynamicImage::ImageRgba16(image) => {
            GrayPixels::Sixteen(grey_of_colours(image.as_raw(), 4, [0, 1, 2]))
        }
        other => return Err(wrong(format!("pixels of the kind {:?} are not read", other.color()))),
    };
    let image = GrayImage::new(size, pixels).ok_or_else(|| wrong("it has too few pixels".to_owned()))?;
    Ok(ReadImage { image, is_turned: orientation != image::metadata::Orientation::NoTransforms })
}

/// Returns the grey of red, green and blue: (9798 R + 19235 G + 3735 B + 2¹⁴) / 2¹⁵, BT.601 in OpenCV's fixed point.
pub(crate) fn grey_of([red, green, blue]: [u64; 3]) -> u64 {
    // The weights add up to 2¹⁵, so grey is at most the largest of the three.
    (9798 * red + 19235 * green + 3735 * blue + (1 << 14)) >> 15
}

/// Returns the grey of pixels of so many channels, with red, green and blue at these places.
pub(crate) fn grey_of_colours<P: Copy + Into<u64> + TryFrom<u64>>(
    values: &[P],
    channels: usize,
    places: [usize; 3],
) -> Vec<P> {
    let grey = |pixel: &[P]| P::try_from(grey_of(places.map(|i| pixel[i].into()))).unwrap_or(pixel[1]);
    values.chunks_exact(channels).map(grey).collect()
}

/// Returns a PNG of an image with its corners marked: each row of a grid of `columns` in its own colour, joined by lines,
/// the first point with a ring.
pub fn overlay_to_png(
    image: &GrayImage,
    observations: &[Observation],
    columns: u32,
) -> Result<Vec<u8>, Error> {
    let [width, height] = image.size();
    // Sixteen bits are shown from the darkest to the brightest value.
    let bytes: Vec<u8> = match image.pixels() {
        GrayPixels::Eight(values) => values.clone(),
        GrayPixels::Sixteen(values) => {
            let (low, high) = values.iter().fold((u16::MAX, 0), |(low, high), &v| (low.min(v), high.max(v)));
            let range = u32::from(high.saturating_sub(low)).max(1);
            values.iter().map(|&value| ((u32::from(value - low) * 255) / range) as u8).collect()
        }
    };
    let mut shown = RgbImage::from_fn(width, height, |x, y| {
        let value = bytes[(y * width + x) as usize];
        Rgb([value; 3])
    });
    let reach = (f64::from(width.max(height)) / 160.0).clamp(3.0, 24.0);
    let columns = columns.max(1);
    for (i, observation) in observations.iter().enumerate() {
        let row = observation.point.0 / columns;
        let colour = COLOURS[row as usize % COLOURS.len()];
        if let Some(next) = observations.get(i + 1) {
            let colour = if next.point.0 / columns == row { colour } else { [90, 90, 90] };
            line(&mut shown, observation.pixel, next.pixel, colour);
        }
    }
    for observation in observations {
        let colour = COLOURS[(observation.point.0 / columns) as usize % COLOURS.len()];
        let [u, v] = observation.pixel;
        line(&mut shown, [u - reach, v], [u + reach, v], colour);
        line(&mut shown, [u, v - reach], [u, v + reach], colour);
        if observation.point.0 == 0 {
            let on_ring = |k: u32| {
                let (sin, cos) = (f64::from(k) * std::f64::consts::TAU / 32.0).sin_cos();
                [u + 1.6 * reach * cos, v + 1.6 * reach * sin]
            };
            (0..32).for_each(|k| line(&mut shown, on_ring(k), on_ring(k + 1), [255, 255, 0]));
        }
    }
    let mut png = Cursor::new(Vec::new());
    shown
        .write_to(&mut png, image::ImageFormat::Png)
        .map_err(|error| Error::Image { file: "overlay".to_owned(), why: error.to_string() })?;
    Ok(png.into_inner())
}

/// Returns an image as a PNG, with as many bits as it has.
pub fn gray_to_png(image: &GrayImage) -> Result<Vec<u8>, Error> {
    let wrong = |why: String| Error::Image { file: "image".to_owned(), why };
    let [width, height] = image.size();
    let buffer = match image.pixels() {
        GrayPixels::Eight(values) => {
            image::GrayImage::from_raw(width, height, values.clone()).map(DynamicImage::ImageLuma8)
        }
        GrayPixels::Sixteen(values) => {
            image::ImageBuffer::from_raw(width, height, values.clone()).map(DynamicImage::ImageLuma16)
        }
    };
    let buffer = buffer.ok_or_else(|| wrong("its pixels are too few".to_owned()))?;
    let mut png = Cursor::new(Vec::new());
    buffer.write_to(&mut png, image::ImageFormat::Png).map_err(|error| wrong(error.to_string()))?;
    Ok(png.into_inner())
}

/// Colours of the rows of a grid.
const COLOURS: [[u8; 3]; 7] = [
    [255, 60, 60],
    [255, 160, 0],
    [210, 220, 0],
    [0, 210, 60],
    [0, 200, 220],
    [80, 120, 255],
    [230, 80, 230],
];

fn line(image: &mut RgbImage, from: [f64; 2], to: [f64; 2], colour: [u8; 3]) {
    let steps = (to[0] - from[0]).abs().max((to[1] - from[1]).abs()).ceil().clamp(1.0, 1e5) as u32;
    for k in 0..=steps {
        let share = f64::from(k) / f64::from(steps);
        let [u, v] = [0, 1].map(|axis| (from[axis] + share * (to[axis] - from[axis])).round());
        if u >= 0.0 && v >= 0.0 && u < f64::from(image.width()) && v < f64::from(image.height()) {
            image.put_pixel(u as u32, v as u32, Rgb(colour));
        }
    }
}

#[cfg(test)]
mod tests {
    use boresight_data::PointId;

    use super::*;

    #[test]
    fn every_format_gives_its_grey_values() {
        let mut pgm = b"P5 3 2 255\n".to_vec();
        pgm.extend([1, 2, 3, 4, 5, 250]);
        let read = image_from_bytes("a.pgm", &pgm).unwrap();
        assert_eq!(read.image, GrayImage::new([3, 2], GrayPixels::Eight(vec![1, 2, 3, 4, 5, 250])).unwrap());
        assert!(!read.is_turned);
        let mut deep = b"P5 2 1 65535\n".to_vec();
        deep.extend([0x12, 0x34, 0xff, 0xfe]);
        let read = image_from_bytes("a.pgm", &deep).unwrap();
        assert_eq!(read.image.pixels(), &GrayPixels::Sixteen(vec![0x1234, 0xfffe]));
        for format in [image::ImageFormat::Png, image::ImageFormat::Tiff] {
            let colours = RgbImage::from_raw(1, 1, vec![133, 20, 136]).unwrap();
            let mut bytes = Cursor::new(Vec::new());
            colours.write_to(&mut bytes, format).unwrap();
            // OpenCV 5.0 makes 67 of this colour, and 25379 of the one below.
            let read = image_from_bytes("a", &bytes.into_inner()).unwrap();
            assert_eq!(read.image.pixels(), &GrayPixels::Eight(vec![67]), "{format:?}");
        }
        assert_eq!(grey_of_colours(&[1000u16, 30000, 65535], 3, [0, 1, 2]), [25379]);
    }

    #[test]
    fn what_is_no_image_is_an_error() {
        let mut cut = b"P5 300 200 255\n".to_vec();
        cut.extend([1, 2, 3]);
        let huge = b"P5 4000000000 4000000000 255\n1".to_vec();
        for bytes in [b"".to_vec(), b"nothing".to_vec(), cut, huge, b"\x89PNG\r\n\x1a\n".to_vec()] {
            let error = image_from_bytes("x.png", &bytes).unwrap_err();
            assert!(error.to_string().starts_with("x.png"), "{error}");
        }
    }

    #[test]
    fn overlays_show_corners() {
        let image = GrayImage::new([40, 30], GrayPixels::Sixteen(vec![500; 1200])).unwrap();
        let observation = |point, pixel| Observation { point: PointId(point), pixel, sigma_px: 0.1 };
        let seen = [observation(0, [10.2, 12.0]), observation(1, [20.0, 12.0]), observation(3, [39.2, 29.1])];
        let png = overlay_to_png(&image, &seen, 3).unwrap();
        let shown = image::load_from_memory(&png).unwrap().into_rgb8();
        assert_eq!((shown.get_pixel(10, 10).0, shown.get_pixel(17, 12).0), (COLOURS[0], COLOURS[0]));
        assert_eq!((shown.get_pixel(39, 29).0, shown.get_pixel(2, 2).0), (COLOURS[1], [0; 3]));
    }

    #[test]
    fn images_survive_as_png() {
        for pixels in [
            GrayPixels::Eight((0..24).map(|i| i * 10).collect()),
            GrayPixels::Sixteen((0..24).map(|i| i * 2500 + 1).collect()),
        ] {
            let image = GrayImage::new([6, 4], pixels).unwrap();
            let again = image_from_bytes("a.png", &gray_to_png(&image).unwrap()).unwrap();
            assert_eq!(again.image, image);
        }
    }
}
