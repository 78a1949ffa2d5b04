//! Tables of poses: what a robot said of its flange, or a tracker of a target.
//!
//! - `.csv` with a header: `x_m,y_m,z_m` or `x_mm,y_mm,z_mm`; then `qx,qy,qz,qw` in any order, or
//!   `rx_rad,ry_rad,rz_rad` (a rotation vector), or `a_deg,b_deg,c_deg` / `a_rad,b_rad,c_rad` (angles that
//!   the convention explains); `frame` (of touches `point`) and `time_s` if they are known.
//! - text with 16 (row by row), 12, 7, 6 numbers in a line, or 8 with the time before them, without a header.
//! - `.yaml`: one column of six numbers under `data:`, position and rotation vector.

use boresight_data::{AngleUnit, LengthUnit, PoseConvention, PoseRow, RotationKind};

use crate::cursor::shown;
use crate::{Error, Place};

/// A table of poses, and the convention that its form tells.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PoseTable {
    /// The rows.
    pub rows: Vec<PoseRow>,
    /// What the header or the form of the table says of its convention.
    pub convention: Option<PoseConvention>,
    /// The units that a header names.
    pub units: Option<(LengthUnit, AngleUnit)>,
}

impl PoseTable {
    /// Returns how its rows are read: as is stated, in the units that its header names; or else as its form tells.
    pub fn read_as(&self, stated: Option<PoseConvention>) -> Option<PoseConvention> {
        let stated = stated.or(self.convention)?;
        let (length, angle) = self.units.unwrap_or((stated.length, stated.angle));
        // Names say which number of a quaternion or a matrix is which, in whatever order the maker writes them.
        let named = self.units.and(self.convention).map(|own| own.rotation);
        let is_alike = |own: &RotationKind| own.number_count() == stated.rotation.number_count();
        match named.filter(|own| !own.has_angles()).filter(is_alike) {
            Some(rotation) => Some(PoseConvention { rotation, length, ..stated }),
            None => Some(PoseConvention { length, angle, ..stated }),
        }
    }
}

/// The columns in which a table has rotations.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RotationColumns {
    /// A quaternion.
    Quaternion,
    /// A matrix, row by row.
    Matrix,
    /// A rotation vector, unless a convention makes angles of it.
    Vector,
    /// Angles that a convention explains, by their letters.
    Angles(&'static [&'static str; 3]),
}

impl RotationColumns {
    /// All, in the order in which they are looked for.
    pub const ALL: [Self; 6] = [
        Self::Quaternion,
        Self::Matrix,
        Self::Vector,
        Self::Angles(&["a", "b", "c"]),
        Self::Angles(&["w", "p", "r"]),
        Self::Angles(&["roll", "pitch", "yaw"]),
    ];

    /// Returns the names of the columns; those of angles have their unit after them, as in `rx_rad` or `a_deg`.
    pub fn names(self) -> &'static [&'static str] {
        match self {
            Self::Quaternion => &["qx", "qy", "qz", "qw"],
            Self::Matrix => &["r11", "r12", "r13", "r21", "r22", "r23", "r31", "r32", "r33"],
            Self::Vector => &["rx", "ry", "rz"],
            Self::Angles(names) => names,
        }
    }

    /// Returns what the numbers are, or `None` of letters for angles, which say nothing of their axes.
    pub fn kind(self) -> Option<RotationKind> {
        match self {
            Self::Quaternion => Some(RotationKind::QuaternionXyzw),
            Self::Matrix => Some(RotationKind::Matrix),
            Self::Vector => Some(RotationKind::RotationVector),
            Self::Angles(_) => None,
        }
    }
}

const NEED: &str =
    "a line has x, y, z and then 3, 4 or 9 numbers of an orientation, or is a 4x4 matrix row by row";

/// Reads a table of poses.
pub fn read_pose_table(file: &str, bytes: &[u8]) -> Result<PoseTable, Error> {
    let text = std::str::from_utf8(bytes).map_err(|_| Error::Malformed {
        place: Place::file(file),
        found: "bytes that are not UTF-8".to_owned(),
        need: "a table of poses is text",
    })?;
    let table = if file.ends_with(".yaml") || file.ends_with(".yml") {
        read_matrix(file, text)?
    } else {
        read_lines(file, text)?
    };
    if table.rows.is_empty() {
        return Err(Error::Empty { file: file.to_owned() });
    }
    Ok(table)
}

