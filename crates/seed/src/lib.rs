//! A closed-form start for every unknown: lenses, rig and poses, with no focal length given.
//!
//! [`seed`] goes from corners to a [`Scene`] in five steps, each in a file of its own: what the
//! directions of the pixels tell of each pose, whatever the lens (`radial`); the lens profile and the
//! depths from all views of a camera (`profile`), with Zhang's closed form as a rival for narrow
//! lenses (`zhang`); the lens model and the poses together (`lens_fit`, `resection`, `bundle`); the
//! graph of cameras and targets over shared frames (`graph`); the poses of the frames (`rig`).
//!
//! Architecture invariant: nothing here is random, and what could not be used is returned, not logged.

mod average;
mod bundle;
mod clock_offset;
mod convert;
mod graph;
pub mod hand_eye;
mod intrinsics;
mod joint_lines;
mod kernel;
mod left_out;
mod lens_fit;
mod linear;
mod local_fit;
mod place;
pub mod planar_robot;
mod profile;
mod radial;
mod resection;
mod rig;
mod rig_bundle;
mod robust;
mod sighting;
mod subset;
mod three_point;
mod zhang;

use boresight_camera::kannala_brandt4::KannalaBrandt4;
use boresight_camera::{Camera, Model};
use boresight_data::{CameraId, Dataset, Id as _, Scene};

pub use clock_offset::{ClockOffset, clock_offset};
pub use convert::{ConvertError, Converted, ImpliedRotation, convert};
pub use joint_lines::{JointError, JointLines, joint_lines};
pub use left_out::LeftOut;
pub use place::place;
pub use three_point::{
    ThreePointError, ThreePointPose, ThreePointPoses, backward_project, three_point_poses,
    triangle_from_sides,
};

use crate::intrinsics::{CameraSeed, seed_camera, seed_known_camera};
use crate::sighting::Sighting;

/// How a seed is made.
#[derive(Clone, Debug, PartialEq)]
pub struct SeedOptions {
    /// The lens model of all cameras, or one for each camera.
    pub models: Vec<Model>,
    /// A camera with fewer usable views is left out.
    pub min_views: usize,
    /// A view with fewer points is left out; at least 4, below which no pose is determined.
    pub min_points: usize,
    /// At most this many views of a camera, the most different ones, determine its lens.
    pub lens_views: usize,
    /// At most this many points of each of them.
    pub lens_points_per_view: usize,
    /// At most this many steps refine lens and poses together.
    pub lens_steps: usize,
    /// The lenses that are known; empty knows none. Four points are enough for their views.
    pub known: Vec<(CameraId, Camera)>,
}

impl Default for SeedOptions {
    fn default() -> Self {
        Self {
            models: vec![Model::OpenCv8(Default::default())],
            min_views: 3,
            min_points: 6,
            lens_views: 30,
            lens_points_per_view: 80,
            lens_steps: 10,
            known: Vec::new(),
        }
    }
}

/// What a lens with local support is fitted to: a lens that sees beyond 90 degrees.
const STAND_IN: Model = Model::KannalaBrandt4(KannalaBrandt4);

impl SeedOptions {
    fn model_of(&self, camera: CameraId) -> Model {
        self.models[if self.models.len() == 1 { 0 } else { camera.index() }]
    }

    /// Returns the lens of a camera, if it is known.
    fn known(&self, camera: CameraId) -> Option<&Camera> {
        self.known.iter().find(|(known, _)| *known == camera).map(|(_, lens)| lens)
    }
}

/// A start for the adjustment.
#[derive(Clone, Debug, PartialEq)]
pub struct Seed {
    /// What is believed: lenses, rig, target poses. Target shapes start flat.
    pub scene: Scene,
    /// What could not be used, and why: facts about cameras first, then about views, in their order.
    pub left_out: Vec<LeftOut>,
}

