//! The optima of mrcal 2.2's objective, from the stored seeds and from our own.

use boresight_adjust::{AdjustOptions, Hold, Optimum, Regularization, Rejection, optimize};
use boresight_camera::Model;
use boresight_data::{CameraId, Scene};
use boresight_seed::{SeedOptions, seed};
use boresight_solver::{Checkpointing, Stop};
use boresight_tests::conformance::conformance_file;
use boresight_tests::mrcal_problem::MrcalProblem;
use boresight_tests::npz::Npz;

/// mrcal's scales of parameters: focal length, centre, distortion, camera rotation, board rotation,
/// translation, warp.
const FOCAL: f64 = 500.0;
const CENTRE: f64 = 20.0;
const CAMERA_ROTATION: f64 = 0.1 * std::f64::consts::PI / 180.0;
const BOARD_ROTATION: f64 = 15.0 * std::f64::consts::PI / 180.0;
const WARP: f64 = 0.01;

fn opencv8() -> Model {
    "opencv8".parse().unwrap()
}

fn options() -> AdjustOptions {
    AdjustOptions {
        rejection: Rejection::None,
        regularization: Regularization::Mrcal22,
        // The stored optima are polished until the step vanishes; the default stops at a thousandth of a sigma.
        decrease_below: 1e-13,
        ..AdjustOptions::default()
    }
}

/// Returns the problem and its stored optimum.
fn read(name: &str) -> Option<(MrcalProblem, Scene, f64)> {
    let problem = conformance_file(&format!("mrcal/problems/{name}_opencv8.npz"))?;
    let solution = Npz::read(&conformance_file(&format!("mrcal/solutions/{name}_opencv8_reg.npz"))?).unwrap();
    let problem = MrcalProblem::read(&problem, opencv8(), false).unwrap();
    let optimum = problem.scene_of(&solution, "", opencv8());
    Some((problem, optimum, solution.number("cost")))
}

/// Returns the largest difference of two scenes in mrcal's packed units.
fn packed_difference(a: &Scene, b: &Scene) -> f64 {
    let mut largest: f64 = 0.0;
    let mut note = |difference: f64| largest = largest.max(difference.abs());
    for (a, b) in a.rig.cameras.iter().flatten().zip(b.rig.cameras.iter().flatten()) {
        for (i, (a, b)) in a.camera.params.iter().zip(&b.camera.params).enumerate() {
            let scale = if i < 2 {
                FOCAL
            } else if i < 4 {
                CENTRE
            } else {
                1.0
            };
            note((a - b) / scale);
        }
        note((a.cam_from_rig * b.cam_from_rig.inverse()).angle() / CAMERA_ROTATION);
        note((a.cam_from_rig.translation - b.cam_from_rig.translation).amax());
    }
    for (a, b) in a.rig_from_target.iter().flatten().zip(b.rig_from_target.iter().flatten()) {
        note((*a * b.inverse()).angle() / BOARD_ROTATION);
        note((a.translation - b.translation).amax());
    }
    for (a, b) in a.targets.iter().zip(&b.targets) {
        a.shape_m.iter().zip(&b.shape_m).for_each(|(a, b)| note((a - b) / WARP));
    }
    largest
}

fn check(found: &Optimum, optimum: &Scene, cost: f64, name: &str) {
    let relative = (found.solution.cost / cost - 1.0).abs();
    let packed = packed_difference(&found.scene, optimum);
    println!(
        "{name}: cost {:.12}, relative {relative:.1e}, packed {packed:.1e}, {:?}",
        found.solution.cost, found.solution.counters
    );
    assert!(found.solution.stop.is_converged(), "{name}: {}", found.solution.stop);
    assert!(relative <= 1e-9, "{name}: cost {} against {cost}", found.solution.cost);
    assert!(packed <= 1e-6, "{name}: {packed:e} packed units");
}

#[test]
fn stored_seeds_lead_to_the_stored_optima() {
    for name in ["c1_f50_b10", "c2_f50_b10", "c8_f50_b10"] {
        let Some((problem, optimum, cost)) = read(name) else { return };
        let found = optimize(&problem.dataset, &problem.seed, &options()).unwrap();
        check(&found, &optimum, cost, name);
    }
}

#[test]
fn own_seeds_without_focal_length_lead_to_the_same_optima() {
    for name in ["c1_f50_b10", "c2_f50_b10", "c8_f50_b10"] {
        let Some((problem, optimum, cost)) = read(name) else { return };
        let seed = seed(&problem.dataset, &SeedOptions { models: vec![opencv8()], ..SeedOptions::default() })
            .unwrap();
        assert_eq!(seed.left_out, [], "{name}");
        let found = optimize(&problem.dataset, &seed.scene, &options()).unwrap();
        check(&found, &optimum, cost, name);
    }
}

