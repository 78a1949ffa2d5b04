//! `cargo xtask picture`: draws how well the committed pair's pixels are known, for the README.

use std::fmt::Write as _;
use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::Context as _;
use serde::Deserialize;

use crate::arguments::Arguments;
use crate::process::{boresight, command, output, root, target};

const DATASET: &str = "datasets/opencv-stereo";
const CORNERS: &str = "datasets/opencv-stereo/corners-classic5.csv";
const PICTURE: &str = "docs/opencv-stereo.svg";

/// The colours between these sigmas, in pixels, change evenly with the logarithm.
const LEAST_PX: f64 = 0.02;
const MOST_PX: f64 = 2.0;

#[derive(Deserialize)]
struct Report {
    cameras: Vec<Camera>,
}

#[derive(Deserialize)]
struct Camera {
    name: String,
    maps: Vec<Map>,
}

#[derive(Deserialize)]
struct Map {
    image_size: [f64; 2],
    columns: usize,
    rows: usize,
    spreads: Vec<Option<Spread>>,
}

#[derive(Deserialize)]
struct Spread {
    covariance_px2: [[f64; 2]; 2],
}

/// Calibrates the pair and draws the sigma of its pixels at one metre, under the corners that were seen.
pub(crate) fn run(mut arguments: Arguments) -> anyhow::Result<ExitCode> {
    let program = arguments.option::<PathBuf>("--program")?;
    arguments.finish()?;
    let program = match program {
        Some(program) => program,
        None => boresight()?,
    };
    let out = target().join("picture");
    output(command(&program).args(["calibrate", DATASET, "--holdout", "off", "-o"]).arg(&out))?;
    let grid = ["--distance-m", "1", "--grid", "32x24", "--format", "json"];
    let said = output(command(&program).arg("uncertainty").arg(out.join("calibration.json")).args(grid))?;
    let report: Report = serde_json::from_str(&said).context("the answer of `uncertainty`")?;
    let corners = std::fs::read_to_string(root().join(CORNERS)).context(CORNERS)?;
    std::fs::write(root().join(PICTURE), draw(&report, &corners)).context(PICTURE)?;
    println!("{PICTURE}");
    Ok(ExitCode::SUCCESS)
}

fn draw(report: &Report, corners: &str) -> String {
    let mut svg = String::from(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 860 390\" font-family=\"sans-serif\" font-size=\"14\">\n\
         <rect width=\"860\" height=\"390\" fill=\"white\"/>\n",
    );
    for (panel, camera) in report.cameras.iter().enumerate() {
        let Some(map) = camera.maps.first() else { continue };
        let [width, height] = map.image_size;
        let scale = 400.0 / width;
        let left = 20.0 + 420.0 * panel as f64;
        let _ = writeln!(svg, "<text x=\"{left}\" y=\"24\">{}</text>", camera.name);
        let _ = writeln!(svg, "<g transform=\"translate({left} 34) scale({scale:.6})\">");
        // A cell around each grid point; those at the border are cut there.
        let (across, down) = (width / (map.columns - 1) as f64, height / (map.rows - 1) as f64);
        let _ = writeln!(
            svg,
            "<clipPath id=\"image{panel}\"><rect width=\"{width}\" height=\"{height}\"/></clipPath>"
        );
        let _ = writeln!(svg, "<g clip-path=\"url(#image{panel})\" shape-rendering=\"crispEdges\">");
        for (at, spread) in map.spreads.iter().enumerate() {
            let Some(spread) = spread else { continue };
            let (column, row) = (at % map.columns, at / map.columns);
            let (x, y) = ((column as f64 - 0.5) * across, (row as f64 - 0.5) * down);
            // Each reaches a little under the next, so that nothing shines through between them.
            let (wide, high) = (across + 0.5, down + 0.5);
            let fill = colour(worst_px(spread));
            let _ = writeln!(
                svg,
                "<rect x=\"{x:.1}\" y=\"{y:.1}\" width=\"{wide:.2}\" height=\"{high:.2}\" fill=\"{fill}\"/>"
            );
        }
        for line in corners.lines().skip(1) {
            let cells: Vec<&str> = line.split(',').collect();
            if let [name, .., u, v] = cells[..]
                && name == camera.name
            {
                let _ = writeln!(
                    svg,
                    "<circle cx=\"{u}\" cy=\"{v}\" r=\"1.6\" fill=\"black\" fill-opacity=\"0.55\"/>"
                );
            }
        }
        svg.push_str("</g></g>\n");
    }
    for step in 0..200 {
        let sigma = LEAST_PX * (MOST_PX / LEAST_PX).powf(f64::from(step) / 199.0);
        let x = 20 + 2 * step;
        let _ =
            writeln!(svg, "<rect x=\"{x}\" y=\"346\" width=\"3\" height=\"12\" fill=\"{}\"/>", colour(sigma));
    }
    for sigma in [0.02_f64, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0] {
        let x = 20.0 + 400.0 * (sigma / LEAST_PX).ln() / (MOST_PX / LEAST_PX).ln();
        let _ = writeln!(
            svg,
            "<text x=\"{x:.0}\" y=\"374\" text-anchor=\"middle\" font-size=\"12\">{sigma}</text>"
        );
    }
    svg.push_str("<text x=\"440\" y=\"357\">px: one sigma of where a point at 1 m appears</text>\n");
    svg.push_str("<text x=\"440\" y=\"376\">dots: the corners that were seen</text>\n</svg>\n");
    svg
}

/// Returns the root of the larger eigenvalue.
fn worst_px(spread: &Spread) -> f64 {
    let [[a, b], [_, c]] = spread.covariance_px2;
    (0.5 * (a + c) + (0.25 * (a - c).powi(2) + b * b).sqrt()).sqrt()
}

/// Returns a colour from blue over white to red.
fn colour(sigma_px: f64) -> String {
    let share = ((sigma_px / LEAST_PX).ln() / (MOST_PX / LEAST_PX).ln()).clamp(0.0, 1.0);
    let stops = [
        [49.0, 104.0, 168.0],
        [158.0, 202.0, 225.0],
        [255.0, 247.0, 220.0],
        [253.0, 174.0, 97.0],
        [178.0, 24.0, 43.0],
    ];
    let place = share * (stops.len() - 1) as f64;
    let below = (place.floor() as usize).min(stops.len() - 2);
    let part = place - below as f64;
    let mix = |k: usize| (stops[below][k] * (1.0 - part) + stops[below + 1][k] * part).round() as u8;
    format!("#{:02x}{:02x}{:02x}", mix(0), mix(1), mix(2))
}
