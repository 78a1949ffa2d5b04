//! Eliminating first or not at all: the same optimum and the same covariance, which is that of the
//! dense JᵀJ.

use boresight_solver::{
    BlockId, Covariance, Elimination, LinearFunctions, Problem, Solution, SolveOptions, Stop, covariance,
    solve,
};
use faer::Mat;

use super::support::{Clouds, as_terms, check_term, counters, dense_covariance};

/// Moves the start as close to the optimum as rounding allows: from there, every further solve is one
/// more undamped step, which is taken without asking for a lower cost.
fn polished(mut clouds: Clouds) -> Clouds {
    for _ in 0..5 {
        let (solution, _) =
            solved(&clouds, &SolveOptions { first_damping: 1e-12, ..SolveOptions::default() });
        assert!(matches!(solution.stop, Stop::PredictedDecrease { .. }), "{solution:?}");
        clouds.parameters.set_values(&solution.values);
    }
    clouds
}

fn solved(clouds: &Clouds, options: &SolveOptions) -> (Solution, Covariance) {
    let terms = clouds.terms();
    let problem = Problem::new(&clouds.parameters, as_terms(&terms)).expect("the problem is sound");
    let solution = solve(&problem, options).expect("the problem can be solved");
    let covariance = covariance(&problem, &solution.values, options).expect("the data constrain it");
    (solution, covariance)
}

fn block_of(covariance: &Mat<f64>, clouds: &Clouds, block: BlockId) -> Vec<f64> {
    let columns = clouds.parameters.columns(block);
    columns.clone().flat_map(|row| columns.clone().map(move |column| covariance[(row, column)])).collect()
}

/// Compares matrices relative to the largest entry of the expected one.
fn close(found: &[f64], expected: &[f64], tolerance: f64) {
    assert_eq!(found.len(), expected.len());
    let largest = expected.iter().fold(0.0f64, |largest, x| largest.max(x.abs()));
    for (found, expected) in found.iter().zip(expected) {
        assert!((found - expected).abs() <= tolerance * largest, "{found:e} against {expected:e}");
    }
}

fn own(covariance: &Covariance, block: BlockId) -> Vec<f64> {
    (0..6).flat_map(|a| (0..6).map(move |b| covariance.between((block, a), (block, b)))).collect()
}

#[test]
fn rows_of_clouds_are_what_differences_find() {
    let clouds = Clouds::new(2, 3, 5, Elimination::First);
    let terms = clouds.terms();
    for (sight, term) in terms.iter().enumerate() {
        let residuals = |values: boresight_solver::Values<'_>| -> Vec<f64> {
            clouds.rows(sight, values).iter().map(|row| row[12]).collect()
        };
        check_term(&clouds.parameters, term, Some(&residuals), 3e-3, 1e-11);
    }
}

#[test]
fn both_ways_end_at_the_same_optimum_with_the_same_covariance() {
    let (n_sensors, n_views, n_points) = (2, 7, 11);
    let eliminated = polished(Clouds::new(n_sensors, n_views, n_points, Elimination::First));
    let reduced = polished(Clouds::new(n_sensors, n_views, n_points, Elimination::Reduced));
    let (first, first_covariance) = solved(&eliminated, &SolveOptions::default());
    let (second, second_covariance) = solved(&reduced, &SolveOptions::default());
    // Values are of the order of one; what the two ways round differently is amplified by the condition.
    for (first, second) in first.values.iter().zip(&second.values) {
        assert!((first - second).abs() < 1e-12, "{first} {second}");
    }
    assert!((first.cost / second.cost - 1.0).abs() < 1e-13);
    let residuals = |values: boresight_solver::Values<'_>| eliminated.residuals(values);
    let dense = dense_covariance(&eliminated.parameters, &eliminated.blocks(), residuals, 3e-3);
    // The entries of JᵀJ come from differences that are good to 1e-12.
    for &sensor in &eliminated.sensors {
        let expected = block_of(&dense, &eliminated, sensor);
        close(&own(&first_covariance, sensor), &expected, 1e-9);
        close(&own(&second_covariance, sensor), &expected, 1e-9);
        assert!(first_covariance.eliminated(sensor).is_none());
    }
    for &pose in &eliminated.poses {
        let expected = block_of(&dense, &eliminated, pose);
        close(first_covariance.eliminated(pose).expect("it was eliminated").as_flattened(), &expected, 1e-9);
        close(&own(&second_covariance, pose), &expected, 1e-9);
    }
    // Across blocks as well.
    let [a, b] = [eliminated.sensors[0], eliminated.sensors[1]].map(|block| (block, 4));
    let columns = [a, b].map(|(block, k)| eliminated.parameters.columns(block).start + k);
    close(&[first_covariance.between(a, b)], &[dense[(columns[0], columns[1])]], 1e-9);
}

