//! Video in recordings: encoded here, recorded as Foxglove does, and read like any other images.
#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "a test may panic, and says what it measured")]

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

use boresight_camera::{Camera, Model};
use boresight_data::{Geometry, GrayPixels, Shape, Target};
use boresight_detect::detect;
use boresight_geometry::{Pose, Vector3};
use boresight_io::{
    JobOverrides, Packing, RecordingOptions, RecordingWriter, load_recordings, survey_recordings,
};
use boresight_synthetic::{Exposure, render};
use openh264::OpenH264API;
use openh264::encoder::{
    BitRate, Encoder, EncoderConfig, FrameRate, IntraFramePeriod, QpRange, RateControlMode,
};
use openh264::formats::YUVBuffer;

const FRAMES: usize = 24;
const KEYFRAMES_EVERY: usize = 8;
const BEGIN_NS: i64 = 1_700_000_000_000_000_000;
const PERIOD_NS: i64 = 33_333_333;

fn target() -> Target {
    let geometry = Geometry::Chessboard { columns: 7, rows: 5, spacing_m: 0.03 };
    Target { name: "board".to_owned(), geometry, shape: Shape::Rigid }
}

fn camera() -> Camera {
    let params = vec![600.0, 600.0, 319.0, 241.0];
    Camera { model: Model::Pinhole(Default::default()), params, image_size: [640, 480] }
}

/// Where the board stands in a frame: it moves by a few pixels from one to the next.
fn cam_from_target(frame: usize) -> Pose {
    let t = frame as f64 / FRAMES as f64;
    let turn = Vector3::new(0.4 * (5.0 * t).cos(), 0.4 * (5.0 * t).sin(), 0.3 * (t - 0.5));
    let turned = Pose::from_rodrigues(turn, Vector3::zeros());
    let middle = Vector3::new(0.04 * (4.0 * t).sin(), 0.03 * (3.0 * t).cos(), 0.55 + 0.1 * t);
    Pose::new(turned.rotation, middle - turned * Vector3::new(0.09, 0.06, 0.0))
}

/// Returns the frames of a video of the board, each with its parameter sets where it is a keyframe.
fn encoded() -> Vec<Vec<u8>> {
    let config = EncoderConfig::new()
        .bitrate(BitRate::from_bps(8_000_000))
        .max_frame_rate(FrameRate::from_hz(30.0))
        .rate_control_mode(RateControlMode::Off)
        .qp(QpRange::new(18, 18))
        .skip_frames(false)
        .scene_change_detect(false)
        .intra_frame_period(IntraFramePeriod::from_num_frames(KEYFRAMES_EVERY as u32));
    let mut encoder = Encoder::with_api_config(OpenH264API::from_source(), config).unwrap();
    let frame = |frame: usize| {
        let image =
            render(&camera(), &cam_from_target(frame), &target(), &[], &Exposure::default(), frame as u64)
                .unwrap();
        let GrayPixels::Eight(luma) = image.pixels() else { panic!("eight bits") };
        let [width, height] = image.size().map(|side| side as usize);
        let mut planes = luma.clone();
        planes.resize(width * height * 3 / 2, 128);
        encoder.encode(&YUVBuffer::from_vec(planes, width, height)).unwrap().to_vec()
    };
    (0..FRAMES).map(frame).collect()
}

/// Writes a message as protobuf does: its time, its data and its format.
fn message(stamp_ns: i64, data: &[u8], format: &str) -> Vec<u8> {
    fn varint(to: &mut Vec<u8>, mut number: u64) {
        while number >= 0x80 {
            to.push(number as u8 | 0x80);
            number >>= 7;
        }
        to.push(number as u8);
    }
    fn field(to: &mut Vec<u8>, number: u8, bytes: &[u8]) {
        to.push(number << 3 | 2);
        varint(to, bytes.len() as u64);
        to.extend_from_slice(bytes);
    }
    let mut time = vec![0x08];
    varint(&mut time, (stamp_ns / 1_000_000_000) as u64);
    time.push(0x10);
    varint(&mut time, (stamp_ns % 1_000_000_000) as u64);
    let mut message = Vec::new();
    field(&mut message, 1, &time);
    field(&mut message, 2, b"camera");
    field(&mut message, 3, data);
    field(&mut message, 4, format.as_bytes());
    message
}

