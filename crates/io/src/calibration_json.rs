//! The native `calibration.json`: a calibration to the last bit, but for the residual of each corner.
//!
//! The file alone restores the scene, targets, fits, covariance, rejections, solve record and
//! provenance, bit for bit. Residuals per corner are in `observations.parquet`:
//! [`attach_residuals`](crate::attach_residuals) puts them back.

use boresight_camera::{Camera, Model};
use boresight_data::{
    Calibration, CameraFit, Finding, FrameMotion, IdVec, Motions, Mount, PointId, Regularization, Rejection,
    RejectionReason, Rig, RigCamera, Robot, Scene, Shape, SolveRecord, Stretch, Target, TargetBelief,
    TargetMount, Uncertainty, ViewFit,
};
use boresight_geometry::{Matrix3, Pose, UnitQuaternion, Vector3, Vector6, nalgebra::Quaternion};
use serde::Deserialize;

use crate::calibration_document::{
    CameraDocument, CovarianceDocument, Document, Estimate, FrameDocument, MotionDocument, MotionsDocument,
    MountDocument, Number, Param, Params, PoseDocument, ReasonDocument, RegularizationDocument,
    RejectionDocument, RobotDocument, ShapeDocument, SolveDocument, StretchDocument, TargetDocument,
    TargetMountDocument, TargetSummary, ViewDocument,
};
use crate::format::{NamedCamera, NamedCovariance, OutputFile, calibrated, holds};
use crate::json_text::to_json;
use crate::{Error, Place, geometry_document};

/// The schema of the calibration files that are written and read.
pub const CALIBRATION_SCHEMA: &str = "boresight.calibration/1";

const QUATERNION_TOLERANCE: f64 = 1e-6;

/// Returns the bytes of `calibration.json`: the same for the same calibration and findings.
pub fn calibration_to_json(calibration: &Calibration, findings: &[Finding]) -> Result<Vec<u8>, Error> {
    let Calibration { scene, uncertainty, .. } = calibration;
    same_length("fits of cameras", calibration.cameras.len(), scene.rig.cameras.len())?;
    same_length("beliefs of targets", scene.targets.len(), calibration.targets.len())?;
    same_length("poses of frames", scene.rig_from_target.len(), calibration.frame_names.len())?;
    let n_names = uncertainty.names.len();
    if uncertainty.unavailable.is_none() {
        same_length("covariances", uncertainty.covariance.len(), n_names * n_names)?;
    }
    let sigmas = Sigmas { uncertainty };
    let cameras = scene.rig.cameras.iter().zip(&calibration.cameras);
    let targets = calibration.targets.iter().zip(&scene.targets);
    let frames = calibration.frame_names.iter().zip(&scene.rig_from_target);
    let rows = if uncertainty.covariance.is_empty() {
        Vec::new()
    } else {
        uncertainty.covariance.chunks(n_names.max(1)).map(<[f64]>::to_vec).collect()
    };
    for (i, value) in uncertainty.covariance.iter().enumerate() {
        finite(*value, || format!("covariance.rows[{}][{}]", i / n_names.max(1), i % n_names.max(1)))?;
    }
    let motions = &uncertainty.motions;
    let n_motions = motions.names.len();
    let motion_width = n_names + n_motions;
    same_length("covariances of motions", motions.covariance.len(), n_motions * motion_width)?;
    for (i, value) in motions.covariance.iter().enumerate() {
        finite(*value, || format!("covariance.motions.rows[{}][{}]", i / motion_width, i % motion_width))?;
    }
    if !uncertainty.regularization_information.is_empty() {
        let found = uncertainty.regularization_information.len();
        same_length("weights of the regularisation", found, n_names)?;
    }
    for (i, (.., entry)) in uncertainty.regularization_pairs.iter().enumerate() {
        finite(*entry, || format!("covariance.regularization_pairs[{i}]"))?;
    }
    let document = Document {
        schema: CALIBRATION_SCHEMA.to_owned(),
        rms_px: calibration.rms_px.into(),
        stop: calibration.solve.stop.clone(),
        cameras: cameras
            .map(|(camera, fit)| write_camera(camera.as_ref(), fit, &sigmas))
            .collect::<Result<_, _>>()?,
        target: summarize(calibration, &sigmas),
        targets: targets.map(|(target, belief)| write_target(target, belief)).collect::<Result<_, _>>()?,
        baselines_m: uncertainty
            .baselines_m
            .iter()
            .map(|(name, [value, sigma])| {
                (name.clone(), Estimate { value: (*value).into(), sigma: (*sigma).into() })
            })
            .collect(),
        noise_factor: uncertainty.noise_factor.into(),
        degrees_of_freedom: uncertainty.degrees_of_freedom,
        regularization: RegularizationDocument {
            kind: calibration.regularization.kind.clone(),
            rows: calibration.regularization.rows,
            chi2: calibration.regularization.chi2.into(),
        },
        solve: SolveDocument {
            chi2: calibration.solve.chi2.into(),
            iterations: calibration.solve.iterations,
            evaluations: calibration.solve.evaluations,
            passes: calibration.solve.passes,
            converged: calibration.solve.converged,
        },
        frames: frames
            .enumerate()
            .map(|(i, (name, pose))| {
                let rig_from_target = pose.as_ref().map(|pose| write_pose(pose, name)).transpose()?;
                let motion = scene.motion.as_slice().get(i).copied().flatten();
                let motion = motion.map(|motion| write_motion(&motion, name)).transpose()?;
                Ok(FrameDocument { name: name.clone(), rig_from_target, motion })
            })
            .collect::<Result<_, Error>>()?,
        views: calibration
            .views
            .iter()
            .map(|view| ViewDocument {
                rms_px: view.rms_px.map(Number::from),
                observations: view.residuals_px.len(),
            })
            .collect(),
        rejected: calibration.rejected.iter().map(write_rejection).collect(),
        robot: scene.robot.as_ref().map(write_robot).transpose()?,
        held_out: calibration.held_out.clone(),
        covariance: CovarianceDocument {
            names: uncertainty.names.clone(),
            rows,
            unavailable: uncertainty.unavailable.clone(),
            regularization_information: uncertainty.regularization_information.clone(),
            regularization_pairs: uncertainty.regularization_pairs.clone(),
            motions: MotionsDocument {
                names: motions.names.clone(),
                rows: motions.covariance.chunks(motion_width.max(1)).map(<[f64]>::to_vec).collect(),
            },
            loose: uncertainty.loose.clone(),
        },
        findings: findings.to_vec(),
        provenance: calibration.provenance.clone(),
    };
    Ok(to_json(&document))
}