#[test]
fn default_stop_is_close_enough() {
    let Some((problem, optimum, cost)) = read("c2_f50_b10") else { return };
    let options = AdjustOptions { decrease_below: AdjustOptions::default().decrease_below, ..options() };
    let found = optimize(&problem.dataset, &problem.seed, &options).unwrap();
    assert!((found.solution.cost / cost - 1.0).abs() < 1e-10);
    // A thousandth of a sigma of the weakest direction, which is a distortion's.
    assert!(packed_difference(&found.scene, &optimum) < 1e-3);
}

#[test]
fn a_splined_lens_leads_to_the_stored_optimum() {
    let Some(problem) = conformance_file("mrcal/problems/c1_f200_b14_splined.npz") else { return };
    let Some(solution) = conformance_file("mrcal/solutions/c1_f200_b14_splined_reg.npz") else { return };
    let lens: Model = "splined3:30x18:120deg".parse().unwrap();
    let problem = MrcalProblem::read(&problem, lens, false).unwrap();
    let solution = Npz::read(&solution).unwrap();
    // mrcal's tool holds the core of a splined lens, which its knots can say as well.
    let holds = (0..4).map(|param| Hold::LensParam(CameraId(0), param)).collect();
    let options = AdjustOptions { holds, ..options() };
    let found = optimize(&problem.dataset, &problem.seed, &options).unwrap();
    let optimum = problem.scene_of(&solution, "", lens);
    check(&found, &optimum, solution.number("cost"), "c1_f200_b14_splined");
    // By default, the last step is taken at a thousandth of a sigma.
    let options = AdjustOptions { decrease_below: AdjustOptions::default().decrease_below, ..options };
    let found = optimize(&problem.dataset, &problem.seed, &options).unwrap();
    // Half of them are of a stand-in, and most of the others of gradients alone.
    assert!(found.solution.counters.evaluations <= 25, "{:?}", found.solution.counters);
    let on_two = optimize(&problem.dataset, &problem.seed, &AdjustOptions { threads: 2, ..options.clone() });
    let on_one = optimize(&problem.dataset, &problem.seed, &AdjustOptions { threads: 1, ..options });
    assert_eq!(on_two.unwrap().solution.values, on_one.unwrap().solution.values);
    let cost = found.solution.cost;
    println!("by default: cost {cost:.12}, {:?}", found.solution.counters);
    assert!(cost <= solution.number("cost") * (1.0 + 1e-9), "{cost}");
}

#[test]
fn a_splined_search_resumes_with_the_same_bits() {
    let Some(problem) = conformance_file("mrcal/problems/c1_f200_b14_splined.npz") else { return };
    let lens: Model = "splined3:30x18:120deg".parse().unwrap();
    let problem = MrcalProblem::read(&problem, lens, false).unwrap();
    let holds = (0..4).map(|param| Hold::LensParam(CameraId(0), param)).collect();
    let options = AdjustOptions { holds, decrease_below: 1e-6, ..options() };
    // A surface that is flat would be solved by a stand-in first.
    let near = AdjustOptions { max_iterations: 1, ..options.clone() };
    let start = optimize(&problem.dataset, &problem.seed, &near).unwrap().scene;
    let whole = optimize(&problem.dataset, &start, &options).unwrap().solution;
    // Most steps are from gradients alone.
    assert!(whole.counters.iterations > whole.counters.factorizations, "{:?}", whole.counters);
    let folder = std::path::Path::new(env!("CARGO_TARGET_TMPDIR")).join("splined-checkpoint");
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).unwrap();
    let path = folder.join("search.json");
    for max_iterations in [2, 6, 10, 12, 14, 16, 18, 500] {
        let checkpoint = Some(Checkpointing { path: path.clone(), every: 1 });
        let options = AdjustOptions { max_iterations, checkpoint, ..options.clone() };
        let found = optimize(&problem.dataset, &start, &options).unwrap().solution;
        println!("up to {max_iterations}: {:?}, {:?}", found.stop, found.counters);
        if max_iterations == 500 {
            assert_eq!(found.values, whole.values);
            assert_eq!(found.cost.to_bits(), whole.cost.to_bits());
        } else {
            assert_eq!(found.stop, Stop::Iterations { count: max_iterations });
        }
    }
}
