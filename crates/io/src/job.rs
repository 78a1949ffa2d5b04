//! Loading a job: a job file or bare corner files become a dataset, options and hashes of the inputs.

use std::path::{Path, PathBuf};

use boresight_camera::Camera;
use boresight_data::{Calibration, Dataset, Finding, Target};

use crate::assemble::{CameraSpec, assemble};
use crate::calibration_json::calibration_from_json;
use crate::format::corner_reader;
use crate::image_names::Listed;
use crate::job_file::{Board, JobFile, TargetDescription, name_of, read_job_file, read_points};
use crate::recording::RecordingOptions;
use crate::robot_input::{RobotInput, RobotOverrides, frame_times, load_robot};
use crate::seen::SeenFile;
use crate::{Error, Place};

/// The name of the job file in a dataset's folder.
pub const JOB_FILE: &str = "boresight.toml";

/// A job, ready to be calibrated.
#[derive(Clone, Debug)]
pub struct Job {
    /// What was seen.
    pub dataset: Dataset,
    /// The job file's `[options]`, which the pipeline reads; empty without a job file.
    pub options: toml::Table,
    /// The line of the job file on which `[options]` begins, with the file, for error messages.
    pub options_place: Option<Place>,
    /// Each input file as it was named, with the blake3 hash of its bytes in hexadecimal.
    pub inputs: Vec<(String, String)>,
    /// What was noticed while reading.
    pub findings: Vec<Finding>,
    /// The robot, where the job has one; its poses are in the dataset's frames.
    pub robot: Option<RobotInput>,
    /// The lenses that are known and shall not be estimated, by camera.
    pub known_lenses: Vec<(String, Camera)>,
}

impl From<Dataset> for Job {
    /// Returns the job of a dataset that comes from no file: without options, inputs, robot or known lenses.
    fn from(dataset: Dataset) -> Self {
        Self {
            dataset,
            options: toml::Table::new(),
            options_place: None,
            inputs: Vec::new(),
            findings: Vec::new(),
            robot: None,
            known_lenses: Vec::new(),
        }
    }
}

/// What the command line says in place of a job file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct JobOverrides {
    /// The target; `None` takes the job file's.
    pub target: Option<Target>,
    /// Width and height of the image of every camera in pixels; `None` takes the job file's.
    pub image_size: Option<[u32; 2]>,
    /// The standard deviation of a corner in pixels, of level 0 or weight 1; `None` takes the job file's, or 1.
    pub sigma_px: Option<f64>,
    /// What replaces the job's `[robot]`.
    pub robot: RobotOverrides,
    /// Names of cameras with patterns of the names of their images; empty takes the job file's cameras.
    pub cameras: Vec<(String, String)>,
    /// How recordings are read, in place of what the job says.
    pub recording: RecordingOptions,
}

/// Loads a job from `inputs`: a folder with a `boresight.toml`, a job file, corner files, or a job and corner files.
///
/// Corner files beside a job take the place of those that the job names.
pub fn load_job(inputs: &[PathBuf], overrides: &JobOverrides) -> Result<Job, Error> {
    let Head { folder, job, options_place, target, mut hashes, place, others: corner_files } =
        head(inputs, overrides)?;
    let sigma_px = overrides.sigma_px.or(job.sigma_px).unwrap_or(1.0);
    if !(1e-6..=1e3).contains(&sigma_px) {
        let message =
            format!("sigma_px is {sigma_px}: the standard deviation of a corner in pixels must be positive");
        return Err(config(Path::new("options"), message, "leave it out for 1 px"));
    }

    let named: Vec<(String, PathBuf)> = if corner_files.is_empty() {
        job.corners.into_iter().map(|name| (name.clone(), folder.join(name))).collect()
    } else {
        corner_files.into_iter().map(|path| (path.display().to_string(), path.clone())).collect()
    };
    if named.is_empty() {
        let fix = "add [input] corners = [\"corners.csv\"] to the job, or name corner files (.csv or .vnl)";
        return Err(config(&place, "there are no corner files".to_owned(), fix));
    }
    let mut files = Vec::new();
    for (name, path) in named {
        files.push(read_corner_file(name, &path, &target, sigma_px, &mut hashes)?);
    }
    let targets = read_boards(&folder, job.boards, target, sigma_px, &mut files, &mut hashes)?;
    let mut cameras = job.cameras;
    if let Some((camera, pattern)) = overrides.cameras.first()
        && let Some(named) = files.iter().find(|file| file.views.iter().all(|view| view.camera.is_some()))
    {
        let message = format!("it says itself which camera saw what: {camera}={pattern} would say it again");
        return Err(config(Path::new(&named.file), message, "leave --camera out"));
    }
    if !overrides.cameras.is_empty() {
        cameras = named_cameras(&cameras, overrides)?;
    } else if let Some(image_size) = overrides.image_size {
        cameras.iter_mut().for_each(|camera| camera.image_size = image_size);
    }
    let (mut dataset, findings) = assemble(files, &cameras, overrides.image_size, targets)?;
    set_times(&folder, job.frame_times.as_deref(), &mut dataset, &mut hashes)?;
    let robot = robot_of(&folder, job.robot.as_ref(), &overrides.robot, &mut dataset, &mut hashes)?;
    let known_lenses = job.known_lenses;
    Ok(Job { dataset, options: job.options, options_place, inputs: hashes, findings, robot, known_lenses })
}

