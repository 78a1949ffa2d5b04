//! From recordings to what is seen in their images: one thread reads, the others decode and detect.
//!
//! Images wait in a queue of limited size, so that memory does not grow with the recording.

use std::collections::VecDeque;
use std::ops::ControlFlow;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use boresight_io::{Contents, Error, RecordedImage, RecordingJob, SeenRecorded};

use crate::images::{DetectWatch, look_up_or_detect};

/// How many images wait at most for each thread.
const WAITING_FOR_EACH: usize = 2;
/// How many bytes wait at most; a single image may be larger.
const WAITING_BYTES: usize = 1 << 26;

/// Detects the target of a job in each image of its recordings.
///
/// What is returned does not depend on the number of threads, but for its order.
pub fn detect_recordings(
    job: &RecordingJob,
    watch: &DetectWatch<'_>,
) -> Result<(Contents, Vec<SeenRecorded>), Error> {
    detect_while_reading(job, watch, |deliver| job.read(deliver))
}

/// Takes images from whoever is told of them.
type Deliver<'a> = &'a mut dyn FnMut(RecordedImage) -> ControlFlow<()>;

/// Detects the target in each image that `read` delivers.
fn detect_while_reading(
    job: &RecordingJob,
    watch: &DetectWatch<'_>,
    read: impl FnOnce(Deliver<'_>) -> Result<Contents, Error>,
) -> Result<(Contents, Vec<SeenRecorded>), Error> {
    let threads = rayon::current_num_threads().max(1);
    let queue = Queue::new(threads * WAITING_FOR_EACH);
    let (found, done) = (AtomicUsize::new(0), AtomicUsize::new(0));
    let work = || {
        // Should a thread panic, the reader must not wait for it.
        let _closes = Closes(&queue);
        let mut seen = Vec::new();
        while let Some(image) = queue.pop() {
            seen.push(look_at(&image, job, watch));
            (watch.progress)(done.fetch_add(1, Ordering::Relaxed) + 1, found.load(Ordering::Relaxed));
        }
        seen
    };
    std::thread::scope(|scope| {
        // Should reading panic, the threads must not wait for more, as the scope waits for them.
        let _closes = Closes(&queue);
        let workers: Vec<_> = (0..threads).map(|_| scope.spawn(work)).collect();
        let begin = Instant::now();
        let mut waited = Duration::ZERO;
        let contents = read(&mut |image| {
            watch.stages.count();
            found.fetch_add(1, Ordering::Relaxed);
            let before = Instant::now();
            let flow = queue.push(image);
            waited += before.elapsed();
            flow
        });
        watch.stages.add_read(begin.elapsed().saturating_sub(waited));
        queue.close();
        let mut seen = Vec::new();
        for worker in workers {
            match worker.join() {
                Ok(mut part) => seen.append(&mut part),
                Err(panic) => std::panic::resume_unwind(panic),
            }
        }
        Ok((contents?, seen))
    })
}

fn look_at(image: &RecordedImage, job: &RecordingJob, watch: &DetectWatch<'_>) -> SeenRecorded {
    let seen = image.open().and_then(|opened| {
        let decode = || opened.decode().map(|image| (image, false));
        Ok((opened.stamp_ns, look_up_or_detect(opened.hash(), job.target(), watch, decode)?))
    });
    let RecordedImage { topic_idx, index, log_time_ns, .. } = *image;
    SeenRecorded { topic_idx, index, log_time_ns, seen }
}

/// Images on their way from the thread that reads to those that detect.
struct Queue {
    state: Mutex<Waiting>,
    changed: Condvar,
    most: usize,
}

#[derive(Default)]
struct Waiting {
    images: VecDeque<RecordedImage>,
    bytes: usize,
    is_closed: bool,
}

impl Queue {
    fn new(most: usize) -> Self {
        Self { state: Mutex::default(), changed: Condvar::new(), most }
    }

    fn state(&self) -> MutexGuard<'_, Waiting> {
        // A thread that panicked has left the queue whole: nothing is half done while it is held.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Adds an image as soon as there is room; breaks if nobody takes any more.
    fn push(&self, image: RecordedImage) -> ControlFlow<()> {
        let bytes = image.bytes();
        let mut state = self.state();
        while !state.is_closed
            && (state.images.len() >= self.most
                || (!state.images.is_empty() && state.bytes + bytes > WAITING_BYTES))
        {
            state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
        if state.is_closed {
            return ControlFlow::Break(());
        }
        state.bytes += bytes;
        state.images.push_back(image);
        drop(state);
        self.changed.notify_all();
        ControlFlow::Continue(())
    }

    /// Takes the next image, or `None` once the queue is closed and empty.
    fn pop(&self) -> Option<RecordedImage> {
        let mut state = self.state();
        loop {
            if let Some(image) = state.images.pop_front() {
                state.bytes -= image.bytes();
                drop(state);
                self.changed.notify_all();
                return Some(image);
            }
            if state.is_closed {
                return None;
            }
            state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
    }

    fn close(&self) {
        self.state().is_closed = true;
        self.changed.notify_all();
    }
}

/// Closes a queue when it goes.
struct Closes<'a>(&'a Queue);

impl Drop for Closes<'_> {
    fn drop(&mut self) {
        self.0.close();
    }
}

#[cfg(test)]
mod tests {
    use boresight_io::{DetectionCache, JobOverrides, load_recordings, parse_target};

    use super::*;
    use crate::images::Stages;

    #[test]
    fn a_reader_that_panics_does_not_leave_its_threads_waiting() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.mcap");
        std::fs::write(&path, b"").unwrap();
        let target = Some(parse_target("chessboard:7x5:30mm").unwrap());
        let overrides = JobOverrides { target, ..JobOverrides::default() };
        let job = load_recordings(&[path], &overrides).unwrap().unwrap();
        let (cache, stages) = (DetectionCache::default(), Stages::default());
        let watch = DetectWatch { progress: &|_, _| {}, cache: &cache, stages: &stages };
        let work = || detect_while_reading(&job, &watch, |_| panic!("the reader panics"));
        let panicked = std::panic::catch_unwind(std::panic::AssertUnwindSafe(work));
        assert!(panicked.is_err());
    }
}
