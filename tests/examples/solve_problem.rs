//! Solves a conformance problem and prints one line of JSON, for `cargo xtask bench`.
#![allow(clippy::print_stdout, clippy::unwrap_used, reason = "a measuring program for developers")]

use std::env;
use std::path::Path;
use std::time::Instant;

use boresight_adjust::{AdjustOptions, Regularization, Rejection, optimize};
use boresight_tests::mrcal_problem::MrcalProblem;
use serde_json::json;

fn main() {
    let arguments: Vec<String> = env::args().collect();
    let [_, path, rest @ ..] = arguments.as_slice() else {
        panic!("usage: solve_problem PROBLEM.npz [THREADS] [REPEATS]");
    };
    let threads = rest.first().map_or(1, |text| text.parse().unwrap());
    let repeats: usize = rest.get(1).map_or(3, |text| text.parse().unwrap());
    let mut problem = MrcalProblem::read(Path::new(path), "opencv8".parse().unwrap(), false).unwrap();

    problem.arrays = Default::default();
    let n_corners = problem.dataset.observation_count();
    let before_kb = resident_kb("VmRSS:");
    let options = AdjustOptions {
        rejection: Rejection::None,
        regularization: Regularization::Mrcal22,
        threads,
        ..AdjustOptions::default()
    };
    let (mut cpu_s, mut wall_s) = (Vec::new(), Vec::new());
    let mut last = None;
    for _ in 0..repeats {
        let (cpu, wall) = (cpu_seconds(), Instant::now());
        let solution = optimize(&problem.dataset, &problem.seed, &options).unwrap().solution;
        cpu_s.push(cpu_seconds() - cpu);
        wall_s.push(wall.elapsed().as_secs_f64());
        last = Some(solution);
    }
    let solution = last.unwrap();
    cpu_s.sort_by(f64::total_cmp);
    wall_s.sort_by(f64::total_cmp);
    let (cpu, wall) = (cpu_s[repeats / 2], wall_s[repeats / 2]);
    println!(
        "{}",
        json!({
            "tool": "boresight", "version": env!("CARGO_PKG_VERSION"), "threads": threads,
            "cpu_s": cpu, "cpu_s_each": cpu_s, "wall_s": wall,
            "cost": solution.cost, "iterations": solution.counters.iterations,
            "evaluations": solution.counters.evaluations,
            "rejected_steps": solution.counters.rejected_steps,
            "stop": solution.stop.to_string(), "corners": n_corners,
            "ns_per_corner_evaluation": cpu * 1e9 / n_corners as f64 / solution.counters.evaluations as f64,
            "peak_rss_kb": resident_kb("VmHWM:"), "rss_before_solve_kb": before_kb,
        })
    );
}

/// Returns the CPU time that this process has used, in seconds.
fn cpu_seconds() -> f64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}

/// Returns a line of `/proc/self/status`, in kB.
fn resident_kb(key: &str) -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find(|line| line.starts_with(key)).unwrap_or_default();
    line.split_whitespace().nth(1).and_then(|number| number.parse().ok()).unwrap_or(0)
}
