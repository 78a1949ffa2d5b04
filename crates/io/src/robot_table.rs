//! The robot side's tables: points, touches and parts as CSV with named columns.
//!
//! A column's name has its unit: `x_mm` or `x_m`, `u_px`, `phi_deg` or `phi_rad`. A line may leave a
//! field empty. Text after `#` is a comment. A table whose fields are separated by `;` may have decimal commas.

use std::path::Path;

use crate::Error;
use crate::error::Place;
use crate::job::read;

/// What a header looks like, for a message.
const EXAMPLE: &str = "name,u_px,v_px,x_mm,y_mm,z_mm";

/// Units of a quantity: the ending of a column's name, and its factor.
type Units = &'static [(&'static str, f64)];

const LENGTHS: Units = &[("_m", 1.0), ("_mm", 1e-3)];
const ANGLES: Units = &[("_rad", 1.0), ("_deg", std::f64::consts::PI / 180.0)];
const PIXELS: Units = &[("_px", 1.0)];
const NUMBERS: Units = &[("", 1.0)];

/// A table, every field as it was written.
#[derive(Clone, Debug, PartialEq)]
pub struct RobotTable {
    file: String,
    columns: Vec<String>,
    /// The line of each row, counted from 1, and its fields.
    rows: Vec<(usize, Vec<String>)>,
    header: String,
    decimal_comma: bool,
}

impl RobotTable {
    /// Reads a table from a file.
    pub fn read(path: &Path) -> Result<Self, Error> {
        Self::from_bytes(&path.display().to_string(), &read(path)?)
    }

    /// Reads a table from bytes; `file` is named in errors.
    pub fn from_bytes(file: &str, bytes: &[u8]) -> Result<Self, Error> {
        let text = String::from_utf8_lossy(bytes);
        let text = text.trim_start_matches('\u{feff}');
        let lines = text.lines().enumerate().filter_map(|(i, line)| {
            let line = line.split('#').next().unwrap_or_default().trim();
            (!line.is_empty()).then_some((i + 1, line))
        });
        let mut table = Self {
            file: file.to_owned(),
            columns: Vec::new(),
            rows: Vec::new(),
            header: String::new(),
            decimal_comma: false,
        };
        for (line, text) in lines {
            if table.columns.is_empty() {
                table.decimal_comma = text.contains(';');
                table.header = text.to_owned();
                table.columns = table.fields(text);
                continue;
            }
            let fields = table.fields(text);
            if fields.len() != table.columns.len() {
                let place = Place::line(file, line);
                let (found, need) = (fields.len(), table.columns.len());
                return Err(Error::ColumnCount { place, found, need, cut_off: false });
            }
            table.rows.push((line, fields));
        }
        if table.columns.is_empty() {
            return Err(Error::Empty { file: file.to_owned() });
        }
        Ok(table)
    }

    /// Returns the names of the columns, in their order.
    pub fn columns(&self) -> &[String] {
        &self.columns
    }

    fn fields(&self, line: &str) -> Vec<String> {
        let separator = if self.decimal_comma { ';' } else { ',' };
        line.split(separator).map(|field| field.trim().to_owned()).collect()
    }

    /// Returns the number of rows.
    pub fn len(&self) -> usize {
        self.rows.len()
    }

    /// Tells whether there are no rows.
    pub fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    /// Returns the name of each row: its column `name`, or else its number, counted from 1.
    pub fn names(&self) -> Vec<String> {
        let column = self.columns.iter().position(|column| column == "name");
        let name = |(i, (_, fields)): (usize, &(usize, Vec<String>))| match column {
            Some(column) if !fields[column].is_empty() => fields[column].clone(),
            _ => (i + 1).to_string(),
        };
        self.rows.iter().enumerate().map(name).collect()
    }

    /// Tells whether there is a column of this name, in any unit or without one.
    pub fn has(&self, name: &str) -> bool {
        let is_it = |column: &String| {
            let rest = column.strip_prefix(name);
            rest.is_some_and(|rest| {
                [LENGTHS, ANGLES, PIXELS, NUMBERS].concat().iter().any(|(unit, _)| *unit == rest)
            })
        };
        self.columns.iter().any(is_it)
    }

    /// Returns a column of lengths in metres, such as `x` for the column `x_mm`; `None` where a field is empty.
    pub fn lengths_m(&self, name: &'static str) -> Result<Vec<Option<f64>>, Error> {
        self.column(name, LENGTHS)
    }

