//! From the last solution to a calibration: residuals, sigmas, what was left out.

use std::collections::BTreeMap;

use boresight_data::{
    Calibration, CameraFit, CameraId, Dataset, Id, Motions, Mounting, Provenance, RejectionReason, Scene,
    SolveRecord, TargetId, Uncertainty, ViewFit,
};
use boresight_solver::{BlockId, Covariance, Solution, SolveOptions, Stop, Term, covariance};

use crate::chain::{CLOCK_COLUMN, LINE_DELAY_COLUMN};
use crate::error::Error;
use crate::loose::{in_words, loose_directions};
use crate::motions::motions;
use crate::options::{AdjustOptions, Regularization};
use crate::rig_problem::RigProblem;

/// What the passes came to.
#[derive(Debug, Default)]
pub(crate) struct Outcome {
    pub stop: Option<Stop>,
    pub iterations: usize,
    pub evaluations: usize,
    pub passes: usize,
    pub cost: f64,
    /// Whether the last pass left the set of outliers as it was.
    pub settled: bool,
    /// For each view of the problem, which observations are kept; `None` keeps all.
    pub kept: Option<Vec<Vec<bool>>>,
    /// The views that were left out as a whole, each with the reason.
    pub left_out: BTreeMap<usize, String>,
    /// For each camera, the length in sigmas beyond which a residual is an outlier.
    pub limits_sigmas: Vec<f64>,
}

impl Outcome {
    pub(crate) fn add(&mut self, solution: &Solution) {
        self.stop = Some(solution.stop);
        self.iterations += solution.counters.iterations;
        self.evaluations += solution.counters.evaluations;
        self.passes += 1;
        self.cost = solution.cost;
    }

    /// Returns how the search went, with the cost that it led to.
    pub(crate) fn record(&self, chi2: f64) -> SolveRecord {
        let stop = self.stop.unwrap_or(Stop::NotStarted);
        // Where it ended is an optimum, but of a set of outliers that may not be the one it asks for.
        let is_open = stop.is_converged() && self.kept.is_some() && !self.settled;
        let open = if is_open { "; which corners are outliers still changes from pass to pass" } else { "" };
        SolveRecord {
            chi2,
            iterations: self.iterations,
            evaluations: self.evaluations,
            passes: self.passes,
            stop: format!("{stop}{open}"),
            converged: stop.is_converged(),
        }
    }
}

