//! Messages that hold images or say what a camera is, in whatever way they were written.

use std::borrow::Cow;

use base64::Engine as _;
use boresight_data::{GrayImage, GrayPixels};
use serde::Deserialize;

use super::cdr::{Layout, Values};
use super::protobuf::Fields;
use super::raw_image::{RawImage, gray_of_raw};
use crate::image_pixels::image_from_bytes;

/// Why a message cannot be used.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub(crate) enum MessageError {
    /// Something ends before its end.
    #[error("it is cut off: {what} needs {need} bytes, {have} are left")]
    CutOff { what: &'static str, need: usize, have: usize },
    /// A serialisation of CDR that is not read.
    #[error("it is serialised as {}; plain CDR is read (identifiers 0 and 1)", representation(*identifier))]
    Representation { identifier: u16 },
    /// A protobuf field of a kind that there is not.
    #[error("it is no protobuf message: a field has wire type {wire}")]
    Protobuf { wire: u64 },
    /// A text is none.
    #[error("its {what} is not UTF-8 text")]
    NotText { what: &'static str },
    /// A JSON message is none of its schema.
    #[error("it is no JSON message of its schema: {why}")]
    Json { why: String },
    /// A time is out of range.
    #[error("its time stamp is {seconds} s")]
    Time { seconds: i64 },
    /// An encoding of pixels that is not read.
    #[error("its pixels are encoded as `{encoding}`, which is not read")]
    Encoding { encoding: String },
    /// The pixels are not as many as stated.
    #[error("{width}x{height} pixels in rows of {step} bytes need {need} bytes, it has {have}")]
    Pixels { width: u32, height: u32, step: u32, need: u64, have: u64 },
    /// A row is too short for its pixels.
    #[error("a row of {width} pixels needs {need} bytes, its step is {step}")]
    Step { width: u32, step: u32, need: u64 },
    /// The image is too large or empty.
    #[error("it states {width}x{height} pixels; 1 to {limit} are read")]
    Size { width: u32, height: u32, limit: u64 },
    /// A compressed image cannot be decoded.
    #[error("its image cannot be decoded: {why}")]
    Image { why: String },
}

fn representation(identifier: u16) -> String {
    match identifier {
        2 | 3 => format!("parameter list CDR (identifier {identifier})"),
        6..=0x0b => format!("XCDR2 (identifier {identifier})"),
        _ => format!("identifier {identifier}"),
    }
}

/// What a message holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Content {
    RawImage,
    CompressedImage,
    CameraInfo,
    /// A frame of a video, which is read with the feature `h264`.
    Video,
}

/// Whose description of a message it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Family {
    Ros,
    Foxglove,
}

/// How a message is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Wire {
    Values(Layout),
    Protobuf,
    Json,
}

/// What the messages of a channel hold and how they are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Kind {
    pub content: Content,
    family: Family,
    /// `None` where messages are written in a way that is not read.
    wire: Option<Wire>,
}

impl Kind {
    /// Tells the kind of a channel from the names of its schema and its encoding; `None` for anything but images and
    /// what is said of cameras.
    pub(crate) fn of_channel(schema: &str, encoding: &str) -> Option<Self> {
        let (package, name) = schema.rsplit_once(['/', '.'])?;
        let family = match package {
            "sensor_msgs/msg" | "sensor_msgs" | "sensor_msgs.msg" => Family::Ros,
            "foxglove" | "foxglove_msgs/msg" | "foxglove_msgs" => Family::Foxglove,
            _ => return None,
        };
        let content = match (family, name) {
            (Family::Ros, "Image") | (Family::Foxglove, "RawImage") => Content::RawImage,
            (_, "CompressedImage") => Content::CompressedImage,
            (_, "CompressedVideo") => Content::Video,
            (Family::Ros, "CameraInfo") | (Family::Foxglove, "CameraCalibration") => Content::CameraInfo,
            _ => return None,
        };
        let wire = match (family, encoding) {
            (_, "cdr") => Some(Wire::Values(Layout::Cdr)),
            (_, "ros1") => Some(Wire::Values(Layout::Packed)),
            (Family::Foxglove, "protobuf") => Some(Wire::Protobuf),
            (Family::Foxglove, "json") => Some(Wire::Json),
            _ => None,
        };
        Some(Self { content, family, wire })
    }

