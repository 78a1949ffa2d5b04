//! One camera's lens and the poses of its views, from nothing but its corners.

use boresight_camera::{Camera, Model};
use boresight_data::{CameraId, CameraInfo};
use boresight_geometry::Pose;

use crate::bundle::{Bundle, bundle};
use crate::lens_fit::camera_from_profile;
use crate::profile::{Profile, ProfileView, fit_profile};
use crate::radial::{RadialPose, radial_pose};
use crate::resection::{Resection, refine, resect};
use crate::robust::median;
use crate::sighting::Sighting;
use crate::subset::diverse_subset;
use crate::{LeftOut, SeedOptions, zhang};

/// Views and points per view that rival starts are judged by.
const TRIAL_VIEWS: usize = 12;
const TRIAL_POINTS: usize = 40;
const TRIAL_STEPS: usize = 5;
/// Residuals below this many sigmas are no reason to look further; corners are never that good.
const FINE_SIGMAS: f64 = 0.05;

/// A calibrated camera with the poses of its views.
#[derive(Clone, Debug)]
pub(crate) struct CameraSeed {
    pub camera: Camera,
    /// The resection of each sighting, `None` where it was left out.
    pub resections: Vec<Option<Resection>>,
    /// The usual median length of a view's residuals, in sigmas.
    pub typical: f64,
}

/// A start for the lens, with poses as far as it provides them.
struct Candidate {
    camera: Camera,
    poses: Vec<Option<Pose>>,
}

/// Finds the poses of all views on a lens that is known; facts about views go to `left_out`.
pub(crate) fn seed_known_camera(
    id: CameraId,
    camera: &Camera,
    sightings: &[Sighting],
    left_out: &mut Vec<LeftOut>,
) -> Result<CameraSeed, LeftOut> {
    let find = |typical: f64| -> Vec<Option<Resection>> {
        sightings.iter().map(|sighting| resect(camera, sighting, None, typical)).collect()
    };
    // What is usual shows only after a first round, for which a pixel's sigma is a fair guess.
    let medians: Vec<f64> = find(1.0).iter().flatten().map(|found| found.median).collect();
    let typical = median(&medians).max(FINE_SIGMAS);
    let mut resections = find(typical);
    sort_out(sightings, &mut resections, typical, left_out);
    if resections.iter().flatten().count() == 0 {
        return Err(LeftOut::TooFewViews { camera: id, found: 0, need: 1 });
    }
    Ok(CameraSeed { camera: camera.clone(), resections, typical })
}

/// Calibrates one camera; facts about views go to `left_out`.
pub(crate) fn seed_camera(
    id: CameraId,
    info: &CameraInfo,
    model: Model,
    sightings: &[Sighting],
    options: &SeedOptions,
    left_out: &mut Vec<LeftOut>,
) -> Result<CameraSeed, LeftOut> {
    if sightings.len() < options.min_views {
        return Err(LeftOut::TooFewViews { camera: id, found: sightings.len(), need: options.min_views });
    }
    let no_lens = LeftOut::NoLens { camera: id, views: sightings.len() };
    let centre = info.image_size.map(|size| 0.5 * (f64::from(size) - 1.0));
    let radials: Vec<Option<RadialPose>> =
        sightings.iter().map(|sighting| radial_pose(sighting, centre)).collect();
    let subset =
        diverse_subset(sightings, &radials, info.image_size, options.lens_views.max(options.min_views));
    let chosen: Vec<Sighting> =
        subset.iter().map(|&i| sightings[i].thinned(options.lens_points_per_view.max(8))).collect();
    let chosen_radials: Vec<Option<RadialPose>> =
        chosen.iter().map(|sighting| radial_pose(sighting, centre)).collect();

    let profile = profile_of(&chosen, &chosen_radials, centre, info.image_size);
    let mut candidates = Vec::new();
    if let Some(profile) = &profile
        && let Some(camera) = camera_from_profile(model, info.image_size, centre, profile)
    {
        let poses = radial_starts(&chosen, &chosen_radials, centre, profile);
        candidates.push(Candidate { camera, poses });
    }
    candidates.extend(narrow_candidates(model, info.image_size, centre, &chosen, &chosen_radials));
    let (camera, starts) = best_candidate(candidates, &chosen).ok_or(no_lens.clone())?;

    // The lens from the chosen views, then every view on that lens.
    let (posed, poses): (Vec<Sighting>, Vec<Pose>) =
        chosen.iter().zip(&starts).filter_map(|(sighting, pose)| Some((sighting.clone(), (*pose)?))).unzip();
    let refined = bundle(&camera, &poses, &posed, options.lens_steps).ok_or(no_lens.clone())?;
    let typical = refined.median.max(FINE_SIGMAS);
    let mut starts = vec![None; sightings.len()];
    if let Some(profile) = &profile {
        starts = radial_starts(sightings, &radials, centre, profile);
    }
    for (sighting, pose) in posed.iter().zip(&refined.poses) {
        if let Some(i) = sightings.iter().position(|other| other.view_idx == sighting.view_idx) {
            starts[i] = Some(*pose);
        }
    }
    let mut resections: Vec<Option<Resection>> = sightings
        .iter()
        .zip(&starts)
        .map(|(sighting, start)| resect(&refined.camera, sighting, start.as_ref(), typical))
        .collect();
    sort_out(sightings, &mut resections, typical, left_out);
    let found = resections.iter().flatten().count();
    if found < options.min_views {
        return Err(LeftOut::TooFewViews { camera: id, found, need: options.min_views });
    }
    Ok(CameraSeed { camera: refined.camera, resections, typical })
}

