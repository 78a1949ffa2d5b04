//! What a job says of a robot: `[robot]`, its table of poses, and which frame each row belongs to.
//!
//! ```toml
//! [robot]
//! mount = "on-flange"          # the cameras: on-flange, or fixed in the work cell
//! poses = ["poses.csv"]        # a table, or several with a row or more each, in order
//! convention = "kuka-abc"      # where the header does not say; see `boresight robot hand-eye --help`
//! axes = 4                     # for robots that turn about the base's z only
//! height_m = 0.012             # for these: the height of target or fixed camera in the base
//! frame_times = "times.csv"    # for robots that moved: frame,time_s by the camera's clock; poses then need times
//! touches = "touches.csv"      # points of the first target that a tip touched: point, counted from 0, and a pose
//! touch_sigma_mm = 0.1         # how far a touch misses its point along each axis
//! tip_mm = [0.0, 0.0, 150.0]   # the tip on what bears the cameras, flange or base; left out, it is estimated
//! ```

use std::collections::BTreeSet;
use std::path::Path;

use boresight_data::{Dataset, Id as _, Mounting, PointId, PoseConvention, PoseRow};
use boresight_geometry::Pose;
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
    pub frame_times: Option<String>,
    pub touches: Option<String>,
    pub touch_sigma_mm: Option<f64>,
    pub tip_mm: Option<[f64; 3]>,
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
    /// For robots that moved: when each frame was taken, in seconds by the camera's clock; empty for robots that
    /// stood, whose rows are tied to frames.
    pub frame_times_s: Vec<Option<f64>>,
    /// Points of the first target that a tip touched.
    pub touches: Option<TouchInput>,
}

/// Points of the first target that a tip touched.
#[derive(Clone, Debug, PartialEq)]
pub struct TouchInput {
    /// The points.
    pub points: Vec<PointId>,
    /// For each, what the robot said of its flange.
    pub base_from_flange: Vec<Pose>,
    /// How far a touch misses its point along each axis, in metres.
    pub sigma_m: f64,
    /// The tip on what bears the cameras, in metres; `None` is to be estimated.
    pub tip_m: Option<[f64; 3]>,
}

