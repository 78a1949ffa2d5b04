//! Works out an uncertainty map of a conformance problem and prints one line of JSON, for `cargo xtask uncertainty`.
//!
//! Everything counts that stands between the optimum and the map: derivatives of all corners, the elimination of
//! the frames, the joint covariance, and the map; and the solve that finds itself at the optimum.
#![allow(clippy::print_stdout, clippy::unwrap_used, reason = "a measuring program for developers")]

use std::env;
use std::path::Path;

use boresight_adjust::{AdjustOptions, Regularization, Rejection, adjust, optimize};
use boresight_data::CameraId;
use boresight_tests::mrcal_problem::MrcalProblem;
use boresight_validate::{Method, ProjectionUncertainty, Propagation};
use serde_json::json;

fn main() {
    let arguments: Vec<String> = env::args().collect();
    let [_, path, camera, distance, repeats] = arguments.as_slice() else {
        panic!("usage: uncertainty_map PROBLEM.npz CAMERA DISTANCE_M REPEATS");
    };
    let camera = CameraId(camera.parse().unwrap());
    let distance_m: f64 = distance.parse().unwrap();
    let distance_m = distance_m.is_finite().then_some(distance_m);
    let problem = MrcalProblem::read(Path::new(path), "opencv8".parse().unwrap(), false).unwrap();
    let options = AdjustOptions {
        rejection: Rejection::None,
        regularization: Regularization::Mrcal22,
        threads: 1,
        decrease_below: 1e-12,
        ..AdjustOptions::default()
    };
    let optimum = optimize(&problem.dataset, &problem.seed, &options).unwrap().scene;
    let mut cpu_s = Vec::new();
    let mut worst = Vec::new();
    for _ in 0..repeats.parse::<usize>().unwrap() {
        let begin = cpu_seconds();
        let calibration = adjust(&problem.dataset, &optimum, &options, None).unwrap();
        let known = ProjectionUncertainty::new(
            &calibration,
            camera,
            Method::MeanFrame,
            Propagation::ObservationsOnly,
        )
        .unwrap();
        let map = known.map(60, 40, distance_m).unwrap();
        let noise = calibration.uncertainty.noise_factor;
        worst = map.spreads.iter().map(|spread| spread.map(|spread| spread.worst_px() / noise)).collect();
        cpu_s.push(cpu_seconds() - begin);
    }
    cpu_s.sort_by(f64::total_cmp);
    println!("{}", json!({ "tool": "boresight", "cpu_s": cpu_s[cpu_s.len() / 2], "worst_px": worst }));
}

/// Returns the CPU time that this process has used, in seconds.
fn cpu_seconds() -> f64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}
