//! A hand-eye job without pixels: `[sights]`, where a camera or tracker saw the target, beside `[robot]`.
//!
//! ```toml
//! [robot]
//! mount = "on-flange"          # as for pixels
//! poses = ["arm.csv"]          # with the time of each row, or as many rows as there are sights
//! convention = "ros"
//!
//! [sights]
//! poses = ["tracker.csv"]      # rig_from_target; with `:inverse` where the camera is given in the target's frame
//! convention = "ros:inverse"
//! ```
//!
//! A target on a positioner has `joints` in place of `[robot]`'s poses, a table with `j1_rad,j2_rad,...` or
//! `_deg`, the joint nearest to the base first; or `[sights]` has `measurements`, the YAML of Industrial
//! Calibration, which holds both.

use std::path::{Path, PathBuf};

use boresight_data::{Mounting, PoseConvention};
use boresight_geometry::nalgebra::Quaternion;
use boresight_geometry::{Pose, UnitQuaternion, Vector3};
use serde::Deserialize;

use crate::file_storage::{Node, Value, read_file_storage};
use crate::job::{JOB_FILE, hash, read};
use crate::pose_table::read_pose_table;
use crate::robot_input::{RobotOverrides, mounting};
use crate::robot_job::read_robot_job;
use crate::robot_table::RobotTable;
use crate::{Error, Place};

/// A pose with the time at which it was taken, where the table says.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimedPose {
    /// The time in seconds, by the clock of whoever wrote it.
    pub time_s: Option<f64>,
    /// The pose: `base_from_flange` of a robot, `cam_from_target` of a camera.
    pub fixed_from_moving: Pose,
}

/// What a robot said.
#[derive(Clone, Debug, PartialEq)]
pub enum RobotRows {
    /// Poses of its flange, `base_from_flange`.
    Poses(Vec<TimedPose>),
    /// The readings of its joints, in radians, the one nearest to the base first.
    Joints(Vec<Vec<f64>>),
}

