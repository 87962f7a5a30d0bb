//! Slots in a row, linked through the slots themselves.

use crate::id::SlotId;
use crate::storage::{NONE, SlotEntry};

/// A first-in first-out list of slots that also lets one go from its middle.
#[derive(Clone, Debug)]
pub(super) struct Queue {
    head: u32,
    tail: u32,
    count: u32,
}

impl Queue {
    pub(super) const fn new() -> Self {
        Self { head: NONE, tail: NONE, count: 0 }
    }

    pub(super) fn push(&mut self, slots: &mut [SlotEntry], slot: SlotId) {
        let entry = &mut slots[slot.index()];
        (entry.next, entry.previous) = (NONE, self.tail);
        match self.tail {
            NONE => self.head = slot.0,
            tail => slots[tail as usize].next = slot.0,
        }
        self.tail = slot.0;
        self.count += 1;
    }

    pub(super) fn pop(&mut self, slots: &mut [SlotEntry]) -> Option<SlotId> {
        let slot = self.first()?;
        self.remove(slots, slot);
        Some(slot)
    }

    /// Takes `slot`, which is in this list, out of it.
    pub(super) fn remove(&mut self, slots: &mut [SlotEntry], slot: SlotId) {
        let SlotEntry { next, previous, .. } = slots[slot.index()];
        match previous {
            NONE => self.head = next,
            previous => slots[previous as usize].next = next,
        }
        match next {
            NONE => self.tail = previous,
            next => slots[next as usize].previous = previous,
        }
        self.count -= 1;
    }

    /// The slot that came first.
    pub(super) fn first(&self) -> Option<SlotId> {
        (self.head != NONE).then_some(SlotId(self.head))
    }

    /// The slot that came after `slot`.
    pub(super) fn after(&self, slots: &[SlotEntry], slot: SlotId) -> Option<SlotId> {
        let next = slots[slot.index()].next;
        (next != NONE).then_some(SlotId(next))
    }

    /// Slots in the list.
    pub(super) const fn count(&self) -> u32 {
        self.count
    }
}
