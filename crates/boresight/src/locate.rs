//! Where an object of known points is: model-based backward projection, Eqs 8.15 and 8.16.
//!
//! Three points leave two to four poses, all of which are returned. Further points decide: every triangle
//! of a well-spread choice proposes its poses, the best are refined on all points, and points that fit
//! none are told.

use boresight_adjust::{Loss, ObjectPose, SeenPoint, assessed, object_pose};
use boresight_camera::Camera;
use boresight_data::{Finding, Severity};
use boresight_geometry::nalgebra::DMatrix;
use boresight_geometry::{Pose, Vector3};
use boresight_seed::three_point_poses;

use crate::robot_error::RobotError;

/// A point of an object.
#[derive(Clone, Debug, PartialEq)]
pub struct LocatePoint {
    /// Its name.
    pub name: String,
    /// Where it is in the object's frame, in metres.
    pub point_m: [f64; 3],
    /// Where it is seen; `None` asks where it would be.
    pub pixel: Option<[f64; 2]>,
}

/// A pose that explains the points.
#[derive(Clone, Debug, PartialEq)]
pub struct Candidate {
    /// The pose with its covariance, and the residuals of the points it rests on.
    pub pose: ObjectPose,
    /// The condition of the three-point equations; infinite where two poses merge. `None` where more
    /// points were used.
    pub condition: Option<f64>,
    /// For each point, in the order given: the predicted pixel, or `None` out of sight.
    pub predicted_px: Vec<Option<[f64; 2]>>,
    /// For each point, in the order given: whether the pose rests on it.
    pub is_used: Vec<bool>,
}

/// All poses that explain the points.
#[derive(Clone, Debug, PartialEq)]
pub struct Located {
    /// The poses: by misfit where more than three points decide, else the best determined first.
    pub candidates: Vec<Candidate>,
    /// What is doubtful.
    pub findings: Vec<Finding>,
}

/// A rival whose chi-squared is this little above the best one's is not ruled out: three sigmas.
const CHI2_MARGIN: f64 = 9.0;

/// Condition numbers above this mean that two poses nearly merge.
const CONDITION_LIMIT: f64 = 100.0;

/// A triangle less high than this share of its longest side is thin.
const THIN: f64 = 0.05;

/// A residual beyond this many sigmas is no noise.
const OUTLYING_SIGMAS: f64 = 5.0;

/// Triangles are chosen from at most this many points.
const MOST_CORNERS: usize = 8;

/// At most this many hypotheses are refined.
const MOST_REFINED: usize = 12;

/// Finds all poses of an object, for pixels of a sigma and a lens of a covariance, where that is known.
pub fn locate(
    camera: &Camera,
    lens_covariance: Option<&DMatrix<f64>>,
    points: &[LocatePoint],
    sigma_px: f64,
) -> Result<Located, RobotError> {
    if !(1e-6..=1e3).contains(&sigma_px) {
        let need = "the standard deviation of a pixel must be positive";
        return Err(RobotError::BadOption { option: "sigma_px", value: sigma_px, need });
    }
    let mut seen = Vec::new();
    let mut rays = Vec::new();
    for (i, point) in points.iter().enumerate() {
        let Some(pixel) = point.pixel else { continue };
        let no_direction = || RobotError::NoDirection { name: point.name.clone(), pixel };
        rays.push(camera.unproject(pixel).ok_or_else(no_direction)?);
        seen.push((i, SeenPoint { point_m: point.point_m, pixel, sigma_px }));
    }
    let (indices, seen): (Vec<usize>, Vec<SeenPoint>) = seen.into_iter().unzip();
    let search = Search { camera, lens_covariance, seen: &seen, rays: &rays, sigma_px };
    let mut findings = Vec::new();
    let found = match seen.len() {
        0..3 => return Err(RobotError::TooFew { what: "seen points", found: seen.len(), need: 3 }),
        3 => search.three_points(&mut findings)?,
        _ => search.many_points()?,
    };
    let candidates = found.into_iter().map(|(pose, condition, kept)| {
        let predicted_px = points
            .iter()
            .map(|point| camera.project(&(pose.cam_from_object * Vector3::from(point.point_m))))
            .collect();
        let mut is_used = vec![false; points.len()];
        indices.iter().zip(&kept).for_each(|(&i, &kept)| is_used[i] = kept);
        Candidate { pose, condition, predicted_px, is_used }
    });
    let candidates: Vec<Candidate> = candidates.collect();
    judge(points, &candidates, sigma_px, &mut findings);
    Ok(Located { candidates, findings })
}

