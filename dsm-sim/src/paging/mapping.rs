//! What the threads of a node see: the memory hardware, and the oracle that watches it.

use dsm_core::id::{PageId, SlotId};
use dsm_core::page_table::PageTable;

use super::workload::contents_of;

/// Which pages a node's threads can read, and what lies in its slots.
///
/// It is told what the driver does and knows nothing of why; what it finds wrong is a promise broken.
///
/// # Invariants
/// - `RIGHT_PAGE`: whoever reads a page reads its contents and no other page's.
/// - `WHOLE_PAGE`: a page is seen by readers only when all of it has come.
/// - `SLOT_HOLDS_ONE_PAGE`: a slot whose page is seen by readers is not filled.
/// - `BOUNDED`: pages seen by readers are never more than slots.
#[derive(Debug)]
pub(super) struct Mapping {
    /// A bit for each page that readers see.
    visible: Vec<u64>,
    visible_count: u32,
    slots: Vec<Slot>,
}

/// What lies in a slot.
#[derive(Clone, Copy, Debug)]
struct Slot {
    page: PageId,
    is_visible: bool,
    contents: u64,
}

impl Mapping {
    pub(super) fn new(page_count: u32, slot_count: u32) -> Self {
        let slot = Slot { page: PageId(u32::MAX), is_visible: false, contents: 0 };
        Self {
            visible: vec![0; (page_count as usize).div_ceil(64)],
            visible_count: 0,
            slots: vec![slot; slot_count as usize],
        }
    }

    /// Forgets everything, as memory does.
    pub(super) fn clear(&mut self) {
        self.visible.fill(0);
        self.visible_count = 0;
        self.slots.iter_mut().for_each(|slot| slot.is_visible = false);
    }

    pub(super) fn is_visible(&self, page: PageId) -> bool {
        self.visible[page.index() / 64] >> (page.0 % 64) & 1 == 1
    }

    /// Fills a slot and shows its page to readers.
    pub(super) fn map(&mut self, page: PageId, slot: SlotId, contents: u64) {
        let place = &mut self.slots[slot.index()];
        assert!(
            !place.is_visible,
            "SLOT_HOLDS_ONE_PAGE: {page} fills {slot:?}, where readers see {}",
            place.page
        );
        assert!(!self.is_visible(page), "SLOT_HOLDS_ONE_PAGE: {page} is seen in another slot already");
        self.slots[slot.index()] = Slot { page, is_visible: true, contents };
        self.visible[page.index() / 64] |= 1 << (page.0 % 64);
        self.visible_count += 1;
        assert!(self.visible_count as usize <= self.slots.len(), "BOUNDED: {} pages", self.visible_count);
    }

    /// Takes a page away from its readers.
    pub(super) fn unmap(&mut self, page: PageId, slot: SlotId) {
        let place = &mut self.slots[slot.index()];
        assert!(place.is_visible && place.page == page, "a victim, {page}, is not in {slot:?}");
        place.is_visible = false;
        self.visible[page.index() / 64] &= !(1 << (page.0 % 64));
        self.visible_count -= 1;
    }

    /// A thread reads a page that it sees.
    pub(super) fn read(&self, page: PageId, table: &PageTable<'_>) {
        let slot = table.slot(page).map(|slot| self.slots[slot.index()]);
        let is_right = slot
            .is_some_and(|slot| slot.is_visible && slot.page == page && slot.contents == contents_of(page));
        assert!(is_right, "RIGHT_PAGE: a thread read {page} and found {slot:?}");
    }

    /// Checks that everything agrees with each other and with the table.
    pub(super) fn check_invariants(&self, table: &PageTable<'_>) {
        let seen: u32 = self.visible.iter().map(|word| word.count_ones()).sum();
        assert_eq!(seen, self.visible_count, "BOUNDED: pages that readers see are counted");
        let shown = self.slots.iter().filter(|slot| slot.is_visible);
        assert_eq!(shown.clone().count(), seen as usize, "SLOT_HOLDS_ONE_PAGE");
        for slot in shown {
            self.read(slot.page, table);
        }
    }
}