/// Reads the numbers under `data:`.
fn read_matrix(file: &str, text: &str) -> Result<PoseTable, Error> {
    let data = text.split_once("data:").map_or("", |(_, data)| data);
    let words = data.split(|c: char| c.is_whitespace() || "[],".contains(c));
    let words = words.filter(|word| !word.is_empty() && *word != "-");
    let numbers: Vec<f64> = words.map_while(|word| word.parse().ok()).collect();
    match row(&numbers) {
        Some(found) => {
            let convention = convention_of(&found, &numbers);
            Ok(PoseTable { convention, rows: vec![found], units: None })
        }
        None => Err(malformed(Place::file(file), numbers.len())),
    }
}

fn malformed(place: Place, found: usize) -> Error {
    Error::Malformed { place, found: format!("{found} numbers"), need: NEED }
}

fn read_lines(file: &str, text: &str) -> Result<PoseTable, Error> {
    let mut table = PoseTable::default();
    let mut header: Option<Header> = None;
    for (i, line) in text.lines().enumerate() {
        let line = line.split('#').next().unwrap_or_default().trim();
        if line.is_empty() {
            continue;
        }
        let place = || Place::line(file, i + 1);
        let separator = |c: char| c == ',' || c == ';' || c.is_whitespace();
        let fields: Vec<&str> = if line.contains(',') || line.contains(';') {
            line.split([',', ';']).map(str::trim).collect()
        } else {
            line.split(separator).filter(|field| !field.is_empty()).collect()
        };
        let is_first = header.is_none() && table.rows.is_empty();
        if is_first && fields.iter().any(|field| field.starts_with(|c: char| c.is_ascii_alphabetic())) {
            let read = Header::new(&fields, place())?;
            (table.convention, table.units) = (read.convention, Some(read.units));
            header = Some(read);
            continue;
        }
        let number = |(column, field): (usize, &&str)| {
            field.parse::<f64>().ok().filter(|number| number.is_finite()).ok_or_else(|| Error::BadValue {
                place: place(),
                column: format!("column {}", column + 1),
                value: shown(field.as_bytes()),
                need: "it must be a number".to_owned(),
            })
        };
        let found = match &header {
            Some(header) => header.row(&fields, place(), &number)?,
            None => {
                let numbers: Vec<f64> = fields.iter().enumerate().map(number).collect::<Result<_, _>>()?;
                let found = row(&numbers).ok_or_else(|| malformed(place(), numbers.len()))?;
                let own = convention_of(&found, &numbers);
                // Rows of another length are told below.
                let is_as_long =
                    table.rows.first().is_some_and(|first| first.rotation.len() == found.rotation.len());
                if is_as_long && own.is_some() && table.convention.is_some() && own != table.convention {
                    let found =
                        "a matrix that is written the other way round than those before it".to_owned();
                    return Err(Error::Malformed { place: place(), found, need: NEED });
                }
                table.convention = table.convention.or(own);
                found
            }
        };
        if let Some(first) = table.rows.first()
            && first.rotation.len() != found.rotation.len()
        {
            return Err(malformed(place(), fields.len()));
        }
        table.rows.push(found);
    }
    // Turns alone are read row by row.
    if header.is_none() && table.rows.first().is_some_and(|row| row.rotation.len() == 9) {
        table.convention = table.convention.or(Some(PoseConvention::plain(RotationKind::Matrix)));
    }
    Ok(table)
}

