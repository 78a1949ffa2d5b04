//! Fits of poses against truth.

use std::sync::Arc;

use boresight_data::Mounting;
use boresight_geometry::{Matrix6, PoseStream, Vector3};

use super::*;
use crate::test_numbers::Normals;

fn pose(a: [f64; 3], b: [f64; 3]) -> Pose {
    Pose::from_rodrigues(a.into(), b.into())
}

/// A robot that waves about all axes.
fn flange(time_s: f64) -> Pose {
    let (a, b, c) = ((1.3 * time_s).sin(), (0.9 * time_s + 0.4).sin(), (0.7 * time_s).cos());
    pose([0.5 * a, 2.6 + 0.5 * b, 0.4 * c], [0.5 + 0.2 * c, 0.2 * a, 0.6 + 0.2 * b])
}

fn noisy(pose: &Pose, sigmas: [f64; 2], normals: &mut Normals) -> Pose {
    let mut tangent = Vector6::from_fn(|i, _| sigmas[i / 3] * normals.next());
    // Turned in place, then shifted.
    let turn = Pose::from_rodrigues(tangent.fixed_rows::<3>(0).into_owned(), Vector3::zeros());
    tangent.fixed_rows_mut::<3>(0).fill(0.0);
    Pose::new(turn.rotation * pose.rotation, pose.translation + tangent.fixed_rows::<3>(3))
}

fn hand_eye(mounting: Mounting, offset_s: f64, is_stream: bool) -> HandEyeModel {
    let times_s: Vec<f64> = (0..300).map(|i| 0.5 + 0.1 * f64::from(i)).collect();
    let arm = if is_stream {
        let samples = (0..3300).map(|i| 0.01 * f64::from(i)).map(|time| (time, flange(time)));
        Arm::Stream { base_from_flange: PoseStream::new(samples), times_s }
    } else {
        Arm::Rows(times_s.iter().map(|&time| flange(time)).collect())
    };
    HandEyeModel {
        arm: Arc::new(arm),
        mounting,
        carrier_from_rig: pose([0.1, -0.2, 1.5], [0.05, -0.03, 0.1]),
        other_from_target: pose([3.0, 0.2, 0.1], [0.7, 0.1, 0.02]),
        offset_s,
    }
}

fn joints() -> JointModel {
    let angles_rad = (0..120)
        .map(|i| {
            vec![0.5 * (0.7 * f64::from(i)).sin(), 0.05 * f64::from(i), 0.3 * (1.9 * f64::from(i)).cos()]
        })
        .collect();
    JointModel {
        angles_rad: Arc::new(angles_rad),
        rig_from_joint: vec![
            pose([0.3, 1.2, 0.1], [0.1, 0.0, 2.0]),
            pose([1.4, 0.1, -0.3], [0.0, 0.2, 1.9]),
            pose([0.1, -1.3, 0.2], [-0.1, 0.1, 1.8]),
        ],
        rig_from_target: pose([0.2, 0.1, 1.0], [0.1, 0.1, 1.7]),
    }
}

/// Derivatives against differences, for each unknown.
fn check_derivatives<M: PoseModel>(model: &M, row: usize) {
    let mut by_unknowns = Matrix6xX::zeros(model.columns());
    let at = model.predicted(row, &mut by_unknowns).unwrap();
    assert_eq!(model.pose(row), Some(at));
    for column in 0..model.columns() {
        let step = |size: f64| {
            let mut step = DVector::zeros(model.columns());
            step[column] = size;
            (model.moved(&step).pose(row).unwrap() * at.inverse()).log()
        };
        let size = 1e-5;
        let slope = (step(size) - step(-size)) / (2.0 * size);
        let error = (slope - by_unknowns.column(column)).norm();
        // Central differences are good to the square of the step.
        assert!(error < 1e-6 * (1.0 + slope.norm()), "{row} {column}: {error}");
    }
}

#[test]
fn derivatives_match_differences() {
    for mounting in [Mounting::RigOnFlange, Mounting::RigInBase] {
        // Between two samples, where the stream is smooth.
        check_derivatives(&hand_eye(mounting, 0.0031, true), 7);
        check_derivatives(&hand_eye(mounting, 0.0, false), 11);
    }
    check_derivatives(&joints(), 17);
}