/// Returns the calibration that the rig's values amount to.
pub(crate) fn report(
    dataset: &Dataset,
    seed: &Scene,
    rig: &RigProblem,
    outcome: Outcome,
    options: &AdjustOptions,
) -> Result<Calibration, Error> {
    let values = rig.parameters.values();
    let scene = rig.scene(dataset, seed, values);
    let mut cameras: boresight_data::IdVec<CameraId, CameraFit> = dataset
        .cameras
        .iter()
        .map(|info| CameraFit { name: info.name.clone(), ..CameraFit::default() })
        .collect();
    let mut views = vec![ViewFit::default(); dataset.views.len()];
    let mut rejected = Vec::new();
    let mut sums = vec![0.0; dataset.cameras.len()];
    let mut takes_part = vec![false; dataset.views.len()];
    for (term_idx, (view_idx, term)) in rig.views.iter().enumerate() {
        let view = &dataset.views[*view_idx];
        takes_part[*view_idx] = true;
        let camera = &mut cameras[view.camera];
        camera.views += 1;
        let (mut sum, mut n_kept) = (0.0, 0);
        let mut residuals_px = Vec::with_capacity(view.observations.len());
        for (idx, (prediction, observation)) in
            term.predict(values).into_iter().zip(&view.observations).enumerate()
        {
            let residual = prediction
                .map_or([f64::INFINITY; 2], |[u, v]| [u - observation.pixel[0], v - observation.pixel[1]]);
            residuals_px.push(residual);
            let square = residual[0] * residual[0] + residual[1] * residual[1];
            if outcome.kept.as_ref().is_none_or(|kept| kept[term_idx][idx]) {
                sum += square;
                n_kept += 1;
            } else {
                let reason = RejectionReason::Outlier {
                    sigmas: square.sqrt() / observation.sigma_px,
                    limit: outcome.limits_sigmas[view.camera.index()],
                };
                rejected.push(boresight_data::Rejection {
                    view_idx: *view_idx,
                    point: observation.point,
                    reason,
                });
                camera.rejected += 1;
            }
        }
        camera.observations += n_kept;
        sums[view.camera.index()] += sum;
        let rms_px = (n_kept > 0).then(|| (sum / n_kept as f64).sqrt());
        views[*view_idx] = ViewFit { rms_px, residuals_px };
    }
    let n_kept: usize = cameras.iter().map(|camera| camera.observations).sum();
    let rms = |sum: f64, n: usize| if n > 0 { (sum / n as f64).sqrt() } else { 0.0 };
    let rms_px = rms(sums.iter().sum(), n_kept);
    for (camera, sum) in cameras.iter_mut().zip(&sums) {
        camera.rms_px = rms(*sum, camera.observations);
    }
    for (view_idx, view) in dataset.views.iter().enumerate().filter(|(view_idx, _)| !takes_part[*view_idx]) {
        let why = match (&scene.rig.cameras[view.camera], outcome.left_out.get(&view_idx)) {
            (_, Some(why)) => why.as_str(),
            (None, _) => "its camera could not be calibrated",
            (Some(_), _) => "the target's pose in its frame could not be found",
        };
        cameras[view.camera].rejected += view.observations.len();
        rejected.extend(view.observations.iter().map(|observation| boresight_data::Rejection {
            view_idx,
            point: observation.point,
            reason: RejectionReason::LeftOut { why: why.to_owned() },
        }));
    }
    let (uncertainty, costs) = uncertainty(dataset, rig, options)?;
    let regularization = boresight_data::Regularization {
        kind: match options.regularization {
            Regularization::None => "none",
            Regularization::Default => "default",
            Regularization::Mrcal22 => "mrcal-2.2",
        }
        .to_owned(),
        rows: rig.priors.iter().map(Term::row_count).sum::<usize>()
            + rig.sparse_priors.iter().map(Term::row_count).sum::<usize>(),
        chi2: rig.regularization_cost(),
    };
    Ok(Calibration {
        scene,
        targets: dataset.targets.clone(),
        frame_names: dataset.frames.iter().map(|frame| frame.name.clone()).collect(),
        cameras,
        views,
        rms_px,
        uncertainty,
        rejected,
        regularization,
        solve: outcome.record(costs.map_or(outcome.cost, |[observations, priors]| observations + priors)),
        held_out: None,
        provenance: Provenance::default(),
    })
}

