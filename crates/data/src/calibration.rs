//! A scene, how well it is known, and what it came from.

use std::collections::BTreeMap;

use boresight_geometry::Vector3;
use serde::{Deserialize, Serialize};

use crate::{CameraId, IdVec, PointId, Scene, Target, TargetId};

/// The result of an adjustment.
#[derive(Clone, Debug, PartialEq)]
pub struct Calibration {
    /// What is believed now.
    pub scene: Scene,
    /// The targets as they were described, so that the calibration stands by itself.
    pub targets: IdVec<TargetId, Target>,
    /// The names of the frames, by frame id.
    pub frame_names: Vec<String>,
    /// How well each camera's observations are met.
    pub cameras: IdVec<CameraId, CameraFit>,
    /// How well each view is met, in the order of the dataset's views.
    pub views: Vec<ViewFit>,
    /// OpenCV's RMS over all kept observations: `sqrt(sum(du² + dv²) / observations)`, in pixels.
    pub rms_px: f64,
    /// How well the parameters are known.
    pub uncertainty: Uncertainty,
    /// The observations that were not used, and why.
    pub rejected: Vec<Rejection>,
    /// What the regularisation did.
    pub regularization: Regularization,
    /// How the solver got there and why it stopped.
    pub solve: SolveRecord,
    /// How well calibrations without a part of the frames predict that part; `None` if that was not tried.
    pub held_out: Option<HeldOut>,
    /// What the calibration was made from, and with what.
    pub provenance: Provenance,
}

impl Calibration {
    /// Returns a scene in the form of a calibration: with the names of its cameras, nothing that a solve would tell, and
    /// why there is no covariance.
    pub fn unsolved(scene: Scene, camera_names: impl IntoIterator<Item = String>, why: &str) -> Self {
        let fit = |name| CameraFit { name, ..CameraFit::default() };
        Self {
            scene,
            targets: IdVec::default(),
            frame_names: Vec::new(),
            cameras: camera_names.into_iter().map(fit).collect(),
            views: Vec::new(),
            rms_px: 0.0,
            uncertainty: Uncertainty { unavailable: Some(why.to_owned()), ..Uncertainty::default() },
            rejected: Vec::new(),
            regularization: Regularization::default(),
            solve: SolveRecord::default(),
            held_out: None,
            provenance: Provenance::default(),
        }
    }

    /// Returns the standard deviation of a corner along either axis as the residuals have it, in pixels: with what the
    /// unknowns absorbed, and whatever sigmas were stated. Cameras count by `observations`, those of the data at hand.
    pub fn corner_sigma_px(&self, observations: impl Fn(&CameraFit) -> usize) -> f64 {
        let fits = || self.cameras.iter().filter(|fit| fit.observations > 0);
        let (mut squares, mut n) = (0.0, 0);
        for fit in fits() {
            squares += observations(fit) as f64 * fit.rms_px * fit.rms_px;
            n += observations(fit);
        }
        let rows = 2 * fits().map(|fit| fit.observations).sum::<usize>();
        let widened = rows as f64 / self.uncertainty.degrees_of_freedom.max(1) as f64;
        (0.5 * squares / n.max(1) as f64 * widened).sqrt()
    }
}

/// How well one camera's observations are met.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CameraFit {
    /// The camera's name.
    pub name: String,
    /// OpenCV's RMS over the camera's kept observations, in pixels.
    pub rms_px: f64,
    /// The number of views used.
    pub views: usize,
    /// The number of observations kept.
    pub observations: usize,
    /// The number of observations rejected.
    pub rejected: usize,
}

/// How well one view is met.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ViewFit {
    /// OpenCV's RMS over the view's kept observations, in pixels; `None` if none was kept or the view was left out.
    pub rms_px: Option<f64>,
    /// Predicted minus observed pixel of each observation, in the order of the view's observations,
    /// rejected ones included; empty if the view was left out.
    pub residuals_px: Vec<[f64; 2]>,
}

