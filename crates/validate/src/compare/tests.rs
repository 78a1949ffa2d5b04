//! Tests of the comparison of two cameras.

use boresight_camera::{CameraModel, Model, kannala_brandt4, opencv, pinhole};
use boresight_geometry::UnitQuaternion;
use proptest::prelude::*;

use super::*;

const SIZE: [u32; 2] = [1600, 1200];

fn camera(model: &str, params: &[f64]) -> Camera {
    Camera::new(model.parse().unwrap(), params.to_vec(), SIZE).unwrap()
}

/// All cameras that a model shows to its conformance tests.
fn examples<M: CameraModel>() -> Vec<Camera> {
    let model: Model = M::NAME.parse().unwrap();
    M::examples().into_iter().map(|(_, params)| Camera::new(model, params, SIZE).unwrap()).collect()
}

fn all_examples() -> Vec<Camera> {
    let mut cameras = examples::<pinhole::Pinhole>();
    cameras.extend(examples::<opencv::OpenCv<4>>());
    cameras.extend(examples::<opencv::OpenCv<5>>());
    cameras.extend(examples::<opencv::OpenCv<8>>());
    cameras.extend(examples::<opencv::OpenCv<12>>());
    cameras.extend(examples::<opencv::OpenCv<14>>());
    cameras.extend(examples::<kannala_brandt4::KannalaBrandt4>());
    cameras
}

fn ways() -> [CompareOptions; 3] {
    let infinity = CompareOptions::default();
    [
        CompareOptions { distance_m: Some(0.8), ..infinity.clone() },
        CompareOptions { columns: 31, focus_radius_px: Some(200.0), ..infinity.clone() },
        infinity,
    ]
}

/// Returns the comparison after checking that the other order of the arguments gives the same, and
/// does so by itself: both ways are computed.
#[track_caller]
fn check_symmetry(a: &Camera, b: &Camera, options: &CompareOptions) -> Comparison {
    let (ab, ba) = (compare_in_order(a, b, options).unwrap(), compare_in_order(b, a, options).unwrap());
    for (forth, back) in ab.differences_px.iter().zip(&ba.differences_px) {
        match (forth, back) {
            (Some(forth), Some(back)) => {
                let gap = (forth[0] + back[0]).hypot(forth[1] + back[1]);
                // Beyond a thousand pixels, twelve digits are what is left after unprojecting.
                let tolerance = 1e-9 * (1e-3 * forth[0].hypot(forth[1])).max(1.0);
                assert!(gap <= tolerance, "{gap}: {forth:?} {back:?}; {} {}", ab.fit_steps, ba.fit_steps);
            }
            pair => assert_eq!(pair, (&None, &None)),
        }
    }
    assert_eq!(ab.missing, ba.missing);
    assert!((ab.rms_px - ba.rms_px).abs() <= 1e-9 * (1e-3 * ab.rms_px).max(1.0));
    let round_trip = ab.b_from_a() * ba.b_from_a();
    // A milliardth of a pixel at 1000 px/rad is 1e-12 rad; poses at a distance are less certain than
    // the pixels that they explain.
    assert!(round_trip.angle() < 1e-9 && round_trip.translation.norm() < 1e-8, "{round_trip:?}");
    ab
}

#[test]
fn no_camera_differs_from_itself() {
    for camera in all_examples() {
        for options in ways() {
            let same = compare(&camera, &camera, &options).unwrap();
            assert_eq!((same.max_px, same.rms_px, same.p95_px, same.focus_rms_px), (0.0, 0.0, 0.0, 0.0));
            assert_eq!((same.rotation_rad, same.translation_m), ([0.0; 3], [0.0; 3]));
            assert!(same.differences_px.iter().flatten().all(|difference| *difference == [0.0; 2]));
        }
    }
}

