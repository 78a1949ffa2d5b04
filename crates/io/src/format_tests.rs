//! Conformance of every registered format: what it writes it reads, and what is no file of its own it refuses.

use boresight_data::{Geometry, Shape};
use proptest::prelude::*;

use super::*;
use crate::samples::{calibration, lens, rig};

const LENSES: [(&str, usize); 18] = [
    ("pinhole", 0),
    ("opencv4", 4),
    ("opencv5", 5),
    ("opencv8", 8),
    ("opencv12", 12),
    ("opencv14", 14),
    ("kannala-brandt4", 4),
    ("double-sphere", 2),
    ("eucm", 2),
    ("mei", 5),
    ("division", 1),
    ("stereographic", 0),
    ("lonlat", 0),
    ("latlon", 0),
    ("cahvor", 5),
    ("cahvore:linearity=0.37", 8),
    ("splined2:4x3:100deg", 24),
    ("splined3:5x4:120deg", 40),
];

fn target() -> Target {
    let geometry = Geometry::Chessboard { columns: 2, rows: 2, spacing_m: 0.1 };
    Target { name: "board".to_owned(), geometry, shape: Shape::Rigid }
}

/// Runs whatever reader a format has.
fn read(format: &Format, bytes: &[u8]) -> Option<Result<(), Error>> {
    let file = format!("x.{}", format.extensions[0]);
    let cameras = format.read_cameras.map(|read| read(&file, bytes).map(|_| ()));
    cameras.or(format.read_corners.map(|read| read(&file, bytes, &target(), 1.0).map(|_| ())))
}

/// Returns a good file of a format that is read.
fn good(format: &Format) -> Option<Vec<u8>> {
    match format.name {
        "csv" => Some(
            b"camera,image,view,point,X,Y,Z,u,v\nleft,a,1,0,0,0,0,1.5,2\nleft,a,1,3,1,1,0,7,8\n".to_vec(),
        ),
        "vnl" => Some(b"# filename x y level\na 1 1 0\na 2 1 1\na - - -\na 2 2.25 0\nb - - -\n".to_vec()),
        _ => {
            format.read_cameras?;
            let lenses = match format.name {
                "kalibr" => [("opencv4", lens(4)), ("eucm", lens(2))],
                _ => [("opencv5", lens(5)), ("opencv8", lens(8))],
            };
            let calibration = calibration(rig(&lenses));
            export(&calibration, format.name).unwrap().pop().map(|file| file.bytes)
        }
    }
}

#[test]
fn names_are_unique_and_every_format_does_something() {
    for (i, format) in FORMATS.iter().enumerate() {
        assert!(FORMATS[..i].iter().all(|other| other.name != format.name), "{}", format.name);
        let does = format.export.is_some() || format.read_cameras.is_some() || format.read_corners.is_some();
        assert!(does && !format.about.is_empty() && !format.extensions.is_empty(), "{}", format.name);
    }
}

#[test]
fn what_is_written_is_read_for_every_lens_it_carries() {
    let families = LENSES.map(|(name, _)| name.split(':').next().unwrap());
    assert_eq!(families.to_vec(), Model::names(), "every lens is tried");
    for format in FORMATS.iter().filter(|format| format.export.is_some()) {
        for (name, coefficients) in LENSES {
            let calibration = calibration(rig(&[(name, lens(coefficients))]));
            let (_, written) = calibrated(&calibration).next().unwrap();
            let files = match export(&calibration, format.name) {
                Ok(files) => files,
                Err(error) => {
                    assert!(!(format.carries)(&written.camera.model), "{} {name}: {error}", format.name);
                    assert!(error.to_string().contains(name), "{error}");
                    assert!(error.hint().unwrap().contains("json"), "{error}");
                    continue;
                }
            };
            assert_eq!(files, export(&calibration, format.name).unwrap());
            assert_eq!(files.len(), 1, "{}", format.name);
            assert!(format.extensions.iter().any(|extension| files[0].name.ends_with(extension)));
            if format.read_cameras.is_none() {
                continue;
            }
            // Told by its contents, whatever its name.
            let read = cameras_from_bytes("unknown", &files[0].bytes).unwrap();
            assert_eq!(read[0].camera, written.camera, "{}", format.name);
            if let Some(cam_from_rig) = read[0].cam_from_rig {
                assert_eq!(cam_from_rig, written.cam_from_rig);
            }
        }
    }
}

