//! A chain of poses from target to camera, and how each link moves its end.

use boresight_data::FrameMotion;
use boresight_geometry::{Matrix3, Pose, Vector3};
use boresight_solver::{BlockId, Links, Values};

/// One factor of `cam_from_target`, from left to right.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Link {
    /// The pose of a block.
    Block(BlockId),
    /// The inverse of the pose of a block.
    Inverse(BlockId),
    /// A pose that is known.
    Known(Pose),
    /// What moves while a camera's image is late, by so many seconds as the block says; see
    /// [`clock`].
    Late(BlockId, FrameMotion),
}

/// The column of a [`Link::Late`]'s block that is the lateness, and the one that is the delay from row to row.
pub(crate) const CLOCK_COLUMN: usize = 3;
pub(crate) const LINE_DELAY_COLUMN: usize = 4;

/// Returns the value of a [`Link::Late`]'s block, whose other columns must be held.
///
/// Chains have poses, so that the seconds stand where a pose has the x of its translation, and the seconds from row to
/// row where it has the y: both add up as numbers do while the rotation is held.
pub fn clock(late_s: f64, line_delay_s: f64) -> Pose {
    Pose::new(Pose::identity().rotation, Vector3::new(late_s, line_delay_s, 0.0))
}

/// Returns the seconds of a [`Link::Late`]'s block.
pub(crate) fn seconds(values: Values<'_>, block: BlockId) -> f64 {
    values.pose(block).translation.x
}

/// Returns the seconds from row to row of a [`Link::Late`]'s block.
pub(crate) fn line_delay(values: Values<'_>, block: BlockId) -> f64 {
    values.pose(block).translation.y
}

/// The factors of `cam_from_target`. No block may occur twice.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Chain {
    /// The factors, the camera's end first.
    pub links: Vec<Link>,
}

impl Chain {
    /// Returns the blocks of the chain, in its order.
    pub fn blocks(&self) -> impl Iterator<Item = BlockId> + '_ {
        self.links.iter().filter_map(|link| match link {
            Link::Block(block) | Link::Inverse(block) | Link::Late(block, _) => Some(*block),
            Link::Known(_) => None,
        })
    }

    /// Returns the block, counted along the chain, whose left perturbation is one of the whole chain.
    pub fn outer_link(&self) -> Option<usize> {
        matches!(self.links.first(), Some(Link::Block(_))).then_some(0)
    }

    /// Returns `cam_from_target`.
    pub fn compose(&self, values: Values<'_>) -> Pose {
        self.links.iter().fold(Pose::identity(), |prefix, link| prefix * link.pose(values))
    }

    /// Returns `cam_from_target`, and leaves in `links` how each block's left perturbation moves it.
    pub fn linearize(&self, values: Values<'_>, links: &mut Links) -> (Matrix3<f64>, Vector3<f64>) {
        links.clear();
        // No first factor spares the products with the identity.
        let mut prefix: Option<(Matrix3<f64>, Vector3<f64>)> = None;
        for link in &self.links {
            let pose = link.pose(values);
            let (rotation, translation) = (pose.rotation_matrix(), pose.translation);
            let next = match &prefix {
                None => (rotation, translation),
                Some((before, shift)) => (before * rotation, before * translation + shift),
            };
            match link {
                // A exp(d) X = exp(Ad(A) d) A X.
                Link::Block(_) => match &prefix {
                    None => links.push_identity(),
                    Some((rotation, translation)) => links.push_adjoint(rotation, translation, 1.0),
                },
                // A (exp(d) X)⁻¹ = A X⁻¹ exp(-d) = exp(-Ad(A X⁻¹) d) A X⁻¹.
                Link::Inverse(_) => links.push_adjoint(&next.0, &next.1, -1.0),
                // A exp(d J) X = exp(Ad(A) J d) A X.
                Link::Late(block, motion) => {
                    let rate = motion.rate(seconds(values, *block));
                    let rate = match &prefix {
                        None => rate,
                        Some((r, t)) => Pose::from_matrix(r, *t).adjoint() * rate,
                    };
                    links.push_along(CLOCK_COLUMN, &rate);
                }
                Link::Known(_) => {}
            }
            prefix = Some(next);
        }
        prefix.unwrap_or((Matrix3::identity(), Vector3::zeros()))
    }
}

