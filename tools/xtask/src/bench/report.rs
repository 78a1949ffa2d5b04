//! From answers to the tables of `docs/performance.md`.

use std::fs;

use crate::bench::answer::{Answer, median};
use crate::bench::measure::{Measured, MeasuredProblem, REPEAT, REPEAT_ALONE, Threads};
use crate::bench::solvers::Missing;
use crate::table::markdown;

/// Costs of the same optimum agree to this, relatively; else the times may not be compared.
const SAME_COST: f64 = 1e-9;

/// The tables, and what is wrong with them.
pub(crate) struct Report {
    pub text: String,
    /// Peers that stopped at another cost than ours, and costs of ours that differ from run to run.
    pub differences: Vec<String>,
}

/// Returns the machine's load before anything was started.
pub(crate) fn load_average() -> String {
    let text = fs::read_to_string("/proc/loadavg").unwrap_or_default();
    text.split_whitespace().next().unwrap_or("unknown").to_owned()
}

/// Returns all tables.
pub(crate) fn report(measured: &Measured, missing: &[Missing], load: &str) -> Report {
    let mut differences = Vec::new();
    let mut rows = Vec::new();
    let mut ours_rows = Vec::new();
    let mut versions: Vec<String> = Vec::new();
    for problem in &measured.problems {
        let Some((_, ours)) = problem.solvers.first() else { continue };
        for (name, answers) in &problem.solvers {
            let Some(first) = answers.first() else { continue };
            let version = format!("{name} {}", first.version);
            if !versions.contains(&version) {
                versions.push(version);
            }
            rows.push(row(problem, name, answers, ours, &mut differences));
        }
        for missing in missing {
            let cells = [format!("{}, {}", problem.label, missing.name), "not installed".to_owned()];
            rows.push(cells.into_iter().chain(vec!["-".to_owned(); 5]).collect());
        }
        ours_rows.extend(own_row(problem));
        let costs: Vec<u64> = ours.iter().filter_map(|answer| answer.cost).map(f64::to_bits).collect();
        if costs.windows(2).any(|pair| pair[0] != pair[1]) {
            differences.push(format!("{}: Boresight's cost differs from run to run", problem.label));
        }
    }
    let mut parts = vec![
        conditions(measured.rounds, load, &versions),
        markdown(
            &["problem, solver", "CPU ms", "x Boresight", "final cost, px²", "off by", "steps", "peak MB"],
            &rows,
        ),
        markdown(
            &[
                "Boresight alone",
                "iterations",
                "ns per corner and iteration",
                "peak GFLOP/s",
                "of the arithmetic floor",
                "bytes per corner to solve",
            ],
            &ours_rows,
        ),
    ];
    if let Some(threads) = &measured.threads {
        parts.push(format!(
            "Two threads: {} rounds of one thread, two, and two processes at once, {REPEAT_ALONE} solves each; medians,\n\
             and of the gains those within a round.\n",
            threads.one.len()
        ));
        parts.push(threads_table(threads, &mut differences));
    }
    Report { text: parts.join("\n"), differences }
}

/// Says where and how it was measured.
fn conditions(rounds: usize, load: &str, versions: &[String]) -> String {
    let cpu = fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let model = cpu.lines().find_map(|line| line.strip_prefix("model name")?.split_once(':'));
    let model = model.map_or("unknown processor", |(_, model)| model.trim());
    let cores = std::thread::available_parallelism().map_or(0, |n| n.get());
    format!(
        "{model}, {cores} cores, load average {load} before the start. Rounds: {rounds}, interleaved; each process solves {REPEAT} times\n\
         (a splined pair once) from the stored seed and reports its median; the first table shows medians over the rounds. The second\n\
         holds Boresight against the machine: the least times of {REPEAT_ALONE} solves a round, and the machine's best peak,\n\
         since neighbours on the host slow the two down unequally. One thread unless said otherwise. {}.\n",
        versions.join(", ")
    )
}

