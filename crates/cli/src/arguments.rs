//! What the command line takes.

use std::path::PathBuf;

use boresight::{
    HoldChoice, HoldoutChoice, LensChoice, LineDelayChoice, LossChoice, Model, RegularizationChoice,
    RejectChoice, ShapeChoice, Target, TimeOffsetChoice,
};
use clap::{Args, Parser, Subcommand, ValueEnum};

use crate::demo::DemoArguments;
use crate::doctor::DoctorArguments;
use crate::init::InitArguments;
use crate::inputs::{CameraImages, ClockChoice, ImageSize, Time};
use crate::robot::RobotCommand;
use crate::stereo::StereoArguments;
use crate::target::TargetCommand;

/// Calibrates cameras: lenses, where they sit, and how well all of that is known.
#[derive(Debug, Parser)]
#[command(name = "boresight", version, max_term_width = 100, disable_help_subcommand = true)]
#[command(after_help = "Exit codes: 0 good; 1 written, but the verdict or a comparison failed; 2 usage or \
    configuration; 3 input unusable; 4 solve failed, diagnostics written; 5 cannot write; 130 stopped by Ctrl-C.\n\
    stdout is the answer only; progress, findings and errors go to stderr.")]
pub(crate) struct Arguments {
    #[command(subcommand)]
    pub command: Command,
}

#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// Calibrate a camera, a stereo pair or a rig from images of a target, or from its corners
    Calibrate(CalibrateArguments),
    /// Detect a target in images: corners as a table, and overlays to look at
    Detect(DetectArguments),
    /// Tell what is wrong with images, a recording or corners, before any solve
    Doctor(DoctorArguments),
    /// Look at images, a recording or corners, and write a job file that says what the command line says
    Init(InitArguments),
    /// Make targets
    Target {
        #[command(subcommand)]
        command: TargetCommand,
    },
    /// Render a stereo recording with known truth, calibrate it, and compare
    Demo(DemoArguments),
    /// Tell what is in a dataset or a calibration
    Info(InfoArguments),
    /// Print the matrices P, M and H = P*M of each camera
    Matrix(MatrixArguments),
    /// Tell how far two calibrations differ, in pixels over the image and between cameras
    Compare(CompareArguments),
    /// Tell how well a calibration's pixels, rays and distances are known
    Uncertainty(UncertaintyArguments),
    /// Calibrate odd and even frames apart, and tell whether they differ by more than noise explains
    Validate(ValidateArguments),
    /// Judge a calibration on other data, without estimating lenses or rig anew
    Verify(VerifyArguments),
    /// Fit another lens model to each camera and tell the error in pixels
    Convert(ConvertArguments),
    /// Write a calibration in the format of another program
    Export(ExportArguments),
    /// Project points (x y z in metres, one per line of stdin) to pixels (u v)
    Project(ProjectArguments),
    /// Turn pixels (u v, one per line of stdin) into unit directions (x y z)
    Unproject(ProjectArguments),
    /// Find points (x y z with sigmas, in metres) from the pixels of two or more cameras, one line of stdin each
    #[command(visible_alias = "triangulate")]
    Stereo(StereoArguments),
    /// Relate camera and robot
    Robot {
        #[command(subcommand)]
        command: RobotCommand,
    },
    /// Explain a finding's code, or list all codes
    Explain {
        /// The code, such as few-views; none lists all
        code: Option<String>,
    },
    /// Print a completion script for a shell
    Completions {
        /// The shell
        shell: clap_complete::Shell,
    },
}

/// Images or corners, and what a job file would say about them.
#[derive(Args, Debug)]
pub(crate) struct InputArguments {
    /// Images, folders of images or patterns; MCAP recordings; or a folder with a boresight.toml, a job file, or corner files (.csv, .vnl)
    #[arg(value_name = "INPUT", required_unless_present = "config")]
    pub inputs: Vec<PathBuf>,
    /// The job file, for corner files that lie elsewhere
    #[arg(short, long, value_name = "JOB.toml")]
    pub config: Option<PathBuf>,
    /// The target, such as chessboard:9x6:25mm (inner corners, spacing)
    #[arg(long, value_name = "SPEC", value_parser = crate::inputs::parse_target)]
    pub target: Option<Target>,
    /// Width and height of the images in pixels, of all cameras or of one; may be repeated
    #[arg(long, value_name = "WxH or NAME=WxH")]
    pub image_size: Vec<ImageSize>,
    /// Which images a camera took, such as left='left*.png', or which topic is its own; may be repeated
    /// [default: told by folders, names and topics]
    #[arg(long, value_name = "NAME=PATTERN")]
    pub camera: Vec<CameraImages>,
    /// Which times of a recording are believed [default: header]
    #[arg(long, value_name = "header|log")]
    pub clock: Option<ClockChoice>,
    /// How far apart in time images of a recording are of one frame, such as 5ms [default: a quarter of the time from
    /// image to image, 15ms at most]
    #[arg(long, value_name = "TIME")]
    pub sync_tolerance: Option<Time>,
}