#[test]
fn what_is_no_file_of_a_format_is_refused_by_name() {
    for format in FORMATS {
        for (what, bytes) in [
            ("empty", &b""[..]),
            ("blank", b" \n\n"),
            ("garbage", b"\x00\xff\xfe garbage \x80 {[('\"\n%"),
            ("another format", b"<?xml version=\"1.0\"?>\n<opencv_storage>\n</opencv_storage>\n"),
        ] {
            let Some(result) = read(format, bytes) else { continue };
            let error = result.expect_err(what).to_string();
            assert!(error.contains(&format!("x.{}", format.extensions[0])), "{what}: {error}");
        }
        let Some(whole) = good(format) else { continue };
        assert!(matches!(read(format, &whole), Some(Ok(()))), "{} {:?}", format.name, read(format, &whole));
        let half = &whole[..whole.len() * 6 / 10];
        let error = read(format, half).unwrap().expect_err(format.name).to_string();
        assert!(error.contains("x."), "{error}");
    }
    assert!(matches!(cameras_from_bytes("x.bin", b"\x01"), Err(Error::Unrecognized { .. })));
    assert!(matches!(cameras_from_bytes("x.bin", b" "), Err(Error::Empty { .. })));
    assert!(export(&calibration(Vec::new()), "h-matrx").unwrap_err().to_string().contains("h-matrix"));
    assert_eq!(closest_format("h-matrx"), Some("h-matrix"));
}

#[test]
fn file_names_are_safe_and_distinct() {
    let names = ["left", "../left", "a/b", "a_b", "", "..", "é"];
    let expected = ["left", ".._left", "a_b", "a_b-2", "camera", "camera-2", "_"];
    assert_eq!(file_stems(names.into_iter()), expected);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]

    #[test]
    fn no_bytes_make_a_reader_panic(bytes in proptest::collection::vec(any::<u8>(), 0..400)) {
        for format in FORMATS {
            let _ = read(format, &bytes);
        }
        let _ = cameras_from_bytes("x", &bytes);
    }

    #[test]
    fn no_change_of_a_good_file_makes_a_reader_panic(
        at in 0.0..1.0_f64,
        length in 0_usize..12,
        with in prop_oneof!["[-0-9.eE,]{0,12}", "[\\[\\]{}()'\":#, \n]{0,8}", "\\PC{0,8}"],
        repeat in 1_usize..40,
    ) {
        for format in FORMATS {
            let Some(mut bytes) = good(format) else { continue };
            let start = (at * bytes.len() as f64) as usize;
            let end = (start + length).min(bytes.len());
            bytes.splice(start..end, with.repeat(repeat).into_bytes());
            let _ = read(format, &bytes);
        }
    }

    #[test]
    fn no_job_file_and_no_points_make_a_reader_panic(
        text in "(\\[target\\]|\\[\\[camera\\]\\]|kind = |columns = |[0-9.,-]{1,4}|\"points\"|\n|id,x_m,y_m,z_m|\\PC){0,30}",
    ) {
        let _ = crate::job_file::read_job_file("x.toml", text.as_bytes());
        let _ = crate::job_file::read_points("x.csv", text.as_bytes());
        let _ = crate::parse_target(&text);
    }

    #[test]
    fn no_names_of_images_make_their_assignment_panic(names in proptest::collection::vec("[a-c0-2/._*?-]{0,8}", 0..6)) {
        use crate::image_names::{Listed, assign};
        let images: Vec<&str> = names.iter().map(String::as_str).collect();
        let listed = |name: &String| Listed { name: name.clone(), images: None };
        let patterned = |name: &String| Listed { name: name.clone(), images: Some(format!("*{name}?*")) };
        let _ = assign("x", &images, &[]);
        let _ = assign("x", &images, &names.iter().map(listed).collect::<Vec<_>>());
        let _ = assign("x", &images, &names.iter().map(patterned).collect::<Vec<_>>());
    }
}

#[test]
fn times_that_a_format_has_no_place_for_are_told() {
    let mut calibration = calibration(rig(&[("opencv4", lens(4)), ("opencv4", lens(4))]));
    for placed in calibration.scene.rig.cameras.iter_mut().flatten() {
        (placed.time_offset_s, placed.line_delay_s) = (0.0, 0.0);
    }
    assert!(FORMATS.iter().all(|format| lost_in(&calibration, format.name).is_empty()));
    let placed = calibration.scene.rig.cameras.iter_mut().flatten().last().unwrap();
    (placed.time_offset_s, placed.line_delay_s) = (0.0123, -4.5e-6);
    let name = calibration.cameras.iter().last().unwrap().name.clone();
    for format in FORMATS.iter().filter(|format| format.export.is_some()) {
        let lost = lost_in(&calibration, format.name);
        if format.name == "json" {
            assert!(lost.is_empty(), "{lost:?}");
            continue;
        }
        let [line] = &lost[..] else { panic!("{}: {lost:?}", format.name) };
        let words = format!("{name}: format {}", format.name);
        assert!(
            line.starts_with(&words) && line.contains("12.300 ms") && line.contains("-4.500 us"),
            "{line}"
        );
    }
}
