//! `observations.parquet`: every corner with its residual, and whether it was kept or why not.
//!
//! One row per corner, in the order of the dataset's views. `du_px, dv_px` is predicted minus observed,
//! null where the view was left out; `reason` is null where the corner was kept.
//!
//! The footer holds a blake3 hash of the file (with zeros in its own place): the parquet library trusts
//! its input and panics on a damaged one, so a file is read only if it is whole.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use arrow_array::cast::AsArray as _;
use arrow_array::types::{Float64Type, UInt32Type};
use arrow_array::{Array, ArrayRef, BooleanArray, Float64Array, RecordBatch, StringArray, UInt32Array};
use boresight_data::{Calibration, Dataset, PointId, RejectionReason};
use parquet::arrow::ArrowWriter;
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
use parquet::basic::{Compression, ZstdLevel};
use parquet::file::metadata::KeyValue;
use parquet::file::properties::WriterProperties;

use crate::{Error, Place, hash};

/// The schema of the observations that are written and read.
pub const OBSERVATIONS_SCHEMA: &str = "boresight.observations/1";

const SCHEMA_KEY: &str = "schema";
const HASH_KEY: &str = "hash";
const HASH_MARK: &[u8] = b"blake3:";
const HASH_LENGTH: usize = 64;
const NEED: &str = "an observations.parquet of Boresight is needed";

/// A corner with what became of it.
#[derive(Clone, Debug, PartialEq)]
pub struct ObservationRow {
    /// The view, as an index into the dataset's views.
    pub view: u32,
    /// The camera's name.
    pub camera: String,
    /// The frame's name.
    pub frame: String,
    /// The target's name.
    pub target: String,
    /// The image, where the input named it.
    pub image: Option<String>,
    /// The point of the target.
    pub point: u32,
    /// Where it was seen, in pixels.
    pub pixel: [f64; 2],
    /// The standard deviation of either pixel coordinate, in pixels.
    pub sigma_px: f64,
    /// Predicted minus observed pixel; `None` where the view was left out.
    pub residual_px: Option<[f64; 2]>,
    /// Why it was not used; `None` where it was.
    pub reason: Option<String>,
}

/// Returns the bytes of `observations.parquet`: the same for the same dataset and calibration.
pub fn observations_to_parquet(dataset: &Dataset, calibration: &Calibration) -> Result<Vec<u8>, Error> {
    let (found, need) = (calibration.views.len(), dataset.views.len());
    if found != need {
        return Err(Error::Inconsistent { what: "fits of views", found, need });
    }
    let cannot = |error: parquet::errors::ParquetError| Error::Write {
        file: "observations.parquet".to_owned(),
        source: std::io::Error::other(error),
    };
    let batch = batch(&rows(dataset, calibration)).map_err(|error| cannot(error.into()))?;
    let level = ZstdLevel::try_new(3).map_err(cannot)?;
    let schema = KeyValue::new(SCHEMA_KEY.to_owned(), OBSERVATIONS_SCHEMA.to_owned());
    let properties = WriterProperties::builder()
        .set_compression(Compression::ZSTD(level))
        .set_created_by(concat!("boresight ", env!("CARGO_PKG_VERSION")).to_owned())
        .set_key_value_metadata(Some(vec![schema, KeyValue::new(HASH_KEY.to_owned(), no_hash())]))
        .build();
    let mut bytes = Vec::new();
    let mut writer = ArrowWriter::try_new(&mut bytes, batch.schema(), Some(properties)).map_err(cannot)?;
    writer.write(&batch).map_err(cannot)?;
    writer.close().map_err(cannot)?;
    seal(&mut bytes);
    Ok(bytes)
}

