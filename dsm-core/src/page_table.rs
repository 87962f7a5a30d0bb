//! The state of every page, and the slots that pages lie in.

use core::fmt;
use core::hash::{Hash, Hasher};
use core::hint::black_box;

use crate::failure::Failure;
use crate::id::{NodeId, PageId, SlotId};
use crate::page_state::{Effect, PageEvent, PageState};
use crate::placement::Stripes;
use crate::storage::{NONE, PageEntry, SLOTS_MAX, SlotEntry};

/// All pages of the address space and all slots of this node, kept consistent with each other.
///
/// # Invariants
/// - `SLOT_HOLDS_ONE_PAGE`: a page has a slot exactly when its state says so, and no two pages share one.
/// - `EVICTABLE_IS_RESIDENT`: a slot may be chosen as a victim exactly when its page is resident.
/// - `NO_LOST_WAITER`: a page that somebody waits for is on its way in or out.
/// - A slot is on the free list exactly when no page has it.
#[derive(Debug)]
pub struct PageTable<'s> {
    pages: &'s mut [PageEntry],
    slots: &'s mut [SlotEntry],
    lists: Lists,
}

/// What a page table keeps besides the lent entries.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Lists {
    free_head: u32,
    free_count: u32,
    leaving_count: u32,
    resident_count: u32,
    /// Pages that are hidden, and no longer being hidden.
    hidden_count: u32,
}

/// Why the lent storage cannot hold a page table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum StorageError {
    /// The address space has `needed` pages, and `got` entries were lent.
    Pages {
        /// Pages of the address space.
        needed: u32,
        /// Entries lent.
        got: usize,
    },
    /// Not even one slot, although other nodes own pages.
    NoSlots,
    /// There are `needed` nodes that own pages, and `got` entries were lent.
    Peers {
        /// Nodes that own pages.
        needed: u16,
        /// Entries lent.
        got: usize,
    },
    /// Not even one request, although other nodes own pages.
    NoRequests,
    /// More slots than an entry can name.
    TooManySlots {
        /// Entries lent.
        got: usize,
    },
}

impl<'s> PageTable<'s> {
    /// Takes the lent storage into use, with the pages that `me` holds as an owner marked and everything else absent.
    ///
    /// # Errors
    /// The storage does not fit the placement.
    pub fn new(
        pages: &'s mut [PageEntry],
        slots: &'s mut [SlotEntry],
        placement: &Stripes,
        me: NodeId,
    ) -> Result<Self, StorageError> {
        let needed = placement.page_count();
        if pages.len() != needed as usize {
            return Err(StorageError::Pages { needed, got: pages.len() });
        }
        if slots.is_empty() && placement.held_pages(me) < needed {
            return Err(StorageError::NoSlots);
        }
        let slot_count = match u32::try_from(slots.len()) {
            Ok(count) if count <= SLOTS_MAX => count,
            _ => return Err(StorageError::TooManySlots { got: slots.len() }),
        };
        pages.fill(PageEntry::EMPTY);
        for stripe in placement.held_stripes_of(me) {
            for page in stripe {
                pages[page as usize].set_state(PageState::Home);
            }
        }
        for (slot, entry) in (1..=slot_count).zip(slots.iter_mut()) {
            *entry = SlotEntry { next: if slot == slot_count { NONE } else { slot }, ..SlotEntry::EMPTY };
        }
        let free_head = if slot_count == 0 { NONE } else { 0 };
        let lists =
            Lists { free_head, free_count: slot_count, leaving_count: 0, resident_count: 0, hidden_count: 0 };
        Ok(Self { pages, slots, lists })
    }

    /// The table again, in memory that it has worked in before.
    pub(crate) fn resume(pages: &'s mut [PageEntry], slots: &'s mut [SlotEntry], lists: Lists) -> Self {
        Self { pages, slots, lists }
    }

    pub(crate) fn lists(&self) -> Lists {
        self.lists
    }

    /// Gives the lent entries back. What is in them means nothing any more.
    pub(crate) fn into_entries(self) -> (&'s mut [PageEntry], &'s mut [SlotEntry]) {
        (self.pages, self.slots)
    }

