//! Recordings whole, damaged, and of every kind of message.

use std::io::Cursor;
use std::path::Path;

use boresight_data::{GrayImage, GrayPixels, Observation, PointId};
use proptest::prelude::*;

use super::*;
use crate::image_job::SeenImage;
use crate::job::JobOverrides;

const SECOND: i64 = 1_000_000_000;

/// Returns an image whose pixels tell its number.
fn image(number: usize, size: [u32; 2]) -> GrayImage {
    let n = size[0] as usize * size[1] as usize;
    let mut state = number as u32 + 1;
    let next = |_| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 24) as u8
    };
    GrayImage::new(size, GrayPixels::Eight((0..n).map(next).collect())).unwrap()
}

/// Returns a recording of two cameras with `n` images each, 100 ms apart, the second camera 2 ms later.
fn recording(n: usize, size: [u32; 2], packing: Packing) -> Vec<u8> {
    let mut writer = RecordingWriter::new(Path::new("x.mcap"), Vec::new(), packing).unwrap();
    for i in 0..n {
        for camera in 0..2 {
            let time = SECOND + i as i64 * 100_000_000 + camera as i64 * 2_000_000;
            let topic = format!("/cam{camera}/image_raw");
            writer.image(&topic, time, time + 5_000_000, &image(2 * i + camera, size)).unwrap();
        }
    }
    writer.finish().unwrap()
}

/// What comes of an image.
#[derive(Clone, Debug, PartialEq)]
struct DecodedImage {
    image: GrayImage,
    stamp_ns: i64,
}

fn decode(image: &RecordedImage) -> Result<DecodedImage, String> {
    let opened = image.open()?;
    Ok(DecodedImage { image: opened.decode()?, stamp_ns: opened.stamp_ns })
}

/// Writes files, reads them as recordings, and returns their contents and images.
fn read(files: &[&[u8]]) -> Result<(Contents, Vec<(usize, DecodedImage)>), Error> {
    let folder = tempfile::tempdir().unwrap();
    let paths: Vec<PathBuf> = (0..files.len()).map(|i| folder.path().join(format!("{i}.mcap"))).collect();
    for (path, bytes) in paths.iter().zip(files) {
        std::fs::write(path, bytes).unwrap();
    }
    let mut images = Vec::new();
    let contents = read_recordings(&paths, &|_| true, &mut |image| {
        if let Ok(decoded) = decode(&image) {
            images.push((image.topic_idx, decoded));
        }
        ControlFlow::Continue(())
    })?;
    Ok((contents, images))
}

#[test]
fn what_is_written_is_read() {
    let size = [640, 480];
    for packing in [Packing::Stored, Packing::Zstd, Packing::Lz4] {
        let bytes = recording(15, size, packing);
        assert_eq!(bytes, recording(15, size, packing), "the same messages give the same bytes");
        let (contents, images) = read(&[&bytes]).unwrap();
        assert_eq!((images.len(), &contents.damages[..]), (30, &[][..]), "{packing:?}");
        assert_eq!(contents.hashes[0].1, crate::hash(&bytes));
        for (i, (topic_idx, decoded)) in images.iter().enumerate() {
            assert_eq!(contents.topics[*topic_idx].name, format!("/cam{}/image_raw", i % 2));
            assert_eq!(decoded.image, image(i, size));
            let time = SECOND + (i as i64 / 2) * 100_000_000 + (i as i64 % 2) * 2_000_000;
            assert_eq!(decoded.stamp_ns, time);
        }
    }
}

