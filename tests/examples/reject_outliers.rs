//! Solves conformance problems with their outliers, by defaults, and prints one line of JSON for each:
//! what was rejected and the CPU time, on one thread, with and without covariance and report.
#![allow(clippy::print_stdout, clippy::unwrap_used, reason = "a measuring program for developers")]

use std::collections::BTreeSet;
use std::env;
use std::path::Path;

use boresight_adjust::{AdjustOptions, adjust, settle};
use boresight_tests::mrcal_problem::MrcalProblem;
use serde_json::json;

fn main() {
    let arguments: Vec<String> = env::args().skip(1).collect();
    let repeats = 9;
    for path in &arguments {
        let problem = MrcalProblem::read(Path::new(path), "opencv8".parse().unwrap(), true).unwrap();
        let options = AdjustOptions { threads: 1, ..AdjustOptions::default() };
        let (mut cpu_s, mut whole_s, mut last) = (Vec::new(), Vec::new(), None);
        for _ in 0..repeats {
            let start = cpu_seconds();
            last = Some(settle(&problem.dataset, &problem.seed, &options).unwrap());
            let middle = cpu_seconds();
            adjust(&problem.dataset, &problem.seed, &options, None).unwrap();
            cpu_s.push(middle - start);
            whole_s.push(cpu_seconds() - middle);
        }
        let least = |times: &[f64]| times.iter().copied().fold(f64::INFINITY, f64::min);
        let settled = last.unwrap();
        let sigma = problem.arrays.number("noise_sigma");
        let outliers = problem.true_outliers(sigma, 5.0);
        // The boards are whole: a corner's place in its view is its number.
        let rejected: BTreeSet<(usize, u32)> =
            settled.rejected.iter().map(|&(view_idx, place)| (view_idx, place as u32)).collect();
        let missed = outliers.above.iter().filter(|place| !rejected.contains(place)).count();
        let lost = rejected.iter().filter(|place| !outliers.all.contains(place)).count();
        let n_good = problem.dataset.observation_count() - outliers.all.len();
        println!(
            "{}",
            json!({
                "tool": "boresight", "problem": path, "cpu_s": least(&cpu_s), "cpu_s_each": cpu_s,
                "cpu_s_with_report": least(&whole_s),
                "outliers": outliers.all.len(), "above_5_sigma": outliers.above.len(), "missed": missed,
                "good_lost": lost, "good_lost_percent": 100.0 * lost as f64 / n_good as f64,
                "passes": settled.solve.passes, "evaluations": settled.solve.evaluations,
                "iterations": settled.solve.iterations,
                "converged": settled.solve.converged,
            })
        );
    }
}

/// Returns the CPU time that this process has used, in seconds.
fn cpu_seconds() -> f64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}