/// What the model sees, with noise.
fn seen<M: PoseModel>(model: &M, rows: usize, sigmas: [f64; 2], normals: &mut Normals) -> Vec<Pose> {
    (0..rows)
        .map(|row| model.pose(row).map_or_else(Pose::identity, |pose| noisy(&pose, sigmas, normals)))
        .collect()
}

fn blocks(rows: usize, count: usize) -> Vec<usize> {
    (0..rows).map(|row| row * count / rows).collect()
}

fn off<M: PoseModel>(model: &M, size: f64) -> M {
    model.moved(&DVector::from_fn(model.columns(), |i, _| size * if i % 2 == 0 { 1.0 } else { -0.7 }))
}

#[test]
fn exact_poses_give_the_truth() {
    let truth = hand_eye(Mounting::RigOnFlange, 0.123, true);
    let poses = seen(&truth, 300, [0.0; 2], &mut Normals::new(1));
    let start = HandEyeModel { offset_s: 0.08, ..off(&truth, 0.03) };
    let found = fit_poses(start, &poses, &blocks(300, 10)).unwrap();
    assert!((found.model.offset_s - 0.123).abs() < 1e-6, "{}", found.model.offset_s);
    let error = (found.model.carrier_from_rig * truth.carrier_from_rig.inverse()).log().norm();
    assert!(error < 1e-6, "{error}");
    let truth = joints();
    let poses = seen(&truth, 120, [0.0; 2], &mut Normals::new(1));
    let found = fit_poses(off(&truth, 0.05), &poses, &blocks(120, 12)).unwrap();
    for (row, pose) in poses.iter().enumerate() {
        let error = (found.model.pose(row).unwrap() * pose.inverse()).log().norm();
        assert!(error < 1e-6, "{row}: {error}");
    }
}

/// The scatter over runs is what is stated, and the noise is what it was.
#[test]
fn stated_sigmas_are_the_scatter() {
    let runs = 40;
    let truth = hand_eye(Mounting::RigInBase, 0.05, true);
    let sigmas = [2e-3, 1e-3];
    let (mut scatter, mut stated) = ([0.0; 13], [0.0; 13]);
    for run in 0..runs {
        let mut normals = Normals::new(run + 1);
        let mut poses = seen(&truth, 300, sigmas, &mut normals);
        // One in thirty is of another target.
        for (row, pose) in poses.iter_mut().enumerate().filter(|(row, _)| row % 30 == 4) {
            pose.translation.x += 0.1 + 1e-3 * row as f64;
        }
        let found = fit_poses(truth.clone(), &poses, &blocks(300, 20)).unwrap();
        assert!(found.is_converged);
        let rotation = found.noise.rotation_sigmas_rad();
        assert!((rotation[0] / 2e-3 - 1.0).abs() < 0.3, "{rotation:?}");
        let is_wrong = |row: usize| row % 30 == 4;
        let is_far = |row: &usize| found.sigmas[*row].unwrap() > 6.0;
        let (wrong, right): (Vec<usize>, Vec<usize>) =
            (0..300).filter(is_far).partition(|row| is_wrong(*row));
        // Sigmas are those of the t distribution's middle, which its tails are not part of.
        assert!(wrong.len() == 10 && right.len() < 4, "{wrong:?} {right:?}");
        let rig = (found.model.carrier_from_rig * truth.carrier_from_rig.inverse()).log();
        let target = (found.model.other_from_target * truth.other_from_target.inverse()).log();
        let offset_s = found.model.offset_s - truth.offset_s;
        let errors = rig.iter().chain(target.iter()).copied().chain([offset_s]);
        for (i, error) in errors.enumerate() {
            scatter[i] += error * error / runs as f64;
            stated[i] += found.covariance[(i, i)] / runs as f64;
        }
    }
    for i in 0..13 {
        let ratio = (stated[i] / scatter[i]).sqrt();
        // The scatter of 40 runs is known to 11 %, the mean of jackknives with 20 blocks to 3 %; three sigmas.
        assert!((ratio - 1.0).abs() < 0.35, "{i}: {ratio}");
    }
}

