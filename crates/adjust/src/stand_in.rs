//! A nearer start for lenses with local support whose surface is still flat.
//!
//! Where a seed knows no more than the core of such a lens, poses and surface are both far off, and it
//! takes many steps with thousands of unknowns until the poses are right. With a lens of eight
//! parameters in its place they are nearly right for the cost of one of those steps.
//!
//! The surface can make up for any turn of the camera, so what decides on the turn is the regularisation
//! alone. The way there from another turn is long and bent, so the start is turned to where it wants it.
//!
//! This is for starts that others made, such as those of mrcal's problems: our own seeds fit the surface already.

use boresight_camera::{Camera, Model};
use boresight_data::{CameraId, Dataset, Id as _, Scene};
use boresight_geometry::{Matrix3, Pose, Vector3};
use boresight_solver::{Belief, Counters, SolveOptions, solve};

use crate::adjust::solve_options;
use crate::error::Error;
use crate::options::{AdjustOptions, Hold, Regularization, Rejection};
use crate::regularization::spline_regularization;
use crate::rig_problem::RigProblem;

/// The stereographic projection, a flat surface, as coefficients of Kannala & Brandt: the series of
/// `2 tan(θ/2)`.
const STEREOGRAPHIC: [f64; 4] = [1.0 / 12.0, 1.0 / 120.0, 17.0 / 20160.0, 31.0 / 362_880.0];

/// The stand-in is solved until a step brings less than this share of the cost.
const DECREASE_BELOW: f64 = 1e-3;

/// A start that a stand-in led to.
pub(crate) struct NearerSeed {
    pub scene: Scene,
    /// What it took.
    pub counters: Counters,
}

/// Returns a nearer start if the lenses of some cameras are known by their core alone, and a stand-in
/// can take their place.
pub(crate) fn nearer_seed(dataset: &Dataset, seed: &Scene, options: &AdjustOptions) -> Option<NearerSeed> {
    let cameras =
        seed.rig.cameras.enumerate().filter_map(|(id, camera)| Some((id, &camera.as_ref()?.camera)));
    let flat: Vec<(CameraId, &Camera)> = cameras.filter(|(_, camera)| is_flat(camera)).collect();
    // What is held or believed says more than a stand-in can, and poses that are held cannot turn.
    let is_held = |hold: &Hold| match *hold {
        Hold::CamFromRig(_) | Hold::RigFromTarget(_) => true,
        Hold::Lens(camera) => flat.iter().any(|(id, _)| id.index() == camera.index()),
        Hold::LensParam(camera, param) => {
            param >= 4 && flat.iter().any(|(id, _)| id.index() == camera.index())
        }
        _ => false,
    };
    let says_more = !options.priors.is_empty() || options.holds.iter().any(is_held);
    if flat.is_empty() || options.rejection != Rejection::None || says_more {
        return None;
    }
    let mut scene = seed.clone();
    for &(id, camera) in &flat {
        let params = [&camera.params[..4], &STEREOGRAPHIC].concat();
        let stand_in =
            Camera::new(Model::KannalaBrandt4(Default::default()), params, camera.image_size).ok()?;
        scene.rig.cameras[id].as_mut()?.camera = stand_in;
    }
    let is_of_flat =
        |hold: &Hold| matches!(*hold, Hold::LensParam(camera, _) if flat.iter().any(|(id, _)| *id == camera));
    let rough_options = AdjustOptions {
        holds: options.holds.iter().copied().filter(|hold| !is_of_flat(hold)).collect(),
        regularization: Regularization::Default,
        checkpoint: None,
        ..options.clone()
    };
    let (mut scene, counters) = solve_roughly(dataset, &scene, &rough_options).ok()?;
    let reference = scene.rig.reference()?;
    for &(id, camera) in &flat {
        let rig_camera = scene.rig.cameras[id].as_mut()?;
        let surface = Surface::new(camera, &rig_camera.camera)?;
        let beliefs = spline_regularization(dataset, &seed.rig, camera, options.regularization);
        let turn = Pose::from_rodrigues(surface.best_turn(&beliefs)?, Vector3::zeros());
        rig_camera.camera = Camera::new(camera.model, surface.params(&turn)?, camera.image_size).ok()?;
        rig_camera.cam_from_rig = turn * rig_camera.cam_from_rig;
    }
    // The rig turns with its reference.
    let turn = scene.rig.cameras[reference].as_ref()?.cam_from_rig;
    for (id, camera) in seed.rig.cameras.ids().zip(scene.rig.cameras.iter_mut()) {
        let Some(camera) = camera else { continue };
        camera.cam_from_rig =
            if id == reference { Pose::identity() } else { camera.cam_from_rig * turn.inverse() };
    }
    for pose in scene.rig_from_target.iter_mut().flatten() {
        *pose = turn * *pose;
    }
    Some(NearerSeed { scene, counters })
}