#[test]
fn all_pairs_are_symmetric() {
    let cameras = all_examples();
    let (mut n_tried, mut n_compared) = (0, 0);
    for (i, a) in cameras.iter().enumerate() {
        // Neighbours may be wide and narrow lenses: differences of hundreds of pixels.
        for b in cameras.iter().skip(i + 1).step_by(5) {
            for options in ways() {
                let options = CompareOptions { columns: 21, ..options };
                let (ab, ba) = (compare(a, b, &options), compare(b, a, &options));
                match (ab, ba) {
                    (Ok(ab), Ok(ba)) => {
                        n_compared += 1;
                        let gap = (ab.b_from_a() * ba.b_from_a()).log().norm();
                        assert!(gap < 1e-15 && ab.rms_px == ba.rms_px, "{gap}");
                        let differences = ab.differences_px.iter().zip(&ba.differences_px);
                        assert!(
                            differences
                                .into_iter()
                                .all(|(forth, back)| *forth == back.map(|d| d.map(|x| -x)))
                        );
                    }
                    // A narrow lens and a fisheye have next to nothing in common.
                    (ab, ba) => assert_eq!(ab, ba),
                }
                n_tried += 1;
            }
        }
    }
    assert!(n_tried > 100 && 2 * n_compared > n_tried, "{n_compared} of {n_tried}");
}

#[test]
fn the_grid_covers_the_imager() {
    let a = camera("pinhole", &[1000.0, 1000.0, 799.5, 599.5]);
    let same = compare(&a, &a, &CompareOptions::default()).unwrap();
    assert_eq!((same.columns, same.rows, same.differences_px.len()), (60, 45, 2700));
    let pixels: Vec<[f64; 2]> = same.points().map(|(pixel, _)| pixel).collect();
    assert_eq!((pixels[0], pixels[59], pixels[2699]), ([0.0, 0.0], [1599.0, 0.0], [1599.0, 1199.0]));
    assert_eq!(same.focus_radius_px, 600.0);
}

#[test]
fn a_longer_focal_length_is_a_known_difference() {
    let (fx, centre) = (1000.0, 799.5);
    let a = camera("pinhole", &[fx, fx, centre, 599.5]);
    let b = camera("pinhole", &[fx * 1.01, fx, centre, 599.5]);
    let difference = check_symmetry(&a, &b, &CompareOptions::default());
    assert!(Vector3::from(difference.rotation_rad).norm() < 1e-12);
    for ([u, _], difference) in difference.points() {
        // Forth by 1 %, back by 1 - 1/1.01.
        let expected = 0.5 * (0.01 + 1.0 - 1.0 / 1.01) * (u - centre);
        let [du, dv] = difference.unwrap();
        assert!((du - expected).abs() < 1e-9 && dv.abs() < 1e-9, "{u}: {du} {dv}");
    }
    assert!((difference.max_px - 0.5 * (0.01 + 1.0 - 1.0 / 1.01) * centre).abs() < 1e-9);
    assert!(difference.p95_px < difference.max_px && difference.rms_px < difference.p95_px);
}

/// A pinhole and the same camera with its frame turned: OpenCV's tilted sensor at x, y is a turn
/// about the principal point followed by a triangular matrix, which the core makes up for.
fn turned(tau_x: f64, tau_y: f64) -> (Camera, Camera, UnitQuaternion<f64>) {
    let (f, cx, cy) = (1000.0, 790.0, 610.0);
    let a = camera("pinhole", &[f, f, cx, cy]);
    let about = |axis, angle| UnitQuaternion::from_axis_angle(&axis, angle);
    let (x, y) = (Vector3::x_axis(), Vector3::y_axis());
    // matTilt of OpenCV's documentation: [R33 0 -R13; 0 R33 -R23; 0 0 1] R with R = Ry Rx of negated angles.
    let tilt = about(y, -tau_y) * about(x, -tau_x);
    let r = *tilt.to_rotation_matrix().matrix();
    let (r13, r23, r33) = (r[(0, 2)], r[(1, 2)], r[(2, 2)]);
    let mut params = vec![f / r33, f / r33, cx + f * r13 / r33, cy + f * r23 / r33];
    params.extend([0.0; 12]);
    params.extend([tau_x, tau_y]);
    // b sees in direction d what a sees in `tilt * d`.
    (a, camera("opencv14", &params), tilt.inverse())
}