/// Reads a file of corners of a target.
fn read_corner_file(
    name: String,
    path: &Path,
    target: &Target,
    sigma_px: f64,
    hashes: &mut Vec<(String, String)>,
) -> Result<SeenFile, Error> {
    let bytes = read(path)?;
    hashes.push((name, hash(&bytes)));
    let extension = path.extension().map(|extension| extension.to_string_lossy().to_lowercase());
    let Some(read_corners) = extension.and_then(|extension| corner_reader(&extension)) else {
        return Err(config(path, "this is no corner file".to_owned(), "corner files end in .csv or .vnl"));
    };
    read_corners(&path.display().to_string(), &bytes, target, sigma_px)
}

/// Reads the corners of the boards beside the first target, and returns all targets.
fn read_boards(
    folder: &Path,
    boards: Vec<Board>,
    first: Target,
    sigma_px: f64,
    files: &mut Vec<SeenFile>,
    hashes: &mut Vec<(String, String)>,
) -> Result<Vec<Target>, Error> {
    let mut targets = vec![first];
    for Board { name, target, corners } in boards {
        let target = described(folder, target, hashes)?;
        let target = Target { name, ..target };
        for name in corners {
            let path = folder.join(&name);
            let file = read_corner_file(name, &path, &target, sigma_px, hashes)?;
            files.push(SeenFile { target_idx: targets.len(), ..file });
        }
        targets.push(target);
    }
    Ok(targets)
}

/// Returns a target as it is described, its points read where they are in a file.
fn described(
    folder: &Path,
    description: TargetDescription,
    hashes: &mut Vec<(String, String)>,
) -> Result<Target, Error> {
    match description {
        TargetDescription::Here(target) => Ok(target),
        TargetDescription::Points(name) => {
            let path = folder.join(&name);
            let bytes = read(&path)?;
            hashes.push((name, hash(&bytes)));
            read_points(&path.display().to_string(), &bytes)
        }
    }
}

/// Returns the cameras that the command line names in place of the job's, with the sizes of their images.
fn named_cameras(of_job: &[CameraSpec], overrides: &JobOverrides) -> Result<Vec<CameraSpec>, Error> {
    let named = overrides.cameras.iter().map(|(name, pattern)| {
        let of_job = of_job.iter().find(|camera| camera.listed.name == *name).map(|camera| camera.image_size);
        let image_size = overrides.image_size.or(of_job);
        let image_size = image_size.ok_or_else(|| Error::NoImageSize { camera: name.clone() })?;
        let listed = Listed { name: name.clone(), images: Some(pattern.clone()) };
        Ok(CameraSpec { listed, image_size })
    });
    named.collect()
}