    /// Feeds a hash with the state of every page and slot.
    pub(crate) fn fingerprint(&self, hasher: &mut impl Hasher) {
        self.pages.hash(hasher);
        self.slots.hash(hasher);
        self.lists.free_head.hash(hasher);
    }

    /// Moves `page` along the transition table and keeps the slots consistent with its new state.
    ///
    /// A fault on an absent page takes a free slot; the caller has made sure that there is one.
    pub(crate) fn apply(&mut self, page: PageId, event: PageEvent) -> Effect {
        let entry = &mut self.pages[page.index()];
        let before = entry.state();
        let (next, effect) = before.on(event);
        entry.set_state(next);
        match effect {
            Effect::SendRequest => self.take_slot(page),
            Effect::Wait => self.pages[page.index()].set_waited_for(true),
            Effect::Wake => self.mark_resident(page),
            Effect::Unmap => self.mark_leaving(page, before),
            Effect::Hide => self.mark_unseen(page),
            Effect::Keep => self.lists.hidden_count += 1,
            Effect::Show => self.lists.hidden_count -= 1,
            Effect::Release => {
                self.lists.leaving_count -= 1;
                self.free_slot(page);
            }
            Effect::Fail | Effect::Forget => self.free_slot(page),
            Effect::None | Effect::Ready | Effect::Refuse | Effect::Map => {}
        }
        effect
    }

    /// Tells whether anybody waited for `page`, and forgets it.
    pub(crate) fn take_waited_for(&mut self, page: PageId) -> bool {
        let entry = &mut self.pages[page.index()];
        let waited_for = entry.is_waited_for();
        entry.set_waited_for(false);
        waited_for
    }

    /// Remembers why `page` failed, where its slot was.
    pub(crate) fn set_failure(&mut self, page: PageId, failure: Failure) {
        debug_assert_eq!(self.state(page), Some(PageState::Failed));
        self.pages[page.index()].set_slot(failure.to_bits());
    }

    /// Why `page` failed.
    pub(crate) fn failure(&self, page: PageId) -> Failure {
        Failure::from_bits(self.pages[page.index()].slot())
    }

    /// The slots, for a replacement policy to keep its order in.
    pub(crate) fn slots_mut(&mut self) -> &mut [SlotEntry] {
        self.slots
    }

    /// Reads the entries of the pages in `slots`, to no other end than that all are on their way from memory at once: whoever
    /// works on one after the other then waits once.
    pub(crate) fn begin_reading(&self, slots: &[SlotId]) {
        for slot in slots {
            black_box(self.page_in(*slot).and_then(|page| self.state(page)));
        }
    }

    /// Pages of the address space.
    #[must_use]
    pub fn page_count(&self) -> u32 {
        u32::try_from(self.pages.len()).unwrap_or(u32::MAX)
    }

    /// All slots, free or not.
    #[must_use]
    pub fn slot_count(&self) -> u32 {
        u32::try_from(self.slots.len()).unwrap_or(u32::MAX)
    }

    /// Slots without a page.
    #[must_use]
    pub fn free_count(&self) -> u32 {
        self.lists.free_count
    }

    /// Slots whose page is being taken away.
    #[must_use]
    pub fn leaving_count(&self) -> u32 {
        self.lists.leaving_count
    }

    /// Pages that are mapped and not this node's own.
    #[must_use]
    pub fn resident_count(&self) -> u32 {
        self.lists.resident_count
    }

    /// Pages that are out of their readers' sight and kept.
    #[must_use]
    pub fn hidden_count(&self) -> u32 {
        self.lists.hidden_count
    }

    /// The state of `page`, or `None` when there is no such page.
    #[must_use]
    pub fn state(&self, page: PageId) -> Option<PageState> {
        self.pages.get(page.index()).map(|entry| entry.state())
    }

    /// The slot of `page`, or `None` when it has none.
    #[must_use]
    pub fn slot(&self, page: PageId) -> Option<SlotId> {
        let entry = self.pages.get(page.index())?;
        entry.state().holds_slot().then(|| SlotId(entry.slot()))
    }

    /// The page in `slot`, or `None` when it is free or there is no such slot.
    #[must_use]
    pub fn page_in(&self, slot: SlotId) -> Option<PageId> {
        let entry = self.slots.get(slot.index())?;
        (entry.page != NONE).then_some(PageId(entry.page))
    }