#[test]
fn a_file_that_was_cut_off_gives_what_is_there() {
    let size = [640, 480];
    for packing in [Packing::Stored, Packing::Zstd, Packing::Lz4] {
        let bytes = recording(10, size, packing);
        let (mut before, mut most) = (0, 0);
        for part in 1..8 {
            let cut = bytes.len() * part / 8;
            let (contents, images) = read(&[&bytes[..cut]]).unwrap();
            assert!(images.len() >= before, "{packing:?}: {cut} bytes give {} images", images.len());
            assert!(!contents.damages.is_empty(), "{packing:?}: {cut}");
            before = images.len();
            most = most.max(images.len());
            assert!(images.iter().enumerate().all(|(i, (_, decoded))| decoded.image == image(i, size)));
        }
        assert!((12..20).contains(&most), "{packing:?}: {most}");
    }
}

#[test]
fn a_spoilt_chunk_costs_no_other() {
    let size = [1024, 1024];
    for packing in [Packing::Stored, Packing::Zstd, Packing::Lz4] {
        let mut bytes = recording(6, size, packing);
        let whole = read(&[&bytes]).unwrap().1.len();
        let middle = bytes.len() / 2;
        bytes[middle..middle + 64].iter_mut().for_each(|byte| *byte ^= 0x5a);
        let (contents, images) = read(&[&bytes]).unwrap();
        assert_eq!(contents.damages.len(), 1, "{packing:?}: {:?}", contents.damages);
        assert!(images.len() + 4 >= whole && images.len() >= 8, "{packing:?}: {} of {whole}", images.len());
        // The first and the last are as they were.
        assert_eq!(
            (&images[0].1.image, &images[images.len() - 1].1.image),
            (&image(0, size), &image(11, size))
        );
    }
}

#[test]
fn a_wrong_length_is_passed_by_the_summary() {
    let size = [1024, 1024];
    let mut bytes = recording(6, size, Packing::Stored);
    // The length of the first chunk, which comes after the magic and the header.
    let header = 8 + 9 + u64::from_le_bytes(bytes[9..17].try_into().unwrap()) as usize;
    assert_eq!(bytes[header], mcap::records::op::CHUNK);
    bytes[header + 8] = 0x7f;
    let (contents, images) = read(&[&bytes]).unwrap();
    assert_eq!(images.len(), 12, "{:?}", contents.damages);
    bytes[header] = 0x60;
    let (contents, images) = read(&[&bytes]).unwrap();
    assert!(matches!(contents.damages[..], [(_, Damage::NoRecord { .. })]), "{:?}", contents.damages);
    assert_eq!(images.len(), 8);
    // Without a summary, what follows cannot be found.
    bytes.truncate(bytes.len() - 1);
    assert!(read(&[&bytes]).unwrap().1.is_empty());
}

#[test]
fn what_is_no_recording_is_named() {
    for (bytes, part) in [
        (&b""[..], "empty"),
        (b"#ROSBAG V2.0\n", "ROS 1 bag"),
        (b"SQLite format 3\0", "SQLite"),
        (b"\x89MCAP1\r\n", "does not begin as an MCAP recording"),
        (b"{}", "does not begin"),
    ] {
        let error = read(&[bytes]).unwrap_err().to_string();
        assert!(error.contains(part), "{error}");
    }
    let (contents, images) = read(&[&MAGIC]).unwrap();
    assert_eq!((contents.damages.len(), images.len()), (1, 0));
}

fn job(files: &[(&str, Vec<u8>)], options: RecordingOptions) -> (tempfile::TempDir, RecordingJob) {
    let folder = tempfile::tempdir().unwrap();
    let paths: Vec<PathBuf> = files.iter().map(|(name, _)| folder.path().join(name)).collect();
    for (path, (_, bytes)) in paths.iter().zip(files) {
        std::fs::write(path, bytes).unwrap();
    }
    let target = Some(crate::parse_target("chessboard:3x2:1cm").unwrap());
    let overrides = JobOverrides { target, recording: options, ..JobOverrides::default() };
    let job = load_recordings(&paths, &overrides).unwrap().unwrap();
    (folder, job)
}

