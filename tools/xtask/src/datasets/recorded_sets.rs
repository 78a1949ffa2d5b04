//! The recorded sets beside the project: what is in them, and what is to be made of it.

/// A recorded set that can be calibrated.
#[derive(Clone, Copy, Debug)]
pub(super) struct Set {
    /// The row's name.
    pub name: &'static str,
    /// Its folder.
    pub folder: &'static str,
    /// The images or the corner file within the folder, as the command line takes them.
    pub inputs: &'static [&'static str],
    /// The target, as the command line takes it. Where the size of the squares is not known it is 30 mm.
    pub target: &'static str,
    /// Whether OpenCV is to find a chessboard or a ChArUco board, or is left out.
    pub kind: &'static str,
    /// The corners of the board across and down.
    pub size: [u32; 2],
    /// The images of each camera within the folder, for OpenCV; none takes the corner file.
    pub images: &'static [&'static str],
    /// The size of the images, where there are corners only.
    pub image_size: Option<[u32; 2]>,
    /// A regular expression over the files' names with the groups `frame` and, for several cameras, `camera`.
    pub pattern: &'static str,
    /// The corners that mrcal gets, within the folder, and their lens, mrcal's name and ours.
    pub mrcal: Option<(&'static str, [&'static str; 2])>,
}

const OPENCV5: [&str; 2] = ["LENSMODEL_OPENCV5", "opencv5"];
const OPENCV8: [&str; 2] = ["LENSMODEL_OPENCV8", "opencv8"];

const PLAIN: Set = Set {
    name: "",
    folder: "",
    inputs: &[],
    target: "",
    kind: "chessboard",
    size: [0, 0],
    images: &[],
    image_size: None,
    pattern: r"(?P<frame>[^/]+)\.\w+$",
    mrcal: None,
};