/// Fits the lens profile to the views that have a radial pose.
fn profile_of(
    sightings: &[Sighting],
    radials: &[Option<RadialPose>],
    centre: [f64; 2],
    image_size: [u32; 2],
) -> Option<Profile> {
    let mut views: Vec<ProfileView> = sightings
        .iter()
        .zip(radials)
        .filter_map(|(sighting, radial)| Some(ProfileView::new(sighting, radial.as_ref()?, centre)))
        .collect();
    let spreads: Vec<f64> = radials.iter().flatten().map(|radial| radial.spread_px).collect();
    fit_profile(&mut views, f64::from(image_size[0].max(image_size[1])), median(&spreads).max(0.01))
}

/// Returns the pose of each view with a radial pose, at the depth that the profile gives it.
fn radial_starts(
    sightings: &[Sighting],
    radials: &[Option<RadialPose>],
    centre: [f64; 2],
    profile: &Profile,
) -> Vec<Option<Pose>> {
    let start = |(sighting, radial): (&Sighting, &Option<RadialPose>)| {
        let radial = radial.as_ref()?;
        let mut view = ProfileView::new(sighting, radial, centre);
        view.place(profile);
        Some(radial.at_depth(sighting, view.depth, view.is_mirrored))
    };
    sightings.iter().zip(radials).map(start).collect()
}

/// Returns the starts that suit narrow lenses: Zhang's with the centre of the image, and with its own.
fn narrow_candidates(
    model: Model,
    image_size: [u32; 2],
    centre: [f64; 2],
    sightings: &[Sighting],
    radials: &[Option<RadialPose>],
) -> Vec<Candidate> {
    let unit_px = f64::from(image_size[0].max(image_size[1]));
    let trusted = sightings.iter().zip(radials).filter_map(|(sighting, radial)| {
        zhang::homography(sighting, &radial.as_ref()?.trust, centre, unit_px)
    });
    let homographies: Vec<_> = trusted.collect();
    let centred = zhang::focal_length(&homographies).map(|focal| [focal, focal, 0.0, 0.0]);
    let free = zhang::core(&homographies)
        .filter(|[fx, fy, cx, cy]| (0.5..2.0).contains(&(fx / fy)) && cx.abs() < 1.0 && cy.abs() < 1.0);
    let candidate = |[fx, fy, cx, cy]: zhang::Core| {
        let core = [fx * unit_px, fy * unit_px, centre[0] + cx * unit_px, centre[1] + cy * unit_px];
        let camera = Camera::new(model, model.wide(core), image_size).ok()?;
        Some(Candidate { camera, poses: vec![None; sightings.len()] })
    };
    [centred, free].into_iter().flatten().filter_map(candidate).collect()
}

