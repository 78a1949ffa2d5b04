//! What a fuzzer calls: each reader of bytes that others wrote. A reader may refuse; it must not panic, and must not take
//! memory that the bytes do not account for.
//!
//! The programs in the folder `fuzz` call these with bytes that libFuzzer makes up; the test below mutates good examples.

use std::io::Cursor;
use std::ops::ControlFlow;

use crate::image_pixels::image_from_bytes;
use crate::job_file::read_job_file;
use crate::recording::{read_any_message, read_recording_bytes};
use crate::{corners_csv, corners_vnl, parse_target};

/// A reader of bytes.
pub type Reader = fn(&[u8]);

/// The readers by name.
pub const READERS: &[(&str, Reader)] = &[
    ("corners_csv", corners_csv),
    ("corners_vnl", corners_vnl),
    ("image", image),
    ("job_file", job_file),
    ("message", message),
    ("recording", recording),
];

/// Reads a table of corners.
pub fn corners_csv(bytes: &[u8]) {
    if let Ok(target) = parse_target("chessboard:3x2:1cm") {
        let _ = corners_csv::read_csv("fuzz", bytes, &target, 1.0);
    }
}

/// Reads corners as mrcal and mrgingham write them.
pub fn corners_vnl(bytes: &[u8]) {
    if let Ok(target) = parse_target("chessboard:3x2:1cm") {
        let _ = corners_vnl::read_vnl("fuzz", bytes, &target, 1.0);
    }
}

/// Reads an image.
pub fn image(bytes: &[u8]) {
    let _ = image_from_bytes("fuzz", bytes);
}

/// Reads a job file.
pub fn job_file(bytes: &[u8]) {
    let _ = read_job_file("fuzz", bytes);
}

/// Reads a message of a recording, of the kind that the first byte chooses.
pub fn message(bytes: &[u8]) {
    if let Some((kind, message)) = bytes.split_first() {
        read_any_message(*kind, message);
    }
}

