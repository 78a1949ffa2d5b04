//! Threads that share out work, and the room that each of them works in.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::available_parallelism;

use rayon::ThreadPool;
use rayon::prelude::*;

use crate::Error;
use crate::problem::Scratch;

/// Below this many rows, starting threads costs more than they save.
const ROWS_WORTH_THREADS: usize = 20_000;

/// The pools that there are, by their number of threads: starting threads takes about as long as a small problem.
static POOLS: Mutex<BTreeMap<usize, Arc<ThreadPool>>> = Mutex::new(BTreeMap::new());

/// Threads that take the items of a list one at a time.
///
/// What becomes of an item does not depend on who takes it, so that the number of threads cannot show.
#[derive(Debug)]
pub struct Threads {
    /// `None` where the caller does it all.
    pool: Option<Arc<ThreadPool>>,
    /// The room of each thread, kept from list to list.
    scratch: Vec<Mutex<Scratch>>,
}

impl Threads {
    /// Returns as many threads as asked for, 0 being one for each core; few rows are left to the caller's.
    pub fn new(threads: usize, rows: usize) -> Result<Self, Error> {
        let threads = match threads {
            0 => available_parallelism().map_or(1, |n| n.get()),
            n => n,
        };
        if threads == 1 || rows < ROWS_WORTH_THREADS {
            return Ok(Self::default());
        }
        let pool = pool(threads)?;
        let scratch = (0..pool.current_num_threads()).map(|_| Mutex::default()).collect();
        Ok(Self { pool: Some(pool), scratch })
    }

    /// Returns what `work` returns. Lists that it shares out are then shared among the thread that it runs on and the
    /// others; from outside, each list would cost the time that a sleeping thread takes to wake, twice.
    pub(crate) fn run<R: Send>(&self, work: impl FnOnce() -> R + Send) -> R {
        match &self.pool {
            None => work(),
            Some(pool) => pool.install(work),
        }
    }

    /// Does `work` on each item with the scratch of the thread that does it.
    pub(crate) fn for_each_with<T: Send>(
        &self,
        items: &mut [T],
        work: impl Fn(&mut Scratch, usize, &mut T) + Sync + Send,
    ) {
        self.for_each(items, |idx, item| {
            let thread = rayon::current_thread_index().filter(|_| self.pool.is_some()).unwrap_or(0);
            // What a panic left in it does not matter: a term writes before it reads.
            let mut scratch = self.scratch[thread].lock().unwrap_or_else(PoisonError::into_inner);
            work(&mut scratch, idx, item);
        });
    }

    /// Does `work` on each item.
    pub(crate) fn for_each<T: Send>(&self, items: &mut [T], work: impl Fn(usize, &mut T) + Sync + Send) {
        if self.pool.is_none() {
            return items.iter_mut().enumerate().for_each(|(idx, item)| work(idx, item));
        }
        self.run(|| items.par_iter_mut().enumerate().with_max_len(1).for_each(|(idx, item)| work(idx, item)));
    }

    /// Returns what `work` makes of each item, in their order. Items are shared out many at a time.
    pub fn map<T: Send, R: Send>(&self, items: Vec<T>, work: impl Fn(T) -> R + Sync + Send) -> Vec<R> {
        if self.pool.is_none() {
            return items.into_iter().map(work).collect();
        }
        self.run(|| items.into_par_iter().map(work).collect())
    }
}

/// Returns the pool of so many threads, which are started if they are not there.
fn pool(threads: usize) -> Result<Arc<ThreadPool>, Error> {
    let mut pools = POOLS.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(pool) = pools.get(&threads) {
        return Ok(pool.clone());
    }
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
    let pool = Arc::new(pool.map_err(|error| Error::Threads { threads, problem: error.to_string() })?);
    pools.insert(threads, pool.clone());
    Ok(pool)
}

/// The caller's own thread alone.
impl Default for Threads {
    fn default() -> Self {
        Self { pool: None, scratch: vec![Mutex::default()] }
    }
}