/// Reads the corners of an `observations.parquet`.
pub fn read_observations(path: &Path) -> Result<Vec<ObservationRow>, Error> {
    let file = path.display().to_string();
    let malformed = |found: String| Error::Malformed { place: Place::file(&file), found, need: NEED };
    let unreadable = |source| Error::Read { file: file.clone(), source };
    if !is_whole(std::fs::read(path).map_err(unreadable)?) {
        return Err(malformed(
            "the file is damaged, or not written by Boresight: its hash is not that of its bytes".to_owned(),
        ));
    }
    let opened = std::fs::File::open(path).map_err(unreadable)?;
    let builder =
        ParquetRecordBatchReaderBuilder::try_new(opened).map_err(|error| malformed(error.to_string()))?;
    let metadata = builder.metadata().file_metadata().key_value_metadata();
    let schema = metadata.and_then(|pairs| pairs.iter().find(|pair| pair.key == SCHEMA_KEY)?.value.clone());
    match schema {
        Some(schema) if schema == OBSERVATIONS_SCHEMA => {}
        Some(found) => return Err(Error::Schema { file, found, reads: OBSERVATIONS_SCHEMA }),
        None => return Err(malformed("its metadata name no schema".to_owned())),
    }
    let reader = builder.build().map_err(|error| malformed(error.to_string()))?;
    let mut rows = Vec::new();
    for batch in reader {
        let batch = batch.map_err(|error| malformed(error.to_string()))?;
        append(&batch, &mut rows)
            .map_err(|column| malformed(format!("column `{column}` is missing or of another type")))?;
    }
    Ok(rows)
}

/// Puts the residuals of an `observations.parquet` back into the calibration it was written with.
pub fn attach_residuals(calibration: &mut Calibration, rows: &[ObservationRow]) -> Result<(), Error> {
    let need = calibration.views.len();
    calibration.views.iter_mut().for_each(|view| view.residuals_px.clear());
    for row in rows {
        let found = row.view as usize + 1;
        let view = calibration.views.get_mut(row.view as usize);
        let view = view.ok_or(Error::Inconsistent { what: "views", found, need })?;
        view.residuals_px.extend(row.residual_px);
    }
    Ok(())
}

/// Returns the place that the hash is written to.
fn no_hash() -> String {
    format!("{}{}", String::from_utf8_lossy(HASH_MARK), "0".repeat(HASH_LENGTH))
}

/// Returns where the hash is in the bytes of a file.
fn find_hash(bytes: &[u8]) -> Option<std::ops::Range<usize>> {
    let at = bytes.windows(HASH_MARK.len()).rposition(|window| window == HASH_MARK)? + HASH_MARK.len();
    (at + HASH_LENGTH <= bytes.len()).then_some(at..at + HASH_LENGTH)
}

/// Writes the hash of the bytes into them.
fn seal(bytes: &mut [u8]) {
    let hash = hash(bytes);
    if let Some(place) = find_hash(bytes) {
        bytes[place].copy_from_slice(hash.as_bytes());
    }
}

/// Tells whether the bytes are those that were sealed.
fn is_whole(mut bytes: Vec<u8>) -> bool {
    let Some(place) = find_hash(&bytes) else { return false };
    let sealed = bytes[place.clone()].to_vec();
    bytes[place].fill(b'0');
    hash(&bytes).as_bytes() == sealed
}

fn rows(dataset: &Dataset, calibration: &Calibration) -> Vec<ObservationRow> {
    let reasons: BTreeMap<(usize, PointId), &RejectionReason> = calibration
        .rejected
        .iter()
        .map(|rejection| ((rejection.view_idx, rejection.point), &rejection.reason))
        .collect();
    let mut rows = Vec::with_capacity(dataset.observation_count());
    for (view_idx, (view, fit)) in dataset.views.iter().zip(&calibration.views).enumerate() {
        for (i, observation) in view.observations.iter().enumerate() {
            let residual_px = fit.residuals_px.get(i).copied();
            let reason = match reasons.get(&(view_idx, observation.point)) {
                Some(RejectionReason::Outlier { sigmas, limit }) => {
                    Some(format!("outlier: {sigmas:.2} sigmas, limit {limit}"))
                }
                Some(RejectionReason::LeftOut { why }) => Some(format!("left out: {why}")),
                None if residual_px.is_none() => Some("left out".to_owned()),
                None => None,
            };
            rows.push(ObservationRow {
                view: view_idx as u32,
                camera: dataset.cameras[view.camera].name.clone(),
                frame: dataset.frames[view.frame].name.clone(),
                target: dataset.targets[view.target].name.clone(),
                image: view.image.clone(),
                point: observation.point.0,
                pixel: observation.pixel,
                sigma_px: observation.sigma_px,
                residual_px,
                reason,
            });
        }
    }
    rows
}