    /// Tells whether messages are frames of a video, and written in a way that is known.
    pub(crate) fn is_video(self) -> bool {
        self.wire.is_some() && self.content == Content::Video
    }

    /// Tells whether messages are written in a way that is read.
    pub(crate) fn is_read(self) -> bool {
        self.wire.is_some() && (self.content != Content::Video || cfg!(feature = "h264"))
    }
}

/// An image as its message holds it.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct ImageMessage<'a> {
    /// When it was taken, as the message says, in nanoseconds.
    pub stamp_ns: i64,
    pub pixels: Pixels<'a>,
}

/// The pixels of an image, not yet looked at.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Pixels<'a> {
    Raw(RawImage<'a>),
    /// A file, with what the message says of its format.
    File {
        format: Cow<'a, str>,
        bytes: Cow<'a, [u8]>,
    },
    /// The frame of a video, which is decoded already.
    Decoded(&'a GrayImage),
}

/// What a message says of a camera.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StatedCamera {
    /// Width and height in pixels.
    pub image_size: [u32; 2],
    /// The lens model, as ROS and Foxglove name it.
    pub distortion_model: String,
    /// The coefficients of the lens model.
    pub distortion: Vec<f64>,
    /// fx, fy, cx and cy in pixels; zero where the camera is not calibrated.
    pub intrinsics: [f64; 4],
}

impl Pixels<'_> {
    /// Returns the grey values.
    pub(crate) fn decode(&self) -> Result<GrayImage, MessageError> {
        match self {
            Pixels::Raw(raw) => gray_of_raw(raw),
            Pixels::Decoded(image) => Ok((*image).clone()),
            Pixels::File { format, bytes } => match image_from_bytes("the message", bytes) {
                Ok(read) => Ok(read.image),
                Err(crate::Error::Image { why, .. }) => {
                    Err(MessageError::Image { why: format!("{why} (it says that it is `{format}`)") })
                }
                Err(error) => Err(MessageError::Image { why: error.to_string() }),
            },
        }
    }

    /// Returns width and height as the message states them; a file states them inside.
    pub(crate) fn stated_size(&self) -> Option<[u32; 2]> {
        match self {
            Pixels::Raw(raw) => Some([raw.width, raw.height]),
            Pixels::Decoded(image) => Some(image.size()),
            Pixels::File { .. } => None,
        }
    }

    /// Returns how the pixels are encoded, as the message states it.
    pub(crate) fn encoding(&self) -> &str {
        match self {
            Pixels::Raw(raw) => &raw.encoding,
            Pixels::File { format, .. } => format,
            Pixels::Decoded(_) => "decoded",
        }
    }

    /// Returns the hash of all that decides the grey values, in hexadecimal.
    pub(crate) fn hash(&self) -> String {
        let mut hasher = blake3::Hasher::new();
        match self {
            Pixels::Raw(raw) => {
                let RawImage { width, height, encoding, is_big_endian, step, data } = raw;
                hasher.update(format!("{encoding} {width} {height} {step} {is_big_endian} ").as_bytes());
                hasher.update(data);
            }
            Pixels::File { bytes, .. } => {
                hasher.update(bytes);
            }
            Pixels::Decoded(image) => {
                let [width, height] = image.size();
                hasher.update(format!("decoded {width} {height} ").as_bytes());
                match image.pixels() {
                    GrayPixels::Eight(values) => hasher.update(values),
                    GrayPixels::Sixteen(values) => {
                        values.iter().fold(&mut hasher, |hasher, value| hasher.update(&value.to_le_bytes()))
                    }
                };
            }
        }
        hasher.finalize().to_hex().to_string()
    }
}

