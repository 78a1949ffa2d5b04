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
        // A few units in the last place of a coordinate near 1000 (1.1e-13), or in proportion.
        assert!(
            error < 2e-15 * pixel[0].hypot(pixel[1]).max(1000.0),
            "{model}: {point:?} at {found:?}, expected {pixel:?}"
        );
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

/// Golden numbers of mrcal 2.2 (`mrcal.project`), where the golden file has none.
#[test]
fn cahvore_matches_mrcal() {
    for (linearity, pupil, pixels) in [
        (
            0.0,
            [0.0, 0.0, 0.0],
            [
                [1150.8924030582825, 369.53039361831634],
                [207.24954305935796, 1022.0517394897611],
                [820.7960320589382, 1126.8188773726956],
                [2275.3018364362392, 199.25081076679635],
            ],
        ),
        (
            0.0,
            [0.005, -0.003, 0.001],
            [
                [1150.9185533476375, 369.5145814100181],
                [207.09892492821757, 1022.163118250509],
                [820.7968958323669, 1126.90151459509],
                [2276.135122237881, 199.0377497561165],
            ],
        ),
        (
            0.37,
            [0.0, 0.0, 0.0],
            [
                [1152.4262361749338, 368.60293586035095],
                [196.52293588318332, 1029.9838271160243],
                [820.8505932520661, 1132.0387478857742],
                [2369.061522194407, 175.2776032918809],
            ],
        ),
        (
            0.37,
            [0.005, -0.003, 0.001],
            [
                [1152.4527446324928, 368.58690707967867],
                [196.36423820263622, 1030.1011805240041],
                [820.8514816736105, 1132.1237431939153],
                [2370.0345444029144, 175.02881338720465],
            ],
        ),
        (
            1.0,
            [0.0, 0.0, 0.0],
            [
                [1162.4971482410833, 362.51339103038305],
                [116.88125816617355, 1088.8770778875335],
                [821.2252423916456, 1167.8814390794098],
                [2330.337322051606, 185.1789087070673],
            ],
        ),
        (
            1.0,
            [0.005, -0.003, 0.001],
            [
                [1162.5260729531037, 362.4959012211796],
                [116.65575242111004, 1089.043834374528],
                [821.2263100281338, 1167.9835798850613],
                [2319.435601396602, 187.96634564206374],
            ],
        ),
        (
            -0.5,
            [0.0, 0.0, 0.0],
            [
                [1149.5013260510486, 370.371531515445],
                [216.79790303350478, 1014.9909394848667],
                [820.746895988449, 1122.118028458453],
                [2195.018742755228, 219.77821810588603],
            ],
        ),
        (
            -0.5,
            [0.005, -0.003, 0.001],
            [
                [1149.5271529705738, 370.3559148381038],
                [216.65435984007183, 1015.0970864864083],
                [820.7477377672631, 1122.1985614555947],
                [2195.72928480537, 219.59654117459127],
            ],
        ),
    ] {
        let points = [[0.3, -0.2, 1.0], [-0.7, 0.5, 1.3], [0.05, 0.9, 2.0], [1.5, -0.4, 0.6]];
        // mrcal 2.2 scales a point to unit length before it projects it, so that its CAHVORE is central.
        let unit = |point: [f64; 3]| <[f64; 3]>::from(Vector3::from(point).normalize());
        let expected: Vec<_> = points.into_iter().map(unit).zip(pixels).collect();
        let params = [&[1250.0, 1245.0, 790.0, 610.0, 0.02, -0.03, -0.01, 0.03, -0.02][..], &pupil].concat();
        check(&format!("cahvore:linearity={linearity:?}"), &params, &expected);
    }
}

/// Golden numbers of mrcal 2.2 (`mrcal.project`) for a spline of order 2, which the golden file lacks.
#[test]
fn splines_of_order_2_match_mrcal() {
    let mut params = vec![1250.0, 1245.0, 790.0, 610.0];
    for y in 0..5 {
        for x in 0..6 {
            let (x, y) = (f64::from(x), f64::from(y));
            params.extend([0.01 * (x - 2.0) * (y - 1.0), 0.02 * (x - y) - 0.003 * x * y]);
        }
    }
    check(
        "splined2:6x5:100deg",
        &params,
        &[
            ([0.3, -0.2, 1.0], [1161.7514784863733, 388.45637982897983]),
            ([-0.7, 0.5, 1.3], [165.82869714937715, 998.2205125619575]),
            ([0.05, 0.6, 2.0], [831.8244021862067, 948.4176761141822]),
            ([0.5, -0.4, 0.6], [1632.0946088547507, 1.010338495278802]),
            ([-0.5, -0.4, 1.6], [412.99708610475534, 309.2619335608122]),
        ],
    );
}

/// Golden numbers of the published formulas in 50-digit arithmetic (Python's `decimal`).
#[test]
fn sphere_and_division_models_match_their_formulas() {
    let points = [[0.3, -0.2, 1.0], [-0.7, 0.5, 0.3], [0.9, 0.3, -0.2]];
    type Golden<'a> = (&'a str, &'a [f64], [[f64; 2]; 3]);
    let golden: [Golden<'_>; 4] = [
        (
            "eucm",
            &[0.6, 1.1],
            [
                [910.2220781883553, 527.8012076138019],
                [389.4811711849815, 896.104587827924],
                [1475.614867744215, 833.005980694312],
            ],
        ),
        (
            "double-sphere",
            &[-0.2, 0.59],
            [
                [938.9218551881524, 508.57235702393785],
                [295.5062996725188, 963.5651205922276],
                [1604.8028133741661, 876.2839424803457],
            ],
        ),
        (
            "mei",
            &[1.2, -0.05, 0.01, 0.001, -0.0005],
            [
                [847.6458392958361, 569.7340155731796],
                [597.248450273792, 747.0558798675431],
                [1153.7474465881844, 725.6351346006669],
            ],
        ),
        (
            "division",
            &[-0.3],
            [
                [910.6529299342292, 527.5125369440665],
                [360.53407419435814, 916.8844681676215],
                [1633.8670162838907, 886.0204504551034],
            ],
        ),
    ];
    for (model, lens, pixels) in golden {
        let expected: Vec<_> = points.into_iter().zip(pixels).collect();
        check(model, &[&[400.0, 402.0, 795.0, 605.0], lens].concat(), &expected);
    }
}

/// The models of the golden file, in its order, by our names.
const MRCAL_MODELS: [(usize, &str); 11] = [
    (0, "pinhole"),
    (1, "stereographic"),
    (2, "lonlat"),
    (3, "latlon"),
    (4, "opencv4"),
    (5, "opencv5"),
    (6, "opencv8"),
    (7, "opencv12"),
    (8, "cahvor"),
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
        let [pixels, by_point, by_param] =
            ["q", "dq_dp", "dq_di"].map(|array| read(&mut archive, &format!("{i}_{array}")));
        // The file has no rays of CAHVOR.
        let rays = (name != "cahvor").then(|| read(&mut archive, &format!("{i}_v")));
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
            if let Some(rays) = &rays {
                let expected = Vector3::from_row_slice(&rays[3 * j..3 * j + 3]).normalize();
                // mrcal's unprojection iterates to about 1e-8.
                assert!((ray - expected).norm() < 1e-7, "{name} {j}: {ray} {expected}");
            }
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