/// All sets with a target of which views are recorded.
pub(super) const SETS: &[Set] = &[
    Set {
        name: "mono-lifecam, 640x480",
        folder: "mono-lifecam-photonvision",
        inputs: &["raw/640x480"],
        target: "chessboard:10x10:25.4mm",
        size: [10, 10],
        images: &["raw/640x480/*"],
        image_size: Some([640, 480]),
        mrcal: Some(("derived/640x480/corners-opencv.vnl", OPENCV5)),
        ..PLAIN
    },
    Set {
        name: "mono-lifecam, 1280x720",
        folder: "mono-lifecam-photonvision",
        inputs: &["raw/1280x720"],
        target: "chessboard:10x10:25.4mm",
        size: [10, 10],
        images: &["raw/1280x720/*"],
        image_size: Some([1280, 720]),
        mrcal: Some(("derived/1280x720/corners-opencv.vnl", OPENCV5)),
        ..PLAIN
    },
    Set {
        name: "charuco-lifecam, 640x480",
        folder: "charuco-lifecam-photonvision",
        inputs: &["raw/640x480"],
        target: "charuco:8x8:25.4mm:19.05mm:4x4_1000",
        kind: "charuco",
        size: [7, 7],
        images: &["raw/640x480/*"],
        image_size: Some([640, 480]),
        mrcal: Some(("derived/640x480/corners-opencv.vnl", OPENCV5)),
        ..PLAIN
    },
    Set {
        name: "charuco-lifecam, 1280x720",
        folder: "charuco-lifecam-photonvision",
        inputs: &["raw/1280x720"],
        target: "charuco:8x8:25.4mm:19.05mm:4x4_1000",
        kind: "charuco",
        size: [7, 7],
        images: &["raw/1280x720/*"],
        image_size: Some([1280, 720]),
        mrcal: Some(("derived/1280x720/corners-opencv.vnl", OPENCV5)),
        ..PLAIN
    },
    Set {
        name: "mono-udacity",
        folder: "mono-udacity-camera-cal",
        inputs: &["raw"],
        target: "chessboard:9x6:30mm",
        size: [9, 6],
        images: &["raw/*"],
        image_size: Some([1280, 720]),
        mrcal: Some(("derived/corners-opencv.vnl", OPENCV5)),
        ..PLAIN
    },
    Set {
        name: "wide-udacity-gopro",
        folder: "wide-udacity-gopro",
        inputs: &["raw/GOPR*.jpg"],
        target: "chessboard:8x6:30mm",
        size: [8, 6],
        images: &["raw/GOPR*"],
        image_size: Some([1280, 960]),
        mrcal: Some(("derived/corners-opencv.vnl", OPENCV8)),
        ..PLAIN
    },
    Set {
        name: "stereo-bumblebee2",
        folder: "stereo-bumblebee2-boofcv",
        inputs: &["raw"],
        target: "chessboard:4x6:30mm",
        size: [4, 6],
        images: &["raw/left*", "raw/right*"],
        image_size: Some([640, 480]),
        pattern: r"(?P<camera>left|right)(?P<frame>\d+)",
        mrcal: Some(("derived/corners-opencv.vnl", OPENCV5)),
        ..PLAIN
    },
    Set {
        name: "stereo-opencv",
        folder: "stereo-opencv-left-right",
        inputs: &["raw/left??.jpg", "raw/right??.jpg"],
        target: "chessboard:9x6:25mm",
        size: [9, 6],
        images: &["raw/left??.jpg", "raw/right??.jpg"],
        image_size: Some([640, 480]),
        pattern: r"(?P<camera>left|right)(?P<frame>\d+)",
        mrcal: Some(("derived/corners-opencv.vnl", OPENCV5)),
        ..PLAIN
    },
    Set {
        name: "fisheye-theta",
        folder: "fisheye-theta-boofcv",
        inputs: &["raw"],
        target: "chessboard:4x6:30mm",
        size: [4, 6],
        images: &["raw/*"],
        ..PLAIN
    },
    Set {
        name: "fisheye-stereopi",
        folder: "fisheye-stereo-stereopi",
        inputs: &["raw"],
        target: "chessboard:9x6:25mm",
        size: [9, 6],
        images: &["raw/left_*", "raw/right_*"],
        image_size: Some([640, 480]),
        pattern: r"(?P<camera>left|right)_(?P<frame>\d+)",
        mrcal: Some(("derived/corners-opencv.vnl", OPENCV8)),
        ..PLAIN
    },
    Set {
        name: "handeye-franka, in hand",
        folder: "handeye-franka-visp",
        inputs: &["raw/eye-in-hand"],
        target: "chessboard:9x6:23.6mm",
        size: [9, 6],
        images: &["raw/eye-in-hand/*"],
        image_size: Some([640, 480]),
        mrcal: Some(("derived/corners-opencv.vnl", OPENCV5)),
        ..PLAIN
    },
    Set {
        name: "handeye-kuka1, 6 images",
        folder: "handeye-kuka1-rwhe",
        inputs: &["raw/gray"],
        target: "chessboard:28x17:20mm",
        size: [28, 17],
        images: &["raw/gray/*"],
        ..PLAIN
    },
    Set {
        name: "handeye-kuka1, 30 views of corners",
        folder: "handeye-kuka1-rwhe",
        inputs: &["derived/corners-opencv.vnl"],
        target: "chessboard:28x17:20mm",
        size: [28, 17],
        image_size: Some([1928, 1208]),
        mrcal: Some(("derived/corners-opencv.vnl", OPENCV5)),
        ..PLAIN
    },
    Set {
        name: "rig3-trinocular",
        folder: "rig3-trinocular-boofcv",
        inputs: &["raw/left", "raw/middle", "raw/right"],
        target: "chessboard:13x9:30mm",
        size: [13, 9],
        images: &["raw/left/*", "raw/middle/*", "raw/right/*"],
        image_size: Some([1224, 1024]),
        pattern: r"(?P<camera>left|middle|right)/[a-z]*(?P<frame>\d+)",
        mrcal: Some(("derived/corners-opencv.vnl", OPENCV5)),
        ..PLAIN
    },
    Set {
        name: "rig4-caliscope, corners",
        folder: "rig4-caliscope-4cam",
        inputs: &["derived/corners-opencv.vnl"],
        target: "chessboard:3x4:54mm",
        size: [3, 4],
        image_size: Some([1280, 720]),
        pattern: r"frame(?P<frame>\d+)-(?P<camera>cam\d)",
        mrcal: Some(("derived/corners-opencv.vnl", OPENCV5)),
        ..PLAIN
    },
    Set {
        name: "corners-picam, images",
        folder: "corners-picam-photonvision",
        inputs: &["raw/640x480"],
        target: "chessboard:7x7:25.4mm",
        size: [7, 7],
        images: &["raw/640x480/*"],
        image_size: Some([640, 480]),
        mrcal: Some(("derived/640x480/corners-opencv.vnl", OPENCV5)),
        ..PLAIN
    },
    Set {
        name: "corners-picam, 960x720 corners",
        folder: "corners-picam-photonvision",
        inputs: &["raw/960x720_corners_only/corners.vnl"],
        target: "chessboard:7x7:25.4mm",
        size: [7, 7],
        image_size: Some([960, 720]),
        mrcal: Some(("raw/960x720_corners_only/corners.vnl", OPENCV5)),
        ..PLAIN
    },
    Set {
        name: "corners-stereo-drcal",
        folder: "corners-stereo-drcal",
        inputs: &["raw/corners.vnl"],
        target: "chessboard:13x8:40mm",
        size: [13, 8],
        image_size: Some([1280, 800]),
        pattern: r"(?P<frame>\d+)_(?P<camera>\d+)",
        mrcal: Some(("raw/corners.vnl", OPENCV8)),
        ..PLAIN
    },
    Set {
        name: "corners-mrcal-figueroa",
        folder: "corners-mrcal-figueroa",
        inputs: &["derived/observations-opencv8.vnl"],
        target: "chessboard:10x10:77mm",
        size: [10, 10],
        image_size: Some([6016, 4016]),
        mrcal: Some(("derived/observations-opencv8.vnl", OPENCV8)),
        ..PLAIN
    },
    Set {
        name: "corners-mrcal-photonvision2023",
        folder: "corners-mrcal-photonvision2023",
        inputs: &["raw/corners.vnl"],
        target: "chessboard:10x10:58.8mm",
        size: [10, 10],
        image_size: Some([1280, 720]),
        mrcal: Some(("raw/corners.vnl", OPENCV8)),
        ..PLAIN
    },
    Set {
        name: "aprilgrid-samples, EuRoC",
        folder: "aprilgrid-samples",
        inputs: &["raw/EuRoC.png"],
        target: "aprilgrid:6x6:88mm:26.4mm:36h11",
        kind: "",
        ..PLAIN
    },
    Set {
        name: "aprilgrid-samples, TUM-VI",
        folder: "aprilgrid-samples",
        inputs: &["raw/TUM_VI.png"],
        target: "aprilgrid:6x6:88mm:26.4mm:36h11",
        kind: "",
        ..PLAIN
    },
];

/// The sets, or parts of them, that `calibrate` has nothing to do with, and why.
pub(super) const OTHERS: &[(&str, &str)] = &[
    ("ba-small", "scenes without a target: points of unknown places, for bundle adjusters"),
    ("handeye-franka, to hand", "one tag on the flange, four corners a view: `cargo xtask hand-eye` has it"),
    ("handeye-poses-ethz", "poses instead of pixels: `cargo xtask hand-eye` has it"),
    ("planar-khepera", "wheels and a laser scanner instead of a camera: `robot planar`, see docs/robot.md"),
    (
        "rig3-apriltag-braid",
        "one view a camera of tags surveyed by hand, to 3 px and more; a lens is not estimated from one view",
    ),
    ("robot-positioner-kinematic", "poses instead of pixels: `cargo xtask hand-eye` has it"),
    ("rig4-caliscope, videos", "MP4 is not read; its corners are above"),
];
