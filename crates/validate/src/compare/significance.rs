//! Whether a difference of two calibrations is more than their own uncertainty explains.
//!
//! Two calibrations from independent data differ by their errors. What of a lens's error a transform
//! makes up for is taken out of the difference, so it is taken out of the prediction too: with L a
//! pixel's derivatives by the lens and G those by the transform, the fit over the focus region leaves
//! `H = L - G (sum GᵀG)⁻¹ sum GᵀL` of the lens's error, and the difference at a pixel has the covariance
//! `H_a C_a H_aᵀ + H_b C_b H_bᵀ`. A ratio of one is what noise gives. Calibrations that share data differ by less.

use boresight_data::Uncertainty;
use boresight_geometry::nalgebra::{DMatrix, Matrix2xX, Matrix6, Matrix6xX, Vector2};
use boresight_geometry::{Pose, Vector3, Vector6};
use serde::{Deserialize, Serialize};

use super::grid::Grid;
use super::{CompareOptions, Comparison};
use crate::slopes::Slopes;
use crate::uncertainty::{Eye, Joint, Propagation};

/// Points across an image at which two rigs are compared.
const TRANSFER_COLUMNS: usize = 21;
/// Points down.
const TRANSFER_ROWS: usize = 15;

/// How large a difference of two lenses is against what their uncertainties predict.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Significance {
    /// The root mean square length of a difference that both uncertainties predict, in pixels.
    pub predicted_rms_px: f64,
    /// The root mean square of the differences, each in units of its own predicted scatter. About one for
    /// two calibrations that differ by noise only; many times that if a model or the camera changed.
    pub ratio: f64,
}

/// How large a difference of two relative poses is against what their uncertainties predict.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PoseSignificance {
    /// The standard deviation of the difference of positions, over all directions, in millimetres.
    pub predicted_translation_mm: f64,
    /// The standard deviation of the difference of orientations, over all axes, in degrees.
    pub predicted_rotation_deg: f64,
    /// The root mean square of the six differences in units of their joint scatter. Noise gives about one.
    pub ratio: f64,
}

/// Where one camera sees what another sees, in one calibration against another: the two lenses and the
/// pose between them together, so that no frame and no transform is in it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct TransferDifference {
    /// The number of points that both calibrations transfer.
    pub points: usize,
    /// The root mean square difference in the second camera, in pixels.
    pub rms_px: f64,
    /// The same in millimetres across the line of sight; `None` at infinity.
    pub rms_mm: Option<f64>,
    /// What both uncertainties predict of `rms_px`, and the ratio; `None` where either is unknown.
    pub significance: Option<Significance>,
}

/// A camera of a calibration with its joint covariance.
pub(super) struct Known<'a> {
    pub(super) joint: Joint<'a>,
}

impl<'a> Known<'a> {
    /// Returns what a calibration knows of itself, `None` if that is nothing.
    pub(super) fn new(uncertainty: &'a Uncertainty) -> Option<Self> {
        Joint::new(uncertainty, Propagation::WithBeliefs).ok().map(|joint| Self { joint })
    }

    fn covariance(&self, places: &[usize]) -> DMatrix<f64> {
        DMatrix::from_row_slice(places.len(), places.len(), &self.joint.block(places))
    }
}

