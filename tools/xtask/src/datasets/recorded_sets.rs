//! The recorded sets beside the project: what is in them, and what is to be made of it. `recorded_sets.toml` lists them.

use anyhow::Context as _;
use serde::Deserialize;

/// All recorded sets.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RecordedSets {
    /// Those with a target of which views are recorded.
    pub set: Vec<Set>,
    /// Those, or parts of them, that `calibrate` has nothing to do with.
    pub other: Vec<Other>,
}

/// A recorded set that `calibrate` has nothing to do with.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Other {
    pub name: String,
    pub why: String,
}

/// A recorded set that can be calibrated.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Set {
    /// The row's name.
    pub name: String,
    /// Its folder.
    pub folder: String,
    /// The images or the corner file within the folder, as the command line takes them.
    pub inputs: Vec<String>,
    /// The target, as the command line takes it.
    pub target: String,
    /// The images of each camera within the folder, for OpenCV; none takes the corner file.
    #[serde(default)]
    pub images: Vec<String>,
    /// The size of the images, for corner files and for mrcal.
    pub image_size: Option<[u32; 2]>,
    /// A regular expression over the files' names with the groups `frame` and, for several cameras, `camera`.
    #[serde(default = "any_name")]
    pub pattern: String,
    /// Which names of a corner file are of which camera, as the command line takes it; none for a single camera.
    #[serde(default)]
    pub cameras: Vec<String>,
    /// The corners that mrcal gets, within the folder, and their lens.
    pub mrcal: Option<ForMrcal>,
}

/// What mrcal is to make of a set.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ForMrcal {
    pub corners: String,
    /// The lens by our name.
    pub lens: String,
}

fn any_name() -> String {
    r"(?P<frame>[^/]+)\.\w+$".to_owned()
}

impl RecordedSets {
    pub(super) fn read() -> anyhow::Result<Self> {
        toml::from_str(include_str!("recorded_sets.toml")).context("recorded_sets.toml")
    }
}

impl Set {
    /// Returns what OpenCV is to find: `chessboard`, `charuco`, or nothing.
    pub(super) fn kind(&self) -> &str {
        let kind = self.target.split(':').next();
        kind.filter(|kind| ["chessboard", "charuco"].contains(kind)).unwrap_or_default()
    }

    /// Returns the corners of the board across and down.
    pub(super) fn size(&self) -> anyhow::Result<[u32; 2]> {
        let words = self.target.split(':').nth(1).and_then(|size| size.split_once('x'));
        let (columns, rows) = words.with_context(|| format!("{}: a target's size", self.name))?;
        // A ChArUco board is told by its squares.
        let less = u32::from(self.kind() == "charuco");
        Ok([columns.parse::<u32>()? - less, rows.parse::<u32>()? - less])
    }

    /// Returns the distance of the corners.
    pub(super) fn spacing_mm(&self) -> anyhow::Result<f64> {
        let spacing = self.target.split(':').nth(2).and_then(|word| word.strip_suffix("mm"));
        Ok(spacing.with_context(|| format!("{}: a target in mm", self.name))?.parse()?)
    }
}