    /// Pages in slots that were brought ahead and are not known to have been used. For tests: looks at every slot.
    pub(crate) fn prefetched_count(&self) -> u64 {
        self.slots.iter().map(|slot| u64::from(slot.prefetched.is_some())).sum()
    }

    /// Checks every invariant named at the type. For tests: its cost grows with the number of pages.
    ///
    /// # Panics
    /// When one does not hold; the message names it.
    pub fn check_invariants(&self) {
        for page in self.pages.iter().filter(|page| page.is_waited_for()) {
            let due = matches!(
                page.state(),
                PageState::Requested | PageState::Filling | PageState::Leaving | PageState::Hiding
            );
            assert!(due, "NO_LOST_WAITER: {page:?} is waited for and nothing will wake who waits");
        }
        let mut free = 0;
        for (index, slot) in self.slots.iter().enumerate() {
            let state = (slot.page != NONE).then(|| self.pages[slot.page as usize]);
            assert_eq!(
                slot.evictable,
                state.is_some_and(|page| page.state() == PageState::Resident),
                "EVICTABLE_IS_RESIDENT"
            );
            match state {
                None => free += 1,
                Some(page) => assert!(
                    page.state().holds_slot() && page.slot() as usize == index,
                    "SLOT_HOLDS_ONE_PAGE: slot {index} says {}, which says {page:?}",
                    slot.page,
                ),
            }
        }
        assert_eq!(free, self.lists.free_count, "free slots are counted");
        let count = |state| self.pages.iter().filter(|page| page.state() == state).count();
        assert_eq!(count(PageState::Leaving), self.lists.leaving_count as usize, "leaving pages are counted");
        assert_eq!(
            count(PageState::Resident),
            self.lists.resident_count as usize,
            "resident pages are counted"
        );
        assert_eq!(count(PageState::Hidden), self.lists.hidden_count as usize, "hidden pages are counted");
        let holding = self.pages.iter().filter(|page| page.state().holds_slot()).count();
        assert_eq!(holding + free as usize, self.slots.len(), "SLOT_HOLDS_ONE_PAGE");
    }

    fn take_slot(&mut self, page: PageId) {
        let slot = self.lists.free_head;
        debug_assert_ne!(slot, NONE, "a fault is let through only when a slot is free");
        let entry = &mut self.slots[slot as usize];
        self.lists.free_head = entry.next;
        *entry = SlotEntry { page: page.0, ..entry.cleared() };
        self.lists.free_count -= 1;
        self.pages[page.index()].set_slot(slot);
    }

    fn free_slot(&mut self, page: PageId) {
        let slot = self.pages[page.index()].slot();
        let entry = &mut self.slots[slot as usize];
        *entry = SlotEntry { next: self.lists.free_head, ..entry.cleared() };
        self.lists.free_head = slot;
        self.lists.free_count += 1;
    }

    fn mark_resident(&mut self, page: PageId) {
        let slot = self.pages[page.index()].slot();
        self.slots[slot as usize].evictable = true;
        self.lists.resident_count += 1;
    }

    fn mark_leaving(&mut self, page: PageId, before: PageState) {
        if before == PageState::Hidden {
            self.lists.hidden_count -= 1;
        } else {
            self.mark_unseen(page);
        }
        self.lists.leaving_count += 1;
    }

    fn mark_unseen(&mut self, page: PageId) {
        let slot = self.pages[page.index()].slot();
        self.slots[slot as usize].evictable = false;
        self.lists.resident_count -= 1;
    }
}

impl fmt::Display for StorageError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Pages { needed, got } => {
                write!(f, "the address space has {needed} pages and storage for {got} was lent")
            }
            Self::Peers { needed, got } => {
                write!(f, "{needed} nodes own pages and storage for {got} was lent")
            }
            Self::NoRequests => write!(f, "no request was lent, and other nodes own pages"),
            Self::NoSlots => write!(f, "no slot was lent, and other nodes own pages"),
            Self::TooManySlots { got } => write!(f, "{got} slots were lent and {SLOTS_MAX} can be named"),
        }
    }
}

impl core::error::Error for StorageError {}
