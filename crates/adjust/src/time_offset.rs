//! Cameras and rows that are late: told from a target that moves, jointly with everything else.
//!
//! All images of a frame are taken as of one instant. Where a camera took its own later, it saw the target where that had
//! moved to by then, and its chain has one link more, between rig and target: the motion of the target in so many seconds
//! ([`FrameMotion`]). The seconds are one more unknown of the camera, with a sigma like any other. Where it took its rows
//! one after another, the seconds are more the further down a point was seen, by the camera's line delay.
//!
//! The motion is that of the solution itself: around each frame, the polynomial in time through the poses of its
//! neighbours, in the tangent space of its own pose. It is taken from a solution and kept while the next is sought, until
//! the times stay. Then the poses of all frames, the motion between them and what each camera saw go together.

use std::collections::{BTreeMap, BTreeSet};

use boresight_data::{Calibration, CameraId, Dataset, FrameId, FrameMotion, Id as _, IdVec, Scene, View};
use boresight_geometry::nalgebra::DMatrix;
use boresight_geometry::{Pose, Vector3, Vector6};

use crate::adjust::adjust;
use crate::error::Error;
use crate::options::{AdjustOptions, Clock};
use crate::rejection::median;

/// How many frames on each side of a frame tell its motion.
const NEIGHBOURS: usize = 2;
/// Frames further apart than this many median intervals are no neighbours.
const LONGEST_GAP: f64 = 2.5;
/// Frames further apart than this are no neighbours, in seconds: a hand's motion has turned by then.
const LONGEST_GAP_S: f64 = 0.6;
/// The least number of frames with a motion that tell a camera's time: its own, and for an offset those that it shares with
/// others whose offset is known.
pub const LEAST_FRAMES: usize = 6;
/// How often the motion is taken anew.
const MAX_ROUNDS: usize = 6;
/// Times stay when they change by less than this share of their sigma.
const SETTLED_SIGMAS: f64 = 0.05;
/// What is only looked at stays when it changes by less than this many of its sigmas.
const LOOKED_AT_SIGMAS: f64 = 2.0;
/// Times stay, too, when they change by less than this many seconds over an image.
const SETTLED_S: f64 = 1e-7;
/// Where no time is unknown, the motion stays when the RMS changes by less than this share.
const SETTLED_RMS: f64 = 1e-5;

/// How late a camera's images are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimeOffset {
    /// The camera.
    pub camera: CameraId,
    /// How much later than the reference camera's its images of a frame were taken, in seconds.
    pub offset_s: f64,
    /// The standard deviation of the offset, with the noise that the residuals show.
    pub sigma_s: f64,
    /// How far the target moves in that time in the camera's images: the median over frames, in pixels.
    pub shift_px: f64,
}

/// How late a camera's rows are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LineDelay {
    /// The camera.
    pub camera: CameraId,
    /// How much later than the row above it each row was taken, in seconds.
    pub line_delay_s: f64,
    /// The standard deviation of the delay, with the noise that the residuals show.
    pub sigma_s: f64,
    /// The number of rows of an image.
    pub rows: u32,
    /// How far the target moves in the camera's images from its first to its last row: the median over frames, in pixels.
    pub shift_px: f64,
}

/// How well times are sought.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TimeSearch {
    /// Well enough to tell whether they matter; most do not, and one adjustment says so.
    Look,
    /// Until they stay.
    Estimate,
}

/// A calibration in which cameras and rows may be late.
#[derive(Clone, Debug)]
pub struct Timed {
    /// The calibration; its scene has the times and the motion.
    pub calibration: Calibration,
    /// The offsets of the cameras of which they were wanted and the data tell them.
    pub offsets: Vec<TimeOffset>,
    /// The line delays likewise.
    pub line_delays: Vec<LineDelay>,
}

/// A delay is not told that leaves the time from the first to the last row less well known than this, in seconds: sensors
/// take 5 to 60 ms.
pub const LOOSEST_READOUT_S: f64 = 0.01;

impl LineDelay {
    /// Returns the sigma of the time from the first to the last row, in seconds.
    pub fn readout_sigma_s(&self) -> f64 {
        f64::from(self.rows) * self.sigma_s
    }

