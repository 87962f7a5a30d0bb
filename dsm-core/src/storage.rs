//! The memory a node works in. It owns no array; the caller lends all.

pub use crate::membership::PeerEntry;
use crate::page_state::PageState;
use crate::prefetch::Foretold;
pub use crate::request::RequestEntry;

/// Memory lent to a [`Node`](crate::node::Node) for as long as it lives.
///
/// A test lends `[PageEntry::EMPTY; 64]`, a cluster a `Vec` of a million: the same code.
#[derive(Debug)]
pub struct Storage<'s> {
    /// One entry per page of the address space, resident or not.
    pub pages: &'s mut [PageEntry],
    /// One entry per slot; decides how many pages can be resident at once.
    pub slots: &'s mut [SlotEntry],
    /// One entry per node that owns pages.
    pub peers: &'s mut [PeerEntry],
    /// One entry per request; decides how many pages can be asked for at once.
    pub requests: &'s mut [RequestEntry],
}

/// What a node knows of one page, in 4 bytes. Opaque; start with [`PageEntry::EMPTY`].
///
/// Bits 0..4 the state, bit 4 "somebody waits", bits 5..32 the slot.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct PageEntry(u32);

/// What a node knows of one slot, in 32 bytes, so that none lies on two lines of a cache. Opaque; start with
/// [`SlotEntry::EMPTY`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[repr(align(32))]
pub struct SlotEntry {
    /// The page in this slot, or [`NONE`] when it is free.
    pub(crate) page: u32,
    /// The next slot of the list this one is in: the free list, or the order of a replacement policy.
    pub(crate) next: u32,
    /// The slot before this one, in a list that can be left from its middle.
    pub(crate) previous: u32,
    /// The page in this slot may be chosen as a victim: it is resident, and neither coming nor leaving.
    pub(crate) evictable: bool,
    /// How often the page was used since the policy last looked, as far as the policy counts.
    pub(crate) uses: u8,
    /// The page was brought before anybody touched it, and nobody is known to have used it yet.
    pub(crate) prefetched: Option<Foretold>,
    /// A page that left not long ago, or [`NONE`]. Has nothing to do with the page that is in the slot.
    pub(crate) ghost: u32,
    /// Tells how long ago `ghost` left.
    pub(crate) ghost_number: u32,
    /// The tile that is expected to use the page next, or that used it last, in the count of all tiles.
    pub(crate) next_use: u32,
}

/// Stands for "no page" and "no slot".
pub(crate) const NONE: u32 = u32::MAX;

/// Slots that a node can have at most: what fits the entry of a page.
pub const SLOTS_MAX: u32 = (1 << 27) - 1;

const STATE_MASK: u32 = 0b1111;
const WAITED_FOR: u32 = 0b1_0000;
const SLOT_SHIFT: u32 = 5;

impl PageEntry {
    /// A page that is absent and that nobody waits for.
    pub const EMPTY: Self = Self(PageState::Absent as u32);

    pub(crate) fn state(self) -> PageState {
        PageState::from_bits(self.0 & STATE_MASK)
    }

    pub(crate) fn slot(self) -> u32 {
        self.0 >> SLOT_SHIFT
    }

    pub(crate) fn is_waited_for(self) -> bool {
        self.0 & WAITED_FOR != 0
    }

    pub(crate) fn set_state(&mut self, state: PageState) {
        self.0 = (self.0 & !STATE_MASK) | state as u32;
    }

    pub(crate) fn set_slot(&mut self, slot: u32) {
        debug_assert!(slot <= SLOTS_MAX);
        self.0 = (self.0 & (STATE_MASK | WAITED_FOR)) | (slot << SLOT_SHIFT);
    }

    pub(crate) fn set_waited_for(&mut self, waited_for: bool) {
        self.0 = (self.0 & !WAITED_FOR) | if waited_for { WAITED_FOR } else { 0 };
    }
}

impl SlotEntry {
    /// A free slot.
    pub const EMPTY: Self = Self {
        page: NONE,
        next: NONE,
        previous: NONE,
        evictable: false,
        uses: 0,
        prefetched: None,
        ghost: NONE,
        ghost_number: 0,
        next_use: 0,
    };

    /// A free slot that still remembers the ghost in it.
    pub(crate) const fn cleared(&self) -> Self {
        Self { ghost: self.ghost, ghost_number: self.ghost_number, ..Self::EMPTY }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_entry_keeps_its_three_parts_apart() {
        for state in PageState::ALL {
            for slot in [0, 1, SLOTS_MAX] {
                for waited_for in [false, true] {
                    let mut entry = PageEntry::EMPTY;
                    entry.set_slot(slot);
                    entry.set_waited_for(waited_for);
                    entry.set_state(state);
                    assert_eq!(
                        (entry.state(), entry.slot(), entry.is_waited_for()),
                        (state, slot, waited_for)
                    );
                }
            }
        }
    }

    #[test]
    fn a_page_costs_4_bytes_and_a_slot_32() {
        assert_eq!(size_of::<PageEntry>(), 4);
        assert_eq!(size_of::<SlotEntry>(), 32);
    }
}
