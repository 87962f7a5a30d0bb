//! What the threads of a node see: the memory hardware, and the oracle that watches it.

use dsm_core::id::{NodeId, PageId, SlotId};
use dsm_core::placement::Stripes;
use dsm_core::wire::{FRAGMENTS_MAX, fragment_unit};

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
    /// The pages that the node holds itself, as home or as replica.
    own: Bits,
    /// The pages that readers see in slots.
    visible: Bits,
    visible_count: u32,
    slots: Vec<Slot>,
    /// What has come of the page of each slot, where pages come in parts.
    parts: Vec<Parts>,
}

/// A bit for each page.
#[derive(Debug)]
struct Bits(Vec<u64>);

/// What lies in a slot.
#[derive(Clone, Copy, Debug)]
struct Slot {
    page: PageId,
    is_visible: bool,
    /// Out of readers' sight, with its contents kept.
    is_hidden: bool,
    contents: u64,
}

/// Parts of a page, put aside until all are there.
#[derive(Clone, Copy, Debug)]
struct Parts {
    page: PageId,
    /// A bit for each unit that has come with the right contents.
    units: [u64; FRAGMENTS_MAX as usize / 64],
}

impl Mapping {
    /// Nothing in the slots; the pages that `me` holds are there.
    pub(super) fn new(placement: &Stripes, me: NodeId, slot_count: u32, has_parts: bool) -> Self {
        let slot = Slot { page: NO_PAGE, is_visible: false, is_hidden: false, contents: 0 };
        let mut own = Bits::new(placement.page_count());
        placement.held_stripes_of(me).flatten().for_each(|page| own.set(PageId(page), true));
        Self {
            own,
            visible: Bits::new(placement.page_count()),
            visible_count: 0,
            slots: vec![slot; slot_count as usize],
            parts: vec![Parts::NONE; if has_parts { slot_count as usize } else { 0 }],
        }
    }

    /// Forgets everything but what the node holds itself.
    pub(super) fn clear(&mut self) {
        self.visible.0.fill(0);
        self.visible_count = 0;
        self.slots.iter_mut().for_each(|slot| (slot.is_visible, slot.is_hidden) = (false, false));
        self.parts.fill(Parts::NONE);
    }

    /// Whether readers see the page, in a slot or because the node holds it itself.
    pub(super) fn is_seen(&self, page: PageId) -> bool {
        self.visible.has(page) || self.own.has(page)
    }

    /// Puts a part of a page aside.
    pub(super) fn store(
        &mut self,
        page: PageId,
        slot: SlotId,
        offset: u32,
        bytes: u32,
        unit: u32,
        contents: u64,
    ) {
        let parts = &mut self.parts[slot.index()];
        if parts.page != page {
            *parts = Parts { page, ..Parts::NONE };
        }
        if contents == contents_of(page) {
            for number in offset / unit..(offset + bytes) / unit {
                parts.units[number as usize / 64] |= 1 << (number % 64);
            }
        }
    }

    /// The contents of a page of which all parts are said to have been put aside.
    pub(super) fn gather(&mut self, page: PageId, slot: SlotId, page_bytes: u32) -> u64 {
        let parts = core::mem::replace(&mut self.parts[slot.index()], Parts::NONE);
        let (units, come) =
            (page_bytes / fragment_unit(page_bytes), parts.units.iter().map(|word| word.count_ones()));
        let come: u32 = come.sum();
        assert!(
            parts.page == page && come == units,
            "WHOLE_PAGE: {come} of {units} parts of {page} have come"
        );
        contents_of(page)
    }

    /// Fills a slot and shows its page to readers.
    pub(super) fn map(&mut self, page: PageId, slot: SlotId, contents: u64) {
        let place = &mut self.slots[slot.index()];
        assert!(
            !place.is_visible,
            "SLOT_HOLDS_ONE_PAGE: {page} fills {slot:?}, where readers see {}",
            place.page
        );
        *place = Slot { page, is_visible: true, is_hidden: false, contents };
        assert!(!self.is_seen(page), "SLOT_HOLDS_ONE_PAGE: {page} is seen elsewhere already");
        self.visible.set(page, true);
        self.visible_count += 1;
        assert!(self.visible_count as usize <= self.slots.len(), "BOUNDED: {} pages", self.visible_count);
    }

    /// Takes a page away from its readers, or from where it was hidden.
    pub(super) fn unmap(&mut self, page: PageId, slot: SlotId) {
        let place = &mut self.slots[slot.index()];
        let is_there = (place.is_visible || place.is_hidden) && place.page == page;
        assert!(is_there, "a victim, {page}, is not in {slot:?}");
        let was_visible = core::mem::replace(&mut place.is_visible, false);
        place.is_hidden = false;
        self.visible.set(page, false);
        self.visible_count -= u32::from(was_visible);
    }

    /// Takes a page from its readers' sight and keeps it.
    pub(super) fn hide(&mut self, page: PageId, slot: SlotId) {
        let place = &mut self.slots[slot.index()];
        assert!(place.is_visible && place.page == page, "{page} is hidden and is not in {slot:?}");
        (place.is_visible, place.is_hidden) = (false, true);
        self.visible.set(page, false);
        self.visible_count -= 1;
    }

    /// The contents of a page that is hidden.
    pub(super) fn kept(&self, page: PageId, slot: SlotId) -> u64 {
        let place = &self.slots[slot.index()];
        assert!(place.is_hidden && place.page == page, "RIGHT_PAGE: {page} is shown and is not in {slot:?}");
        place.contents
    }

