//! A view whose rows were taken one after another, of a target that moves: each point has a time of its own.
//!
//! The chain is `before * motion(t) * after`, with `t` the lateness of the camera and its line delay times how far below
//! the middle the point's row is. The row is the one that was measured, so that `t` is linear in both unknowns. So the
//! points of a view share no composite pose, and this is no composite term: rows are written and multiplied point by
//! point. What the chain's links do is the same for all points on either side of the motion, though.

use boresight_camera::{CameraModel, ModelVisitor};
use boresight_data::FrameMotion;
use boresight_geometry::{Pose, Vector3, Vector6};
use boresight_solver::{BlockId, GramMut, Links, Values};

use super::{MAX_LENS, MAX_SHAPE, Reprojection, Weights};
use crate::chain::{CLOCK_COLUMN, Chain, LINE_DELAY_COLUMN, Link, line_delay, seconds};
use crate::options::Loss;

/// When the rows of a view's points were taken, and the chain cut where the target moves meanwhile.
#[derive(Clone, Debug)]
pub(super) struct RowTimes {
    before: Chain,
    late: BlockId,
    motion: FrameMotion,
    after: Chain,
    /// How far below the middle row of the image each point was seen.
    rows: Vec<f64>,
}

impl RowTimes {
    /// Cuts a chain at its motion; `None` if it has none.
    pub(super) fn new(chain: &Chain, rows: Vec<f64>) -> Option<Self> {
        let place = chain.links.iter().position(|link| matches!(link, Link::Late(..)))?;
        let Link::Late(late, motion) = chain.links[place] else { return None };
        let part = |links: &[Link]| Chain { links: links.to_vec() };
        let (before, after) = (part(&chain.links[..place]), part(&chain.links[place + 1..]));
        Some(Self { before, late, motion, after, rows })
    }
}

/// The poses of a view with row times, at some values.
struct Rolling<'a> {
    term: &'a Reprojection,
    times: &'a RowTimes,
    lens: &'a [f64],
    shape: [f64; MAX_SHAPE],
    before: Pose,
    after: Pose,
    late_s: f64,
    line_delay_s: f64,
}

/// Where a point is as its row was taken.
struct Placed {
    time_s: f64,
    /// `motion(t)`.
    moved: Pose,
    /// The point before the motion, after it, and in the camera.
    at_rest: Vector3<f64>,
    at_time: Vector3<f64>,
    in_cam: Vector3<f64>,
}

impl<'a> Rolling<'a> {
    fn new(term: &'a Reprojection, times: &'a RowTimes, values: Values<'a>) -> Self {
        Self {
            term,
            times,
            lens: values.vector(term.blocks[0]),
            shape: term.shape(values),
            before: times.before.compose(values),
            after: times.after.compose(values),
            late_s: seconds(values, times.late),
            line_delay_s: line_delay(values, times.late),
        }
    }

    fn place(&self, point: usize) -> Placed {
        let in_target = self.term.points.bent(point, &self.shape[..self.term.n_shape]);
        let time_s = self.late_s + self.line_delay_s * self.times.rows[point];
        let moved = self.times.motion.after(time_s);
        let at_rest = self.after * in_target;
        let at_time = moved * at_rest;
        Placed { time_s, moved, at_rest, at_time, in_cam: self.before * at_time }
    }
}

impl Reprojection {
    /// Returns the predicted pixel of each point, seen as its row was taken.
    pub(super) fn predict_rolling(&self, times: &RowTimes, values: Values<'_>) -> Vec<Option<[f64; 2]>> {
        self.model.visit(Predict(Rolling::new(self, times, values)))
    }

    /// Writes what [`Term::linearize`](boresight_solver::Term::linearize) does.
    pub(super) fn linearize_rolling(
        &self,
        times: &RowTimes,
        values: Values<'_>,
        gram: &mut GramMut<'_>,
    ) -> Option<f64> {
        let [mut before, mut after] = [Links::default(), Links::default()];
        times.before.linearize(values, &mut before);
        times.after.linearize(values, &mut after);
        gram.clear();
        let rolling = Rolling::new(self, times, values);
        self.model.visit(WriteRows { rolling, before: &before, after: &after, gram })
    }

    fn weight(&self, point: usize) -> f64 {
        match &self.weights {
            Weights::Uniform(weight) => *weight,
            Weights::Each(weights) => weights[point],
        }
    }
}

struct Predict<'a>(Rolling<'a>);

impl ModelVisitor for Predict<'_> {
    type Output = Vec<Option<[f64; 2]>>;

    fn visit<M: CameraModel>(self, model: M) -> Self::Output {
        let Self(rolling) = self;
        let project = |point: usize| model.project(rolling.lens, rolling.place(point).in_cam.into());
        (0..rolling.term.points.n_points).map(project).collect()
    }
}

