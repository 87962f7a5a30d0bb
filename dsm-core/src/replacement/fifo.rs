//! `fifo`: the page that came first leaves first.

use super::Replacement;
use super::queue::Queue;
use crate::id::SlotId;
use crate::storage::SlotEntry;

/// Evicts in the order of arrival. Takes no reference bits.
#[derive(Clone, Debug)]
pub struct Fifo {
    queue: Queue,
}

impl Fifo {
    /// A queue of no slots.
    #[must_use]
    pub const fn new() -> Self {
        Self { queue: Queue::new() }
    }
}

impl Default for Fifo {
    fn default() -> Self {
        Self::new()
    }
}

impl Replacement for Fifo {
    fn handle_resident(&mut self, slots: &mut [SlotEntry], slot: SlotId) {
        self.queue.push(slots, slot);
    }

    fn handle_reference(&mut self, _slots: &mut [SlotEntry], _slot: SlotId) {}

    fn choose_victim(&mut self, slots: &mut [SlotEntry]) -> Option<SlotId> {
        self.queue.pop(slots)
    }
}
