//! The one line of JSON that a solver prints.

use serde::Deserialize;

/// What a solver says of its solves; the keys are told in `tools/bench/README.md`.
#[derive(Clone, Debug, Default, Deserialize)]
pub(crate) struct Answer {
    pub version: String,
    /// Null where the problem is not one for this solver.
    pub cpu_s: Option<f64>,
    pub wall_s: Option<f64>,
    pub cost: Option<f64>,
    pub iterations: Option<u64>,
    pub evaluations: Option<u64>,
    pub peak_rss_kb: Option<f64>,
    /// `same`, or in what the problem differs.
    pub problem: Option<String>,
    /// What the solver was restricted to, where it was.
    pub frames: Option<u64>,
    pub corners: Option<f64>,
    /// An evaluation and the step from it.
    pub ns_per_corner_evaluation: Option<f64>,
    /// The time that the arithmetic alone would take, over the time taken.
    pub fraction_of_floor: Option<f64>,
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
