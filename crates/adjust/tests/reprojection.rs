//! The residual block against differences of its own predictions, for every lens and several topologies.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

use std::sync::Arc;

use boresight_adjust::{Chain, Layouts, Link, Loss, Reprojection, TargetPoints};
use boresight_camera::{CameraModel, Model, ModelVisitor, ParamGroup};
use boresight_data::{Geometry, Observation, PointId, Shape, Target};
use boresight_geometry::{Pose, Vector3, Vector6};
use boresight_solver::{BlockId, Elimination, GramMut, Parameters, Scratch, Term};

/// A view to be differentiated: its blocks' values, and how the chain goes.
#[derive(Clone)]
struct Case {
    model: Model,
    lens: Vec<f64>,
    shape: Option<Vec<f64>>,
    poses: Vec<Pose>,
    /// For each pose: whether the chain takes its inverse.
    inverse: Vec<bool>,
    loss: Loss,
    n_points: usize,
    rejected: Vec<usize>,
}

struct Built {
    parameters: Parameters,
    term: Reprojection,
    blocks: Vec<BlockId>,
    observations: Vec<Observation>,
}

impl Case {
    /// Builds the view; `pixels` of another build make residuals that do not vanish.
    fn build(&self, observations: Option<&[Observation]>) -> Built {
        let mut parameters = Parameters::default();
        let lens = parameters.add_vector(&self.lens);
        let shape = self.shape.as_ref().map(|shape| (parameters.add_vector(shape), shape.len()));
        let poses: Vec<BlockId> =
            self.poses.iter().map(|pose| parameters.add_pose(pose, Elimination::Reduced)).collect();
        let links = poses
            .iter()
            .zip(&self.inverse)
            .map(|(&block, &inverse)| if inverse { Link::Inverse(block) } else { Link::Block(block) });
        let chain = Chain { links: links.collect() };
        let target = Target {
            name: "board".to_owned(),
            geometry: Geometry::Chessboard { columns: 9, rows: 15, spacing_m: 0.05 },
            shape: Shape::ALL
                .into_iter()
                .find(|shape| shape.coefficient_count() == self.shape.as_ref().map_or(0, Vec::len))
                .unwrap(),
        };
        let pixel = |idx: usize| [700.0 + 3.7 * (idx % 11) as f64, 500.0 + 2.3 * (idx % 7) as f64];
        let own: Vec<Observation> = (0..self.n_points)
            .map(|idx| Observation {
                point: PointId((idx * 135 / self.n_points) as u32),
                pixel: pixel(idx),
                sigma_px: 0.5 + 0.1 * (idx % 4) as f64,
            })
            .collect();
        let observations = observations.map_or(own, <[Observation]>::to_vec);
        let points = Arc::new(TargetPoints::new(&target, &observations));
        let layouts = &Layouts::default();
        let mut term = Reprojection::new(self.model, lens, shape, chain, points, &observations, layouts);
        term.set_loss(self.loss);
        term.set_kept(&observations, |idx| !self.rejected.contains(&idx));
        let mut blocks = vec![lens];
        blocks.extend(shape.map(|(block, _)| block));
        blocks.extend(&poses);
        Built { parameters, term, blocks, observations }
    }

    /// Returns the case with column `column` of all columns moved by `step`.
    fn moved(&self, column: usize, step: f64) -> Self {
        let mut case = self.clone();
        let (n_lens, n_shape) = (self.lens.len(), self.shape.as_ref().map_or(0, Vec::len));
        if column < n_lens {
            case.lens[column] += step;
        } else if column < n_lens + n_shape {
            case.shape.as_mut().unwrap()[column - n_lens] += step;
        } else {
            let column = column - n_lens - n_shape;
            let mut tangent = Vector6::zeros();
            tangent[column % 6] = step;
            case.poses[column / 6] = case.poses[column / 6].perturbed(&tangent);
        }
        case
    }

    /// Returns the weighted residuals: all rows, in sigmas, rejected ones zero.
    fn residuals(&self, observations: &[Observation]) -> Vec<f64> {
        let built = self.build(Some(observations));
        let predictions = built.term.predict(built.parameters.values());
        let rows =
            predictions.iter().zip(observations).enumerate().flat_map(|(idx, (prediction, observation))| {
                let prediction = prediction.expect("the case is in view");
                [0, 1].map(|axis| {
                    let kept = if self.rejected.contains(&idx) { 0.0 } else { 1.0 };
                    kept * (prediction[axis] - observation.pixel[axis]) / observation.sigma_px
                })
            });
        rows.collect()
    }
}

