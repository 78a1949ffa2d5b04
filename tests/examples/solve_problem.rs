//! Solves a conformance problem and prints one line of JSON, for `cargo xtask bench`.
#![allow(clippy::print_stdout, clippy::unwrap_used, reason = "a measuring program for developers")]

use std::env;
use std::path::Path;
use std::time::Instant;

use boresight_adjust::{AdjustOptions, Hold, Regularization, Rejection, optimize};
use boresight_camera::Model;
use boresight_data::{CameraId, Dataset};
use boresight_solver::pulp::{Arch, Simd, WithSimd};
use boresight_tests::mrcal_problem::MrcalProblem;
use serde_json::json;

fn main() {
    let arguments: Vec<String> = env::args().collect();
    let [_, path, rest @ ..] = arguments.as_slice() else {
        panic!("usage: solve_problem PROBLEM.npz [THREADS] [REPEATS] [LENS]");
    };
    let threads = rest.first().map_or(1, |text| text.parse().unwrap());
    let repeats: usize = rest.get(1).map_or(3, |text| text.parse().unwrap());
    let lens: Model = rest.get(2).map_or("opencv8", String::as_str).parse().unwrap();
    let mut problem = MrcalProblem::read(Path::new(path), lens, false).unwrap();

    problem.arrays = Default::default();
    let n_corners = problem.dataset.observation_count();
    // Reading the file must not count as the solver's peak.
    std::fs::write("/proc/self/clear_refs", "5").unwrap();
    let before_kb = resident_kb("VmRSS:");
    let options = AdjustOptions {
        rejection: Rejection::None,
        regularization: Regularization::Mrcal22,
        threads,
        // The core of a splined lens is held: its knots can say the same.
        holds: match lens.local_support() {
            Some(_) => problem.dataset.cameras.ids().flat_map(core_holds).collect(),
            None => Vec::new(),
        },
        ..AdjustOptions::default()
    };
    let solve = |max_iterations: usize| {
        let options = AdjustOptions { max_iterations, ..options.clone() };
        let (cpu, wall) = (cpu_seconds(), Instant::now());
        let solution = optimize(&problem.dataset, &problem.seed, &options).unwrap().solution;
        (cpu_seconds() - cpu, wall.elapsed().as_secs_f64(), solution)
    };
    let (mut cpu_s, mut wall_s, mut one_s) = (Vec::new(), Vec::new(), Vec::new());
    let mut last = None;
    for _ in 0..repeats {
        let (cpu, wall, solution) = solve(options.max_iterations);
        cpu_s.push(cpu);
        wall_s.push(wall);
        one_s.push(solve(1).0);
        last = Some(solution);
    }
    let solution = last.unwrap();
    let peak_rss_kb = resident_kb("VmHWM:");
    for times in [&mut cpu_s, &mut wall_s, &mut one_s] {
        times.sort_by(f64::total_cmp);
    }
    let (cpu, wall) = (cpu_s[repeats / 2], wall_s[repeats / 2]);
    // What an iteration takes is the difference to a solve of one, so that setting up is not in it. Each
    // is the least of its repeats, as the peak is the most of its own: neighbours of a virtual machine
    // slow a cache or a front end down that is shared with them, but not a loop of additions in registers.
    // A spline starts from a stand-in, which takes more steps where it may take one only: there the
    // difference says nothing.
    let is_comparable = lens.local_support().is_none();
    let iteration_s =
        is_comparable.then(|| (cpu_s[0] - one_s[0]) / (solution.counters.evaluations - 2) as f64);
    let peak = peak_flops_per_second();
    println!(
        "{}",
        json!({
            "tool": "boresight", "version": env!("CARGO_PKG_VERSION"), "threads": threads,
            "cpu_s": cpu, "cpu_s_each": cpu_s, "wall_s": wall,
            "cost": solution.cost, "iterations": solution.counters.iterations,
            "evaluations": solution.counters.evaluations,
            "rejected_steps": solution.counters.rejected_steps,
            "stop": solution.stop.to_string(), "corners": n_corners,
            "iteration_s": iteration_s, "floor_flops": floor_flops(&problem.dataset),
            "peak_flops_per_s": peak,
            "peak_rss_kb": peak_rss_kb, "rss_before_solve_kb": before_kb,
        })
    );
}

fn core_holds(camera: CameraId) -> impl Iterator<Item = Hold> {
    (0..4).map(move |param| Hold::LensParam(camera, param))
}

/// Returns the floating-point operations that an iteration cannot do without: 950 for each corner, and
/// the elimination of each frame's pose from the 18 columns of each camera that sees it and two of shape.
fn floor_flops(dataset: &Dataset) -> f64 {
    let mut n_views = vec![0; dataset.frames.len()];
    dataset.views.iter().for_each(|view| n_views[view.frame.0 as usize] += 1);
    let elimination: f64 = n_views.iter().map(|&m| 6.0 * (18.0 * f64::from(m) + 2.0).powi(2)).sum();
    950.0 * dataset.observation_count() as f64 + elimination
}

/// Returns the fused multiply-adds, counted twice, that one core does in a second of CPU time when
/// nothing else holds it up.
fn peak_flops_per_second() -> f64 {
    const ROUNDS: usize = 1_000_000;
    const CHAINS: usize = 16;
    struct Multiply;
    impl WithSimd for Multiply {
        type Output = f64;
        #[inline(always)]
        fn with_simd<S: Simd>(self, simd: S) -> f64 {
            let factor = simd.splat_f64s(std::hint::black_box(0.999));
            let summand = simd.splat_f64s(std::hint::black_box(0.5));
            let mut sums = [simd.splat_f64s(0.0); CHAINS];
            for _ in 0..ROUNDS {
                for sum in &mut sums {
                    *sum = simd.mul_add_f64s(factor, *sum, summand);
                }
            }
            let mut total = sums[0];
            for sum in sums {
                total = simd.add_f64s(total, sum);
            }
            std::hint::black_box(simd.reduce_sum_f64s(total));
            (2 * ROUNDS * CHAINS * S::F64_LANES) as f64
        }
    }
    let round = |_| {
        let start = cpu_seconds();
        let flops = Arch::new().dispatch(Multiply);
        flops / (cpu_seconds() - start)
    };
    let mut rounds: Vec<f64> = (0..9).map(round).collect();
    rounds.sort_by(f64::total_cmp);
    rounds[rounds.len() - 1]
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