struct WriteRows<'a, 'b, 'c> {
    rolling: Rolling<'a>,
    before: &'b Links,
    after: &'b Links,
    gram: &'b mut GramMut<'c>,
}

impl ModelVisitor for WriteRows<'_, '_, '_> {
    type Output = Option<f64>;

    fn visit<M: CameraModel>(self, model: M) -> Option<f64> {
        let Self { rolling, before, after, gram } = self;
        let Rolling { term, lens, .. } = rolling;
        let (n_lens, n) = (lens.len(), gram.size());
        let first_pose = n_lens + term.n_shape;
        let clock = first_pose + 6 * before.maps().len();
        let from_camera = rolling.before.rotation_matrix().transpose();
        let normal = rolling.after.rotation * Vector3::z();
        let mut row = vec![0.0; n];
        let mut by_lens = [[0.0; MAX_LENS]; 2];
        let mut cost = 0.0;
        for point in 0..term.points.n_points {
            let weight = term.weight(point);
            if weight == 0.0 {
                continue;
            }
            let placed = rolling.place(point);
            let mut by_point = [[0.0; 3]; 2];
            let [by_lens_u, by_lens_v] = &mut by_lens;
            let d_lens = [&mut by_lens_u[..n_lens - 4], &mut by_lens_v[..n_lens - 4]];
            let pixel = model.linearize(lens, placed.in_cam.into(), &mut by_point, d_lens)?;
            let residual = [0, 1].map(|axis| weight * (pixel[axis] - term.pixels[axis][point]));
            let (loss, by_root) = weighed(term.loss, residual[0] * residual[0] + residual[1] * residual[1]);
            cost += loss;
            let scale = weight * by_root;
            let to_rest = placed.moved.rotation_matrix().transpose();
            let rate = rolling.times.motion.rate(placed.time_s);
            for axis in 0..2 {
                row.fill(0.0);
                row[axis] = scale * (pixel[axis] - lens[2 + axis]) / lens[axis];
                row[2 + axis] = scale;
                for (entry, by_param) in row[4..n_lens].iter_mut().zip(&by_lens[axis]) {
                    *entry = scale * by_param;
                }
                // The gradient in the camera, with the motion done, and before it.
                let in_cam = Vector3::from(by_point[axis]) * scale;
                let at_time = from_camera * in_cam;
                let at_rest = to_rest * at_time;
                for j in 0..term.n_shape {
                    row[n_lens + j] = at_rest.dot(&normal) * term.points.axes[3 + j][point];
                }
                write_links(before, &by_pose(&placed.in_cam, &in_cam), &mut row[first_pose..]);
                let by_time = by_pose(&placed.at_time, &at_time).dot(&rate);
                row[clock + CLOCK_COLUMN] = by_time;
                row[clock + LINE_DELAY_COLUMN] = by_time * rolling.times.rows[point];
                write_links(after, &by_pose(&placed.at_rest, &at_rest), &mut row[clock + 6..]);
                row[n - 1] = by_root * residual[axis];
                for (a, left) in row.iter().enumerate().filter(|(_, left)| **left != 0.0) {
                    for (sum, right) in gram.row_mut(a)[a..].iter_mut().zip(&row[a..]) {
                        *sum += left * right;
                    }
                }
            }
        }
        Some(cost)
    }
}

/// Returns the loss of a squared residual in sigmas, and the root of the weight that it gives the rows.
fn weighed(loss: Loss, square: f64) -> (f64, f64) {
    match loss {
        Loss::None => (square, 1.0),
        // ρ(s) = c² ln(1 + s/c²), whose weight is 1 / (1 + s/c²).
        Loss::Cauchy { sigmas } => {
            let one_more = 1.0 + square / (sigmas * sigmas);
            (sigmas * sigmas * one_more.ln(), 1.0 / one_more.sqrt())
        }
    }
}

/// Returns the derivative along a left perturbation (w, v), which moves a point by w × p + v.
fn by_pose(point: &Vector3<f64>, gradient: &Vector3<f64>) -> Vector6<f64> {
    let turn = point.cross(gradient);
    Vector6::new(turn.x, turn.y, turn.z, gradient.x, gradient.y, gradient.z)
}