fn row(
    problem: &MeasuredProblem,
    name: &str,
    answers: &[Answer],
    ours: &[Answer],
    differences: &mut Vec<String>,
) -> Vec<String> {
    let label = format!("{}, {name}", problem.label);
    let Some(cpu_s) = median(answers.iter().filter_map(|answer| answer.cpu_s).collect()) else {
        let cells = vec![label, "not applicable".to_owned()];
        return cells.into_iter().chain(vec!["-".to_owned(); 5]).collect();
    };
    let first = &answers[0];
    let label = match (first.is_same_problem(), first.frames) {
        (true, _) => label,
        (false, Some(frames)) => format!("{label} (another problem, {frames} frames)"),
        (false, None) => format!("{label} (another problem)"),
    };
    let (cost, our_cost) = (first.cost, ours.first().and_then(|answer| answer.cost));
    let off_by = cost.zip(our_cost).map(|(cost, ours)| (cost - ours) / ours);
    let is_same_cost = off_by.is_some_and(|off_by| off_by.abs() <= SAME_COST);
    if first.is_same_problem() && !is_same_cost {
        let shown = |cost: Option<f64>| cost.map_or("missing".to_owned(), |cost| format!("{cost:.9}"));
        differences.push(format!("{label}: the cost is {}, Boresight's is {}", shown(cost), shown(our_cost)));
    }
    // Round by round, so that a busy minute does not make the ratio.
    let pairs = answers.iter().zip(ours).filter_map(|(theirs, ours)| Some(theirs.cpu_s? / ours.cpu_s?));
    let ratio = median(pairs.collect()).filter(|_| first.is_same_problem() && is_same_cost);
    let steps = match (first.iterations, first.evaluations) {
        (Some(n), _) => n.to_string(),
        (None, Some(n)) => format!("{n} evaluations"),
        (None, None) => "-".to_owned(),
    };
    vec![
        label,
        significant(cpu_s * 1e3),
        ratio.map_or("-".to_owned(), significant),
        cost.map_or("-".to_owned(), |cost| format!("{cost:.6}")),
        off_by.filter(|_| first.is_same_problem()).map_or("-".to_owned(), |off_by| format!("{off_by:.0e}")),
        steps,
        median(answers.iter().filter_map(|answer| answer.peak_rss_kb).collect())
            .map_or("-".to_owned(), |kb| significant(kb / 1024.0)),
    ]
}

fn own_row(problem: &MeasuredProblem) -> Option<Vec<String>> {
    let first = problem.alone.first()?;
    let iteration_s = least(problem.alone.iter().map(|answer| answer.iteration_s));
    let peak = least(problem.alone.iter().map(|answer| Some(-answer.peak_flops_per_s?))).map(|peak| -peak);
    let fraction = || Some(first.floor_flops? / peak? / iteration_s?);
    let bytes = median(problem.alone.iter().filter_map(Answer::bytes_per_corner).collect());
    let cell = |value: Option<f64>| value.map_or("-".to_owned(), significant);
    Some(vec![
        problem.label.to_owned(),
        first.iterations.map_or("-".to_owned(), |n| n.to_string()),
        cell(iteration_s.zip(first.corners).map(|(s, n)| s * 1e9 / n)),
        cell(peak.map(|peak| peak * 1e-9)),
        cell(fraction()),
        cell(bytes),
    ])
}

/// Returns the least of the numbers that there are.
fn least(numbers: impl Iterator<Item = Option<f64>>) -> Option<f64> {
    numbers.flatten().min_by(f64::total_cmp)
}

