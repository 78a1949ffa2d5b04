//! How a calibration is made: the command line's flags and the job file's `[options]` are these.

use std::collections::BTreeMap;
use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use boresight_adjust::{AdjustOptions, Loss, Regularization, Rejection};
use boresight_data::Dataset;
use boresight_io::{Job, Place};
use serde::de::{Deserializer, Error as _, Visitor};
use serde::{Deserialize, Serialize, Serializer};

use crate::beliefs::HoldChoice;
use crate::choices::{
    HoldoutChoice, LensChoice, LossChoice, RegularizationChoice, RejectChoice, ShapeChoice,
};
use crate::error::Error;
use crate::line_delay::LineDelayChoice;
use crate::time_offset::TimeOffsetChoice;

/// How a calibration is made. Flags come before the job file, and that before these defaults.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CalibrateOptions {
    /// The lens model of all cameras, or `auto` to choose for each, and after it those of single cameras,
    /// as in `opencv5,right=kannala-brandt4`; `opencv5` unless told otherwise.
    #[serde(with = "as_text")]
    pub model: LensChoice,
    /// How the target may depart from its drawing: `none`, `2`, `6` or `auto`; `2` unless told otherwise.
    #[serde(with = "as_text")]
    pub shape: ShapeChoice,
    /// What keeps weakly constrained lens parameters in bounds: `none`, `default` or `mrcal-2.2`.
    #[serde(with = "as_text")]
    pub regularization: RegularizationChoice,
    /// What large residuals cost: `none` or `cauchy:PX`; `none` unless told otherwise.
    #[serde(with = "as_text")]
    pub loss: LossChoice,
    /// Beyond how many sigmas a corner is rejected, or `none`; 4 unless told otherwise.
    #[serde(with = "as_text")]
    pub reject: RejectChoice,
    /// Into how many parts the frames are cut that are left out in turn, for the held-out error:
    /// `off`, `auto` or a number; `auto` unless told otherwise.
    #[serde(with = "as_text")]
    pub holdout: HoldoutChoice,
    /// What is not estimated, such as `lens:left`, `pose`, `shape` or `k3`. Empty estimates everything.
    #[serde(with = "as_texts")]
    pub hold: Vec<HoldChoice>,
    /// An earlier calibration, made from other views: its lenses, and its poses where the reference camera is
    /// the same, are believed with their covariance. Cameras that it has take their lens model from it.
    pub prior: Option<PathBuf>,
    /// Cameras that share one lens, such as `left+right`, for each lens that is shared.
    pub share_lens: Vec<String>,
    /// What becomes of cameras whose images of a frame are late, where the frames have times: `hold` takes them as of one
    /// instant and tells of offsets, `solve` estimates them; `hold` unless told otherwise.
    #[serde(with = "as_text")]
    pub time_offset: TimeOffsetChoice,
    /// What becomes of cameras that take their rows one after another, where frames have times: `hold` takes the rows as of
    /// one instant and tells of delays, `solve` estimates them, a number of seconds from row to row states them; after it
    /// those of single cameras, as in `solve,right=0`. `hold` unless told otherwise.
    #[serde(with = "as_text")]
    pub line_delay: LineDelayChoice,
    /// The names of the cameras to calibrate; empty takes all.
    pub cameras: Vec<String>,
    /// The number of threads; 0 takes one for each core. The result does not depend on it.
    pub jobs: usize,
}

impl CalibrateOptions {
    /// Returns the options that a job file states, and the defaults of all others.
    pub fn of_job(job: &Job) -> Result<Self, Error> {
        Self::of_table(&job.options, job.options_place.as_ref())
    }

    /// Returns the options that a table `[options]` states, which begins at `place`, and the defaults of all others.
    pub fn of_table(table: &toml::Table, place: Option<&Place>) -> Result<Self, Error> {
        let stated: Result<Self, _> = table.clone().try_into();
        let mut options = stated.map_err(|error| Error::Options {
            place: place.cloned().unwrap_or_else(|| Place::file("boresight.toml")),
            message: error.message().lines().next().unwrap_or_default().to_owned(),
        })?;
        // What a job file names is beside it.
        let folder = place.and_then(|place| Path::new(&place.file).parent());
        if let (Some(prior), Some(folder)) = (&mut options.prior, folder) {
            *prior = folder.join(&*prior);
        }
        Ok(options)
    }