/// Returns the pose that bare numbers are.
fn row(numbers: &[f64]) -> Option<PoseRow> {
    let matrix = |at: [usize; 9], position: [usize; 3]| PoseRow {
        frame: None,
        time_s: None,
        position: position.map(|i| numbers[i]),
        rotation: at.map(|i| numbers[i]).to_vec(),
    };
    let plain = |first: usize| PoseRow {
        frame: None,
        time_s: (first > 0).then(|| numbers[0]),
        position: [numbers[first], numbers[first + 1], numbers[first + 2]],
        rotation: numbers[first + 3..].to_vec(),
    };
    match numbers.len() {
        // The zeros of the last row tell a matrix by rows from one by columns, which becomes one by rows of R'.
        16 if numbers[12..15].iter().all(is_zero) => Some(matrix([0, 1, 2, 4, 5, 6, 8, 9, 10], [3, 7, 11])),
        16 if [3, 7, 11].iter().all(|&i: &usize| is_zero(&numbers[i])) => {
            Some(matrix([0, 1, 2, 4, 5, 6, 8, 9, 10], [12, 13, 14]))
        }
        12 => Some(matrix([0, 1, 2, 4, 5, 6, 8, 9, 10], [3, 7, 11])),
        6 | 7 => Some(plain(0)),
        8 => Some(plain(1)),
        _ => None,
    }
}

/// Returns the convention that the form of bare numbers tells; `None` of a matrix without a translation, which is as
/// good by rows as by columns.
fn convention_of(row: &PoseRow, numbers: &[f64]) -> Option<PoseConvention> {
    let by_rows = numbers.len() == 12 || numbers.get(12..15).is_some_and(|last| last.iter().all(is_zero));
    if by_rows && numbers.len() == 16 && [3, 7, 11].iter().all(|&i: &usize| is_zero(&numbers[i])) {
        return None;
    }
    Some(PoseConvention::plain(match row.rotation.len() {
        9 if by_rows => RotationKind::Matrix,
        9 => RotationKind::MatrixByColumns,
        4 => RotationKind::QuaternionXyzw,
        3 => RotationKind::RotationVector,
        _ => return None,
    }))
}

fn is_zero(number: &f64) -> bool {
    number.abs() < 1e-9
}

/// Reads the field of a column.
type Number<'a> = dyn Fn((usize, &&str)) -> Result<f64, Error> + 'a;

/// Which column is what.
struct Header {
    n_columns: usize,
    frame: Option<usize>,
    time: Option<usize>,
    position: [usize; 3],
    rotation: Vec<usize>,
    convention: Option<PoseConvention>,
    units: (LengthUnit, AngleUnit),
}

