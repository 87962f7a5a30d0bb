//! `clock`: the page that came first and was not used since.

use super::Replacement;
use super::queue::Queue;
use crate::id::SlotId;
use crate::storage::SlotEntry;

/// First in, first out, with a second chance for a page that was used since the hand last passed it.
///
/// # Where its reference bits come from
/// From [`Node::handle_reference`](crate::node::Node::handle_reference), which a driver that sees its accesses
/// calls (the `soft` backend does), and from faults that find the page here already because another thread was
/// faster. A backend that pages by hardware sees no hits; there `clock` is little else than `fifo`.
///
/// # Source
/// Corbato, "A Paging Experiment with the Multics System", MIT Project MAC, 1968.
#[derive(Clone, Debug)]
pub struct Clock {
    queue: Queue,
}

impl Clock {
    /// A clock of no slots.
    #[must_use]
    pub const fn new() -> Self {
        Self { queue: Queue::new() }
    }
}

impl Default for Clock {
    fn default() -> Self {
        Self::new()
    }
}

impl Replacement for Clock {
    fn handle_resident(&mut self, slots: &mut [SlotEntry], slot: SlotId) {
        slots[slot.index()].uses = 0;
        self.queue.push(slots, slot);
    }

    fn handle_reference(&mut self, slots: &mut [SlotEntry], slot: SlotId) {
        slots[slot.index()].uses = 1;
    }

    fn choose_victim(&mut self, slots: &mut [SlotEntry]) -> Option<SlotId> {
        // Every round clears one bit, so the loop ends after one turn of the clock at the latest.
        loop {
            let slot = self.queue.pop(slots)?;
            if slots[slot.index()].uses == 0 {
                return Some(slot);
            }
            slots[slot.index()].uses = 0;
            self.queue.push(slots, slot);
        }
    }
}
