//! Projections against the numbers of other tools.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

use std::io::{Read, Seek};
use std::path::Path;

use boresight_camera::{Camera, CameraModel, Model, ModelVisitor};
use boresight_geometry::Vector3;
use npyz::npz::NpzArchive;

const IMAGE_SIZE: [u32; 2] = [1600, 1200];

#[track_caller]
fn check(model: &str, params: &[f64], expected: &[([f64; 3], [f64; 2])]) {
    let camera = Camera::new(model.parse().unwrap(), params.to_vec(), IMAGE_SIZE).unwrap();
    for (point, pixel) in expected {
        let found = camera.project(&Vector3::from(*point)).unwrap();
        let error = (found[0] - pixel[0]).hypot(found[1] - pixel[1]);
        // A few units in the last place of a coordinate near 1000 (1.1e-13).
        assert!(error < 2e-12, "{model}: {point:?} at {found:?}, expected {pixel:?}");
    }
}

/// Golden numbers of `cv2.projectPoints`, OpenCV 5.0.0 (PyPI opencv-python).
#[test]
fn opencv_12_and_14_match_opencv() {
    let strong = [
        1250.0, 1245.0, 790.0, 610.0, -0.27, -0.047, 1.8e-3, -3e-4, 0.25, 0.05, 0.02, 0.01, -2e-3, 1e-3,
        1e-3, -1e-3, 0.1, -0.08,
    ];
    let rational = [
        620.0, 622.0, 805.0, 590.0, 0.9, 0.12, 2e-4, -1e-4, 0.004, 1.25, 0.35, 0.02, -5e-4, 1e-4, 3e-4,
        -1e-4, 0.005, 0.01,
    ];
    check(
        "opencv12",
        &strong[..16],
        &[
            ([0.3, -0.2, 1.0], [1148.5908247133946, 372.09368889030594]),
            ([-0.7, 0.5, 1.3], [201.83601206331866, 1028.9992786422476]),
            ([0.05, 0.9, 2.0], [818.7354534619541, 1135.3709755350524]),
        ],
    );
    check(
        "opencv14",
        &strong,
        &[
            ([0.0, 0.0, 1.0], [790.0, 610.0]),
            ([0.3, -0.2, 1.0], [1151.1649078235687, 372.8373544090732]),
            ([-0.7, 0.5, 1.3], [202.38464806322418, 1024.6719029271114]),
            ([0.05, 0.9, 2.0], [820.1605043983554, 1162.662267814645]),
        ],
    );
    check(
        "opencv12",
        &rational[..16],
        &[
            ([0.3, -0.2, 1.0], [983.0594305985123, 470.9185250343283]),
            ([-0.7, 0.5, 1.3], [511.9605533285495, 800.0051431929433]),
            ([0.05, 0.9, 2.0], [819.4434187344777, 852.199110924651]),
        ],
    );
    check(
        "opencv14",
        &rational,
        &[
            ([0.3, -0.2, 1.0], [982.3890558129732, 471.36240486295276]),
            ([-0.7, 0.5, 1.3], [510.05387514357517, 801.3784221632757]),
            ([0.05, 0.9, 2.0], [819.4712710727246, 852.694151988965]),
        ],
    );
}

/// Golden numbers of `cv2.fisheye.projectPoints`, OpenCV 5.0.0 (PyPI opencv-python). Beyond 90
/// degrees that function mirrors the point, so that only points in front are compared.
#[test]
fn kannala_brandt_matches_opencv_fisheye() {
    check(
        "kannala-brandt4",
        &[380.0, 381.0, 795.0, 605.0, -0.01, 0.005, -0.002, 3e-4],
        &[
            ([0.0, 0.0, 1.0], [795.0, 605.0]),
            ([0.3, -0.2, 1.0], [904.2892668146792, 531.9487532343986]),
            ([-0.7, 0.5, 0.3], [416.5144565176992, 876.05825576458]),
            ([0.9, 0.3, 0.01], [1350.1425870992603, 790.5344962147528]),
        ],
    );
    check(
        "kannala-brandt4",
        &[310.0, 309.0, 802.0, 598.0, 0.05, -0.01, 0.002, -2e-4],
        &[
            ([0.3, -0.2, 1.0], [891.7797476888293, 538.3399096003263]),
            ([-0.7, 0.5, 0.3], [472.00733553235494, 832.9486942868717]),
            ([0.9, 0.3, 0.01], [1299.534131017635, 763.3097274026336]),
        ],
    );
}

