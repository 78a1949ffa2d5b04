//! Arrays from NumPy's npz files.

use std::collections::BTreeMap;
use std::fs::File;
use std::io;
use std::path::Path;

use npyz::npz::NpzArchive;

/// The numeric arrays of an npz file, all as `f64`, row-major.
#[derive(Debug, Default)]
pub struct Npz {
    arrays: BTreeMap<String, (Vec<u64>, Vec<f64>)>,
}

impl Npz {
    /// Reads every array of `path` whose numbers convert to `f64`; texts are passed over.
    pub fn read(path: &Path) -> io::Result<Self> {
        let mut archive = NpzArchive::new(io::BufReader::new(File::open(path)?))?;
        let names: Vec<String> = archive.array_names().map(str::to_owned).collect();
        let mut arrays = BTreeMap::new();
        for name in names {
            let Some(array) = archive.by_name(&name)? else { continue };
            let shape = array.shape().to_vec();
            let is_row_major = array.order() == npyz::Order::C;
            let kind = array.dtype().descr();
            let numbers = match kind.trim_matches('\'') {
                "<f8" => array.into_vec::<f64>()?,
                "<f4" => array.into_vec::<f32>()?.into_iter().map(f64::from).collect(),
                "<i8" => array.into_vec::<i64>()?.into_iter().map(|n| n as f64).collect(),
                "<i4" => array.into_vec::<i32>()?.into_iter().map(f64::from).collect(),
                "|b1" => array.into_vec::<bool>()?.into_iter().map(|b| if b { 1.0 } else { 0.0 }).collect(),
                "|u1" => array.into_vec::<u8>()?.into_iter().map(f64::from).collect(),
                _ => continue,
            };
            let numbers = if is_row_major { numbers } else { row_major(&shape, &numbers) };
            arrays.insert(name, (shape, numbers));
        }
        Ok(Self { arrays })
    }

    /// Returns the numbers of an array.
    ///
    /// # Panics
    /// If the file has no such array.
    pub fn numbers(&self, name: &str) -> &[f64] {
        &self
            .arrays
            .get(name)
            .unwrap_or_else(|| panic!("no array {name}; there are {:?}", self.arrays.keys()))
            .1
    }

    /// Returns the shape of an array.
    ///
    /// # Panics
    /// If the file has no such array.
    pub fn shape(&self, name: &str) -> Vec<usize> {
        self.arrays[name].0.iter().map(|&n| n as usize).collect()
    }

    /// Returns the one number of an array.
    pub fn number(&self, name: &str) -> f64 {
        self.numbers(name)[0]
    }
}

/// Returns numbers stored with the first index fastest in the order with the last index fastest.
fn row_major(shape: &[u64], numbers: &[f64]) -> Vec<f64> {
    let mut sorted = vec![0.0; numbers.len()];
    for (mut rest, &number) in numbers.iter().enumerate() {
        let mut place = 0;
        for (axis, &length) in shape.iter().enumerate() {
            let stride: u64 = shape[axis + 1..].iter().product();
            place += (rest as u64 % length) * stride;
            rest /= length as usize;
        }
        sorted[place as usize] = number;
    }
    sorted
}
