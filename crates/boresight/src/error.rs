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
    #[error("option cameras: there is no camera `{name}`; known: {}", known.join(", "))]
    UnknownCamera {
        /// The name.
        name: String,
        /// The cameras there are.
        known: Vec<String>,
    },
    /// No start could be found.
    #[error("{0}")]
    Seed(#[from] boresight_seed::Error),
    /// The adjustment failed.
    #[error("{0}")]
    Adjust(#[from] boresight_adjust::Error),
    /// Two calibrations cannot be compared.
    #[error("{}", with_sources(.0))]
    Compare(#[from] boresight_validate::Error),
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
            Error::Options { .. } | Error::UnknownCamera { .. } => ErrorKind::Usage,
            Error::Compare(
                boresight_validate::Error::NotPositive { .. } | boresight_validate::Error::Columns { .. },
            ) => ErrorKind::Usage,
            Error::Seed(_) | Error::Compare(_) | Error::Camera(_) | Error::Convert { .. } => ErrorKind::Input,
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
            Error::Options { .. } => {
                text("[options] takes model, shape, regularization, loss, reject, cameras and jobs")
            }
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
