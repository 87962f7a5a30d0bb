//! The lock and the words that threads wait on, under every order of memory that the language allows.
//!
//! `RUSTFLAGS="--cfg loom" cargo test -p fault-linux --lib --release`. What waits and wakes here does so in the order of
//! `paging` and `thread`: the word is read under the lock, with the answer; state changes under the lock, the word after.

use dsm_core::id::PageId;
use loom::cell::UnsafeCell;
use loom::sync::Arc;
use loom::thread;

use crate::lock::Lock;
use crate::sync::{AtomicU32, Ordering};
use crate::words::Words;

/// Every execution in which the threads are interrupted at most three times where they need not be.
fn explore(model: impl Fn() + Sync + Send + 'static) {
    let mut builder = loom::model::Builder::new();
    builder.preemption_bound = Some(builder.preemption_bound.unwrap_or(3));
    builder.check(model);
}

/// What the threads of a region share. The cells are watched by loom: the lock must keep threads apart.
struct Shared {
    /// How many pages are present, or slots free.
    present: Lock<UnsafeCell<u32>>,
    words: Words,
    has_failed: AtomicU32,
}

const PAGE: PageId = PageId(0);
/// Shares its word with [`PAGE`].
const OTHER_PAGE: PageId = PageId(1);

impl Shared {
    fn new() -> Arc<Self> {
        let (present, has_failed) = (Lock::new(UnsafeCell::new(0)), AtomicU32::new(0));
        Arc::new(Self { present, words: Words::new(), has_failed })
    }

    /// Adds one under the lock, and changes nothing else.
    fn add(&self) {
        let present = self.present.lock();
        // SAFETY: the lock is held; loom reports it if that keeps nobody out.
        present.with_mut(|present| unsafe { *present += 1 });
    }

    /// Takes one away if there is one.
    fn take(present: &UnsafeCell<u32>) -> bool {
        // SAFETY: as above; the caller holds the lock.
        present.with_mut(|present| unsafe {
            let is_there = *present > 0;
            *present -= u32::from(is_there);
            is_there
        })
    }

    fn wait_for_page(&self) {
        loop {
            let present = self.present.lock();
            if Self::take(&present) {
                return;
            }
            let ticket = self.words.ticket_for_page(PAGE);
            drop(present);
            ticket.wait(0);
        }
    }

    fn wait_for_slot(&self) {
        loop {
            let present = self.present.lock();
            if Self::take(&present) {
                return;
            }
            let ticket = self.words.ticket_for_slot();
            drop(present);
            ticket.wait(0);
        }
    }
}

#[test]
fn the_lock_keeps_threads_apart_and_wakes_whoever_waits_for_it() {
    explore(|| {
        let shared = Shared::new();
        let others = [shared.clone(), shared.clone()].map(|other| thread::spawn(move || other.add()));
        shared.add();
        for other in others {
            other.join().unwrap();
        }
        let present = shared.present.lock();
        // SAFETY: the lock is held.
        assert_eq!(present.with(|present| unsafe { *present }), 3);
    });
}

#[test]
fn whoever_waits_for_a_page_is_woken_when_it_is_there() {
    explore(|| {
        let shared = Shared::new();
        let other = shared.clone();
        let waker = thread::spawn(move || {
            // A page that shares the word comes first: the waiter is woken for nothing, and waits again.
            other.words.wake_page(OTHER_PAGE);
            other.add();
            other.words.wake_page(PAGE);
        });
        shared.wait_for_page();
        waker.join().unwrap();
    });
}

#[test]
fn two_who_wait_for_slots_are_both_woken() {
    explore(|| {
        let shared = Shared::new();
        let waiters = [shared.clone(), shared.clone()].map(|one| thread::spawn(move || one.wait_for_slot()));
        for _ in 0..2 {
            shared.add();
            shared.words.wake_slots();
        }
        for waiter in waiters {
            waiter.join().unwrap();
        }
    });
}

#[test]
fn a_failure_is_seen_by_whoever_was_told_to_wait() {
    explore(|| {
        let shared = Shared::new();
        let other = shared.clone();
        let failing = thread::spawn(move || {
            other.has_failed.store(1, Ordering::Release);
            other.words.wake_all();
        });
        loop {
            let present = shared.present.lock();
            let ticket = shared.words.ticket_for_page(PAGE);
            drop(present);
            // After the ticket, as `resolve` does: else a failure in between wakes nobody.
            if shared.has_failed.load(Ordering::Acquire) == 1 {
                break;
            }
            ticket.wait(0);
        }
        failing.join().unwrap();
    });
}