#[derive(Args, Debug)]
pub(crate) struct DetectArguments {
    #[command(flatten)]
    pub input: InputArguments,
    /// The file for the corners; without it they are printed
    #[arg(short, long, value_name = "CORNERS.csv")]
    pub output: Option<PathBuf>,
    /// The folder for a copy of each image with its corners marked; made if it does not exist
    #[arg(long, value_name = "DIR")]
    pub overlays: Option<PathBuf>,
}

#[derive(Args, Debug)]
pub(crate) struct CalibrateArguments {
    #[command(flatten)]
    pub input: InputArguments,
    /// The lens model: pinhole, opencv4, 5, 8, 12 or 14, kannala-brandt4, double-sphere, eucm, mei, division,
    /// stereographic, cahvor, splined2, splined3 and others; auto chooses one for each camera by what it
    /// predicts; cameras may have their own, as in opencv5,right=eucm [default: opencv5]
    #[arg(long, value_name = "NAME")]
    pub model: Option<LensChoice>,
    /// How the target may depart from flat: none, 2 coefficients (a bend along each side), 6 (a twist and higher bends
    /// too), or auto: as many as help to predict views that took no part [default: 2]
    #[arg(long, value_name = "none|2|6|auto")]
    pub shape: Option<ShapeChoice>,
    /// What keeps weakly constrained lens parameters in bounds: none, default or mrcal-2.2
    #[arg(long, value_name = "KIND")]
    pub regularization: Option<RegularizationChoice>,
    /// What large residuals cost: none (their square), or cauchy:PX [default: none]
    #[arg(long, value_name = "LOSS")]
    pub loss: Option<LossChoice>,
    /// Reject corners beyond this many sigmas, or none [default: 4]
    #[arg(long, value_name = "SIGMAS|none")]
    pub reject: Option<RejectChoice>,
    /// Parts into which the frames are cut and left out in turn, to test predictions: off, auto or a number [default: auto]
    #[arg(long, value_name = "K")]
    pub holdout: Option<HoldoutChoice>,
    /// Do not estimate this: lens, pose or a lens parameter such as k3, of all cameras or as lens:NAME; shape
    #[arg(long, value_name = "WHAT[:CAMERA],...", value_delimiter = ',')]
    pub hold: Vec<HoldChoice>,
    /// Believe the lenses and poses of an earlier calibration, made from other views, as far as their sigmas say
    #[arg(long, value_name = "FILE")]
    pub prior: Option<PathBuf>,
    /// Let cameras share one lens, such as a camera that moves; may be repeated
    #[arg(long, value_name = "NAME+NAME")]
    pub share_lens: Vec<String>,
    /// What becomes of cameras that took their images of a frame at different times while the target moved: hold (it is told)
    /// or solve (it is estimated) [default: hold]
    #[arg(long, value_name = "hold|solve")]
    pub time_offset: Option<TimeOffsetChoice>,
    /// What becomes of cameras that take their rows one after another while the target moves: hold (it is told), solve (it is
    /// estimated), or the seconds from row to row; after it those of single cameras, as in solve,right=0 [default: hold]
    #[arg(long, value_name = "hold|solve|SECONDS", allow_hyphen_values = true)]
    pub line_delay: Option<LineDelayChoice>,
    /// Calibrate these cameras only
    #[arg(long, value_name = "NAME,...", value_delimiter = ',')]
    pub cameras: Vec<String>,
    /// The number of threads; 0 takes one per core. It does not change the result [default: 0]
    #[arg(long, value_name = "N")]
    pub jobs: Option<usize>,
    /// The folder for the results; made if it does not exist
    #[arg(short, long, value_name = "DIR", default_value = "out")]
    pub output: PathBuf,
    /// Print calibration.json on stdout instead of the summary
    #[arg(long)]
    pub json: bool,
}

#[derive(Args, Debug)]
pub(crate) struct InfoArguments {
    #[command(flatten)]
    pub input: InputArguments,
}

