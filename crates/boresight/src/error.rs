//! What can keep a job from being calibrated, and who has to act.

use boresight_io::Place;

/// Who has to act on an error; the command line maps it to its exit codes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ErrorKind {
    /// The command line or the job file asks for something that cannot be.
    Usage,
    /// The input cannot be used.
    Input,
    /// The solve failed.
    Solve,
    /// A result cannot be written.
    CannotWrite,
}

/// Why a job was not calibrated.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A file cannot be read or written, or says something that cannot be.
    #[error(transparent)]
    Io(#[from] boresight_io::Error),
    /// The job file's `[options]` say something that cannot be.
    #[error("{place}: [options]: {message}")]
    Options {
        /// Where the options begin.
        place: Place,
        /// What is wrong with them.
        message: String,
    },
    /// A camera is asked for that the input does not have.
    #[error("there is no camera `{name}`; known: {}", known.join(", "))]
    UnknownCamera {
        /// The name.
        name: String,
        /// The cameras there are.
        known: Vec<String>,
    },
    /// An earlier calibration says nothing that can be used.
    #[error("option prior: {path} cannot be used as a prior: {why}")]
    NoPrior {
        /// The file.
        path: String,
        /// What is missing.
        why: String,
    },
    /// Something is to be held that nothing tells.
    #[error("option hold: {what} of camera {camera} cannot be held: nothing says where it is")]
    NothingToHold {
        /// The camera's name.
        camera: String,
        /// What is to be held.
        what: String,
    },
    /// A lens parameter is to be held that the lens does not have.
    #[error("option hold: camera {camera} ({model}) has no parameter {what}")]
    NoParameter {
        /// The camera's name.
        camera: String,
        /// Its lens model.
        model: String,
        /// What is to be held.
        what: String,
        /// The parameters that it has.
        known: Vec<&'static str>,
    },
    /// The regularisation is that of a tool whose targets have another shape.
    #[error(
        "option shape: mrcal-2.2 knows two coefficients, and its rows with {coefficients} would not be its problem"
    )]
    ShapeNotMrcals {
        /// The number of shape coefficients asked for.
        coefficients: usize,
    },
    /// Cameras are to share a lens and cannot.
    #[error("option share_lens: cameras {} and {} cannot share a lens: {why}", cameras[0], cameras[1])]
    LensesApart {
        /// The names of two of them.
        cameras: [String; 2],
        /// Why not.
        why: String,
    },
    /// A line delay is asked for or stated, and nothing is known to move.
    #[error(
        "option line_delay: rows of camera {camera} cannot have times of their own: {timed} of {frames} frames have times, \
         and the target's motion is known in {moving} views of the camera, where {need} are needed"
    )]
    NoMotion {
        /// The camera's name.
        camera: String,
        /// The frames that have times.
        timed: usize,
        /// All frames.
        frames: usize,
        /// The views of the camera whose neighbours in time tell how the target moved.
        moving: usize,
        /// How many are needed.
        need: usize,
    },
    /// A line delay is asked for, and the target moves too little to tell it.
    #[error(
        "option line_delay: the target moves too little before camera {camera} to tell its line delay: {}, and {limit_ms} ms \
         is the limit",
        readout_known_to(*readout_sigma_ms)
    )]
    SlowMotion {
        /// The camera's name.
        camera: String,
        /// The sigma of the time from first to last row, in milliseconds; `None` if nothing tells it.
        readout_sigma_ms: Option<f64>,
        /// What it may be.
        limit_ms: f64,
    },
    /// The caller stopped it.
    #[error("the work was stopped")]
    Cancelled,
    /// The target's pose could be found in no frame.
    #[error("the target's pose could be found in none of the {views} views")]
    NothingPlaced {
        /// The number of views.
        views: usize,
    },
    /// No start could be found.
    #[error("{0}")]
    Seed(#[from] boresight_seed::Error),
    /// No lens model will do.
    #[error(transparent)]
    NoLens(#[from] crate::lens_choice::NoLens),
    /// A camera has a lens without a centre of projection, which cannot be calibrated.
    #[error(
        "camera {camera}: lens model {model} cannot be calibrated: its centre of projection moves with the angle, so that lens and poses are not told apart"
    )]
    Noncentral {
        /// The camera's name.
        camera: String,
        /// Its lens model.
        model: &'static str,
    },
    /// The adjustment failed.
    #[error("{0}")]
    Adjust(#[from] boresight_adjust::Error),
    /// Two calibrations cannot be compared.
    #[error("{}", with_sources(.0))]
    Compare(#[from] boresight_validate::Error),
    /// The job has no table of robot poses.
    #[error("the job has no table of robot poses")]
    NoRobotPoses,
    /// The robot's motions do not determine what is sought.
    #[error("[{}] {}", .0.code, .0.message)]
    Degenerate(Box<boresight_data::Finding>),
    /// Rows of the table of poses are no poses in the stated convention.
    #[error("the rows of the table are no poses read as {convention}")]
    UnreadablePoses {
        /// The convention.
        convention: boresight_data::PoseConvention,
        /// Which convention fits, if one does.
        finding: Option<Box<boresight_data::Finding>>,
    },
    /// No adjustment begins from where the robot's poses put the cameras.
    #[error("the robot's poses do not go with what the cameras saw: {why}")]
    PosesMisfit {
        /// What the adjustment says.
        why: boresight_adjust::Error,
        /// Which reading of the poses fits better, if one does.
        finding: Option<Box<boresight_data::Finding>>,
    },
    /// The robot's poses are those of a mirror image of the cell.
    #[error("the robot's poses go with what camera {camera} saw only if the camera is mirrored")]
    MirroredPoses {
        /// The camera's name.
        camera: String,
    },
    /// No closed form places rig and target on the robot.
    #[error("no closed form places camera and target on the robot from {poses} poses")]
    NoClosedForm {
        /// The number of poses.
        poses: usize,
    },
    /// A camera's lens cannot be exchanged for another.
    #[error("camera {camera}: {source}")]
    Convert {
        /// The camera's name.
        camera: String,
        /// Why not.
        source: boresight_seed::ConvertError,
    },
    /// A camera's parameters are none of its lens model.
    #[error(transparent)]
    Camera(#[from] boresight_camera::Error),
    /// Poses of the robot and sights of the target cannot be paired.
    #[error("there are {poses} rows of the robot and {sights} sights, and not all have a time")]
    Unpaired {
        /// The rows of the robot.
        poses: usize,
        /// The sights.
        sights: usize,
    },
    /// Readings of joints and sights of the target cannot be paired.
    #[error("there are {readings} rows of joints and {sights} sights; they are paired row by row")]
    UnpairedJoints {
        /// The rows of joints.
        readings: usize,
        /// The sights.
        sights: usize,
    },
    /// The rows of a robot that moved belong to no frames until clocks are set.
    #[error("the robot moved (frame_times), so that its rows belong to no frames until the clocks are set")]
    MovingRobot,
    /// Poses that were seen do not determine what is sought.
    #[error("{0}")]
    PoseFit(#[from] boresight_adjust::PoseFitError),
    /// The lines of a positioner's joints cannot be found.
    #[error("{0}")]
    Joints(#[from] boresight_seed::JointError),
    /// A robot command has no answer.
    #[error(transparent)]
    Robot(#[from] crate::robot_error::RobotError),
}

fn readout_known_to(sigma_ms: Option<f64>) -> String {
    match sigma_ms {
        Some(sigma_ms) => {
            format!("the time from the first row to the last would be known to {sigma_ms:.1} ms")
        }
        None => "nothing would be known of the time from the first row to the last".to_owned(),
    }
}

impl Error {
    /// Returns who has to act.
    pub fn kind(&self) -> ErrorKind {
        match self {
            Error::Io(error) => match error.kind() {
                boresight_io::Kind::Usage => ErrorKind::Usage,
                boresight_io::Kind::Input => ErrorKind::Input,
                boresight_io::Kind::CannotWrite => ErrorKind::CannotWrite,
            },
            Error::Robot(error) => error.kind(),
            Error::Options { .. }
            | Error::UnknownCamera { .. }
            | Error::NoPrior { .. }
            | Error::NothingToHold { .. }
            | Error::NoParameter { .. }
            | Error::LensesApart { .. }
            | Error::ShapeNotMrcals { .. }
            | Error::Noncentral { .. }
            | Error::MovingRobot
            | Error::NoRobotPoses => ErrorKind::Usage,
            Error::NoMotion { .. }
            | Error::SlowMotion { .. }
            | Error::UnreadablePoses { .. }
            | Error::Unpaired { .. }
            | Error::UnpairedJoints { .. } => ErrorKind::Input,
            Error::Degenerate(_)
            | Error::NoClosedForm { .. }
            | Error::PosesMisfit { .. }
            | Error::MirroredPoses { .. }
            | Error::PoseFit(_)
            | Error::Joints(_)
            | Error::Cancelled => ErrorKind::Solve,
            Error::Compare(
                boresight_validate::Error::NotPositive { .. } | boresight_validate::Error::Columns { .. },
            ) => ErrorKind::Usage,
            Error::NothingPlaced { .. }
            | Error::NoLens(_)
            | Error::Seed(_)
            | Error::Compare(_)
            | Error::Camera(_)
            | Error::Convert { .. } => ErrorKind::Input,
            Error::Adjust(boresight_adjust::Error::LensesDiffer { .. }) => ErrorKind::Usage,
            Error::Adjust(
                boresight_adjust::Error::TooFewEquations { .. } | boresight_adjust::Error::BadSigma { .. },
            ) => ErrorKind::Input,
            Error::Adjust(_) => ErrorKind::Solve,
        }
    }

    /// Returns what to do about it, where that is not obvious.
    pub fn hint(&self) -> Option<String> {
        let text = |text: &str| Some(text.to_owned());
        match self {
            Error::Io(error) => error.hint(),
            Error::Robot(error) => error.hint(),
            Error::NoRobotPoses => text(
                "add [robot] with mount and poses to the job, or --poses FILE with --mount on-flange or fixed",
            ),
            Error::Degenerate(finding) => Some(finding.fix.clone()),
            Error::UnreadablePoses { finding, .. } => Some(match finding {
                Some(finding) => format!("{}. {}", finding.message, finding.fix),
                None => "`boresight robot poses` tries all conventions".to_owned(),
            }),
            Error::PosesMisfit { finding, .. } => Some(match finding {
                Some(finding) => format!("{}. {}", finding.message, finding.fix),
                None => "are they in the stated convention and units, and each in the row of its own frame? \
                         `boresight robot poses` tries all conventions"
                    .to_owned(),
            }),
            Error::MirroredPoses { .. } => text(
                "robots have right-handed frames: is the sign of an axis or of an angle wrong, or are two columns exchanged?",
            ),
            Error::Unpaired { .. } => {
                text("give each row of both a time (column time_s), or as many rows of one as of the other")
            }
            Error::UnpairedJoints { .. } => text("give as many rows of joints as sights, in their order"),
            Error::MovingRobot => text(
                "`boresight robot hand-eye` sets the clocks; conventions are tried on frames of a robot that stood",
            ),
            Error::PoseFit(_) | Error::Joints(_) => {
                text("add rows in which the robot, or each joint by itself, turned by 30 degrees or more")
            }
            Error::NoClosedForm { .. } => text(
                "`boresight robot poses` tries all readings of the poses; are they turned about different axes?",
            ),
            Error::ShapeNotMrcals { .. } => text("take --shape 2, or another --regularization"),
            Error::Options { .. } => text(
                "[options] takes model, shape, regularization, loss, reject, holdout, hold, prior, share_lens, time_offset, line_delay, cameras and jobs",
            ),
            Error::NothingToHold { .. } => {
                text("state the earlier calibration that says it with --prior, or the lens in the job file")
            }
            Error::NoParameter { known, .. } => {
                const SHOWN: usize = 18;
                let more = match known.len().saturating_sub(SHOWN) {
                    0 => String::new(),
                    more => format!(" and {more} others"),
                };
                Some(format!("it has {}{more}", known[..known.len().min(SHOWN)].join(", ")))
            }
            Error::NoMotion { .. } => text(
                "take images in quick succession, 0.6 s apart at most, with time stamps or [input] frame_times, while the target moves",
            ),
            Error::SlowMotion { .. } => {
                text("move the target faster, or state the delay with --line-delay SECONDS")
            }
            Error::Noncentral { .. } => text(
                "take --model cahvor, or auto; a calibrated CAHVORE lens can be used, converted and compared",
            ),
            Error::Seed(boresight_seed::Error::TooFewViews { need, .. }) => Some(format!(
                "show the target to the camera in at least {need} poses, tilted in different directions; 10 or more are better"
            )),
            Error::Seed(boresight_seed::Error::NoViews { .. }) => {
                text("do the corner files hold corners of these cameras?")
            }
            Error::Seed(_) => text(
                "do columns, rows and spacing describe the board, and is it tilted in different directions between views?",
            ),
            Error::Adjust(boresight_adjust::Error::TooFewEquations { .. }) => {
                text("add views, or choose a model with fewer parameters such as --model opencv4")
            }
            Error::Adjust(_) => {
                text("try a simpler lens model such as --model opencv4; if that fails too, report it")
            }
            Error::Compare(boresight_validate::Error::NoCommonCamera { .. }) => {
                text("cameras are paired by name, or by order where both have the same number of them")
            }
            _ => None,
        }
    }
}

fn with_sources(error: &boresight_validate::Error) -> String {
    match error {
        boresight_validate::Error::Camera { source, .. } => format!("{error}: {}", with_sources(source)),
        error => error.to_string(),
    }
}