/// Returns the calibration and the findings in the bytes of a `calibration.json`; `file` is named in errors.
///
/// The residuals of the views are empty.
pub fn calibration_from_json(file: &str, bytes: &[u8]) -> Result<(Calibration, Vec<Finding>), Error> {
    if bytes.trim_ascii().is_empty() {
        return Err(Error::Empty { file: file.to_owned() });
    }
    check_schema(file, bytes)?;
    let document: Document = serde_json::from_slice(bytes).map_err(|error| not_json(file, &error))?;
    let reader = Reader { file };

    let mut cameras = IdVec::default();
    let mut fits = IdVec::default();
    for (i, camera) in document.cameras.into_iter().enumerate() {
        fits.push(CameraFit {
            name: camera.name.clone(),
            rms_px: (&camera.rms_px).into(),
            views: camera.views,
            observations: camera.observations,
            rejected: camera.rejected,
        });
        cameras.push(reader.camera(i, camera)?);
    }
    let mut targets = IdVec::default();
    let mut beliefs = IdVec::default();
    for (i, target) in document.targets.into_iter().enumerate() {
        let (target, belief) = reader.target(i, target)?;
        targets.push(target);
        beliefs.push(belief);
    }
    let mut frame_names = Vec::new();
    let mut rig_from_target = IdVec::default();
    let mut motion = IdVec::default();
    // Where no frame has a motion, there is not even a place for it.
    let has_motion = document.frames.iter().any(|frame| frame.motion.is_some());
    for (i, frame) in document.frames.into_iter().enumerate() {
        let at = || format!("frames[{i}].rig_from_target");
        rig_from_target.push(frame.rig_from_target.map(|pose| reader.pose(&pose, at)).transpose()?);
        if has_motion {
            motion.push(frame.motion.map(|motion| FrameMotion {
                velocity: Vector6::from(motion.velocity_per_s),
                acceleration: Vector6::from(motion.acceleration_per_s2),
            }));
        }
        frame_names.push(frame.name);
    }
    let CovarianceDocument {
        names,
        rows,
        unavailable,
        regularization_information,
        regularization_pairs,
        motions,
        loose,
    } = document.covariance;
    if let Some(i) = regularization_pairs.iter().position(|&(a, b, _)| a >= b || b >= names.len()) {
        let value = format!("{:?}", regularization_pairs[i]);
        let need = "the places of two names, the first before the second, and an entry";
        return Err(reader.bad(format!("covariance.regularization_pairs[{i}]"), value, need));
    }
    let motion_width = names.len() + motions.names.len();
    if motions.rows.len() != motions.names.len() || motions.rows.iter().any(|row| row.len() != motion_width) {
        let value = format!("{} rows", motions.rows.len());
        let need = "a row for each motion, with an entry for each parameter and each motion";
        return Err(reader.bad("covariance.motions.rows".to_owned(), value, need));
    }
    if !regularization_information.is_empty() && regularization_information.len() != names.len() {
        let value = format!("{} numbers", regularization_information.len());
        let need = "a number for each name";
        return Err(reader.bad("covariance.regularization_information".to_owned(), value, need));
    }
    if !rows.is_empty() && (rows.len() != names.len() || rows.iter().any(|row| row.len() != names.len())) {
        let value = format!("{} rows", rows.len());
        return Err(reader.bad(
            "covariance.rows".to_owned(),
            value,
            "a square matrix with a row for each name",
        ));
    }
    let solve = document.solve;
    let calibration = Calibration {
        scene: Scene {
            rig: Rig { cameras },
            robot: document.robot.map(|robot| reader.robot(robot)).transpose()?,
            targets: beliefs,
            rig_from_target,
            motion,
        },
        targets,
        frame_names,
        cameras: fits,
        views: document
            .views
            .iter()
            .map(|view| ViewFit { rms_px: view.rms_px.as_ref().map(f64::from), residuals_px: Vec::new() })
            .collect(),
        rms_px: (&document.rms_px).into(),
        uncertainty: Uncertainty {
            noise_factor: (&document.noise_factor).into(),
            degrees_of_freedom: document.degrees_of_freedom,
            names,
            covariance: rows.concat(),
            unavailable,
            baselines_m: document
                .baselines_m
                .into_iter()
                .map(|(name, estimate)| (name, [(&estimate.value).into(), (&estimate.sigma).into()]))
                .collect(),
            regularization_information,
            regularization_pairs,
            motions: Motions { names: motions.names, covariance: motions.rows.concat() },
            loose,
        },
        rejected: document.rejected.into_iter().map(read_rejection).collect(),
        regularization: Regularization {
            kind: document.regularization.kind,
            rows: document.regularization.rows,
            chi2: (&document.regularization.chi2).into(),
        },
        solve: SolveRecord {
            chi2: (&solve.chi2).into(),
            iterations: solve.iterations,
            evaluations: solve.evaluations,
            passes: solve.passes,
            stop: document.stop,
            converged: solve.converged,
        },
        held_out: document.held_out,
        provenance: document.provenance,
    };
    Ok((calibration, document.findings))
}