    /// Returns the options that bear on the result, as the command line or the job file would state them.
    pub fn stated(&self) -> BTreeMap<String, String> {
        let mut stated = BTreeMap::from([
            ("model".to_owned(), self.model.to_string()),
            ("shape".to_owned(), self.shape.to_string()),
            ("regularization".to_owned(), self.regularization.to_string()),
            ("loss".to_owned(), self.loss.to_string()),
            ("reject".to_owned(), self.reject.to_string()),
            ("holdout".to_owned(), self.holdout.to_string()),
        ]);
        if !self.hold.is_empty() {
            let hold: Vec<String> = self.hold.iter().map(ToString::to_string).collect();
            stated.insert("hold".to_owned(), hold.join(","));
        }
        if let Some(prior) = &self.prior {
            stated.insert("prior".to_owned(), prior.display().to_string());
        }
        if !self.share_lens.is_empty() {
            stated.insert("share_lens".to_owned(), self.share_lens.join(","));
        }
        if self.time_offset != TimeOffsetChoice::default() {
            stated.insert("time_offset".to_owned(), self.time_offset.to_string());
        }
        if self.line_delay != LineDelayChoice::default() {
            stated.insert("line_delay".to_owned(), self.line_delay.to_string());
        }
        if !self.cameras.is_empty() {
            stated.insert("cameras".to_owned(), self.cameras.join(","));
        }
        stated
    }

    /// Returns what these options ask of an adjustment of `dataset`.
    pub fn adjust_options(&self, dataset: &Dataset) -> AdjustOptions {
        AdjustOptions {
            loss: match self.loss {
                LossChoice::None => Loss::None,
                LossChoice::Cauchy { px } => Loss::Cauchy { sigmas: px / typical_sigma_px(dataset) },
            },
            rejection: match self.reject {
                RejectChoice::None => Rejection::None,
                RejectChoice::Beyond { sigmas } => Rejection::Beyond { sigmas },
            },
            regularization: match self.regularization {
                RegularizationChoice::None => Regularization::None,
                RegularizationChoice::Default => Regularization::Default,
                RegularizationChoice::Mrcal22 => Regularization::Mrcal22,
            },
            threads: self.jobs,
            ..AdjustOptions::default()
        }
    }
}

/// Returns the root of the mean squared sigma of all corners, in pixels, which an RMS in pixels goes with.
pub(crate) fn typical_sigma_px(dataset: &Dataset) -> f64 {
    let observations = dataset.views.iter().flat_map(|view| &view.observations);
    let squares = observations.map(|observation| observation.sigma_px * observation.sigma_px);
    let typical = (squares.sum::<f64>() / dataset.observation_count().max(1) as f64).sqrt();
    if typical.is_finite() && typical > 0.0 { typical } else { 1.0 }
}

/// Values that a file states as text; a bare number will do where the text would be one.
mod as_text {
    use super::*;

    pub(super) fn serialize<T: fmt::Display, S: Serializer>(
        value: &T,
        serializer: S,
    ) -> Result<S::Ok, S::Error> {
        serializer.collect_str(value)
    }

    pub(super) fn deserialize<'de, T, D>(deserializer: D) -> Result<T, D::Error>
    where
        T: FromStr<Err: fmt::Display>,
        D: Deserializer<'de>,
    {
        struct TextOrNumber;
        impl Visitor<'_> for TextOrNumber {
            type Value = String;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a text or a number")
            }

            fn visit_str<E>(self, text: &str) -> Result<String, E> {
                Ok(text.to_owned())
            }

            fn visit_i64<E>(self, number: i64) -> Result<String, E> {
                Ok(number.to_string())
            }

            fn visit_u64<E>(self, number: u64) -> Result<String, E> {
                Ok(number.to_string())
            }

            fn visit_f64<E>(self, number: f64) -> Result<String, E> {
                Ok(number.to_string())
            }
        }
        deserializer.deserialize_any(TextOrNumber)?.parse().map_err(|error: T::Err| D::Error::custom(error))
    }
}