impl RobotInput {
    /// Returns the robot for another dataset of the same frames, or of some of them, by their names.
    pub fn for_frames(&self, known: &Dataset, others: &Dataset) -> Self {
        let place = |name: &str| known.frames.iter().position(|frame| frame.name == name);
        let places: Vec<Option<usize>> = others.frames.iter().map(|frame| place(&frame.name)).collect();
        let row_of_frame = places.iter().map(|place| *self.row_of_frame.get((*place)?)?).collect();
        let frame_times_s = match self.frame_times_s.is_empty() {
            true => Vec::new(),
            false => places.iter().map(|place| *self.frame_times_s.get((*place)?)?).collect(),
        };
        Self { row_of_frame, frame_times_s, ..self.clone() }
    }
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

/// The farthest from a base or a flange that anything is, in metres: more are millimetres.
const FARTHEST_M: f64 = 20.0;

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
    let stated = table.convention.as_ref().map(|text| text.parse::<PoseConvention>()).transpose();
    let stated = stated.map_err(|error| config(error.to_string(), "mend `convention` of [robot]"))?;
    let said = overrides.convention.or(stated);
    let (mut rows, mut hashes) = (Vec::new(), Vec::new());
    let mut told: Option<PoseConvention> = None;
    for (name, path) in files {
        let bytes = read(&path)?;
        let mut read = read_pose_table(&path.display().to_string(), &bytes)?;
        let own = read.read_as(said);
        if let (Some(told), Some(own)) = (told, own)
            && told != own
        {
            let message = format!("the poses of {name} are written as {own}, those before as {told}");
            return Err(config(message, "write all tables of poses alike"));
        }
        hashes.push((name, hash(&bytes)));
        told = told.or(own);
        rows.append(&mut read.rows);
    }
    let convention = told.ok_or_else(|| {
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
    let is_far = |metres: f64| metres.is_nan() || metres.abs() > FARTHEST_M;
    if let Some(height_m) = table.height_m.filter(|height_m| is_far(*height_m)) {
        let message = format!("height_m is {height_m}: it must be -{FARTHEST_M} to {FARTHEST_M}");
        return Err(config(message, "write the height in metres, such as height_m = 0.012"));
    }
    if let Some(tip_mm) = table.tip_mm.filter(|tip_mm| tip_mm.iter().any(|mm| is_far(1e-3 * mm))) {
        let message = format!("tip_mm is {tip_mm:?}: a tip is within {FARTHEST_M} m");
        return Err(config(message, "write the tip in millimetres, such as tip_mm = [0.0, 0.0, 150.0]"));
    }
    let mounting = match overrides.mounting {
        Some(mounting) => Some(mounting),
        None => table.mount.as_ref().map(|word| mounting(word, place)).transpose()?,
    };
    let mut touches = None;
    if let Some(name) = &table.touches {
        let bytes = read(&folder.join(name))?;
        hashes.push((name.clone(), hash(&bytes)));
        let file = folder.join(name).display().to_string();
        touches = Some(read_touches(&file, &bytes, table, said, convention, dataset, place)?);
    }
    if let Some(name) = &table.frame_times {
        let path = folder.join(name);
        let bytes = read(&path)?;
        hashes.push((name.clone(), hash(&bytes)));
        let frame_times_s = frame_times(&path.display().to_string(), &bytes, dataset, place)?;
        if axes == RobotAxes::Four {
            let message =
                "[robot] has frame_times and axes = 4: the clocks of a robot that turns about one axis only \
                           cannot be set by how its poses follow each other"
                    .to_owned();
            return Err(config(message, "take frames while the robot stands, and leave frame_times out"));
        }
        if rows.iter().any(|row| row.time_s.is_none()) {
            let message = "[robot] has frame_times, and rows of the poses have no time".to_owned();
            return Err(config(message, "add a column time_s to the poses, by the robot's clock"));
        }
        let (row_of_frame, height_m) = (vec![None; dataset.frames.len()], table.height_m);
        let robot =
            RobotInput { mounting, rows, convention, row_of_frame, axes, height_m, frame_times_s, touches };
        return Ok(Some((robot, hashes)));
    }
    let row_of_frame = rows_of_frames(dataset, &rows, place)?;
    for (frame, row) in dataset.frames.iter_mut().zip(&row_of_frame) {
        let Some(row_idx) = row else { continue };
        // A row that is no pose in this convention is told by whoever needs it.
        frame.base_from_flange = convention.base_from_flange(&rows[*row_idx]);
    }
    let (height_m, frame_times_s) = (table.height_m, Vec::new());
    let robot =
        RobotInput { mounting, rows, convention, row_of_frame, axes, height_m, frame_times_s, touches };
    Ok(Some((robot, hashes)))
}

/// Reads which points were touched: a table with the columns `point` and a pose, in the convention that is stated, or
/// the header's, or that of the robot's other poses.
fn read_touches(
    file: &str,
    bytes: &[u8],
    table: &RobotTable,
    stated: Option<PoseConvention>,
    of_poses: PoseConvention,
    dataset: &Dataset,
    place: &Place,
) -> Result<TouchInput, Error> {
    let config = |message: String, fix: &str| Error::Config {
        place: place.clone(),
        message,
        fix: Some(fix.to_owned()),
    };
    let read = read_pose_table(file, bytes)?;
    let convention = read.read_as(stated).or_else(|| read.read_as(Some(of_poses))).unwrap_or(of_poses);
    let sigma_mm = table.touch_sigma_mm.filter(|sigma_mm| sigma_mm.is_finite() && *sigma_mm > 0.0);
    let sigma_mm = sigma_mm.ok_or_else(|| {
        let message = "[robot] has touches, and no `touch_sigma_mm` that is positive".to_owned();
        config(message, "write how far a touch misses its point, such as touch_sigma_mm = 0.1")
    })?;
    let n_points = dataset.targets.iter().next().map_or(0, |target| target.point_count());
    let (mut points, mut base_from_flange) = (Vec::new(), Vec::new());
    for (i, row) in read.rows.iter().enumerate() {
        let point = row.frame.as_deref().and_then(|text| text.parse::<usize>().ok());
        let point = point.filter(|point| *point < n_points).ok_or_else(|| {
            let said = row.frame.as_deref().unwrap_or("nothing");
            let message =
                format!("touch {} of {file} is of {said}, which is no point of the first target", i + 1);
            config(message, "let the column `point` count the points of the target from 0")
        })?;
        let pose = convention.base_from_flange(row).ok_or_else(|| {
            let message = format!("touch {} of {file} is no pose in the convention {convention}", i + 1);
            config(message, "write touches as the robot's other poses")
        })?;
        points.push(PointId::from_index(point));
        base_from_flange.push(pose);
    }
    let tip_m = table.tip_mm.map(|tip_mm| tip_mm.map(|mm| 1e-3 * mm));
    Ok(TouchInput { points, base_from_flange, sigma_m: 1e-3 * sigma_mm, tip_m })
}

/// Reads when frames were taken: a table with the columns `frame` and `time_s`.
pub(crate) fn frame_times(
    file: &str,
    bytes: &[u8],
    dataset: &Dataset,
    place: &Place,
) -> Result<Vec<Option<f64>>, Error> {
    let text = String::from_utf8_lossy(bytes);
    let mut lines = text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty());
    let fields = |line: &str| line.split(',').map(|field| field.trim().to_owned()).collect::<Vec<String>>();
    let (first, header) = lines.next().ok_or_else(|| Error::Empty { file: file.to_owned() })?;
    let header = fields(header);
    let at = |missing: &'static str| {
        header.iter().position(|field| field == missing).ok_or_else(|| Error::Header {
            place: Place::line(file, first + 1),
            header: header.join(","),
            missing,
            example: "frame,time_s",
        })
    };
    let (frame, time) = (at("frame")?, at("time_s")?);
    let mut times_s = vec![None; dataset.frames.len()];
    for (i, line) in lines {
        let row = fields(line);
        if row.len() != header.len() {
            let (found, need) = (row.len(), header.len());
            return Err(Error::ColumnCount { place: Place::line(file, i + 1), found, need, cut_off: false });
        }
        let time_s = row[time].parse::<f64>().ok().filter(|time_s| time_s.is_finite());
        let time_s = time_s.ok_or_else(|| Error::BadValue {
            place: Place::line(file, i + 1),
            column: "time_s".to_owned(),
            value: row[time].clone(),
            need: "it must be a number of seconds".to_owned(),
        })?;
        if let Some(known) = dataset.frames.iter().position(|known| known.name == row[frame]) {
            if times_s[known].is_some() {
                return Err(Error::BadValue {
                    place: Place::line(file, i + 1),
                    column: "frame".to_owned(),
                    value: row[frame].clone(),
                    need: "a frame has one time, and this one has had it".to_owned(),
                });
            }
            times_s[known] = Some(time_s);
        }
    }
    if times_s.iter().all(Option::is_none) {
        return Err(of_no_frame("frame_times", dataset, place));
    }
    Ok(times_s)
}