#[test]
fn a_turn_is_recovered_and_no_difference() {
    for (tau_x, tau_y) in [(0.01, 0.0), (0.0, -0.02), (0.05, 0.03), (-0.2, 0.15)] {
        let (a, b, rotation) = turned(tau_x, tau_y);
        let difference = check_symmetry(&a, &b, &CompareOptions::default());
        // Rounding of a projection through two homographies.
        assert!(difference.max_px < 1e-9, "{tau_x} {tau_y}: {}", difference.max_px);
        assert!((difference.b_from_a().rotation.inverse() * rotation).angle() < 1e-12);
        assert_eq!(difference.translation_m, [0.0; 3]);

        let options = CompareOptions { distance_m: Some(2.0), ..CompareOptions::default() };
        let difference = check_symmetry(&a, &b, &options);
        assert!(difference.max_px < 1e-8, "{tau_x} {tau_y}: {}", difference.max_px);
        assert!(Vector3::from(difference.translation_m).norm() < 1e-8);
    }
}

#[test]
fn equal_lenses_of_different_models_do_not_differ() {
    let core = [1100.0, 1102.0, 812.0, 591.0];
    let lens = [-0.12, 0.05, 4e-4, -6e-4, -0.01];
    let five = camera("opencv5", &[&core[..], &lens].concat());
    let eight = camera("opencv8", &[&core[..], &lens, &[0.0; 3]].concat());
    assert!(check_symmetry(&five, &eight, &CompareOptions::default()).max_px < 1e-9);
}

#[test]
fn distortion_is_a_difference() {
    let core = [1100.0, 1100.0, 799.5, 599.5];
    let straight = camera("pinhole", &core);
    let barrel = camera("opencv5", &[&core[..], &[-0.1, 0.0, 0.0, 0.0, 0.0]].concat());
    let difference = check_symmetry(&straight, &barrel, &CompareOptions::default());
    // Symmetric about the axis, so nothing turns; where a ray is at r, b is at r - 0.1 r³.
    assert!(Vector3::from(difference.rotation_rad).norm() < 1e-9, "{:?}", difference.rotation_rad);
    let (pixel, corner) = difference.points().next().unwrap();
    let r = (799.5f64).hypot(599.5) / 1100.0;
    let forth = -0.1 * r.powi(3) * 1100.0;
    let ray = barrel.unproject(pixel).unwrap();
    let back = (ray.xy().norm() / ray.z - r) * 1100.0;
    let [du, dv] = corner.unwrap();
    assert!((du.hypot(dv) - 0.5 * (back - forth)).abs() < 1e-6, "{du} {dv} {forth} {back}");
    // The corner comes nearer to the middle.
    assert!(du > 0.0 && dv > 0.0);
}

#[test]
fn rays_that_are_missing_are_counted() {
    // Folds back at 66 degrees, well inside the image; the other sees all.
    let narrow = camera("kannala-brandt4", &[500.0, 500.0, 780.0, 620.0, -0.3, 0.1, -0.05, 0.01]);
    let wide = camera("kannala-brandt4", &[500.0, 500.0, 780.0, 620.0, 0.0, 0.0, 0.0, 0.0]);
    let difference = check_symmetry(&narrow, &wide, &CompareOptions::default());
    let missing = difference.differences_px.iter().filter(|difference| difference.is_none()).count();
    assert!(missing > 0 && missing == difference.missing && missing < difference.differences_px.len());
    assert_eq!(difference.differences_px[0], None);
}

#[test]
fn a_disagreement_outside_the_focus_leaves_the_transform_alone() {
    let core = [1100.0, 1100.0, 799.5, 599.5];
    let a = camera("pinhole", &core);
    // Grows with the fifth power, off to one side.
    let b = camera("opencv12", &[&core[..], &[0.0; 8], &[0.0, 0.02, 0.0, 0.0]].concat());
    let turn = |focus_radius_px| {
        let options = CompareOptions { focus_radius_px: Some(focus_radius_px), ..CompareOptions::default() };
        Vector3::from(check_symmetry(&a, &b, &options).rotation_rad).norm()
    };
    assert!(turn(200.0) < 0.1 * turn(600.0) && turn(600.0) < 0.7 * turn(1000.0));
}