/// Reads a job, and takes every image that can be decoded as one of the whole board.
fn loaded(job: RecordingJob) -> Result<crate::Job, Error> {
    let mut seen = Vec::new();
    let contents = job.read(&mut |image| {
        let RecordedImage { topic_idx, index, log_time_ns, .. } = image;
        let observation =
            |i| Observation { point: PointId(i), pixel: [1.0 + f64::from(i), 2.0], sigma_px: 0.1 };
        let found = image.open().and_then(|opened| {
            let size = opened.decode()?.size();
            Ok((
                opened.stamp_ns,
                SeenImage {
                    hash: opened.hash(),
                    image_size: size,
                    is_turned: false,
                    observations: (0..if size[0] > 8 { 6 } else { 0 }).map(observation).collect(),
                    missed: (size[0] <= 8).then(|| "no board is seen".to_owned()),
                    size: crate::SizeSeen::Open,
                    is_legacy: false,
                },
            ))
        });
        seen.push(SeenRecorded { topic_idx, index, log_time_ns, seen: found });
        ControlFlow::Continue(())
    })?;
    // Threads hand back images in any order.
    seen.reverse();
    job.with_detections(contents, seen)
}

fn codes(job: &crate::Job) -> Vec<&str> {
    job.findings.iter().map(|finding| finding.code.as_str()).collect()
}

#[test]
fn topics_become_cameras_and_times_frames() {
    let (_folder, recorded) =
        job(&[("a.mcap", recording(5, [64, 48], Packing::Zstd))], RecordingOptions::default());
    let job = loaded(recorded).unwrap();
    assert_eq!(codes(&job), [""; 0]);
    let names: Vec<&str> = job.dataset.cameras.iter().map(|camera| camera.name.as_str()).collect();
    assert_eq!((names, job.dataset.views.len(), job.dataset.frames.len()), (vec!["cam0", "cam1"], 10, 5));
    let frame = job.dataset.frames.iter().nth(3).unwrap();
    assert_eq!((frame.name.as_str(), frame.time_ns), ("0.300", Some(SECOND + 300_000_000)));
    assert_eq!(job.inputs.len(), 1);

    // Cameras that are 2 ms apart are not of one frame where the tolerance is 1 ms.
    let options = RecordingOptions { tolerance_ns: Some(1_000_000), ..RecordingOptions::default() };
    let (_folder, recorded) =
        super::tests::job(&[("a.mcap", recording(5, [64, 48], Packing::Zstd))], options);
    let job = loaded(recorded).unwrap();
    assert_eq!((codes(&job), job.dataset.frames.len()), (vec!["cameras-apart-in-time"], 10));
    assert!(
        job.findings[0].message.starts_with("cam0 and cam1 are 2.00 ± 0.00 ms apart"),
        "{:?}",
        job.findings
    );
}

#[test]
fn the_times_of_recording_are_taken_on_request_and_where_there_are_no_stamps() {
    let bytes = recording(3, [64, 48], Packing::Stored);
    let options = RecordingOptions { clock: Some(Clock::Log), ..RecordingOptions::default() };
    let (_folder, recorded) = job(&[("a.mcap", bytes)], options);
    let by_log = loaded(recorded).unwrap();
    assert_eq!(by_log.dataset.frames.iter().next().unwrap().time_ns, Some(SECOND + 5_000_000));

    let mut writer = RecordingWriter::new(Path::new("x"), Vec::new(), Packing::Stored).unwrap();
    for i in 0..3 {
        writer.image("/image", 0, i * SECOND, &image(i as usize, [64, 48])).unwrap();
    }
    let (_folder, recorded) = job(&[("a.mcap", writer.finish().unwrap())], RecordingOptions::default());
    let unstamped = loaded(recorded).unwrap();
    assert_eq!((codes(&unstamped), unstamped.dataset.frames.len()), (vec!["no-time-stamps"], 3));
}

