//! The atomics that threads wait on, which are `core`'s or loom's, and the futex, which is the kernel's or a model of it.

#[cfg(not(loom))]
pub(crate) use core::sync::atomic::{AtomicU32, Ordering};
#[cfg(loom)]
pub(crate) use loom::sync::atomic::{AtomicU32, Ordering};

#[cfg(not(loom))]
pub(crate) use crate::sys::{futex_wait, futex_wake_all};
#[cfg(loom)]
pub(crate) use model::{futex_wait, futex_wake_all};

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

    pub(crate) fn futex_wake_all(_word: &AtomicU32) {
        let _guard = KERNEL.0.lock().unwrap();
        KERNEL.1.notify_all();
    }
}
