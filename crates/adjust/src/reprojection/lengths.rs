//! How far predictions are from what was seen, several points at a time.

use boresight_camera::{CameraModel, ModelVisitor};
use boresight_data::Observation;
use boresight_geometry::{Matrix3, Scalar as _, Vector3};
use boresight_solver::Values;
use boresight_solver::lanes::Lanes;
use boresight_solver::pulp::{Simd, WithSimd};

use super::{MAX_SHAPE, Reprojection, load};

impl Reprojection {
    /// Returns the length of each observation's residual in its sigmas, whether it counts or not; infinite
    /// where the lens does not see the point.
    pub(crate) fn lengths(&self, values: Values<'_>, observations: &[Observation]) -> Vec<f64> {
        let mut lengths = match &self.row_times {
            None => self.model.visit(Measure { term: self, values }),
            Some(times) => {
                let length = |(pixel, seen): (Option<[f64; 2]>, &Observation)| {
                    pixel.map_or(f64::INFINITY, |[u, v]| (u - seen.pixel[0]).hypot(v - seen.pixel[1]))
                };
                self.predict_rolling(times, values).into_iter().zip(observations).map(length).collect()
            }
        };
        lengths.truncate(observations.len());
        lengths.iter_mut().zip(observations).for_each(|(length, seen)| *length /= seen.sigma_px);
        lengths
    }
}

struct Measure<'a> {
    term: &'a Reprojection,
    values: Values<'a>,
}

impl ModelVisitor for Measure<'_> {
    type Output = Vec<f64>;

    fn visit<M: CameraModel>(self, model: M) -> Vec<f64> {
        let Self { term, values } = self;
        let cam_from_target = term.chain.compose(values);
        let measure = MeasureWith {
            model,
            term,
            lens: values.vector(term.blocks[0]),
            rotation: cam_from_target.rotation_matrix(),
            translation: cam_from_target.translation.into(),
            shape: term.shape(values),
        };
        if const { M::IS_INLINED } {
            return term.arch.dispatch(measure);
        }
        (0..term.points.n_points).map(|point| measure.one(point)).collect()
    }
}

struct MeasureWith<'a, M> {
    model: M,
    term: &'a Reprojection,
    lens: &'a [f64],
    rotation: Matrix3<f64>,
    translation: [f64; 3],
    shape: [f64; MAX_SHAPE],
}

impl<M: CameraModel> MeasureWith<'_, M> {
    /// Returns the length in pixels of one point's residual.
    fn one(&self, point: usize) -> f64 {
        let in_target = self.term.points.bent(point, &self.shape[..self.term.n_shape]);
        let in_cam = self.rotation * in_target + Vector3::from(self.translation);
        let seen = [0, 1].map(|axis| self.term.pixels[axis][point]);
        let pixel = self.model.project(self.lens, in_cam.into());
        pixel.map_or(f64::INFINITY, |[u, v]| (u - seen[0]).hypot(v - seen[1]))
    }
}