fn batch(rows: &[ObservationRow]) -> Result<RecordBatch, arrow_schema::ArrowError> {
    let words = |value: fn(&ObservationRow) -> &str| {
        Arc::new(StringArray::from_iter_values(rows.iter().map(value))) as ArrayRef
    };
    let numbers = |value: fn(&ObservationRow) -> f64| {
        Arc::new(Float64Array::from_iter_values(rows.iter().map(value))) as ArrayRef
    };
    let ids = |value: fn(&ObservationRow) -> u32| {
        Arc::new(UInt32Array::from_iter_values(rows.iter().map(value))) as ArrayRef
    };
    let residual = |axis: usize| {
        let values = rows.iter().map(move |row| row.residual_px.map(|residual| residual[axis]));
        Arc::new(Float64Array::from_iter(values)) as ArrayRef
    };
    let optional = |value: fn(&ObservationRow) -> Option<&str>| {
        Arc::new(StringArray::from_iter(rows.iter().map(value))) as ArrayRef
    };
    let kept: BooleanArray = rows.iter().map(|row| Some(row.reason.is_none())).collect();
    RecordBatch::try_from_iter_with_nullable([
        ("view", ids(|row| row.view), false),
        ("camera", words(|row| &row.camera), false),
        ("frame", words(|row| &row.frame), false),
        ("target", words(|row| &row.target), false),
        ("image", optional(|row| row.image.as_deref()), true),
        ("point", ids(|row| row.point), false),
        ("u_px", numbers(|row| row.pixel[0]), false),
        ("v_px", numbers(|row| row.pixel[1]), false),
        ("sigma_px", numbers(|row| row.sigma_px), false),
        ("du_px", residual(0), true),
        ("dv_px", residual(1), true),
        ("kept", Arc::new(kept), false),
        ("reason", optional(|row| row.reason.as_deref()), true),
    ])
}

