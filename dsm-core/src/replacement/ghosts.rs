//! Pages that left not long ago, remembered in the slots.

use crate::storage::{NONE, SlotEntry};

/// The last pages that were remembered, about as many as there are slots.
///
/// A table of pages by hash, one place in each slot, in groups of [`WAYS`]. A page that is remembered takes the place in
/// its group that was remembered longest ago, so one may be forgotten a little early; none is known longer than
/// `slots.len()` others after it.
#[derive(Clone, Debug)]
pub(super) struct Ghosts {
    /// Pages remembered so far, wrapping. A page carries the number it was remembered under.
    count: u32,
}

/// Places that a page may lie in.
const WAYS: usize = 4;

impl Ghosts {
    pub(super) const fn new() -> Self {
        Self { count: 0 }
    }

    pub(super) fn remember(&mut self, slots: &mut [SlotEntry], page: u32) {
        self.count = self.count.wrapping_add(1);
        let group = group_of(page, slots);
        let oldest = group.iter_mut().max_by_key(|entry| self.age(entry));
        if let Some(entry) = oldest {
            (entry.ghost, entry.ghost_number) = (page, self.count);
        }
    }

    /// Tells whether `page` is remembered, and forgets it.
    pub(super) fn take(&self, slots: &mut [SlotEntry], page: u32) -> bool {
        let limit = slots.len();
        let mut group = group_of(page, slots).iter_mut();
        let Some(entry) = group.find(|entry| entry.ghost == page) else { return false };
        let is_recent = (self.age(entry) as usize) < limit;
        entry.ghost = NONE;
        is_recent
    }

    /// How many pages were remembered since that one; the most there can be for a place without a page.
    const fn age(&self, entry: &SlotEntry) -> u32 {
        if entry.ghost == NONE { u32::MAX } else { self.count.wrapping_sub(entry.ghost_number) }
    }
}

/// The places that `page` may lie in.
fn group_of(page: u32, slots: &mut [SlotEntry]) -> &mut [SlotEntry] {
    // Multiplicative hashing by the golden section, then multiply and shift instead of a division.
    let hash = u64::from(page.wrapping_mul(0x9E37_79B9));
    let groups = (slots.len() / WAYS).max(1);
    let group = usize::try_from((hash * groups as u64) >> 32).unwrap_or(0);
    let end = if group + 1 == groups { slots.len() } else { (group + 1) * WAYS };
    &mut slots[group * WAYS..end]
}
