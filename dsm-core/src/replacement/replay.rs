//! A cache without a network: what a policy makes of a list of touches.

use super::{Replacement, Residents};
use crate::id::{PageId, SlotId};
use crate::prefetch::{Foretold, Prefetch};
use crate::storage::{NONE, SlotEntry};

/// A cache of pages that takes no time and moves no bytes, to count the misses of a policy on a recorded trace.
///
/// Storage is lent, as for a node: a slot number for each page of the trace, and the slots.
#[derive(Debug)]
pub struct Replay<'s, R> {
    slot_of: &'s mut [u32],
    slots: &'s mut [SlotEntry],
    used: u32,
    residents: Residents<R>,
    prefetch: Prefetch,
}

/// What a touch met.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Touch {
    /// The page was there, and nobody heard of it.
    Hit,
    /// The page was there and hidden: a fault without a message.
    SoftFault,
    /// The page had to be fetched.
    Miss,
}

impl<'s, R: Replacement> Replay<'s, R> {
    /// An empty cache of `slots.len()` slots for pages `0..slot_of.len()`, at most `hidden_max` of them hidden.
    ///
    /// # Panics
    /// When there is no slot, or more than a `u32` counts.
    pub fn new(slot_of: &'s mut [u32], slots: &'s mut [SlotEntry], policy: R, hidden_max: u32) -> Self {
        assert!(!slots.is_empty(), "a cache without a slot");
        slot_of.fill(NONE);
        slots.fill(SlotEntry::EMPTY);
        Self {
            slot_of,
            slots,
            used: 0,
            residents: Residents::new(policy, hidden_max),
            prefetch: Prefetch::new(0),
        }
    }

    /// The same cache, which may bring up to so many pages along with one that is missed.
    #[must_use]
    pub fn with_neighbours(self, neighbours_max: u32) -> Self {
        Self { prefetch: Prefetch::new(neighbours_max), ..self }
    }

    /// A reader touches `page`.
    ///
    /// # Panics
    /// When there is no such page.
    pub fn touch(&mut self, page: PageId) -> Touch {
        match self.slot_of[page.index()] {
            NONE => {
                self.fetch(page);
                self.prefetch.fetched();
                Touch::Miss
            }
            slot if self.slots[slot as usize].evictable => Touch::Hit,
            slot => {
                self.judge(SlotId(slot), true);
                self.residents.handle_shown(self.slots, SlotId(slot));
                self.residents.handle_resident(self.slots, SlotId(slot));
                self.slots[slot as usize].evictable = true;
                self.hide();
                Touch::SoftFault
            }
        }
    }

    /// The cache is told that `page` was used. Without effect unless it is there and not hidden.
    pub fn hint(&mut self, page: PageId) {
        let slot = self.slot_of[page.index()];
        if slot != NONE && self.slots[slot as usize].evictable {
            self.residents.policy_mut().handle_reference(self.slots, SlotId(slot));
            self.judge(SlotId(slot), true);
        }
    }

    /// The cache is told at which tile `page` will be used next. Without effect unless it is there and not hidden.
    pub fn forecast(&mut self, page: PageId, next_use: u32) {
        let slot = self.slot_of[page.index()];
        if slot != NONE && self.slots[slot as usize].evictable {
            self.residents.policy_mut().handle_forecast(self.slots, SlotId(slot), next_use);
        }
    }

    /// Tile `now` is being drawn, and the next frame begins with tile `frame_end`.
    pub fn clock(&mut self, now: u32, frame_end: u32) {
        self.residents.policy_mut().handle_clock(now, frame_end);
    }

    /// Brings `page` before a tile that is foretold to touch it. Tells whether it was brought: not if it is there already,
    /// nor if all that is there is needed sooner, nor while too many pages were brought for nothing.
    pub fn prefetch(&mut self, page: PageId) -> bool {
        self.prefetch.allows_tiles() && self.bring(page, Foretold::ByTile)
    }

