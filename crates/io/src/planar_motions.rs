//! Motions of a planar robot with two wheels: JSON objects, one or more a line, `{"T": s, "phi_l": rad/s, "phi_r": rad/s,
//! "sm": [x, y, theta]}`, as Censi et al. published theirs.

use serde::Deserialize;

use crate::{Error, Place};

/// An interval: its duration in seconds, the mean angular velocities of the left and the right wheel in radians
/// per second, and the motion that the sensor measured, x and y in metres and the turn in radians.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
pub struct PlanarMotionRow {
    /// The duration in seconds.
    #[serde(rename = "T")]
    pub duration_s: f64,
    /// The left wheel's mean angular velocity in radians per second.
    #[serde(rename = "phi_l")]
    pub left_rad_per_s: f64,
    /// The right wheel's.
    #[serde(rename = "phi_r")]
    pub right_rad_per_s: f64,
    /// The sensor's motion in its first frame: x and y in metres, the turn in radians.
    #[serde(rename = "sm")]
    pub sensor_motion: [f64; 3],
}

/// Reads a file of motions.
pub fn read_planar_motions(file: &str, bytes: &[u8]) -> Result<Vec<PlanarMotionRow>, Error> {
    let text = String::from_utf8_lossy(bytes);
    let mut rows = Vec::new();
    for (i, line) in text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty()) {
        // Where recordings were joined, the last of one and the first of the next share a line.
        for row in serde_json::Deserializer::from_str(line).into_iter::<PlanarMotionRow>() {
            rows.push(row.map_err(|error| Error::Malformed {
                place: Place::line(file, i + 1),
                found: error.to_string(),
                need: "a motion is {\"T\": s, \"phi_l\": rad/s, \"phi_r\": rad/s, \"sm\": [x, y, theta]}",
            })?);
        }
    }
    if rows.is_empty() {
        return Err(Error::Empty { file: file.to_owned() });
    }
    Ok(rows)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_read_and_mistakes_named() {
        let text = "{ \"T\": 0.5, \"phi_l\": 1e-1, \"phi_r\": -2, \"sm\": [ 1, 2, 3 ] }\n\n";
        let rows = read_planar_motions("m.tuple", text.as_bytes()).unwrap();
        assert_eq!((rows.len(), rows[0].right_rad_per_s, rows[0].sensor_motion[2]), (1, -2.0, 3.0));
        let line = text.lines().next().unwrap();
        let joined = read_planar_motions("m.tuple", format!("{line}{line}\n{line}").as_bytes()).unwrap();
        assert_eq!(joined, [rows[0]; 3]);
        for (text, part) in [
            ("", "m.tuple: the file is empty"),
            ("{}\n", "m.tuple:1: "),
            ("{\n", "m.tuple:1: "),
            ("{}x", "m.tuple:1: "),
        ] {
            let error = read_planar_motions("m.tuple", text.as_bytes()).unwrap_err().to_string();
            assert!(error.contains(part), "`{part}` is not in: {error}");
        }
    }
}
