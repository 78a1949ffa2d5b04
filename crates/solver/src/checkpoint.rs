//! Checkpoints of a long search, bound to the problem by a hash.
//!
//! argmin's own file checkpoint resumes whatever lies under its name, and keeps the limits of the
//! run that wrote it. Here a file of another problem is an error, and limits are always the caller's.

use std::{fs, io};

use argmin::core::checkpointing::{Checkpoint, CheckpointingFrequency};
use argmin::core::{IterState, State as _};
use serde::{Deserialize, Serialize};

use crate::Error;
use crate::levenberg_marquardt::{LevenbergMarquardt, State};
use crate::options::Checkpointing;
use crate::problem::Problem;

const SCHEMA: &str = "boresight.checkpoint/2";

/// The state of a search on disk.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Saved {
    schema: String,
    problem: String,
    pub iteration: u64,
    pub damping: f64,
    pub growth: f64,
    pub gain: f64,
    pub promised: f64,
    pub values: Vec<f64>,
    /// Where the supports of the terms were found; nothing if that is where the problem starts.
    pub support_values: Vec<f64>,
}

/// Reads and writes the checkpoint of one problem. argmin only writes; reading happens before the
/// run, where it can fail by name.
#[derive(Clone, Debug)]
pub(crate) struct Writer {
    options: Checkpointing,
    hash: u64,
}

impl Writer {
    pub(crate) fn new(options: &Checkpointing, problem: &Problem<'_>, first_cost: f64) -> Self {
        Self { options: options.clone(), hash: hash(problem, first_cost) }
    }

    /// Replaces the checkpoint as a whole.
    pub(crate) fn write(
        &self,
        solver: &LevenbergMarquardt<'_>,
        values: &[f64],
        iteration: u64,
    ) -> Result<(), Error> {
        // What a kept model has learnt is not saved; the search goes on from where that was made, the same way.
        let (values, promised, since) = match solver.origin() {
            None => (values, solver.promised, 0),
            Some(at) => (&*at.values, at.promised, (solver.counters.iterations - at.iterations) as u64),
        };
        let saved = Saved {
            schema: SCHEMA.to_owned(),
            problem: format!("{:016x}", self.hash),
            iteration: iteration.saturating_sub(since),
            damping: solver.damping,
            growth: solver.growth,
            gain: solver.gain,
            promised,
            values: values.to_vec(),
            support_values: solver.support_values.clone(),
        };
        let text = serde_json::to_string(&saved).map_err(|error| self.fail(error.to_string()))?;
        let mut temporary = self.options.path.clone().into_os_string();
        temporary.push(".partial");
        fs::write(&temporary, text).and_then(|()| fs::rename(&temporary, &self.options.path)).map_err(
            |error| {
                // Nothing half-written stays; that it was never there is no error.
                let _ = fs::remove_file(&temporary);
                self.fail(error.to_string())
            },
        )
    }

    /// Returns the state that was kept, `None` if there is none yet, or an error if it is of another problem.
    pub(crate) fn read(&self, n_values: usize) -> Result<Option<Saved>, Error> {
        let text = match fs::read_to_string(&self.options.path) {
            Ok(text) => text,
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
            Err(error) => return Err(self.fail(error.to_string())),
        };
        let saved: Saved =
            serde_json::from_str(&text).map_err(|error| self.fail(format!("not a checkpoint: {error}")))?;
        if saved.schema != SCHEMA {
            return Err(self.fail(format!("its schema is {:?}, not {SCHEMA:?}", saved.schema)));
        }
        let expected = format!("{:016x}", self.hash);
        if saved.problem != expected {
            return Err(self.fail(format!(
                "it is of another problem ({} instead of {expected}); delete it or name another file",
                saved.problem
            )));
        }
        for values in [&saved.values, &saved.support_values] {
            let may_lack = values.is_empty() && std::ptr::eq(values, &saved.support_values);
            if values.len() != n_values && !may_lack {
                return Err(self.fail(format!("it has {} values, not {n_values}", values.len())));
            }
        }
        if !(saved.damping > 0.0 && saved.growth > 1.0) {
            return Err(self.fail(format!("its damping {} grows by {}", saved.damping, saved.growth)));
        }
        Ok(Some(saved))
    }

    fn fail(&self, problem: String) -> Error {
        Error::Checkpoint { path: self.options.path.display().to_string(), problem }
    }
}

impl<'a> Checkpoint<LevenbergMarquardt<'a>, State> for Writer {
    fn save(&self, solver: &LevenbergMarquardt<'a>, state: &State) -> Result<(), argmin::core::Error> {
        // A search that has ended is not saved, so that resuming it ends with the very same bits.
        match state.get_param() {
            Some(values) if solver.stop.is_none() => Ok(self.write(solver, values, state.get_iter())?),
            _ => Ok(()),
        }
    }

    fn load(&self) -> Result<Option<(LevenbergMarquardt<'a>, State)>, argmin::core::Error> {
        Ok(None)
    }

    fn frequency(&self) -> CheckpointingFrequency {
        CheckpointingFrequency::Every(self.options.every)
    }
}

/// Returns a hash of the problem: its blocks, what is held, where it starts, what it costs there.
fn hash(problem: &Problem<'_>, first_cost: f64) -> u64 {
    let mut hash = Fnv(0xcbf2_9ce4_8422_2325);
    for block in &problem.parameters.blocks {
        hash.add((block.n_columns as u64) ^ ((block.n_values() as u64) << 32));
        block.held.iter().for_each(|&held| hash.add(u64::from(held)));
    }
    problem.parameters.values.iter().for_each(|value| hash.add(value.to_bits()));
    for term in &problem.terms {
        hash.add(term.row_count() as u64);
        term.blocks().iter().for_each(|block| hash.add(block.0 as u64));
    }
    hash.add(first_cost.to_bits());
    hash.0
}

/// The FNV-1a hash: short, stable, and strong enough to tell one's own problems apart.
struct Fnv(u64);

impl Fnv {
    fn add(&mut self, number: u64) {
        for byte in number.to_le_bytes() {
            self.0 = (self.0 ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3);
        }
    }
}

/// Returns the argmin state at `values`, after so many iterations.
pub(crate) fn first_state(values: Vec<f64>, iteration: u64) -> State {
    let mut state = IterState::new().param(values);
    state.iter = iteration;
    state
}