    /// Brings pages along with `page`, which was missed just now: those that follow it, as far as none of them is there,
    /// and as many as experience says are worth it. Calls `brought` with each.
    pub fn prefetch_neighbours(&mut self, page: PageId, mut brought: impl FnMut(PageId)) {
        let run = self.prefetch.run_after_miss().min(u32::try_from(self.slots.len() / 2).unwrap_or(u32::MAX));
        for next in (1..=run).map_while(|step| page.0.checked_add(step).map(PageId)) {
            if self.slot_of.get(next.index()) != Some(&NONE) || !self.bring(next, Foretold::ByNeighbour) {
                return;
            }
            brought(next);
        }
    }

    fn bring(&mut self, page: PageId, foretold: Foretold) -> bool {
        if self.slot_of[page.index()] != NONE {
            return false;
        }
        let is_full = self.used as usize == self.slots.len();
        let victim = is_full.then(|| self.residents.choose_victim_for_prefetch(self.slots));
        match victim {
            Some(None) => return false,
            Some(Some(victim)) => {
                let slot = self.vacate(victim);
                self.fill(page, slot);
            }
            None => self.fetch(page),
        }
        let slot = self.slot_of[page.index()];
        self.slots[slot as usize].prefetched = Some(foretold);
        self.prefetch.asked(foretold);
        true
    }

    fn fetch(&mut self, page: PageId) {
        let slot = self.free_slot();
        self.fill(page, slot);
    }

    fn fill(&mut self, page: PageId, slot: SlotId) {
        self.slot_of[page.index()] = slot.0;
        let entry = &mut self.slots[slot.index()];
        (entry.page, entry.evictable) = (page.0, true);
        self.residents.handle_resident(self.slots, slot);
        self.hide();
    }

    /// A slot that was never used, or that of a victim.
    fn free_slot(&mut self) -> SlotId {
        if (self.used as usize) < self.slots.len() {
            self.used += 1;
            return SlotId(self.used - 1);
        }
        let victim = self.residents.choose_victim(self.slots).unwrap_or(SlotId(0));
        self.vacate(victim)
    }

    fn vacate(&mut self, victim: SlotId) -> SlotId {
        let entry = &mut self.slots[victim.index()];
        self.slot_of[entry.page as usize] = NONE;
        entry.evictable = false;
        self.judge(victim, false);
        victim
    }

    /// It is known of the page in `slot` whether it was used. That matters the first time, if it was brought ahead.
    fn judge(&mut self, slot: SlotId, was_used: bool) {
        match self.slots[slot.index()].prefetched.take() {
            Some(foretold) if was_used => self.prefetch.used(foretold),
            Some(foretold) => self.prefetch.wasted(foretold),
            None => {}
        }
    }

    /// Hides pages once the cache is full.
    fn hide(&mut self) {
        if (self.used as usize) < self.slots.len() {
            return;
        }
        while let Some(slot) = self.residents.choose_to_hide(self.slots) {
            self.slots[slot.index()].evictable = false;
            self.residents.handle_hidden(self.slots, slot);
        }
    }
}

#[cfg(test)]
mod tests {
    extern crate std;

    use std::collections::BTreeSet;
    use std::vec::Vec;

    use proptest::prelude::*;

    use super::*;
    use crate::replacement::{Policy, PolicyKind};

    const PAGES: u32 = 24;

    #[derive(Clone, Copy, Debug)]
    enum Op {
        Touch(u32),
        Hint(u32),
        Forecast(u32, u32),
        Prefetch(u32),
        Neighbours(u32),
        Clock(u32),
    }

    fn op() -> impl Strategy<Value = Op> {
        let page = 0..PAGES;
        prop_oneof![
            6 => page.clone().prop_map(Op::Touch),
            1 => page.clone().prop_map(Op::Hint),
            1 => (page.clone(), any::<u32>()).prop_map(|(page, when)| Op::Forecast(page, when)),
            1 => page.clone().prop_map(Op::Prefetch),
            1 => page.prop_map(Op::Neighbours),
            1 => any::<u32>().prop_map(Op::Clock),
        ]
    }

