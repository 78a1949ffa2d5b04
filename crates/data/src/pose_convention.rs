//! How robots write poses: what the numbers of a row mean.

use std::fmt;
use std::str::FromStr;

use boresight_geometry::nalgebra::Quaternion;
use boresight_geometry::{Matrix3, Pose, UnitQuaternion, Vector3};

/// A row of a table of poses, as it was written.
#[derive(Clone, Debug, PartialEq)]
pub struct PoseRow {
    /// The frame it belongs to, or the point that was touched, where the table says.
    pub frame: Option<String>,
    /// When it was taken, in seconds, where the table says.
    pub time_s: Option<f64>,
    /// The three numbers of the position.
    pub position: [f64; 3],
    /// The three, four or nine numbers of the orientation; nine are row by row.
    pub rotation: Vec<f64>,
}

/// What the numbers of a row mean.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct PoseConvention {
    /// What the orientation's numbers are.
    pub rotation: RotationKind,
    /// The unit of its angles; of no meaning for quaternions and matrices.
    pub angle: AngleUnit,
    /// The unit of positions.
    pub length: LengthUnit,
    /// Whether a row is the flange in the base or the base seen from the flange.
    pub direction: PoseDirection,
}

/// What the numbers of an orientation are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum RotationKind {
    /// A rotation matrix, row by row.
    Matrix,
    /// A rotation matrix, column by column.
    MatrixByColumns,
    /// A quaternion with the scalar last.
    QuaternionXyzw,
    /// A quaternion with the scalar first.
    QuaternionWxyz,
    /// An axis times an angle.
    RotationVector,
    /// Three turns, in the order of the numbers.
    Euler {
        /// The axis of each turn: 0 is x, 1 is y, 2 is z.
        axes: [u8; 3],
        /// Which axes these are.
        about: TurnsAbout,
    },
}

/// Which axes Euler angles turn about.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum TurnsAbout {
    /// Those of the base, which stay: the first turn is the rightmost factor.
    Fixed,
    /// Those of the body, which move with it: the first turn is the leftmost factor.
    Moving,
}

/// A unit of angles.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum AngleUnit {
    /// Radians.
    Radians,
    /// Degrees.
    Degrees,
}

/// A unit of lengths.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum LengthUnit {
    /// Metres.
    Metres,
    /// Millimetres.
    Millimetres,
}

/// Which way a pose leads.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum PoseDirection {
    /// `base_from_flange`: where the flange is, what robots show.
    BaseFromFlange,
    /// `flange_from_base`: its inverse.
    FlangeFromBase,
}

const fn euler(axes: [u8; 3], about: TurnsAbout) -> RotationKind {
    RotationKind::Euler { axes, about }
}

const FIXED_XYZ: RotationKind = euler([0, 1, 2], TurnsAbout::Fixed);
const MOVING_ZYX: RotationKind = euler([2, 1, 0], TurnsAbout::Moving);
const MOVING_XYZ: RotationKind = euler([0, 1, 2], TurnsAbout::Moving);
const MOVING_ZYZ: RotationKind = euler([2, 1, 2], TurnsAbout::Moving);

/// The makers' conventions by name: orientation, angles, lengths.
pub const MAKERS: &[(&str, RotationKind, AngleUnit, LengthUnit)] = {
    use AngleUnit::{Degrees, Radians};
    use LengthUnit::{Metres, Millimetres};
    &[
        ("abb", RotationKind::QuaternionWxyz, Radians, Millimetres),
        ("epson", MOVING_ZYX, Degrees, Millimetres),
        ("fanuc-wpr", FIXED_XYZ, Degrees, Millimetres),
        ("franka", RotationKind::MatrixByColumns, Radians, Metres),
        ("halcon", MOVING_XYZ, Degrees, Metres),
        ("kawasaki-oat", MOVING_ZYZ, Degrees, Millimetres),
        ("kuka-abc", MOVING_ZYX, Degrees, Millimetres),
        ("mitsubishi-abc", FIXED_XYZ, Degrees, Millimetres),
        ("ros", RotationKind::QuaternionXyzw, Radians, Metres),
        ("staubli", MOVING_XYZ, Degrees, Millimetres),
        ("universal-robots", RotationKind::RotationVector, Radians, Metres),
        ("universal-robots-pendant", RotationKind::RotationVector, Radians, Millimetres),
        ("urdf-rpy", FIXED_XYZ, Radians, Metres),
        ("yaskawa", FIXED_XYZ, Degrees, Millimetres),
    ]
};

