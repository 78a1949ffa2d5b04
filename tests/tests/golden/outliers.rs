//! Outliers: mrcal's problems with displaced corners, and views that are wrong as a whole.

use std::collections::BTreeSet;

use boresight_adjust::{AdjustOptions, adjust};
use boresight_data::{CameraId, Dataset, RejectionReason, Scene, TargetId};
use boresight_geometry::{Pose, Vector3};
use boresight_seed::{SeedOptions, seed};
use boresight_synthetic::{Recipe, Synthetic, simulate};
use boresight_tests::conformance::conformance_file;
use boresight_tests::mrcal_problem::MrcalProblem;

#[test]
fn no_outlier_is_missed_and_no_good_corner_lost() {
    for name in ["c1_f50_b10", "c1_f50_b14", "c2_f50_b10", "c8_f50_b10"] {
        let Some(path) = conformance_file(&format!("mrcal/problems/{name}_opencv8.npz")) else { return };
        let problem = MrcalProblem::read(&path, "opencv8".parse().unwrap(), true).unwrap();
        let calibration = adjust(&problem.dataset, &problem.seed, &AdjustOptions::default(), None).unwrap();
        assert!(calibration.solve.converged);
        let outliers = problem.true_outliers(problem.arrays.number("noise_sigma"), 5.0);
        let rejected: BTreeSet<(usize, u32)> =
            calibration.rejected.iter().map(|r| (r.view_idx, r.point.0)).collect();
        let missed = outliers.above.difference(&rejected).count();
        let lost = rejected.difference(&outliers.all).count();
        let n_good = problem.dataset.observation_count() - outliers.all.len();
        let share = lost as f64 / n_good as f64;
        let (n_above, passes) = (outliers.above.len(), calibration.solve.passes);
        println!("{name}: {missed} of {n_above} missed, {lost} of {n_good} lost, {passes} passes");
        assert_eq!(missed, 0, "{name}");
        assert!(share <= 1e-3, "{name}: {lost} of {n_good}");
    }
}

/// Returns the pixels of a view if its camera or the target had been elsewhere, with the noise it has.
fn seen_otherwise(
    made: &Synthetic,
    view_idx: usize,
    shift_in_target: Vector3<f64>,
    moved_from_cam: Pose,
) -> Vec<[f64; 2]> {
    let view = &made.dataset.views[view_idx];
    let camera = made.truth.rig.cameras[view.camera].as_ref().unwrap();
    let rig_from_target = made.truth.rig_from_target[view.frame].unwrap();
    let shape_m = &made.truth.targets[TargetId(0)].shape_m;
    let pixel = |(seen, clean): (&boresight_data::Observation, &[f64; 2])| {
        let point = made.dataset.targets[TargetId(0)].point(seen.point, shape_m) + shift_in_target;
        let here = moved_from_cam * (camera.cam_from_rig * (rig_from_target * point));
        let pixel = camera.camera.project(&here).unwrap();
        [0, 1].map(|axis| pixel[axis] + seen.pixel[axis] - clean[axis])
    };
    view.observations.iter().zip(&made.clean_px[view_idx]).map(pixel).collect()
}

/// Returns the views of the second camera that show the whole board.
fn whole_views(dataset: &Dataset) -> Vec<usize> {
    let is_whole = |idx: &usize| {
        let view = &dataset.views[*idx];
        view.camera == CameraId(1) && view.observations.len() == dataset.targets[TargetId(0)].point_count()
    };
    (0..dataset.views.len()).filter(is_whole).collect()
}

/// What can be told of a view that is wrong.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Blame {
    /// Which it is.
    View,
    /// In which frame it is: where two cameras disagree, nothing tells which of them is right.
    Frame,
}