#[test]
fn topics_that_are_not_used_are_not_read_unless_those_that_were_to_be_are_lost() {
    let mut writer = RecordingWriter::new(Path::new("x"), Vec::new(), Packing::Zstd).unwrap();
    for i in 0..4_i64 {
        writer.image("/cam/image_raw", i * SECOND, i * SECOND, &image(i as usize, [64, 48])).unwrap();
    }
    let raw = writer.finish().unwrap();
    let mut writer = RecordingWriter::new(Path::new("x"), Vec::new(), Packing::Zstd).unwrap();
    for i in 0..3 {
        let schema = "sensor_msgs/msg/CompressedImage";
        writer.message("/cam/image_raw/compressed", schema, "cdr", i, &[0; 4]).unwrap();
    }
    let compressed = writer.finish().unwrap();
    let delivered = |raw: Vec<u8>| {
        let files = [("a.mcap", raw), ("b.mcap", compressed.clone())];
        let (_folder, recorded) = job(&files, RecordingOptions::default());
        let mut topics = Vec::new();
        let contents = recorded.read(&mut |image| {
            topics.push(image.topic_idx);
            ControlFlow::Continue(())
        });
        let contents = contents.unwrap();
        assert_eq!(contents.topics[1].messages, 3, "what is not read is counted");
        topics.into_iter().map(|idx| contents.topics[idx].name.clone()).collect::<Vec<String>>()
    };
    assert_eq!(delivered(raw.clone()), ["/cam/image_raw"; 4]);
    // The chunk with all raw images is spoilt, though the summary tells of them.
    let mut spoilt = raw;
    let chunk = spoilt.windows(4).position(|four| four == [0x28, 0xb5, 0x2f, 0xfd]).unwrap();
    spoilt[chunk..chunk + 12].fill(0);
    assert_eq!(delivered(spoilt), ["/cam/image_raw/compressed"; 3]);
}

#[test]
fn copies_repetitions_and_second_topics_are_left_out() {
    let mut writer = RecordingWriter::new(Path::new("x"), Vec::new(), Packing::Zstd).unwrap();
    for i in 0..4_i64 {
        // The third image is that of the second again, and the fourth has the time of the first.
        let (number, time) = [(0, 1), (1, 2), (1, 3), (3, 1)][i as usize];
        writer.image("/cam/image_raw", time * SECOND, i * SECOND, &image(number, [64, 48])).unwrap();
    }
    writer
        .message("/cam/image_raw/compressed", "sensor_msgs/msg/CompressedImage", "cdr", 0, &[0; 4])
        .unwrap();
    writer.message("/front", "foxglove.CompressedVideo", "protobuf", 0, &[]).unwrap();
    writer.message("/points", "sensor_msgs/msg/PointCloud2", "cdr", 0, &[]).unwrap();
    let (_folder, recorded) = job(&[("a.mcap", writer.finish().unwrap())], RecordingOptions::default());
    let job = loaded(recorded).unwrap();
    let mut found = codes(&job);
    found.sort_unstable();
    // Nothing is in the message of the video, but without a decoder nobody looks.
    let of_video = if cfg!(feature = "h264") { "unreadable-messages" } else { "topic-not-read" };
    assert_eq!(found, ["camera-recorded-twice", "duplicate-images", "repeated-time-stamps", of_video]);
    let told = job.findings.iter().find(|finding| finding.code == of_video).unwrap();
    assert!(cfg!(feature = "h264") || told.message.contains("without the feature h264"), "{told:?}");
    assert_eq!(job.dataset.views.len(), 2);
}