#[derive(Args, Debug)]
pub(crate) struct MatrixArguments {
    /// A calibration.json, or the folder it is in
    pub result: PathBuf,
    /// How to print the matrices; npy holds H of all cameras, [camera, 3, 4]
    #[arg(long, value_enum, default_value_t = MatrixFormat::Text)]
    pub format: MatrixFormat,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum MatrixFormat {
    Text,
    Json,
    Npy,
}

#[derive(Args, Debug)]
pub(crate) struct CompareArguments {
    /// A calibration.json or its folder, a .cameramodel, an OpenCV .yml, or a folder of .cameramodel files
    pub a: PathBuf,
    /// Another; cameras are paired by name, or by order where no name is common
    pub b: PathBuf,
    /// Compare points at this distance in metres, after a pose fitted there; else at infinity
    #[arg(long, value_name = "D")]
    pub distance_m: Option<f64>,
    /// Exit with 1 if the RMS difference of any camera is above this many pixels
    #[arg(long, value_name = "PX")]
    pub limit_px: Option<f64>,
    /// Print one JSON document, the difference at each grid point included
    #[arg(long)]
    pub json: bool,
}

#[derive(Args, Debug)]
pub(crate) struct ConvertArguments {
    /// A calibration.json, or the folder it is in
    pub result: PathBuf,
    /// The lens model to fit, such as opencv8, double-sphere or splined3:30x20:120deg
    #[arg(long, value_name = "NAME")]
    pub model: Model,
    /// The folder for the calibration.json with the new lenses; made if it does not exist
    #[arg(short, long, value_name = "DIR")]
    pub output: Option<PathBuf>,
    /// Whether a camera may turn a little as its lens changes; its pose turns with it
    #[arg(long, value_enum, default_value_t = Rotation::Fit)]
    pub rotation: Rotation,
    /// Exit with 1 if the largest error of any camera is above this many pixels
    #[arg(long, value_name = "PX")]
    pub limit_px: Option<f64>,
    /// Print one JSON document
    #[arg(long)]
    pub json: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Rotation {
    /// Fitted, as models differ in how they share it with their centre
    Fit,
    /// The camera keeps its orientation
    Keep,
}

#[derive(Args, Debug)]
pub(crate) struct ExportArguments {
    /// A calibration.json, or the folder it is in
    pub result: PathBuf,
    /// The format: json, opencv, cameramodel, kalibr, ros, mcap, h-matrix, h-matrix-json or h-matrix-npy
    #[arg(long, value_name = "FORMAT")]
    pub to: String,
    /// The folder for the files; made if it does not exist
    #[arg(short, long, value_name = "DIR")]
    pub output: PathBuf,
}

#[derive(Args, Debug)]
pub(crate) struct ProjectArguments {
    /// A calibration.json or its folder, a .cameramodel or an OpenCV .yml
    pub result: PathBuf,
    /// The camera; may be left out where there is only one
    #[arg(long, value_name = "NAME")]
    pub camera: Option<String>,
    /// The frame of the points or directions
    #[arg(long, value_enum, default_value_t = PointFrame::Camera)]
    pub frame: PointFrame,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum PointFrame {
    /// The camera's own: x right, y down, z forward
    Camera,
    /// The rig's: that of its reference camera
    Rig,
}

#[derive(Args, Debug)]
pub(crate) struct UncertaintyArguments {
    /// A calibration.json, or the folder it is in
    pub result: PathBuf,
    /// Of these cameras only
    #[arg(long, value_name = "NAME,...", value_delimiter = ',')]
    pub camera: Vec<String>,
    /// At these distances in metres; inf is infinity [default: 0.5,1,3,10,inf]
    #[arg(long, value_name = "D,...", value_delimiter = ',')]
    pub distance_m: Vec<f64>,
    /// Grid points across and down the image
    #[arg(long, value_name = "CxR", default_value = "60x40")]
    pub grid: GridSize,
    /// How a motion of all targets is taken out
    #[arg(long, value_enum, default_value_t = UncertaintyMethod::CrossReprojection)]
    pub method: UncertaintyMethod,
    /// Pass on the noise of observations only, as mrcal does, and take the regularisation for granted
    #[arg(long)]
    pub observations_only: bool,
    /// How to print; json has the maps
    #[arg(long, value_enum, default_value_t = AnswerFormat::Text)]
    pub format: AnswerFormat,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum UncertaintyMethod {
    /// The motion that explains best how the camera's own corners move
    CrossReprojection,
    /// The mean motion of all frames
    MeanFrame,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum AnswerFormat {
    Text,
    Json,
}

/// Grid points across and down.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct GridSize(pub [usize; 2]);

impl std::str::FromStr for GridSize {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let sides: Vec<Option<usize>> = text.split('x').map(|side| side.parse().ok()).collect();
        match sides[..] {
            [Some(columns), Some(rows)] => Ok(Self([columns, rows])),
            _ => Err("write columns x rows, such as 60x40".to_owned()),
        }
    }
}

#[derive(Args, Debug)]
pub(crate) struct VerifyArguments {
    /// A calibration.json, or the folder it is in
    pub result: PathBuf,
    #[command(flatten)]
    pub input: InputArguments,
    /// Exit with 1 if the error per degree of freedom is above so many times that of the calibration
    #[arg(long, value_name = "TIMES", default_value_t = 1.5)]
    pub limit_ratio: f64,
    /// How to print
    #[arg(long, value_enum, default_value_t = AnswerFormat::Text)]
    pub format: AnswerFormat,
}

#[derive(Args, Debug)]
pub(crate) struct ValidateArguments {
    #[command(flatten)]
    pub input: InputArguments,
    /// The lens model, if not that of the job file
    #[arg(long, value_name = "NAME")]
    pub model: Option<LensChoice>,
    /// Compare points at this distance in metres, after a pose fitted there; else at infinity
    #[arg(long, value_name = "D")]
    pub distance_m: Option<f64>,
    /// Exit with 1 if any camera's halves differ by more than so many times what noise explains
    #[arg(long, value_name = "TIMES", default_value_t = 3.0)]
    pub limit_ratio: f64,
    /// How to print; json has the difference at each grid point
    #[arg(long, value_enum, default_value_t = AnswerFormat::Text)]
    pub format: AnswerFormat,
}
