//! The seed crate's integration tests.

#[cfg(test)]
mod problems;
#[cfg(test)]
mod support;
#[cfg(test)]
mod synthetic;
#[cfg(test)]
mod three_point;