/// Returns how significant the difference of two lenses is, `None` where nothing is known of either.
pub(super) fn of_lenses(comparison: &Comparison, sides: [(&Known<'_>, &Eye); 2]) -> Option<Significance> {
    let grid = Grid { image_size: comparison.image_size, columns: comparison.columns, rows: comparison.rows };
    let lenses = sides.map(|(known, eye)| {
        let places: Vec<usize> = eye.lens.iter().map(|(_, place)| *place).collect();
        let left = Remaining::new(eye, &grid, comparison);
        left.map(|left| (known.covariance(&places), left))
    });
    let [Some(a), Some(b)] = lenses else { return None };
    let mut sums = Sums::default();
    for (i, difference) in comparison.differences_px.iter().enumerate() {
        let Some([u, v]) = *difference else { continue };
        let (Some(of_a), Some(of_b)) = (a.1.at(grid.pixel(i)), b.1.at(grid.pixel(i))) else { continue };
        let predicted = &of_a * &a.0 * of_a.transpose() + &of_b * &b.0 * of_b.transpose();
        sums.add(Vector2::new(u, v), &predicted)?;
    }
    sums.significance()
}

/// Sums over points.
#[derive(Default)]
struct Sums {
    n: usize,
    predicted_px2: f64,
    normalized: f64,
}

impl Sums {
    /// Adds a difference with the covariance that is predicted of it, `None` if that is singular.
    fn add(&mut self, difference: Vector2<f64>, predicted: &DMatrix<f64>) -> Option<()> {
        let predicted = predicted.fixed_view::<2, 2>(0, 0).into_owned();
        self.n += 1;
        self.predicted_px2 += predicted.trace();
        self.normalized += 0.5 * difference.dot(&(predicted.try_inverse()? * difference));
        Some(())
    }

    fn significance(&self) -> Option<Significance> {
        let n = self.n as f64;
        (self.n > 0).then(|| Significance {
            predicted_rms_px: (self.predicted_px2 / n).sqrt(),
            ratio: (self.normalized / n).max(0.0).sqrt(),
        })
    }
}

/// What the transform's fit leaves of a lens's error.
struct Remaining<'a> {
    eye: &'a Eye,
    distance_m: Option<f64>,
    /// The transform that a change of each lens parameter implies.
    implied: Matrix6xX<f64>,
}

impl<'a> Remaining<'a> {
    fn new(eye: &'a Eye, grid: &Grid, comparison: &Comparison) -> Option<Self> {
        let n_lens = eye.lens.len();
        let mut left = Self { eye, distance_m: comparison.distance_m, implied: Matrix6xX::zeros(n_lens) };
        let (mut own, mut with_lens) = (Matrix6::zeros(), Matrix6xX::zeros(n_lens));
        for i in (0..grid.len()).filter(|&i| grid.radius(i) <= comparison.focus_radius_px) {
            if comparison.differences_px.get(i).is_none_or(Option::is_none) {
                continue;
            }
            let Some((by_lens, by_transform)) = left.slopes(grid.pixel(i)) else { continue };
            own += by_transform.transpose() * by_transform;
            with_lens += by_transform.transpose() * by_lens;
        }
        if comparison.distance_m.is_none() {
            // There is no translation at infinity.
            (3..6).for_each(|k| own[(k, k)] = 1.0);
        }
        left.implied = own.cholesky()?.solve(&with_lens);
        Some(left)
    }

    /// Returns a pixel's derivatives by the lens, and by rotation and translation (in units of the distance).
    fn slopes(
        &self,
        pixel: [f64; 2],
    ) -> Option<(Matrix2xX<f64>, boresight_geometry::nalgebra::Matrix2x6<f64>)> {
        let point = self.eye.camera.unproject(pixel)? * self.distance_m.unwrap_or(1.0);
        let mut slopes = Slopes::default();
        slopes.fill(&self.eye.camera, &point)?;
        let by_lens = Matrix2xX::from_fn(self.eye.lens.len(), |row, column| {
            slopes.by_param[row][self.eye.lens[column].0]
        });
        let [by_turn, by_shift] = slopes.by_motion(&point);
        let unit = self.distance_m.unwrap_or(0.0);
        let by_transform = boresight_geometry::nalgebra::Matrix2x6::from_fn(|row, k| {
            if k < 3 { by_turn[(row, k)] } else { unit * by_shift[(row, k - 3)] }
        });
        Some((by_lens, by_transform))
    }

    /// Returns how a pixel moves with the lens after the transform that the lens implies.
    fn at(&self, pixel: [f64; 2]) -> Option<DMatrix<f64>> {
        let (by_lens, by_transform) = self.slopes(pixel)?;
        let left = by_lens - by_transform * &self.implied;
        Some(DMatrix::from_fn(2, self.eye.lens.len(), |row, column| left[(row, column)]))
    }
}

/// Two cameras of one calibration.
pub(super) struct EyePair<'a> {
    pub(super) from: &'a Eye,
    pub(super) to: &'a Eye,
    pub(super) known: Option<&'a Known<'a>>,
}

impl EyePair<'_> {
    fn to_from_from(&self) -> Pose {
        self.to.cam_from_rig * self.from.cam_from_rig.inverse()
    }

    fn places(&self) -> Vec<usize> {
        self.from.places().chain(self.to.places()).collect()
    }

    /// Returns how the relative pose's left perturbation varies with lenses and poses: zero for lenses.
    fn by_places(&self) -> DMatrix<f64> {
        let n = self.places().len();
        let mut rows = DMatrix::zeros(6, n);
        // (exp(d_to) E_to) (exp(d_from) E_from)⁻¹ = exp(d_to - Ad(T) d_from) T.
        let adjoint = self.to_from_from().adjoint();
        let first = self.from.lens.len();
        for (i, (k, _)) in self.from.pose.iter().enumerate() {
            (0..6).for_each(|row| rows[(row, first + i)] = -adjoint[(row, *k)]);
        }
        let first = first + self.from.pose.len() + self.to.lens.len();
        for (i, (k, _)) in self.to.pose.iter().enumerate() {
            rows[(*k, first + i)] = 1.0;
        }
        rows
    }
}