/// Gives the frames the times that a file tells, if the job names one.
pub(crate) fn set_times(
    folder: &Path,
    name: Option<&str>,
    dataset: &mut Dataset,
    hashes: &mut Vec<(String, String)>,
) -> Result<(), Error> {
    let Some(name) = name else { return Ok(()) };
    let path = folder.join(name);
    let bytes = read(&path)?;
    hashes.push((name.to_owned(), hash(&bytes)));
    let file = path.display().to_string();
    let times_s = frame_times(&file, &bytes, dataset, &Place::file(&file))?;
    for (frame, time_s) in dataset.frames.iter_mut().zip(times_s) {
        // A number of seconds that is too large for nanoseconds is taken as the largest there is.
        frame.time_ns = time_s.map(|time_s| (1e9 * time_s).round() as i64);
    }
    Ok(())
}

/// Reads what the job says of a robot, if it has one, and gives the frames their robot poses.
pub(crate) fn robot_of(
    folder: &Path,
    said: Option<&(crate::robot_input::RobotTable, Place)>,
    overrides: &RobotOverrides,
    dataset: &mut Dataset,
    hashes: &mut Vec<(String, String)>,
) -> Result<Option<RobotInput>, Error> {
    let place = said.map_or_else(|| Place::file("--poses"), |(_, place)| place.clone());
    let table = said.map(|(table, _)| table);
    let robot = load_robot(folder, table, &place, overrides, dataset)?;
    Ok(robot.map(|(robot, mut read)| {
        hashes.append(&mut read);
        robot
    }))
}

/// What a job says before its corners are known.
pub(crate) struct Head {
    /// The folder of the job file; empty without one.
    pub folder: PathBuf,
    pub job: JobFile,
    pub options_place: Option<Place>,
    pub target: Target,
    /// The files read so far, with their hashes.
    pub hashes: Vec<(String, String)>,
    /// What errors about the whole input name.
    pub place: PathBuf,
    /// The inputs that are no job.
    pub others: Vec<PathBuf>,
}

impl Head {
    /// Returns the cameras that the job lists, or those that were named with patterns in their place.
    pub fn listed(&self, named: &[(String, String)]) -> Vec<Listed> {
        if named.is_empty() {
            return self.job.cameras.iter().map(|spec| spec.listed.clone()).collect();
        }
        let listed =
            |(name, pattern): &(String, String)| Listed { name: name.clone(), images: Some(pattern.clone()) };
        named.iter().map(listed).collect()
    }
}

/// Reads the job file among `inputs`, if there is one, and the target.
pub(crate) fn head(inputs: &[PathBuf], overrides: &JobOverrides) -> Result<Head, Error> {
    let (jobs, others): (Vec<PathBuf>, Vec<PathBuf>) = inputs
        .iter()
        .cloned()
        .partition(|path| path.is_dir() || path.extension().is_some_and(|extension| extension == "toml"));
    let place = jobs.first().or(others.first()).cloned().unwrap_or_else(|| PathBuf::from("the input"));
    let mut hashes = Vec::new();
    let (folder, mut job, options_place) = match &jobs[..] {
        [] => (PathBuf::new(), JobFile::default(), None),
        [path] => {
            let path = if path.is_dir() { find_job_file(path)? } else { path.clone() };
            let bytes = read(&path)?;
            hashes.push((name_of(&path), hash(&bytes)));
            let file = path.display().to_string();
            let job = read_job_file(&file, &bytes)?;
            let line = bytes
                .split(|&byte| byte == b'\n')
                .position(|line| line.trim_ascii().starts_with(b"[options]"));
            let place = line.map(|line| Place::line(&file, line + 1));
            (path.parent().unwrap_or(Path::new("")).to_owned(), job, place)
        }
        [first, second, ..] => {
            let message = format!("{} is a second job beside {}", second.display(), first.display());
            return Err(config(second, message, "calibrate one job at a time"));
        }
    };

    let target = match (&overrides.target, job.target.take()) {
        (Some(target), _) => target.clone(),
        (None, Some(description)) => described(&folder, description, &mut hashes)?,
        (None, None) => {
            let fix = "add --target chessboard:COLUMNSxROWS:SPACING, such as chessboard:9x6:25mm, or a [target] to the job";
            return Err(config(&place, "the target is not known".to_owned(), fix));
        }
    };
    Ok(Head { folder, job, options_place, target, hashes, place, others })
}