impl RotationKind {
    /// Returns all kinds that `n` numbers can be: 3, 4 or 9.
    pub fn all_of(n: usize) -> Vec<Self> {
        match n {
            3 => {
                let mut kinds = vec![Self::RotationVector];
                for about in [TurnsAbout::Fixed, TurnsAbout::Moving] {
                    for axes in EULER_AXES {
                        kinds.push(Self::Euler { axes, about });
                    }
                }
                kinds
            }
            4 => vec![Self::QuaternionXyzw, Self::QuaternionWxyz],
            9 => vec![Self::Matrix, Self::MatrixByColumns],
            _ => Vec::new(),
        }
    }

    /// Returns how many numbers it takes.
    pub fn number_count(self) -> usize {
        match self {
            Self::Matrix | Self::MatrixByColumns => 9,
            Self::QuaternionXyzw | Self::QuaternionWxyz => 4,
            Self::RotationVector | Self::Euler { .. } => 3,
        }
    }

    /// Tells whether its numbers are angles.
    pub fn has_angles(self) -> bool {
        self.number_count() == 3
    }

    /// Returns the rotation that numbers in radians mean, or `None` if they are of the wrong number or no rotation.
    pub fn rotation(self, numbers: &[f64]) -> Option<UnitQuaternion<f64>> {
        if numbers.len() != self.number_count() || numbers.iter().any(|number| !number.is_finite()) {
            return None;
        }
        let quaternion = |w: f64, x: f64, y: f64, z: f64| {
            let quaternion = Quaternion::new(w, x, y, z);
            // Text has a few digits; what is far from unit length is no quaternion.
            ((quaternion.norm() - 1.0).abs() < 0.05).then(|| UnitQuaternion::new_normalize(quaternion))
        };
        match self {
            Self::Matrix | Self::MatrixByColumns => {
                let rows = Matrix3::from_row_slice(numbers);
                let matrix = if self == Self::Matrix { rows } else { rows.transpose() };
                let is_rotation = (matrix * matrix.transpose() - Matrix3::identity()).norm() < 0.05
                    && matrix.determinant() > 0.0;
                is_rotation.then(|| UnitQuaternion::from_matrix(&matrix))
            }
            Self::QuaternionXyzw => quaternion(numbers[3], numbers[0], numbers[1], numbers[2]),
            Self::QuaternionWxyz => quaternion(numbers[0], numbers[1], numbers[2], numbers[3]),
            Self::RotationVector => {
                Some(UnitQuaternion::from_scaled_axis(Vector3::new(numbers[0], numbers[1], numbers[2])))
            }
            Self::Euler { axes, about } => {
                let mut rotation = UnitQuaternion::identity();
                for (axis, angle) in axes.iter().zip(numbers) {
                    let mut vector = Vector3::zeros();
                    vector[usize::from(*axis)] = *angle;
                    let turn = UnitQuaternion::from_scaled_axis(vector);
                    rotation = match about {
                        TurnsAbout::Moving => rotation * turn,
                        TurnsAbout::Fixed => turn * rotation,
                    };
                }
                Some(rotation)
            }
        }
    }
}

/// All orders of axes in which three turns reach every rotation.
const EULER_AXES: [[u8; 3]; 12] = [
    [0, 1, 2],
    [0, 2, 1],
    [1, 0, 2],
    [1, 2, 0],
    [2, 0, 1],
    [2, 1, 0],
    [0, 1, 0],
    [0, 2, 0],
    [1, 0, 1],
    [1, 2, 1],
    [2, 0, 2],
    [2, 1, 2],
];

