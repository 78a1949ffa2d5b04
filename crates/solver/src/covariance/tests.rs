//! Dense and sparse: the same steps, the same optimum, the same covariance, the same refusals.

use boresight_geometry::nalgebra::{DMatrix, DVector};
use boresight_geometry::{Pose, Vector3, Vector6};

use super::*;
use crate::problem::{GramMut, Parameters, Scratch, Term, Values};
use crate::structure::SparseRule;

const DENSE: SparseRule = SparseRule { least_columns: usize::MAX, toll: 1.0 };
const SPARSE: SparseRule = SparseRule { least_columns: 0, toll: 0.0 };

/// Rows of `[J r]` over the blocks' columns: for poses their difference in the frame between, as far
/// as it is linear; for vectors the sum of sines.
struct Tie {
    blocks: Vec<BlockId>,
    is_pose: bool,
    measured: Vec<f64>,
}

impl Term for Tie {
    fn blocks(&self) -> &[BlockId] {
        &self.blocks
    }

    fn row_count(&self) -> usize {
        self.measured.len()
    }

    fn linearize(&self, values: Values<'_>, gram: &mut GramMut<'_>, _: &mut Scratch) -> Option<f64> {
        gram.clear();
        let n = gram.size();
        let residuals = |moved: Option<(usize, f64)>| -> Vec<f64> {
            let step = |block: usize, n: usize| -> Vec<f64> {
                let mut step = vec![0.0; n];
                if let Some((column, distance)) = moved.filter(|(column, _)| column / n == block) {
                    step[column % n] = distance;
                }
                step
            };
            let mut sums = vec![0.0; self.measured.len()];
            for (k, &block) in self.blocks.iter().enumerate() {
                let sign = if k == 0 { 1.0 } else { -0.7 };
                let numbers: Vec<f64> = if self.is_pose {
                    let pose = values.pose(block).perturbed(&Vector6::from_vec(step(k, 6)));
                    (pose.rodrigues().iter().chain(pose.translation.iter()).copied()).collect()
                } else {
                    let numbers = values.vector(block);
                    let step = step(k, numbers.len());
                    numbers.iter().zip(step).map(|(x, d)| (x + d).sin()).collect()
                };
                for (i, sum) in sums.iter_mut().enumerate() {
                    // Rows mix the block's numbers, so that blocks are dense.
                    *sum += sign
                        * numbers
                            .iter()
                            .enumerate()
                            .map(|(j, x)| x * ((i * 3 + j * 7) % 5 + 1) as f64)
                            .sum::<f64>()
                        + sign * 4.0 * numbers[i % numbers.len()];
                }
            }
            sums.iter().zip(&self.measured).map(|(sum, measured)| sum - measured).collect()
        };
        let here = residuals(None);
        let h = 1e-5;
        let columns: Vec<Vec<f64>> = (0..n - 1)
            .map(|column| {
                let (ahead, behind) = (residuals(Some((column, h))), residuals(Some((column, -h))));
                ahead.iter().zip(behind).map(|(a, b)| (a - b) / (2.0 * h)).collect()
            })
            .chain([here.clone()])
            .collect();
        for a in 0..n {
            for b in a..n {
                gram.add(a, b, columns[a].iter().zip(&columns[b]).map(|(x, y)| x * y).sum());
            }
        }
        Some(here.iter().map(|r| r * r).sum())
    }
}

/// Rows that are the same at all values, with residuals of zero.
struct Rows {
    blocks: [BlockId; 2],
    jacobian: DMatrix<f64>,
}

impl Term for Rows {
    fn blocks(&self) -> &[BlockId] {
        &self.blocks
    }

    fn row_count(&self) -> usize {
        self.jacobian.nrows()
    }

    fn linearize(&self, _: Values<'_>, gram: &mut GramMut<'_>, _: &mut Scratch) -> Option<f64> {
        gram.clear();
        Some(gram.add_rows(&self.jacobian, &DVector::zeros(self.row_count())))
    }
}

struct Graph {
    parameters: Parameters,
    ties: Vec<Tie>,
}