/// Tells whether a file is one of ours.
pub(crate) fn recognizes(bytes: &[u8]) -> bool {
    bytes.trim_ascii_start().starts_with(b"{") && holds(bytes, "\"boresight.")
}

/// Returns the cameras of a calibration file that could be calibrated.
pub(crate) fn read_cameras(file: &str, bytes: &[u8]) -> Result<Vec<NamedCamera>, Error> {
    let (calibration, _) = calibration_from_json(file, bytes)?;
    let camera = |(name, RigCamera { camera, cam_from_rig, .. }): (&str, &RigCamera)| NamedCamera {
        name: name.to_owned(),
        camera: camera.clone(),
        cam_from_rig: Some(*cam_from_rig),
        covariance: covariance_of(name, &calibration.uncertainty),
    };
    Ok(calibrated(&calibration).map(camera).collect())
}

/// Returns the calibration as a file.
pub(crate) fn export(calibration: &Calibration) -> Result<Vec<OutputFile>, Error> {
    let bytes = calibration_to_json(calibration, &[])?;
    Ok(vec![OutputFile { name: "calibration.json".to_owned(), bytes }])
}

fn covariance_of(camera: &str, uncertainty: &Uncertainty) -> Option<NamedCovariance> {
    let own =
        |name: &str| name.strip_prefix(camera).and_then(|rest| rest.strip_prefix('.')).map(str::to_owned);
    let (rows, names): (Vec<usize>, Vec<String>) =
        uncertainty.names.iter().enumerate().filter_map(|(i, name)| Some((i, own(name)?))).unzip();
    let n = uncertainty.names.len();
    let value = |i: usize, j: usize| uncertainty.covariance.get(i * n + j).copied();
    let values =
        rows.iter().flat_map(|&i| rows.iter().map(move |&j| value(i, j))).collect::<Option<Vec<f64>>>()?;
    (uncertainty.unavailable.is_none() && !names.is_empty()).then_some(NamedCovariance { names, values })
}