/// Checks the matrix without the parameters that not every point depends on against the whole one, `entries`.
fn check_common(case: &Case, built: &Built, entries: &[f64], side: usize) {
    let n_lens = if case.model.local_support().is_some() { 4 } else { case.lens.len() };
    let n_left_out = case.lens.len() - n_lens;
    let n = side - n_left_out;
    let mut common = vec![f64::NAN; n * n];
    let mut gram = GramMut::new(&mut common, n);
    let values = built.parameters.values();
    built.term.linearize_common(values, &mut gram, &mut Scratch::default()).expect("the case is in view");
    let place = |column: usize| if column < n_lens { column } else { column + n_left_out };
    for a in 0..n {
        for b in a..n {
            // Of the residual's square nothing is promised.
            let (found, whole) = (common[a * n + b], entries[place(a) * side + place(b)]);
            let is_alike = (found - whole).abs() <= 1e-9 * whole.abs().max(1.0);
            assert!(is_alike || a + 1 == n, "columns {a} {b}: {found} against {whole}");
        }
    }
}

/// Checks every entry of the term's matrix against the rows' central differences.
fn check(case: &Case) {
    let built = case.build(None);
    let n_columns = case.lens.len() + case.shape.as_ref().map_or(0, Vec::len) + 6 * case.poses.len();
    assert_eq!(built.term.blocks(), built.blocks);
    let side = n_columns + 1;
    // What the buffer held before must not matter.
    let mut entries = vec![f64::NAN; side * side];
    let mut scratch = Scratch::default();
    let cost = built
        .term
        .linearize(built.parameters.values(), &mut GramMut::new(&mut entries, side), &mut scratch)
        .expect("the case is in view");
    check_common(case, &built, &entries, side);
    let residuals = case.residuals(&built.observations);
    // Cauchy's weight of each corner, and the loss.
    let mut weights = vec![1.0; residuals.len()];
    let mut expected_cost: f64 = residuals.iter().map(|r| r * r).sum();
    if let Loss::Cauchy { sigmas } = case.loss {
        expected_cost = 0.0;
        for (pair, weights) in residuals.chunks_exact(2).zip(weights.chunks_exact_mut(2)) {
            let square = pair[0] * pair[0] + pair[1] * pair[1];
            let c2 = sigmas * sigmas;
            expected_cost += c2 * (1.0 + square / c2).ln();
            weights.fill(1.0 / (1.0 + square / c2));
        }
    }
    assert!((cost - expected_cost).abs() <= 1e-11 * expected_cost, "cost {cost} against {expected_cost}");
    let mut columns: Vec<Vec<f64>> = Vec::new();
    for column in 0..n_columns {
        // A longer step drowns rounding: that of the iteration that finds a pupil's motion, and that of
        // large residuals where a knot, in which pixels are linear, moves few points by little, or where a high power
        // of a small angle moves none by much.
        let step = match case.model.param_groups().get(column) {
            _ if column < 4 => 1e-4,
            Some(ParamGroup::Pupil) => 1e-4,
            Some(ParamGroup::Spline) => 1e-2,
            Some(_) => 1e-5,
            None => 1e-6,
        };
        let plus = case.moved(column, step).residuals(&built.observations);
        let minus = case.moved(column, -step).residuals(&built.observations);
        columns.push(plus.iter().zip(&minus).map(|(a, b)| (a - b) / (2.0 * step)).collect());
    }
    columns.push(residuals);
    let product =
        |a: &[f64], b: &[f64]| -> f64 { a.iter().zip(b).zip(&weights).map(|((a, b), w)| a * b * w).sum() };
    let norms: Vec<f64> = columns.iter().map(|column| product(column, column).sqrt()).collect();
    for a in 0..side {
        for b in a..side {
            let (found, expected) = (entries[a * side + b], product(&columns[a], &columns[b]));
            // Central differences with these steps are good to about 1e-8 of a column's norm, and to 1e-8
            // in themselves, which counts beside a knot that hardly moves a point.
            // The slope of a quadratic spline has kinks at its knots, where they are good to the step.
            let is_kinked = case.model.name().starts_with("splined2");
            let share = if is_kinked { 3e-6 } else { 3e-7 };
            let tolerance = share * norms[a] * norms[b] + 1e-8 * (norms[a] + norms[b]) + 1e-9;
            let model = case.model;
            assert!((found - expected).abs() <= tolerance, "{model} ({a}, {b}): {found} against {expected}");
        }
    }
    let Some(local) = built.term.local() else { return };
    let mut gradient = vec![0.0; n_columns];
    let cost_again = local.gradient(built.parameters.values(), &mut gradient, &mut scratch).unwrap();
    assert!((cost_again - cost).abs() <= 1e-12 * cost, "cost {cost_again} against {cost}");
    for (column, found) in gradient.iter().enumerate() {
        // The same products in another order.
        let (expected, size) = (entries[column * side + n_columns], norms[column] * norms[n_columns]);
        assert!((found - expected).abs() <= 1e-12 * size, "{column}: {found} against {expected}");
    }
}

