//! A robot command's table of a job file: `[locate]`, `[plane]`, `[pose]` and their like.

use std::path::{Path, PathBuf};

use serde::de::DeserializeOwned;

use crate::error::Place;
use crate::job::{JOB_FILE, hash, read};
use crate::{Error, job_file};

/// One command's table of a job file.
#[derive(Clone, Debug, PartialEq)]
pub struct RobotJob<T> {
    /// What the table says.
    pub table: T,
    /// The folder of the job file, to which the files it names are relative.
    pub folder: PathBuf,
    /// The job file as it was named, with the blake3 hash of its bytes in hexadecimal.
    pub input: (String, String),
}

/// Reads the table `key` of a job file, or of the `boresight.toml` of a folder.
pub fn read_robot_job<T: DeserializeOwned>(path: &Path, key: &'static str) -> Result<RobotJob<T>, Error> {
    let file = if path.is_dir() { path.join(JOB_FILE) } else { path.to_owned() };
    let bytes = read(&file)?;
    let name = file.display().to_string();
    let wrong =
        |message: String, fix: Option<String>| Error::Config { place: Place::file(&name), message, fix };
    let text = std::str::from_utf8(&bytes).map_err(|_| wrong("the text is not UTF-8".to_owned(), None))?;
    let mut tables: toml::Table =
        toml::from_str(text).map_err(|error| job_file::explain(&name, &bytes, &error))?;
    let table = tables.remove(key).ok_or_else(|| {
        let fix = format!("add a table [{key}] to it, or name another job");
        wrong(format!("the job has no table [{key}]"), Some(fix))
    })?;
    let line = text.lines().position(|line| line.trim() == format!("[{key}]")).map(|line| line + 1);
    let table = T::deserialize(table).map_err(|error| Error::Config {
        place: Place { file: name.clone(), line },
        message: format!("[{key}]: {}", error.message()),
        fix: None,
    })?;
    let folder = file.parent().unwrap_or(Path::new("")).to_owned();
    Ok(RobotJob { table, folder, input: (job_file::name_of(&file), hash(&bytes)) })
}

#[cfg(test)]
mod tests {
    use serde::Deserialize;

    use super::*;

    #[derive(Debug, Deserialize, PartialEq)]
    #[serde(deny_unknown_fields)]
    struct Table {
        points: String,
    }

    #[test]
    fn tables_are_read_by_name() {
        let folder = tempfile::tempdir().unwrap();
        let job = folder.path().join(JOB_FILE);
        std::fs::write(&job, "[locate]\npoints = \"p.csv\"\n[other]\nx = 1\n").unwrap();
        let found = read_robot_job::<Table>(folder.path(), "locate").unwrap();
        assert_eq!((found.table.points.as_str(), found.folder.as_path()), ("p.csv", folder.path()));
        let error = read_robot_job::<Table>(&job, "plane").unwrap_err();
        assert!(error.to_string().contains("no table [plane]"), "{error}");
        let error = read_robot_job::<Table>(&job, "other").unwrap_err();
        assert!(error.to_string().contains("boresight.toml:3: [other]: unknown field `x`"), "{error}");
    }
}
