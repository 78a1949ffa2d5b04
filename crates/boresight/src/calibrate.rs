//! From a job to a judged calibration.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use boresight_adjust::{AdjustOptions, Hold, Observer, adjust};
use boresight_camera::{Camera, Model, ParamGroup};
use boresight_data::{
    Calibration, CameraId, Dataset, Finding, Geometry, Id as _, Provenance, RejectionReason, Shape,
};
use boresight_io::Job;
use boresight_seed::{LeftOut, SeedOptions, seed};
use boresight_validate::{Verdict, verdict};

use crate::VERSION;
use crate::beliefs::{Beliefs, Earlier};
use crate::choices::{LensModel, RegularizationChoice, ShapeChoice};
use crate::error::Error;
use crate::held_out::held_out;
use crate::lens_choice::{LensSelection, choose_lens};
use crate::options::CalibrateOptions;
use crate::select::select_cameras;
use crate::shape_choice::{ShapeSelection, choose_shape};
use crate::shared_lens::{Group, apart, groups, sharers, spread, spread_stated};
use crate::time_offset;
use crate::trial::Terms;

/// Who follows a calibration while it runs, and may stop it.
#[derive(Clone, Default)]
pub struct Watch {
    /// Hears of each iteration.
    pub observer: Option<Observer>,
    /// Stops the solve when it becomes true; a choice of lens or shape then ends as [`Error::Cancelled`].
    pub cancel: Option<Arc<AtomicBool>>,
}

impl Watch {
    /// Returns an error if the work was stopped.
    fn check(&self) -> Result<(), Error> {
        let is_cancelled = self.cancel.as_ref().is_some_and(|cancel| cancel.load(Ordering::Relaxed));
        if is_cancelled { Err(Error::Cancelled) } else { Ok(()) }
    }
}

/// What a job came to.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// The calibration, its provenance filled in.
    pub calibration: Calibration,
    /// What it was made from: the cameras and the target shape that the options chose.
    pub dataset: Dataset,
    /// What is doubtful about input and result, the gravest first.
    pub findings: Vec<Finding>,
    /// The findings in one word.
    pub verdict: Verdict,
    /// What the seed could not use and why, a sentence each.
    pub left_out: Vec<String>,
    /// The lens models that were chosen, and why.
    pub lenses: Vec<LensSelection>,
    /// Which shape of the target helped, where that was asked.
    pub shape: Option<ShapeSelection>,
    /// How it was adjusted: with the lenses that the job states, the holds, priors and shared lenses that the options
    /// came to. Whoever adjusts the dataset again begins with these.
    pub adjust: AdjustOptions,
}

