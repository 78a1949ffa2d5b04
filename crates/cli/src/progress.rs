//! A progress line while a solve runs, on a terminal only.

use std::io::IsTerminal as _;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use boresight::Observer;
use indicatif::{ProgressBar, ProgressStyle};

/// Returns the progress line, hidden where stderr is no terminal, and an observer that feeds it.
pub(crate) fn start() -> (ProgressBar, Observer) {
    let bar =
        if std::io::stderr().is_terminal() { ProgressBar::new_spinner() } else { ProgressBar::hidden() };
    // A template that indicatif does not take would only cost the looks.
    if let Ok(style) = ProgressStyle::with_template("{spinner} {elapsed} {msg}") {
        bar.set_style(style);
    }
    bar.set_message("finding a start");
    bar.enable_steady_tick(Duration::from_millis(100));
    let steps = Arc::new(AtomicUsize::new(0));
    let shown = bar.clone();
    let observer: Observer = Arc::new(move |progress: boresight::Progress| {
        let step = steps.fetch_add(1, Ordering::Relaxed) + 1;
        shown.set_message(format!("solving: step {step}, cost {:.6e}", progress.cost));
    });
    (bar, observer)
}

/// Returns the progress bar of a detection, hidden where stderr is no terminal, and what feeds it.
pub(crate) fn of_images() -> (ProgressBar, impl Fn(usize, usize) + Sync) {
    let bar = if std::io::stderr().is_terminal() { ProgressBar::new(0) } else { ProgressBar::hidden() };
    if let Ok(style) = ProgressStyle::with_template("{elapsed} detecting {bar:40} {pos} of {len} images") {
        bar.set_style(style);
    }
    let shown = bar.clone();
    let tell = move |done: usize, total: usize| {
        shown.set_length(total as u64);
        // Threads may tell out of order; the bar does not go back.
        if done as u64 > shown.position() {
            shown.set_position(done as u64);
        }
    };
    (bar, tell)
}