/// Looks sigmas up by the names of parameters.
struct Sigmas<'a> {
    uncertainty: &'a Uncertainty,
}

impl Sigmas<'_> {
    /// Returns the sigma of a parameter, or why there is none.
    fn of(&self, name: &str) -> Result<f64, String> {
        if let Some(why) = &self.uncertainty.unavailable {
            return Err(why.clone());
        }
        let n = self.uncertainty.names.len();
        let Some(i) = self.uncertainty.names.iter().position(|other| other == name) else {
            return Err("not estimated".to_owned());
        };
        let variance = self.uncertainty.covariance.get(i * n + i).copied().unwrap_or(f64::NAN);
        if variance >= 0.0 { Ok(variance.sqrt()) } else { Err(format!("its variance is {variance}")) }
    }

    fn of_all<const N: usize>(&self, names: [String; N]) -> Option<[f64; N]> {
        let sigmas: Vec<f64> = names.iter().map(|name| self.of(name).ok()).collect::<Option<_>>()?;
        sigmas.try_into().ok()
    }
}

fn write_camera(
    camera: Option<&RigCamera>,
    fit: &CameraFit,
    sigmas: &Sigmas<'_>,
) -> Result<CameraDocument, Error> {
    let name = &fit.name;
    let mut document = CameraDocument {
        name: name.clone(),
        model: None,
        image_size: None,
        params: None,
        cam_from_rig: None,
        time_offset_s: None,
        line_delay_s: None,
        rms_px: fit.rms_px.into(),
        views: fit.views,
        observations: fit.observations,
        rejected: fit.rejected,
    };
    let Some(RigCamera { camera, cam_from_rig, time_offset_s, line_delay_s }) = camera else {
        return Ok(document);
    };
    let names = camera.model.param_names();
    same_length("parameters of a camera", camera.params.len(), names.len())?;
    let param = |param: &str, value: f64| {
        finite(value, || format!("{name}.{param}"))?;
        let (sigma, why) = match sigmas.of(&format!("{name}.{param}")) {
            Ok(sigma) => (Some(sigma), None),
            Err(why) => (None, Some(why)),
        };
        Ok::<_, Error>(Param { value, sigma, why })
    };
    let params =
        names.iter().zip(&camera.params).map(|(name, &value)| Ok(((*name).to_owned(), param(name, value)?)));
    document.model = Some(camera.model.to_string());
    document.image_size = Some(camera.image_size);
    document.params = Some(Params(params.collect::<Result<_, Error>>()?));
    let of_pose = |axes: [&str; 3]| sigmas.of_all(axes.map(|axis| format!("{name}.cam_from_rig.{axis}")));
    document.cam_from_rig = Some(PoseDocument {
        rotation_sigma_rad: of_pose(["rx_rad", "ry_rad", "rz_rad"]),
        translation_sigma_m: of_pose(["tx_m", "ty_m", "tz_m"]),
        ..write_pose(cam_from_rig, name)?
    });
    let clock = |name: &str, value: f64| {
        let clock = param(name, value)?;
        Ok::<_, Error>((clock.value != 0.0 || clock.sigma.is_some()).then_some(clock))
    };
    document.time_offset_s = clock("time_offset_s", *time_offset_s)?;
    document.line_delay_s = clock("line_delay_s", *line_delay_s)?;
    Ok(document)
}