/// Lists of values that a file states as text.
mod as_texts {
    use super::*;

    pub(super) fn serialize<T: fmt::Display, S: Serializer>(
        values: &[T],
        serializer: S,
    ) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(values.iter().map(ToString::to_string))
    }

    pub(super) fn deserialize<'de, T, D>(deserializer: D) -> Result<Vec<T>, D::Error>
    where
        T: FromStr<Err: fmt::Display>,
        D: Deserializer<'de>,
    {
        let texts = Vec::<String>::deserialize(deserializer)?;
        texts.iter().map(|text| text.parse().map_err(|error: T::Err| D::Error::custom(error))).collect()
    }
}

#[cfg(test)]
mod tests {
    use boresight_data::Shape;

    use super::*;

    fn job(options: &str) -> Job {
        let options_place = Some(Place::line("boresight.toml", 7));
        Job { options: options.parse().unwrap(), options_place, ..Job::from(Dataset::default()) }
    }

    #[test]
    fn a_job_file_states_what_it_wants_and_defaults_fill_in() {
        let options = CalibrateOptions::of_job(&job(
            "model = \"opencv8\"\nshape = \"none\"\nreject = 3.5\nloss = \"cauchy:2\"\ncameras = [\"left\"]\njobs = 1",
        ));
        let options = options.unwrap();
        assert_eq!(options.model.to_string(), "opencv8");
        assert_eq!(options.shape, ShapeChoice::Given(Shape::Rigid));
        assert_eq!(options.reject, RejectChoice::Beyond { sigmas: 3.5 });
        assert_eq!(options.loss, LossChoice::Cauchy { px: 2.0 });
        assert_eq!(options.regularization, RegularizationChoice::Default);
        assert_eq!(options.stated()["cameras"], "left");
        assert!(!options.stated().contains_key("jobs"), "threads have no say in the result");
        assert_eq!(CalibrateOptions::of_job(&job("")).unwrap(), CalibrateOptions::default());
        for (text, shape) in [("shape = 2", Shape::Parabolic2), ("shape = \"6\"", Shape::Twisted6)] {
            assert_eq!(CalibrateOptions::of_job(&job(text)).unwrap().shape, ShapeChoice::Given(shape));
        }
    }

    #[test]
    fn mistakes_are_named_with_their_place() {
        for (options, parts) in [
            ("modle = \"opencv5\"", ["unknown field `modle`", "`model`"]),
            ("model = \"opencv6\"", ["no lens model `opencv6`", "opencv14"]),
            ("reject = -1", ["`-1` is not one of", "4"]),
            ("jobs = -1", ["invalid value", "-1"]),
        ] {
            let error = CalibrateOptions::of_job(&job(options)).unwrap_err().to_string();
            assert!(error.starts_with("boresight.toml:7: "), "{error}");
            assert!(parts.iter().all(|part| error.contains(part)), "{error}");
        }
    }

    #[test]
    fn the_hint_names_every_option() {
        let options = CalibrateOptions { prior: Some("out".into()), ..CalibrateOptions::default() };
        let wrong = Error::Options { place: Place::line("boresight.toml", 7), message: "wrong".to_owned() };
        let hint = wrong.hint().unwrap();
        let known: toml::Table = toml::to_string(&options).unwrap().parse().unwrap();
        for name in known.keys() {
            assert!(hint.split([' ', ',']).any(|word| word == name), "{name}: {hint}");
        }
    }

    #[test]
    fn options_survive_a_round_trip() {
        let options = CalibrateOptions {
            model: "auto,b=opencv8".parse().unwrap(),
            hold: vec!["k3".parse().unwrap(), "pose:b".parse().unwrap()],
            prior: Some("earlier/calibration.json".into()),
            share_lens: vec!["a+b".to_owned()],
            time_offset: TimeOffsetChoice::Solve,
            line_delay: "solve,a=2e-5".parse().unwrap(),
            cameras: vec!["a".to_owned()],
            ..CalibrateOptions::default()
        };
        let text = toml::to_string(&options).unwrap();
        assert_eq!(toml::from_str::<CalibrateOptions>(&text).unwrap(), options);
    }
}