/// Checks that exactly these views are left out, for a reason that says `part`, and that the lens is as true as ever.
fn check(name: &str, dataset: &Dataset, truth: &Scene, bad: &[usize], blame: Blame, part: &str) {
    let model = "opencv5".parse().unwrap();
    let seed = seed(dataset, &SeedOptions { models: vec![model], ..SeedOptions::default() }).unwrap();
    let calibration = adjust(dataset, &seed.scene, &AdjustOptions::default(), None).unwrap();
    let mut left_out = BTreeSet::new();
    for rejection in &calibration.rejected {
        if let RejectionReason::LeftOut { why } = &rejection.reason {
            left_out.insert((rejection.view_idx, why.clone()));
        }
    }
    println!("{name}: {left_out:?}, seed {:?}", seed.left_out);
    let views: Vec<usize> = left_out.iter().map(|(view_idx, _)| *view_idx).collect();
    let blamed = |views: &[usize]| -> Vec<usize> {
        let id = |idx: &usize| match blame {
            Blame::View => *idx,
            Blame::Frame => dataset.views[*idx].frame.0 as usize,
        };
        views.iter().map(id).collect()
    };
    assert_eq!(blamed(&views), blamed(bad), "{name}: {left_out:?}");
    let n_told = left_out.iter().filter(|(_, why)| why.contains(part)).count();
    // A move that hardly shows where a view's target is may be taken for anything else there.
    let n_least = if part.contains("moved") { 3 } else { bad.len() };
    assert!(n_told >= n_least, "{name}: {left_out:?}");
    let n_outliers = calibration.rejected.len()
        - views.iter().map(|idx| dataset.views[*idx].observations.len()).sum::<usize>();
    // Beyond four sigmas lie 0.03 % of normal residuals.
    assert!(n_outliers <= 6, "{name}: {n_outliers} outliers");
    for (found, truth) in calibration.scene.rig.cameras.iter().zip(&truth.rig.cameras) {
        let (found, truth) = (found.as_ref().unwrap(), truth.as_ref().unwrap());
        let error = (found.camera.params[0] - truth.camera.params[0]).abs();
        assert!(error < 1.5, "{name}: focal length off by {error} px");
        let apart = (found.cam_from_rig.translation - truth.cam_from_rig.translation).norm();
        assert!(apart < 1e-3, "{name}: a camera is {apart} m off");
    }
}

#[test]
fn views_that_are_wrong_as_a_whole_are_left_out_with_the_reason() {
    let made = simulate(&Recipe::stereo(), 11);
    let whole = whole_views(&made.dataset);
    let (one, spacing) = (whole[2], 0.05);
    let with = |changes: &[(usize, Vec<[f64; 2]>)]| {
        let mut dataset = made.dataset.clone();
        for (view_idx, pixels) in changes {
            for (seen, pixel) in dataset.views[*view_idx].observations.iter_mut().zip(pixels) {
                seen.pixel = *pixel;
            }
        }
        dataset
    };
    let own: Vec<[f64; 2]> = made.dataset.views[one].observations.iter().map(|seen| seen.pixel).collect();

    let backwards = own.iter().rev().copied().collect();
    check(
        "backwards",
        &with(&[(one, backwards)]),
        &made.truth,
        &[one],
        Blame::View,
        "counted from another corner",
    );

    // Down the columns where it should be along the rows.
    let [columns, rows] = [10, 8];
    let by_columns = (0..own.len()).map(|i| own[(i % rows) * columns + i / rows]).collect();
    check("by columns", &with(&[(one, by_columns)]), &made.truth, &[one], Blame::View, "another order");

    let half = seen_otherwise(&made, one, Vector3::new(0.5 * spacing, 0.0, 0.0), Pose::identity());
    check(
        "half a square",
        &with(&[(one, half)]),
        &made.truth,
        &[one],
        Blame::Frame,
        "shifted by 0.5 and 0 squares",
    );

    let late = seen_otherwise(&made, one, Vector3::new(0.011, -0.007, 0.004), Pose::identity());
    check("unsynchronised", &with(&[(one, late)]), &made.truth, &[one], Blame::Frame, "not at the same time");

    let moved = Pose::from_rodrigues(Vector3::new(0.004, -0.006, 0.002), Vector3::new(0.008, 0.002, -0.003));
    let last: Vec<usize> =
        (0..made.dataset.views.len()).filter(|idx| made.dataset.views[*idx].camera == CameraId(1)).collect();
    let last = &last[last.len() - 5..];
    let changes: Vec<(usize, Vec<[f64; 2]>)> =
        last.iter().map(|&idx| (idx, seen_otherwise(&made, idx, Vector3::zeros(), moved))).collect();
    check("moved camera", &with(&changes), &made.truth, last, Blame::View, "it moved between frames");
}