    /// Returns a column of angles in radians.
    pub fn angles_rad(&self, name: &'static str) -> Result<Vec<Option<f64>>, Error> {
        self.column(name, ANGLES)
    }

    /// Returns a column of pixel coordinates, such as `u` for the column `u_px`.
    pub fn pixels(&self, name: &'static str) -> Result<Vec<Option<f64>>, Error> {
        self.column(name, PIXELS)
    }

    /// Returns a column of numbers without a unit, such as those of a quaternion.
    pub fn numbers(&self, name: &'static str) -> Result<Vec<Option<f64>>, Error> {
        self.column(name, NUMBERS)
    }

    /// Returns the error that says a row needs a value that it does not have.
    pub fn missing(&self, row: usize, column: &str) -> Error {
        Error::BadValue {
            place: Place::line(&self.file, self.rows.get(row).map_or(0, |(line, _)| *line)),
            column: column.to_owned(),
            value: String::new(),
            need: "a number is needed here".to_owned(),
        }
    }

    fn column(&self, name: &'static str, units: Units) -> Result<Vec<Option<f64>>, Error> {
        let known = units.iter().find_map(|(unit, factor)| {
            let position = self.columns.iter().position(|column| *column == format!("{name}{unit}"))?;
            Some((position, *factor))
        });
        let Some((position, factor)) = known else {
            return Err(Error::TableColumn {
                file: self.file.clone(),
                header: self.header.clone(),
                missing: units.iter().map(|(unit, _)| format!("{name}{unit}")).collect(),
                example: EXAMPLE,
            });
        };
        let value = |(line, fields): &(usize, Vec<String>)| {
            let field = &fields[position];
            if field.is_empty() {
                return Ok(None);
            }
            let text = if self.decimal_comma { field.replace(',', ".") } else { field.clone() };
            match text.parse::<f64>() {
                Ok(value) if value.is_finite() => Ok(Some(value * factor)),
                _ => Err(Error::BadValue {
                    place: Place::line(&self.file, *line),
                    column: self.columns[position].clone(),
                    value: field.clone(),
                    need: "it must be a finite number".to_owned(),
                }),
            }
        };
        self.rows.iter().map(value).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_are_found_by_name_and_unit() {
        let text = "\u{feff}name, u_px,x_mm,phi_deg\n# a comment\na,10.5,2,90\n,11,,\n";
        let table = RobotTable::from_bytes("t.csv", text.as_bytes()).unwrap();
        assert_eq!((table.len(), table.names()), (2, vec!["a".to_owned(), "2".to_owned()]));
        assert_eq!(table.lengths_m("x").unwrap(), [Some(0.002), None]);
        assert_eq!(table.pixels("u").unwrap(), [Some(10.5), Some(11.0)]);
        let angle = table.angles_rad("phi").unwrap()[0].unwrap();
        assert!((angle - std::f64::consts::FRAC_PI_2).abs() < 1e-15);
        assert!(table.has("x") && table.has("name") && !table.has("y"));
        let error = table.lengths_m("y").unwrap_err();
        assert!(error.to_string().contains("y_m or y_mm"), "{error}");
    }

    #[test]
    fn decimal_commas_are_read_where_fields_are_separated_by_semicolons() {
        let table = RobotTable::from_bytes("t.csv", b"u_px;x_m\n10,5;-0,25\n").unwrap();
        assert_eq!(
            (table.pixels("u").unwrap()[0], table.lengths_m("x").unwrap()[0]),
            (Some(10.5), Some(-0.25))
        );
        // With commas between fields a decimal comma is one field too many, and said to be.
        let error = RobotTable::from_bytes("t.csv", b"u_px,x_m\n10,5,1\n").unwrap_err();
        assert!(matches!(error, Error::ColumnCount { found: 3, need: 2, .. }));
    }

    #[test]
    fn bad_fields_name_their_line() {
        let table = RobotTable::from_bytes("t.csv", b"u_px\n1\n\nx\n").unwrap();
        assert_eq!(
            table.pixels("u").unwrap_err().to_string(),
            "t.csv:4: u_px is `x`: it must be a finite number"
        );
        assert!(matches!(RobotTable::from_bytes("t.csv", b" \n# nothing\n"), Err(Error::Empty { .. })));
    }
}
