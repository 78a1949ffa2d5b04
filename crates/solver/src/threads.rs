//! Threads that share out work, and the room that each of them works in.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::available_parallelism;
use std::{hint, mem};

use rayon::{ThreadPool, Yield};

use crate::Error;
use crate::problem::Scratch;

/// Below this many rows, starting threads costs more than they save.
const ROWS_WORTH_THREADS: usize = 20_000;

/// A thread that has looked for something to do so often in vain, which takes about a millisecond, goes to sleep: where
/// lists are this far apart, waking it is cheap.
const MOST_IN_VAIN: usize = 20_000;

/// The parts in which threads take a list whose items may be many and small.
const MAP_PARTS: usize = 64;

/// The pools that there are, by their number of threads: starting threads takes about as long as a small problem.
static POOLS: Mutex<BTreeMap<usize, Arc<Pool>>> = Mutex::new(BTreeMap::new());

/// Threads that take the items of a list one at a time.
///
/// What becomes of an item does not depend on who takes it, so that the number of threads cannot show.
#[derive(Debug)]
pub struct Threads {
    /// `None` where the caller does it all.
    pool: Option<Arc<Pool>>,
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
        let scratch = (0..pool.threads.current_num_threads()).map(|_| Mutex::default()).collect();
        Ok(Self { pool: Some(pool), scratch })
    }

    /// Returns what `work` returns. Lists that it shares out are then shared among the thread that it runs on and the
    /// others, who stand by; from outside, each list would cost the time that sleeping threads take to wake.
    pub(crate) fn run<R: Send>(&self, work: impl FnOnce() -> R + Send) -> R {
        match &self.pool {
            None => work(),
            Some(pool) => pool.threads.install(|| pool.with_others(work)),
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
        match &self.pool {
            None => items.iter_mut().enumerate().for_each(|(idx, item)| work(idx, item)),
            Some(pool) => pool.threads.install(|| share(items, &work)),
        }
    }

    /// Returns what `work` makes of each item, in their order.
    pub fn map<T: Send, R: Send>(&self, items: Vec<T>, work: impl Fn(T) -> R + Sync + Send) -> Vec<R> {
        let n_items = items.len();
        let mut slots: Vec<(Option<T>, Option<R>)> =
            items.into_iter().map(|item| (Some(item), None)).collect();
        // Threads get into each other's way where they fetch little work at a time.
        let mut parts: Vec<_> = slots.chunks_mut(n_items.div_ceil(MAP_PARTS).max(1)).collect();
        self.for_each(&mut parts, |_, part| {
            part.iter_mut().for_each(|(item, result)| *result = item.take().map(&work));
        });
        let results: Vec<R> = slots.into_iter().filter_map(|(_, result)| result).collect();
        assert_eq!(results.len(), n_items, "each item has its result");
        results
    }
}

/// The threads of a pool.
#[derive(Debug)]
struct Pool {
    threads: ThreadPool,
    /// Whether they stand by for someone.
    is_taken: AtomicBool,
}

impl Pool {
    /// Returns what `work` returns, which runs on this one of the threads while the others stand by, unless they do so
    /// for someone else.
    fn with_others<R: Send>(&self, work: impl FnOnce() -> R + Send) -> R {
        if self.is_taken.swap(true, Ordering::AcqRel) {
            return work();
        }
        let (own, is_over) = (rayon::current_thread_index(), AtomicBool::new(false));
        rayon::in_place_scope(|scope| {
            // Others are let go even where `work` panics.
            let _end = OnDrop(|| {
                self.is_taken.store(false, Ordering::Release);
                is_over.store(true, Ordering::Release);
            });
            scope.spawn_broadcast(|_, context| {
                if Some(context.index()) != own {
                    work_until(|| is_over.load(Ordering::Acquire));
                }
            });
            work()
        })
    }
}

/// Does what there is to do on this thread until `is_over`, or until there has been nothing for long.
fn work_until(is_over: impl Fn() -> bool) {
    let mut n_in_vain = 0;
    while !is_over() && n_in_vain < MOST_IN_VAIN {
        match rayon::yield_now() {
            Some(Yield::Executed) => n_in_vain = 0,
            _ => n_in_vain += 1,
        }
        hint::spin_loop();
    }
}

