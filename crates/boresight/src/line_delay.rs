//! Cameras that take the rows of an image one after another: what a caller may ask, and what is said of it.

use std::fmt;
use std::str::FromStr;

use boresight_adjust::{Clock, LOOSEST_READOUT_S, LineDelay};
use boresight_data::{CameraId, Dataset, Finding, Scene, Severity};

use crate::choices::{BadChoice, ByCamera};
use crate::error::Error;
use crate::time_offset::{CERTAIN_SIGMAS, HARMLESS_PX};

/// What becomes of a camera whose rows are late.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum LineDelayUse {
    /// All rows are taken as of one instant; a delay that matters is told.
    #[default]
    Hold,
    /// The delay is estimated with everything else.
    Solve,
    /// The delay from row to row is this, in seconds; zero is a global shutter.
    Given(f64),
}

/// No sensor takes longer from row to row, in seconds.
const LONGEST_S: f64 = 1e-3;

/// What becomes of all cameras whose rows are late: `solve`, `29.6e-6`, or with cameras of their own as in `solve,left=0`.
pub type LineDelayChoice = ByCamera<LineDelayUse>;

impl LineDelayChoice {
    /// Puts the delays that are given into a scene.
    pub(crate) fn apply(&self, dataset: &Dataset, scene: &mut Scene) {
        for (camera, info) in scene.rig.cameras.iter_mut().zip(&dataset.cameras) {
            if let (Some(camera), LineDelayUse::Given(line_delay_s)) = (camera, self.of(&info.name)) {
                camera.line_delay_s = line_delay_s;
            }
        }
    }

    /// Returns the delays of cameras that are estimated, and those that are looked for.
    pub(crate) fn clocks(&self, dataset: &Dataset) -> [Vec<Clock>; 2] {
        let that = |use_: LineDelayUse| {
            let is_that = move |camera: &CameraId| self.of(&dataset.cameras[*camera].name) == use_;
            dataset.cameras.ids().filter(is_that).map(Clock::LineDelay).collect()
        };
        [that(LineDelayUse::Solve), that(LineDelayUse::Hold)]
    }
}

impl FromStr for LineDelayUse {
    type Err = BadChoice;

    fn from_str(text: &str) -> Result<Self, BadChoice> {
        match (text, text.parse::<f64>()) {
            ("hold", _) => Ok(Self::Hold),
            ("solve", _) => Ok(Self::Solve),
            (_, Ok(seconds)) if seconds.abs() <= LONGEST_S => Ok(Self::Given(seconds)),
            _ => Err(BadChoice {
                value: text.to_owned(),
                takes: "hold, solve, seconds from row to row such as 29.6e-6 (1e-3 at most)",
            }),
        }
    }
}

impl fmt::Display for LineDelayUse {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Hold => f.pad("hold"),
            Self::Solve => f.pad("solve"),
            Self::Given(seconds) => write!(f, "{seconds:e}"),
        }
    }
}

/// The long texts of findings about line delays, each with its code.
pub(crate) const LINE_DELAY_TEXTS: &[(&str, &str)] = &[(
    "rolling-shutter",
    "What it means: the camera takes the rows of an image one after another, and where the target moves, it is sheared and\n\
     stretched by what it moves from the first row to the last. The delay from row to row is told with its sigma.\n\n\
     Why it matters: all rows of an image are taken as of one instant, so that what the target moves in between becomes an\n\
     error of lenses and poses.\n\n\
     How to fix it: estimate the delay with --line-delay solve, or line_delay = \"solve\" in [options] of the job; hold the\n\
     target still for each image; or take a camera with a global shutter.",
)];

/// Tells whether a delay is certain and does harm.
pub(crate) fn matters(delay: &LineDelay) -> bool {
    delay.line_delay_s.abs() > CERTAIN_SIGMAS * delay.sigma_s && delay.shift_px > HARMLESS_PX
}

/// Returns an error if a delay that was to be estimated is not known, or not well enough to say anything.
pub(crate) fn check_told(delay: Option<&LineDelay>, name: &str) -> Result<(), Error> {
    if delay.is_some_and(LineDelay::is_told) {
        return Ok(());
    }
    let readout_sigma_ms = delay.map(|delay| 1e3 * delay.readout_sigma_s());
    Err(Error::SlowMotion { camera: name.to_owned(), readout_sigma_ms, limit_ms: 1e3 * LOOSEST_READOUT_S })
}

/// Returns the finding of a delay that was looked for and not used.
pub(crate) fn found(delay: &LineDelay, name: &str) -> Finding {
    Finding {
        code: LINE_DELAY_TEXTS[0].0.to_owned(),
        severity: Severity::Caution,
        place: name.to_owned(),
        message: describe(delay, name),
        measured: Some(1e6 * delay.line_delay_s),
        limit: Some(1e6 * CERTAIN_SIGMAS * delay.sigma_s),
        fix: "--line-delay solve estimates it; or hold the target still".to_owned(),
    }
}

/// Returns the finding of a delay that is estimated and used.
pub(crate) fn used(delay: &LineDelay, name: &str) -> Finding {
    Finding {
        code: LINE_DELAY_TEXTS[0].0.to_owned(),
        severity: Severity::Note,
        place: name.to_owned(),
        message: format!("{}; this is estimated and used", describe(delay, name)),
        measured: Some(1e6 * delay.line_delay_s),
        limit: None,
        fix: "hold the target still, or take a camera with a global shutter".to_owned(),
    }
}

/// Says how late a camera's rows are.
fn describe(delay: &LineDelay, name: &str) -> String {
    let [delay_us, sigma_us] = [delay.line_delay_s, delay.sigma_s].map(|seconds| 1e6 * seconds);
    let readout_ms = 1e3 * delay.line_delay_s.abs() * f64::from(delay.rows.saturating_sub(1));
    let decimals = if sigma_us < 0.05 { 3 } else { 2 };
    let order =
        if delay_us < 0.0 { "from the last row to the first" } else { "from the first row to the last" };
    format!(
        "{name} takes its rows one after another, {delay_us:.decimals$} ± {sigma_us:.decimals$} us apart, \
         {readout_ms:.1} ms {order}, while the target moves by {:.2} px over its own rows",
        delay.shift_px
    )
}

#[cfg(test)]
#[path = "line_delay_tests.rs"]
mod tests;