/// Reads a message that holds an image.
pub(crate) fn read_image_message(kind: Kind, bytes: &[u8]) -> Result<ImageMessage<'_>, MessageError> {
    match (kind.wire, kind.content) {
        (Some(Wire::Values(layout)), Content::RawImage) => {
            let mut values = Values::new(bytes, layout)?;
            let stamp_ns = header(&mut values, kind.family, layout)?;
            let first = values.u32("the size")?;
            let second = values.u32("the size")?;
            // ROS says height before width, Foxglove width before height.
            let [width, height] = if kind.family == Family::Ros { [second, first] } else { [first, second] };
            let encoding = Cow::Borrowed(values.string("encoding")?);
            let is_big_endian = kind.family == Family::Ros && values.u8("the order of bytes")? != 0;
            let step = values.u32("the step")?;
            let data = Cow::Borrowed(values.bytes("the pixels")?);
            let raw = RawImage { width, height, encoding, is_big_endian, step, data };
            Ok(ImageMessage { stamp_ns, pixels: Pixels::Raw(raw) })
        }
        (Some(Wire::Values(layout)), _) => {
            let mut values = Values::new(bytes, layout)?;
            let stamp_ns = header(&mut values, kind.family, layout)?;
            let (format, bytes) = if kind.family == Family::Ros {
                (values.string("format")?, values.bytes("the image")?)
            } else {
                let bytes = values.bytes("the image")?;
                (values.string("format")?, bytes)
            };
            let pixels = Pixels::File { format: Cow::Borrowed(format), bytes: Cow::Borrowed(bytes) };
            Ok(ImageMessage { stamp_ns, pixels })
        }
        (Some(Wire::Protobuf), content) => read_protobuf(content, bytes),
        (Some(Wire::Json), content) => read_json(content, bytes),
        (None, _) => Err(MessageError::Encoding { encoding: "unknown".to_owned() }),
    }
}

/// Reads what stands before everything else in a message, and returns its time.
fn header(values: &mut Values<'_>, family: Family, layout: Layout) -> Result<i64, MessageError> {
    if layout == Layout::Packed && family == Family::Ros {
        values.u32("the sequence number")?;
    }
    let stamp_ns = values.time_ns("the time stamp")?;
    values.string("the frame's name")?;
    Ok(stamp_ns)
}

fn read_protobuf(content: Content, bytes: &[u8]) -> Result<ImageMessage<'_>, MessageError> {
    let mut stamp_ns = 0;
    let mut raw = RawImage::default();
    let (mut format, mut file): (&str, &[u8]) = ("", &[]);
    let mut fields = Fields(bytes);
    while let Some((number, value)) = fields.next()? {
        match (content, number) {
            (_, 1) => stamp_ns = value.time_ns()?,
            (Content::RawImage, 2) => raw.width = value.u32(),
            (Content::RawImage, 3) => raw.height = value.u32(),
            (Content::RawImage, 4) => raw.encoding = Cow::Borrowed(value.text("encoding")?),
            (Content::RawImage, 5) => raw.step = value.u32(),
            (Content::RawImage, 6) => raw.data = Cow::Borrowed(value.bytes()),
            (Content::CompressedImage, 2) => file = value.bytes(),
            (Content::CompressedImage, 3) => format = value.text("format")?,
            (Content::Video, 3) => file = value.bytes(),
            (Content::Video, 4) => format = value.text("format")?,
            _ => {}
        }
    }
    let pixels = match content {
        Content::RawImage => Pixels::Raw(raw),
        _ => Pixels::File { format: Cow::Borrowed(format), bytes: Cow::Borrowed(file) },
    };
    Ok(ImageMessage { stamp_ns, pixels })
}

#[derive(Deserialize)]
struct JsonTime {
    sec: i64,
    nsec: i64,
}

impl JsonTime {
    fn time_ns(&self) -> Result<i64, MessageError> {
        let time = self.sec.checked_mul(1_000_000_000).and_then(|time| time.checked_add(self.nsec));
        time.ok_or(MessageError::Time { seconds: self.sec })
    }
}

