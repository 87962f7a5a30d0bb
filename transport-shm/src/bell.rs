//! Going to sleep until another process has published something, without losing the wake-up.

use crate::sync::{AtomicU32, Ordering, fence, futex_wait, futex_wake};

/// What one thread sleeps on and others ring. Lies in shared memory.
///
/// # How no wake-up is lost
/// The sleeper reads `rung`, says that it sleeps, looks once more, and sleeps only if `rung` is still what it read.
/// The ringer publishes first, and changes `rung` only when it finds somebody sleeping. Whoever comes second sees
/// what the first has done: both pass a sequentially consistent fence between their write and their read.
///
/// The obvious other order (say that you sleep, *then* read `rung`) loses wake-ups: a ringer that publishes an
/// earlier message late takes the sleeping mark away between the two, and the next finds nobody to wake. Loom checks
/// this file in `tests/loom.rs`. Sleeps are timed all the same.
#[derive(Debug)]
#[repr(C, align(64))]
pub struct Bell {
    /// Changes with every ring that found somebody asleep.
    rung: AtomicU32,
    /// 1 from when the sleeper is about to sleep until somebody rings.
    sleeping: AtomicU32,
}

impl Bell {
    /// A bell that nobody has rung. All bits zero, so fresh shared memory holds bells.
    #[must_use]
    pub fn new() -> Self {
        Self { rung: AtomicU32::new(0), sleeping: AtomicU32::new(0) }
    }

    /// Sleeps until rung, but not if `is_ready` says that there is something to do; at most `timeout_us`.
    ///
    /// May return early. Only one thread at a time may wait on a bell.
    pub fn wait(&self, timeout_us: u64, is_ready: impl FnOnce() -> bool) {
        let rung = self.rung.load(Ordering::Acquire);
        self.sleeping.store(1, Ordering::Relaxed);
        // Pairs with the fence in `ring`: either that one sees `sleeping`, or `is_ready` sees what was published.
        fence(Ordering::SeqCst);
        if !is_ready() {
            futex_wait(&self.rung, rung, timeout_us);
        }
        // The mark is left for the next ringer to take: at worst it wakes somebody who is awake. Taking it away here
        // would race with a ringer that is about to.
    }

    /// Wakes the sleeper, if there is one. Call it after publishing.
    pub fn ring(&self) {
        // Pairs with the fence in `wait`.
        fence(Ordering::SeqCst);
        if self.sleeping.load(Ordering::Relaxed) != 0 && self.sleeping.swap(0, Ordering::Relaxed) != 0 {
            // Release: pairs with the Acquire in `wait`, though what was published is found by other means.
            self.rung.fetch_add(1, Ordering::Release);
            futex_wake(&self.rung);
        }
    }
}

impl Default for Bell {
    fn default() -> Self {
        Self::new()
    }
}