/// Does `work` on each item, on as many threads of this one's pool as have nothing else to do.
///
/// Each has a share of its own, the same in lists of the same length, so that it finds in its cache what it left there.
fn share<T: Send>(items: &mut [T], work: &(impl Fn(usize, &mut T) + Sync)) {
    let n_items = items.len();
    let n_threads = rayon::current_num_threads().min(n_items);
    if n_threads < 2 {
        return items.iter_mut().enumerate().for_each(|(idx, item)| work(idx, item));
    }
    let first = |share: usize| share * n_items / n_threads;
    let mut rest = items;
    let shares = (0..n_threads).map(|share| {
        let idxs = first(share)..first(share + 1);
        let (share, others) = mem::take(&mut rest).split_at_mut(idxs.len());
        rest = others;
        Mutex::new(idxs.zip(share))
    });
    let shares: Vec<_> = shares.collect();
    let n_done = AtomicUsize::new(0);
    let work_on = || {
        let own = rayon::current_thread_index().unwrap_or(0);
        for k in 0..n_threads {
            let next = || {
                let mut share = shares[(own + k) % n_threads].lock().unwrap_or_else(PoisonError::into_inner);
                // From another's share, what that one would come to last.
                if k == 0 { share.next() } else { share.next_back() }
            };
            while let Some((idx, item)) = next() {
                let _done = OnDrop(|| {
                    n_done.fetch_add(1, Ordering::Release);
                });
                work(idx, item);
            }
        }
    };
    rayon::in_place_scope(|scope| {
        (1..n_threads).for_each(|_| scope.spawn(|_| work_on()));
        work_on();
        // Whoever falls asleep over another's last item takes long to wake.
        work_until(|| n_done.load(Ordering::Acquire) == n_items);
    });
}

/// Does something when it goes.
struct OnDrop<F: FnMut()>(F);

impl<F: FnMut()> Drop for OnDrop<F> {
    fn drop(&mut self) {
        self.0();
    }
}

/// Returns the pool of so many threads, which are started if they are not there.
fn pool(threads: usize) -> Result<Arc<Pool>, Error> {
    let mut pools = POOLS.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(pool) = pools.get(&threads) {
        return Ok(pool.clone());
    }
    let started = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
    let started = started.map_err(|error| Error::Threads { threads, problem: error.to_string() })?;
    let pool = Arc::new(Pool { threads: started, is_taken: AtomicBool::new(false) });
    pools.insert(threads, pool.clone());
    Ok(pool)
}

/// The caller's own thread alone.
impl Default for Threads {
    fn default() -> Self {
        Self { pool: None, scratch: vec![Mutex::default()] }
    }
}

#[cfg(test)]
mod tests {
    use std::panic::{AssertUnwindSafe, catch_unwind};

    use super::*;

    fn threads(n: usize) -> Threads {
        Threads::new(n, usize::MAX).unwrap()
    }

    #[test]
    fn each_item_is_worked_on_once_and_keeps_its_place() {
        for n_threads in [1, 2, 3, 7] {
            let threads = threads(n_threads);
            for n_items in [0, 1, 2, 5, 64, 1000] {
                let mut items = vec![0; n_items];
                threads.run(|| threads.for_each(&mut items, |idx, item| *item += idx + 1));
                assert_eq!(items, (1..=n_items).collect::<Vec<_>>(), "{n_threads} threads");
                let squares = threads.map(items, |item| item * item);
                assert_eq!(squares, (1..=n_items).map(|item| item * item).collect::<Vec<_>>());
            }
        }
    }

    #[test]
    fn who_shares_a_pool_does_not_wait_for_each_other_forever() {
        let work = || {
            let threads = threads(2);
            for _ in 0..200 {
                // Within what is shared out, others may run and share out again.
                let sums = threads.run(|| {
                    threads.map((0..6).collect(), |first: u64| {
                        let mut items: Vec<u64> = (first..first + 9).collect();
                        threads.run(|| threads.for_each(&mut items, |_, item| *item *= 2));
                        items.iter().sum::<u64>()
                    })
                });
                assert_eq!(sums, (0..6).map(|first| 18 * first + 72).collect::<Vec<_>>());
            }
        };
        std::thread::scope(|scope| (0..4).for_each(|_| drop(scope.spawn(work))));
    }

    #[test]
    fn a_panic_reaches_the_caller_and_leaves_the_pool_usable() {
        let threads = threads(2);
        for bad in [0, 40, 63] {
            let run = || threads.run(|| threads.for_each(&mut [(); 64], |idx, ()| assert!(idx != bad)));
            assert!(catch_unwind(AssertUnwindSafe(run)).is_err());
            assert_eq!(threads.map(vec![1, 2, 3], |item| item + 1), [2, 3, 4]);
        }
        let in_between = || threads.run(|| panic!("between lists"));
        assert!(catch_unwind(AssertUnwindSafe(in_between)).is_err());
        let mut items = [0; 64];
        threads.run(|| threads.for_each(&mut items, |_, item| *item = 1));
        assert_eq!(items, [1; 64]);
    }
}
