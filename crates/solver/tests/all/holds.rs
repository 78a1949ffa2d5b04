//! What is held keeps its very bits, and has no covariance.

use boresight_geometry::Pose;
use boresight_solver::{Elimination, Error, Problem, SolveOptions, Stop, covariance, solve};

use super::support::{Clouds, as_terms, counters, dense_covariance};

fn bits(values: &[f64]) -> Vec<u64> {
    values.iter().map(|value| value.to_bits()).collect()
}

/// The start of a block's values; all blocks of clouds before the poses have six.
fn first_value(clouds: &Clouds, view: usize) -> usize {
    clouds.sensors.len() * 6 + view * 7
}

fn solved(clouds: &Clouds) -> boresight_solver::Solution {
    let terms = clouds.terms();
    let problem = Problem::new(&clouds.parameters, as_terms(&terms)).expect("the problem is sound");
    solve(&problem, &SolveOptions::default()).expect("the problem can be solved")
}

#[test]
fn held_numbers_keep_their_bits() {
    for elimination in [Elimination::First, Elimination::Reduced] {
        let mut clouds = Clouds::new(2, 6, 10, elimination);
        let sensor = clouds.sensors[0];
        let mut values = clouds.parameters.values().as_slice().to_vec();
        // The sign of a zero is a bit too.
        (values[1], values[4]) = (-0.0, 0.1 + 0.2);
        clouds.parameters.set_values(&values);
        clouds.parameters.hold(sensor, 1);
        clouds.parameters.hold(sensor, 4);
        assert!(clouds.parameters.is_held(sensor, 4) && !clouds.parameters.is_held(sensor, 0));
        assert_eq!(clouds.parameters.free_count(), 10 + 36);
        let solution = solved(&clouds);
        assert!(solution.stop.is_converged(), "{solution:?}");
        for (k, (start, found)) in bits(&values).iter().zip(bits(&solution.values)).enumerate().take(12) {
            assert_eq!(*start == found, k == 1 || k == 4, "value {k} of {elimination:?}");
        }
    }
}

#[test]
fn a_held_rotation_keeps_its_bits_while_its_translation_moves() {
    for elimination in [Elimination::First, Elimination::Reduced] {
        let mut clouds = Clouds::new(1, 6, 10, elimination);
        let mut values = clouds.parameters.values().as_slice().to_vec();
        let place = first_value(&clouds, 2);
        // A rotation a few roundings off its unit length would change if it were normalised anew.
        values[place..place + 4].iter_mut().for_each(|x| *x *= 1.0 + 1e-15);
        clouds.parameters.set_values(&values);
        (0..3).for_each(|k| clouds.parameters.hold(clouds.poses[2], k));
        clouds.parameters.hold(clouds.poses[2], 5);
        let solution = solved(&clouds);
        assert!(solution.stop.is_converged(), "{solution:?}");
        let (start, found) = (bits(&values[place..place + 7]), bits(&solution.values[place..place + 7]));
        for k in 0..7 {
            assert_eq!(start[k] == found[k], ![4, 5].contains(&k), "value {k} of {elimination:?}");
        }
    }
}

/// Holding some columns of a pose takes them out of the covariance, and their share of it with them.
#[test]
fn held_columns_have_no_covariance() {
    for held in [vec![0, 1, 2], vec![5], (0..6).collect()] {
        let mut clouds = Clouds::new(1, 5, 10, Elimination::First);
        held.iter().for_each(|&k| clouds.parameters.hold(clouds.poses[1], k));
        clouds.parameters.hold(clouds.sensors[0], 3);
        let values = solved(&clouds).values;
        clouds.parameters.set_values(&values);
        let terms = clouds.terms();
        let problem = Problem::new(&clouds.parameters, as_terms(&terms)).expect("the problem is sound");
        let found = covariance(&problem, &values, &SolveOptions::default()).expect("the data constrain it");
        let residuals = |values: boresight_solver::Values<'_>| clouds.residuals(values);
        let dense = dense_covariance(&clouds.parameters, &clouds.blocks(), residuals, 3e-3);
        for view in [0, 1] {
            let own = found.eliminated(clouds.poses[view]).expect("the block was eliminated");
            let first = clouds.parameters.columns(clouds.poses[view]).start;
            for a in 0..6 {
                for b in 0..6 {
                    let expected = dense[(first + a, first + b)];
                    // Variances are of the order of 1e-1 of a squared noise unit of 1e-2.
                    assert!(
                        (own[a][b] - expected).abs() < 1e-13,
                        "{view} {a} {b}: {:e} {expected:e}",
                        own[a][b]
                    );
                    assert!(view == 0 || !held.contains(&a) || own[a][b] == 0.0);
                }
            }
        }
        let sensor = clouds.sensors[0];
        assert_eq!(found.between((sensor, 3), (sensor, 3)), 0.0);
        assert!(found.between((sensor, 2), (sensor, 2)) > 0.0);
    }
}

#[test]
fn with_everything_held_nothing_moves() {
    for elimination in [Elimination::First, Elimination::Reduced] {
        let mut clouds = Clouds::new(2, 4, 5, elimination);
        for block in clouds.blocks() {
            clouds.parameters.hold_all(block);
        }
        assert_eq!(clouds.parameters.free_count(), 0);
        let solution = solved(&clouds);
        assert_eq!(bits(&solution.values), bits(clouds.parameters.values().as_slice()));
        let Stop::PredictedDecrease { predicted, .. } = solution.stop else { panic!("{solution:?}") };
        assert_eq!(predicted, 0.0);
        assert_eq!(solution.counters, counters(1, 1, 1, 0));
        let expected: f64 = clouds.residuals(clouds.parameters.values()).iter().map(|r| r * r).sum();
        assert!((solution.cost / expected - 1.0).abs() < 1e-14);
    }
}

#[test]
fn a_pose_that_nothing_constrains_but_itself_is_refused_by_name() {
    // A single point leaves the rotation free, and with the sensor held there is no reduced system
    // that could notice.
    let mut clouds = Clouds::new(1, 2, 1, Elimination::First);
    clouds.parameters.hold_all(clouds.sensors[0]);
    (0..3).for_each(|k| clouds.parameters.hold(clouds.poses[0], k));
    let terms = clouds.terms();
    let problem = Problem::new(&clouds.parameters, as_terms(&terms)).expect("the problem is sound");
    let refused = covariance(&problem, clouds.parameters.values().as_slice(), &SolveOptions::default());
    let Err(Error::LooseBlock { block }) = refused else { panic!("{refused:?}") };
    assert_eq!(block, clouds.poses[1]);
}

#[test]
fn translations_whose_columns_are_held_turn_with_their_rotation() {
    // As the documentation of `hold` says; a caller who relies on the opposite should see this fail.
    let mut clouds = Clouds::new(1, 6, 10, Elimination::First);
    (3..6).for_each(|k| clouds.parameters.hold(clouds.poses[0], k));
    let solution = solved(&clouds);
    let pose = |values: &[f64]| -> Pose { clouds.parameters.at(values).pose(clouds.poses[0]) };
    let (start, found) = (pose(clouds.parameters.values().as_slice()), pose(&solution.values));
    assert!((start.translation - found.translation).norm() > 1e-3);
    // Turning about the origin keeps the distance from it, to rounding.
    assert!((start.translation.norm() - found.translation.norm()).abs() < 1e-13);
}
