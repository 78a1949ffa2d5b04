//! Video to images: the frames of each topic are decoded in the order in which they were recorded, as most of them say only
//! what has changed.
//!
//! Each message is a frame of its own time, and frames come out as they go in: streams whose frames are shown in another
//! order than they are sent (B-frames) are not what Foxglove allows. A frame that cannot be decoded takes those after it
//! along, up to the next keyframe. H.264 alone is decoded, by OpenH264, where the program was built with the feature
//! `h264`.

use std::collections::BTreeMap;

use boresight_data::GrayImage;

use super::message::{Content, Pixels, read_image_message};
use super::{Held, RecordedImage};

/// The decoders of topics with video, by the topics' indices.
#[derive(Default)]
pub(super) struct Videos(BTreeMap<usize, Stream>);

impl Videos {
    /// Returns a frame of a video decoded, or why it cannot be; any other image as it is.
    ///
    /// The frames of a topic must come in the order in which they were recorded.
    pub(super) fn decoded(&mut self, image: RecordedImage) -> RecordedImage {
        let Held::Message { kind, bytes } = &image.held else { return image };
        if kind.content != Content::Video {
            return image;
        }
        let frame = read_image_message(*kind, bytes).map_err(|error| error.to_string()).and_then(|message| {
            let Pixels::File { format, bytes } = &message.pixels else {
                return Err("it is no video".to_owned());
            };
            let stream = self.0.entry(image.topic_idx).or_default();
            stream.note(image.index);
            Ok((message.stamp_ns, stream.frame(format, bytes)?))
        });
        let held = match frame {
            Ok((stamp_ns, image)) => Held::Frame { stamp_ns, image },
            Err(why) => Held::Lost(why),
        };
        RecordedImage { held, ..image }
    }
}

/// A video on its way.
#[derive(Default)]
struct Stream {
    decoder: Option<decoder::Decoder>,
    state: State,
    /// The index of the message that follows the last one.
    next_index: usize,
}

/// What is known of the frames so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum State {
    /// There was no keyframe yet.
    #[default]
    Begin,
    /// The last frame was decoded.
    Whole,
    /// A frame since the last keyframe is missing or broken.
    Broken,
}

impl Stream {
    /// Takes note of which message comes next: those before it that were too large or could not be read are missing.
    fn note(&mut self, index: usize) {
        if index != self.next_index && self.state == State::Whole {
            self.state = State::Broken;
        }
        self.next_index = index + 1;
    }

    /// Decodes the next frame.
    fn frame(&mut self, format: &str, bytes: &[u8]) -> Result<GrayImage, String> {
        if format != "h264" {
            return Err(format!("it is video in `{format}`; h264 is read"));
        }
        let units: Vec<u8> = unit_types(bytes).collect();
        let is_keyframe = units.contains(&KEYFRAME);
        let has_picture = is_keyframe || units.contains(&SLICE);
        match self.state {
            _ if units.is_empty() => return Err("its data are no H.264 in Annex B form".to_owned()),
            State::Begin if has_picture && !is_keyframe => {
                return Err("no keyframe of the video comes before it".to_owned());
            }
            State::Broken if has_picture && !is_keyframe => {
                return Err("a frame before it is missing or broken, and no keyframe came since".to_owned());
            }
            _ => {}
        }
        let decoder = match &mut self.decoder {
            Some(decoder) => decoder,
            none => none.insert(decoder::Decoder::new()?),
        };
        let decoded = decoder.frame(bytes);
        if has_picture || decoded.is_err() {
            self.state = if matches!(decoded, Ok(Some(_))) { State::Whole } else { State::Broken };
        }
        decoded?.ok_or_else(|| "no picture comes of it".to_owned())
    }
}

/// The type of a unit that holds a part of a picture, and of one that needs no other picture: Table 7-1 of H.264.
const SLICE: u8 = 1;
const KEYFRAME: u8 = 5;

/// Returns the types of the units of a stream in Annex B form, which begin behind the bytes 0, 0, 1.
fn unit_types(bytes: &[u8]) -> impl Iterator<Item = u8> {
    bytes.windows(4).filter(|window| window[..3] == [0, 0, 1]).map(|window| window[3] & 0x1f)
}

#[cfg(feature = "h264")]
mod decoder {
    use boresight_data::{GrayImage, GrayPixels};
    use openh264::OpenH264API;
    use openh264::decoder::DecoderConfig;
    use openh264::formats::YUVSource as _;

    /// A decoder, which makes up nothing for what is missing.
    pub(super) struct Decoder(openh264::decoder::Decoder);

    impl Decoder {
        pub(super) fn new() -> Result<Self, String> {
            let decoder =
                openh264::decoder::Decoder::with_api_config(OpenH264API::from_source(), DecoderConfig::new());
            decoder.map(Self).map_err(|error| format!("its video cannot be decoded: {error}"))
        }

        /// Decodes the units of a frame; `None` if no picture comes of them.
        pub(super) fn frame(&mut self, bytes: &[u8]) -> Result<Option<GrayImage>, String> {
            let wrong = |why: &str| format!("its picture cannot be decoded: {why}");
            // The decoder's own words are numbers.
            let decoded =
                self.0.decode(bytes).map_err(|_| wrong("it is damaged, or a frame before it is missing"))?;
            let Some(picture) = decoded else { return Ok(None) };
            let ((width, height), (stride, ..)) = (picture.dimensions(), picture.strides());
            if width == 0 || height == 0 || stride < width {
                return Err(wrong(&format!("it has {width}x{height} pixels in rows of {stride}")));
            }
            let mut luma = Vec::with_capacity(width * height);
            for row in picture.y().chunks(stride).take(height) {
                luma.extend_from_slice(row.get(..width).ok_or_else(|| wrong("a row is too short"))?);
            }
            let size = [width, height].map(|side| u32::try_from(side).unwrap_or(u32::MAX));
            let image = GrayImage::new(size, GrayPixels::Eight(luma));
            image.map(Some).ok_or_else(|| wrong("its size is not that of its pixels"))
        }
    }
}

#[cfg(not(feature = "h264"))]
mod decoder {
    use boresight_data::GrayImage;

    /// Nothing, as there is no decoder; topics with video are told and not read.
    pub(super) enum Decoder {}

    impl Decoder {
        pub(super) fn new() -> Result<Self, String> {
            Err("video is read by programs that are built with the feature h264".to_owned())
        }

        pub(super) fn frame(&mut self, _: &[u8]) -> Result<Option<GrayImage>, String> {
            match *self {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_message_that_is_missing_breaks_the_video() {
        let mut stream = Stream { state: State::Whole, ..Stream::default() };
        for (index, expected) in [(0, State::Whole), (1, State::Whole), (3, State::Broken)] {
            stream.note(index);
            assert_eq!(stream.state, expected, "{index}");
        }
        // What comes before the first frame is not missed.
        let mut stream = Stream::default();
        stream.note(5);
        assert_eq!(stream.state, State::Begin);
    }
}