impl Header {
    fn new(fields: &[&str], place: Place) -> Result<Self, Error> {
        let at = |name: &str| fields.iter().position(|field| field.eq_ignore_ascii_case(name));
        let all = |names: [&str; 3]| names.map(at).into_iter().collect::<Option<Vec<usize>>>();
        let missing = |missing: &'static str| Error::Header {
            place: place.clone(),
            header: shown(fields.join(",").as_bytes()),
            missing,
            example: "frame,x_m,y_m,z_m,qx,qy,qz,qw",
        };
        let (position, length) = match (all(["x_m", "y_m", "z_m"]), all(["x_mm", "y_mm", "z_mm"])) {
            (Some(position), _) => (position, LengthUnit::Metres),
            (None, Some(position)) => (position, LengthUnit::Millimetres),
            (None, None) => return Err(missing("x_m")),
        };
        let frame = at("frame").or_else(|| at("point"));
        // Angles are of one unit; other numbers have none.
        let columns = |columns: RotationColumns, unit: &str| -> Option<Vec<usize>> {
            columns.names().iter().map(|name| at(&format!("{name}{unit}"))).collect()
        };
        let has_angles = |columns: RotationColumns| columns.kind().is_none_or(RotationKind::has_angles);
        let units = [("_rad", AngleUnit::Radians), ("_deg", AngleUnit::Degrees)];
        let found = RotationColumns::ALL.into_iter().find_map(|named| match has_angles(named) {
            true => units.iter().find_map(|(unit, angle)| Some((named, columns(named, unit)?, *angle))),
            false => Some((named, columns(named, "")?, AngleUnit::Radians)),
        });
        let (named, rotation, angle) = found.ok_or_else(|| missing("qx"))?;
        let plain = |kind| PoseConvention { length, angle, ..PoseConvention::plain(kind) };
        Ok(Self {
            n_columns: fields.len(),
            frame,
            time: at("time_s"),
            position: [position[0], position[1], position[2]],
            rotation,
            convention: named.kind().map(plain),
            units: (length, angle),
        })
    }

    fn row(&self, fields: &[&str], place: Place, number: &Number<'_>) -> Result<PoseRow, Error> {
        if fields.len() != self.n_columns {
            let (found, need) = (fields.len(), self.n_columns);
            return Err(Error::ColumnCount { place, found, need, cut_off: false });
        }
        let at = |column: usize| number((column, &fields[column]));
        Ok(PoseRow {
            frame: self.frame.map(|column| fields[column].to_owned()),
            time_s: self.time.map(at).transpose()?,
            position: [at(self.position[0])?, at(self.position[1])?, at(self.position[2])?],
            rotation: self.rotation.iter().map(|&column| at(column)).collect::<Result<_, _>>()?,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tables_say_their_convention_as_far_as_they_can() {
        let read = |name: &str, text: &str| read_pose_table(name, text.as_bytes()).unwrap();
        let text = |table: &PoseTable| table.convention.map(|convention| convention.to_string());
        let csv = read("p.csv", "frame,qw,qx,qy,qz,x_mm,y_mm,z_mm\n1,1,0,0,0,10,20,30\n");
        assert_eq!(text(&csv).unwrap(), "quaternion-xyzw:mm");
        assert_eq!((csv.rows[0].frame.as_deref(), csv.rows[0].position), (Some("1"), [10.0, 20.0, 30.0]));
        assert_eq!(csv.rows[0].rotation, [0.0, 0.0, 0.0, 1.0]);
        let angles = read("p.csv", "x_mm,y_mm,z_mm,a_deg,b_deg,c_deg\n1,2,3,4,5,6\n");
        assert_eq!((text(&angles), angles.rows[0].rotation.len()), (None, 3));
        let vector = read("p.csv", "x_m,y_m,z_m,rx_rad,ry_rad,rz_rad\n1,2,3,4,5,6\n");
        assert_eq!(text(&vector).unwrap(), "rotation-vector:rad:m");
        let matrix = read("p.txt", "1 0 0 7 0 1 0 8 0 0 1 9 0 0 0 1\n");
        assert_eq!((text(&matrix).unwrap().as_str(), matrix.rows[0].position), ("matrix:m", [7.0, 8.0, 9.0]));
        let columns = read("p.txt", "1,0,0,0,0,1,0,0,0,0,1,0,7,8,9,1");
        assert_eq!(text(&columns).unwrap(), "matrix-by-columns:m");
        assert_eq!(columns.rows[0].position, [7.0, 8.0, 9.0]);
        let timed = read("p.csv", "10.5, 1, 2, 3, 0, 0, 0, 1\n# end\n");
        assert_eq!((timed.rows[0].time_s, timed.rows[0].position[0]), (Some(10.5), 1.0));
        let yaml = read(
            "p.yaml",
            "rows: 6\ncols: 1\ndata: \n  - [1]\n  - [2]\n  - [3]\n  - [4]\n  - [5]\n  - [6]\n",
        );
        assert_eq!(text(&yaml).unwrap(), "rotation-vector:rad:m");
    }

    #[test]
    fn mistakes_are_named_with_their_line() {
        for (text, part) in [
            ("", "p.csv: the file is empty"),
            ("x,y,z\n", "no column `x_m`"),
            ("x_m,y_m,z_m\n", "no column `qx`"),
            ("1 2 3\n", "p.csv:1: "),
            ("1 2 3 4 5 6\n1 2 3 4 5 6 7\n", "p.csv:2: "),
            ("1 0 0 7 0 1 0 8 0 0 1 9 0 0 0 1\n1 2 3 0 0 0 1\n", "7 numbers"),
            ("1 2 3 4 5 nan\n", "p.csv:1: "),
            ("x_m,y_m,z_m,qx,qy,qz,qw\n1,2\n", "p.csv:2: the line has 2 columns"),
        ] {
            let error = read_pose_table("p.csv", text.as_bytes()).unwrap_err().to_string();
            assert!(error.contains(part), "`{part}` is not in: {error}");
        }
    }
}