/// Calibrates a job: chooses cameras and target shape, seeds, adjusts and judges.
///
/// Not converging is no error: the calibration's solve record tells, a finding says so, and the
/// verdict is [`Verdict::Fail`].
pub fn calibrate(job: &Job, options: &CalibrateOptions, watch: &Watch) -> Result<Outcome, Error> {
    let mut dataset = select_cameras(&job.dataset, &options.cameras)?;
    options.model.check_names(&dataset)?;
    options.line_delay.check_names(&dataset)?;
    let shapes = shapes(options)?;
    let usual = match options.shape {
        ShapeChoice::Given(shape) => shape,
        ShapeChoice::Auto => Shape::Parabolic2,
    };
    set_shape(&mut dataset, usual);
    let groups = groups(&dataset, &options.share_lens)?;
    let mut stated = known_lenses(job, &dataset);
    spread_stated(&dataset, &groups, &mut stated)?;
    let earlier = options.prior.as_deref().map(Earlier::read).transpose()?;
    let mut known = stated.clone();
    if let Some(earlier) = &earlier {
        let lenses = earlier.lenses(&dataset)?;
        known.extend(lenses.into_iter().filter(|(id, _)| !stated.iter().any(|(other, _)| other == id)));
        spread(&groups, &mut known);
    }
    let terms = Terms { options, cancel: watch.cancel.as_ref() };
    let chosen = with_threads(options.jobs, || lens_models(&dataset, &known, &groups, terms));
    watch.check()?;
    let (models, lenses) = chosen?;
    let may_bend = dataset.targets.iter().any(|target| target.shape != Shape::Rigid);
    let shape = (options.shape == ShapeChoice::Auto && may_bend)
        .then(|| with_threads(options.jobs, || choose_shape(&dataset, shapes, &models, &known, terms)));
    watch.check()?;
    if let Some(selection) = &shape {
        set_shape(&mut dataset, selection.shape);
    }
    let holds = stated.iter().map(|(camera, _)| Hold::Lens(*camera)).collect();
    let seed_options = SeedOptions { models, known, ..SeedOptions::default() };
    let mut seed = seed(&dataset, &seed_options)?;
    let mut adjust_options = AdjustOptions { holds, ..options.adjust_options(&dataset) };
    let beliefs = Beliefs { options, earlier: earlier.as_ref(), stated: &stated, groups: &groups };
    beliefs.apply(&dataset, &mut seed.scene, &mut adjust_options)?;
    adjust_options.cancel = watch.cancel.clone();
    options.line_delay.apply(&dataset, &mut seed.scene);
    let mut calibration = adjust(&dataset, &seed.scene, &adjust_options, watch.observer.clone())?;
    let choices = (options.time_offset, &options.line_delay);
    let times = time_offset::look(&dataset, &seed.scene, &calibration, choices, &adjust_options)?;
    if let Some(timed) = times.calibration {
        calibration = timed;
        adjust_options.clocks = times.clocks;
    }
    say_why(&mut calibration, &dataset, &seed.left_out);
    if calibration.solve.converged && calibration.uncertainty.unavailable.is_none() {
        calibration.held_out = with_threads(options.jobs, || {
            held_out(&dataset, &calibration, &adjust_options, options.holdout)
        })?;
    }
    calibration.provenance = Provenance {
        version: VERSION.to_owned(),
        inputs: job.inputs.iter().cloned().collect(),
        options: options.stated(),
    };
    for selection in &lenses {
        let key = format!("model.{}", selection.camera);
        calibration.provenance.options.insert(key, selection.why.clone());
    }
    if let Some(shape) = &shape {
        calibration.provenance.options.insert("shape.auto".to_owned(), shape.why.clone());
    }
    let mut findings = boresight_validate::findings(&dataset, &calibration);
    findings
        .extend(job.findings.iter().filter(|finding| !is_of_other_camera(finding, job, &dataset)).cloned());
    findings.extend(times.findings);
    findings.sort_by_key(|finding| std::cmp::Reverse(finding.severity));
    let left_out = seed.left_out.iter().map(|fact| fact.describe(&dataset)).collect();
    let (verdict, adjust) = (verdict(&findings), AdjustOptions { cancel: None, ..adjust_options });
    Ok(Outcome { calibration, verdict, dataset, findings, left_out, lenses, shape, adjust })
}

/// Returns the shapes that targets may have, or an error if the options ask for another.
fn shapes(options: &CalibrateOptions) -> Result<&'static [Shape], Error> {
    let is_mrcals = options.regularization == RegularizationChoice::Mrcal22;
    let shapes = if is_mrcals { &Shape::ALL[..2] } else { &Shape::ALL[..] };
    match options.shape {
        ShapeChoice::Given(shape) if !shapes.contains(&shape) => {
            Err(Error::ShapeNotMrcals { coefficients: shape.coefficient_count() })
        }
        _ => Ok(shapes),
    }
}

/// Gives a shape to all targets that are grids.
pub(crate) fn set_shape(dataset: &mut Dataset, shape: Shape) {
    for target in dataset.targets.iter_mut() {
        target.shape = match target.geometry {
            Geometry::Points { .. } => Shape::Rigid,
            _ => shape,
        };
    }
}