impl PoseConvention {
    /// Returns the convention of metres, radians and `base_from_flange` with this kind of orientation.
    pub fn plain(rotation: RotationKind) -> Self {
        Self {
            rotation,
            angle: AngleUnit::Radians,
            length: LengthUnit::Metres,
            direction: PoseDirection::BaseFromFlange,
        }
    }

    /// Returns `base_from_flange` as a row says it, or `None` if its numbers are no pose in this convention.
    pub fn base_from_flange(&self, row: &PoseRow) -> Option<Pose> {
        let angle = match self.angle {
            AngleUnit::Degrees if self.rotation.has_angles() => std::f64::consts::PI / 180.0,
            _ => 1.0,
        };
        let length = match self.length {
            LengthUnit::Metres => 1.0,
            LengthUnit::Millimetres => 1e-3,
        };
        let numbers: Vec<f64> = row.rotation.iter().map(|number| number * angle).collect();
        let position = Vector3::from(row.position) * length;
        if position.iter().any(|number| !number.is_finite()) {
            return None;
        }
        let pose = Pose::new(self.rotation.rotation(&numbers)?, position);
        Some(match self.direction {
            PoseDirection::BaseFromFlange => pose,
            PoseDirection::FlangeFromBase => pose.inverse(),
        })
    }

    /// Returns the names of the makers that write poses so.
    pub fn makers(&self) -> Vec<&'static str> {
        let is_alike = |angle: AngleUnit| !self.rotation.has_angles() || angle == self.angle;
        let alike = MAKERS.iter().filter(|(_, rotation, angle, length)| {
            *rotation == self.rotation && *length == self.length && is_alike(*angle)
        });
        alike.map(|(name, ..)| *name).collect()
    }
}

impl fmt::Display for RotationKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Matrix => f.write_str("matrix"),
            Self::MatrixByColumns => f.write_str("matrix-by-columns"),
            Self::QuaternionXyzw => f.write_str("quaternion-xyzw"),
            Self::QuaternionWxyz => f.write_str("quaternion-wxyz"),
            Self::RotationVector => f.write_str("rotation-vector"),
            Self::Euler { axes, about } => {
                let letters: String =
                    axes.iter().map(|axis| ['x', 'y', 'z'][usize::from(*axis % 3)]).collect();
                let about = if *about == TurnsAbout::Fixed { "fixed" } else { "moving" };
                write!(f, "{about}-{letters}")
            }
        }
    }
}

impl fmt::Display for PoseConvention {
    /// Writes what [`FromStr`] reads, such as `moving-zyx:deg:mm`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.rotation)?;
        if self.rotation.has_angles() {
            f.write_str(if self.angle == AngleUnit::Degrees { ":deg" } else { ":rad" })?;
        }
        f.write_str(if self.length == LengthUnit::Millimetres { ":mm" } else { ":m" })?;
        if self.direction == PoseDirection::FlangeFromBase {
            f.write_str(":inverse")?;
        }
        Ok(())
    }
}

/// A text that names no convention.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "`{text}` is no convention for poses; write a maker's ({}), or the kind of the orientation and its units, such \
     as moving-zyx:deg:mm, fixed-xyz:rad:m, rotation-vector:rad:m, quaternion-xyzw:m, quaternion-wxyz:mm, matrix:m; \
     add :inverse for flange_from_base",
    makers()
)]
pub struct BadPoseConvention {
    /// The text.
    pub text: String,
}

fn makers() -> String {
    let names: Vec<&str> = MAKERS.iter().map(|(name, ..)| *name).collect();
    names.join(", ")
}

impl FromStr for PoseConvention {
    type Err = BadPoseConvention;