/// How well the parameters are known.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Uncertainty {
    /// The factor by which the stated sigmas must be multiplied to explain the residuals:
    /// `sqrt(chi² / degrees of freedom)`, the regularisation excluded. All sigmas here include it.
    pub noise_factor: f64,
    /// Equations minus unknowns.
    pub degrees_of_freedom: usize,
    /// The names of the parameters of `covariance`, such as `left.fx`, `right.cam_from_rig.tx_m`,
    /// `target.shape0_m`, in its order. Rotations are left perturbations in radians
    /// (`right.cam_from_rig.rx_rad`). Held parameters and the poses of frames are not among them.
    pub names: Vec<String>,
    /// The joint covariance, row by row.
    pub covariance: Vec<f64>,
    /// Why there is no covariance, where there is none.
    pub unavailable: Option<String>,
    /// The distance of each camera's centre from the reference camera's, with its sigma, in metres.
    /// A camera whose place is held has none.
    pub baselines_m: BTreeMap<String, [f64; 2]>,
    /// What the regularisation claims to know of each parameter of `names`: the inverse square of its
    /// sigma, zero where it claims nothing. Residuals in units of the stated sigma have the weight one. Of a lens
    /// that cameras share it is told once, at the last camera's names.
    pub regularization_information: Vec<f64>,
    /// What it claims of two parameters together: their places in `names`, the first before the second, and the entry of
    /// the regularisation's matrix. There are such claims about the knots of a spline in mrcal's way.
    pub regularization_pairs: Vec<(usize, usize, f64)>,
    /// How the poses of all frames vary with the parameters, as far as projections ask for it.
    pub motions: Motions,
    /// Combinations of parameters that the data hardly tell apart, the loosest first.
    pub loose: Vec<LooseDirection>,
}

impl Uncertainty {
    /// Returns where a parameter is in `names`, or `None` if it was not estimated.
    fn place(&self, parameter: &str) -> Option<usize> {
        self.names.iter().position(|name| name == parameter)
    }

    /// Returns the sigma of a parameter such as `left.fx`, or `None` if it was not estimated.
    pub fn sigma(&self, parameter: &str) -> Option<f64> {
        let i = self.place(parameter)?;
        self.covariance.get(i * (self.names.len() + 1)).map(|variance| variance.sqrt())
    }

    /// Returns the sigma of a camera's distance from the reference camera, in metres, where `translation_m` is that of its
    /// `cam_from_rig`; `None` where its place was not estimated.
    pub fn baseline_sigma_m(&self, camera: &str, translation_m: &Vector3<f64>) -> Option<f64> {
        let place = |axis: &str| self.place(&format!("{camera}.cam_from_rig.t{axis}_m"));
        // A left perturbation (w, v) changes |t| by t·v / |t|; w × t is square to t.
        let direction = translation_m / translation_m.norm().max(f64::MIN_POSITIVE);
        let free: Vec<(usize, f64)> = ["x", "y", "z"]
            .into_iter()
            .zip(&direction)
            .filter_map(|(axis, d)| Some((place(axis)?, *d)))
            .collect();
        let entry = |a: usize, b: usize| self.covariance.get(a * self.names.len() + b).copied();
        let mut variance = 0.0;
        for (a, along_a) in &free {
            for (b, along_b) in &free {
                variance += along_a * along_b * entry(*a, *b)?;
            }
        }
        (!free.is_empty()).then(|| variance.max(0.0).sqrt())
    }

    /// Returns which share of what is known of a parameter the regularisation claims; `None` if it was not estimated.
    pub fn believed_share(&self, parameter: &str) -> Option<f64> {
        let n = self.names.len();
        let i = self.place(parameter)?;
        let row = self.covariance.get(i * n..(i + 1) * n)?;
        // Of a lens that cameras share the claim stands at one of the names, whose numbers are the same.
        let is_same = |j: &usize| row[*j] == row[i] && self.covariance[j * (n + 1)] == row[i];
        let claims = &self.regularization_information;
        let claimed: f64 = (0..claims.len().min(n)).filter(is_same).map(|j| claims[j]).sum();
        Some(claimed * row[i] / self.noise_factor.powi(2))
    }
}

/// Motions of frames as wholes, which are linear functions of the poses of all frames; they are known
/// jointly with the parameters. Each is a left perturbation: rotation in radians, translation in metres.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Motions {
    /// The names: `mean.rx_rad` to `mean.tz_m` is the mean motion of the targets of all frames in the rig;
    /// `left.views.rx_rad` to `left.views.tz_m` is the motion in camera `left` that explains best, over
    /// its own corners and with its lens as it is, how they move when everything but its lens does.
    pub names: Vec<String>,
    /// For each motion a row of its covariances with the parameters, then with the motions, each in order.
    pub covariance: Vec<f64>,
}