    /// Tells whether the images say anything of it: where nothing moves, they do not.
    pub fn is_told(&self) -> bool {
        self.readout_sigma_s() <= LOOSEST_READOUT_S
    }
}

impl Timed {
    /// Returns the times that were estimated.
    pub fn clocks(&self) -> Vec<Clock> {
        let offsets = self.offsets.iter().map(|offset| Clock::Offset(offset.camera));
        offsets.chain(self.line_delays.iter().map(|delay| Clock::LineDelay(delay.camera))).collect()
    }
}

/// Adjusts `seed` with those `wanted` times as unknowns that the data tell, from `solved`, a calibration without.
/// Line delays that the scene states are kept.
///
/// `None` where none is told and none stated: a robot, frames without times, or too few frames close enough in time, which
/// for an offset cameras must share. The reference camera has no offset.
pub fn adjust_times(
    dataset: &Dataset,
    seed: &Scene,
    solved: &Calibration,
    (wanted, search): (&[Clock], TimeSearch),
    options: &AdjustOptions,
) -> Result<Option<Timed>, Error> {
    if seed.robot.is_some() {
        return Ok(None);
    }
    // Without offsets, frames of a fast target may have been left out; they have their seed's poses.
    let mut scene = solved.scene.clone();
    for (pose, seeded) in scene.rig_from_target.iter_mut().zip(&seed.rig_from_target) {
        *pose = pose.or(*seeded);
    }
    scene.motion = motion(dataset, &scene);
    // What is not modelled yet makes residuals larger than noise, but nothing makes them smaller.
    let noise_factor = solved.uncertainty.noise_factor.min(1.0);
    let clocks = told(dataset, &scene, noise_factor, wanted);
    let is_stated = |camera: &boresight_data::RigCamera| camera.line_delay_s != 0.0;
    if clocks.is_empty() && !scene.rig.cameras.iter().flatten().any(is_stated) {
        return Ok(None);
    }
    let options = AdjustOptions { clocks: clocks.clone(), ..options.clone() };
    let settled_sigmas = match search {
        TimeSearch::Look => LOOKED_AT_SIGMAS,
        TimeSearch::Estimate => SETTLED_SIGMAS,
    };
    // What was estimated already is told again beside the others, and stays from the start.
    let start_s = |clock: &Clock| {
        let camera = |id: CameraId| scene.rig.cameras[id].as_ref();
        match *clock {
            Clock::Offset(id) => camera(id).map_or(0.0, |camera| camera.time_offset_s),
            Clock::LineDelay(id) => camera(id).map_or(0.0, |camera| camera.line_delay_s),
        }
    };
    let mut before = (clocks.iter().map(start_s).collect::<Vec<f64>>(), f64::INFINITY);
    let mut rounds = 0;
    loop {
        rounds += 1;
        let calibration = adjust(dataset, &scene, &options, None)?;
        let rms_px = calibration.rms_px;
        let (mut offsets, mut line_delays) = (Vec::new(), Vec::new());
        let (mut times_s, mut limits_s) = (Vec::new(), Vec::new());
        for clock in &clocks {
            match *clock {
                Clock::Offset(camera) => {
                    let Some(found) = offset(dataset, &calibration, camera) else { continue };
                    times_s.push(found.offset_s);
                    limits_s.push((settled_sigmas * found.sigma_s).max(SETTLED_S));
                    offsets.push(found);
                }
                Clock::LineDelay(camera) => {
                    let Some(found) = line_delay(dataset, &calibration, camera) else { continue };
                    times_s.push(found.line_delay_s);
                    let least_s = SETTLED_S / f64::from(found.rows.max(1));
                    limits_s.push((settled_sigmas * found.sigma_s).max(least_s));
                    line_delays.push(found);
                }
            }
        }
        let are_known = times_s.len() == clocks.len();
        let changes = times_s.iter().zip(&before.0).zip(&limits_s);
        let is_settled = are_known
            && changes.into_iter().all(|((now, before), limit)| (now - before).abs() < *limit)
            && (!clocks.is_empty() || (before.1 - rms_px).abs() < SETTLED_RMS * rms_px);
        // Delays that are not told may be anything, and nothing can start from there.
        let are_told = are_known && line_delays.iter().all(LineDelay::is_told);
        if is_settled || rounds == MAX_ROUNDS || !are_told {
            return Ok(Some(Timed { calibration, offsets, line_delays }));
        }
        before = (times_s, rms_px);
        let last = std::mem::replace(&mut scene, calibration.scene);
        for (pose, last) in scene.rig_from_target.iter_mut().zip(&last.rig_from_target) {
            *pose = pose.or(*last);
        }
        scene.motion = motion(dataset, &scene);
    }
}