fn number(seed: &mut u64) -> f64 {
    *seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
    (*seed >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
}

impl Graph {
    fn tie(&mut self, blocks: &[BlockId], is_pose: bool, n_rows: usize, seed: &mut u64) {
        let measured = (0..n_rows).map(|_| 0.1 * number(seed)).collect();
        self.ties.push(Tie { blocks: blocks.to_vec(), is_pose, measured });
    }

    /// A moving camera: a chain of poses with closures, none of which is eliminated first.
    fn trajectory(n_poses: usize) -> Self {
        let (mut graph, mut seed) = (Self { parameters: Parameters::default(), ties: Vec::new() }, 3);
        let mut vector =
            |size: f64| Vector3::new(number(&mut seed), number(&mut seed), number(&mut seed)) * size;
        let poses: Vec<BlockId> = (0..n_poses)
            .map(|_| {
                let pose = Pose::from_rodrigues(vector(0.1), vector(0.1));
                graph.parameters.add_pose(&pose, Elimination::Reduced)
            })
            .collect();
        graph.tie(&poses[..1], true, 6, &mut seed);
        for k in 1..n_poses {
            graph.tie(&[poses[k - 1], poses[k]], true, 6, &mut seed);
            if k % 11 == 0 {
                graph.tie(&[poses[k - 11], poses[k]], true, 6, &mut seed);
            }
        }
        graph.parameters.hold(poses[4], 2);
        graph
    }

    /// A grid of vectors of different lengths, tied to their neighbours, numbered all over the place.
    fn grid(side: usize) -> Self {
        let (mut graph, mut seed) = (Self { parameters: Parameters::default(), ties: Vec::new() }, 5);
        let n = side * side;
        let blocks: Vec<BlockId> = (0..n).map(|_| graph.parameters.add_vector(&[0.05, -0.1, 0.2])).collect();
        let at = |x: usize, y: usize| blocks[(x + y * side) * 31 % n];
        for y in 0..side {
            for x in 0..side {
                graph.tie(&[at(x, y)], false, 3, &mut seed);
                if x > 0 {
                    graph.tie(&[at(x - 1, y), at(x, y)], false, 3, &mut seed);
                }
                if y > 0 {
                    graph.tie(&[at(x, y), at(x, y - 1)], false, 3, &mut seed);
                }
            }
        }
        graph
    }

    /// Poses that are eliminated first, each tied to two of many others in a ring, and a hub for all.
    fn eliminated(n_reduced: usize) -> Self {
        let (mut graph, mut seed) = (Self { parameters: Parameters::default(), ties: Vec::new() }, 9);
        let mut vector =
            |size: f64| Vector3::new(number(&mut seed), number(&mut seed), number(&mut seed)) * size;
        let mut add = |graph: &mut Self, elimination| {
            let pose = Pose::from_rodrigues(vector(0.1), vector(0.1));
            graph.parameters.add_pose(&pose, elimination)
        };
        let hub = add(&mut graph, Elimination::Reduced);
        let ring: Vec<BlockId> = (0..n_reduced).map(|_| add(&mut graph, Elimination::Reduced)).collect();
        let frames: Vec<BlockId> = (0..2 * n_reduced).map(|_| add(&mut graph, Elimination::First)).collect();
        graph.tie(&[hub], true, 6, &mut seed);
        for (k, &frame) in frames.iter().enumerate() {
            graph.tie(&[ring[k / 2], frame], true, 12, &mut seed);
            graph.tie(&[frame, ring[(k * 7 / 13 + 1) % n_reduced]], true, 12, &mut seed);
            graph.tie(&[frame, hub], true, 12, &mut seed);
        }
        graph.parameters.hold(frames[3], 1);
        graph
    }

    fn problem(&self) -> Problem<'_> {
        Problem::new(&self.parameters, self.ties.iter().map(|tie| tie as &dyn Term).collect()).unwrap()
    }
}

/// Returns the values after each of a few steps.
fn steps(problem: &Problem<'_>, rule: SparseRule, threads: &Threads) -> Vec<Vec<f64>> {
    let mut values = problem.parameters.values.clone();
    let structure = Structure::by_rule(problem, &values, rule);
    let mut model = Linearization::new(&structure);
    let mut steps = StepSolver::new(&structure);
    let mut all = Vec::new();
    for damping in [1e-2, 1e-4, 0.0, 0.0] {
        model.evaluate(problem, &structure, &values, threads).unwrap();
        assert!(steps.factor(&structure, &model, damping, threads));
        steps.solve(problem, &structure, &model, damping, threads);
        let mut moved = Vec::new();
        problem.parameters.retract(&values, &steps.step, &mut moved);
        all.push(moved.clone());
        values = moved;
    }
    all
}

fn check(graph: &Graph) {
    let problem = graph.problem();
    let options = SolveOptions::default();
    let dense = steps(&problem, DENSE, &Threads::default());
    let sparse = steps(&problem, SPARSE, &Threads::default());
    for (dense, sparse) in dense.iter().flatten().zip(sparse.iter().flatten()) {
        assert!((dense - sparse).abs() < 1e-10, "{dense} {sparse}");
    }
    let three = Threads::new(3, usize::MAX).unwrap();
    assert!(steps(&problem, SPARSE, &three) == sparse, "threads can be told from the result");
    let values = &dense[3];
    let covariance = |rule| {
        let structure = Structure::by_rule(&problem, values, rule);
        assert_eq!(structure.sparse.is_some(), rule.least_columns == 0);
        covariance_of(&problem, structure, values, &options).unwrap()
    };
    let (dense, sparse) = (covariance(DENSE), covariance(SPARSE));
    let blocks: Vec<BlockId> = (0..graph.parameters.blocks.len()).map(BlockId).collect();
    let sigma = |block: BlockId, k: usize| dense.between((block, k), (block, k)).sqrt();
    for (idx, &a) in blocks.iter().enumerate() {
        assert_eq!(dense.eliminated(a).is_some(), sparse.eliminated(a).is_some());
        if let (Some(dense), Some(sparse)) = (dense.eliminated(a), sparse.eliminated(a)) {
            for (k, l) in (0..SIDE).flat_map(|k| (0..SIDE).map(move |l| (k, l))) {
                let scale = (dense[k][k] * dense[l][l]).sqrt();
                assert!((dense[k][l] - sparse[k][l]).abs() <= 1e-10 * scale, "{a:?} {k} {l}");
            }
            continue;
        }
        // Near ones are in the factor, far ones take a solve.
        for &b in blocks[idx..].iter().step_by(17).filter(|&&b| dense.eliminated(b).is_none()) {
            for (k, l) in (0..3).flat_map(|k| (0..3).map(move |l| (k, l))) {
                let (expected, found) = (dense.between((a, k), (b, l)), sparse.between((a, k), (b, l)));
                let scale = sigma(a, k) * sigma(b, l);
                assert!((expected - found).abs() <= 1e-10 * scale, "{a:?} {b:?}: {expected} {found}");
                assert_eq!(found, sparse.between((b, l), (a, k)));
            }
        }
    }
}