/// The models of the golden file, in its order, by our names.
const MRCAL_MODELS: [(usize, &str); 8] = [
    (0, "pinhole"),
    (1, "stereographic"),
    (4, "opencv4"),
    (5, "opencv5"),
    (6, "opencv8"),
    (7, "opencv12"),
    (9, "splined3:16x11:120deg"),
    (10, "splined3:16x11:120deg"),
];

/// Golden numbers of mrcal 2.2 (`mrcal.project` and `mrcal.unproject`), 200 points per model.
#[test]
fn projections_match_mrcal() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../../shared/conformance/mrcal/golden/golden_project.npz");
    let Ok(mut archive) = NpzArchive::open(&path) else {
        println!("skipped: {} is not there", path.display());
        return;
    };
    let points = read(&mut archive, "p");
    for (i, name) in MRCAL_MODELS {
        let params = read(&mut archive, &format!("{i}_intrinsics"));
        let [pixels, by_point, by_param, rays] =
            ["q", "dq_dp", "dq_di", "v"].map(|array| read(&mut archive, &format!("{i}_{array}")));
        let model: Model = name.parse().unwrap();
        let camera = Camera::new(model, params.clone(), [4000, 2200]).unwrap();
        for (j, point) in points.chunks(3).enumerate() {
            let point = [point[0], point[1], point[2]];
            let golden = Golden {
                pixel: &pixels[2 * j..],
                by_point: &by_point[6 * j..],
                by_param: &by_param[2 * params.len() * j..],
            };
            model.visit(Compare { params: &params, point, golden });
            let ray = camera.unproject([pixels[2 * j], pixels[2 * j + 1]]).unwrap();
            let expected = Vector3::from_row_slice(&rays[3 * j..3 * j + 3]).normalize();
            // mrcal's unprojection iterates to about 1e-8.
            assert!((ray - expected).norm() < 1e-7, "{name} {j}: {ray} {expected}");
            assert!((ray - Vector3::from(point).normalize()).norm() < 1e-12);
        }
    }
}

struct Golden<'a> {
    pixel: &'a [f64],
    by_point: &'a [f64],
    by_param: &'a [f64],
}

struct Compare<'a> {
    params: &'a [f64],
    point: [f64; 3],
    golden: Golden<'a>,
}

impl ModelVisitor for Compare<'_> {
    type Output = ();

    fn visit<M: CameraModel>(self, model: M) {
        let Self { params, point, golden } = self;
        let n_lens = params.len() - 4;
        let mut d_point = [[0.0; 3]; 2];
        let mut d_lens = [vec![0.0; n_lens], vec![0.0; n_lens]];
        let [u, v] = &mut d_lens;
        let pixel = model.linearize(params, point, &mut d_point, [u, v]).unwrap();
        let projected = model.project(params, point).unwrap();
        for row in 0..2 {
            // mrcal computes in the same precision: pixels near 4000 agree to a few of their 4.5e-13.
            assert!((pixel[row] - golden.pixel[row]).abs() < 1e-11);
            assert!((projected[row] - golden.pixel[row]).abs() < 1e-11);
            for (axis, derivative) in d_point[row].iter().enumerate() {
                assert!((derivative - golden.by_point[3 * row + axis]).abs() < 1e-10);
            }
            for (i, derivative) in d_lens[row].iter().enumerate() {
                assert!((derivative - golden.by_param[params.len() * row + 4 + i]).abs() < 1e-10);
            }
        }
    }
}

fn read(archive: &mut NpzArchive<impl Read + Seek>, name: &str) -> Vec<f64> {
    archive.by_name(name).unwrap().unwrap().into_vec().unwrap()
}