/// Returns the first example of a model, with its configuration if it has one.
fn example(model: Model) -> (Model, Vec<f64>) {
    struct Example;
    impl ModelVisitor for Example {
        type Output = (String, Vec<f64>);
        fn visit<M: CameraModel>(self, _: M) -> Self::Output {
            let (model, params) = M::examples().remove(0);
            let configuration = model.configuration().map(|text| format!(":{text}")).unwrap_or_default();
            (format!("{}{configuration}", M::NAME), params)
        }
    }
    let (name, params) = model.visit(Example);
    (name.parse().unwrap(), params)
}

fn pose(rotation: [f64; 3], translation: [f64; 3]) -> Pose {
    Pose::from_rodrigues(Vector3::from(rotation), Vector3::from(translation))
}

const TWISTED_M: [f64; 6] = [2e-3, -3e-3, 4e-3, -1e-3, 2e-3, -2e-3];

fn case(model: Model) -> Case {
    let (model, lens) = example(model);
    Case {
        model,
        lens,
        shape: Some(vec![2e-3, -3e-3]),
        poses: vec![pose([0.05, -0.1, 0.02], [0.1, 0.02, -0.05]), pose([0.3, 0.2, -0.1], [-0.2, -0.35, 1.3])],
        inverse: vec![false, false],
        loss: Loss::None,
        n_points: 135,
        rejected: vec![],
    }
}

#[test]
fn every_lens_matches_differences() {
    for name in Model::names() {
        check(&case(name.parse().unwrap()));
    }
}

#[test]
fn every_lens_matches_differences_on_a_twisted_board() {
    for name in Model::names() {
        check(&Case { shape: Some(TWISTED_M.to_vec()), ..case(name.parse().unwrap()) });
    }
}

#[test]
fn splined_lenses_match_in_every_way() {
    for name in ["splined2", "splined3"] {
        let case = case(name.parse().unwrap());
        check(&Case { shape: None, n_points: 13, ..case.clone() });
        check(&Case { shape: Some(TWISTED_M.to_vec()), n_points: 13, ..case.clone() });
        check(&Case { loss: Loss::Cauchy { sigmas: 30.0 }, ..case.clone() });
        check(&Case { rejected: vec![0, 3, 77, 134], n_points: 135, ..case.clone() });
        let mut long = case;
        long.poses.insert(1, pose([0.1, 0.05, -0.3], [0.02, 0.1, 0.1]));
        long.inverse = vec![false, true, false];
        check(&long);
    }
}

#[test]
fn every_number_of_points_matches() {
    // Fewer than a register, whole registers, one more, and more than are in scratch at once.
    for n_points in [1, 3, 8, 9, 16, 56, 57, 112, 113, 135] {
        check(&Case { n_points, ..case("opencv8".parse().unwrap()) });
    }
}

#[test]
fn every_topology_matches() {
    let base = case("opencv5".parse().unwrap());
    let near = base.poses[0];
    let one = Case { poses: vec![base.poses[1]], inverse: vec![false], ..base.clone() };
    let inverse =
        Case { poses: vec![near.inverse(), base.poses[1]], inverse: vec![true, false], ..base.clone() };
    let three = Case {
        poses: vec![near, base.poses[1].inverse(), pose([0.02, 0.1, 0.0], [0.01, 0.02, 0.03])],
        inverse: vec![false, true, false],
        ..base.clone()
    };
    let rigid = Case { shape: None, ..base.clone() };
    [one, inverse, three, rigid].iter().for_each(check);
}

#[test]
fn rejected_corners_and_robust_losses_match() {
    let base = case("opencv8".parse().unwrap());
    check(&Case { rejected: vec![0, 7, 8, 100, 134], ..base.clone() });
    check(&Case { loss: Loss::Cauchy { sigmas: 40.0 }, ..base.clone() });
    check(&Case { loss: Loss::Cauchy { sigmas: 3.0 }, rejected: vec![134], ..base });
}

#[test]
fn a_point_behind_the_camera_is_not_defined() {
    let base = case("opencv5".parse().unwrap());
    let behind = Case { poses: vec![base.poses[0], pose([0.3, 0.2, 0.0], [0.0, 0.0, -0.1])], ..base };
    let built = behind.build(None);
    let mut entries = vec![0.0; 24 * 24];
    let outcome = built.term.linearize(
        built.parameters.values(),
        &mut GramMut::new(&mut entries, 9 + 2 + 12 + 1),
        &mut Scratch::default(),
    );
    assert_eq!(outcome, None);
    assert!(built.term.predict(built.parameters.values()).contains(&None));
}