#[test]
fn recordings_without_images_and_unreadable_ones_are_named() {
    let mut writer = RecordingWriter::new(Path::new("x"), Vec::new(), Packing::Zstd).unwrap();
    writer.message("/points", "sensor_msgs/msg/PointCloud2", "cdr", 0, &[]).unwrap();
    let (_folder, recorded) = job(&[("a.mcap", writer.finish().unwrap())], RecordingOptions::default());
    let error = loaded(recorded).unwrap_err().to_string();
    assert!(error.contains("/points (sensor_msgs/msg/PointCloud2, cdr)"), "{error}");

    let empty = RecordingWriter::new(Path::new("x"), Vec::new(), Packing::Zstd).unwrap().finish().unwrap();
    let (_folder, recorded) = job(&[("a.mcap", empty)], RecordingOptions::default());
    let error = loaded(recorded).unwrap_err();
    assert!(error.to_string().contains("it has no topics"), "{error}");
    assert!(error.hint().unwrap().contains("sensor_msgs"));

    let mut writer = RecordingWriter::new(Path::new("x"), Vec::new(), Packing::Zstd).unwrap();
    writer.image("/cam/image", SECOND, SECOND, &image(0, [64, 48])).unwrap();
    let mut xcdr2 = vec![0, 7, 0, 0];
    xcdr2.extend([0; 40]);
    writer.message("/cam/image", "sensor_msgs/msg/Image", "cdr", SECOND, &xcdr2).unwrap();
    let bytes = writer.finish().unwrap();
    let (folder, recorded) = job(&[("a.mcap", bytes)], RecordingOptions::default());
    let found = loaded(recorded).unwrap();
    assert_eq!(codes(&found), ["unreadable-messages"]);
    assert!(found.findings[0].message.contains("XCDR2"), "{}", found.findings[0].message);
    let survey =
        survey_recordings(&[folder.path().join("a.mcap")], &RecordingOptions::default(), &[]).unwrap();
    assert_eq!((survey.images[0].sizes.clone(), survey.images[0].messages), (vec![[64, 48]], 2));
    assert!(survey.findings[0].message.contains("XCDR2"));
}

/// Returns a protobuf field of bytes.
fn field(number: u8, bytes: &[u8]) -> Vec<u8> {
    let mut field = vec![number << 3 | 2];
    let mut length = bytes.len();
    while length >= 0x80 {
        field.push(length as u8 | 0x80);
        length >>= 7;
    }
    field.push(length as u8);
    field.extend(bytes);
    field
}

fn png(image: &GrayImage) -> Vec<u8> {
    let GrayPixels::Eight(values) = image.pixels() else { panic!("eight bits") };
    let [width, height] = image.size();
    let mut bytes = Cursor::new(Vec::new());
    let buffer = image::GrayImage::from_raw(width, height, values.clone()).unwrap();
    buffer.write_to(&mut bytes, image::ImageFormat::Png).unwrap();
    bytes.into_inner()
}

