//! A scene, how well it is known, and what it came from.

use std::collections::BTreeMap;

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
    /// What the calibration was made from, and with what.
    pub provenance: Provenance,
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
    pub baselines_m: BTreeMap<String, [f64; 2]>,
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
