//! The recorded robot on wheels, against what was published of it.

use std::path::Path;

use anyhow::Context as _;
use serde::Deserialize;

use super::SHARED;
use crate::process::{command, output, root};
use crate::table::markdown;

const FOLDER: &str = "planar-khepera-censi/raw/reference-output";
/// All intervals with the sensor turned aside, all with it straight ahead.
const RECORDINGS: [&str; 2] = ["l90", "lstraight"];

#[derive(Debug, Deserialize)]
struct Document {
    parameters: Vec<Parameter>,
    intervals: usize,
    used: usize,
    median_residual_m: f64,
    median_residual_rad: f64,
    findings: Vec<super::Finding>,
}

#[derive(Debug, Deserialize)]
struct Parameter {
    name: String,
    value: f64,
    sigma: f64,
}

/// What was published; wheels as diameters.
#[derive(Debug, Deserialize)]
struct Published {
    axle: f64,
    l_diam: f64,
    r_diam: f64,
    l_x: f64,
    l_y: f64,
    l_theta: f64,
}

/// Calibrates the recordings and returns their table.
pub(super) fn table(program: &Path) -> anyhow::Result<String> {
    let mut rows = Vec::new();
    for name in RECORDINGS {
        let folder = Path::new(SHARED).join(FOLDER);
        let mut calibrate = command(program);
        calibrate.args(["robot", "planar", "--json"]).arg(folder.join(format!("{name}.tuple")));
        let found: Document = serde_json::from_str(&output(&mut calibrate)?).context(name)?;
        let path = root().join(&folder).join(format!("{name}_results.json"));
        let text = std::fs::read_to_string(&path).with_context(|| path.display().to_string())?;
        let said: Published = serde_json::from_str(&text).context(name)?;
        let published = [0.5 * said.l_diam, 0.5 * said.r_diam, said.axle, said.l_x, said.l_y, said.l_theta];
        for (parameter, published) in found.parameters.iter().zip(published) {
            let (factor, unit) = if parameter.name.ends_with("_m") {
                (1e3, "mm")
            } else {
                (180.0 / std::f64::consts::PI, "deg")
            };
            let quantity = parameter.name.trim_end_matches("_m").trim_end_matches("_rad").replace('_', " ");
            rows.push(vec![
                format!("{name}, {quantity}, {unit}"),
                format!("{:.3} ± {:.3}", factor * parameter.value, factor * parameter.sigma),
                format!("{:.3}", factor * published),
                format!("{:.2}", (parameter.value - published) / parameter.sigma),
            ]);
        }
        let codes: Vec<&str> = found.findings.iter().map(|finding| finding.code.as_str()).collect();
        rows.push(vec![
            format!("{name}, median residual"),
            format!(
                "{:.3} mm, {:.3} deg, {} of {} intervals{}",
                1e3 * found.median_residual_m,
                found.median_residual_rad.to_degrees(),
                found.used,
                found.intervals,
                if codes.is_empty() { String::new() } else { format!("; {}", codes.join(", ")) }
            ),
            "-".to_owned(),
            "-".to_owned(),
        ]);
    }
    Ok(markdown(&["robot on wheels", "here", "published", "apart, in our sigmas"], &rows))
}
