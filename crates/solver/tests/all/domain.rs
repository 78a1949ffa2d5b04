//! Where terms are not defined, and problems that are not sound.

use boresight_geometry::Pose;
use boresight_solver::{
    BlockId, Covariance, Elimination, Error, Parameters, PosePrior, Problem, SolveOptions, Stop, Term,
    VectorPrior, covariance, solve,
};

use super::support::{Clouds, Function, Rows, as_terms, counters, solve_plainly};

fn options() -> SolveOptions {
    SolveOptions::default()
}

/// Residual `ln x - 1`, not defined for x ≤ 0: full steps from above overshoot into there.
fn logarithm(x: f64, undefined: Rows) -> Rows {
    if x > 0.0 { Some(vec![vec![1.0 / x, x.ln() - 1.0]]) } else { undefined }
}

#[test]
fn leaving_the_domain_rejects_the_step() {
    // A term may say so, or compute NaN or infinity: all three are one.
    for undefined in [None, Some(vec![vec![f64::NAN; 2]]), Some(vec![vec![1.0, f64::INFINITY]])] {
        let mut parameters = Parameters::default();
        let block = parameters.add_vector(&[40.0]);
        let term = Function::new(&[block], 1, |values| logarithm(values.vector(block)[0], undefined.clone()));
        let solution = solve_plainly(&parameters, &[&term]);
        assert!(matches!(solution.stop, Stop::Exact { .. }), "{solution:?}");
        // A residual below 1e-11 is an x of e to as many relative.
        assert!((solution.values[0] / 1f64.exp() - 1.0).abs() < 2e-11, "{solution:?}");
        // A snapshot: the rejected steps are those that left the domain.
        assert_eq!(solution.counters, counters(7, 22, 21, 14), "{undefined:?}");
    }
}

#[test]
fn an_undefined_start_names_its_term() {
    let mut parameters = Parameters::default();
    let blocks = [1.0, 2.0, -1.0, -2.0].map(|x| parameters.add_vector(&[x]));
    let terms = blocks
        .map(|block| Function::new(&[block], 1, move |values| logarithm(values.vector(block)[0], None)));
    let problem = Problem::new(&parameters, as_terms(&terms)).expect("the problem is sound");
    let expected = Error::UndefinedStart { term_idx: 2 };
    assert_eq!(solve(&problem, &options()).expect_err("undefined"), expected);
    let values = parameters.values().as_slice();
    assert_eq!(covariance(&problem, values, &options()).expect_err("undefined"), expected);
}

#[test]
fn a_start_must_be_finite() {
    for value in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        let mut parameters = Parameters::default();
        parameters.add_vector(&[1.0, 2.0]);
        parameters.add_vector(&[3.0, value]);
        let refused = Problem::new(&parameters, Vec::new()).err().expect("it is refused");
        let Error::NotFinite { value_idx: 3, value: found } = refused else { panic!("{refused:?}") };
        assert_eq!(found.to_bits(), value.to_bits());
    }
}

#[test]
fn blocks_must_exist_once_and_be_eliminated_apart() {
    let mut parameters = Parameters::default();
    let first = parameters.add_pose(&Pose::identity(), Elimination::First);
    let second = parameters.add_pose(&Pose::identity(), Elimination::First);
    let vector = parameters.add_vector(&[0.0]);
    let mut others = parameters.clone();
    let unknown = others.add_vector(&[0.0]);
    let refused = |blocks: &[BlockId]| {
        let fine = Function::new(&[vector, first], 1, |_| None);
        let term = Function::new(blocks, 1, |_| None);
        Problem::new(&parameters, vec![&fine, &term]).err().map(|error| error.to_string())
    };
    let expect = |blocks: &[BlockId], message: &str| assert_eq!(refused(blocks).as_deref(), Some(message));
    expect(&[second, vector, first], "term 1 sees blocks 1 and 0, which are both to be eliminated first");
    expect(&[vector, unknown], "term 1 names block 3, which the problem does not have");
    expect(&[vector, first, vector], "term 1 names block 2 twice");
    assert_eq!(refused(&[second, vector]), None);
}