    /// A thread reads a page that it sees, and that the state machine says is in `slot`.
    pub(super) fn read(&self, page: PageId, slot: Option<SlotId>) {
        if self.own.has(page) {
            return;
        }
        let slot = slot.map(|slot| self.slots[slot.index()]);
        let is_right = slot
            .is_some_and(|slot| slot.is_visible && slot.page == page && slot.contents == contents_of(page));
        assert!(is_right, "RIGHT_PAGE: a thread read {page} and found {slot:?}");
    }

    /// Checks that everything agrees with each other and with the state machine, which says where a page is.
    pub(super) fn check_invariants(&self, slot_of: impl Fn(PageId) -> Option<SlotId>) {
        let seen: u32 = self.visible.0.iter().map(|word| word.count_ones()).sum();
        assert_eq!(seen, self.visible_count, "BOUNDED: pages that readers see are counted");
        let shown = self.slots.iter().filter(|slot| slot.is_visible);
        assert_eq!(shown.clone().count(), seen as usize, "SLOT_HOLDS_ONE_PAGE");
        for slot in shown {
            self.read(slot.page, slot_of(slot.page));
        }
    }
}

impl Bits {
    fn new(page_count: u32) -> Self {
        Self(vec![0; (page_count as usize).div_ceil(64)])
    }

    fn has(&self, page: PageId) -> bool {
        self.0[page.index() / 64] >> (page.0 % 64) & 1 == 1
    }

    fn set(&mut self, page: PageId, value: bool) {
        let word = &mut self.0[page.index() / 64];
        *word = *word & !(1 << (page.0 % 64)) | u64::from(value) << (page.0 % 64);
    }
}

impl Parts {
    const NONE: Self = Self { page: NO_PAGE, units: [0; FRAGMENTS_MAX as usize / 64] };
}

const NO_PAGE: PageId = PageId(u32::MAX);

#[cfg(test)]
mod tests {
    use super::*;

    const PAGE: PageId = PageId(1);
    const OTHER: PageId = PageId(3);
    const SLOT: SlotId = SlotId(0);
    const PAGE_BYTES: u32 = 1024;

    /// Node 0 of two, with the odd pages at node 1, and two slots.
    fn mapping() -> Mapping {
        Mapping::new(&Stripes::new(8, 1, NodeId(0), 2).unwrap(), NodeId(0), 2, true)
    }

    fn with_page(contents: u64) -> Mapping {
        let mut mapping = mapping();
        mapping.map(PAGE, SLOT, contents);
        mapping
    }

    #[test]
    fn a_page_is_seen_from_its_mapping_to_its_unmapping() {
        let mut mapping = with_page(contents_of(PAGE));
        assert!(mapping.is_seen(PAGE) && !mapping.is_seen(OTHER));
        mapping.read(PAGE, Some(SLOT));
        mapping.check_invariants(|_| Some(SLOT));
        mapping.unmap(PAGE, SLOT);
        assert!(!mapping.is_seen(PAGE));
        mapping.check_invariants(|_| None);
    }

    #[test]
    fn own_pages_are_always_there() {
        let mut mapping = mapping();
        mapping.clear();
        assert!(mapping.is_seen(PageId(2)));
        mapping.read(PageId(2), None);
    }

    #[test]
    #[should_panic(expected = "RIGHT_PAGE")]
    fn other_contents_are_noticed() {
        with_page(contents_of(OTHER)).read(PAGE, Some(SLOT));
    }

    #[test]
    #[should_panic(expected = "RIGHT_PAGE")]
    fn another_slot_is_noticed() {
        with_page(contents_of(PAGE)).check_invariants(|_| Some(SlotId(1)));
    }

    #[test]
    #[should_panic(expected = "SLOT_HOLDS_ONE_PAGE")]
    fn filling_a_slot_that_is_seen_is_noticed() {
        with_page(contents_of(PAGE)).map(OTHER, SLOT, contents_of(OTHER));
    }

    #[test]
    #[should_panic(expected = "SLOT_HOLDS_ONE_PAGE")]
    fn a_page_in_two_slots_is_noticed() {
        with_page(contents_of(PAGE)).map(PAGE, SlotId(1), contents_of(PAGE));
    }

    #[test]
    fn all_parts_make_a_page() {
        let mut mapping = mapping();
        for part in [3, 0, 2, 1, 2] {
            mapping.store(PAGE, SLOT, part * 256, 256, fragment_unit(PAGE_BYTES), contents_of(PAGE));
        }
        assert_eq!(mapping.gather(PAGE, SLOT, PAGE_BYTES), contents_of(PAGE));
    }

    #[test]
    #[should_panic(expected = "WHOLE_PAGE")]
    fn a_part_that_is_missing_is_noticed() {
        let mut mapping = mapping();
        for part in 0..3 {
            mapping.store(PAGE, SLOT, part * 256, 256, fragment_unit(PAGE_BYTES), contents_of(PAGE));
        }
        mapping.gather(PAGE, SLOT, PAGE_BYTES);
    }

    #[test]
    #[should_panic(expected = "WHOLE_PAGE")]
    fn a_part_of_another_page_is_noticed() {
        let mut mapping = mapping();
        mapping.store(PAGE, SLOT, 0, 512, fragment_unit(PAGE_BYTES), contents_of(PAGE));
        mapping.store(PAGE, SLOT, 512, 512, fragment_unit(PAGE_BYTES), contents_of(OTHER));
        mapping.gather(PAGE, SLOT, PAGE_BYTES);
    }
}