/// A combination of parameters that the data hardly tell apart.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LooseDirection {
    /// How much less is known of it than of the same parameters one by one: a ratio of sigmas.
    pub inflation: f64,
    /// The parameters that make it up, with their shares; the shares of all parameters sum to one.
    pub parts: Vec<(String, f64)>,
    /// What cannot be separated and what would separate it, in words.
    pub words: String,
}

/// How well calibrations without a part of the frames predict that part.
///
/// Each fold leaves out its frames, solves for lenses, rig and target from the rest, and then fits
/// nothing but the poses of the frames left out, to all of their corners. What remains is compared
/// with what remains in the solution itself, both per degree of freedom.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct HeldOut {
    /// The number of parts that were left out in turn.
    pub folds: usize,
    /// The number of frames that were predicted.
    pub frames: usize,
    /// The number of their views.
    pub views: usize,
    /// The number of corners in these.
    pub observations: usize,
    /// Residuals less what the poses of the frames absorb: two for each corner, less six for each frame.
    pub degrees_of_freedom: usize,
    /// The root of the mean squared distance of a corner from its prediction, with the mean taken over
    /// degrees of freedom: `sqrt(2 sum(du² + dv²) / degrees of freedom)`, in pixels.
    pub rms_px: f64,
    /// The same of the solution itself over all corners it used, in pixels.
    pub in_sample_rms_px: f64,
    /// `rms_px / in_sample_rms_px`, both weighted by the corners' sigmas. One is perfect.
    pub ratio: f64,
    /// By camera, the root of the mean squared distance of a corner from its prediction, in pixels.
    pub cameras_px: BTreeMap<String, f64>,
    /// How well one camera's view of a frame left out predicts what the others see; `None` for a
    /// single camera.
    pub transfer: Option<Transfer>,
    /// Views that could not be predicted, because without their fold nothing determines their camera.
    pub untested_views: usize,
}

/// From one camera to another, over frames that were left out of the calibration.
///
/// The target's pose comes from one camera's corners alone; the rig then says where the others must
/// see them. The pose's own noise is part of the error, as it is in use.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Transfer {
    /// The number of corners predicted.
    pub observations: usize,
    /// The root of the mean squared distance of a corner from where it is predicted, in pixels.
    pub rms_px: f64,
    /// The root of the mean squared distance of a predicted corner from the line of sight that saw it,
    /// in millimetres at the target.
    pub rms_mm: f64,
}

/// An observation that was not used.
#[derive(Clone, Debug, PartialEq)]
pub struct Rejection {
    /// The view, as an index into the dataset's views.
    pub view_idx: usize,
    /// The point.
    pub point: PointId,
    /// Why.
    pub reason: RejectionReason,
}

/// Why an observation was not used.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "kind")]
pub enum RejectionReason {
    /// It lies too far from where the solution says.
    Outlier {
        /// The length of its residual in sigmas.
        sigmas: f64,
        /// The limit it was held against.
        limit: f64,
    },
    /// Its view or camera was left out of the solve.
    LeftOut {
        /// Why.
        why: String,
    },
}

/// What the regularisation did.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Regularization {
    /// `none`, `default` or `mrcal-2.2`.
    pub kind: String,
    /// The number of rows it added.
    pub rows: usize,
    /// Its share of the cost, in chi-squared.
    pub chi2: f64,
}

/// How the solver got to the solution.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SolveRecord {
    /// The sum of squared residuals, each in units of its sigma, regularisation included.
    pub chi2: f64,
    /// The sum over all passes of accepted and rejected steps.
    pub iterations: usize,
    /// How often the problem was evaluated.
    pub evaluations: usize,
    /// How often the set of rejected observations was revised.
    pub passes: usize,
    /// The stop reason with its evidence, such as `predicted decrease 3.1e-9 below 1e-6`.
    pub stop: String,
    /// Whether the stop means that the optimum was reached.
    pub converged: bool,
}

/// What a calibration was made from, and with what.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Provenance {
    /// The version of Boresight.
    pub version: String,
    /// Each input file as it was named, with the blake3 hash of its bytes in hexadecimal.
    pub inputs: BTreeMap<String, String>,
    /// The options, as the command line or the job file would state them.
    pub options: BTreeMap<String, String>,
}