#[test]
fn there_must_be_as_many_rows_as_unknowns() {
    let mut parameters = Parameters::default();
    let block = parameters.add_vector(&[1.0, 2.0, 3.0]);
    let prior = VectorPrior::new(block, vec![(0, 1.0, 1.0), (1, 1.0, 1.0), (2, 1.0, 0.0)]);
    let refuse = |parameters: &Parameters| {
        let problem = Problem::new(parameters, vec![&prior]).expect("the problem is sound");
        solve(&problem, &options()).err()
    };
    assert_eq!(refuse(&parameters), Some(Error::TooFewRows { rows: 2, unknowns: 3 }));
    parameters.hold(block, 2);
    assert_eq!(refuse(&parameters), None);
}

/// Checks that the covariance is refused with this column, and this one only, to blame.
fn blames(parameters: &Parameters, terms: Vec<&dyn Term>, expected: &[(BlockId, usize)]) {
    let problem = Problem::new(parameters, terms).expect("the problem is sound");
    let refused =
        covariance(&problem, parameters.values().as_slice(), &options()).expect_err("it is singular");
    let Error::Singular { reciprocal_condition, limit, columns } = &refused else { panic!("{refused:?}") };
    assert!(reciprocal_condition < limit, "{refused:?}");
    let mut blamed: Vec<_> = columns
        .iter()
        .map(|&(column, _)| Covariance::column_of(&problem, column).expect("it exists"))
        .collect();
    blamed.sort_unstable();
    assert_eq!(blamed, expected, "{refused:?}");
}

#[test]
fn a_number_that_nothing_observes_is_blamed() {
    let mut parameters = Parameters::default();
    let pair = parameters.add_vector(&[1.0, 2.0]);
    let triple = parameters.add_vector(&[1.0, 2.0, 3.0]);
    parameters.hold(pair, 0);
    // Well-conditioned but for the one column; the strong correlation of the others is not to blame.
    let term = Function::new(&[pair, triple], 4, |_| {
        Some(vec![
            vec![0.0, 1.0, 1.0, 0.0, 0.0, 0.1],
            vec![0.0, 1.0, 1.001, 0.0, 0.0, 0.2],
            vec![0.0, 0.0, 0.0, 0.0, 5.0, 0.3],
        ])
    });
    blames(&parameters, vec![&term], &[(triple, 1)]);
    // Searching is no problem: it stays where it is.
    let solution = solve_plainly(&parameters, &[&term]);
    assert_eq!(solution.values[3].to_bits(), 2f64.to_bits());
}

#[test]
fn two_numbers_seen_only_by_their_sum_are_blamed() {
    let mut parameters = Parameters::default();
    let block = parameters.add_vector(&[0.0; 4]);
    let rows = [
        [1.0, 0.0, 0.0, 0.0, 0.0],
        [0.2, 1.0, 0.0, 1.0, 0.0],
        [0.0, 2.0, 1.0, 2.0, 0.0],
        [0.1, 0.0, 3.0, 0.0, 0.0],
    ];
    let term = Function::new(&[block], 4, |_| Some(rows.iter().map(|row| row.to_vec()).collect()));
    blames(&parameters, vec![&term], &[(block, 1), (block, 3)]);
}

#[test]
fn a_number_that_an_eliminated_pose_absorbs_is_blamed() {
    // A shift that every pose can undo: what elimination leaves of it is rounding.
    let mut parameters = Parameters::default();
    let shift = parameters.add_vector(&[0.0, 0.0]);
    let poses: Vec<BlockId> =
        (0..5).map(|_| parameters.add_pose(&Pose::identity(), Elimination::First)).collect();
    let term = |pose: BlockId, weight: f64| {
        Function::new(&[shift, pose], 7, move |_| {
            let mut rows = vec![vec![0.0; 9]; 7];
            (0..6).for_each(|k| rows[k][2 + k] = weight);
            rows[4][0] = weight;
            rows[6][1] = 1.0;
            Some(rows)
        })
    };
    let terms: Vec<_> = poses.iter().enumerate().map(|(k, &pose)| term(pose, 0.3 + 0.7 * k as f64)).collect();
    blames(&parameters, as_terms(&terms), &[(shift, 0)]);
}