#[test]
fn both_ways_agree_on_a_trajectory() {
    check(&Graph::trajectory(60));
}

#[test]
fn both_ways_agree_on_a_grid() {
    check(&Graph::grid(12));
}

#[test]
fn both_ways_agree_after_elimination() {
    check(&Graph::eliminated(40));
}

#[test]
fn the_rule_tells_sparse_from_dense() {
    let is_sparse = |graph: &Graph| {
        let problem = graph.problem();
        Structure::new(&problem, &problem.parameters.values).sparse.is_some()
    };
    assert!(is_sparse(&Graph::trajectory(60)));
    assert!(!is_sparse(&Graph::trajectory(20)));
    assert!(is_sparse(&Graph::grid(20)));
    // A frame that sees all cameras makes all of them dense.
    let mut full = Graph::eliminated(60);
    let mut blocks: Vec<BlockId> = (0..61).map(BlockId).collect();
    blocks.push(BlockId(61));
    full.tie(&blocks, true, 1, &mut 1);
    assert!(!is_sparse(&full));
}

#[test]
fn both_ways_refuse_what_is_singular() {
    // Nothing ties the trajectory down.
    let mut graph = Graph::trajectory(60);
    graph.ties.remove(0);
    graph.ties.iter_mut().for_each(|tie| tie.measured.truncate(5));
    let problem = graph.problem();
    let refusal = |rule| {
        let structure = Structure::by_rule(&problem, &problem.parameters.values, rule);
        covariance_of(&problem, structure, &problem.parameters.values, &SolveOptions::default())
    };
    for rule in [DENSE, SPARSE] {
        assert!(matches!(refusal(rule), Err(Error::Singular { .. })), "{rule:?}");
    }
}

#[test]
fn what_elimination_leaves_is_judged_by_what_was_there() {
    // Two numbers of which a pose takes all but a share, and that of their sum is 4e-4 of that of their difference: of a
    // share of 1e-12, that is four last bits of what was there.
    for (share, is_lost) in [(1e-6, false), (1e-12, true)] {
        let mut jacobian = DMatrix::<f64>::zeros(8, 8);
        (0..6).for_each(|k| jacobian[(k, k)] = 1.0);
        (jacobian[(0, 6)], jacobian[(1, 7)]) = (1.0, 1.0);
        let (sum, difference) = (f64::sqrt(4e-4 * share), f64::sqrt(share));
        (jacobian[(6, 0)], jacobian[(6, 1)]) = (sum, sum);
        (jacobian[(7, 0)], jacobian[(7, 1)]) = (difference, -difference);
        let mut parameters = Parameters::default();
        let pose = parameters.add_pose(&Pose::identity(), Elimination::First);
        let blocks = [pose, parameters.add_vector(&[0.0; 2])];
        let rows = Rows { blocks, jacobian };
        let problem = Problem::new(&parameters, vec![&rows as &dyn Term]).unwrap();
        for rule in [DENSE, SPARSE] {
            let structure = Structure::by_rule(&problem, &problem.parameters.values, rule);
            match covariance_of(&problem, structure, &problem.parameters.values, &SolveOptions::default()) {
                Ok(_) => assert!(!is_lost, "{rule:?}"),
                Err(Error::Singular { limit, .. }) => {
                    assert!(is_lost && limit == LEAST_BEFORE_ELIMINATION, "{rule:?}: {limit:e}");
                }
                Err(error) => panic!("{rule:?}: {error}"),
            }
        }
    }
}

#[test]
fn refusals_name_the_same_column_both_ways() {
    // One number of one block is seen by nothing.
    let mut graph = Graph::trajectory(60);
    let lonely = graph.parameters.add_vector(&[1.0]);
    let problem = graph.problem();
    for rule in [DENSE, SPARSE] {
        let structure = Structure::by_rule(&problem, &problem.parameters.values, rule);
        let refused =
            covariance_of(&problem, structure, &problem.parameters.values, &SolveOptions::default());
        let Err(Error::Singular { columns, .. }) = refused else { panic!("it is singular") };
        assert_eq!(columns.len(), 1);
        assert_eq!(Covariance::column_of(&problem, columns[0].0), Some((lonely, 0)));
    }
}
