//! What a calibration leaves on disk, and figures that are read off it.

use std::path::Path;

use boresight_io::{OutputFile, calibration_to_json, matrices_to_text, observations_to_parquet, write_files};

use crate::calibrate::Outcome;
use crate::error::Error;

/// The names of the files that [`write_results`] writes.
pub const RESULT_FILES: [&str; 3] = ["calibration.json", "observations.parquet", "h-matrix.txt"];

/// Returns the files of an outcome: the calibration, every corner with its residual, and the matrices.
pub fn result_files(outcome: &Outcome) -> Result<Vec<OutputFile>, Error> {
    let Outcome { calibration, dataset, findings, .. } = outcome;
    let contents = [
        calibration_to_json(calibration, findings)?,
        observations_to_parquet(dataset, calibration)?,
        matrices_to_text(calibration).into_bytes(),
    ];
    let files = RESULT_FILES.iter().zip(contents);
    Ok(files.map(|(name, bytes)| OutputFile { name: (*name).to_owned(), bytes }).collect())
}

/// Writes the files of an outcome to `folder`, which is made if it does not exist.
///
/// All are made before the first is written, and each appears whole or not at all.
pub fn write_results(outcome: &Outcome, folder: &Path) -> Result<(), Error> {
    Ok(write_files(folder, &result_files(outcome)?)?)
}

#[cfg(test)]
mod tests {
    use boresight_io::{JobOverrides, load_job, read_calibration};
    use boresight_validate::Verdict;

    use super::*;
    use crate::{CalibrateOptions, Watch, calibrate};

    #[test]
    fn the_recorded_stereo_pair_is_calibrated_written_and_read_back() {
        let dataset = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../datasets/opencv-stereo");
        let job = load_job(&[dataset], &JobOverrides::default()).unwrap();
        let options = CalibrateOptions::of_job(&job).unwrap();
        let outcome = calibrate(&job, &options, &Watch::default()).unwrap();
        assert!(outcome.calibration.solve.converged, "{}", outcome.calibration.solve.stop);
        assert_ne!(outcome.verdict, Verdict::Fail, "{:?}", outcome.findings);
        assert_eq!(outcome.left_out, Vec::<String>::new());
        let sigma = outcome.calibration.uncertainty.sigma("left.fx").unwrap();
        assert!(sigma > 0.01 && sigma < 5.0, "{sigma}");
        assert_eq!(outcome.calibration.uncertainty.sigma("left.fz"), None);

        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("out");
        write_results(&outcome, &out).unwrap();
        let mut names: Vec<String> = std::fs::read_dir(&out)
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        assert_eq!(names, ["calibration.json", "h-matrix.txt", "observations.parquet"]);
        let (again, findings) = read_calibration(&out).unwrap();
        assert_eq!(again.scene, outcome.calibration.scene);
        assert_eq!(again.provenance, outcome.calibration.provenance);
        assert_eq!(findings, outcome.findings);
    }
}