/// Returns the lens model of each camera, and why for those that were chosen.
fn lens_models(
    dataset: &Dataset,
    known: &[(CameraId, Camera)],
    groups: &[Group],
    terms: Terms<'_>,
) -> Result<(Vec<Model>, Vec<LensSelection>), Error> {
    let options = terms.options;
    let asked = |id: CameraId| match known.iter().find(|(known, _)| *known == id) {
        Some((_, lens)) => LensModel::Given(lens.model),
        None => options.model.of(&dataset.cameras[id].name),
    };
    // A lens that is shared has one model: that which is given for any of its cameras.
    let given = |id: CameraId| match asked(id) {
        LensModel::Given(model) => Some((id, model)),
        LensModel::Auto => None,
    };
    for group in groups {
        let mut given = group.iter().filter_map(|id| given(*id));
        if let Some((first, model)) = given.next()
            && let Some((other, other_model)) = given.find(|(_, other)| *other != model)
        {
            let why = format!("it is {model} for one and {other_model} for the other");
            return Err(apart(dataset, [first, other], why));
        }
    }
    let (mut models, mut lenses): (Vec<Model>, Vec<LensSelection>) = (Vec::new(), Vec::new());
    for (id, info) in dataset.cameras.enumerate() {
        let sharers = sharers(groups, id);
        let model = match (sharers.iter().copied().find_map(given), sharers.first()) {
            (Some((_, model)), _) => model,
            // It was chosen with the first that shares it.
            (None, Some(first)) if *first < id => models[first.index()],
            // It will be left out, whatever its lens.
            (None, _)
                if !dataset.views.iter().any(|view| view.camera == id || sharers.contains(&view.camera)) =>
            {
                Model::OpenCv5(Default::default())
            }
            (None, _) => {
                let selection = choose_lens(dataset, &sharers, terms)?;
                let model = selection.model;
                lenses.push(selection);
                model
            }
        };
        if is_noncentral(model) && !known.iter().any(|(known, _)| *known == id) {
            return Err(Error::Noncentral { camera: info.name.clone(), model: model.name() });
        }
        models.push(model);
    }
    Ok((models, lenses))
}

/// Tells whether a lens has a centre of projection that moves, so that what its pixels see depends on the
/// distance: poses and lens cannot be told apart from views of a target.
pub(crate) fn is_noncentral(model: Model) -> bool {
    model.param_groups().contains(&ParamGroup::Pupil)
}

/// Returns the lenses that the job knows, by the dataset's cameras.
pub(crate) fn known_lenses(job: &Job, dataset: &Dataset) -> Vec<(CameraId, Camera)> {
    let known = job.known_lenses.iter().filter_map(|(name, lens)| {
        let (id, _) = dataset.cameras.enumerate().find(|(_, info)| info.name == *name)?;
        Some((id, lens.clone()))
    });
    known.collect()
}

/// Does parallel work on so many threads; 0 is one for each core.
pub fn with_threads<T: Send>(threads: usize, work: impl FnOnce() -> T + Send) -> T {
    match rayon::ThreadPoolBuilder::new().num_threads(threads).build() {
        Ok(pool) => pool.install(work),
        // Where no threads can be had, the caller's own will do; the result is the same.
        Err(_) => work(),
    }
}

/// Replaces what the adjustment knows of views that were left out by the seed's own reasons.
fn say_why(calibration: &mut Calibration, dataset: &Dataset, left_out: &[LeftOut]) {
    for rejection in &mut calibration.rejected {
        let RejectionReason::LeftOut { why } = &mut rejection.reason else { continue };
        let view = &dataset.views[rejection.view_idx];
        let fact = left_out.iter().find(|fact| fact.view_idx() == Some(rejection.view_idx));
        let fact = fact.or_else(|| {
            left_out.iter().find(|fact| match fact {
                LeftOut::TooFewViews { camera, .. }
                | LeftOut::NoLens { camera, .. }
                | LeftOut::Unconnected { camera, .. } => *camera == view.camera,
                _ => false,
            })
        });
        if let Some(fact) = fact {
            *why = fact.describe(dataset);
        }
    }
}

/// Tells whether a finding about the input is about a camera that was not chosen.
fn is_of_other_camera(finding: &Finding, job: &Job, chosen: &Dataset) -> bool {
    let is_in = |dataset: &Dataset| dataset.cameras.iter().any(|camera| camera.name == finding.place);
    is_in(&job.dataset) && !is_in(chosen)
}

#[cfg(test)]
#[path = "calibrate_tests.rs"]
mod tests;
