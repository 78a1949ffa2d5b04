//! A chain of poses from target to camera, and how each link moves its end.

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
            Link::Block(block) | Link::Inverse(block) => Some(*block),
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
}