/// Reads the head of a job beside images or recordings, the first of which is `first`; `others` are the other inputs.
pub(crate) fn head_beside(
    what: &str,
    first: &Path,
    others: &[PathBuf],
    overrides: &JobOverrides,
) -> Result<Head, Error> {
    let head = head(others, overrides).map_err(|error| match error {
        Error::Config { message, fix, .. } if others.is_empty() => {
            config(first, message, fix.as_deref().unwrap_or_default())
        }
        error => error,
    })?;
    match head.others.first() {
        None => Ok(head),
        Some(other) => {
            let message = format!("it is neither {what} nor job, beside {what}s");
            let fix = "calibrate from images, recordings or corners, one at a time";
            Err(config(other, message, fix))
        }
    }
}

/// The files that a job names in its `[input]`.
#[derive(Default)]
pub(crate) struct NamedInputs {
    pub images: Vec<PathBuf>,
    pub recordings: Vec<PathBuf>,
}

/// Returns the images and the recordings that the job file among `inputs` names; none where there is no job file.
pub(crate) fn named_inputs(inputs: &[PathBuf]) -> Result<NamedInputs, Error> {
    let mut named = NamedInputs::default();
    for path in inputs {
        let path = if path.is_dir() { path.join(JOB_FILE) } else { path.clone() };
        if path.extension().is_none_or(|extension| extension != "toml") || !path.is_file() {
            continue;
        }
        let job = read_job_file(&path.display().to_string(), &read(&path)?)?;
        let folder = path.parent().unwrap_or(Path::new(""));
        named.images.extend(job.images.iter().map(|name| folder.join(name)));
        named.recordings.extend(job.recordings.iter().map(|name| folder.join(name)));
    }
    Ok(named)
}

/// Returns the blake3 hash of `bytes` in hexadecimal.
pub fn hash(bytes: &[u8]) -> String {
    blake3::hash(bytes).to_hex().to_string()
}

/// Reads a `calibration.json`, or that in a folder, with its findings and without the residuals of the corners.
pub fn read_calibration(path: &Path) -> Result<(Calibration, Vec<Finding>), Error> {
    let path = if path.is_dir() { path.join("calibration.json") } else { path.to_owned() };
    calibration_from_json(&path.display().to_string(), &read(&path)?)
}

/// Returns the bytes of a file.
pub(crate) fn read(path: &Path) -> Result<Vec<u8>, Error> {
    std::fs::read(path).map_err(|source| Error::Read { file: path.display().to_string(), source })
}

fn find_job_file(folder: &Path) -> Result<PathBuf, Error> {
    let path = folder.join(JOB_FILE);
    if path.is_file() {
        return Ok(path);
    }
    let message = format!("the folder has no {JOB_FILE} and no images");
    Err(config(folder, message, "name its corner files or images and --target, or write a job file"))
}