/// Returns how many views of a camera are of a frame whose motion `scene` tells.
pub fn views_in_motion(dataset: &Dataset, scene: &Scene, camera: CameraId) -> usize {
    let motion = motion(dataset, scene);
    dataset.views.iter().filter(|view| view.camera == camera && motion[view.frame].is_some()).count()
}

/// Returns those of the wanted times that the data can tell, whose noise is so many times what corners state.
fn told(dataset: &Dataset, scene: &Scene, noise_factor: f64, wanted: &[Clock]) -> Vec<Clock> {
    let in_step = told_cameras(dataset, scene);
    let is_told = |clock: &&Clock| match **clock {
        Clock::Offset(camera) => in_step.contains(&camera),
        Clock::LineDelay(camera) => {
            let is_moving = |view: &&View| view.camera == camera && scene.motion[view.frame].is_some();
            scene.rig.cameras[camera].is_some()
                && dataset.views.iter().filter(is_moving).count() >= LEAST_FRAMES
                && line_delay_information(dataset, scene, camera) > (noise_factor / LOOSEST_READOUT_S).powi(2)
        }
    };
    wanted.iter().filter(is_told).copied().collect()
}

/// Returns at most how much a camera's views tell of the time from its first to its last row, in s⁻²: what they would if
/// all corners were in the last row, half that time after the middle one, with the noise that they state, and all else
/// were known.
fn line_delay_information(dataset: &Dataset, scene: &Scene, camera: CameraId) -> f64 {
    let information = |view: &View| {
        let cam_from_rig = scene.rig.cameras[camera].as_ref()?.cam_from_rig;
        let (rig_from_target, motion) = (scene.rig_from_target[view.frame]?, scene.motion[view.frame]?);
        let ends = [0.0, LOOSEST_READOUT_S].map(|time_s| motion.after(time_s) * rig_from_target);
        let rate_px =
            shift_px(dataset, scene, view, ends.map(|pose| cam_from_rig * pose))? / LOOSEST_READOUT_S;
        Some(view.observations.iter().map(|seen| (0.5 * rate_px / seen.sigma_px).powi(2)).sum::<f64>())
    };
    dataset.views.iter().filter(|view| view.camera == camera).filter_map(information).sum()
}

/// Returns the sigma of a camera's time in seconds; `None` if it is not known.
fn sigma_of(dataset: &Dataset, calibration: &Calibration, camera: CameraId, time: &str) -> Option<f64> {
    calibration.uncertainty.sigma(&format!("{}.{time}", dataset.cameras[camera].name))
}

/// Returns the median over a camera's views of how far the target moves in their images between two rows.
fn median_shift_px(
    dataset: &Dataset,
    scene: &Scene,
    camera: CameraId,
    ends: impl Fn(&View) -> Option<[Pose; 2]>,
) -> f64 {
    let views = dataset.views.iter().filter(|view| view.camera == camera);
    let mut shifts: Vec<f64> = views.filter_map(|view| shift_px(dataset, scene, view, ends(view)?)).collect();
    median(&mut shifts)
}

/// Returns a camera's offset; `None` if its sigma is not known.
fn offset(dataset: &Dataset, calibration: &Calibration, camera: CameraId) -> Option<TimeOffset> {
    let scene = &calibration.scene;
    let own = scene.rig.cameras[camera].as_ref()?;
    let sigma_s = sigma_of(dataset, calibration, camera, "time_offset_s")?;
    let shift_px = median_shift_px(dataset, scene, camera, |view| {
        (*scene.motion.get(view.frame)?)?;
        let in_time = own.cam_from_rig * scene.rig_from_target[view.frame]?;
        Some([in_time, scene.cam_from_first(camera, view.frame)?])
    });
    Some(TimeOffset { camera, offset_s: own.time_offset_s, sigma_s, shift_px })
}

