//! What a job says of a robot: `[robot]`, its table of poses, and which frame each row belongs to.
//!
//! ```toml
//! [robot]
//! mount = "on-flange"          # the cameras: on-flange, or fixed in the work cell
//! poses = ["poses.csv"]        # a table, or several with a row or more each, in order
//! convention = "kuka-abc"      # where the header does not say; see `boresight robot hand-eye --help`
//! axes = 4                     # for robots that turn about the base's z only
//! height_m = 0.012             # for these: the height of target or fixed camera in the base
//! ```

use std::path::Path;

use boresight_data::{Dataset, Mounting, PoseConvention, PoseRow};
use serde::Deserialize;

use crate::job::{hash, read};
use crate::pose_table::read_pose_table;
use crate::{Error, Place};

/// The table `[robot]` of a job file.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct RobotTable {
    pub mount: Option<String>,
    #[serde(default)]
    pub poses: Vec<String>,
    pub convention: Option<String>,
    pub axes: Option<u8>,
    pub height_m: Option<f64>,
}

/// A robot as a job describes it.
#[derive(Clone, Debug, PartialEq)]
pub struct RobotInput {
    /// Where the cameras are; `None` if the job does not say.
    pub mounting: Option<Mounting>,
    /// The rows of its table of poses, as they were written.
    pub rows: Vec<PoseRow>,
    /// How the rows are read.
    pub convention: PoseConvention,
    /// For each frame of the dataset, its row.
    pub row_of_frame: Vec<Option<usize>>,
    /// Whether the robot turns about the base's z axis only.
    pub axes: RobotAxes,
    /// For robots that do: the height in the base of the target, or of the fixed rig, in metres.
    pub height_m: Option<f64>,
}

/// About how many axes a robot turns.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum RobotAxes {
    /// About all.
    #[default]
    Six,
    /// About the base's z axis only.
    Four,
}

/// What the command line says in place of a job's `[robot]`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RobotOverrides {
    /// Where the cameras are.
    pub mounting: Option<Mounting>,
    /// The files of poses, in order; empty takes the job's.
    pub poses: Vec<std::path::PathBuf>,
    /// How rows are read.
    pub convention: Option<PoseConvention>,
}

/// Reads the word for where cameras are.
pub(crate) fn mounting(word: &str, place: &Place) -> Result<Mounting, Error> {
    match word {
        "on-flange" => Ok(Mounting::RigOnFlange),
        "fixed" => Ok(Mounting::RigInBase),
        _ => Err(Error::Config {
            place: place.clone(),
            message: format!("there is no mount `{word}`"),
            fix: Some(
                "write on-flange for cameras that move with the robot, fixed for cameras that do not"
                    .to_owned(),
            ),
        }),
    }
}

/// The files that were read, with their hashes.
type Hashes = Vec<(String, String)>;

/// Reads the poses that a job names, ties them to frames, and puts them into the dataset.
///
/// Returns the robot and the names and hashes of what was read; `None` if neither job nor overrides name poses.
pub(crate) fn load_robot(
    folder: &Path,
    table: Option<&RobotTable>,
    place: &Place,
    overrides: &RobotOverrides,
    dataset: &mut Dataset,
) -> Result<Option<(RobotInput, Hashes)>, Error> {
    let nothing = RobotTable::default();
    let table = table.unwrap_or(&nothing);
    let files: Vec<(String, std::path::PathBuf)> = if overrides.poses.is_empty() {
        table.poses.iter().map(|name| (name.clone(), folder.join(name))).collect()
    } else {
        overrides.poses.iter().map(|path| (path.display().to_string(), path.clone())).collect()
    };
    if files.is_empty() {
        return Ok(None);
    }
    let config = |message: String, fix: &str| Error::Config {
        place: place.clone(),
        message,
        fix: Some(fix.to_owned()),
    };
    let (mut rows, mut hashes, mut told) = (Vec::new(), Vec::new(), None);
    for (name, path) in files {
        let bytes = read(&path)?;
        hashes.push((name, hash(&bytes)));
        let mut read = read_pose_table(&path.display().to_string(), &bytes)?;
        told = told.or(read.convention);
        rows.append(&mut read.rows);
    }
    let stated = table.convention.as_ref().map(|text| text.parse::<PoseConvention>()).transpose();
    let stated = stated.map_err(|error| config(error.to_string(), "mend `convention` of [robot]"))?;
    let convention = overrides.convention.or(stated).or(told).ok_or_else(|| {
        let message = "the table of poses does not say what its angles mean".to_owned();
        config(message, "add convention = \"kuka-abc\" (or another) to [robot], or --poses-as")
    })?;
    let axes = match table.axes {
        None | Some(5..=7) => RobotAxes::Six,
        Some(4) => RobotAxes::Four,
        Some(other) => {
            return Err(config(
                format!("axes is {other}"),
                "write 4 for a robot that turns about z only, else 6",
            ));
        }
    };
    let mounting = match overrides.mounting {
        Some(mounting) => Some(mounting),
        None => table.mount.as_ref().map(|word| mounting(word, place)).transpose()?,
    };
    let row_of_frame = rows_of_frames(dataset, &rows, place)?;
    for (frame, row) in dataset.frames.iter_mut().zip(&row_of_frame) {
        let Some(row_idx) = row else { continue };
        // A row that is no pose in this convention is told by whoever needs it.
        frame.base_from_flange = convention.base_from_flange(&rows[*row_idx]);
    }
    let robot = RobotInput { mounting, rows, convention, row_of_frame, axes, height_m: table.height_m };
    Ok(Some((robot, hashes)))
}

/// Ties rows to frames: by name where the table has names, else by order, one row for each frame.
fn rows_of_frames(dataset: &Dataset, rows: &[PoseRow], place: &Place) -> Result<Vec<Option<usize>>, Error> {
    let config = |message: String, fix: &str| Error::Config {
        place: place.clone(),
        message,
        fix: Some(fix.to_owned()),
    };
    if rows.iter().any(|row| row.frame.is_some()) {
        let found: Vec<Option<usize>> = dataset
            .frames
            .iter()
            .map(|frame| rows.iter().position(|row| row.frame.as_deref() == Some(frame.name.as_str())))
            .collect();
        if found.iter().flatten().count() == 0 {
            let names: Vec<&str> = dataset.frames.iter().take(3).map(|frame| frame.name.as_str()).collect();
            let message =
                format!("no row of the poses is of a frame of the corners ({}, ...)", names.join(", "));
            return Err(config(
                message,
                "let the column `frame` name the frames as `boresight info` lists them",
            ));
        }
        return Ok(found);
    }
    if rows.len() != dataset.frames.len() {
        let message = format!(
            "there are {} poses and {} frames with corners, and the poses do not name their frames",
            rows.len(),
            dataset.frames.len()
        );
        return Err(config(
            message,
            "add a column `frame` to the poses, with the names that `boresight info` lists",
        ));
    }
    Ok((0..rows.len()).map(Some).collect())
}
