//! Slots in the order in which their pages came, linked through the slots themselves.

use crate::id::SlotId;
use crate::storage::{NONE, SlotEntry};

/// A first-in first-out list of slots. Holds evictable slots only.
#[derive(Clone, Debug)]
pub(super) struct Queue {
    head: u32,
    tail: u32,
}

impl Queue {
    pub(super) const fn new() -> Self {
        Self { head: NONE, tail: NONE }
    }

    pub(super) fn push(&mut self, slots: &mut [SlotEntry], slot: SlotId) {
        slots[slot.index()].next = NONE;
        if self.tail == NONE {
            self.head = slot.0;
        } else {
            slots[self.tail as usize].next = slot.0;
        }
        self.tail = slot.0;
    }

    pub(super) fn pop(&mut self, slots: &mut [SlotEntry]) -> Option<SlotId> {
        if self.head == NONE {
            return None;
        }
        let slot = SlotId(self.head);
        self.head = slots[slot.index()].next;
        if self.head == NONE {
            self.tail = NONE;
        }
        Some(slot)
    }
}
