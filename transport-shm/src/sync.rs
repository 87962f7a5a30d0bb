//! The atomics, which are `core`'s or loom's, and the futex, which is the kernel's or a model of it.

#[cfg(not(loom))]
pub(crate) use core::sync::atomic::{AtomicU32, Ordering, fence};
#[cfg(loom)]
pub(crate) use loom::sync::atomic::{AtomicU32, Ordering, fence};

/// Sleeps while `word` is `expected`, until woken or, on a real kernel, until `timeout_us` has passed.
///
/// May return early for no reason. Async-signal-safe: one system call.
#[cfg(not(loom))]
pub(crate) fn futex_wait(word: &AtomicU32, expected: u32, timeout_us: u64) {
    use rustix::thread::futex::{Flags, Timespec, wait};
    let seconds = i64::try_from(timeout_us / 1_000_000).unwrap_or(i64::MAX);
    let nanoseconds = i64::try_from(timeout_us % 1_000_000 * 1000).unwrap_or(0);
    let timeout = Timespec { tv_sec: seconds, tv_nsec: nanoseconds };
    // Woken, timed out, interrupted or changed already: the caller looks again in each case.
    let _ = wait(word, Flags::empty(), expected, Some(&timeout));
}

/// Wakes everybody who sleeps on `word`. Async-signal-safe: one system call.
#[cfg(not(loom))]
pub(crate) fn futex_wake(word: &AtomicU32) {
    let _ = rustix::thread::futex::wake(word, rustix::thread::futex::Flags::empty(), u32::MAX);
}

#[cfg(loom)]
pub(crate) use model::{futex_wait, futex_wake};

/// A futex as loom can see it: comparing and going to sleep is one step, as the kernel promises.
#[cfg(loom)]
mod model {
    use super::{AtomicU32, Ordering};
    use loom::sync::{Condvar, Mutex};

    loom::lazy_static! {
        static ref KERNEL: (Mutex<()>, Condvar) = (Mutex::new(()), Condvar::new());
    }

    /// Without a timeout, so that a lost wake-up is a deadlock that loom reports.
    pub(crate) fn futex_wait(word: &AtomicU32, expected: u32, _timeout_us: u64) {
        let guard = KERNEL.0.lock().unwrap();
        if word.load(Ordering::SeqCst) == expected {
            drop(KERNEL.1.wait(guard).unwrap());
        }
    }

    pub(crate) fn futex_wake(_word: &AtomicU32) {
        let _guard = KERNEL.0.lock().unwrap();
        KERNEL.1.notify_all();
    }
}