/// Tells whether a camera's lens has local support and nothing is known of it beyond its core.
fn is_flat(camera: &Camera) -> bool {
    camera.model.local_support().is_some() && camera.params[4..].iter().all(|param| *param == 0.0)
}

fn solve_roughly(
    dataset: &Dataset,
    scene: &Scene,
    options: &AdjustOptions,
) -> Result<(Scene, Counters), Error> {
    let mut rig = RigProblem::new(dataset, scene, options)?;
    rig.views.iter_mut().for_each(|(_, term)| term.set_loss(options.loss));
    let problem = rig.problem()?;
    // In residual variances, of which there are as many as rows.
    let decrease_below = DECREASE_BELOW * problem.observation_rows() as f64;
    // What a stand-in cannot follow is no reason for long steps.
    let first_damping = SolveOptions::default().first_damping;
    let solve_options = SolveOptions { first_damping, ..solve_options(options, decrease_below) };
    let solution = solve(&problem, &solve_options)?;
    Ok((rig.scene(dataset, scene, solution.values(&problem)), solution.counters))
}

/// The surface with which a lens follows its stand-in.
struct Surface<'a> {
    camera: &'a Camera,
    stand_in: &'a Camera,
    core: [f64; 4],
    /// The camera with a level surface.
    level: Camera,
    /// How far off the axis the stand-in is worth following, in radians.
    limit: f64,
}

impl<'a> Surface<'a> {
    fn new(camera: &'a Camera, stand_in: &'a Camera) -> Option<Self> {
        let core = [camera.params[0], camera.params[1], camera.params[2], camera.params[3]];
        let stereographic = Model::Stereographic(Default::default());
        let level = Camera::new(stereographic, core.to_vec(), camera.image_size).ok()?;
        Some(Self { camera, stand_in, core, level, limit: widest_angle(stand_in)? })
    }

    /// Returns the parameters of the lens for a camera that is the stand-in's after `turn`.
    fn params(&self, turn: &Pose) -> Option<Vec<f64>> {
        self.camera.model.following(self.core, &|ray| self.pixel(&back(turn), ray))
    }

    /// Returns where the stand-in sees a ray of the turned camera. A polynomial goes anywhere beyond what it
    /// was fitted to, so the surface is level there.
    fn pixel(&self, back: &Matrix3<f64>, ray: [f64; 3]) -> Option<[f64; 2]> {
        let there = Vector3::from(ray);
        let ray = back * there;
        let across = ray.x.hypot(ray.y);
        if across.atan2(ray.z) <= self.limit {
            return self.stand_in.project(&ray);
        }
        let (sine, cosine) = self.limit.sin_cos();
        let edge = Vector3::new(ray.x / across * sine, ray.y / across * sine, cosine);
        let seen = self.stand_in.project(&edge)?;
        let [there, here] = [self.level.project(&there)?, self.level.project(&(back.transpose() * edge))?];
        Some([seen[0] + there[0] - here[0], seen[1] + there[1] - here[1]])
    }