pub(crate) fn config(path: &Path, message: String, fix: &str) -> Error {
    Error::Config { place: Place::file(path.display().to_string()), message, fix: Some(fix.to_owned()) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Kind;

    const JOB: &str = r#"
[target]
kind = "chessboard"
columns = 3
rows = 2
spacing_m = 0.1
[[camera]]
name = "left"
image_size = [640, 480]
[input]
corners = ["corners.csv"]
[options]
model = "pinhole"
"#;

    fn folder(files: &[(&str, &str)]) -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        for (name, text) in files {
            std::fs::write(folder.path().join(name), text).unwrap();
        }
        folder
    }

    fn vnl(n: usize) -> String {
        let rows: String = (0..n).map(|i| format!("left1.png {i} {i} 0\n")).collect();
        format!("# filename x y level\n{rows}")
    }

    #[test]
    fn a_folder_is_loaded_and_corner_files_beside_it_take_over() {
        let csv = "camera,view,point,u,v\nleft,1,0,5,6\n";
        let folder = folder(&[(JOB_FILE, JOB), ("corners.csv", csv), ("other.vnl", &vnl(6))]);
        let job = load_job(&[folder.path().to_owned()], &JobOverrides::default()).unwrap();
        assert_eq!(job.dataset.observation_count(), 1);
        assert_eq!(job.options["model"].as_str(), Some("pinhole"));
        assert_eq!(job.options_place.unwrap().line, Some(12));
        let names: Vec<&str> = job.inputs.iter().map(|(name, _)| name.as_str()).collect();
        assert_eq!(names, [JOB_FILE, "corners.csv"]);
        assert_eq!(job.inputs[1].1, hash(csv.as_bytes()));

        let inputs = [folder.path().join(JOB_FILE), folder.path().join("other.vnl")];
        let job = load_job(&inputs, &JobOverrides::default()).unwrap();
        assert_eq!(job.dataset.observation_count(), 6);
        assert_eq!(job.dataset.frames.as_slice()[0].name, "left1");

        // Patterns of the command line take the place of the job's cameras.
        let cameras = |name: &str| vec![(name.to_owned(), "left*.png".to_owned())];
        let overrides = JobOverrides { cameras: cameras("left"), ..JobOverrides::default() };
        let job = load_job(&inputs, &overrides).unwrap();
        assert_eq!(job.dataset.frames.as_slice()[0].name, "1");
        let overrides = JobOverrides { cameras: cameras("other"), ..JobOverrides::default() };
        assert!(matches!(load_job(&inputs, &overrides), Err(Error::NoImageSize { .. })));
        // Where each line names its camera there is nothing to tell.
        let refused = load_job(&[folder.path().to_owned()], &overrides).unwrap_err();
        assert!(refused.kind() == Kind::Usage && refused.to_string().contains("says itself"), "{refused}");
    }

    #[test]
    fn boards_beside_the_target_have_corners_of_their_own() {
        let board = "[[board]]\nname = \"wall\"\nkind = \"chessboard:4x3:2cm\"\ncorners = [\"wall.csv\"]\n";
        let job = format!("{JOB}{board}");
        let csv = "camera,view,point,u,v\nleft,1,0,5,6\nleft,2,5,5,6\n";
        let wall = "camera,view,point,u,v\nleft,2,11,7,8\nleft,3,0,7,8\n";
        let folder = folder(&[(JOB_FILE, &job), ("corners.csv", csv), ("wall.csv", wall)]);
        let job = load_job(&[folder.path().to_owned()], &JobOverrides::default()).unwrap();
        let names: Vec<&str> = job.dataset.targets.iter().map(|target| target.name.as_str()).collect();
        assert_eq!(names, ["target", "wall"]);
        let views: Vec<(u32, u32)> =
            job.dataset.views.iter().map(|view| (view.frame.0, view.target.0)).collect();
        assert_eq!(views, [(0, 0), (1, 0), (1, 1), (2, 1)]);
        assert_eq!(job.inputs.len(), 3);
        // A board's points are counted by its own size.
        std::fs::write(folder.path().join("wall.csv"), wall.replace(",11,", ",12,")).unwrap();
        let error = load_job(&[folder.path().to_owned()], &JobOverrides::default()).unwrap_err();
        assert!(matches!(error, Error::PointOutOfRange { points: 12, .. }), "{error}");
    }

    #[test]
    fn frames_have_the_times_that_the_job_names() {
        let job = JOB.replace("[options]", "frame_times = \"times.csv\"\n[options]");
        let csv = "camera,view,point,u,v\nleft,1,0,5,6\nleft,2,0,5,6\n";
        let load = |times: &str| {
            let folder = folder(&[(JOB_FILE, &job), ("corners.csv", csv), ("times.csv", times)]);
            load_job(&[folder.path().to_owned()], &JobOverrides::default())
        };
        let job = load("frame,time_s\n1,0.25\n9,7\n").unwrap();
        let times_ns: Vec<Option<i64>> = job.dataset.frames.iter().map(|frame| frame.time_ns).collect();
        assert_eq!(times_ns, [Some(250_000_000), None]);
        assert_eq!(job.inputs.len(), 3);
        assert!(load("frame,time_s\n1,soon\n").unwrap_err().to_string().contains("times.csv:2"));
    }

    #[test]
    fn corner_files_alone_need_a_target_and_an_image_size() {
        let folder = folder(&[("c.vnl", &vnl(6)), ("c.txt", "")]);
        let inputs = [folder.path().join("c.vnl")];
        let fails = |inputs: &[PathBuf], overrides: &JobOverrides| load_job(inputs, overrides).unwrap_err();
        let mut overrides = JobOverrides::default();
        let error = fails(&inputs, &overrides);
        assert_eq!(error.kind(), Kind::Usage);
        assert!(error.hint().unwrap().contains("--target"), "{error}");
        overrides.target = Some(crate::parse_target("chessboard:3x2:5cm").unwrap());
        assert!(matches!(fails(&inputs, &overrides), Error::NoImageSize { .. }));
        overrides.image_size = Some([100, 100]);
        let job = load_job(&inputs, &overrides).unwrap();
        assert_eq!(job.dataset.cameras.as_slice()[0].image_size, [100, 100]);

        assert_eq!(fails(&[folder.path().to_owned()], &overrides).kind(), Kind::Usage);
        assert_eq!(fails(&[folder.path().join("c.txt")], &overrides).kind(), Kind::Usage);
        assert_eq!(fails(&[folder.path().join("gone.csv")], &overrides).kind(), Kind::Input);
        assert_eq!(fails(&[], &overrides).kind(), Kind::Usage);
    }

    #[test]
    fn the_recorded_stereo_pair_is_loaded() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../datasets/opencv-stereo");
        let job = load_job(&[folder], &JobOverrides::default()).unwrap();
        let Dataset { cameras, frames, views, .. } = &job.dataset;
        assert_eq!((cameras.len(), frames.len(), views.len()), (2, 13, 26));
        assert_eq!(job.dataset.observation_count(), 2 * 13 * 54);
        assert!(job.findings.is_empty(), "{:?}", job.findings);
    }

    #[test]
    fn recordings_of_others_are_loaded_where_present() {
        let recorded = |file: &str| crate::samples::shared_file(&format!("datasets/{file}"));
        for (file, target, cameras, frames, views) in [
            ("stereo-opencv-left-right/derived/corners-opencv.vnl", "9x6:25mm", 2, 13, 26),
            ("fisheye-stereo-stereopi/derived/corners-opencv.vnl", "9x6:25mm", 2, 49, 98),
            ("rig3-trinocular-boofcv/derived/corners-opencv.vnl", "13x9:10mm", 3, 27, 79),
            ("rig4-caliscope-4cam/derived/corners-opencv.vnl", "4x3:54mm", 4, 48, 157),
            ("corners-mrcal-figueroa/derived/observations-opencv8.vnl", "10x10:77mm", 1, 186, 186),
            // Two of its 89 images have no board.
            ("corners-mrcal-photonvision2023/raw/corners.vnl", "10x10:58.8mm", 1, 87, 87),
        ] {
            let Some(path) = recorded(file) else { continue };
            let target = Some(crate::parse_target(&format!("chessboard:{target}")).unwrap());
            let overrides =
                JobOverrides { target, image_size: Some([10_000, 10_000]), ..JobOverrides::default() };
            let dataset = load_job(&[path], &overrides).unwrap().dataset;
            let found = (dataset.cameras.len(), dataset.frames.len(), dataset.views.len());
            assert_eq!(found, (cameras, frames, views), "{file}");
        }
        if let Some(drcal) = recorded("corners-stereo-drcal/raw/corners.vnl") {
            let job = "[target]\nkind = \"chessboard\"\ncolumns = 13\nrows = 8\nspacing_m = 0.04\n\
                [[camera]]\nname = \"l\"\nimage_size = [1280, 800]\nimages = \"*_000.png\"\n\
                [[camera]]\nname = \"r\"\nimage_size = [1280, 800]\nimages = \"*_001.png\"\n";
            let folder = folder(&[(JOB_FILE, job)]);
            let dataset =
                load_job(&[folder.path().to_owned(), drcal], &JobOverrides::default()).unwrap().dataset;
            assert_eq!((dataset.cameras.len(), dataset.views.len()), (2, 432));
            // The weight column is a weight: read as a level, it would double the sigma.
            assert!(dataset.views.iter().flat_map(|view| &view.observations).any(|o| o.sigma_px == 1.0));
        }
    }
}