#[test]
fn images_of_every_kind_of_message_are_read() {
    use base64::Engine as _;
    let shown = image(3, [5, 4]);
    let GrayPixels::Eight(pixels) = shown.pixels() else { panic!("eight bits") };
    let file = png(&shown);
    let base64 = |bytes: &[u8]| base64::engine::general_purpose::STANDARD.encode(bytes);
    let stamp = [0x08, 7, 0x10, 9];
    let raw_protobuf = [
        field(1, &stamp),
        vec![0x15, 5, 0, 0, 0, 0x1d, 4, 0, 0, 0],
        field(4, b"mono8"),
        vec![0x2d, 5, 0, 0, 0],
        field(6, pixels),
        field(7, b"camera"),
    ]
    .concat();
    let compressed_protobuf = [field(1, &stamp), field(2, &file), field(3, b"png")].concat();
    let raw_json = format!(
        r#"{{"timestamp":{{"sec":7,"nsec":9}},"frame_id":"c","width":5,"height":4,"encoding":"mono8","step":5,"data":"{}"}}"#,
        base64(pixels)
    );
    let compressed_json =
        format!(r#"{{"timestamp":{{"sec":7,"nsec":9}},"format":"png","data":"{}"}}"#, base64(&file));
    let number = |value: u32| value.to_le_bytes().to_vec();
    let counted = |bytes: &[u8]| [number(bytes.len() as u32), bytes.to_vec()].concat();
    let raw_ros1 = [
        number(1),
        number(7),
        number(9),
        counted(b"camera"),
        number(4),
        number(5),
        counted(b"mono8"),
        vec![0],
        number(5),
        counted(pixels),
    ]
    .concat();
    // CDR: header, time, frame `c` with its zero, two bytes of padding, format `png` with its zero, the file.
    let compressed_cdr = [
        vec![0, 1, 0, 0],
        number(7),
        number(9),
        number(2),
        b"c\0\0\0".to_vec(),
        number(4),
        b"png\0".to_vec(),
        counted(&file),
    ]
    .concat();
    let foxglove_cdr =
        [vec![0, 1, 0, 0], number(7), number(9), number(2), b"c\0\0\0".to_vec(), counted(&file)].concat();
    let padding = vec![0; (4 - foxglove_cdr.len() % 4) % 4];
    let foxglove_cdr = [foxglove_cdr, padding, number(4), b"png\0".to_vec()].concat();
    for (schema, encoding, bytes) in [
        ("foxglove.RawImage", "protobuf", &raw_protobuf[..]),
        ("foxglove.CompressedImage", "protobuf", &compressed_protobuf),
        ("foxglove.RawImage", "json", raw_json.as_bytes()),
        ("foxglove.CompressedImage", "json", compressed_json.as_bytes()),
        ("sensor_msgs/Image", "ros1", &raw_ros1),
        ("sensor_msgs/msg/CompressedImage", "cdr", &compressed_cdr),
        ("foxglove_msgs/msg/CompressedImage", "cdr", &foxglove_cdr),
    ] {
        let mut writer = RecordingWriter::new(Path::new("x"), Vec::new(), Packing::Zstd).unwrap();
        writer.message("/camera", schema, encoding, 1, bytes).unwrap();
        let (contents, images) = read(&[&writer.finish().unwrap()]).unwrap();
        assert!(contents.topics[0].is_of_images(), "{schema} {encoding}");
        let [(_, decoded)] = &images[..] else { panic!("{schema} {encoding}: {images:?}") };
        assert_eq!((&decoded.image, decoded.stamp_ns), (&shown, 7 * SECOND + 9), "{schema} {encoding}");
        // Whatever of it is there is read or refused.
        let kind = Kind::of_channel(schema, encoding).unwrap();
        for end in 0..bytes.len() {
            let _ = read_image_message(kind, &bytes[..end]).map(|message| message.pixels.decode());
        }
    }
}

#[test]
fn what_is_said_of_cameras_is_read() {
    let number = |value: u32| value.to_le_bytes().to_vec();
    let floats = |values: &[f64]| values.iter().flat_map(|value| value.to_le_bytes()).collect::<Vec<u8>>();
    let matrix = [600.0, 0.0, 320.0, 0.0, 601.0, 240.0, 0.0, 0.0, 1.0];
    // After the header: 8 bytes of time, 4 + 4 of the frame, 8 of the size, 4 + 12 of the model, then at 40 the number of
    // coefficients, and at 48 the first of them.
    let cdr = [
        vec![0, 1, 0, 0],
        number(7),
        number(9),
        number(1),
        vec![0; 4],
        number(480),
        number(640),
        number(10),
        b"plumb_bob\0\0\0".to_vec(),
        number(2),
        number(0),
        floats(&[0.1, -0.2]),
        floats(&matrix),
    ]
    .concat();
    let protobuf = [
        vec![0x15, 0x80, 2, 0, 0, 0x1d, 0xe0, 1, 0, 0],
        field(4, b"plumb_bob"),
        field(5, &floats(&[0.1, -0.2])),
        field(6, &floats(&matrix)),
    ]
    .concat();
    let json = r#"{"timestamp":{"sec":0,"nsec":0},"width":640,"height":480,"distortion_model":"plumb_bob",
        "D":[0.1,-0.2],"K":[600,0,320,0,601,240,0,0,1],"R":[],"P":[]}"#;
    for (schema, encoding, bytes) in [
        ("sensor_msgs/msg/CameraInfo", "cdr", &cdr[..]),
        ("foxglove.CameraCalibration", "protobuf", &protobuf),
        ("foxglove.CameraCalibration", "json", json.as_bytes()),
    ] {
        let info = read_camera_info(Kind::of_channel(schema, encoding).unwrap(), bytes).unwrap();
        assert_eq!((info.image_size, info.distortion_model.as_str()), ([640, 480], "plumb_bob"), "{schema}");
        assert_eq!((&info.distortion[..], info.intrinsics), (&[0.1, -0.2][..], [600.0, 601.0, 320.0, 240.0]));
    }
}