/// Returns a camera's line delay; `None` if its sigma is not known.
fn line_delay(dataset: &Dataset, calibration: &Calibration, camera: CameraId) -> Option<LineDelay> {
    let scene = &calibration.scene;
    let own = scene.rig.cameras[camera].as_ref()?;
    let sigma_s = sigma_of(dataset, calibration, camera, "line_delay_s")?;
    let shift_px = median_shift_px(dataset, scene, camera, |view| {
        (*scene.motion.get(view.frame)?)?;
        let rows = view.observations.iter().map(|seen| seen.pixel[1]);
        let [first, last] = rows
            .fold([f64::INFINITY, f64::NEG_INFINITY], |[least, most], row| [least.min(row), most.max(row)]);
        let at_row = |row: f64| scene.cam_from_first_at_row(camera, view.frame, row);
        Some([at_row(first)?, at_row(last)?])
    });
    let rows = own.camera.image_size[1];
    Some(LineDelay { camera, line_delay_s: own.line_delay_s, sigma_s, rows, shift_px })
}

/// Returns how far the middle of what a view sees moves in its image between two poses `cam_from_first`.
fn shift_px(dataset: &Dataset, scene: &Scene, view: &View, cam_from_first: [Pose; 2]) -> Option<f64> {
    let camera = scene.rig.cameras[view.camera].as_ref()?;
    let belief = &scene.targets[view.target];
    let target = &dataset.targets[view.target];
    let points = view.observations.iter().map(|seen| target.point(seen.point, &belief.shape_m));
    let middle = points.sum::<Vector3<f64>>() / view.observations.len().max(1) as f64;
    let middle_in_first = belief.first_from_target * middle;
    let [from, to] = cam_from_first.map(|pose| camera.camera.project(&(pose * middle_in_first)));
    let (from, to) = (from?, to?);
    Some((to[0] - from[0]).hypot(to[1] - from[1]))
}

/// Returns the cameras whose offsets the data can tell: those that share enough moving frames with the reference camera, or
/// with others that do.
fn told_cameras(dataset: &Dataset, scene: &Scene) -> Vec<CameraId> {
    let Some(reference) = scene.rig.reference() else { return Vec::new() };
    let mut seen_by: BTreeMap<FrameId, BTreeSet<CameraId>> = BTreeMap::new();
    for view in &dataset.views {
        if scene.motion[view.frame].is_some() && scene.rig.cameras[view.camera].is_some() {
            seen_by.entry(view.frame).or_default().insert(view.camera);
        }
    }
    let mut told = BTreeSet::from([reference]);
    loop {
        let shared = |camera: CameraId| {
            let both = |cameras: &&BTreeSet<CameraId>| {
                cameras.contains(&camera) && cameras.iter().any(|other| told.contains(other))
            };
            seen_by.values().filter(both).count()
        };
        let more: Vec<CameraId> = dataset
            .cameras
            .ids()
            .filter(|camera| !told.contains(camera) && shared(*camera) >= LEAST_FRAMES)
            .collect();
        if more.is_empty() {
            break;
        }
        told.extend(more);
    }
    told.into_iter().filter(|camera| *camera != reference).collect()
}