/// Refines each candidate a little on some views and returns the best with poses of all views.
fn best_candidate(candidates: Vec<Candidate>, sightings: &[Sighting]) -> Option<(Camera, Vec<Option<Pose>>)> {
    let step = sightings.len().div_ceil(TRIAL_VIEWS);
    let trial: Vec<(usize, Sighting)> =
        (0..sightings.len()).step_by(step.max(1)).map(|i| (i, sightings[i].thinned(TRIAL_POINTS))).collect();
    let judge = |candidate: Candidate| -> Option<Judged> {
        let (mut posed, mut views, mut poses) = (Vec::new(), Vec::new(), Vec::new());
        for (i, sighting) in &trial {
            if let Some(found) = pose_of(&candidate.camera, sighting, candidate.poses[*i].as_ref()) {
                posed.push(*i);
                views.push(sighting.clone());
                poses.push(found.cam_from_target);
            }
        }
        let bundle = bundle(&candidate.camera, &poses, &views, TRIAL_STEPS)?;
        // A view that could not be posed counts as one whose points are all out of sight.
        let outside = bundle.outside + (trial.len() - posed.len()) * TRIAL_POINTS;
        Some(Judged { bundle, starts: candidate.poses, posed, outside })
    };
    let mut best: Option<Judged> = None;
    for judged in candidates.into_iter().filter_map(judge) {
        let rank = |judged: &Judged| (judged.outside, judged.bundle.median);
        if best.as_ref().is_none_or(|best| rank(&judged) < rank(best)) {
            best = Some(judged);
        }
    }
    let Judged { bundle: refined, mut starts, posed, .. } = best?;
    let typical = refined.median.max(FINE_SIGMAS);
    for (i, pose) in posed.into_iter().zip(refined.poses) {
        starts[i] = Some(pose);
    }
    let pose_on = |(sighting, start): (&Sighting, &Option<Pose>)| {
        resect(&refined.camera, sighting, start.as_ref(), typical).map(|found| found.cam_from_target)
    };
    let poses = sightings.iter().zip(&starts).map(pose_on).collect();
    Some((refined.camera, poses))
}

/// A candidate after a few steps on the trial views.
struct Judged {
    bundle: Bundle,
    /// The poses that the candidate came with.
    starts: Vec<Option<Pose>>,
    /// The views that the bundle's poses are of.
    posed: Vec<usize>,
    /// The number of trial points that do not project.
    outside: usize,
}

/// Poses a view on a lens that is still rough, so that nothing is known of usual residuals.
fn pose_of(camera: &Camera, sighting: &Sighting, start: Option<&Pose>) -> Option<Resection> {
    let from_start =
        start.and_then(|start| refine(crate::kernel::Lens::of(camera), start, sighting, 1e-3, 6));
    match from_start {
        Some(found) if found.cost.outside == 0 => Some(found),
        _ => resect(camera, sighting, None, 5.0),
    }
}

/// Leaves out views without a pose, with points out of sight, or with a residual beyond all others'.
fn sort_out(
    sightings: &[Sighting],
    resections: &mut [Option<Resection>],
    typical: f64,
    left_out: &mut Vec<LeftOut>,
) {
    let medians: Vec<f64> = resections.iter().flatten().map(|found| found.median).collect();
    let usual = median(&medians).max(typical);
    let limit_sigmas = (10.0 * usual).max(3.0);
    for (sighting, resection) in sightings.iter().zip(resections) {
        let view_idx = sighting.view_idx;
        let fact = match resection {
            None => LeftOut::NoPose { view_idx },
            Some(found) if found.cost.outside > 0 => {
                LeftOut::OutOfSight { view_idx, points: found.cost.outside }
            }
            Some(found) if found.median > limit_sigmas => {
                LeftOut::BadFit { view_idx, median_sigmas: found.median, limit_sigmas }
            }
            Some(_) => continue,
        };
        left_out.push(fact);
        *resection = None;
    }
}
