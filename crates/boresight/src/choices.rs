//! The values of options as people write them, in a job file or on the command line.

use std::collections::BTreeMap;
use std::fmt;
use std::str::FromStr;

use boresight_camera::Model;
use boresight_data::{Dataset, Shape};

use crate::error::Error;
use crate::shared_lens::camera_of;

/// A value that an option does not take.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("`{value}` is not one of: {takes}")]
pub struct BadChoice {
    /// The value given.
    pub value: String,
    /// What the option takes.
    pub takes: &'static str,
}

/// What is chosen for all cameras, and what for single ones: a choice as it is written, then `,NAME=` and another for each.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ByCamera<T> {
    /// That of cameras that are not named.
    pub usual: T,
    /// Those of single cameras, by name.
    pub by_camera: BTreeMap<String, T>,
}

impl<T: Copy> ByCamera<T> {
    /// Returns the choice of a camera.
    pub fn of(&self, camera: &str) -> T {
        self.by_camera.get(camera).copied().unwrap_or(self.usual)
    }
}

impl<T> ByCamera<T> {
    /// Returns an error if it names a camera that a dataset does not have.
    pub(crate) fn check_names(&self, dataset: &Dataset) -> Result<(), Error> {
        self.by_camera.keys().try_for_each(|name| camera_of(dataset, name).map(|_| ()))
    }
}

/// A list of choices, one for all cameras and others for some, that cannot be read.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum BadList<E> {
    /// One of its choices.
    #[error(transparent)]
    Choice(E),
    /// Two choices for the same.
    #[error("`{text}` has two values for {what}")]
    Twice {
        /// The list.
        text: String,
        /// A camera, or all cameras.
        what: String,
    },
}

impl<T: FromStr + Default> FromStr for ByCamera<T> {
    type Err = BadList<T::Err>;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let (mut usual, mut by_camera) = (None, BTreeMap::new());
        for part in text.split(',') {
            let (before, what) = match part.split_once('=') {
                None => (usual.replace(part.parse().map_err(BadList::Choice)?), "all cameras".to_owned()),
                Some((camera, of_camera)) => {
                    let of_camera = of_camera.parse().map_err(BadList::Choice)?;
                    (by_camera.insert(camera.to_owned(), of_camera), format!("camera {camera}"))
                }
            };
            if before.is_some() {
                return Err(BadList::Twice { text: text.to_owned(), what });
            }
        }
        Ok(Self { usual: usual.unwrap_or_default(), by_camera })
    }
}

impl<T: fmt::Display> fmt::Display for ByCamera<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut text = self.usual.to_string();
        for (camera, of_camera) in &self.by_camera {
            text.push_str(&format!(",{camera}={of_camera}"));
        }
        f.pad(&text)
    }
}

/// How a camera's lens model is found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LensModel {
    /// It is this one.
    Given(Model),
    /// It is the simplest that predicts the camera's views well.
    Auto,
}

/// The lens models of all cameras: `opencv5`, `auto`, or with cameras of their own as in
/// `opencv5,right=kannala-brandt4`.
pub type LensChoice = ByCamera<LensModel>;

impl From<Model> for LensChoice {
    fn from(model: Model) -> Self {
        Self { usual: LensModel::Given(model), by_camera: BTreeMap::new() }
    }
}

impl Default for LensModel {
    fn default() -> Self {
        Self::Given(Model::OpenCv5(Default::default()))
    }
}

impl FromStr for LensModel {
    type Err = boresight_camera::Error;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        if text == "auto" { Ok(Self::Auto) } else { text.parse().map(Self::Given) }
    }
}

impl fmt::Display for LensModel {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Given(model) => f.pad(&model.to_string()),
            Self::Auto => f.pad("auto"),
        }
    }
}

/// How the target may depart from its drawing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ShapeChoice {
    /// In this way. A target that is no grid stays as drawn.
    Given(Shape),
    /// With as many coefficients as help to predict views that took no part.
    Auto,
}

impl Default for ShapeChoice {
    fn default() -> Self {
        Self::Given(Shape::Parabolic2)
    }
}

impl FromStr for ShapeChoice {
    type Err = BadChoice;

    fn from_str(text: &str) -> Result<Self, BadChoice> {
        match text {
            "none" => Ok(Self::Given(Shape::Rigid)),
            "2" => Ok(Self::Given(Shape::Parabolic2)),
            "6" => Ok(Self::Given(Shape::Twisted6)),
            "auto" => Ok(Self::Auto),
            _ => Err(BadChoice { value: text.to_owned(), takes: "none, 2, 6, auto" }),
        }
    }
}

impl fmt::Display for ShapeChoice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Given(Shape::Rigid) => "none",
            Self::Given(Shape::Parabolic2) => "2",
            Self::Given(Shape::Twisted6) => "6",
            Self::Auto => "auto",
        })
    }
}

/// What keeps weakly constrained lens parameters in bounds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum RegularizationChoice {
    /// Nothing.
    None,
    /// Rational, thin-prism and tilt coefficients are believed near zero, mildly.
    #[default]
    Default,
    /// The rows of mrcal 2.2, for comparisons at the same optimum.
    Mrcal22,
}

impl FromStr for RegularizationChoice {
    type Err = BadChoice;

    fn from_str(text: &str) -> Result<Self, BadChoice> {
        match text {
            "none" => Ok(Self::None),
            "default" => Ok(Self::Default),
            "mrcal-2.2" => Ok(Self::Mrcal22),
            _ => Err(BadChoice { value: text.to_owned(), takes: "none, default, mrcal-2.2" }),
        }
    }
}

impl fmt::Display for RegularizationChoice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::None => "none",
            Self::Default => "default",
            Self::Mrcal22 => "mrcal-2.2",
        })
    }
}

