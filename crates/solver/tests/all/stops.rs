//! Limits, cancelling and reports.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use boresight_solver::{
    Elimination, Observer, Parameters, Problem, Progress, Solution, SolveOptions, Stop, solve, solve_observed,
};

use super::support::{Clouds, Function, as_terms, counters};

fn clouds() -> Clouds {
    Clouds::new(2, 6, 8, Elimination::First)
}

fn solved(clouds: &Clouds, options: &SolveOptions, observer: Option<Observer>) -> Solution {
    let terms = clouds.terms();
    let problem = Problem::new(&clouds.parameters, as_terms(&terms)).expect("the problem is sound");
    solve_observed(&problem, options, observer).expect("the problem can be solved")
}

fn cost_at(clouds: &Clouds, values: &[f64]) -> f64 {
    clouds.residuals(clouds.parameters.at(values)).iter().map(|r| r * r).sum()
}

fn same_cost(clouds: &Clouds, solution: &Solution) {
    // Sums of a few hundred squares, in another order.
    assert!((solution.cost / cost_at(clouds, &solution.values) - 1.0).abs() < 1e-12, "{solution:?}");
}

#[test]
fn each_step_is_reported_once_with_falling_cost() {
    let clouds = clouds();
    let reports = Arc::new(Mutex::new(Vec::<Progress>::new()));
    let sink = Arc::clone(&reports);
    let observer: Observer = Arc::new(move |progress| sink.lock().expect("no one panicked").push(progress));
    let solution = solved(&clouds, &SolveOptions::default(), Some(observer));
    let reports = reports.lock().expect("no one panicked");
    assert_eq!(reports.len(), solution.counters.iterations);
    assert_eq!(solution.counters, counters(5, 5, 5, 0));
    let mut cost = cost_at(&clouds, clouds.parameters.values().as_slice());
    for (idx, report) in reports.iter().enumerate() {
        assert_eq!(report.iteration, idx + 1);
        assert!(report.cost < cost && report.predicted_decrease > 0.0 && report.damping > 0.0, "{report:?}");
        cost = report.cost;
    }
    assert_eq!(cost.to_bits(), solution.cost.to_bits());
    let Stop::PredictedDecrease { predicted, .. } = solution.stop else { panic!("{solution:?}") };
    assert_eq!(reports[reports.len() - 1].predicted_decrease.to_bits(), predicted.to_bits());
}

#[test]
fn a_stop_without_a_step_is_not_reported() {
    let mut parameters = Parameters::default();
    let block = parameters.add_vector(&[0.0]);
    let term = Function::new(&[block], 2, |values| Some(vec![vec![1.0, values.vector(block)[0]]; 2]));
    let problem = Problem::new(&parameters, vec![&term]).expect("the problem is sound");
    let observer: Observer = Arc::new(|progress| panic!("{progress:?}"));
    let solution =
        solve_observed(&problem, &SolveOptions::default(), Some(observer)).expect("it can be solved");
    assert!(matches!(solution.stop, Stop::Exact { .. }), "{solution:?}");
}

#[test]
fn iterations_are_limited_exactly() {
    let clouds = clouds();
    let mut last = f64::INFINITY;
    for limit in 0..5 {
        let options = SolveOptions { max_iterations: limit, ..SolveOptions::default() };
        let solution = solved(&clouds, &options, None);
        assert_eq!(solution.stop, Stop::Iterations { count: limit });
        assert!(!solution.stop.is_converged());
        assert_eq!(solution.counters, counters(limit, limit + 1, limit, 0));
        // The values are those of the last step, and the cost is theirs, also where none was taken.
        same_cost(&clouds, &solution);
        assert!(solution.cost < last);
        last = solution.cost;
    }
    let options = SolveOptions { max_iterations: 5, ..SolveOptions::default() };
    assert!(solved(&clouds, &options, None).stop.is_converged());
}

#[test]
fn time_is_limited_after_the_first_step() {
    let clouds = clouds();
    let options = SolveOptions { time_limit: Some(Duration::ZERO), ..SolveOptions::default() };
    let solution = solved(&clouds, &options, None);
    assert_eq!(solution.stop, Stop::TimeLimit { seconds: 0.0 });
    assert_eq!(solution.counters.iterations, 1);
    same_cost(&clouds, &solution);
    let options = SolveOptions { time_limit: Some(Duration::from_secs(3600)), ..SolveOptions::default() };
    assert_eq!(solved(&clouds, &options, None), solved(&clouds, &SolveOptions::default(), None));
}

#[test]
fn cancelling_keeps_the_best_values() {
    let clouds = clouds();
    for (after, iterations) in [(0, 0), (1, 1), (3, 3)] {
        let cancel = Arc::new(AtomicBool::new(after == 0));
        let options = SolveOptions { cancel: Some(Arc::clone(&cancel)), ..SolveOptions::default() };
        let observer: Observer = Arc::new(move |progress| {
            if progress.iteration == after {
                cancel.store(true, Ordering::Relaxed);
            }
        });
        let solution = solved(&clouds, &options, Some(observer));
        assert_eq!(solution.stop, Stop::Cancelled);
        assert_eq!(solution.counters.iterations, iterations);
        same_cost(&clouds, &solution);
        let limited = SolveOptions { max_iterations: iterations, ..SolveOptions::default() };
        assert_eq!(solved(&clouds, &limited, None).values, solution.values);
    }
}

#[test]
fn a_search_that_finds_no_step_says_so() {
    // The gradient reported points uphill, as from a wrong derivative.
    let mut parameters = Parameters::default();
    let block = parameters.add_vector(&[3.0]);
    let term = Function::new(&[block], 1, |values| Some(vec![vec![-1.0, values.vector(block)[0]]]));
    let problem = Problem::new(&parameters, vec![&term]).expect("the problem is sound");
    let solution = solve(&problem, &SolveOptions::default()).expect("it can be solved");
    let Stop::NoStep { damping, above } = solution.stop else { panic!("{solution:?}") };
    assert!(damping > above && !solution.stop.is_converged());
    assert_eq!((solution.values, solution.cost), (vec![3.0], 9.0));
}
