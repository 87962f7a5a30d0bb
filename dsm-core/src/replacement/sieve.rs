//! `sieve`: a hand sifts what came in, and what was used stays where it is.

use super::Replacement;
use super::queue::Queue;
use crate::id::SlotId;
use crate::storage::SlotEntry;

/// One queue in order of arrival, and a hand that walks from the oldest page to the newest. A page that was used
/// since the hand last passed keeps its place and loses its mark; the first that was not used leaves.
///
/// Unlike `clock`, a page that is kept is not moved behind the newest, so pages that came and were never used are found
/// soon.
///
/// # Where its reference bits come from
/// As for [`Clock`](super::Clock). With none it is `fifo`.
///
/// # Source
/// Zhang, Yang, Yue, Vigfusson, Rashmi, "SIEVE is Simpler than LRU: an Efficient Turn-Key Eviction Algorithm for Web
/// Caches", NSDI 2024, algorithm 1.
#[derive(Clone, Debug)]
pub struct Sieve {
    queue: Queue,
    /// The slot that the hand looks at next; `None` when it begins with the oldest.
    hand: Option<SlotId>,
}

impl Sieve {
    /// A queue of no slots.
    #[must_use]
    pub const fn new() -> Self {
        Self { queue: Queue::new(), hand: None }
    }
}

impl Default for Sieve {
    fn default() -> Self {
        Self::new()
    }
}

impl Replacement for Sieve {
    fn handle_resident(&mut self, slots: &mut [SlotEntry], slot: SlotId) {
        slots[slot.index()].uses = 0;
        self.queue.push(slots, slot);
    }

    fn handle_reference(&mut self, slots: &mut [SlotEntry], slot: SlotId) {
        slots[slot.index()].uses = 1;
    }

    fn choose_victim(&mut self, slots: &mut [SlotEntry]) -> Option<SlotId> {
        // Every step clears a mark, so the loop ends after one way round at the latest.
        loop {
            let slot = self.hand.or_else(|| self.queue.first())?;
            self.hand = self.queue.after(slots, slot);
            if slots[slot.index()].uses == 0 {
                self.queue.remove(slots, slot);
                return Some(slot);
            }
            slots[slot.index()].uses = 0;
        }
    }
}