type FoundPose = (ObjectPose, Option<f64>, Vec<bool>);

struct Search<'a> {
    camera: &'a Camera,
    lens_covariance: Option<&'a DMatrix<f64>>,
    seen: &'a [SeenPoint],
    rays: &'a [Vector3<f64>],
    sigma_px: f64,
}

impl Search<'_> {
    fn point(&self, i: usize) -> Vector3<f64> {
        Vector3::from(self.seen[i].point_m)
    }

    /// Returns all poses of exactly three points, the best determined first.
    fn three_points(&self, findings: &mut Vec<Finding>) -> Result<Vec<FoundPose>, RobotError> {
        let points = [0, 1, 2].map(|i| self.point(i));
        let poses = three_point_poses(&[0, 1, 2].map(|i| self.rays[i]), &points)?;
        let (a, b) = (points[1] - points[0], points[2] - points[0]);
        let longest = a.norm().max(b.norm()).max((a - b).norm());
        let height = a.cross(&b).norm() / (longest * longest);
        if height < THIN {
            findings.push(Finding {
                code: "thin-triangle".to_owned(),
                severity: Severity::Caution,
                place: "points".to_owned(),
                message: format!("the triangle is {height:.3} as high as its longest side"),
                measured: Some(height),
                limit: Some(THIN),
                fix: "choose points that span a wider triangle".to_owned(),
            });
        }
        let mut found = Vec::new();
        for pose in poses.as_slice() {
            // A pose so near a merger that its covariance has no inverse is told as one without.
            if let Ok(known) = assessed(self.camera, self.seen, pose.cam_from_target, self.lens_covariance) {
                found.push((known, Some(pose.condition), vec![true; 3]));
            }
        }
        if found.is_empty() {
            return Err(RobotError::NoSolution { tried: 1 });
        }
        let spread = |found: &FoundPose| found.0.origin_covariance().fixed_view::<3, 3>(3, 3).trace();
        found.sort_by(|a, b| spread(a).total_cmp(&spread(b)));
        Ok(found)
    }

    /// Returns the poses that more than three points leave, the best first.
    fn many_points(&self) -> Result<Vec<FoundPose>, RobotError> {
        let mut hypotheses: Vec<(f64, Pose)> = Vec::new();
        let corners = self.spread_corners();
        let mut tried = 0;
        let mut last_error = None;
        for (a, &i) in corners.iter().enumerate() {
            for (b, &j) in corners.iter().enumerate().skip(a + 1) {
                for &k in &corners[b + 1..] {
                    tried += 1;
                    let rays = [i, j, k].map(|i| self.rays[i]);
                    match three_point_poses(&rays, &[i, j, k].map(|i| self.point(i))) {
                        Ok(poses) => hypotheses.extend(
                            poses
                                .as_slice()
                                .iter()
                                .map(|pose| (self.cost(&pose.cam_from_target), pose.cam_from_target)),
                        ),
                        Err(error) => last_error = Some(error),
                    }
                }
            }
        }
        hypotheses.retain(|(cost, _)| cost.is_finite());
        hypotheses.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut found: Vec<FoundPose> = Vec::new();
        let mut failure = None;
        for (_, start) in distinct(&hypotheses) {
            match self.refined(&start) {
                Ok(pose)
                    if found
                        .iter()
                        .all(|known| !is_same(&known.0.cam_from_object, &pose.0.cam_from_object)) =>
                {
                    found.push(pose);
                }
                Ok(_) => {}
                Err(error) => failure = Some(error),
            }
        }
        // A pose that meets all points badly must not beat one that meets all but one well, so a point
        // that is far off costs no more than the cap.
        let kept = |found: &FoundPose| found.2.iter().filter(|kept| **kept).count();
        let cost = |found: &FoundPose| self.cost(&found.0.cam_from_object);
        found.sort_by(|a, b| cost(a).total_cmp(&cost(b)).then(kept(b).cmp(&kept(a))));
        let Some(best) = found.first() else {
            return Err(match (failure, last_error) {
                (Some(failure), _) => failure.into(),
                (None, Some(error)) if hypotheses.is_empty() => error.into(),
                _ => RobotError::NoSolution { tried },
            });
        };
        // Rivals that the data rule out are none.
        let (most, chi2) = (kept(best), best.0.chi2);
        let scale = (chi2 / best.0.degrees_of_freedom.max(1) as f64).max(1.0);
        found.retain(|rival| kept(rival) == most && rival.0.chi2 - chi2 <= 4.0 * CHI2_MARGIN * scale);
        Ok(found)
    }

    /// Refines a pose on all points, then without those that it does not explain.
    fn refined(&self, start: &Pose) -> Result<FoundPose, boresight_adjust::ObjectPoseError> {
        let n = self.seen.len();
        let robust = if n >= 6 { Loss::Cauchy { sigmas: 2.385 } } else { Loss::None };
        let first = object_pose(self.camera, self.seen, start, robust, None)?;
        let lengths: Vec<f64> = first.residuals_px.iter().map(|[u, v]| u.hypot(*v) / self.sigma_px).collect();
        let mut sorted = lengths.clone();
        sorted.sort_by(f64::total_cmp);
        // Of a two-dimensional normal residual the median length is 1.18 sigmas.
        let scale = (sorted[n / 2] / 1.18).max(1.0);
        let mut kept: Vec<bool> = lengths.iter().map(|length| *length <= OUTLYING_SIGMAS * scale).collect();
        let n_kept = kept.iter().filter(|kept| **kept).count();
        if n_kept < 4 || n < 6 {
            kept = vec![true; n];
        }
        let chosen: Vec<SeenPoint> =
            self.seen.iter().zip(&kept).filter(|(_, kept)| **kept).map(|(point, _)| *point).collect();
        let pose =
            object_pose(self.camera, &chosen, &first.cam_from_object, Loss::None, self.lens_covariance)?;
        Ok((pose, None, kept))
    }

    /// Returns the sum of squared residuals in sigmas, large ones capped, or infinity out of sight.
    fn cost(&self, cam_from_object: &Pose) -> f64 {
        let cap = (0.01 * f64::from(self.camera.image_size[0].max(100)) / self.sigma_px).powi(2);
        let one = |point: &SeenPoint| {
            let pixel = self.camera.project(&(*cam_from_object * Vector3::from(point.point_m)));
            let Some([u, v]) = pixel else { return f64::INFINITY };
            (((u - point.pixel[0]).powi(2) + (v - point.pixel[1]).powi(2)) / self.sigma_px.powi(2)).min(cap)
        };
        self.seen.iter().map(one).sum()
    }

    /// Returns points that are far from one another in the image.
    fn spread_corners(&self) -> Vec<usize> {
        let n = self.seen.len();
        if n <= MOST_CORNERS {
            return (0..n).collect();
        }
        let distance = |i: usize, j: usize| (self.rays[i] - self.rays[j]).norm();
        let mut chosen = vec![0];
        while chosen.len() < MOST_CORNERS {
            let apart = |i: usize| chosen.iter().map(|&j| distance(i, j)).fold(f64::INFINITY, f64::min);
            let farthest = (0..n).max_by(|&i, &j| apart(i).total_cmp(&apart(j)));
            chosen.extend(farthest);
        }
        chosen.sort_unstable();
        chosen.dedup();
        chosen
    }
}