    /// Returns the turn, as a Rodrigues vector, that goes best with what is believed of the surface where the
    /// image shows it: Gauss-Newton with differences.
    fn best_turn(&self, beliefs: &[Belief]) -> Option<Vector3<f64>> {
        const STEPS: usize = 4;
        const DIFFERENCE_RAD: f64 = 1e-4;
        let mut turn = Vector3::zeros();
        for _ in 0..STEPS {
            // Differences are of the same knots.
            let seen = self.seen_knots(&turn)?;
            let here = self.residuals(beliefs, &seen, &turn)?;
            let mut columns = Vec::with_capacity(3);
            for axis in 0..3 {
                let moved = self.residuals(beliefs, &seen, &(turn + Vector3::ith(axis, DIFFERENCE_RAD)))?;
                let column = moved.iter().zip(&here).map(|(moved, here)| (moved - here) / DIFFERENCE_RAD);
                columns.push(column.collect::<Vec<f64>>());
            }
            let dot = |a: &[f64], b: &[f64]| -> f64 { a.iter().zip(b).map(|(a, b)| a * b).sum() };
            let normal = Matrix3::from_fn(|a, b| dot(&columns[a], &columns[b]));
            let gradient = Vector3::from_fn(|a, _| dot(&columns[a], &here));
            turn -= normal.cholesky()?.solve(&gradient);
        }
        Some(turn)
    }

    /// Tells of each knot whether the image shows it after a turn.
    fn seen_knots(&self, turn: &Vector3<f64>) -> Option<Vec<bool>> {
        let back = back(&Pose::from_rodrigues(*turn, Vector3::zeros()));
        let seen = std::cell::RefCell::new(Vec::new());
        let [right, bottom] = self.camera.image_size.map(f64::from);
        self.camera.model.following(self.core, &|ray| {
            let pixel = self.pixel(&back, ray);
            let is_inside =
                pixel.is_some_and(|[u, v]| (0.0..right).contains(&u) && (0.0..bottom).contains(&v));
            seen.borrow_mut().push(is_inside);
            pixel
        })?;
        Some(seen.into_inner())
    }

    /// Returns by how much the surface after a turn misses what is believed of its `seen` knots.
    fn residuals(&self, beliefs: &[Belief], seen: &[bool], turn: &Vector3<f64>) -> Option<Vec<f64>> {
        let mut params = self.params(&Pose::from_rodrigues(*turn, Vector3::zeros()))?;
        for (knot, is_seen) in params[4..].chunks_exact_mut(2).zip(seen) {
            if !is_seen {
                knot.fill(0.0);
            }
        }
        let sum = |belief: &Belief| -> f64 {
            belief.factors.iter().map(|&(column, factor)| factor * params[column]).sum::<f64>() - belief.mean
        };
        Some(
            beliefs
                .iter()
                .filter(|belief| belief.factors.iter().all(|(column, _)| *column >= 4))
                .map(sum)
                .collect(),
        )
    }
}

fn back(turn: &Pose) -> Matrix3<f64> {
    turn.rotation_matrix().transpose()
}

/// Returns the largest angle off the axis that the edge of the image sees, in radians.
fn widest_angle(camera: &Camera) -> Option<f64> {
    let [right, bottom] = camera.image_size.map(|size| f64::from(size) - 1.0);
    let shares = [0.0, 0.25, 0.5, 0.75, 1.0];
    let edge = shares.iter().flat_map(|share| {
        let (x, y) = (share * right, share * bottom);
        [[x, 0.0], [x, bottom], [0.0, y], [right, y]]
    });
    let angles = edge.filter_map(|pixel| camera.unproject(pixel)).map(|ray| ray.x.hypot(ray.y).atan2(ray.z));
    angles.reduce(f64::max)
}