#[test]
fn mrcal_says_nearly_the_same() {
    let a = camera("opencv5", &[1100.0, 1102.0, 812.0, 591.0, -0.12, 0.05, 4e-4, -6e-4, -0.01]);
    let b = camera("opencv5", &[1103.0, 1102.0, 814.0, 591.0, -0.117, 0.05, 4e-4, -6e-4, -0.01]);
    // mrcal 2.2-4 (Debian 12), projection_diff(gridn_width=60, use_uncertainties=False): distance,
    // focus radius, then rms, maximum, top-left corner and rotation about y.
    let cases = [
        (None, 600.0, 2.127152, 5.952920, [-5.304780, -2.514158], -1.616111e-3),
        (None, 200.0, 2.145353, 6.191564, [-5.530028, -2.561117], -1.763977e-3),
        (Some(0.8), 600.0, 1.074888, 3.195390, [-3.150327, -0.416545], -2.955254e-4),
    ];
    for (distance_m, focus_radius_px, rms_px, max_px, [u, v], yaw_rad) in cases {
        let options = CompareOptions {
            distance_m,
            focus_radius_px: Some(focus_radius_px),
            ..CompareOptions::default()
        };
        let ours = check_symmetry(&a, &b, &options);
        // mrcal fits fourth powers of angles and reports one way only.
        let near = |ours: f64, theirs: f64| (ours / theirs - 1.0).abs() < 0.11;
        assert!(near(ours.rms_px, rms_px) && near(ours.max_px, max_px), "{} {}", ours.rms_px, ours.max_px);
        let [du, dv] = ours.differences_px[0].unwrap();
        assert!((du - u).hypot(dv - v) < 0.2, "{du} {dv}");
        assert!(near(ours.rotation_rad[1], yaw_rad), "{}", ours.rotation_rad[1]);
    }
}

#[test]
fn bad_arguments_are_named() {
    let a = camera("pinhole", &[1000.0, 1000.0, 799.5, 599.5]);
    let message = |b: &Camera, options: CompareOptions| compare(&a, b, &options).unwrap_err().to_string();
    let mut small = a.clone();
    small.image_size = [640, 480];
    let options = CompareOptions::default;
    assert_eq!(message(&small, options()), "the images differ in size: 1600x1200 and 640x480 pixels");
    assert_eq!(
        message(&a, CompareOptions { columns: 1, ..options() }),
        "option `columns` is 1; it must be 2 to 1000"
    );
    assert_eq!(
        message(&a, CompareOptions { distance_m: Some(-1.0), ..options() }),
        "option `distance_m` is -1; it must be positive and finite"
    );
    assert_eq!(
        message(&a, CompareOptions { focus_radius_px: Some(f64::NAN), ..options() }),
        "option `focus_radius_px` is NaN; it must be positive and finite"
    );
    assert_eq!(
        message(&a, CompareOptions { focus_radius_px: Some(20.0), ..options() }),
        "both cameras see 2 of the 2 grid points within 20 px of the image's middle; 6 are needed"
    );
}

#[test]
fn options_and_results_survive_a_file() {
    let options: CompareOptions = serde_json::from_str(r#"{"distance_m": 2.5}"#).unwrap();
    assert_eq!(options, CompareOptions { distance_m: Some(2.5), ..CompareOptions::default() });
    assert!(serde_json::from_str::<CompareOptions>(r#"{"distance": 2.5}"#).is_err());
    let [a, b] = [1000.0, 1003.0].map(|f| camera("pinhole", &[f, f, 799.5, 599.5]));
    let difference = compare(&a, &b, &options).unwrap();
    let text = serde_json::to_string(&difference).unwrap();
    assert_eq!(serde_json::from_str::<Comparison>(&text).unwrap(), difference);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]

    #[test]
    fn recalibrations_are_symmetric(
        core in prop::array::uniform4(-8.0..8.0f64), radial in prop::array::uniform3(-0.02..0.02f64),
        tangential in prop::array::uniform2(-2e-3..2e-3f64), distance in prop::option::of(0.3..20.0f64),
    ) {
        let a = camera("opencv5", &[1100.0, 1102.0, 812.0, 591.0, -0.12, 0.05, 4e-4, -6e-4, -0.01]);
        let changes = [&core[..], &radial[..2], &tangential, &radial[2..]].concat();
        let params: Vec<f64> = a.params.iter().zip(&changes).map(|(param, change)| param + change).collect();
        let b = camera("opencv5", &params);
        let options = CompareOptions { distance_m: distance, columns: 30, ..CompareOptions::default() };
        let difference = check_symmetry(&a, &b, &options);
        prop_assert!(difference.fit_last_step_px < 1e-10, "{} steps", difference.fit_steps);
    }
}
