//! Detects a target in binary PGM files, and prints corners and CPU time as lines of JSON, for `cargo xtask detection`.
//!
//!     detect_images TARGET REPEATS FILE...
//!
//! TARGET is `chessboard:9x6`, `charuco:8x8:0.75:4x4_1000` (marker as a share of the square), `aprilgrid:6x6:0.3` or
//! `circles:7x5`. The time is the least of the repeats.

#![allow(clippy::print_stdout, reason = "its answer is its output")]

use std::time::Instant;

use boresight_data::{CircleLayout, Dictionary, Geometry, GrayImage, GrayPixels, Shape, Target};
use boresight_detect::detect;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let target = target(&arguments.next().ok_or("a target is missing")?).ok_or("there is no such target")?;
    let repeats: usize = arguments.next().ok_or("the number of repeats is missing")?.parse()?;
    for file in arguments {
        let image = read_pgm(&std::fs::read(&file)?).ok_or("not a binary PGM of eight bits")?;
        let mut least_s = f64::INFINITY;
        let mut found = detect(&image, &target);
        for _ in 0..repeats {
            let begin = cpu_s();
            found = detect(&image, &target);
            least_s = least_s.min(cpu_s() - begin);
        }
        let corner = |o: &boresight_data::Observation| {
            format!("[{},{:.5},{:.5},{:.5}]", o.point, o.pixel[0], o.pixel[1], o.sigma_px)
        };
        let corners: Vec<String> = found.observations.iter().map(corner).collect();
        let missed = found.missed.map(|missed| missed.to_string()).unwrap_or_default();
        println!(
            "{{\"file\":{file:?},\"cpu_s\":{least_s:.6},\"whole\":{},\"missed\":{missed:?},\"corners\":[{}]}}",
            found.shows_size,
            corners.join(",")
        );
    }
    Ok(())
}

/// Returns the CPU time of this thread where the system tells, else the time of day.
fn cpu_s() -> f64 {
    let told = std::fs::read_to_string("/proc/thread-self/schedstat").ok();
    let nanoseconds = told.and_then(|text| text.split(' ').next()?.parse::<f64>().ok());
    static BEGIN: std::sync::OnceLock<Instant> = std::sync::OnceLock::new();
    nanoseconds.map_or_else(|| BEGIN.get_or_init(Instant::now).elapsed().as_secs_f64(), |ns| 1e-9 * ns)
}

fn target(spec: &str) -> Option<Target> {
    let parts: Vec<&str> = spec.split(':').collect();
    let (columns, rows) = parts.get(1)?.split_once('x')?;
    let (columns, rows) = (columns.parse().ok()?, rows.parse().ok()?);
    let number = |i: usize| parts.get(i)?.parse::<f64>().ok();
    let geometry = match parts[0] {
        "chessboard" => Geometry::Chessboard { columns, rows, spacing_m: 1.0 },
        "charuco" => {
            let dictionary = Dictionary::named(parts.get(3)?)?;
            Geometry::Charuco { columns, rows, spacing_m: 1.0, marker_m: number(2)?, dictionary }
        }
        "aprilgrid" => {
            let dictionary = Dictionary::APRILTAG_36H11;
            Geometry::AprilGrid { columns, rows, tag_m: 1.0, spacing: number(2)?, dictionary }
        }
        "circles" => Geometry::Circles { columns, rows, spacing_m: 1.0, layout: CircleLayout::Symmetric },
        _ => return None,
    };
    Some(Target { name: "target".to_owned(), geometry, shape: Shape::Rigid })
}

fn read_pgm(bytes: &[u8]) -> Option<GrayImage> {
    let mut at = 0;
    let mut words = Vec::new();
    while words.len() < 4 {
        let end = at + bytes[at..].iter().position(u8::is_ascii_whitespace)?;
        words.push(std::str::from_utf8(&bytes[at..end]).ok()?);
        at = end + 1;
    }
    let size = [words[1].parse().ok()?, words[2].parse().ok()?];
    if words[0] != "P5" || words[3] != "255" {
        return None;
    }
    GrayImage::new(size, GrayPixels::Eight(bytes[at..].to_vec()))
}
