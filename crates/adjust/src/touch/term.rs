//! Touches as a term of the sum of squares: where the map puts a pixel, less where the tip was.

use boresight_geometry::{Dual, Pose, Vector3};
use boresight_solver::{BlockId, GramMut, Scratch, Term, Values};

use super::map::{Kind, mapped, ray_on_plane};

/// The most columns of a term: a homography, a plane, a tip.
const MOST: usize = 8 + 3 + 3;

type Number = Dual<f64, MOST>;

/// One touch, ready to be held against a map.
#[derive(Clone, Copy, Debug)]
pub(super) struct Held {
    /// Image coordinates: normalised, or of a pose `x / z, y / z`.
    pub image: [f64; 2],
    pub base_from_flange: Pose,
    /// Takes the error in the plane to units of its sigma.
    pub whitening: [[f64; 2]; 2],
    /// The inverse sigma of the height; zero where heights are not known.
    pub inverse_height_sigma: f64,
}

/// All touches as one term.
#[derive(Clone, Debug)]
pub(super) struct TouchTerm {
    pub blocks: Vec<BlockId>,
    pub kind: Kind,
    pub facing: f64,
    pub centre: [f64; 2],
    pub scale: f64,
    pub tip: Tip,
    pub touches: Vec<Held>,
}

/// The tip on the flange: what is known, and the directions in which it is sought.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Tip {
    pub known: Vector3<f64>,
    pub sought: Vec<Vector3<f64>>,
}

impl TouchTerm {
    /// Returns, for a touch, where the map puts it less where the tip was: x, y, and the plane's height
    /// there less the tip's, in metres; with derivatives by all columns.
    fn errors(&self, touch: &Held, values: &Values<'_>) -> Option<[Number; 3]> {
        let n = self.kind.columns();
        let mut next = 0;
        let mut variable = |value: f64| {
            next += 1;
            Number::variable(value, next - 1)
        };
        let map: Vec<Number> = match self.kind {
            Kind::Pose => (0..n).map(|_| variable(0.0)).collect(),
            _ => values.vector(self.blocks[0]).iter().map(|&value| variable(value)).collect(),
        };
        let height: Vec<Number> =
            values.vector(self.blocks[1]).iter().map(|&value| variable(value)).collect();
        let tip_in_base = touch.base_from_flange * self.tip.known;
        let mut position = [tip_in_base.x, tip_in_base.y, tip_in_base.z].map(Number::fixed);
        if let Some(&block) = self.blocks.get(2) {
            for (direction, &value) in self.tip.sought.iter().zip(values.vector(block)) {
                let along = variable(value);
                let direction = touch.base_from_flange.rotation * direction;
                for axis in 0..3 {
                    position[axis] = position[axis] + along * Number::fixed(direction[axis]);
                }
            }
        }
        let [x, y] = match self.kind {
            Kind::Pose => {
                let pose = values.pose(self.blocks[0]);
                ray_on_plane(&pose, &map, touch.image, &height, self.centre)?
            }
            kind => {
                let [x, y] = mapped(kind, self.facing, &map, touch.image.map(Number::fixed))?;
                let scale = Number::fixed(self.scale);
                [x * scale + Number::fixed(self.centre[0]), y * scale + Number::fixed(self.centre[1])]
            }
        };
        let across = [0, 1].map(|axis| position[axis] - Number::fixed(self.centre[axis]));
        let level = height[0] + height[1] * across[0] + height[2] * across[1];
        Some([x - position[0], y - position[1], level - position[2]])
    }

    /// Returns the errors of each touch in metres at `values`.
    pub(super) fn errors_m(&self, values: &Values<'_>) -> Option<Vec<[f64; 3]>> {
        self.touches.iter().map(|touch| Some(self.errors(touch, values)?.map(|e| e.value))).collect()
    }
}

impl Term for TouchTerm {
    fn blocks(&self) -> &[BlockId] {
        &self.blocks
    }

    fn row_count(&self) -> usize {
        let heights = self.touches.iter().filter(|touch| touch.inverse_height_sigma != 0.0).count();
        2 * self.touches.len() + heights
    }

    fn linearize(&self, values: Values<'_>, gram: &mut GramMut<'_>, _: &mut Scratch) -> Option<f64> {
        gram.clear();
        let n = gram.size() - 1;
        let mut cost = 0.0;
        for touch in &self.touches {
            let [x, y, z] = self.errors(touch, &values)?;
            let w = touch.whitening.map(|row| row.map(Number::fixed));
            let rows = [
                w[0][0] * x + w[0][1] * y,
                w[1][0] * x + w[1][1] * y,
                z * Number::fixed(touch.inverse_height_sigma),
            ];
            for row in rows {
                for a in 0..n {
                    for b in a..n {
                        gram.add(a, b, row.derivative[a] * row.derivative[b]);
                    }
                    gram.add(a, n, row.derivative[a] * row.value);
                }
                cost += row.value * row.value;
            }
        }
        gram.add(n, n, cost);
        Some(cost)
    }
}