/// A hand-eye job of poses that were seen.
#[derive(Clone, Debug, PartialEq)]
pub struct SightsJob {
    /// Where the cameras are; `None` if the job does not say.
    pub mounting: Option<Mounting>,
    /// What the robot said.
    pub robot: RobotRows,
    /// Where the target was seen, `rig_from_target`.
    pub sights: Vec<TimedPose>,
    /// Each file that was read as it was named, with the blake3 hash of its bytes in hexadecimal.
    pub inputs: Vec<(String, String)>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct OfRobot {
    mount: Option<String>,
    #[serde(default)]
    poses: Vec<String>,
    convention: Option<String>,
    joints: Option<String>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct OfSights {
    #[serde(default)]
    poses: Vec<String>,
    convention: Option<String>,
    measurements: Option<String>,
}

/// Reads a job that has a table `[sights]`; `None` of any other.
pub fn read_sights_job(path: &Path, overrides: &RobotOverrides) -> Result<Option<SightsJob>, Error> {
    let file = if path.is_dir() { path.join(JOB_FILE) } else { path.to_owned() };
    let is_job = file.extension().is_some_and(|extension| extension == "toml") && file.is_file();
    if !is_job || !has_sights(&file)? {
        return Ok(None);
    }
    let of_sights = read_robot_job::<OfSights>(&file, "sights")?;
    let has_robot = of_sights.table.measurements.is_none();
    let of_robot =
        if has_robot { read_robot_job::<OfRobot>(&file, "robot")?.table } else { OfRobot::default() };
    let place = Place::file(file.display().to_string());
    let mut reader = Reader { folder: of_sights.folder, place, inputs: vec![of_sights.input] };
    let config = |message: &str, fix: &str| Error::Config {
        place: Place::file(file.display().to_string()),
        message: message.to_owned(),
        fix: Some(fix.to_owned()),
    };
    if let Some(name) = of_sights.table.measurements {
        let (readings, sights) = reader.measurements(&name)?;
        let robot = RobotRows::Joints(readings);
        return Ok(Some(SightsJob { mounting: None, robot, sights, inputs: reader.inputs }));
    }
    let sights = reader.poses(&named(&of_sights.table.poses), of_sights.table.convention.as_deref(), None)?;
    if sights.is_empty() {
        let fix = "name the table of where the target was seen: poses = [\"tracker.csv\"]";
        return Err(config("[sights] names no poses", fix));
    }
    let stated = of_robot.mount.as_ref().map(|word| mounting(word, &reader.place)).transpose()?;
    let mounting = overrides.mounting.or(stated);
    let robot = match &of_robot.joints {
        Some(name) if overrides.poses.is_empty() => RobotRows::Joints(reader.joints(name)?),
        _ => {
            let files = if overrides.poses.is_empty() {
                named(&of_robot.poses)
            } else {
                overrides.poses.iter().map(|path| (path.display().to_string(), Some(path.clone()))).collect()
            };
            let rows = reader.poses(&files, of_robot.convention.as_deref(), overrides.convention)?;
            if rows.is_empty() {
                let fix =
                    "name the table of the robot's poses: poses = [\"arm.csv\"], or joints = \"joints.csv\"";
                return Err(config("[robot] names neither poses nor joints", fix));
            }
            RobotRows::Poses(rows)
        }
    };
    Ok(Some(SightsJob { mounting, robot, sights, inputs: reader.inputs }))
}

/// Tells whether a job file has a table `[sights]`; a file that is no job is left to others to tell of.
fn has_sights(file: &Path) -> Result<bool, Error> {
    let bytes = read(file)?;
    let text = String::from_utf8_lossy(&bytes);
    Ok(toml::from_str::<toml::Table>(&text).is_ok_and(|tables| tables.contains_key("sights")))
}

/// Names of files, with their paths where these are not relative to the job.
type Named = Vec<(String, Option<PathBuf>)>;

fn named(files: &[String]) -> Named {
    files.iter().map(|name| (name.clone(), None)).collect()
}

struct Reader {
    folder: PathBuf,
    place: Place,
    inputs: Vec<(String, String)>,
}

impl Reader {
    /// Returns the bytes of a file, and how it is named in errors.
    fn bytes(&mut self, name: &str, path: Option<&PathBuf>) -> Result<(Vec<u8>, String), Error> {
        let path = path.cloned().unwrap_or_else(|| self.folder.join(name));
        let bytes = read(&path)?;
        self.inputs.push((name.to_owned(), hash(&bytes)));
        Ok((bytes, path.display().to_string()))
    }

    fn config(&self, message: String, fix: &str) -> Error {
        Error::Config { place: self.place.clone(), message, fix: Some(fix.to_owned()) }
    }

    /// Reads tables of poses, one after another.
    fn poses(
        &mut self,
        files: &Named,
        stated: Option<&str>,
        said: Option<PoseConvention>,
    ) -> Result<Vec<TimedPose>, Error> {
        let stated = stated.map(|text| text.parse::<PoseConvention>()).transpose();
        let stated = stated.map_err(|error| self.config(error.to_string(), "mend `convention`"))?;
        let mut poses = Vec::new();
        for (name, path) in files {
            let (bytes, file) = self.bytes(name, path.as_ref())?;
            let table = read_pose_table(&file, &bytes)?;
            let convention = table.read_as(said.or(stated)).ok_or_else(|| {
                let message = format!("{name} does not say what its angles mean");
                self.config(message, "add convention = \"kuka-abc\" (or another) beside it")
            })?;
            for (i, row) in table.rows.iter().enumerate() {
                let pose = convention.base_from_flange(row).ok_or_else(|| Error::Malformed {
                    place: Place::file(&file),
                    found: format!("row {} is no pose read as {convention}", i + 1),
                    need: "check `convention`: the unit of angles, the kind and order of the numbers",
                })?;
                poses.push(TimedPose { time_s: row.time_s, fixed_from_moving: pose });
            }
        }
        Ok(poses)
    }

    /// Reads a table of joints.
    fn joints(&mut self, name: &str) -> Result<Vec<Vec<f64>>, Error> {
        const NAMES: [&str; 7] = ["j1", "j2", "j3", "j4", "j5", "j6", "j7"];
        let (bytes, file) = self.bytes(name, None)?;
        let table = RobotTable::from_bytes(&file, &bytes)?;
        let is_joint = |column: &str| {
            let mut units = column.strip_suffix("_rad").or(column.strip_suffix("_deg")).into_iter();
            units.any(|name| NAMES.contains(&name))
        };
        if let Some(column) = table.columns().iter().find(|name| name.starts_with('j') && !is_joint(name)) {
            return Err(Error::Malformed {
                place: Place::file(&file),
                found: format!("there is a column `{column}`"),
                need: "joints are in columns j1_deg or j1_rad, j2_deg or j2_rad, and so on to j7",
            });
        }
        // All up to the last that is there are asked for, and of none the first, so that the error says what is missing.
        let last = NAMES.iter().rposition(|name| table.has(name)).unwrap_or(0);
        let names = &NAMES[..=last];
        let columns: Vec<Vec<Option<f64>>> =
            names.iter().map(|name| table.angles_rad(name)).collect::<Result<_, _>>()?;
        let reading = |row: usize| {
            let one = |(column, name): (&Vec<Option<f64>>, &&str)| {
                column[row].ok_or_else(|| table.missing(row, name))
            };
            columns.iter().zip(names).map(one).collect::<Result<Vec<f64>, Error>>()
        };
        (0..table.len()).map(reading).collect()
    }

    /// Reads the measurements of Industrial Calibration's kinematic example: joints and a pose for each time.
    fn measurements(&mut self, name: &str) -> Result<(Vec<Vec<f64>>, Vec<TimedPose>), Error> {
        let (bytes, file) = self.bytes(name, None)?;
        let root = read_file_storage(&file, &bytes)?;
        let malformed = |line: usize, found: String| Error::Malformed {
            place: Place::line(&file, line),
            found,
            need: "a measurement has pose: {x, y, z, qx, qy, qz, qw}, target_joints and empty camera_joints",
        };
        let Value::Map(entries) = &root.value else {
            return Err(malformed(root.line, "no map is there".to_owned()));
        };
        let (mut readings, mut sights) = (Vec::new(), Vec::new());
        for (time, node) in entries {
            let list = |key: &str| match node.get(key).map(|node| &node.value) {
                Some(Value::List(items)) => items.iter().map(Node::number).collect::<Option<Vec<f64>>>(),
                _ => None,
            };
            let lacks = |key: &str| malformed(node.line, format!("measurement {time} lacks {key}"));
            if list("camera_joints").is_some_and(|joints| !joints.is_empty()) {
                return Err(malformed(node.line, format!("measurement {time} has joints of the camera")));
            }
            let joints = list("target_joints").ok_or_else(|| lacks("target_joints"))?;
            let number = |key: &str| {
                let number = node.get("pose").and_then(|pose| pose.get(key)).and_then(Node::number);
                number.filter(|number| number.is_finite()).ok_or_else(|| lacks(key))
            };
            let quaternion = Quaternion::new(number("qw")?, number("qx")?, number("qy")?, number("qz")?);
            let rotation = UnitQuaternion::try_new(quaternion, 0.5)
                .ok_or_else(|| malformed(node.line, format!("the quaternion of {time} is none")))?;
            let translation = Vector3::new(number("x")?, number("y")?, number("z")?);
            let time_s = time.parse::<f64>().ok().filter(|time_s| time_s.is_finite());
            readings.push(joints);
            sights.push(TimedPose { time_s, fixed_from_moving: Pose::new(rotation, translation) });
        }
        if sights.is_empty() {
            return Err(Error::Empty { file });
        }
        Ok((readings, sights))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn job(files: &[(&str, &str)]) -> Result<Option<SightsJob>, Error> {
        let folder = tempfile::tempdir().unwrap();
        for (name, text) in files {
            std::fs::write(folder.path().join(name), text).unwrap();
        }
        read_sights_job(folder.path(), &RobotOverrides::default())
    }

    const ARM: (&str, &str) = ("arm.csv", "1.5,1,2,3,0,0,0,1\n2.5,1,2,4,0,0,0,1\n");
    const SEEN: (&str, &str) = ("seen.csv", "1.4,0,0,1,0,0,0,1\n2.4,0,0,2,0,0,0,1\n");

    #[test]
    fn poses_with_times_are_read() {
        let text = "[robot]\nmount = \"fixed\"\nposes = [\"arm.csv\"]\n[sights]\nposes = [\"seen.csv\"]\nconvention = \"ros:inverse\"\n";
        let found = job(&[(JOB_FILE, text), ARM, SEEN]).unwrap().unwrap();
        assert_eq!(found.mounting, Some(Mounting::RigInBase));
        assert_eq!(
            (found.sights[1].time_s, found.sights[1].fixed_from_moving.translation.z),
            (Some(2.4), -2.0)
        );
        let RobotRows::Poses(rows) = &found.robot else { panic!("{:?}", found.robot) };
        assert_eq!(
            (rows.len(), rows[1].time_s, rows[1].fixed_from_moving.translation.z),
            (2, Some(2.5), 4.0)
        );
        assert_eq!(found.inputs.len(), 3);
        assert_eq!(job(&[(JOB_FILE, "[robot]\nposes = [\"arm.csv\"]\n"), ARM]).unwrap(), None);
        // A folder of images is a job without a file.
        assert_eq!(job(&[ARM]).unwrap(), None);
    }

    #[test]
    fn joints_are_read_from_a_table_or_from_measurements() {
        let text = "[robot]\njoints = \"joints.csv\"\n[sights]\nposes = [\"seen.csv\"]\n";
        let joints = ("joints.csv", "j1_deg,j2_rad\n180,0.5\n90,0.25\n");
        let found = job(&[(JOB_FILE, text), joints, SEEN]).unwrap().unwrap();
        let RobotRows::Joints(rows) = &found.robot else { panic!("{:?}", found.robot) };
        assert!((rows[0][0] - std::f64::consts::PI).abs() < 1e-15 && rows[1][1] == 0.25, "{rows:?}");
        let yaml = "'1593701755':\n  camera_joints: []\n  pose:\n    qw: 1.0\n    qx: 0.0\n    qy: 0\n    qz: 0\n    x: -0.5\n    y: 1\n    z: 2\n  target_joints:\n  - -0.25\n  - 0.5\n";
        let text = "[sights]\nmeasurements = \"m.yaml\"\n";
        let found = job(&[(JOB_FILE, text), ("m.yaml", yaml)]).unwrap().unwrap();
        assert_eq!(found.robot, RobotRows::Joints(vec![vec![-0.25, 0.5]]));
        assert_eq!(
            (found.sights[0].fixed_from_moving.translation.x, found.sights[0].time_s),
            (-0.5, Some(1593701755.0))
        );
    }

    #[test]
    fn mistakes_are_named() {
        let robot = "[robot]\nposes = [\"arm.csv\"]\n";
        let sights = "[sights]\nposes = [\"seen.csv\"]\n";
        for (text, seen, part) in [
            (sights.to_owned(), SEEN, "no table [robot]"),
            (format!("{robot}[sights]\n"), SEEN, "[sights] names no poses"),
            (format!("[robot]\n{sights}"), SEEN, "[robot] names neither poses nor joints"),
            (format!("{robot}{sights}convention = \"abc\"\n"), SEEN, "`abc` is no convention"),
            (format!("{robot}{sights}"), ("seen.csv", "0,0,1,0,0,0,0\n"), "row 1 is no pose"),
            (
                format!("{robot}{sights}"),
                ("seen.csv", "x_m,y_m,z_m,a_deg,b_deg,c_deg\n1,2,3,4,5,6\n"),
                "what its angles mean",
            ),
        ] {
            let error = job(&[(JOB_FILE, &text), ARM, seen]).unwrap_err().to_string();
            assert!(error.contains(part), "`{part}` is not in: {error}");
        }
        let text = "[sights]\nmeasurements = \"m.yaml\"\n";
        let error = job(&[(JOB_FILE, text), ("m.yaml", "'1':\n  target_joints: [1]\n")]).unwrap_err();
        assert!(error.to_string().contains("measurement 1 lacks qw"), "{error}");
    }
}