/// What can keep a seed from being made.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The dataset has no view.
    #[error("the dataset has {cameras} cameras and {frames} frames, but no view")]
    NoViews {
        /// The number of cameras.
        cameras: usize,
        /// The number of frames.
        frames: usize,
    },
    /// The number of lens models fits neither one for all nor one for each camera.
    #[error("{found} lens models are given for {cameras} cameras; give one for all or one for each")]
    ModelCount {
        /// How many are given.
        found: usize,
        /// The number of cameras.
        cameras: usize,
    },
    /// No camera has enough usable views; the one with most is named.
    #[error("camera {camera} has {found} usable views; {need} are needed")]
    TooFewViews {
        /// The camera's name.
        camera: String,
        /// How many of its views are usable.
        found: usize,
        /// How many it takes.
        need: usize,
    },
    /// A camera's seed shows too little of its image to fit the lens model to.
    #[error("the seed of camera {camera} sees too little of its image for lens model {model}")]
    NoLocalFit {
        /// The camera's name.
        camera: String,
        /// The lens model.
        model: Model,
    },
    /// No camera could be calibrated.
    #[error("none of the {cameras} cameras could be calibrated: {}", reasons.join("; "))]
    NoUsableCamera {
        /// The number of cameras.
        cameras: usize,
        /// Why, camera by camera.
        reasons: Vec<String>,
    },
}

/// Returns a start for every unknown of `dataset`, and what it had to leave out.
///
/// The largest group of cameras that are connected by shared frames is kept; its first camera is the
/// reference. Every observation of every kept view projects in the scene that is returned.
pub fn seed(dataset: &Dataset, options: &SeedOptions) -> Result<Seed, Error> {
    let n_cameras = dataset.cameras.len();
    if dataset.views.is_empty() {
        return Err(Error::NoViews { cameras: n_cameras, frames: dataset.frames.len() });
    }
    if options.models.len() != 1 && options.models.len() != n_cameras {
        return Err(Error::ModelCount { found: options.models.len(), cameras: n_cameras });
    }
    let mut left_out = Vec::new();
    let mut sightings: Vec<Vec<Sighting>> = vec![Vec::new(); n_cameras];
    for (view_idx, view) in dataset.views.iter().enumerate() {
        let min_points = if options.known(view.camera).is_some() { 4 } else { options.min_points.max(4) };
        match Sighting::new(view_idx, view, &dataset.targets[view.target], min_points) {
            Ok(sighting) => sightings[view.camera.index()].push(sighting),
            Err(fact) => left_out.push(fact),
        }
    }
    let mut cameras: Vec<Option<CameraSeed>> = Vec::with_capacity(n_cameras);
    let mut camera_facts = Vec::new();
    for (id, info) in dataset.cameras.enumerate() {
        let model = options.model_of(id);
        // A lens with local support has too many parameters to be found from little; it is fitted last.
        let first = if model.local_support().is_some() { STAND_IN } else { model };
        let of_camera = &sightings[id.index()];
        let seeded = match options.known(id) {
            Some(lens) => seed_known_camera(id, lens, of_camera, &mut left_out),
            None => seed_camera(id, info, first, of_camera, options, &mut left_out),
        };
        cameras.push(seeded.map_err(|fact| camera_facts.push(fact)).ok());
    }
    if cameras.iter().all(Option::is_none) {
        return Err(nothing_usable(dataset, &camera_facts));
    }
    let mut scene = rig::assemble(dataset, &sightings, cameras, &mut camera_facts, &mut left_out);
    for (id, camera) in dataset.cameras.ids().zip(scene.rig.cameras.iter_mut()) {
        let (model, Some(camera)) = (options.model_of(id), camera) else { continue };
        if model.local_support().is_some() {
            camera.camera = local_fit::camera_from_lens(model, &camera.camera)
                .ok_or_else(|| Error::NoLocalFit { camera: dataset.cameras[id].name.clone(), model })?;
        }
    }
    left_out.sort_by_key(LeftOut::view_idx);
    camera_facts.append(&mut left_out);
    Ok(Seed { scene, left_out: camera_facts })
}

/// Returns the error that says why no camera is left.
fn nothing_usable(dataset: &Dataset, facts: &[LeftOut]) -> Error {
    let name = |id: CameraId| dataset.cameras[id].name.clone();
    let few = facts.iter().filter_map(|fact| match *fact {
        LeftOut::TooFewViews { camera, found, need } => Some((camera, found, need)),
        _ => None,
    });
    let few: Vec<_> = few.collect();
    if few.len() == facts.len()
        && let Some(&(camera, found, need)) = few.iter().max_by_key(|(_, found, _)| *found)
    {
        return Error::TooFewViews { camera: name(camera), found, need };
    }
    let reasons = facts.iter().map(|fact| fact.describe(dataset)).collect();
    Error::NoUsableCamera { cameras: dataset.cameras.len(), reasons }
}
