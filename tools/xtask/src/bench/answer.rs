//! The one line of JSON that a solver prints.

use serde::Deserialize;

/// What a solver says of its solves; the keys are told in `tools/bench/README.md`.
#[derive(Clone, Debug, Default, Deserialize)]
pub(crate) struct Answer {
    pub version: String,
    /// Null where the problem is not one for this solver.
    pub cpu_s: Option<f64>,
    pub cost: Option<f64>,
    pub iterations: Option<u64>,
    pub evaluations: Option<u64>,
    pub peak_rss_kb: Option<f64>,
    /// `same`, or in what the problem differs.
    pub problem: Option<String>,
    /// What the solver was restricted to, where it was.
    pub frames: Option<u64>,
    pub corners: Option<f64>,
    /// The median wall time of all solves.
    pub wall_s: Option<f64>,
    /// The least CPU time of an iteration, setting up not counted.
    pub iteration_s: Option<f64>,
    /// The operations that an iteration cannot do without.
    pub floor_flops: Option<f64>,
    /// The most operations that the machine did in a second, in the same process.
    pub peak_flops_per_s: Option<f64>,
    /// Before the first solve, with the problem in memory.
    pub rss_before_solve_kb: Option<f64>,
}

impl Answer {
    /// Returns the memory that solving took at its peak, the problem's own not counted.
    pub(crate) fn bytes_per_corner(&self) -> Option<f64> {
        Some((self.peak_rss_kb? - self.rss_before_solve_kb?) * 1024.0 / self.corners?)
    }

    /// Tells whether the solver had the very problem of the others.
    pub(crate) fn is_same_problem(&self) -> bool {
        self.problem.as_deref().is_none_or(|problem| problem == "same")
    }
}

/// Returns the median of some numbers; `None` of none.
pub(crate) fn median(mut numbers: Vec<f64>) -> Option<f64> {
    numbers.sort_by(f64::total_cmp);
    let n = numbers.len();
    let upper = *numbers.get(n / 2)?;
    Some(if n % 2 == 1 { upper } else { (numbers[n / 2 - 1] + upper) / 2.0 })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn medians_are_in_the_middle() {
        assert_eq!(median(vec![]), None);
        assert_eq!(median(vec![3.0, 1.0, 2.0]), Some(2.0));
        assert_eq!(median(vec![4.0, 1.0, 2.0, 3.0]), Some(2.5));
    }

    #[test]
    fn answers_may_lack_what_a_solver_does_not_know() {
        let line = r#"{"tool": "opencv", "version": "5.0.0", "cpu_s": null, "problem": "not applicable"}"#;
        let answer: Answer = serde_json::from_str(line).unwrap();
        assert!(answer.cpu_s.is_none() && !answer.is_same_problem());
    }
}