/// Returns the best hypotheses that are not the same.
fn distinct(hypotheses: &[(f64, Pose)]) -> Vec<(f64, Pose)> {
    let mut chosen: Vec<(f64, Pose)> = Vec::new();
    for hypothesis in hypotheses {
        let near = |known: &(f64, Pose)| {
            let between = known.1.inverse() * hypothesis.1;
            between.angle() < 0.05 && between.translation.norm() < 0.02 * known.1.translation.norm()
        };
        if chosen.len() < MOST_REFINED && !chosen.iter().any(near) {
            chosen.push(*hypothesis);
        }
    }
    chosen
}

fn is_same(a: &Pose, b: &Pose) -> bool {
    let between = a.inverse() * *b;
    between.angle() < 1e-4 && between.translation.norm() < 1e-4 * a.translation.norm()
}

/// Adds what is doubtful about the poses.
fn judge(points: &[LocatePoint], candidates: &[Candidate], sigma_px: f64, findings: &mut Vec<Finding>) {
    let Some(best) = candidates.first() else { return };
    let mut add = |code: &str, place: &str, message: String, measured: f64, limit: f64, fix: &str| {
        findings.push(Finding {
            code: code.to_owned(),
            severity: Severity::Caution,
            place: place.to_owned(),
            message,
            measured: Some(measured),
            limit: Some(limit),
            fix: fix.to_owned(),
        });
    };
    if let Some(rival) = candidates.get(1) {
        let between = best.pose.cam_from_object.inverse() * rival.pose.cam_from_object;
        let apart_mm =
            1e3 * (best.pose.cam_from_object.translation - rival.pose.cam_from_object.translation).norm();
        let message = format!(
            "{} poses explain the points; the first two differ by {apart_mm:.2} mm and {:.2} degrees",
            candidates.len(),
            between.angle().to_degrees()
        );
        let fix = "add a fourth point off the plane of the others, or say which pose is possible";
        add("ambiguous-pose", "pose", message, candidates.len() as f64, 1.0, fix);
    }
    for (i, candidate) in candidates.iter().enumerate() {
        if let Some(condition) = candidate.condition.filter(|condition| *condition > CONDITION_LIMIT) {
            let message =
                format!("this pose nearly merges with another: its equations have condition {condition:.1e}");
            let fix = "look at the points from further aside: a frontal view of three points is the worst";
            add("merging-poses", &format!("pose {}", i + 1), message, condition, CONDITION_LIMIT, fix);
        }
    }
    for (i, point) in points.iter().enumerate() {
        let (Some([u, v]), Some([seen_u, seen_v])) = (best.predicted_px[i], point.pixel) else { continue };
        if !best.is_used[i] {
            let missed = (u - seen_u).hypot(v - seen_v);
            let message = format!("seen {missed:.2} px from where the pose puts it; it was left out");
            let fix = "check its coordinates and its pixel";
            add(
                "outlying-point",
                &format!("point {}", point.name),
                message,
                missed,
                OUTLYING_SIGMAS * sigma_px,
                fix,
            );
        }
    }
    if best.pose.degrees_of_freedom > 0 {
        let factor = (best.pose.chi2 / best.pose.degrees_of_freedom as f64).sqrt();
        if factor > 2.0 {
            let message =
                format!("the residuals are {factor:.1} times what a sigma of {sigma_px} px explains");
            let fix = "check the points, the calibration, and sigma_px; the stated sigmas are too small by this factor";
            add("large-misfit", "pose", message, factor, 2.0, fix);
        }
    }
}

#[cfg(test)]
#[path = "locate_tests.rs"]
mod tests;