#[test]
fn an_image_that_states_too_much_costs_nothing() {
    // A PNG header of 30000x30000 pixels with next to nothing behind it, and one pixel whole.
    let mut huge = b"\x89PNG\r\n\x1a\n".to_vec();
    for (kind, data) in
        [(b"IHDR", &[0, 0, 0x75, 0x30, 0, 0, 0x75, 0x30, 8, 0, 0, 0, 0][..]), (b"IDAT", &[0x78, 0x9c])]
    {
        let chunk = [&kind[..], data].concat();
        huge.extend((data.len() as u32).to_be_bytes());
        huge.extend(&chunk);
        huge.extend(crc32fast::hash(&chunk).to_be_bytes());
    }
    let mut writer = RecordingWriter::new(Path::new("x"), Vec::new(), Packing::Zstd).unwrap();
    let one = image(0, [1, 1]);
    writer.image("/one/image", SECOND, SECOND, &one).unwrap();
    let fine = image(1, [64, 48]);
    writer.image("/fine/image", SECOND, SECOND, &fine).unwrap();
    let compressed =
        [vec![0, 1, 0, 0], vec![0; 8], vec![1, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0]].concat();
    let compressed = [compressed, (huge.len() as u32).to_le_bytes().to_vec(), huge].concat();
    writer.message("/huge/image", "sensor_msgs/msg/CompressedImage", "cdr", 0, &compressed).unwrap();
    let bytes = writer.finish().unwrap();
    let (_, images) = read(&[&bytes]).unwrap();
    assert_eq!(images.iter().map(|(_, decoded)| &decoded.image).collect::<Vec<_>>(), [&one, &fine]);
    let (_folder, recorded) = job(&[("a.mcap", bytes)], RecordingOptions::default());
    let found = loaded(recorded).unwrap();
    let messages: Vec<&str> = found.findings.iter().map(|finding| finding.message.as_str()).collect();
    assert!(messages.iter().any(|message| message.contains("30000x30000")), "{messages:?}");
}

#[test]
fn any_byte_may_be_another() {
    for packing in [Packing::Stored, Packing::Zstd, Packing::Lz4] {
        let bytes = recording(2, [8, 6], packing);
        for at in 8..bytes.len() {
            for byte in [0, 0x7f, 0xff] {
                let mut bytes = bytes.clone();
                bytes[at] = byte;
                let (_, images) = read(&[&bytes]).unwrap();
                assert!(images.len() <= 400, "{packing:?}, byte {at} is {byte}");
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(96))]

    #[test]
    fn any_damage_is_borne(
        packing in prop_oneof![Just(Packing::Stored), Just(Packing::Zstd), Just(Packing::Lz4)],
        changes in proptest::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..12),
        cut in any::<prop::sample::Index>(),
        is_cut in any::<bool>(),
    ) {
        let mut bytes = recording(3, [24, 16], packing);
        for (at, byte) in changes {
            // The first eight bytes decide whether it is a recording at all.
            let at = 8 + at.index(bytes.len() - 8);
            bytes[at] = byte;
        }
        if is_cut {
            bytes.truncate(8 + cut.index(bytes.len() - 8));
        }
        let (_, images) = read(&[&bytes]).unwrap();
        // A chunk may be read again where the damage points back to it, but not without end.
        prop_assert!(images.len() <= 600);
    }
}
