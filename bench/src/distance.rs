//! How far apart two cores are.
//!
//! A virtual machine's cores wander over the real ones: now they share a cache, now they sit on different dies, and
//! whatever two threads share costs ten times as much. What two threads gain over one depends on it more than on
//! anything else, so it is measured beside that.

use core::hint::spin_loop;
use core::sync::atomic::{AtomicU32, Ordering};
use std::thread;
use std::time::Instant;

use crate::machine;

const STRETCHES: u32 = 24;

/// To and fro, so many times in each stretch.
const TRIPS: u32 = 500;

/// A thread that waits so long will not be answered.
const LOOKS_MAX: u32 = 2_000_000;

/// Nanoseconds until a core sees what another has written; `None` when two threads never ran at once.
///
/// Two threads hand a word to and fro; the shortest stretch counts, for in others one may have been held up, or both
/// begun on one core.
pub(crate) fn between_cores_ns() -> Option<f64> {
    if machine::cores() < 2 {
        return None;
    }
    let word = AtomicU32::new(0);
    thread::scope(|scope| {
        scope.spawn(|| (0..STRETCHES).all(|stretch| hand_on(&word, 2 * TRIPS * stretch + 1)));
        let stretch_ns = |stretch: u32| {
            let start = Instant::now();
            let ns = hand_on(&word, 2 * TRIPS * stretch).then(|| start.elapsed().as_secs_f64() * 1e9);
            ns.map(|ns| ns / f64::from(2 * TRIPS))
        };
        (0..STRETCHES).map_while(stretch_ns).min_by(f64::total_cmp)
    })
}

/// Waits for `first` and passes on the number after it, then waits for the one after that, and so on.
fn hand_on(word: &AtomicU32, first: u32) -> bool {
    (0..TRIPS).all(|trip| {
        let mine = first + 2 * trip;
        let is_mine = wait_for(word, mine);
        word.store(mine + 1, Ordering::Release);
        is_mine
    })
}

fn wait_for(word: &AtomicU32, value: u32) -> bool {
    for _ in 0..LOOKS_MAX {
        if word.load(Ordering::Acquire) == value {
            return true;
        }
        spin_loop();
    }
    false
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_word_takes_some_time_if_two_threads_run_at_all() {
        assert!(between_cores_ns().is_none_or(|ns| ns > 0.0 && ns < 1e6));
    }
}
