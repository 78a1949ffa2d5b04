//! What was detected in images before, by the hash of their bytes, so that it need not be detected again.
//!
//! A cache is of one target and one revision of the detectors; for any other it is empty. One that cannot be read is
//! empty too: nothing is lost but time.

use std::collections::BTreeMap;
use std::path::Path;

use boresight_data::{Observation, PointId, Target};
use serde::{Deserialize, Serialize};

use crate::atomic::write_atomically;
use crate::error::Error;
use crate::{SeenImage, SizeSeen};

/// The schema of the file.
const SCHEMA: &str = "boresight.detections/3";

/// What was detected before.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DetectionCache {
    /// Target and detectors, in words.
    key: String,
    known: BTreeMap<String, SeenImage>,
}

#[derive(Serialize, Deserialize)]
struct Document {
    schema: String,
    key: String,
    images: BTreeMap<String, Entry>,
}

#[derive(Serialize, Deserialize)]
struct Entry {
    image_size: [u32; 2],
    is_turned: bool,
    /// Point, u, v and sigma of each.
    points: Vec<(u32, f64, f64, f64)>,
    missed: Option<String>,
    size: SizeSeen,
    is_legacy: bool,
}

impl DetectionCache {
    /// Reads what was detected of this target by these detectors.
    pub fn read(path: &Path, target: &Target, detectors: &str) -> Self {
        let key = format!("{detectors} {target:?}");
        let document: Option<Document> =
            std::fs::read(path).ok().and_then(|bytes| serde_json::from_slice(&bytes).ok());
        let known = match document {
            Some(document) if document.schema == SCHEMA && document.key == key => {
                document.images.into_iter().map(|(hash, entry)| (hash.clone(), entry.seen(hash))).collect()
            }
            _ => BTreeMap::new(),
        };
        Self { key, known }
    }

    /// Returns what was seen in the image whose bytes have this hash.
    pub fn get(&self, hash: &str) -> Option<&SeenImage> {
        self.known.get(hash)
    }

    /// Writes what was known and what was seen now; nothing where nothing is new.
    pub fn write<'a>(self, path: &Path, seen: impl Iterator<Item = &'a SeenImage>) -> Result<(), Error> {
        let before = self.known.len();
        let mut known = self.known;
        for image in seen {
            known.entry(image.hash.clone()).or_insert_with(|| image.clone());
        }
        if known.len() == before {
            return Ok(());
        }
        let images = known.into_iter().map(|(hash, seen)| (hash, Entry::of(&seen))).collect();
        let document = Document { schema: SCHEMA.to_owned(), key: self.key, images };
        let wrong = |error: serde_json::Error| Error::Write {
            file: path.display().to_string(),
            source: std::io::Error::other(error),
        };
        write_atomically(path, &serde_json::to_vec(&document).map_err(wrong)?)
    }
}

impl Entry {
    fn of(seen: &SeenImage) -> Self {
        let point = |seen: &Observation| (seen.point.0, seen.pixel[0], seen.pixel[1], seen.sigma_px);
        Self {
            image_size: seen.image_size,
            is_turned: seen.is_turned,
            points: seen.observations.iter().map(point).collect(),
            missed: seen.missed.clone(),
            size: seen.size,
            is_legacy: seen.is_legacy,
        }
    }

    fn seen(self, hash: String) -> SeenImage {
        let observation =
            |(point, u, v, sigma_px)| Observation { point: PointId(point), pixel: [u, v], sigma_px };
        SeenImage {
            hash,
            image_size: self.image_size,
            is_turned: self.is_turned,
            observations: self.points.into_iter().map(observation).collect(),
            missed: self.missed,
            size: self.size,
            is_legacy: self.is_legacy,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn seen(hash: &str, n: u32) -> SeenImage {
        let pixel = |i: u32| [0.1 + f64::from(i) / 3.0, std::f64::consts::PI * f64::from(i)];
        let observation = |i| Observation { point: PointId(i), pixel: pixel(i), sigma_px: 0.1 / 3.0 };
        SeenImage {
            hash: hash.to_owned(),
            image_size: [640, 480],
            is_turned: n == 0,
            observations: (0..n).map(observation).collect(),
            missed: (n == 0).then(|| "no board is seen".to_owned()),
            size: if n == 0 { SizeSeen::Other([7, 5]) } else { SizeSeen::AsDeclared },
            is_legacy: n > 4,
        }
    }

    #[test]
    fn what_was_seen_comes_back_to_the_last_bit() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("detections.json");
        let target = crate::parse_target("chessboard:9x6:25mm").unwrap();
        let empty = DetectionCache::read(&path, &target, "1");
        assert_eq!(empty.get("a"), None);
        empty.write(&path, [seen("a", 5), seen("b", 0)].iter()).unwrap();
        let cache = DetectionCache::read(&path, &target, "1");
        assert_eq!(
            (cache.get("a"), cache.get("b"), cache.get("c")),
            (Some(&seen("a", 5)), Some(&seen("b", 0)), None)
        );
        cache.write(&path, [seen("c", 1)].iter()).unwrap();
        assert_eq!(DetectionCache::read(&path, &target, "1").known.len(), 3);
    }

    #[test]
    fn it_is_of_one_target_and_one_revision() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("detections.json");
        let target = crate::parse_target("chessboard:9x6:25mm").unwrap();
        DetectionCache::read(&path, &target, "1").write(&path, [seen("a", 5)].iter()).unwrap();
        let other = crate::parse_target("chessboard:9x6:26mm").unwrap();
        assert_eq!(DetectionCache::read(&path, &other, "1").get("a"), None);
        assert_eq!(DetectionCache::read(&path, &target, "2").get("a"), None);
        std::fs::write(&path, b"{\"schema\": 1").unwrap();
        assert_eq!(DetectionCache::read(&path, &target, "1").get("a"), None);
    }
}