#[derive(Deserialize)]
struct JsonImage<'a> {
    timestamp: JsonTime,
    #[serde(default)]
    width: u32,
    #[serde(default)]
    height: u32,
    #[serde(default, borrow)]
    encoding: Cow<'a, str>,
    #[serde(default)]
    step: u32,
    #[serde(default, borrow)]
    format: Cow<'a, str>,
    #[serde(borrow)]
    data: Cow<'a, str>,
}

fn wrong_json(error: &dyn std::fmt::Display) -> MessageError {
    MessageError::Json { why: error.to_string() }
}

fn read_json(content: Content, bytes: &[u8]) -> Result<ImageMessage<'_>, MessageError> {
    let message: JsonImage = serde_json::from_slice(bytes).map_err(|error| wrong_json(&error))?;
    let data = base64::engine::general_purpose::STANDARD.decode(message.data.as_bytes());
    let data = Cow::Owned(data.map_err(|error| wrong_json(&format!("its data are not base64: {error}")))?);
    let stamp_ns = message.timestamp.time_ns()?;
    let JsonImage { width, height, encoding, step, format, .. } = message;
    let pixels = match content {
        Content::RawImage => {
            Pixels::Raw(RawImage { width, height, encoding, is_big_endian: false, step, data })
        }
        _ => Pixels::File { format, bytes: data },
    };
    Ok(ImageMessage { stamp_ns, pixels })
}

#[derive(Deserialize)]
#[allow(non_snake_case, reason = "the names are those of the messages")]
struct JsonCalibration {
    width: u32,
    height: u32,
    #[serde(default)]
    distortion_model: String,
    #[serde(default)]
    D: Vec<f64>,
    #[serde(default)]
    K: Vec<f64>,
}

/// Reads a message that says what a camera is.
pub(crate) fn read_camera_info(kind: Kind, bytes: &[u8]) -> Result<StatedCamera, MessageError> {
    match kind.wire {
        Some(Wire::Values(layout)) => {
            let mut values = Values::new(bytes, layout)?;
            header(&mut values, kind.family, layout)?;
            let first = values.u32("the size")?;
            let second = values.u32("the size")?;
            let image_size = if kind.family == Family::Ros { [second, first] } else { [first, second] };
            let distortion_model = values.string("the lens model")?.to_owned();
            let distortion = values.numbers("the lens model's coefficients")?;
            let matrix = values.array::<9>("the camera matrix")?;
            Ok(StatedCamera { image_size, distortion_model, distortion, intrinsics: of_matrix(&matrix) })
        }
        Some(Wire::Protobuf) => {
            let mut info = StatedCamera::default();
            let mut matrix = Vec::new();
            let mut fields = Fields(bytes);
            while let Some((number, value)) = fields.next()? {
                match number {
                    2 => info.image_size[0] = value.u32(),
                    3 => info.image_size[1] = value.u32(),
                    4 => info.distortion_model = value.text("lens model")?.to_owned(),
                    5 => value.numbers(&mut info.distortion),
                    6 => value.numbers(&mut matrix),
                    _ => {}
                }
            }
            info.intrinsics = of_matrix(&matrix);
            Ok(info)
        }
        Some(Wire::Json) => {
            let said: JsonCalibration = serde_json::from_slice(bytes).map_err(|error| wrong_json(&error))?;
            Ok(StatedCamera {
                image_size: [said.width, said.height],
                distortion_model: said.distortion_model,
                distortion: said.D,
                intrinsics: of_matrix(&said.K),
            })
        }
        None => Err(MessageError::Encoding { encoding: "unknown".to_owned() }),
    }
}

/// Returns fx, fy, cx and cy of a camera matrix, row by row.
fn of_matrix(matrix: &[f64]) -> [f64; 4] {
    [0, 4, 2, 5].map(|i| matrix.get(i).copied().unwrap_or(0.0))
}