    fn from_str(text: &str) -> Result<Self, BadPoseConvention> {
        let bad = || BadPoseConvention { text: text.to_owned() };
        let mut words = text.split(':');
        let first = words.next().unwrap_or_default();
        let mut convention = match MAKERS.iter().find(|(name, ..)| *name == first) {
            Some((_, rotation, angle, length)) => {
                Self { angle: *angle, length: *length, ..Self::plain(*rotation) }
            }
            None => {
                let kinds = [3, 4, 9].into_iter().flat_map(RotationKind::all_of);
                Self::plain({ kinds }.find(|kind| kind.to_string() == first).ok_or_else(bad)?)
            }
        };
        for word in words {
            match word {
                "deg" => convention.angle = AngleUnit::Degrees,
                "rad" => convention.angle = AngleUnit::Radians,
                "mm" => convention.length = LengthUnit::Millimetres,
                "m" => convention.length = LengthUnit::Metres,
                "inverse" => convention.direction = PoseDirection::FlangeFromBase,
                _ => return Err(bad()),
            }
        }
        Ok(convention)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[track_caller]
    fn check(convention: &str, position: [f64; 3], rotation: &[f64], expected: Pose) {
        let row = PoseRow { frame: None, time_s: None, position, rotation: rotation.to_vec() };
        let found = convention.parse::<PoseConvention>().unwrap().base_from_flange(&row).unwrap();
        assert!((found * expected.inverse()).log().norm() < 1e-9, "{convention}: {found:?}");
    }

    #[test]
    fn makers_conventions_mean_what_their_manuals_say() {
        let turn = |axis: usize, degrees: f64| {
            let mut vector = Vector3::zeros();
            vector[axis] = degrees.to_radians();
            UnitQuaternion::from_scaled_axis(vector)
        };
        let at = |rotation| Pose::new(rotation, Vector3::new(0.1, 0.2, 0.3));
        let (mm, m) = ([100.0, 200.0, 300.0], [0.1, 0.2, 0.3]);
        let angles = [10.0, 20.0, 30.0];
        // A about z, B about y, C about x.
        let zyx = at(turn(2, 10.0) * turn(1, 20.0) * turn(0, 30.0));
        check("kuka-abc", mm, &angles, zyx);
        check("epson", mm, &angles, zyx);
        // W about x, P about y, R about z, all of the base.
        let fixed = at(turn(2, 30.0) * turn(1, 20.0) * turn(0, 10.0));
        check("fanuc-wpr", mm, &angles, fixed);
        check("mitsubishi-abc", mm, &angles, fixed);
        check("urdf-rpy", m, &angles.map(f64::to_radians), fixed);
        check("staubli", mm, &angles, at(turn(0, 10.0) * turn(1, 20.0) * turn(2, 30.0)));
        check("kawasaki-oat", mm, &angles, at(turn(2, 10.0) * turn(1, 20.0) * turn(2, 30.0)));
        let [w, x, y, z] = [0.5, -0.5, 0.5, 0.5];
        let quarter = UnitQuaternion::new_normalize(Quaternion::new(w, x, y, z));
        check("abb", mm, &[w, x, y, z], at(quarter));
        check("ros", m, &[x, y, z, w], at(quarter));
        check("universal-robots", m, quarter.scaled_axis().as_slice(), at(quarter));
        check("franka", m, quarter.to_rotation_matrix().matrix().as_slice(), at(quarter));
        let inverse = at(quarter).inverse();
        check("ros:inverse", inverse.translation.into(), inverse.rotation.coords.as_slice(), at(quarter));
    }

    #[test]
    fn conventions_survive_their_text_and_mistakes_are_refused() {
        for n in [3, 4, 9] {
            for rotation in RotationKind::all_of(n) {
                let convention = PoseConvention {
                    length: LengthUnit::Millimetres,
                    direction: PoseDirection::FlangeFromBase,
                    ..PoseConvention::plain(rotation)
                };
                assert_eq!(convention.to_string().parse(), Ok(convention));
            }
        }
        assert_eq!("kuka-abc".parse::<PoseConvention>().unwrap().makers(), ["epson", "kuka-abc"]);
        for text in ["", "kuka", "moving-xxy", "ros:cm", "matrix:m:"] {
            assert!(text.parse::<PoseConvention>().is_err(), "{text}");
        }
        let row =
            PoseRow { frame: None, time_s: None, position: [0.0; 3], rotation: vec![2.0, 0.0, 0.0, 0.0] };
        assert_eq!(PoseConvention::plain(RotationKind::QuaternionWxyz).base_from_flange(&row), None);
    }
}
