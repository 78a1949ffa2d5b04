//! A chain of poses from target to camera, and how each link moves its end.

use boresight_geometry::{Matrix6, Pose};
use boresight_solver::{BlockId, Values};

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

    /// Returns `cam_from_target`.
    pub fn compose(&self, values: Values<'_>) -> Pose {
        self.links.iter().fold(Pose::identity(), |prefix, link| prefix * link.pose(values))
    }

    /// Calls `write` for each block in order with the matrix that maps a left perturbation of the
    /// block's pose to the left perturbation of `cam_from_target` that it amounts to;
    /// `None` is the identity, which spares the products.
    pub fn each_adjoint(&self, values: Values<'_>, mut write: impl FnMut(Option<&Matrix6<f64>>)) {
        let mut prefix: Option<Pose> = None;
        for link in &self.links {
            let pose = link.pose(values);
            let next = prefix.map_or(pose, |prefix| prefix * pose);
            match link {
                Link::Block(_) => match &prefix {
                    None => write(None),
                    // A exp(d) X = exp(Ad(A) d) A X.
                    Some(prefix) => write(Some(&prefix.adjoint())),
                },
                // A (exp(d) X)⁻¹ = A X⁻¹ exp(-d) = exp(-Ad(A X⁻¹) d) A X⁻¹.
                Link::Inverse(_) => write(Some(&-next.adjoint())),
                Link::Known(_) => {}
            }
            prefix = Some(next);
        }
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
    use boresight_geometry::{Vector3, Vector6};
    use boresight_solver::{Elimination, Parameters};

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
        let mut adjoints = Vec::new();
        chain.each_adjoint(parameters.values(), |adjoint| {
            adjoints.push(adjoint.copied().unwrap_or_else(Matrix6::identity));
        });
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