/// Writes six columns for each link, from those of the composite pose.
fn write_links(links: &Links, by_pose: &Vector6<f64>, columns: &mut [f64]) {
    for (map, columns) in links.maps().iter().zip(columns.chunks_exact_mut(6)) {
        match map {
            None => columns.copy_from_slice(by_pose.as_slice()),
            Some(map) => {
                let map = map.matrix();
                for (k, entry) in columns.iter_mut().enumerate() {
                    *entry = (0..6).map(|l| by_pose[l] * map[l][k]).sum();
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use boresight_camera::Model;
    use boresight_data::{Geometry, Observation, PointId, Shape, Target};
    use boresight_solver::{Elimination, Parameters, Scratch, Term as _};

    use super::*;
    use crate::chain::clock;
    use crate::reprojection::{Layouts, TargetPoints};

    /// A view of a moving board: the values of its blocks, one number each, in the order of the term's columns.
    #[derive(Clone)]
    struct Case {
        model: Model,
        lens: Vec<f64>,
        shape: [f64; 2],
        /// Camera, clock, frame and board.
        poses: [Pose; 4],
        loss: Loss,
    }

    const N_POINTS: usize = 13;

    impl Case {
        fn new(model: &str, loss: Loss, clock: Pose) -> Self {
            let model: Model = model.parse().unwrap();
            let lens = (0..model.param_count())
                .map(|i| [500.0, 510.0, 320.0, 240.0, 0.01, -0.004][i.min(5)])
                .collect();
            let pose =
                |a: f64, z: f64| Pose::from_rodrigues(Vector3::new(a, 0.3 - a, 0.2), Vector3::new(0.1, a, z));
            Self {
                model,
                lens,
                shape: [2e-3, -1e-3],
                poses: [pose(0.1, 0.1), clock, pose(0.2, 1.0), pose(-0.1, 0.2)],
                loss,
            }
        }

        fn observations() -> Vec<Observation> {
            let seen = |i: usize| Observation {
                point: PointId((i * 8) as u32),
                pixel: [300.0 + 7.0 * i as f64, 40.0 + 31.0 * i as f64],
                sigma_px: 0.5 + 0.1 * (i % 4) as f64,
            };
            (0..N_POINTS).map(seen).collect()
        }

        fn build(&self) -> (Parameters, Reprojection) {
            let target = Target {
                name: "board".to_owned(),
                geometry: Geometry::Chessboard { columns: 9, rows: 12, spacing_m: 0.03 },
                shape: Shape::Parabolic2,
            };
            let motion = FrameMotion {
                velocity: Vector6::new(0.8, -0.5, 0.6, 0.4, 0.2, -0.6),
                acceleration: Vector6::new(-1.0, 2.0, 0.7, 1.5, -0.8, 0.9),
            };
            let mut parameters = Parameters::default();
            let lens = parameters.add_vector(&self.lens);
            let shape = parameters.add_vector(&self.shape);
            let [camera, late, frame, board] =
                self.poses.map(|pose| parameters.add_pose(&pose, Elimination::Reduced));
            let links =
                vec![Link::Block(camera), Link::Late(late, motion), Link::Block(frame), Link::Inverse(board)];
            let observations = Self::observations();
            let points = Arc::new(TargetPoints::new(&target, &observations));
            let layouts = &Layouts::default();
            let chain = Chain { links };
            let mut term =
                Reprojection::new(self.model, lens, Some((shape, 2)), chain, points, &observations, layouts);
            term.set_loss(self.loss);
            term.set_kept(&observations, |idx| idx != 5);
            (parameters, term)
        }

        fn rolling(&self) -> (Parameters, Reprojection) {
            let (parameters, term) = self.build();
            (
                parameters,
                term.with_row_times(Self::observations().iter().map(|seen| seen.pixel[1] - 239.5).collect()),
            )
        }

        fn moved(&self, column: usize, step: f64) -> Self {
            let mut case = self.clone();
            let n_lens = self.lens.len();
            if column < n_lens {
                case.lens[column] += step;
            } else if column < n_lens + 2 {
                case.shape[column - n_lens] += step;
            } else {
                let mut tangent = Vector6::zeros();
                tangent[(column - n_lens - 2) % 6] = step;
                let pose = &mut case.poses[(column - n_lens - 2) / 6];
                *pose = pose.perturbed(&tangent);
            }
            case
        }

        fn n_columns(&self) -> usize {
            self.lens.len() + 2 + 24
        }

        /// The residuals in sigmas, two for each point.
        fn residuals(&self) -> Vec<f64> {
            let (parameters, term) = self.rolling();
            let predictions = term.predict(parameters.values());
            let rows = predictions.iter().zip(Self::observations());
            rows.flat_map(|(pixel, seen)| [0, 1].map(|k| (pixel.unwrap()[k] - seen.pixel[k]) / seen.sigma_px))
                .collect()
        }
    }

    /// Returns the matrix of a term, upper triangle, and its cost.
    fn gram(term: &Reprojection, parameters: &Parameters, side: usize) -> (Vec<f64>, f64) {
        let mut entries = vec![f64::NAN; side * side];
        let mut scratch = Scratch::default();
        let cost =
            term.linearize(parameters.values(), &mut GramMut::new(&mut entries, side), &mut scratch).unwrap();
        let mut common = vec![f64::NAN; side * side];
        term.linearize_common(parameters.values(), &mut GramMut::new(&mut common, side), &mut scratch)
            .unwrap();
        for a in 0..side {
            for b in a..side {
                assert!(
                    a + 1 == side
                        || (entries[a * side + b] - common[a * side + b]).abs()
                            <= 1e-9 * entries[a * side + b].abs()
                );
            }
        }
        assert_eq!(scratch.links.maps().len(), 4);
        (entries, cost)
    }

    fn check_differences(model: &str, loss: Loss) {
        let case = Case::new(model, loss, clock(0.01, 2e-4));
        let (parameters, term) = case.rolling();
        assert!(term.composite().is_none());
        let n = case.n_columns();
        let (entries, cost) = gram(&term, &parameters, n + 1);
        let residuals = case.residuals();
        let clock_column = case.lens.len() + 2 + 6;
        let columns: Vec<Vec<f64>> = (0..n)
            .map(|column| {
                if (clock_column..clock_column + 6).contains(&column)
                    && ![CLOCK_COLUMN, LINE_DELAY_COLUMN].contains(&(column - clock_column))
                {
                    return vec![0.0; residuals.len()];
                }
                let step = if column == clock_column + LINE_DELAY_COLUMN { 1e-8 } else { 1e-6 };
                let [ahead, behind] = [step, -step].map(|step| case.moved(column, step).residuals());
                ahead.iter().zip(behind).map(|(a, b)| (a - b) / (2.0 * step)).collect()
            })
            .collect();
        let (mut weights, mut expected_cost) = (vec![1.0; residuals.len()], 0.0);
        for point in 0..N_POINTS {
            let square = residuals[2 * point].powi(2) + residuals[2 * point + 1].powi(2);
            let (own, root) = weighed(loss, square);
            let kept = if point == 5 { 0.0 } else { 1.0 };
            expected_cost += kept * own;
            weights[2 * point..2 * point + 2].fill(kept * root * root);
        }
        assert!((cost / expected_cost - 1.0).abs() < 1e-12, "{model}: {cost} {expected_cost}");
        let dot = |a: &[f64], b: &[f64]| -> f64 {
            a.iter().zip(b).zip(&weights).map(|((a, b), weight)| weight * a * b).sum()
        };
        for a in 0..n {
            for b in a..=n {
                let right = if b == n { &residuals } else { &columns[b] };
                let expected = dot(&columns[a], right);
                let size = (dot(&columns[a], &columns[a]) * dot(right, right)).sqrt();
                let found = entries[a * (n + 1) + b];
                // Central differences are good to 1e-7; the rate of a motion is a series good to 1e-6.
                assert!(
                    (found - expected).abs() <= 3e-6 * size,
                    "{model} {a} {b}: {found} {expected} of {size}"
                );
            }
        }
    }

    #[test]
    fn rows_match_differences() {
        for model in ["pinhole", "opencv5", "opencv14", "kannala-brandt4", "division"] {
            check_differences(model, Loss::None);
            check_differences(model, Loss::Cauchy { sigmas: 40.0 });
        }
    }

    #[test]
    fn rows_of_one_time_are_those_of_the_kernel() {
        for (model, loss) in [("opencv5", Loss::None), ("opencv8", Loss::Cauchy { sigmas: 3.0 })] {
            let case = Case::new(model, loss, clock(0.02, 0.0));
            let (parameters, rolling) = case.rolling();
            let (_, plain) = case.build();
            let side = case.n_columns() + 1;
            let [(entries, cost), (expected, expected_cost)] =
                [&rolling, &plain].map(|term| gram(term, &parameters, side));
            assert!((cost / expected_cost - 1.0).abs() < 1e-12);
            let idle = case.lens.len() + 2 + 6 + LINE_DELAY_COLUMN;
            for a in (0..side).filter(|a| *a != idle) {
                for b in (a..side).filter(|b| *b != idle) {
                    let [found, expected] = [&entries, &expected].map(|entries| entries[a * side + b]);
                    let size = (entries[a * (side + 1)] * entries[b * (side + 1)]).abs().sqrt();
                    assert!((found - expected).abs() <= 1e-10 * size, "{model} {a} {b}: {found} {expected}");
                }
            }
            let observations = Case::observations();
            let [of_rows, of_view] =
                [&rolling, &plain].map(|term| term.lengths(parameters.values(), &observations));
            for (a, b) in of_rows.iter().zip(&of_view) {
                assert!((a / b - 1.0).abs() < 1e-10, "{a} {b}");
            }
        }
    }
}