/// Appends the rows of a batch, or returns the name of the column that is missing.
fn append(batch: &RecordBatch, rows: &mut Vec<ObservationRow>) -> Result<(), &'static str> {
    let column = |name: &'static str| batch.column_by_name(name).ok_or(name);
    let words = |name: &'static str| column(name)?.as_string_opt::<i32>().ok_or(name);
    let numbers = |name: &'static str| column(name)?.as_primitive_opt::<Float64Type>().ok_or(name);
    let ids = |name: &'static str| column(name)?.as_primitive_opt::<UInt32Type>().ok_or(name);
    let (view, point) = (ids("view")?, ids("point")?);
    let (camera, frame, target) = (words("camera")?, words("frame")?, words("target")?);
    let (image, reason) = (words("image")?, words("reason")?);
    let (u, v, sigma) = (numbers("u_px")?, numbers("v_px")?, numbers("sigma_px")?);
    let (du, dv) = (numbers("du_px")?, numbers("dv_px")?);
    let optional = |words: &StringArray, i: usize| words.is_valid(i).then(|| words.value(i).to_owned());
    for i in 0..batch.num_rows() {
        rows.push(ObservationRow {
            view: view.value(i),
            camera: camera.value(i).to_owned(),
            frame: frame.value(i).to_owned(),
            target: target.value(i).to_owned(),
            image: optional(image, i),
            point: point.value(i),
            pixel: [u.value(i), v.value(i)],
            sigma_px: sigma.value(i),
            residual_px: (du.is_valid(i) && dv.is_valid(i)).then(|| [du.value(i), dv.value(i)]),
            reason: optional(reason, i),
        });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use boresight_data::{CameraId, CameraInfo, Frame, FrameId, IdVec, Observation, TargetId, View};

    use super::*;
    use crate::samples::sample;

    fn dataset() -> Dataset {
        let observation = |i: u32| Observation { point: PointId(i), pixel: [1.0 / 3.0, -0.0], sigma_px: 0.5 };
        let view = |frame: u32, image: Option<&str>, n: u32| View {
            camera: CameraId(0),
            frame: FrameId(frame),
            target: TargetId(0),
            image: image.map(str::to_owned),
            observations: (0..n).map(observation).collect(),
        };
        let frame = |name: &str| Frame { name: name.to_owned(), ..Frame::default() };
        Dataset {
            cameras: IdVec::from(vec![CameraInfo { name: "left".to_owned(), image_size: [640, 480] }]),
            targets: sample().targets,
            frames: IdVec::from(vec![frame("01"), frame("02")]),
            views: vec![view(0, Some("a.png"), 2), view(1, None, 3)],
        }
    }

    #[test]
    fn every_corner_survives_with_its_fate() {
        let (folder, calibration) = (tempfile::tempdir().unwrap(), sample());
        let path = folder.path().join("observations.parquet");
        let bytes = observations_to_parquet(&dataset(), &calibration).unwrap();
        assert_eq!(bytes, observations_to_parquet(&dataset(), &calibration).unwrap());
        std::fs::write(&path, &bytes).unwrap();
        let rows = read_observations(&path).unwrap();
        assert_eq!(rows.len(), 5);
        assert_eq!(rows[0].pixel.map(f64::to_bits), [1.0 / 3.0, -0.0_f64].map(f64::to_bits));
        assert_eq!((rows[0].image.as_deref(), rows[2].image.as_deref()), (Some("a.png"), None));
        assert_eq!(rows[1].residual_px, Some([1e-17, 3.0]));
        let reasons: Vec<_> = rows.iter().map(|row| row.reason.as_deref()).collect();
        let outlier = Some("outlier: inf sigmas, limit 4");
        assert_eq!(reasons, [None, outlier, Some("left out: alone"), Some("left out"), Some("left out")]);

        let mut restored = calibration.clone();
        restored.views.iter_mut().for_each(|view| view.residuals_px.clear());
        attach_residuals(&mut restored, &rows).unwrap();
        assert_eq!(restored, calibration);
    }

    #[test]
    fn what_is_no_parquet_of_ours_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("o.parquet");
        let good = observations_to_parquet(&dataset(), &sample()).unwrap();
        let mut changed = good.clone();
        let at = changed.windows(24).rposition(|window| window == OBSERVATIONS_SCHEMA.as_bytes()).unwrap();
        changed[at + 23] = b'2';
        let place = find_hash(&changed).unwrap();
        changed[place].fill(b'0');
        seal(&mut changed);
        for (bytes, part) in
            [(&good[..0], "o.parquet"), (&good[..good.len() - 9], "o.parquet"), (&changed, "observations/2")]
        {
            std::fs::write(&path, bytes).unwrap();
            let error = read_observations(&path).unwrap_err().to_string();
            assert!(error.contains(part), "{error}");
        }
        assert!(observations_to_parquet(&Dataset::default(), &sample()).is_err());
    }

    #[test]
    fn a_damaged_file_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("o.parquet");
        let good = observations_to_parquet(&dataset(), &sample()).unwrap();
        for at in 0..good.len() {
            for with in [0x00, 0x7f, 0xff, good[at].wrapping_add(1)] {
                if with == good[at] {
                    continue;
                }
                let mut changed = good.clone();
                changed[at] = with;
                std::fs::write(&path, &changed).unwrap();
                assert!(matches!(read_observations(&path), Err(Error::Malformed { .. })), "byte {at}");
            }
        }
    }
}
