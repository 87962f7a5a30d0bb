//! Pages that are asked for before anybody touches them.

use super::{EVICT_BATCH_MAX, Node};
use crate::id::{PageId, PortId, SlotId};
use crate::mutants::{self, Mutant};
use crate::page_state::{Effect, PageEvent, PageState};
use crate::prefetch::Foretold;
use crate::replacement::Replacement;
use crate::time::Instant;

impl<R: Replacement> Node<'_, R> {
    /// A tile is about to be drawn that is expected to touch so many absent pages: makes slots free for them, if they can be
    /// had for pages that are needed later.
    ///
    /// Gives the number that can be asked for, after what [`poll`](Self::poll) says has been carried out. 0 where it
    /// has shown that it does not pay.
    pub fn handle_prefetch_wish(&mut self, now: Instant, count: u32) -> u32 {
        self.expect_drained();
        self.clock.advance(now);
        if self.prefetch.allows_tiles() { self.make_room(count) } else { 0 }
    }

    /// `page` was missed and has been asked for: makes slots free for pages that follow it, as many as experience says are
    /// worth it.
    ///
    /// Gives the number that can be asked for, from the page after it on, after what [`poll`](Self::poll) says has been
    /// carried out.
    pub fn handle_neighbour_wish(&mut self, now: Instant, page: PageId) -> u32 {
        self.expect_drained();
        self.clock.advance(now);
        let run = self.prefetch.run_after_miss().min(self.table.slot_count() / 2);
        let following = (1..=run).map_while(|step| page.0.checked_add(step).map(PageId));
        let absent = following.take_while(|page| self.table.state(*page) == Some(PageState::Absent));
        let count = u32::try_from(absent.count()).unwrap_or(0);
        self.make_room(count)
    }

    /// Asks for a page that nobody has touched, if it is absent and a slot is free and half of the requests are. Tells
    /// whether it did; the answer comes to `port`.
    pub fn handle_prefetch(&mut self, now: Instant, page: PageId, port: PortId, foretold: Foretold) -> bool {
        self.expect_drained();
        let now = self.clock.advance(now);
        let has_room = self.table.free_count() > 0 && 2 * self.requests.len() < self.requests.capacity();
        if !has_room || self.table.state(page) != Some(PageState::Absent) {
            return false;
        }
        if let Effect::SendRequest = self.apply(page, PageEvent::Fault) {
            self.stats.prefetch_mut(foretold).asked += 1;
            self.prefetch.asked(foretold);
            if let Some(slot) = self.table.slot(page) {
                self.table.slots_mut()[slot.index()].prefetched = Some(foretold);
            }
            // Given up in half the time, it leaves who waits for its slot or its request the other half.
            let elapsed_us =
                if mutants::is_on(Mutant::AheadTakesAllTime) { 0 } else { self.config.deadline_us / 2 };
            self.begin_request(now, page, port, elapsed_us);
        }
        true
    }

    /// Makes slots free for up to `count` pages, of such as are needed later, and gives the number there will be.
    fn make_room(&mut self, count: u32) -> u32 {
        let count = count.min(EVICT_BATCH_MAX);
        while self.table.free_count() + self.table.leaving_count() < count {
            let Some(slot) = self.residents.choose_victim_for_prefetch(self.table.slots_mut()) else { break };
            self.evict_from(slot);
        }
        count.min(self.table.free_count() + self.table.leaving_count())
    }

    /// It is known of the page in `slot` whether it was used. That matters the first time, if it was asked for ahead.
    pub(super) fn judge(&mut self, slot: SlotId, was_used: bool) {
        let Some(foretold) = self.table.slots_mut()[slot.index()].prefetched.take() else { return };
        let stats = self.stats.prefetch_mut(foretold);
        if was_used {
            stats.used += 1;
            self.prefetch.used(foretold);
        } else {
            stats.wasted += 1;
            self.prefetch.wasted(foretold);
        }
    }

    /// Whether `page` was asked for ahead, and nobody is known to have touched it.
    pub(super) fn is_in_doubt(&mut self, page: PageId) -> bool {
        let slot = self.table.slot(page);
        slot.is_some_and(|slot| self.table.slots_mut()[slot.index()].prefetched.is_some())
    }

    /// A thread waits for a page that is on its way, by a fault that is `elapsed_us` old. If it was asked for ahead, its
    /// deadline counts from that fault, and so do the sendings that must fit in before.
    pub(super) fn wait_for(&mut self, now: Instant, page: PageId, elapsed_us: u64) {
        if !self.is_in_doubt(page) {
            return;
        }
        self.table.slot(page).into_iter().for_each(|slot| self.judge(slot, true));
        let left_us = self.config.deadline_us.saturating_sub(elapsed_us);
        let share_us = left_us / (self.config.round() + 1);
        let holders = self.config.placement.holders(page);
        if let Some(request) = self.requests.iter_mut().find(|request| request.page == page) {
            self.stats.adopted_requests += 1;
            if mutants::is_on(Mutant::AdoptChangesNothing) {
                return;
            }
            request.deadline = now.after(left_us);
            request.resend_at = request.resend_at.min(now.after(share_us));
            request.sendings = 0;
            // Who was asked earlier may be back; the one that is being asked has its turn.
            let place = holders.as_slice().iter().position(|holder| *holder == request.holder);
            request.asked = place.map_or(0, |place| 1 << place);
        }
    }

    /// A page that was asked for ahead does not come, and nobody has missed it.
    pub(super) fn abandon(&mut self, page: PageId) {
        self.table.slot(page).into_iter().for_each(|slot| self.judge(slot, false));
        if let Effect::Forget = self.apply(page, PageEvent::Abandon) {
            self.stats.abandoned_requests += 1;
            self.wake(page);
        }
    }
}