#[test]
fn covariance_is_the_scatter_that_one_expects() {
    let (solution, covariance) = solved(&Clouds::new(1, 6, 20, Elimination::First), &SolveOptions::default());
    assert_eq!(covariance.prior_cost, 0.0);
    // The cost reported after the last step is a prediction, right to a small part of the step's 1e-6.
    assert!((covariance.observation_cost - solution.cost).abs() < 1e-8, "{}", solution.cost);
    // Uniform noise in [-1, 1) has a third of a variance: 318 degrees of freedom, sigma 5 %.
    assert!((solution.cost / 318.0 / (1.0 / 3.0) - 1.0).abs() < 0.15, "{}", solution.cost);
}

#[test]
fn elimination_does_not_change_the_work() {
    // A snapshot: the numbers may change, but not unseen.
    for elimination in [Elimination::First, Elimination::Reduced] {
        let (solution, _) = solved(&Clouds::new(2, 7, 11, elimination), &SolveOptions::default());
        assert_eq!(solution.counters, counters(4, 4, 4, 0), "{elimination:?}");
    }
}

#[test]
fn linear_functions_are_as_well_known_as_the_dense_covariance_says() {
    let eliminated = polished(Clouds::new(2, 5, 11, Elimination::First));
    let residuals = |values: boresight_solver::Values<'_>| eliminated.residuals(values);
    let dense = dense_covariance(&eliminated.parameters, &eliminated.blocks(), residuals, 3e-3);
    let (_, covariance) = solved(&eliminated, &SolveOptions::default());
    // Three functions: of eliminated poses, of one sensor, and of both.
    let weight = |i: usize| ((i * 7 + 3) % 11) as f64 / 5.0 - 1.0;
    let n = eliminated.parameters.column_count();
    let mut functions = LinearFunctions::new(3);
    let mut weights = Mat::<f64>::zeros(3, n);
    let mut add = |first: usize, block: BlockId, salt: usize, n_rows: usize| {
        let rows: Vec<f64> = (0..6 * n_rows).map(|i| weight(i + salt)).collect();
        functions.add(first, block, 6, &rows);
        for (i, entry) in rows.iter().enumerate() {
            weights[(first + i / 6, eliminated.parameters.columns(block).start + i % 6)] += entry;
        }
    };
    for (salt, &pose) in eliminated.poses.iter().enumerate() {
        add(0, pose, salt, 1);
    }
    add(1, eliminated.sensors[1], 5, 2);
    add(2, eliminated.poses[3], 9, 1);
    add(2, eliminated.poses[3], 2, 1);
    let columns: Vec<(BlockId, usize)> =
        eliminated.sensors.iter().flat_map(|&sensor| (0..6).map(move |k| (sensor, k))).collect();
    let found = covariance.of_functions(&functions, &columns);
    let mut expected = Vec::new();
    for row in 0..3 {
        let with = |column: usize| (0..n).map(|k| weights[(row, k)] * dense[(k, column)]).sum::<f64>();
        expected
            .extend(columns.iter().map(|(block, k)| with(eliminated.parameters.columns(*block).start + k)));
        expected.extend((0..3).map(|other| (0..n).map(|k| with(k) * weights[(other, k)]).sum::<f64>()));
    }
    close(&found, &expected, 1e-9);
}