fn threads_table(threads: &Threads, differences: &mut Vec<String>) -> String {
    let wall = |answers: &[Answer]| median(answers.iter().filter_map(|answer| answer.wall_s).collect());
    let cost = |answers: &[Answer]| answers.first().and_then(|answer| answer.cost);
    // Of the same round, as the machine is not the same in another.
    let ratios = |others: Vec<Option<f64>>| {
        let ratio = |(one, other): (&Answer, Option<f64>)| Some(one.wall_s? / other?);
        median(threads.one.iter().zip(others).filter_map(ratio).collect())
    };
    let gain = ratios(threads.two.iter().map(|answer| answer.wall_s).collect());
    let both_s = |[a, b]: &[Answer; 2]| Some((a.wall_s? + b.wall_s?) / 2.0);
    let machine = ratios(threads.apart.iter().map(both_s).collect()).map(|ratio| 2.0 * ratio);
    let cell = |value: Option<f64>| value.map_or("-".to_owned(), significant);
    let is_same = cost(&threads.one).map(f64::to_bits) == cost(&threads.two).map(f64::to_bits);
    if !is_same {
        differences.push(format!("{}: Boresight's cost differs with the number of threads", threads.label));
    }
    markdown(
        &["threads", "wall ms, one", "wall ms, two", "gain", "same bits", "gain of two processes at once"],
        &[vec![
            threads.label.to_owned(),
            cell(wall(&threads.one).map(|s| s * 1e3)),
            cell(wall(&threads.two).map(|s| s * 1e3)),
            cell(gain),
            if is_same { "yes" } else { "no" }.to_owned(),
            cell(machine),
        ]],
    )
}

/// Returns a number with three digits that count.
fn significant(number: f64) -> String {
    let rounded: f64 = format!("{number:.2e}").parse().unwrap_or(number);
    let is_plain = rounded != 0.0 && rounded.is_finite();
    let exponent = if is_plain { rounded.abs().log10().floor() as i32 } else { 0 };
    let decimals = (2 - exponent).max(0) as usize;
    format!("{number:.decimals$}")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn answer(cpu_s: f64, cost: f64) -> Answer {
        Answer { cpu_s: Some(cpu_s), cost: Some(cost), ..Answer::default() }
    }

    fn measured(their_cost: f64) -> Measured {
        let ours = [1.0e-3, 2.0e-3, 9.0e-3].map(|s| answer(s, 870.5)).to_vec();
        // The third round was busy for both.
        let theirs = [50e-3, 100e-3, 450e-3].map(|s| answer(s, their_cost)).to_vec();
        let apart = vec![[ours[0].clone(), ours[1].clone()]];
        let threads = Threads { label: "8x200", one: ours.clone(), two: ours.clone(), apart };
        let solvers = vec![("Boresight", ours), ("mrcal", theirs)];
        Measured {
            rounds: 3,
            problems: vec![MeasuredProblem { label: "1x50", solvers, alone: Vec::new() }],
            threads: Some(threads),
        }
    }

    #[test]
    fn ratios_are_of_the_same_round_and_the_same_optimum() {
        let good = report(&measured(870.5 * (1.0 + 1e-11)), &[], "0.1");
        assert!(good.differences.is_empty(), "{:?}", good.differences);
        let line = good.text.lines().find(|line| line.contains("mrcal") && line.starts_with('|')).unwrap();
        let cells: Vec<&str> = line.split('|').map(str::trim).collect();
        assert_eq!(cells[1..4], ["1x50, mrcal", "100", "50.0"]);

        let other = report(&measured(871.0), &[], "0.1");
        assert_eq!(other.differences.len(), 1);
        let line = other.text.lines().find(|line| line.contains("mrcal") && line.starts_with('|')).unwrap();
        assert_eq!(line.split('|').map(str::trim).nth(3), Some("-"));
    }

    #[test]
    fn three_digits_count() {
        for (number, expected) in [
            (0.04567, "0.0457"),
            (1.234, "1.23"),
            (99.96, "100"),
            (9.9999, "10.0"),
            (2841.3, "2841"),
            (0.0, "0.00"),
        ] {
            assert_eq!(significant(number), expected);
        }
    }
}