/// A recording of frames that are numbered, in a folder of its own.
fn recording(frames: &[(usize, Vec<u8>)], format: &str) -> (tempfile::TempDir, PathBuf) {
    let mut writer = RecordingWriter::new(Path::new("video"), Vec::new(), Packing::Zstd).unwrap();
    for (frame, data) in frames {
        let stamp_ns = BEGIN_NS + *frame as i64 * PERIOD_NS;
        let message = message(stamp_ns, data, format);
        writer
            .message("/cam/video", "foxglove.CompressedVideo", "protobuf", stamp_ns + 5_000_000, &message)
            .unwrap();
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("video.mcap");
    std::fs::write(&path, writer.finish().unwrap()).unwrap();
    (folder, path)
}

/// Reads a recording, and returns the frames that were decoded, by their stamps, and for the others why they were not.
///
/// Every corner of those that were is checked against the truth.
fn read(path: &Path) -> (Vec<usize>, Vec<String>) {
    let overrides = JobOverrides { target: Some(target()), ..JobOverrides::default() };
    let job = load_recordings(&[path.to_owned()], &overrides).unwrap().unwrap();
    let (mut frames, mut lost) = (Vec::new(), Vec::new());
    let (mut squares, mut n) = (0.0, 0.0);
    job.read(&mut |image| {
        let decoded = image.open().and_then(|opened| Ok((opened.stamp_ns, opened.decode()?)));
        let (stamp_ns, pixels) = match decoded {
            Ok(decoded) => decoded,
            Err(why) => {
                lost.push(why);
                return ControlFlow::Continue(());
            }
        };
        assert_eq!(image.bytes(), 640 * 480);
        assert_eq!((stamp_ns - BEGIN_NS) % PERIOD_NS, 0, "stamps are kept");
        let frame = ((stamp_ns - BEGIN_NS) / PERIOD_NS) as usize;
        frames.push(frame);
        let detection = detect(&pixels, &target());
        assert_eq!(detection.observations.len(), 35, "frame {frame}: {:?}", detection.missed);
        for seen in &detection.observations {
            let in_cam = cam_from_target(frame) * target().drawn_point(seen.point);
            let [u, v] = camera().project(&in_cam).unwrap();
            let off_px = (u - seen.pixel[0]).hypot(v - seen.pixel[1]);
            assert!(off_px < 0.5, "frame {frame}: {off_px} px");
            squares += off_px * off_px;
            n += 1.0;
        }
        ControlFlow::Continue(())
    })
    .unwrap();
    if n > 0.0 {
        let rms_px = f64::sqrt(squares / (2.0 * n));
        println!("{} frames, {n} corners, {rms_px:.4} px per axis", frames.len());
        assert!(rms_px < 0.06, "{rms_px}");
    }
    (frames, lost)
}

fn numbered(frames: &[Vec<u8>]) -> Vec<(usize, Vec<u8>)> {
    frames.iter().cloned().enumerate().collect()
}

#[test]
fn video_is_read_like_images() {
    let frames = encoded();
    let bytes: usize = frames.iter().map(Vec::len).sum();
    println!("{} bytes a frame", bytes / FRAMES);
    let (_folder, path) = recording(&numbered(&frames), "h264");
    assert_eq!(read(&path), ((0..FRAMES).collect(), Vec::new()));
    let survey = survey_recordings(&[path], &RecordingOptions::default(), &[]).unwrap();
    let topic = &survey.images[0];
    assert_eq!((topic.messages, &topic.encodings[..]), (FRAMES, &["h264".to_owned()][..]));
}

#[test]
fn frames_after_a_missing_or_broken_one_wait_for_a_keyframe() {
    let frames = encoded();
    let up_to = |range: std::ops::Range<usize>| range.collect::<Vec<usize>>();
    let check = |frames: &[(usize, Vec<u8>)], good: Vec<usize>, reasons: &[(usize, &str)]| {
        let (_folder, path) = recording(frames, "h264");
        let (found, lost) = read(&path);
        assert_eq!(found, good);
        assert_eq!(lost.len(), reasons.iter().map(|(count, _)| count).sum::<usize>(), "{lost:?}");
        for (count, part) in reasons {
            assert_eq!(lost.iter().filter(|why| why.contains(part)).count(), *count, "{part}: {lost:?}");
        }
    };
    // It begins between keyframes.
    check(
        &numbered(&frames)[3..],
        up_to(KEYFRAMES_EVERY..FRAMES),
        &[(KEYFRAMES_EVERY - 3, "no keyframe of the video comes before it")],
    );
    // One is missing, and what follows refers to it; then one is cut off.
    let mut missing = numbered(&frames);
    missing.remove(10);
    let good = [up_to(0..10), up_to(16..FRAMES)].concat();
    let waiting = "no keyframe came since";
    check(&missing, good.clone(), &[(1, "it is damaged"), (4, waiting)]);
    let mut cut = numbered(&frames);
    let half = cut[10].1.len() / 2;
    cut[10].1.truncate(half);
    check(&cut, good, &[(1, "it is damaged"), (5, waiting)]);
    // Nothing of it is video that is read.
    for (data, format, part) in [
        (&frames[0][..], "h265", "`h265`; h264 is read"),
        (b"not video at all", "h264", "no H.264 in Annex B form"),
        (b"", "h264", "no H.264 in Annex B form"),
        (&[0, 0, 1, 0x65, 9, 9, 9, 9], "h264", "cannot be decoded"),
    ] {
        let (_folder, path) = recording(&[(0, data.to_vec())], format);
        let (found, lost) = read(&path);
        assert!(found.is_empty() && lost.len() == 1 && lost[0].contains(part), "{lost:?}");
    }
}