#[test]
fn what_is_open_is_refused() {
    let model = JointModel { angles_rad: Arc::new(vec![vec![0.1, 0.2, 0.3]; 20]), ..joints() };
    let poses = seen(&model, 20, [1e-3; 2], &mut Normals::new(1));
    assert_eq!(fit_poses(model, &poses, &blocks(20, 20)).unwrap_err(), PoseFitError::Open);
    let model = joints();
    let poses = seen(&model, 2, [1e-3; 2], &mut Normals::new(1));
    let few = JointModel { angles_rad: Arc::new(model.angles_rad[..2].to_vec()), ..model };
    assert_eq!(fit_poses(few, &poses, &[0, 1]).unwrap_err(), PoseFitError::TooFew { found: 2, need: 4 });
}

/// Of a few rows the unknowns can bring one direction of residuals to zero, which must not make a noise of it.
#[test]
fn few_rows_keep_their_noise() {
    let (mut squares, runs) = ([0.0; 2], 20);
    for run in 0..runs {
        let all = hand_eye(Mounting::RigOnFlange, 0.0, false);
        let Arm::Rows(poses) = &*all.arm else { panic!() };
        // Eight poses far apart.
        let few = poses.iter().copied().step_by(37).take(8).collect();
        let truth = HandEyeModel { arm: Arc::new(Arm::Rows(few)), ..all.clone() };
        let poses = seen(&truth, 8, [2e-3, 1e-3], &mut Normals::new(run + 1));
        let found = fit_poses(truth, &poses, &blocks(8, 8)).unwrap();
        squares[0] += found.noise.scale[(0, 0)] / (2e-3f64.powi(2) * runs as f64);
        squares[1] += found.noise.scale[(3, 3)] / (1e-3f64.powi(2) * runs as f64);
    }
    for square in squares {
        // 20 runs of some 18 redundant numbers each tell a sigma to 4 %; the t distribution's scale is below the
        // normal one's where it is chosen.
        assert!((0.75..1.15).contains(&square.sqrt()), "{squares:?}");
    }
}

#[test]
fn rows_that_are_no_longer_told_of_gain_nothing() {
    let present = [Some(4.0), Some(1.0), Some(2.0), None];
    for (trial, expected) in [
        ([Some(3.0), Some(1.0), Some(2.0), None], true),
        ([Some(3.0), Some(1.0), Some(2.0), Some(9.0)], true),
        ([Some(3.0), Some(3.0), None, None], false),
        ([None, Some(1.0), Some(1.5), None], true),
        ([None, None, Some(0.0), None], false),
        ([None; 4], false),
    ] {
        assert_eq!(is_no_worse(&present, &trial), expected, "{trial:?}");
    }
}

/// The most likely noise is where no small change of it is more likely, from any start.
#[test]
fn the_noise_is_the_most_likely() {
    let mut normals = Normals::new(7);
    let residuals: Vec<Vector6<f64>> = (0..400)
        .map(|row| {
            let factor = if row % 9 == 0 { 6.0 } else { 1.0 };
            let own = Vector6::from_fn(|_, _| normals.next());
            Vector6::from_fn(|i, _| 1e-3 * factor * (own[i] + 0.5 * own[(i + 1) % 6]) * (1.0 + i as f64))
        })
        .collect();
    let plain = NoiseSearch::default().of_all_choices(&residuals, 1.0);
    assert!(plain.degrees_of_freedom < 15.0);
    let cost =
        |scale: &Matrix6<f64>| PoseNoise::new(*scale, plain.degrees_of_freedom).likelihood_cost(&residuals);
    let least = cost(&plain.scale);
    for i in 0..6 {
        for j in i..6 {
            for change in [-0.01, 0.01] {
                let mut scale = plain.scale;
                let by = change * (scale[(i, i)] * scale[(j, j)]).sqrt();
                scale[(i, j)] += by;
                if i != j {
                    scale[(j, i)] += by;
                }
                assert!(cost(&scale) > least, "{i} {j} {change}");
            }
        }
    }
    // From elsewhere, the same.
    let mut search = NoiseSearch::default();
    let far: Vec<Vector6<f64>> = residuals.iter().map(|residual| residual * 30.0).collect();
    search.of_all_choices(&far, 0.9);
    let again = search.of_near_choices(&residuals, 1.0);
    assert_eq!(again.degrees_of_freedom, plain.degrees_of_freedom);
    assert!((again.scale - plain.scale).norm() < 1e-4 * plain.scale.norm());
}
