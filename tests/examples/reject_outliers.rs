//! Adjusts conformance problems with their outliers, by defaults, and prints one line of JSON for each:
//! what was rejected and the CPU time, on one thread.
#![allow(clippy::print_stdout, clippy::unwrap_used, reason = "a measuring program for developers")]

use std::collections::BTreeSet;
use std::env;
use std::path::Path;

use boresight_adjust::{AdjustOptions, adjust};
use boresight_data::RejectionReason;
use boresight_tests::mrcal_problem::MrcalProblem;
use serde_json::json;

fn main() {
    let arguments: Vec<String> = env::args().skip(1).collect();
    let repeats = 5;
    for path in &arguments {
        let problem = MrcalProblem::read(Path::new(path), "opencv8".parse().unwrap(), true).unwrap();
        let options = AdjustOptions { threads: 1, ..AdjustOptions::default() };
        let (mut cpu_s, mut last) = (Vec::new(), None);
        for _ in 0..repeats {
            let start = cpu_seconds();
            last = Some(adjust(&problem.dataset, &problem.seed, &options, None).unwrap());
            cpu_s.push(cpu_seconds() - start);
        }
        cpu_s.sort_by(f64::total_cmp);
        let calibration = last.unwrap();
        let sigma = problem.arrays.number("noise_sigma");
        let outliers = problem.true_outliers(sigma, 5.0);
        let rejected: BTreeSet<(usize, u32)> = calibration
            .rejected
            .iter()
            .filter(|r| matches!(r.reason, RejectionReason::Outlier { .. }))
            .map(|r| (r.view_idx, r.point.0))
            .collect();
        let missed = outliers.above.iter().filter(|place| !rejected.contains(place)).count();
        let lost = rejected.iter().filter(|place| !outliers.all.contains(place)).count();
        let n_good = problem.dataset.observation_count() - outliers.all.len();
        println!(
            "{}",
            json!({
                "tool": "boresight", "problem": path, "cpu_s": cpu_s[repeats / 2], "cpu_s_each": cpu_s,
                "outliers": outliers.all.len(), "above_5_sigma": outliers.above.len(), "missed": missed,
                "good_lost": lost, "good_lost_percent": 100.0 * lost as f64 / n_good as f64,
                "passes": calibration.solve.passes, "evaluations": calibration.solve.evaluations,
                "iterations": calibration.solve.iterations,
                "converged": calibration.solve.converged,
            })
        );
    }
}

/// Returns the CPU time that this process has used, in seconds.
fn cpu_seconds() -> f64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}