/// Returns how well the parameters are known, and the costs of observations and priors.
fn uncertainty(
    dataset: &Dataset,
    rig: &RigProblem,
    options: &AdjustOptions,
) -> Result<(Uncertainty, Option<[f64; 2]>), Error> {
    let problem = rig.problem()?;
    let n_rows = problem.observation_rows();
    let degrees_of_freedom = n_rows.saturating_sub(rig.parameters.free_count());
    let solve_options = SolveOptions { threads: options.threads, ..SolveOptions::default() };
    let columns = columns(dataset, rig);
    let unavailable = |why: String| Uncertainty {
        noise_factor: 1.0,
        degrees_of_freedom,
        unavailable: Some(why),
        ..Uncertainty::default()
    };
    let covariance = match covariance(&problem, rig.parameters.values().as_slice(), &solve_options) {
        Ok(covariance) => covariance,
        Err(boresight_solver::Error::Singular { reciprocal_condition, limit, columns: loosest }) => {
            let names: Vec<String> = loosest
                .iter()
                .filter_map(|(column, _)| {
                    let place = Covariance::column_of(&problem, *column)?;
                    columns.iter().find(|(_, known)| *known == place).map(|(name, _)| name.clone())
                })
                .collect();
            let names: Vec<&str> = names.iter().map(String::as_str).collect();
            let why = format!(
                "the data do not constrain {}: reciprocal condition {reciprocal_condition:.1e} is below {limit:.1e}; {}",
                if names.is_empty() { "the parameters".to_owned() } else { names.join(", ") },
                in_words(&names)
            );
            return Ok((unavailable(why), None));
        }
        Err(boresight_solver::Error::LooseBlock { block }) => {
            let blocks = rig.frames.enumerate().chain(rig.robot.arms.enumerate());
            let frame = { blocks }.find(|(_, frame)| **frame == Some(block));
            let place = frame.map_or("a pose".to_owned(), |(id, _)| {
                format!("the pose of frame {}", dataset.frames[id].name)
            });
            return Ok((unavailable(format!("the data do not constrain {place}")), None));
        }
        Err(error) => return Err(error.into()),
    };
    let costs = [covariance.observation_cost, covariance.prior_cost];
    if degrees_of_freedom == 0 {
        return Ok((unavailable("there are no more equations than unknowns".to_owned()), Some(costs)));
    }
    let variance_factor = costs[0] / degrees_of_freedom as f64;
    let free: Vec<&(String, (BlockId, usize))> =
        columns.iter().filter(|(_, (block, column))| !rig.parameters.is_held(*block, *column)).collect();
    let places: Vec<(BlockId, usize)> = free.iter().map(|(_, place)| *place).collect();
    let names: Vec<String> = free.iter().map(|(name, _)| name.clone()).collect();
    let scaled = |entry: f64| variance_factor * entry;
    let mut entries = Vec::with_capacity(free.len() * free.len());
    for a in &places {
        entries.extend(places.iter().map(|b| scaled(covariance.between(*a, *b))));
    }
    let n = names.len();
    let bad = (0..n).find(|i| !(entries[i * (n + 1)] > 0.0 && entries[i * (n + 1)].is_finite()));
    if let Some(bad) = bad {
        let why = format!("the variance of {} came out as {:e}", names[bad], entries[bad * (n + 1)]);
        return Ok((unavailable(why), Some(costs)));
    }
    let (motion_names, functions) = motions(dataset, rig, rig.parameters.values());
    let motion_entries = covariance.of_functions(&functions, &places).into_iter().map(scaled).collect();
    // Relative to the noise, as the covariance of the solver is.
    let information: Vec<f64> =
        places.iter().map(|&place| covariance.information(place).unwrap_or(0.0) / variance_factor).collect();
    let (regularization_information, regularization_pairs) = regularization_information(rig, &places);
    let mut uncertainty = Uncertainty {
        noise_factor: variance_factor.sqrt(),
        degrees_of_freedom,
        loose: loose_directions(&names, &entries, &information),
        regularization_information,
        regularization_pairs,
        motions: Motions { names: motion_names, covariance: motion_entries },
        names,
        covariance: entries,
        unavailable: None,
        baselines_m: BTreeMap::new(),
    };
    uncertainty.baselines_m = baselines(dataset, rig, &uncertainty);
    Ok((uncertainty, Some(costs)))
}

/// Returns the inverse square of each column's sigma in the regularisation, zero where it has none, and what it claims
/// of two columns together.
fn regularization_information(
    rig: &RigProblem,
    places: &[(BlockId, usize)],
) -> (Vec<f64>, Vec<(usize, usize, f64)>) {
    let by_place: BTreeMap<(BlockId, usize), usize> =
        places.iter().enumerate().map(|(i, &place)| (place, i)).collect();
    let information = |(i, place): (usize, &(BlockId, usize))| -> f64 {
        // A lens that cameras share has several names for each parameter, and counts at the last of them alone.
        if by_place.get(place) != Some(&i) {
            return 0.0;
        }
        let (block, column) = *place;
        rig.priors.iter().map(|prior| prior.information(block, column)).sum()
    };
    let mut single: Vec<f64> = places.iter().enumerate().map(information).collect();
    let mut pairs = Vec::new();
    for prior in &rig.sparse_priors {
        let [block] = *prior.blocks() else { continue };
        for ([a, b], entry) in prior.information() {
            match (by_place.get(&(block, a)), by_place.get(&(block, b))) {
                (Some(&a), Some(&b)) if a == b => single[a] += entry,
                (Some(&a), Some(&b)) => pairs.push((a.min(b), a.max(b), entry)),
                // What is held does not vary.
                _ => {}
            }
        }
    }
    (single, pairs)
}