fn write_motion(motion: &FrameMotion, of: &str) -> Result<MotionDocument, Error> {
    let FrameMotion { velocity, acceleration } = motion;
    for value in velocity.iter().chain(acceleration) {
        finite(*value, || format!("the motion of {of}"))?;
    }
    Ok(MotionDocument { velocity_per_s: (*velocity).into(), acceleration_per_s2: (*acceleration).into() })
}

fn write_pose(pose: &Pose, of: &str) -> Result<PoseDocument, Error> {
    let rotation = pose.rotation.quaternion();
    let rotation_xyzw = [rotation.i, rotation.j, rotation.k, rotation.w];
    let translation_m: [f64; 3] = pose.translation.into();
    for value in rotation_xyzw.iter().chain(&translation_m) {
        finite(*value, || format!("the pose of {of}"))?;
    }
    Ok(PoseDocument { rotation_xyzw, translation_m, rotation_sigma_rad: None, translation_sigma_m: None })
}

fn summarize(calibration: &Calibration, sigmas: &Sigmas<'_>) -> TargetSummary {
    let Some(target) = calibration.targets.iter().next() else { return TargetSummary::default() };
    let shape = calibration.scene.targets.iter().next().map_or(Vec::new(), |belief| belief.shape_m.clone());
    let sigma = |i: usize| sigmas.of(&format!("target.shape{i}_m")).ok();
    let shape_sigma_m = (0..shape.len()).map(sigma).collect();
    TargetSummary { name: target.name.clone(), shape, shape_sigma_m }
}

fn write_target(target: &Target, belief: &TargetBelief) -> Result<TargetDocument, Error> {
    same_length("coefficients of a shape", belief.shape_m.len(), target.shape.coefficient_count())?;
    for value in &belief.shape_m {
        finite(*value, || format!("the shape of {}", target.name))?;
    }
    let geometry = geometry_document::write(target)?;
    Ok(TargetDocument {
        name: target.name.clone(),
        geometry,
        shape: match target.shape {
            Shape::Rigid => ShapeDocument::Rigid,
            Shape::Parabolic2 => ShapeDocument::Parabolic2,
            Shape::Twisted6 => ShapeDocument::Twisted6,
        },
        shape_m: belief.shape_m.clone(),
        first_from_target: write_pose(&belief.first_from_target, &target.name)?,
    })
}

fn write_rejection(rejection: &Rejection) -> RejectionDocument {
    let reason = match &rejection.reason {
        RejectionReason::Outlier { sigmas, limit } => {
            ReasonDocument::Outlier { sigmas: (*sigmas).into(), limit: (*limit).into() }
        }
        RejectionReason::LeftOut { why } => ReasonDocument::LeftOut { why: why.clone() },
    };
    RejectionDocument { view: rejection.view_idx, point: rejection.point.0, reason }
}

fn read_rejection(document: RejectionDocument) -> Rejection {
    let reason = match document.reason {
        ReasonDocument::Outlier { sigmas, limit } => {
            RejectionReason::Outlier { sigmas: (&sigmas).into(), limit: (&limit).into() }
        }
        ReasonDocument::LeftOut { why } => RejectionReason::LeftOut { why },
    };
    Rejection { view_idx: document.view, point: PointId(document.point), reason }
}

fn write_robot(robot: &Robot) -> Result<RobotDocument, Error> {
    let pose = |pose: &Pose| write_pose(pose, "the robot");
    Ok(RobotDocument {
        mount: match &robot.mount {
            Mount::OnFlange { flange_from_rig } => {
                MountDocument::OnFlange { flange_from_rig: pose(flange_from_rig)? }
            }
            Mount::Fixed { base_from_rig } => MountDocument::Fixed { base_from_rig: pose(base_from_rig)? },
        },
        target_mount: match &robot.target_mount {
            TargetMount::Fixed { base_from_target } => {
                TargetMountDocument::Fixed { base_from_target: pose(base_from_target)? }
            }
            TargetMount::OnFlange { flange_from_target } => {
                TargetMountDocument::OnFlange { flange_from_target: pose(flange_from_target)? }
            }
        },
        tip_in_flange_m: match robot.tip_in_flange {
            Some(tip) => {
                tip.iter().try_for_each(|value| finite(*value, || "the robot's tip".to_owned()))?;
                Some(tip.into())
            }
            None => None,
        },
        stretch: match robot.stretch {
            Some(Stretch { centre_in_base, matrix }) => {
                let numbers = centre_in_base.iter().chain(matrix.iter());
                { numbers }.try_for_each(|value| finite(*value, || "the robot's stretch".to_owned()))?;
                let matrix = [0, 1, 2].map(|row| [0, 1, 2].map(|column| matrix[(row, column)]));
                Some(StretchDocument { centre_in_base_m: centre_in_base.into(), matrix })
            }
            None => None,
        },
    })
}