/// Returns how significant the difference of two relative poses is, `None` where nothing is known of either.
pub(super) fn of_poses(pairs: [&EyePair<'_>; 2]) -> Option<PoseSignificance> {
    let covariance = |pair: &EyePair<'_>| -> Option<Matrix6<f64>> {
        let rows = pair.by_places();
        let covariance = &rows * pair.known?.covariance(&pair.places()) * rows.transpose();
        Some(Matrix6::from_fn(|row, column| covariance[(row, column)]))
    };
    let predicted = covariance(pairs[0])? + covariance(pairs[1])?;
    let [in_a, in_b] = pairs.map(EyePair::to_from_from);
    let difference: Vector6<f64> = (in_b * in_a.inverse()).log();
    let chi2 = difference.dot(&predicted.cholesky()?.solve(&difference));
    let trace = |first: usize| (first..first + 3).map(|k| predicted[(k, k)]).sum::<f64>().sqrt();
    Some(PoseSignificance {
        predicted_translation_mm: 1e3 * trace(3),
        predicted_rotation_deg: trace(0).to_degrees(),
        ratio: (chi2.max(0.0) / 6.0).sqrt(),
    })
}

/// Returns how differently two calibrations transfer pixels from one camera to another; `None` where
/// the cameras see nothing in common.
pub(super) fn of_transfer(pairs: [&EyePair<'_>; 2], options: &CompareOptions) -> Option<TransferDifference> {
    let image_size = pairs[0].from.camera.image_size;
    let grid = Grid { image_size, columns: TRANSFER_COLUMNS, rows: TRANSFER_ROWS };
    let covariances = pairs.map(|pair| pair.known.map(|known| known.covariance(&pair.places())));
    let (mut px2, mut m2, mut n) = (0.0, 0.0, 0usize);
    let mut sums = Some(Sums::default());
    for i in 0..grid.len() {
        let transfers = pairs.map(|pair| Transferred::new(pair, grid.pixel(i), options.distance_m));
        let [Some(a), Some(b)] = transfers else { continue };
        let difference = Vector2::new(b.pixel[0] - a.pixel[0], b.pixel[1] - a.pixel[1]);
        n += 1;
        px2 += difference.norm_squared();
        m2 += 0.5 * ((a.by_pixel * difference).norm_squared() + (b.by_pixel * difference).norm_squared());
        if let [Some(of_a), Some(of_b)] = &covariances {
            let predicted =
                &a.by_places * of_a * a.by_places.transpose() + &b.by_places * of_b * b.by_places.transpose();
            sums = sums.and_then(|mut sums| sums.add(difference, &predicted).map(|()| sums));
        }
    }
    let rms = |sum: f64| (sum / n as f64).sqrt();
    (n > 0).then(|| TransferDifference {
        points: n,
        rms_px: rms(px2),
        rms_mm: options.distance_m.map(|_| 1e3 * rms(m2)),
        significance: sums.and_then(|sums| sums.significance()),
    })
}

/// Where the second camera of a pair sees what a pixel of the first sees.
struct Transferred {
    pixel: [f64; 2],
    by_places: DMatrix<f64>,
    /// Metres across the line of sight for a pixel.
    by_pixel: boresight_geometry::nalgebra::Matrix3x2<f64>,
}

impl Transferred {
    fn new(pair: &EyePair<'_>, pixel: [f64; 2], distance_m: Option<f64>) -> Option<Self> {
        let to_from_from = pair.to_from_from();
        let point_in_from: Vector3<f64> = pair.from.camera.unproject(pixel)? * distance_m.unwrap_or(1.0);
        let point_in_to = match distance_m {
            Some(_) => to_from_from * point_in_from,
            None => to_from_from.rotation * point_in_from,
        };
        let (mut from, mut to) = (Slopes::default(), Slopes::default());
        from.fill(&pair.from.camera, &point_in_from)?;
        to.fill(&pair.to.camera, &point_in_to)?;
        if !pair.to.is_inside(to.pixel) {
            return None;
        }
        let [by_turn, by_shift] = to.by_motion(&point_in_to);
        let near = if distance_m.is_some() { 1.0 } else { 0.0 };
        let by_motion =
            DMatrix::from_fn(
                2,
                6,
                |row, k| if k < 3 { by_turn[(row, k)] } else { near * by_shift[(row, k - 3)] },
            );
        let mut by_places = by_motion * pair.by_places();
        // The lens of the first camera moves the point across its ray, against its pixel.
        let by_from_pixel = to.by_point * to_from_from.rotation_matrix() * from.point_by_pixel()?;
        for (column, (i, _)) in pair.from.lens.iter().enumerate() {
            let by_lens = Vector2::new(from.by_param[0][*i], from.by_param[1][*i]);
            let moved = by_from_pixel * by_lens;
            (0..2).for_each(|row| by_places[(row, column)] = -moved[row]);
        }
        let first = pair.from.lens.len() + pair.from.pose.len();
        for (column, (i, _)) in pair.to.lens.iter().enumerate() {
            (0..2).for_each(|row| by_places[(row, first + column)] = to.by_param[row][*i]);
        }
        Some(Self { pixel: to.pixel, by_places, by_pixel: to.point_by_pixel()? })
    }
}