/// Returns the names of all parameters but the frames' poses, each with its block and column.
fn columns(dataset: &Dataset, rig: &RigProblem) -> Vec<(String, (BlockId, usize))> {
    const POSE_COLUMNS: [&str; 6] = ["rx_rad", "ry_rad", "rz_rad", "tx_m", "ty_m", "tz_m"];
    let mut columns = Vec::new();
    for (camera_id, blocks) in rig.cameras.enumerate() {
        let Some(blocks) = blocks else { continue };
        let camera = &dataset.cameras[camera_id].name;
        for (i, name) in rig.lens_names(camera_id).iter().enumerate() {
            columns.push((format!("{camera}.{name}"), (blocks.lens, i)));
        }
        for (k, name) in POSE_COLUMNS.iter().enumerate() {
            columns.push((format!("{camera}.cam_from_rig.{name}"), (blocks.cam_from_rig, k)));
        }
        let clock =
            |name: &str, column: usize| blocks.late.map(|late| (format!("{camera}.{name}"), (late, column)));
        columns.extend(clock("time_offset_s", CLOCK_COLUMN));
        columns.extend(clock("line_delay_s", LINE_DELAY_COLUMN));
    }
    for (target_id, blocks) in rig.targets.enumerate() {
        let target: &str = target_name(dataset, target_id);
        if let Some(shape) = blocks.shape {
            for j in 0..dataset.targets[target_id].shape.coefficient_count() {
                columns.push((format!("{target}.shape{j}_m"), (shape, j)));
            }
        }
        if let Some(pose) = blocks.first_from_target {
            for (k, name) in POSE_COLUMNS.iter().enumerate() {
                columns.push((format!("{target}.first_from_target.{name}"), (pose, k)));
            }
        }
    }
    if let Some(robot) = rig.robot.blocks {
        let (rig_pose, target_pose) = match robot.mounting {
            Mounting::RigOnFlange => ("flange_from_rig", "base_from_target"),
            Mounting::RigInBase => ("base_from_rig", "flange_from_target"),
        };
        for (pose, block) in [(rig_pose, robot.carrier_from_rig), (target_pose, robot.other_from_first)] {
            columns.extend(
                POSE_COLUMNS.iter().enumerate().map(|(k, name)| (format!("robot.{pose}.{name}"), (block, k))),
            );
        }
        let bearer = match robot.mounting {
            Mounting::RigOnFlange => "flange",
            Mounting::RigInBase => "base",
        };
        if let Some(tip) = rig.robot.tip {
            let axes = ["x_m", "y_m", "z_m"];
            columns.extend(
                axes.iter().enumerate().map(|(k, name)| (format!("robot.tip_in_{bearer}.{name}"), (tip, k))),
            );
        }
    }
    columns
}

fn target_name(dataset: &Dataset, target: TargetId) -> &str {
    &dataset.targets[target].name
}

/// Returns the distance of each camera's centre from the rig's origin, with its sigma.
fn baselines(dataset: &Dataset, rig: &RigProblem, uncertainty: &Uncertainty) -> BTreeMap<String, [f64; 2]> {
    let mut baselines = BTreeMap::new();
    for (camera_id, blocks) in rig.cameras.enumerate() {
        let Some(blocks) = blocks.filter(|blocks| !blocks.is_reference) else { continue };
        let translation_m = rig.parameters.values().pose(blocks.cam_from_rig).translation;
        let name = &dataset.cameras[camera_id].name;
        if let Some(sigma_m) = uncertainty.baseline_sigma_m(name, &translation_m) {
            baselines.insert(name.clone(), [translation_m.norm(), sigma_m]);
        }
    }
    baselines
}
