//! A lock that may be taken inside a signal handler.

use core::cell::UnsafeCell;
use core::ops::{Deref, DerefMut};

use crate::sync::{AtomicU32, Ordering, futex_wait, futex_wake_all};

/// Mutual exclusion by one word: no allocation, no poisoning, no thread-local state.
///
/// A thread must not fault on a region while it holds this: the handler would wait for the thread it runs in. The few
/// places that take the lock touch only memory that is always present.
#[derive(Debug)]
pub(crate) struct Lock<T> {
    /// [`FREE`], [`HELD`] or [`WAITED_FOR`].
    word: AtomicU32,
    value: UnsafeCell<T>,
}

/// The value, while it is locked.
#[derive(Debug)]
pub(crate) struct Guard<'a, T> {
    lock: &'a Lock<T>,
}

const FREE: u32 = 0;
const HELD: u32 = 1;
const WAITED_FOR: u32 = 2;

/// Looks before sleeping; what is done under the lock takes well under a microsecond.
const LOOKS: u32 = if cfg!(loom) { 1 } else { 100 };

/// Nobody sleeps longer than this without looking again.
const SLEEP_US: u64 = 10_000;

// SAFETY: the value is reached by one thread at a time, which may be any.
unsafe impl<T: Send> Sync for Lock<T> {}

impl<T> Lock<T> {
    pub(crate) fn new(value: T) -> Self {
        Self { word: AtomicU32::new(FREE), value: UnsafeCell::new(value) }
    }

    pub(crate) fn lock(&self) -> Guard<'_, T> {
        for _ in 0..LOOKS {
            // Acquire: pairs with the Release in `Guard::drop`.
            if self.word.compare_exchange_weak(FREE, HELD, Ordering::Acquire, Ordering::Relaxed).is_ok() {
                return Guard { lock: self };
            }
            core::hint::spin_loop();
        }
        while self.word.swap(WAITED_FOR, Ordering::Acquire) != FREE {
            futex_wait(&self.word, WAITED_FOR, SLEEP_US);
        }
        Guard { lock: self }
    }
}

impl<T> Deref for Guard<'_, T> {
    type Target = T;

    fn deref(&self) -> &T {
        // SAFETY: this guard is the only one there is, so nobody writes.
        unsafe { &*self.lock.value.get() }
    }
}

impl<T> DerefMut for Guard<'_, T> {
    fn deref_mut(&mut self) -> &mut T {
        // SAFETY: this guard is the only one there is, and it is borrowed exclusively.
        unsafe { &mut *self.lock.value.get() }
    }
}

impl<T> Drop for Guard<'_, T> {
    fn drop(&mut self) {
        // Release: pairs with the Acquire in `lock`.
        if self.lock.word.swap(FREE, Ordering::Release) == WAITED_FOR {
            futex_wake_all(&self.lock.word);
        }
    }
}

#[cfg(all(test, not(loom)))]
mod tests {
    use super::*;

    #[test]
    fn counting_under_the_lock_loses_nothing() {
        let lock = Lock::new(0u64);
        std::thread::scope(|scope| {
            for _ in 0..4 {
                scope.spawn(|| (0..50_000).for_each(|_| *lock.lock() += 1));
            }
        });
        assert_eq!(*lock.lock(), 200_000);
    }
}