    impl<R: Replacement> Replay<'_, R> {
        /// Every page knows its slot and every slot its page; as many are hidden as may be.
        fn check(&self) {
            let here = (0..).zip(self.slot_of.iter()).filter(|(_, slot)| **slot != NONE);
            for (page, slot) in here.clone() {
                assert_eq!(self.slots[*slot as usize].page, page, "SLOT_HOLDS_ONE_PAGE");
            }
            assert_eq!(here.count(), self.used as usize, "no slot is lost");
            let hidden = self.slots[..self.used as usize].iter().filter(|slot| !slot.evictable).count();
            assert_eq!(hidden, self.residents.hidden_count() as usize, "hidden pages are counted");
            assert!(hidden < self.slots.len(), "not all are hidden");
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(500))]

        #[test]
        fn no_order_of_events_breaks_a_policy(
            kind in prop::sample::select(&PolicyKind::ALL[..]),
            slots in 1_usize..10,
            hidden in 0_u32..9,
            ops in prop::collection::vec(op(), 0..300),
        ) {
            let mut slot_of = [0; PAGES as usize];
            let mut entries: Vec<SlotEntry> = (0..slots).map(|_| SlotEntry::EMPTY).collect();
            let hidden = hidden.min(u32::try_from(slots).unwrap() - 1);
            let mut cache = Replay::new(&mut slot_of, &mut entries, Policy::new(kind, 3), hidden).with_neighbours(4);
            for op in ops {
                match op {
                    Op::Touch(page) => {
                        let first = cache.touch(PageId(page));
                        prop_assert!(first == Touch::Hit || cache.slot_of[page as usize] != NONE);
                    }
                    Op::Hint(page) => cache.hint(PageId(page)),
                    Op::Forecast(page, when) => cache.forecast(PageId(page), when),
                    Op::Prefetch(page) => {
                        if cache.prefetch(PageId(page)) {
                            prop_assert_ne!(cache.slot_of[page as usize], NONE);
                        }
                    }
                    Op::Neighbours(page) => {
                        let _ = cache.touch(PageId(page));
                        cache.prefetch_neighbours(PageId(page), |next| assert!((1..5).contains(&(next.0 - page))));
                    }
                    Op::Clock(now) => cache.clock(now, now.wrapping_add(50)),
                }
                cache.check();
            }
        }

        #[test]
        fn with_a_slot_for_each_page_each_is_missed_once(
            kind in prop::sample::select(&PolicyKind::ALL[..]),
            pages in prop::collection::vec(0..PAGES, 0..200),
        ) {
            let (mut slot_of, mut entries) = ([0; PAGES as usize], [SlotEntry::EMPTY; PAGES as usize]);
            let mut cache = Replay::new(&mut slot_of, &mut entries, Policy::new(kind, 3), 0);
            let misses = pages.iter().filter(|page| cache.touch(PageId(**page)) == Touch::Miss).count();
            prop_assert_eq!(misses, pages.iter().collect::<BTreeSet<_>>().len());
        }
    }

    #[test]
    fn a_touch_brings_a_hidden_page_back_and_a_page_that_nobody_touches_leaves() {
        let (mut slot_of, mut entries) = ([0; 8], [SlotEntry::EMPTY; 4]);
        let mut cache = Replay::new(&mut slot_of, &mut entries, Policy::new(PolicyKind::Fifo, 0), 2);
        let touches = [0, 1, 2, 3, 0, 2, 4, 0, 1].map(|page| cache.touch(PageId(page)));
        use Touch::{Hit, Miss, SoftFault};
        // With four pages there, 0 and 1 are hidden; 0 comes back and 2 is hidden for it; 2 comes back and 3 is;
        // 4 takes the slot of 1, which was hidden first.
        assert_eq!(touches, [Miss, Miss, Miss, Miss, SoftFault, SoftFault, Miss, SoftFault, Miss]);
        assert_eq!(cache.touch(PageId(1)), Hit);
    }
}