/// Turns parts of the document into values, naming file and path where one is wrong.
struct Reader<'a> {
    file: &'a str,
}

impl Reader<'_> {
    fn bad(&self, column: String, value: String, need: &str) -> Error {
        Error::BadValue { place: Place::file(self.file), column, value, need: need.to_owned() }
    }

    fn camera(&self, i: usize, document: CameraDocument) -> Result<Option<RigCamera>, Error> {
        let CameraDocument {
            name, model, image_size, params, cam_from_rig, time_offset_s, line_delay_s, ..
        } = document;
        let (Some(model), Some(image_size), Some(Params(params)), Some(pose)) =
            (model, image_size, params, cam_from_rig)
        else {
            return Ok(None);
        };
        let lens = |source| Error::Lens {
            place: Place::file(self.file),
            camera: name.clone(),
            source: Box::new(source),
        };
        let model: Model = model.parse().map_err(lens)?;
        let names = model.param_names();
        if let Some((other, _)) = params.iter().find(|(param, _)| !names.contains(&param.as_str())) {
            let need = format!("lens model {model} has the parameters {}", names.join(", "));
            return Err(self.bad(format!("cameras[{i}].params"), other.clone(), &need));
        }
        let value = |param: &&str| {
            params.iter().find(|(other, _)| other == param).map(|(_, param)| param.value).ok_or_else(|| {
                let need = format!("lens model {model} has this parameter");
                self.bad(format!("cameras[{i}].params.{param}"), "missing".to_owned(), &need)
            })
        };
        let values = names.iter().map(value).collect::<Result<Vec<f64>, Error>>()?;
        let camera = Camera::new(model, values, image_size).map_err(lens)?;
        let cam_from_rig = self.pose(&pose, || format!("cameras[{i}].cam_from_rig"))?;
        Ok(Some(RigCamera {
            camera,
            cam_from_rig,
            time_offset_s: time_offset_s.map_or(0.0, |late| late.value),
            line_delay_s: line_delay_s.map_or(0.0, |delay| delay.value),
        }))
    }

    fn pose(&self, pose: &PoseDocument, at: impl Fn() -> String) -> Result<Pose, Error> {
        let [x, y, z, w] = pose.rotation_xyzw;
        let rotation = Quaternion::new(w, x, y, z);
        let excess = (rotation.norm() - 1.0).abs();
        if excess.is_nan() || excess > QUATERNION_TOLERANCE {
            let value = format!("{:?}", pose.rotation_xyzw);
            return Err(self.bad(format!("{}.rotation_xyzw", at()), value, "a unit quaternion is needed"));
        }
        // Not normalised anew: that could change the last bit.
        Ok(Pose::new(UnitQuaternion::new_unchecked(rotation), Vector3::from(pose.translation_m)))
    }

    fn target(&self, i: usize, document: TargetDocument) -> Result<(Target, TargetBelief), Error> {
        let geometry = geometry_document::read(document.geometry)
            .map_err(|(value, need)| self.bad(format!("targets[{i}].geometry"), value, need))?;
        let shape = match document.shape {
            ShapeDocument::Rigid => Shape::Rigid,
            ShapeDocument::Parabolic2 => Shape::Parabolic2,
            ShapeDocument::Twisted6 => Shape::Twisted6,
        };
        let (n, need) = (document.shape_m.len(), shape.coefficient_count());
        if n != need {
            let need = format!("{need} coefficients, as its shape has");
            return Err(self.bad(format!("targets[{i}].shape_m"), format!("{n} numbers"), &need));
        }
        let first_from_target =
            self.pose(&document.first_from_target, || format!("targets[{i}].first_from_target"))?;
        let belief = TargetBelief { shape_m: document.shape_m, first_from_target };
        Ok((Target { name: document.name, geometry, shape }, belief))
    }

    fn robot(&self, document: RobotDocument) -> Result<Robot, Error> {
        let pose = |pose: PoseDocument, name: &str| self.pose(&pose, || format!("robot.{name}"));
        Ok(Robot {
            mount: match document.mount {
                MountDocument::OnFlange { flange_from_rig } => Mount::OnFlange {
                    flange_from_rig: pose(flange_from_rig, "mount.on_flange.flange_from_rig")?,
                },
                MountDocument::Fixed { base_from_rig } => {
                    Mount::Fixed { base_from_rig: pose(base_from_rig, "mount.fixed.base_from_rig")? }
                }
            },
            target_mount: match document.target_mount {
                TargetMountDocument::Fixed { base_from_target } => TargetMount::Fixed {
                    base_from_target: pose(base_from_target, "target_mount.fixed.base_from_target")?,
                },
                TargetMountDocument::OnFlange { flange_from_target } => TargetMount::OnFlange {
                    flange_from_target: pose(
                        flange_from_target,
                        "target_mount.on_flange.flange_from_target",
                    )?,
                },
            },
            tip_in_flange: document.tip_in_flange_m.map(Vector3::from),
            stretch: document.stretch.map(|stretch| Stretch {
                centre_in_base: Vector3::from(stretch.centre_in_base_m),
                matrix: Matrix3::from_fn(|row, column| stretch.matrix[row][column]),
            }),
        })
    }
}