/// What large residuals cost.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum LossChoice {
    /// Their square.
    #[default]
    None,
    /// Cauchy's loss, which bends at this many pixels.
    Cauchy {
        /// The length of a residual in pixels.
        px: f64,
    },
}

impl FromStr for LossChoice {
    type Err = BadChoice;

    fn from_str(text: &str) -> Result<Self, BadChoice> {
        let bad = || BadChoice {
            value: text.to_owned(),
            takes: "none, cauchy:PX with a positive number of pixels such as cauchy:1.5",
        };
        if text == "none" {
            return Ok(Self::None);
        }
        let px = text.strip_prefix("cauchy:").and_then(positive).ok_or_else(bad)?;
        Ok(Self::Cauchy { px })
    }
}

impl fmt::Display for LossChoice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::None => f.pad("none"),
            Self::Cauchy { px } => f.pad(&format!("cauchy:{px}")),
        }
    }
}

/// Which observations are not used.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum RejectChoice {
    /// All are used.
    None,
    /// Those are not that lie farther from the solution than this many robust sigmas of their camera.
    Beyond {
        /// The limit on the length of the residual.
        sigmas: f64,
    },
}

/// Into how many parts the frames are cut that are left out in turn.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum HoldoutChoice {
    /// Nothing is left out; there is no held-out error.
    Off,
    /// Each frame alone where there are no more than 20, else five parts.
    #[default]
    Auto,
    /// So many parts; each frame alone where there are no more frames.
    Folds(usize),
}

impl FromStr for HoldoutChoice {
    type Err = BadChoice;

    fn from_str(text: &str) -> Result<Self, BadChoice> {
        match text {
            "off" => Ok(Self::Off),
            "auto" => Ok(Self::Auto),
            _ => {
                let takes = "off, auto, or a number of parts of at least 2 such as 5";
                let folds = text.parse().ok().filter(|folds| *folds >= 2);
                folds.map(Self::Folds).ok_or_else(|| BadChoice { value: text.to_owned(), takes })
            }
        }
    }
}

impl fmt::Display for HoldoutChoice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Off => f.pad("off"),
            Self::Auto => f.pad("auto"),
            Self::Folds(folds) => f.pad(&folds.to_string()),
        }
    }
}

impl Default for RejectChoice {
    fn default() -> Self {
        Self::Beyond { sigmas: 4.0 }
    }
}

impl FromStr for RejectChoice {
    type Err = BadChoice;

    fn from_str(text: &str) -> Result<Self, BadChoice> {
        if text == "none" {
            return Ok(Self::None);
        }
        let takes = "none, a number of sigmas of at least 2 such as 4";
        let sigmas = positive(text).filter(|sigmas| *sigmas >= 2.0);
        let sigmas = sigmas.ok_or_else(|| BadChoice { value: text.to_owned(), takes })?;
        Ok(Self::Beyond { sigmas })
    }
}

impl fmt::Display for RejectChoice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::None => f.pad("none"),
            Self::Beyond { sigmas } => f.pad(&sigmas.to_string()),
        }
    }
}

fn positive(text: &str) -> Option<f64> {
    text.parse::<f64>().ok().filter(|value| *value > 0.0 && value.is_finite())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn survives<T: FromStr<Err = BadChoice> + fmt::Display>(texts: &[&str]) {
        for text in texts {
            let Ok(value) = text.parse::<T>() else { panic!("{text}") };
            assert_eq!(value.to_string(), *text);
        }
    }

    fn refuses<T: FromStr<Err = BadChoice>>(texts: &[&str]) {
        for text in texts {
            let Err(error) = text.parse::<T>() else { panic!("{text}") };
            let first = ["none", "off"].map(|word| format!("`{text}` is not one of: {word}"));
            assert!(first.iter().any(|first| error.to_string().starts_with(first)), "{error}");
        }
    }

    #[test]
    fn choices_are_read_and_written() {
        survives::<ShapeChoice>(&["none", "2", "6", "auto"]);
        survives::<RegularizationChoice>(&["none", "default", "mrcal-2.2"]);
        survives::<LossChoice>(&["none", "cauchy:1.5", "cauchy:2"]);
        survives::<RejectChoice>(&["none", "4", "3.5"]);
        survives::<HoldoutChoice>(&["off", "auto", "5"]);
        assert_eq!(RejectChoice::default().to_string(), "4");
    }

    #[test]
    fn lens_models_are_given_for_all_cameras_or_for_some() {
        for text in ["opencv5", "auto", "opencv8,left=auto", "opencv5,left=splined3:30x20:150deg,right=mei"] {
            let choice: LensChoice = text.parse().unwrap();
            assert_eq!(choice.to_string(), text);
        }
        let some: LensChoice = "right=auto".parse().unwrap();
        assert_eq!(some.to_string(), "opencv5,right=auto");
        assert_eq!((some.of("right"), some.of("left")), (LensModel::Auto, LensChoice::default().usual));
        for text in ["", "opencv6", "left=", "left=opencv5,"] {
            assert!(text.parse::<LensChoice>().is_err(), "{text}");
        }
    }

    #[test]
    fn mistakes_are_answered_with_what_is_taken() {
        refuses::<ShapeChoice>(&["", "3", "two"]);
        refuses::<RegularizationChoice>(&["mrcal", "mrcal-2.3"]);
        refuses::<LossChoice>(&["cauchy", "cauchy:", "cauchy:0", "cauchy:-1", "cauchy:nan", "huber:1"]);
        refuses::<HoldoutChoice>(&["", "1", "0", "-2", "2.5", "none"]);
        refuses::<RejectChoice>(&["0", "-4", "nan", "inf", "1.5", "four"]);
    }
}