#[test]
fn a_gauge_freedom_is_refused_and_a_prior_cures_it() {
    // Poses and a common pose that all of them are seen through, reduced: six columns too many.
    let mut parameters = Parameters::default();
    let common = parameters.add_pose(&Pose::identity(), Elimination::Reduced);
    let other = parameters.add_vector(&[0.0]);
    let poses: Vec<BlockId> =
        (0..6).map(|_| parameters.add_pose(&Pose::identity(), Elimination::First)).collect();
    let term = |pose: BlockId, weight: f64| {
        Function::new(&[common, pose, other], 7, move |_| {
            let mut rows = vec![vec![0.0; 14]; 7];
            for k in 0..6 {
                rows[k][k] = weight;
                rows[k][6 + k] = weight;
            }
            rows[6][12] = 1.0;
            Some(rows)
        })
    };
    let terms: Vec<_> = poses.iter().enumerate().map(|(k, &pose)| term(pose, 0.3 + 0.7 * k as f64)).collect();
    let all: Vec<(BlockId, usize)> = (0..6).map(|k| (common, k)).collect();
    blames(&parameters, as_terms(&terms), &all);
    let prior = PosePrior::new(common, Pose::identity(), [1.0; 6]);
    let mut cured = as_terms(&terms);
    cured.push(&prior);
    let problem = Problem::new(&parameters, cured).expect("the problem is sound");
    let found =
        covariance(&problem, parameters.values().as_slice(), &options()).expect("the prior constrains it");
    // Only the prior knows the common pose, with a sigma of one.
    assert!((found.between((common, 3), (common, 3)) - 1.0).abs() < 1e-12);
}

#[test]
fn a_nearly_singular_problem_has_its_covariance_or_none() {
    // Two columns apart by d have a reciprocal condition of d²/4, and variances of 1/d².
    for (apart, singular) in [(1e-4, false), (1e-5, false), (1e-6, true), (1e-8, true)] {
        let mut parameters = Parameters::default();
        let block = parameters.add_vector(&[0.0, 0.0]);
        let term = Function::new(&[block], 2, |_| Some(vec![vec![1.0, 1.0, 0.0], vec![0.0, apart, 0.0]]));
        if singular {
            blames(&parameters, vec![&term], &[(block, 0), (block, 1)]);
            continue;
        }
        let problem = Problem::new(&parameters, vec![&term]).expect("the problem is sound");
        let found = covariance(&problem, &[0.0, 0.0], &options()).expect("it is constrained");
        let variance = found.between((block, 1), (block, 1)) * apart * apart;
        // The normal equations lose what the condition says: 1e-16 / d².
        assert!((variance - 1.0).abs() < 4e-16 / (apart * apart), "{apart:e}: {variance}");
    }
}

#[test]
fn a_pose_that_nothing_sees_has_no_covariance_and_stays() {
    let mut clouds = Clouds::new(1, 4, 5, Elimination::First);
    let unseen = clouds.parameters.add_pose(&Pose::identity(), Elimination::First);
    let terms = clouds.terms();
    let problem = Problem::new(&clouds.parameters, as_terms(&terms)).expect("the problem is sound");
    let solution = solve(&problem, &options()).expect("the problem can be solved");
    assert_eq!(clouds.parameters.at(&solution.values).pose(unseen), Pose::identity());
    let found = covariance(&problem, &solution.values, &options()).expect("the others are constrained");
    assert!(found.eliminated(unseen).is_none() && found.eliminated(clouds.poses[0]).is_some());
}
