//! Grey images: what detectors look at and renderers make.

/// A grey image, row by row from the top left.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct GrayImage {
    size: [u32; 2],
    pixels: GrayPixels,
}

/// The values of an image's pixels.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum GrayPixels {
    /// 0 to 255.
    Eight(Vec<u8>),
    /// 0 to 65535, or as much of that as the camera fills.
    Sixteen(Vec<u16>),
}

impl GrayImage {
    /// Returns the image of this width and height, or `None` if it has another number of pixels.
    pub fn new(size: [u32; 2], pixels: GrayPixels) -> Option<Self> {
        let n_pixels = match &pixels {
            GrayPixels::Eight(values) => values.len(),
            GrayPixels::Sixteen(values) => values.len(),
        };
        let need = usize::try_from(size[0]).ok()?.checked_mul(usize::try_from(size[1]).ok()?)?;
        (n_pixels == need).then_some(Self { size, pixels })
    }

    /// Returns width and height in pixels.
    pub fn size(&self) -> [u32; 2] {
        self.size
    }

    /// Returns the values, row by row.
    pub fn pixels(&self) -> &GrayPixels {
        &self.pixels
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn size_and_pixels_agree() {
        let image = GrayImage::new([2, 1], GrayPixels::Eight(vec![1, 2])).unwrap();
        assert_eq!((image.size(), image.pixels()), ([2, 1], &GrayPixels::Eight(vec![1, 2])));
        assert_eq!(GrayImage::new([2, 2], GrayPixels::Sixteen(vec![1, 2])), None);
        assert_eq!(GrayImage::new([u32::MAX; 2], GrayPixels::Eight(Vec::new())), None);
    }
}
