//! What threads sleep on while another thread fetches their page.

use dsm_core::id::PageId;

use crate::sync::{AtomicU32, Ordering, futex_wait, futex_wake_all};

/// A fixed number of words, shared by all pages: a few threads ever wait, so pages rarely meet.
///
/// # How no wake-up is lost
/// A word is read under the lock of the state machine, together with the answer "wait". Whoever changes the page's
/// state does so under the same lock, later, and changes the word after that. So a waiter that sleeps on what it has
/// read either still finds the old value and is woken, or finds another and does not sleep. Loom checks this and the
/// lock in `waiting_model`.
#[derive(Debug)]
pub(crate) struct Words {
    pages: [AtomicU32; PAGE_WORDS],
    slots: AtomicU32,
}

/// A word as it was when somebody was told to wait.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Ticket<'a> {
    word: &'a AtomicU32,
    seen: u32,
}

const PAGE_WORDS: usize = if cfg!(loom) { 1 } else { 256 };

impl Words {
    pub(crate) fn new() -> Self {
        Self { pages: core::array::from_fn(|_| AtomicU32::new(0)), slots: AtomicU32::new(0) }
    }

    /// For a thread that is to wait for `page`. Call it under the lock.
    pub(crate) fn ticket_for_page(&self, page: PageId) -> Ticket<'_> {
        Ticket::new(self.word(page))
    }

    /// For a thread that is to wait for a slot. Call it under the lock.
    pub(crate) fn ticket_for_slot(&self) -> Ticket<'_> {
        Ticket::new(&self.slots)
    }

    pub(crate) fn wake_page(&self, page: PageId) {
        wake(self.word(page));
    }

    pub(crate) fn wake_slots(&self) {
        wake(&self.slots);
    }

    pub(crate) fn wake_all(&self) {
        self.pages.iter().for_each(wake);
        self.wake_slots();
    }

    fn word(&self, page: PageId) -> &AtomicU32 {
        &self.pages[page.index() % PAGE_WORDS]
    }
}

impl<'a> Ticket<'a> {
    fn new(word: &'a AtomicU32) -> Self {
        Self { word, seen: word.load(Ordering::Acquire) }
    }

    /// Sleeps until woken, at most `timeout_us`. The caller looks again in any case.
    pub(crate) fn wait(self, timeout_us: u64) {
        futex_wait(self.word, self.seen, timeout_us);
    }
}

fn wake(word: &AtomicU32) {
    word.fetch_add(1, Ordering::Release);
    futex_wake_all(word);
}