impl Link {
    fn pose(&self, values: Values<'_>) -> Pose {
        match self {
            Link::Block(block) => values.pose(*block),
            Link::Inverse(block) => values.pose(*block).inverse(),
            Link::Known(pose) => *pose,
            Link::Late(block, motion) => motion.after(seconds(values, *block)),
        }
    }
}

#[cfg(test)]
mod tests {
    use boresight_geometry::{Matrix6, Vector6};
    use boresight_solver::{Elimination, LinkMap, Parameters};

    use super::*;

    #[test]
    fn adjoints_match_differences() {
        let pose =
            |a: f64| Pose::from_rodrigues(Vector3::new(a, 0.3 - a, 0.2), Vector3::new(0.1, a, 1.0 + a));
        let mut parameters = Parameters::default();
        let blocks = [0.1, 0.5, -0.4].map(|a| parameters.add_pose(&pose(a), Elimination::Reduced));
        let chain = Chain {
            links: vec![
                Link::Block(blocks[0]),
                Link::Inverse(blocks[1]),
                Link::Known(pose(0.7)),
                Link::Block(blocks[2]),
            ],
        };
        let start = chain.compose(parameters.values());
        let mut links = Links::default();
        let (rotation, translation) = chain.linearize(parameters.values(), &mut links);
        assert!((rotation - start.rotation_matrix()).norm() < 1e-14);
        assert!((translation - start.translation).norm() < 1e-14);
        let adjoint = |map: &Option<LinkMap>| {
            map.map_or(Matrix6::identity(), |map| Matrix6::from_fn(|k, l| map.matrix()[k][l]))
        };
        let adjoints: Vec<Matrix6<f64>> = links.maps().iter().map(adjoint).collect();
        let step = 1e-6;
        for (which, adjoint) in adjoints.iter().enumerate() {
            for column in 0..6 {
                let mut tangent = Vector6::zeros();
                tangent[column] = step;
                let mut moved = Parameters::default();
                for (other, a) in [0.1, 0.5, -0.4].into_iter().enumerate() {
                    let pose = if other == which { pose(a).perturbed(&tangent) } else { pose(a) };
                    moved.add_pose(&pose, Elimination::Reduced);
                }
                let difference = (chain.compose(moved.values()) * start.inverse()).log() / step;
                // One-sided differences are good to the step.
                assert!((difference - adjoint.column(column)).norm() < 1e-5, "{which} {column}");
            }
        }
    }

    #[test]
    fn lateness_moves_the_target_along_its_motion() {
        let turned = Pose::from_rodrigues(Vector3::new(0.4, -0.2, 0.7), Vector3::new(0.3, -0.1, 0.2));
        let motion = FrameMotion {
            velocity: Vector6::new(0.5, -0.3, 0.2, 0.4, 0.1, -0.2),
            acceleration: Vector6::new(1.0, 0.5, -2.0, 0.3, -0.6, 0.2),
        };
        let linearized = |late_s: f64| {
            let mut parameters = Parameters::default();
            let [camera, frame] =
                [turned, turned.inverse()].map(|pose| parameters.add_pose(&pose, Elimination::Reduced));
            let late = parameters.add_pose(&clock(late_s, 0.0), Elimination::Reduced);
            let links = vec![Link::Block(camera), Link::Late(late, motion), Link::Block(frame)];
            let chain = Chain { links };
            let mut links = Links::default();
            chain.linearize(parameters.values(), &mut links);
            let map = links.maps()[1].unwrap().matrix();
            (chain.compose(parameters.values()), map)
        };
        let (pose, map) = linearized(0.02);
        assert!((pose * (turned * motion.after(0.02) * turned.inverse()).inverse()).log().norm() < 1e-14);
        let step_s = 1e-5;
        let ahead =
            (linearized(0.02 + step_s).0 * linearized(0.02 - step_s).0.inverse()).log() / (2.0 * step_s);
        for (row, expected) in map.iter().zip(ahead.iter()) {
            // Central differences are good to 1e-9 here, the rate's series to 1e-6.
            assert!((row[CLOCK_COLUMN] - expected).abs() < 2e-6, "{row:?} {expected}");
            assert!((0..6).all(|column| column == CLOCK_COLUMN || row[column] == 0.0));
        }
    }
}