/// Returns the error of a table none of whose rows is of a frame.
fn of_no_frame(table: &str, dataset: &Dataset, place: &Place) -> Error {
    let names: Vec<&str> = dataset.frames.iter().take(3).map(|frame| frame.name.as_str()).collect();
    Error::Config {
        place: place.clone(),
        message: format!("no row of {table} is of a frame of the corners ({}, ...)", names.join(", ")),
        fix: Some("let the column `frame` name the frames as `boresight info` lists them".to_owned()),
    }
}

/// Ties rows to frames: by name where the table has names, else by order, one row for each frame.
fn rows_of_frames(dataset: &Dataset, rows: &[PoseRow], place: &Place) -> Result<Vec<Option<usize>>, Error> {
    let config = |message: String, fix: &str| Error::Config {
        place: place.clone(),
        message,
        fix: Some(fix.to_owned()),
    };
    if rows.iter().any(|row| row.frame.is_some()) {
        let mut known = BTreeSet::new();
        let mut names = rows.iter().filter_map(|row| row.frame.as_deref()).filter(|name| !name.is_empty());
        if let Some(name) = names.find(|name| !known.insert(*name)) {
            return Err(config(
                format!("frame {name} has two rows of poses"),
                "leave the one with which its image was taken",
            ));
        }
        let found: Vec<Option<usize>> = dataset
            .frames
            .iter()
            .map(|frame| rows.iter().position(|row| row.frame.as_deref() == Some(frame.name.as_str())))
            .collect();
        if found.iter().flatten().count() == 0 {
            return Err(of_no_frame("the poses", dataset, place));
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
