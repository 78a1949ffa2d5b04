//! Priors: what they report against differences, and what they settle on.

use boresight_geometry::{Pose, Vector3, Vector6};
use boresight_solver::{
    Elimination, Parameters, PosePrior, Problem, SolveOptions, Stop, Term, VectorPrior, covariance, solve,
};

use super::support::{Numbers, check_term, solve_plainly};

fn pose(numbers: &mut Numbers, angle: f64, distance: f64) -> Pose {
    let mut vector = || Vector3::new(numbers.next(), numbers.next(), numbers.next());
    let (axis, translation) = (vector().normalize(), vector() * distance);
    Pose::from_rodrigues(axis * angle, translation)
}

#[test]
fn vector_priors_report_what_differences_find() {
    let mut parameters = Parameters::default();
    parameters.add_vector(&[9.0]);
    let block = parameters.add_vector(&[1.5, -2.0, 0.25]);
    let rows = vec![(0, 1.0, 10.0), (2, -1.0, 0.5), (0, 2.0, 3.0)];
    let prior = VectorPrior::new(block, rows.clone());
    let residuals = |values: boresight_solver::Values<'_>| -> Vec<f64> {
        rows.iter().map(|&(column, mean, weight)| (values.vector(block)[column] - mean) * weight).collect()
    };
    // The cost is a square, so differences are exact but for rounding: 1e-16 / 0.1.
    check_term(&parameters, &prior, Some(&residuals), 0.1, 1e-14);
}

#[test]
fn pose_priors_report_what_differences_find() {
    let mut numbers = Numbers::new(1);
    // The rotation vector of the error has no derivative at π, and the tolerance allows for the
    // sixth derivative growing towards it.
    for (angle, tolerance) in [(0.0, 1e-12), (1e-9, 1e-12), (0.1, 1e-12), (1.5, 1e-12), (3.0, 1e-9)] {
        let mean = pose(&mut numbers, 2.0, 3.0);
        let mut parameters = Parameters::default();
        parameters.add_vector(&[1.0, 2.0]);
        let block = parameters.add_pose(&(pose(&mut numbers, angle, 0.5) * mean), Elimination::First);
        let weights = [10.0, 20.0, 5.0, 1.0, 2.0, 3.0];
        let prior = PosePrior::new(block, mean, weights);
        let residuals = |values: boresight_solver::Values<'_>| -> Vec<f64> {
            let found = values.pose(block);
            let rotation = Pose::new(found.rotation * mean.rotation.inverse(), Vector3::zeros()).rodrigues();
            let translation = found.translation - mean.translation;
            let both = rotation.iter().chain(translation.iter());
            both.zip(weights).map(|(error, weight)| error * weight).collect()
        };
        check_term(&parameters, &prior, Some(&residuals), 3e-3, tolerance);
    }
}

#[test]
fn rows_without_a_belief_do_not_count() {
    let mut parameters = Parameters::default();
    let vector = parameters.add_vector(&[1.0]);
    let block = parameters.add_pose(&Pose::identity(), Elimination::Reduced);
    assert_eq!(VectorPrior::new(vector, vec![(0, 1.0, 0.0), (0, 1.0, 2.0)]).row_count(), 1);
    assert_eq!(PosePrior::new(block, Pose::identity(), [1.0, 1.0, 1.0, 0.0, 0.0, 0.0]).row_count(), 3);
}

/// The mean of rotations is where their rotation vectors cancel; that of translations is plain.
#[test]
fn poses_are_averaged() {
    let mut numbers = Numbers::new(2);
    let centre = pose(&mut numbers, 1.0, 2.0);
    let believed: Vec<Pose> = (0..20).map(|_| pose(&mut numbers, 0.3, 0.2) * centre).collect();
    for elimination in [Elimination::First, Elimination::Reduced] {
        let mut parameters = Parameters::default();
        let block = parameters.add_pose(&Pose::identity(), elimination);
        let priors: Vec<PosePrior> =
            believed.iter().map(|&mean| PosePrior::new(block, mean, [10.0; 6])).collect();
        let terms: Vec<&dyn Term> = priors.iter().map(|prior| prior as &dyn Term).collect();
        let solution = solve_plainly(&parameters, &terms);
        // Priors alone leave no noise to compare with: the search goes on until rounding.
        assert!(matches!(solution.stop, Stop::Rounding { .. }), "{solution:?}");
        let found = parameters.at(&solution.values).pose(block);
        let mut errors = Vector6::zeros();
        for mean in &believed {
            let rotation = Pose::new(found.rotation * mean.rotation.inverse(), Vector3::zeros()).rodrigues();
            let mut rows = errors.fixed_rows_mut::<3>(0);
            rows += rotation;
            let mut rows = errors.fixed_rows_mut::<3>(3);
            rows += found.translation - mean.translation;
        }
        // With g = 100 e and H = 100 * 20, a decrease gᵀH⁻¹g of 1e-14 of the cost, where it is lost
        // in rounding, is an e of this size.
        let limit = (1e-14 * solution.cost * 20.0 / 100.0).sqrt();
        assert!(errors.norm() < limit, "{elimination:?} {errors} {solution:?}");
    }
}

#[test]
fn a_single_prior_is_met_exactly_and_has_its_own_covariance() {
    let mut numbers = Numbers::new(3);
    let mean = pose(&mut numbers, 2.5, 3.0);
    let mut parameters = Parameters::default();
    let block = parameters.add_pose(&Pose::identity(), Elimination::First);
    let inverse_sigmas = [10.0, 20.0, 50.0, 1.0, 2.0, 4.0];
    let prior = PosePrior::new(block, mean, inverse_sigmas);
    let problem = Problem::new(&parameters, vec![&prior]).expect("the problem is sound");
    let solution = solve(&problem, &SolveOptions::default()).expect("the problem can be solved");
    assert!(matches!(solution.stop, Stop::Exact { .. }), "{solution:?}");
    let covariance =
        covariance(&problem, &solution.values, &SolveOptions::default()).expect("it is constrained");
    let found = covariance.eliminated(block).expect("the block was eliminated");
    for k in 0..3 {
        // At the mean a left perturbation of the rotation is the rotation vector's error itself.
        let expected = inverse_sigmas[k].powi(-2);
        assert!((found[k][k] / expected - 1.0).abs() < 1e-10, "{k}: {} {expected}", found[k][k]);
    }
}