/// Returns how the first target moved in each frame that has a time, and two neighbours at least.
fn motion(dataset: &Dataset, scene: &Scene) -> IdVec<FrameId, Option<FrameMotion>> {
    let mut timed: Vec<(i64, FrameId, Pose)> = dataset
        .frames
        .enumerate()
        .filter_map(|(id, frame)| Some((frame.time_ns?, id, (*scene.rig_from_target.get(id)?)?)))
        .collect();
    timed.sort_by_key(|(time_ns, id, _)| (*time_ns, id.index()));
    timed.dedup_by_key(|(time_ns, ..)| *time_ns);
    let seconds = |from: usize, to: usize| timed[to].0.saturating_sub(timed[from].0) as f64 * 1e-9;
    let mut intervals: Vec<f64> = (1..timed.len()).map(|i| seconds(i - 1, i)).collect();
    let longest_s = (LONGEST_GAP * median(&mut intervals)).min(LONGEST_GAP_S);
    let mut motion: IdVec<FrameId, Option<FrameMotion>> = dataset.frames.ids().map(|_| None).collect();
    for (i, (_, id, pose)) in timed.iter().enumerate() {
        let is_near = |one: usize, next: usize| seconds(one, next) <= longest_s;
        let before = (1..=NEIGHBOURS.min(i)).take_while(|k| is_near(i - k, i - k + 1)).count();
        let after =
            (1..=NEIGHBOURS.min(timed.len() - 1 - i)).take_while(|k| is_near(i + k - 1, i + k)).count();
        // One neighbour alone would tell a velocity, and nothing of how it changes.
        if before + after < 2 {
            continue;
        }
        let from_here = pose.inverse();
        let nodes: Vec<(f64, Vector6<f64>)> = (i - before..=i + after)
            .filter(|other| *other != i)
            .map(|other| {
                let time_s = timed[other].0.saturating_sub(timed[i].0) as f64 * 1e-9;
                (time_s, (timed[other].2 * from_here).log())
            })
            .collect();
        motion[*id] = polynomial(&nodes);
    }
    motion
}

/// Returns the first two derivatives at zero of the polynomial through zero and the nodes.
fn polynomial(nodes: &[(f64, Vector6<f64>)]) -> Option<FrameMotion> {
    let n = nodes.len();
    // In units of the longest time, so that the powers are of one size.
    let unit_s = nodes.iter().map(|(time_s, _)| time_s.abs()).fold(0.0, f64::max);
    let powers = DMatrix::from_fn(n, n, |row, power| (nodes[row].0 / unit_s).powi(power as i32 + 1));
    let values = DMatrix::from_fn(n, 6, |row, column| nodes[row].1[column]);
    let coefficients = powers.lu().solve(&values)?;
    let row = |power: usize| Vector6::from_fn(|column, _| coefficients[(power - 1, column)]);
    Some(FrameMotion { velocity: row(1) / unit_s, acceleration: row(2) * 2.0 / (unit_s * unit_s) })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_polynomial_has_the_derivatives_of_what_it_passes() {
        let value = |t: f64| Vector6::repeat(0.7 * t - 1.3 * t * t + 0.4 * t * t * t - 0.2 * t.powi(4));
        let nodes = [-0.2, -0.1, 0.1, 0.3].map(|t| (t, value(t)));
        let found = polynomial(&nodes).unwrap();
        assert!((found.velocity - Vector6::repeat(0.7)).norm() < 1e-12, "{found:?}");
        assert!((found.acceleration - Vector6::repeat(-2.6)).norm() < 1e-11, "{found:?}");
    }

    #[test]
    fn frames_without_neighbours_have_no_motion() {
        let times_ms = [0, 100, 200, 300, 1200, 1300, 1400, 5000];
        let pose = |ms: i64| Pose::new(Pose::identity().rotation, Vector3::new(1e-3 * ms as f64, 0.0, 1.0));
        let frame = |ms: &i64| boresight_data::Frame { time_ns: Some(ms * 1_000_000), ..Default::default() };
        let dataset = Dataset { frames: times_ms.iter().map(frame).collect(), ..Dataset::default() };
        let rig_from_target = times_ms.iter().map(|ms| Some(pose(*ms))).collect();
        let scene = Scene { rig_from_target, ..Scene::default() };
        let found = motion(&dataset, &scene);
        let is_moving: Vec<bool> = found.iter().map(Option::is_some).collect();
        assert_eq!(is_moving, [true, true, true, true, true, true, true, false]);
        for motion in found.iter().flatten() {
            // A metre a second, without turning.
            assert!((motion.velocity - Vector6::new(0.0, 0.0, 0.0, 1.0, 0.0, 0.0)).norm() < 1e-9);
        }
    }
}
