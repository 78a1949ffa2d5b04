//! The classic small problems of Moré, Garbow & Hillstrom 1981, and how much work they are.

use boresight_solver::{Counters, Parameters, Stop};

use super::support::{Function, counters, solve_plainly};

/// The rows `[J r]` at a point.
type Rows = fn(x: &[f64]) -> Vec<Vec<f64>>;

/// All of these are met exactly at `optimum`; `tolerance` is absolute.
fn check(rows: Rows, start: &[f64], optimum: &[f64], tolerance: f64, expected: Counters) {
    let mut parameters = Parameters::default();
    let block = parameters.add_vector(start);
    let n_rows = rows(start).len();
    let term = Function::new(&[block], n_rows, |values| Some(rows(values.vector(block))));
    let solution = solve_plainly(&parameters, &[&term]);
    assert!(matches!(solution.stop, Stop::Exact { .. }), "{solution:?}");
    for (found, expected) in solution.values.iter().zip(optimum) {
        assert!((found - expected).abs() < tolerance, "{solution:?}");
    }
    // A snapshot: the numbers may change, but not unseen.
    assert_eq!(solution.counters, expected);
}

fn rosenbrock(x: &[f64]) -> Vec<Vec<f64>> {
    vec![vec![-20.0 * x[0], 10.0, 10.0 * (x[1] - x[0] * x[0])], vec![-1.0, 0.0, 1.0 - x[0]]]
}

#[test]
fn rosenbrock_from_the_far_side_of_the_valley() {
    // Residuals of 1e-11 are parameters of 1e-11, times ten in the valley's direction.
    check(rosenbrock, &[-1.2, 1.0], &[1.0, 1.0], 1e-10, counters(21, 38, 37, 16));
}

fn powell_singular(x: &[f64]) -> Vec<Vec<f64>> {
    let (a, b) = (x[1] - 2.0 * x[2], x[0] - x[3]);
    let (r5, r10) = (5f64.sqrt(), 10f64.sqrt());
    vec![
        vec![1.0, 10.0, 0.0, 0.0, x[0] + 10.0 * x[1]],
        vec![0.0, 0.0, r5, -r5, r5 * (x[2] - x[3])],
        vec![0.0, 2.0 * a, -4.0 * a, 0.0, a * a],
        vec![2.0 * r10 * b, 0.0, 0.0, -2.0 * r10 * b, r10 * b * b],
    ]
}

#[test]
fn powell_with_a_singular_optimum() {
    // Two residuals are squares, so parameters are only known to the root of 1e-11.
    check(powell_singular, &[3.0, -1.0, 0.0, 1.0], &[0.0; 4], 1e-5, counters(20, 21, 20, 0));
}

fn beale(x: &[f64]) -> Vec<Vec<f64>> {
    let row = |(power, y): (i32, f64)| {
        let slope = x[0] * f64::from(power) * x[1].powi(power - 1);
        vec![-(1.0 - x[1].powi(power)), slope, y - x[0] * (1.0 - x[1].powi(power))]
    };
    [(1, 1.5), (2, 2.25), (3, 2.625)].map(row).to_vec()
}

#[test]
fn beale_at_the_usual_start() {
    check(beale, &[1.0, 1.0], &[3.0, 0.5], 1e-10, counters(7, 11, 10, 3));
}

fn helical_valley(x: &[f64]) -> Vec<Vec<f64>> {
    let square = x[0] * x[0] + x[1] * x[1];
    let turn = std::f64::consts::TAU;
    let angle = x[1].atan2(x[0]) / turn;
    let radius = square.sqrt();
    vec![
        vec![
            100.0 * x[1] / (turn * square),
            -100.0 * x[0] / (turn * square),
            10.0,
            10.0 * (x[2] - 10.0 * angle),
        ],
        vec![10.0 * x[0] / radius, 10.0 * x[1] / radius, 0.0, 10.0 * (radius - 1.0)],
        vec![0.0, 0.0, 1.0, x[2]],
    ]
}

#[test]
fn helical_valley_from_half_a_turn_away() {
    check(helical_valley, &[-1.0, 0.0, 0.0], &[1.0, 0.0, 0.0], 1e-10, counters(8, 11, 10, 2));
}

#[test]
fn a_start_at_the_optimum_takes_no_step() {
    check(rosenbrock, &[1.0, 1.0], &[1.0, 1.0], f64::MIN_POSITIVE, counters(0, 1, 0, 0));
}

/// A straight line through four points: linear, so that the first undamped step arrives.
#[test]
fn a_linear_problem_stops_by_its_predicted_decrease() {
    let rows = |x: &[f64]| -> Vec<Vec<f64>> {
        let row = |(t, y): (f64, f64)| vec![1.0, t, x[0] + x[1] * t - y];
        [(0.0, 1.1), (1.0, 2.9), (2.0, 5.2), (3.0, 6.8)].map(row).to_vec()
    };
    let mut parameters = Parameters::default();
    let block = parameters.add_vector(&[0.0, 0.0]);
    let term = Function::new(&[block], 4, |values| Some(rows(values.vector(block))));
    let solution = solve_plainly(&parameters, &[&term]);
    let Stop::PredictedDecrease { predicted, below } = solution.stop else { panic!("{solution:?}") };
    assert!(predicted <= below);
    // The normal equations of these points give exactly 1.09 and 1.94. Steps damped by 1e-3 and
    // less leave 1e-6 after two, and 1e-9 after three.
    let error = (solution.values[0] - 1.09).abs().max((solution.values[1] - 1.94).abs());
    assert!(error < 1e-8, "{solution:?}");
    // What the model promised for the last step is what the rows say.
    let cost: f64 = rows(&solution.values).iter().map(|row| row[2] * row[2]).sum();
    assert!((solution.cost - cost).abs() < 1e-14, "{} {cost}", solution.cost);
}