impl<M: CameraModel> WithSimd for MeasureWith<'_, M> {
    type Output = Vec<f64>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Vec<f64> {
        let Self { model, term, lens, rotation, translation, shape } = &self;
        let zero = Lanes::splat(simd, 0.0);
        let mut params = [zero; boresight_camera::MAX_PARAMS];
        for i in 0..lens.len() {
            params[i] = zero.like(lens[i]);
        }
        let params = &params[..lens.len()];
        let axes = &term.points.axes;
        // The points are padded to whole registers.
        let mut lengths = vec![0.0; axes[0].len()];
        let mut point = 0;
        while point < lengths.len() {
            let (x, y) = (load(simd, &axes[0], point), load(simd, &axes[1], point));
            let mut z = load(simd, &axes[2], point);
            for j in 0..term.n_shape {
                z = load(simd, &axes[3 + j], point).mul_add(zero.like(shape[j]), z);
            }
            let mut in_cam = [zero; 3];
            for i in 0..3 {
                let along_z = z.mul_add(zero.like(rotation[(i, 2)]), zero.like(translation[i]));
                let along_y = y.mul_add(zero.like(rotation[(i, 1)]), along_z);
                in_cam[i] = x.mul_add(zero.like(rotation[(i, 0)]), along_y);
            }
            if let Some([u, v]) = model.project(params, in_cam) {
                let (u, v) = (u - load(simd, &term.pixels[0], point), v - load(simd, &term.pixels[1], point));
                let length = u.mul_add(u, v * v).sqrt().to_array();
                lengths[point..point + S::F64_LANES].copy_from_slice(&length[..S::F64_LANES]);
            } else {
                for lane in 0..S::F64_LANES {
                    lengths[point + lane] = self.one(point + lane);
                }
            }
            point += S::F64_LANES;
        }
        lengths
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use boresight_camera::Model;
    use boresight_data::{Geometry, PointId, Shape, Target};
    use boresight_geometry::Pose;
    use boresight_solver::{Elimination, Parameters};

    use super::*;
    use crate::chain::{Chain, Link};
    use crate::reprojection::{Layouts, TargetPoints};

    /// Lengths must be those of the predictions, where some points are behind the camera too.
    fn check(model: &str, shape: Shape, tilt_rad: f64) {
        let model: Model = model.parse().unwrap();
        let geometry = Geometry::Chessboard { columns: 7, rows: 3, spacing_m: 0.1 };
        let target = Target { name: "board".to_owned(), geometry, shape };
        let mut parameters = Parameters::default();
        let lens: Vec<f64> =
            (0..model.param_count()).map(|i| [500.0, 510.0, 320.0, 240.0, 0.01][i.min(4)]).collect();
        let lens = parameters.add_vector(&lens);
        let coefficients_m = [2e-3, -1e-3, 3e-3, 1e-3, -2e-3, 2e-3];
        let n_shape = shape.coefficient_count();
        let shape = (n_shape > 0).then(|| (parameters.add_vector(&coefficients_m[..n_shape]), n_shape));
        let pose = Pose::from_rodrigues(Vector3::new(0.1, tilt_rad, 0.2), Vector3::new(-0.1, 0.05, 0.3));
        let frame = parameters.add_pose(&pose, Elimination::First);
        let observations: Vec<Observation> = (0..21)
            .map(|i| Observation {
                point: PointId(i),
                pixel: [300.0 + f64::from(i), 250.0 - f64::from(i)],
                sigma_px: 0.5 + 0.1 * f64::from(i % 3),
            })
            .collect();
        let points = Arc::new(TargetPoints::new(&target, &observations));
        let chain = Chain { links: vec![Link::Block(frame)] };
        let layouts = &Layouts::default();
        let term = Reprojection::new(model, lens, shape, chain, points, &observations, layouts);
        let lengths = term.lengths(parameters.values(), &observations);
        let predictions = term.predict(parameters.values());
        assert_eq!(lengths.len(), predictions.len());
        for ((length, prediction), seen) in lengths.iter().zip(&predictions).zip(&observations) {
            let expected = prediction
                .map_or(f64::INFINITY, |[u, v]| (u - seen.pixel[0]).hypot(v - seen.pixel[1]) / seen.sigma_px);
            // A point almost in the plane of the camera magnifies rounding.
            assert!(*length == expected || (length / expected - 1.0).abs() < 1e-9, "{length} {expected}");
        }
        let n_behind = predictions.iter().filter(|prediction| prediction.is_none()).count();
        assert_eq!(n_behind > 0, tilt_rad > 1.0, "{n_behind}");
    }

    #[test]
    fn lengths_are_those_of_the_predictions() {
        for model in ["opencv5", "opencv8", "pinhole", "opencv14"] {
            check(model, Shape::Parabolic2, 0.1);
            check(model, Shape::Parabolic2, 1.5);
        }
        for shape in Shape::ALL {
            check("kannala-brandt4", shape, 0.1);
            check("division", shape, 0.1);
        }
    }
}
