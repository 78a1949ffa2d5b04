//! The recorded robots of which poses are known and no pixels.

use std::path::Path;

use anyhow::Context as _;
use serde::Deserialize;

use super::{JOBS, SHARED, calibrated};
use crate::process::{command, root, run};
use crate::table::markdown;

/// The jobs, each with what its `DATASET.md` or the recording's own test says of it.
const RECORDINGS: [(&str, &str); 3] = [
    ("poses-ethz-robot-arm", "(-2, -18, -1) mm, 0.00 s, 3.9 mm, 0.56 deg"),
    ("poses-ethz-vicon", "-0.05 s, 17 mm, 1.8 deg"),
    ("joints-positioner", "below 2 mm, 0.2 deg"),
];

/// Archives of streams, and the folders that are taken out of them.
const ARCHIVES: [(&str, &str); 2] = [
    ("robot_arm_w_color_camera_real.zip", "robot_arm"),
    ("prime_sense_color_w_vicon_1.zip", "prime_sense_1"),
];
const STREAMS: &str = "target/robot/ethz";

#[derive(Debug, Deserialize)]
struct Document {
    poses: Vec<Pose>,
    clock: Option<Clock>,
    sights: usize,
    used: Option<usize>,
    far_off: usize,
    #[serde(default)]
    methods: Vec<Method>,
    left_out: Option<Figures>,
    #[serde(default)]
    links: Vec<Link>,
    findings: Vec<super::Finding>,
}

#[derive(Debug, Deserialize)]
struct Pose {
    translation_m: [f64; 3],
    sigma_rad_m: [f64; 6],
}

#[derive(Debug, Deserialize)]
struct Clock {
    offset_s: f64,
    sigma_s: f64,
}

#[derive(Debug, Deserialize)]
struct Method {
    name: String,
    left_out: Option<Figures>,
}

/// Mean, median, 95 % and largest.
#[derive(Clone, Copy, Debug, Deserialize)]
struct Figures {
    distance_m: [f64; 4],
    angle_rad: [f64; 4],
}

#[derive(Debug, Deserialize)]
struct Link {
    angle_rad: [f64; 2],
    distance_m: [f64; 2],
}

/// Calibrates the recordings and returns their tables.
pub(super) fn tables(program: &Path) -> anyhow::Result<String> {
    for (archive, folder) in ARCHIVES {
        if !root().join(STREAMS).join(folder).is_dir() {
            let archive = Path::new(SHARED).join("handeye-poses-ethz/raw").join(archive);
            run(command("python3").args(["-m", "zipfile", "-e"]).arg(archive).arg(STREAMS))?;
        }
    }
    let (mut rows, mut all) = (Vec::new(), Vec::new());
    for (name, reference) in RECORDINGS {
        let text = calibrated(program, &Path::new(JOBS).join(name), name)?;
        let found: Document = serde_json::from_str(&text).with_context(|| name.to_owned())?;
        let own = found.left_out.or_else(|| found.methods.last().and_then(|method| method.left_out));
        let shown = |figures: Option<Figures>| {
            figures.map_or("failed".to_owned(), |figures| {
                let [distance, angle] =
                    [figures.distance_m.map(|metres| 1e3 * metres), figures.angle_rad.map(f64::to_degrees)];
                format!("{:.2} / {:.2} mm, {:.3} / {:.3} deg", distance[0], distance[1], angle[0], angle[1])
            })
        };
        let result = match (&found.poses[..], found.links.first()) {
            (_, Some(link)) => {
                let [angle, angle_sigma] = link.angle_rad.map(f64::to_degrees);
                let [distance, distance_sigma] = link.distance_m.map(|metres| 1e3 * metres);
                format!(
                    "axes at {angle:.4} ± {angle_sigma:.4} deg, {distance:.2} ± {distance_sigma:.2} mm apart"
                )
            }
            ([pose, ..], None) => {
                let one = |axis: usize| {
                    let (value, sigma) = (1e3 * pose.translation_m[axis], 1e3 * pose.sigma_rad_m[3 + axis]);
                    format!("{value:.1} ± {sigma:.1}")
                };
                format!("({}, {}, {}) mm", one(0), one(1), one(2))
            }
            _ => "-".to_owned(),
        };
        let clock = found.clock.as_ref();
        let codes: Vec<&str> = found.findings.iter().map(|finding| finding.code.as_str()).collect();
        rows.push(vec![
            name.to_owned(),
            format!(
                "{}, {} used, {} far off",
                found.sights,
                found.used.unwrap_or(found.sights),
                found.far_off
            ),
            shown(own),
            result,
            clock.map_or("-".to_owned(), |clock| {
                format!("{:.2} ± {:.2} ms", 1e3 * clock.offset_s, 1e3 * clock.sigma_s)
            }),
            reference.to_owned(),
            if codes.is_empty() { "-".to_owned() } else { codes.join(", ") },
        ]);
        all.extend(
            found
                .methods
                .iter()
                .map(|method| vec![format!("{name}, {}", method.name), shown(method.left_out)]),
        );
    }
    let head = [
        "recording",
        "sights",
        "left out, mean / median",
        "result",
        "robot's clock less camera's",
        "reference",
        "findings",
    ];
    Ok([markdown(&head, &rows), markdown(&["recording, method", "left out, mean / median"], &all)].join("\n"))
}
