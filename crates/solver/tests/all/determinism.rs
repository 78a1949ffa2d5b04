//! The number of threads cannot be told from the result.

use boresight_solver::{Elimination, Problem, SolveOptions, covariance, solve};

use super::support::{Clouds, as_terms};

#[test]
fn threads_do_not_change_a_bit() {
    // Enough rows for threads to be started at all: 20 000 are needed.
    let clouds = Clouds::new(5, 300, 20, Elimination::First);
    let terms = clouds.terms();
    let problem = Problem::new(&clouds.parameters, as_terms(&terms)).expect("the problem is sound");
    assert!(problem.observation_rows() > 20_000);
    let bits = |values: &[f64]| -> Vec<u64> { values.iter().map(|value| value.to_bits()).collect() };
    let outcome = |threads: usize| {
        let options = SolveOptions { threads, ..SolveOptions::default() };
        let solution = solve(&problem, &options).expect("the problem can be solved");
        assert!(solution.stop.is_converged(), "{solution:?}");
        let covariance = covariance(&problem, &solution.values, &options).expect("the data constrain it");
        let mut numbers = bits(&solution.values);
        numbers.push(solution.cost.to_bits());
        for &a in &clouds.sensors {
            for &b in &clouds.sensors {
                numbers.extend((0..36).map(|k| covariance.between((a, k / 6), (b, k % 6)).to_bits()));
            }
        }
        for &pose in &clouds.poses {
            numbers.extend(bits(covariance.eliminated(pose).expect("it was eliminated").as_flattened()));
        }
        (numbers, solution.counters)
    };
    let alone = outcome(1);
    for threads in [2, 3, 7] {
        assert!(outcome(threads) == alone, "{threads} threads");
    }
    assert!(outcome(1) == alone, "the same again");
}