fn check_schema(file: &str, bytes: &[u8]) -> Result<(), Error> {
    #[derive(Deserialize)]
    struct Head {
        schema: Option<String>,
    }
    let head: Head = serde_json::from_slice(bytes).map_err(|error| not_json(file, &error))?;
    match head.schema {
        Some(schema) if schema == CALIBRATION_SCHEMA => Ok(()),
        Some(found) if found.starts_with("boresight.calibration/") => {
            Err(Error::Schema { file: file.to_owned(), found, reads: CALIBRATION_SCHEMA })
        }
        found => Err(Error::BadValue {
            place: Place::file(file),
            column: "schema".to_owned(),
            value: found.unwrap_or_else(|| "missing".to_owned()),
            need: format!("a calibration has the schema {CALIBRATION_SCHEMA}"),
        }),
    }
}

fn not_json(file: &str, error: &serde_json::Error) -> Error {
    let place = Place::line(file, error.line());
    Error::Malformed { place, found: error.to_string(), need: "a calibration.json of Boresight is needed" }
}

fn same_length(what: &'static str, found: usize, need: usize) -> Result<(), Error> {
    if found == need { Ok(()) } else { Err(Error::Inconsistent { what, found, need }) }
}

fn finite(value: f64, at: impl Fn() -> String) -> Result<(), Error> {
    if value.is_finite() { Ok(()) } else { Err(Error::NotFinite { at: at(), value }) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::samples::sample;

    fn without_residuals(mut calibration: Calibration) -> Calibration {
        calibration.views.iter_mut().for_each(|view| view.residuals_px.clear());
        calibration
    }

    #[test]
    fn a_calibration_survives_to_the_last_bit() {
        let calibration = sample();
        let findings = vec![Finding {
            code: "few-views".to_owned(),
            severity: boresight_data::Severity::Caution,
            place: "left".to_owned(),
            message: "few".to_owned(),
            measured: Some(3.0),
            limit: None,
            fix: "more".to_owned(),
        }];
        let bytes = calibration_to_json(&calibration, &findings).unwrap();
        let (again, findings_again) = calibration_from_json("c.json", &bytes).unwrap();
        assert_eq!(again, without_residuals(calibration));
        assert_eq!(findings_again, findings);
        let mut second = again;
        second.views.iter_mut().zip(sample().views).for_each(|(view, with)| *view = with);
        assert_eq!(calibration_to_json(&second, &findings).unwrap(), bytes);
    }

    #[test]
    fn the_required_keys_are_there() {
        let json: serde_json::Value =
            serde_json::from_slice(&calibration_to_json(&sample(), &[]).unwrap()).unwrap();
        assert_eq!(json["schema"], "boresight.calibration/1");
        let left = &json["cameras"][0];
        assert_eq!(left["params"]["fx"]["sigma"], 0.5);
        assert_eq!(left["params"]["fy"]["sigma"], serde_json::Value::Null);
        assert_eq!(left["params"]["fy"]["why"], "not estimated");
        for key in [
            "name",
            "model",
            "image_size",
            "params",
            "cam_from_rig",
            "rms_px",
            "views",
            "observations",
            "rejected",
        ] {
            assert!(left.get(key).is_some(), "{key}");
        }
        assert!(
            left["cam_from_rig"]["rotation_xyzw"].is_array()
                && left["cam_from_rig"]["translation_m"].is_array()
        );
        assert_eq!(json["target"]["shape"][0], 1e-4);
        for key in ["rms_px", "stop", "provenance"] {
            assert!(json.get(key).is_some(), "{key}");
        }
    }

    #[test]
    fn every_shape_survives_with_as_many_coefficients_as_it_has() {
        let mut calibration = sample();
        calibration.views.iter_mut().for_each(|view| view.residuals_px.clear());
        for shape in Shape::ALL {
            let n = shape.coefficient_count();
            calibration.targets.iter_mut().next().unwrap().shape = shape;
            let shape_m = (0..n).map(|j| 1e-4 / (1.0 + j as f64)).collect();
            calibration.scene.targets.iter_mut().next().unwrap().shape_m = shape_m;
            let bytes = calibration_to_json(&calibration, &[]).unwrap();
            assert_eq!(calibration_from_json("c", &bytes).unwrap().0, calibration);
            let mut document: serde_json::Value = serde_json::from_slice(&bytes).unwrap();
            document["targets"][0]["shape_m"].as_array_mut().unwrap().push(1e-3.into());
            let bytes = serde_json::to_vec(&document).unwrap();
            let error = calibration_from_json("c", &bytes).unwrap_err().to_string();
            assert!(
                error.contains(&format!("{n} coefficients")) && error.contains("targets[0].shape_m"),
                "{error}"
            );
            calibration.scene.targets.iter_mut().next().unwrap().shape_m.push(1e-3);
            let refused = calibration_to_json(&calibration, &[]).unwrap_err().to_string();
            assert!(refused.contains("coefficients of a shape"), "{refused}");
        }
    }

    #[test]
    fn numbers_that_are_none_are_null_with_a_reason_or_refused() {
        let mut calibration = sample();
        calibration.rms_px = f64::NEG_INFINITY;
        let bytes = calibration_to_json(&calibration, &[]).unwrap();
        assert!(String::from_utf8_lossy(&bytes).contains("\"reason\": \"-inf\""));
        assert_eq!(calibration_from_json("c", &bytes).unwrap().0.rms_px, f64::NEG_INFINITY);
        calibration.scene.targets.iter_mut().next().unwrap().shape_m[0] = f64::NAN;
        assert!(matches!(calibration_to_json(&calibration, &[]), Err(Error::NotFinite { .. })));
    }

    #[test]
    fn what_is_wrong_is_said_with_its_path() {
        let good = String::from_utf8(calibration_to_json(&sample(), &[]).unwrap()).unwrap();
        let refuses = |text: &str, part: &str| {
            let error = calibration_from_json("c.json", text.as_bytes()).unwrap_err().to_string();
            assert!(error.starts_with("c.json") && error.contains(part), "`{part}` is not in: {error}");
        };
        refuses("", "empty");
        refuses(&good[..good.len() / 2], "line");
        refuses("{}", "schema is `missing`");
        refuses(
            &good.replace("calibration/1", "calibration/2"),
            "calibration/2; Boresight 0.1.0 reads boresight.calibration/1",
        );
        refuses(&good.replace("calibration/1", "else/1").replace("boresight.", ""), "schema is `else/1`");
        refuses(&good.replace("\"opencv5\"", "\"opencv6\""), "no lens model `opencv6`");
        refuses(&good.replace("\"k1\"", "\"kk\""), "cameras[0].params is `kk`");
        refuses(
            &good.replace(
                "\"rotation_xyzw\": [0.0, 0.0, 0.0, 1.0]",
                "\"rotation_xyzw\": [0.0, 0.0, 0.0, 2.0]",
            ),
            "unit quaternion",
        );
        refuses(&good.replace("\"rms_px\": ", "\"rms\": "), "missing field `rms_px`");
    }
}