/// Reads a recording and decodes its images.
pub fn recording(bytes: &[u8]) {
    let _ = read_recording_bytes(Cursor::new(bytes), &mut |image| {
        let _ = image.open().map(|opened| opened.decode());
        ControlFlow::Continue(())
    });
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use boresight_data::{GrayImage, GrayPixels};
    use proptest::prelude::*;

    use super::*;
    use crate::recording::{Packing, RecordingWriter};

    /// Returns good examples for a reader.
    fn examples(reader: &str) -> Vec<Vec<u8>> {
        let pixels = GrayPixels::Eight((0..96).collect());
        let shown = GrayImage::new([12, 8], pixels).unwrap();
        let file = |format| {
            let mut bytes = Cursor::new(Vec::new());
            let buffer = image::RgbImage::from_fn(9, 7, |x, y| image::Rgb([x as u8, y as u8, 9]));
            buffer.write_to(&mut bytes, format).unwrap();
            bytes.into_inner()
        };
        match reader {
            "corners_csv" => vec![b"camera,view,point,u,v,sigma_px\nleft,1,0,5,6,0.1\nleft,1,1,7.5,6e0,1\n".to_vec()],
            "corners_vnl" => vec![b"# filename x y level\na.png 1 2 0\na.png 3 4 1\na.png - - -\na.png 5 6 0\na.png 7 8 0\na.png 9 9 0\n".to_vec()],
            "image" => {
                let mut jpeg = vec![
                    file(image::ImageFormat::Png),
                    file(image::ImageFormat::Tiff),
                    b"P5 3 2 255\n123456".to_vec(),
                ];
                let mut bytes = Vec::new();
                image::codecs::jpeg::JpegEncoder::new(&mut bytes)
                    .encode(&[7; 192], 8, 8, image::ExtendedColorType::Rgb8)
                    .unwrap();
                jpeg.push(bytes);
                jpeg
            }
            "job_file" => vec![
                b"[target]\nkind = \"chessboard\"\ncolumns = 9\nrows = 6\nspacing_m = 0.025\n[[camera]]\n\
                  name = \"left\"\nimage_size = [640, 480]\nmodel = \"pinhole\"\nparams = [1.0, 1.0, 0.0, 0.0]\n\
                  [input]\nrecordings = [\"a.mcap\"]\nsync_tolerance_ms = 5.0\n[options]\nmodel = \"opencv5\"\n"
                    .to_vec(),
            ],
            "message" => {
                let cdr = crate::recording::image_to_cdr(7, &shown);
                let json = br#"{"timestamp":{"sec":7,"nsec":9},"width":2,"height":1,"encoding":"mono8","step":2,"data":"AAA="}"#;
                let protobuf = [8, 1, 0x15, 2, 0, 0, 0, 0x1d, 1, 0, 0, 0, 0x22, 5, b'm', b'o', b'n', b'o', b'8', 0x2d, 2, 0, 0, 0, 0x32, 2, 1, 2];
                (0..13)
                    .flat_map(|kind| [&cdr[..], json, &protobuf].map(|bytes| [&[kind], bytes].concat()))
                    .collect()
            }
            _ => [Packing::Stored, Packing::Zstd, Packing::Lz4]
                .map(|packing| {
                    let mut writer = RecordingWriter::new(Path::new("x"), Vec::new(), packing).unwrap();
                    for time in 0..4 {
                        writer.image("/a/image", time, time, &shown).unwrap();
                    }
                    writer.finish().unwrap()
                })
                .to_vec(),
        }
    }

    #[test]
    fn good_examples_are_good() {
        let target = parse_target("chessboard:3x2:1cm").unwrap();
        for (reader, _) in READERS {
            for bytes in examples(reader) {
                let is_good = match *reader {
                    "corners_csv" => super::corners_csv::read_csv("x", &bytes, &target, 1.0).is_ok(),
                    "corners_vnl" => super::corners_vnl::read_vnl("x", &bytes, &target, 1.0).is_ok(),
                    "image" => image_from_bytes("x", &bytes).is_ok(),
                    "job_file" => read_job_file("x", &bytes).is_ok(),
                    "recording" => {
                        let mut images = 0;
                        let count = |image: crate::RecordedImage| {
                            images += usize::from(image.open().is_ok_and(|opened| opened.decode().is_ok()));
                            ControlFlow::Continue(())
                        };
                        let read = read_recording_bytes(Cursor::new(&bytes), &mut { count });
                        read.is_ok() && images == 4
                    }
                    _ => true,
                };
                assert!(is_good, "{reader}: {bytes:?}");
            }
        }
    }

    /// A change to bytes.
    #[derive(Clone, Debug)]
    enum Change {
        Set(prop::sample::Index, u8),
        Remove(prop::sample::Index, usize),
        Repeat(prop::sample::Index, usize),
        Fill(prop::sample::Index, usize, u8),
        Cut(prop::sample::Index),
    }

    fn change() -> impl Strategy<Value = Change> {
        let at = any::<prop::sample::Index>;
        let byte = || prop_oneof![Just(0_u8), Just(0xff), Just(0x7f), Just(0x80), any::<u8>()];
        prop_oneof![
            6 => (at(), byte()).prop_map(|(at, byte)| Change::Set(at, byte)),
            1 => (at(), 1..16_usize).prop_map(|(at, n)| Change::Remove(at, n)),
            1 => (at(), 1..64_usize).prop_map(|(at, n)| Change::Repeat(at, n)),
            2 => (at(), 1..9_usize, byte()).prop_map(|(at, n, byte)| Change::Fill(at, n, byte)),
            1 => at().prop_map(Change::Cut),
        ]
    }

    fn apply(bytes: &mut Vec<u8>, change: &Change) {
        if bytes.is_empty() {
            return;
        }
        let length = bytes.len();
        let range = |at: &prop::sample::Index, n: usize| {
            let at = at.index(length);
            at..(at + n).min(length)
        };
        match change {
            Change::Set(at, byte) => bytes[at.index(length)] = *byte,
            Change::Remove(at, n) => drop(bytes.drain(range(at, *n))),
            Change::Repeat(at, n) => {
                let range = range(at, *n);
                let again = bytes[range.clone()].to_vec();
                bytes.splice(range.start..range.start, again);
            }
            Change::Fill(at, n, byte) => bytes[range(at, *n)].fill(*byte),
            Change::Cut(at) => bytes.truncate(at.index(length)),
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(400))]

        #[test]
        fn spoilt_examples_are_read_or_refused(
            reader in 0..READERS.len(),
            example in any::<prop::sample::Index>(),
            changes in proptest::collection::vec(change(), 1..8),
        ) {
            let (name, read) = READERS[reader];
            let examples = examples(name);
            let mut bytes = examples[example.index(examples.len())].clone();
            for change in &changes {
                apply(&mut bytes, change);
            }
            read(&bytes);
        }

        #[test]
        fn any_bytes_are_read_or_refused(
            reader in 0..READERS.len(),
            bytes in proptest::collection::vec(any::<u8>(), 0..200),
        ) {
            READERS[reader].1(&bytes);
        }
    }
}
