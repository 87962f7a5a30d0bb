//! The state machine of a node that reads pages.
//!
//! `Node` never waits. Facts go in with the time through `handle_*`, work comes out of [`Node::poll`], the driver
//! does it. One input, then poll until [`Output::Idle`]: this bounds the outbox, and is checked.

mod ahead;
mod answers;
mod asking;
mod config;
mod snapshot;

pub use answers::MessageError;
pub use config::{Config, ConfigError, EVICT_BATCH_MAX, NEIGHBOURS_MAX};
pub use snapshot::Snapshot;

use heapless::Deque;

use crate::failure::Failure;
use crate::id::{Incarnation, NodeId, PageId, PortId, SlotId};
use crate::membership::{Liveness, Membership};
use crate::mutants::{self, Mutant};
use crate::page_state::{Effect, PageEvent, PageState};
use crate::page_table::{PageTable, StorageError};
use crate::prefetch::Prefetch;
use crate::replacement::{Policy, Replacement, Residents};
use crate::request::Requests;
use crate::stats::NodeStats;
use crate::storage::{PeerEntry, Storage};
use crate::time::{Instant, SteadyClock};
use crate::wire::Message;

/// A node that reads pages of other nodes through a bounded cache.
///
/// # Invariants
/// - `ONE_REQUEST`: a page is in state `Requested` exactly when one request for it is under way.
/// - `NO_LOST_WAITER`: a page that somebody waits for is on its way in or out, so an event that wakes them is due;
///   every request ends by its deadline.
/// - `BOUNDED`: pages that hold a slot are never more than the slots lent.
/// - `OUTBOX_BOUNDED`: one input causes at most [`OUTBOX`] outputs.
/// - `PREFETCH_COUNTED`: every page asked for ahead is used, wasted, or in its slot and in doubt.
#[derive(Debug)]
pub struct Node<'s, R: Replacement = Policy> {
    config: Config,
    table: PageTable<'s>,
    requests: Requests<'s>,
    membership: Membership<'s>,
    residents: Residents<R>,
    clock: SteadyClock,
    outbox: Deque<Pending, OUTBOX>,
    /// A thread waits for a slot, any slot.
    slot_waited_for: bool,
    next_number: u32,
    prefetch: Prefetch,
    stats: NodeStats,
}

/// What a thread that faulted is to do, after it has carried out what [`Node::poll`] says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[must_use]
pub enum Fault {
    /// Go on: the page is here.
    Ready,
    /// Wait for the answer on your port; you fetch the page.
    Fetch,
    /// Wait until this page's waiters are woken, then call [`Node::handle_fault_again`].
    Wait,
    /// Every slot is on its way in or out. If the poll gave pages to unmap, do that; else wait until those who wait
    /// for slots are woken. Then call [`Node::handle_fault_again`].
    Full,
    /// The page was hidden, and you show it: do what the poll says, call [`Node::handle_filled`], and go on.
    Show,
    /// The page cannot be had.
    Failed(Failure),
}

/// Work for the driver.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[must_use]
pub enum Output {
    /// Send the first `len` bytes of the buffer to `to`, through this port.
    Transmit {
        /// The receiver.
        to: NodeId,
        /// The port of the thread that faulted.
        port: PortId,
        /// Bytes to send.
        len: usize,
    },
    /// The bytes that came with the message are a part of `page`: put them aside, where the parts of the page in `slot`
    /// are gathered. No reader sees them yet.
    Store {
        /// The page of which a part arrived.
        page: PageId,
        /// The slot kept for it.
        slot: SlotId,
        /// Where in the page the part starts.
        offset: u32,
        /// Its length.
        bytes: u32,
    },
    /// All bytes of `page` are here and belong into `slot`: fill it, make the whole page visible at once, then call
    /// [`Node::handle_filled`].
    Map {
        /// The page that arrived.
        page: PageId,
        /// The slot kept for it.
        slot: SlotId,
        /// Where the bytes are.
        bytes: PageBytes,
    },
    /// Take `page` away from its readers, then call [`Node::handle_unmapped`]. Until then nobody else gets `slot`.
    Unmap {
        /// The victim.
        page: PageId,
        /// The slot it lies in.
        slot: SlotId,
    },
    /// Take `page` from its readers' sight but keep its bytes in `slot`, then call [`Node::handle_covered`].
    Hide {
        /// The page that replacement wants to know more of.
        page: PageId,
        /// The slot it lies in, and stays in.
        slot: SlotId,
    },
    /// Wake every thread that waits for `page`.
    WakePage {
        /// The page whose state changed.
        page: PageId,
    },
    /// Wake every thread that waits for a slot.
    WakeSlots,
    /// Nothing to do before this moment, or before the next input when `None`.
    Idle(Option<Instant>),
}

/// Where the bytes of a page are that has arrived.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PageBytes {
    /// All of them came with the message.
    InMessage,
    /// They were gathered as [`Output::Store`] said, the last of them just now.
    Stored,
    /// They have been in the slot all the time: the page was hidden.
    Kept,
}

/// Outputs that one input can cause.
pub const OUTBOX: usize = (1 + HIDES_PER_VICTIM) * EVICT_BATCH_MAX as usize + 4;

/// Pages hidden for each that leaves, at most: so their number grows to what it may be.
const HIDES_PER_VICTIM: usize = 2;

/// Requests that one call of [`Node::handle_timeout`] looks after; each can cause two outputs. Those left over stay due.
const DUE_MAX: usize = OUTBOX / 2;

/// An output before it is polled.
#[derive(Clone, Copy, Debug)]
enum Pending {
    Send(PortId, Message),
    Done(Output),
}

impl<'s, R: Replacement> Node<'s, R> {
    /// A node with nothing resident but its home pages.
    ///
    /// # Errors
    /// The configuration contradicts itself or the storage.
    pub fn new(config: Config, storage: Storage<'s>, replacement: R) -> Result<Self, ConfigError> {
        config.check()?;
        let Storage { pages, slots, peers, requests } = storage;
        let (placement, me) = (&config.placement, config.me);
        let table = PageTable::new(pages, slots, placement, me).map_err(ConfigError::Storage)?;
        let needed = placement.owner_count();
        if peers.len() != usize::from(needed) {
            return Err(ConfigError::Storage(StorageError::Peers { needed, got: peers.len() }));
        }
        if requests.is_empty() && placement.held_pages(me) < placement.page_count() {
            return Err(ConfigError::Storage(StorageError::NoRequests));
        }
        peers.fill(PeerEntry::EMPTY);
        Ok(Self {
            table,
            requests: Requests::new(requests, 0),
            membership: Membership::new(peers, placement.first_owner(), config.patience(), config.limits()),
            residents: Residents::new(replacement, config.hidden_max),
            prefetch: Prefetch::new(config.neighbours_max),
            config,
            clock: SteadyClock::default(),
            outbox: Deque::new(),
            slot_waited_for: false,
            next_number: 0,
            stats: NodeStats::default(),
        })
    }

    /// Gives the lent storage back, for a node that takes this one's place.
    #[must_use]
    pub fn into_storage(self) -> Storage<'s> {
        let (pages, slots) = self.table.into_entries();
        Storage {
            pages,
            slots,
            peers: self.membership.into_entries(),
            requests: self.requests.into_entries(),
        }
    }

    /// A thread touched `page`, which was not mapped for it. It can be reached through `port`.
    pub fn handle_fault(&mut self, now: Instant, page: PageId, port: PortId) -> Fault {
        self.stats.faults += 1;
        let answer = self.answer_fault(now, page, port, now);
        match answer {
            Fault::Wait => self.stats.merged_faults += 1,
            Fault::Ready => self.stats.ready_faults += 1,
            Fault::Full => self.stats.full_faults += 1,
            Fault::Fetch | Fault::Show | Fault::Failed(_) => {}
        }
        answer
    }

    /// The thread that faulted `since` then was told to wait, did, and asks again.
    pub fn handle_fault_again(&mut self, now: Instant, page: PageId, port: PortId, since: Instant) -> Fault {
        self.answer_fault(now, page, port, since)
    }

    /// A message arrived. What follows its header is none of the node's business.
    ///
    /// # Errors
    /// The message is not believed; it is counted and changes nothing.
    pub fn handle_message(&mut self, now: Instant, bytes: &[u8]) -> Result<(), MessageError> {
        self.expect_drained();
        let now = self.clock.advance(now);
        match self.check(bytes).and_then(|message| self.accept(now, message)) {
            Err(error @ MessageError::Late(_)) => {
                self.stats.late_answers += 1;
                Err(error)
            }
            Err(error) => {
                self.stats.refused_messages += 1;
                Err(error)
            }
            Ok(()) => Ok(()),
        }
    }

    /// The driver has filled the slot of `page` and made the page visible.
    pub fn handle_filled(&mut self, now: Instant, page: PageId) {
        self.expect_drained();
        self.clock.advance(now);
        if let Effect::Wake = self.apply(page, PageEvent::Filled) {
            if let Some(slot) = self.table.slot(page) {
                self.residents.handle_resident(self.table.slots_mut(), slot);
            }
            self.wake(page);
        }
    }

    /// The driver has taken `page` from its readers' sight.
    pub fn handle_covered(&mut self, now: Instant, page: PageId) {
        self.expect_drained();
        self.clock.advance(now);
        if let Effect::Keep = self.apply(page, PageEvent::Covered) {
            if let Some(slot) = self.table.slot(page) {
                self.residents.handle_hidden(self.table.slots_mut(), slot);
            }
            self.wake(page);
        }
    }

    /// The driver has taken `page` away from its readers.
    pub fn handle_unmapped(&mut self, now: Instant, page: PageId) {
        self.expect_drained();
        self.clock.advance(now);
        if let Effect::Release = self.apply(page, PageEvent::Unmapped) {
            self.wake(page);
        }
    }

    /// The driver knows that `page` was used. Without effect unless it is resident.
    pub fn handle_reference(&mut self, page: PageId) {
        if self.table.state(page) == Some(PageState::Resident)
            && let Some(slot) = self.table.slot(page)
        {
            self.residents.policy_mut().handle_reference(self.table.slots_mut(), slot);
            self.judge(slot, true);
        }
    }

    /// The driver expects `page` to be used next at tile `next_use`. Without effect unless it is resident.
    pub fn handle_forecast(&mut self, page: PageId, next_use: u32) {
        if self.table.state(page) == Some(PageState::Resident)
            && let Some(slot) = self.table.slot(page)
        {
            self.residents.policy_mut().handle_forecast(self.table.slots_mut(), slot, next_use);
        }
    }

    /// Tile `now` is being drawn, and the next frame begins with tile `frame_end`, in the count of all tiles.
    pub fn handle_clock(&mut self, now: u32, frame_end: u32) {
        self.residents.policy_mut().handle_clock(now, frame_end);
    }

    /// Time has passed for the requests that left through `port`. Early or repeated calls do nothing.
    ///
    /// Requests whose peer has died are due at once.
    pub fn handle_timeout(&mut self, now: Instant, port: PortId) {
        self.expect_drained();
        let now = self.clock.advance(now);
        for _ in 0..DUE_MAX {
            let Some(index) = self.requests.next_due(now, port) else { break };
            self.look_after(now, index);
        }
    }

    /// The driver knows that `node` is dead: its connection broke, its process ended, the roster says so.
    ///
    /// What was asked of it is due at once, on its port: [`handle_timeout`](Self::handle_timeout) asks the next copy.
    pub fn handle_peer_down(&mut self, now: Instant, node: NodeId) {
        self.expect_drained();
        let now = self.clock.advance(now);
        if self.membership.bury(node) {
            self.stats.dead_peers += 1;
            self.make_due(now, node);
        }
    }

    /// The driver knows that `node` is alive in this incarnation, otherwise than by a message given to this node. If it is
    /// a later one than was known it is a new node, and what was asked of the old one is due at once. The dead stay dead.
    pub fn handle_peer_heard(&mut self, now: Instant, node: NodeId, incarnation: Incarnation) {
        self.expect_drained();
        let now = self.clock.advance(now);
        if self.membership.trusts(node, incarnation).is_ok() && self.membership.heard(node, incarnation) {
            self.make_due(now, node);
        }
    }

    /// Says how far away `node` is, in any unit. Of the live copies of a page the one that costs least is asked; of those
    /// that cost the same, the home, then the others in an order that differs from stripe to stripe. All cost 0 at first.
    pub fn set_cost(&mut self, node: NodeId, cost: u16) {
        self.membership.set_cost(node, cost);
    }

    /// The next piece of work. A message to send is written to the start of `buffer`.
    ///
    /// # Panics
    /// When `buffer` is shorter than [`HEADER_BYTES`](crate::wire::HEADER_BYTES).
    pub fn poll(&mut self, buffer: &mut [u8]) -> Output {
        match self.outbox.pop_front() {
            None => Output::Idle(self.requests.next_event(None).map(|moment| self.clock.outside(moment))),
            Some(Pending::Done(output)) => output,
            Some(Pending::Send(port, message)) => {
                Output::Transmit { to: message.to, port, len: message.emit(buffer) }
            }
        }
    }

    /// When [`handle_timeout`](Self::handle_timeout) will have something to do for `port`.
    #[must_use]
    pub fn next_timeout(&self, port: PortId) -> Option<Instant> {
        self.requests.next_event(Some(port)).map(|moment| self.clock.outside(moment))
    }

    /// What this node thinks of `node`; alive, when it owns nothing.
    #[must_use]
    pub fn liveness(&self, node: NodeId) -> Liveness {
        self.membership.liveness(node)
    }

    /// The last incarnation of `node` that this node has heard of.
    #[must_use]
    pub fn incarnation_of(&self, node: NodeId) -> Incarnation {
        self.membership.incarnation(node)
    }

    /// The smoothed round trip to `node` in microseconds, once it has been measured.
    #[must_use]
    pub fn round_trip_us(&self, node: NodeId) -> Option<u64> {
        self.membership.round_trip_us(node)
    }

    /// Requests under way.
    #[must_use]
    pub fn request_count(&self) -> usize {
        self.requests.len()
    }

    /// The configuration it was made with.
    #[must_use]
    pub const fn config(&self) -> &Config {
        &self.config
    }

    /// The state of every page and slot.
    #[must_use]
    pub const fn table(&self) -> &PageTable<'s> {
        &self.table
    }

    /// What has been counted so far.
    #[must_use]
    pub const fn stats(&self) -> NodeStats {
        self.stats
    }

    /// Checks every invariant named at the type. For tests: its cost grows with the number of pages.
    ///
    /// # Panics
    /// When one does not hold; the message names it.
    pub fn check_invariants(&self) {
        self.table.check_invariants();
        assert!(self.table.free_count() <= self.table.slot_count(), "BOUNDED");
        for page in (0..self.table.page_count()).map(PageId) {
            let under_way = self.requests.iter().filter(|request| request.page == page).count();
            let requested = self.table.state(page) == Some(PageState::Requested);
            assert_eq!(under_way, usize::from(requested), "ONE_REQUEST: {page}");
        }
        for request in self.requests.iter() {
            let asks_holder = self.config.placement.holds(request.holder, request.page);
            assert!(asks_holder, "ASKS_HOLDER: {} asked for {}", request.holder, request.page);
        }
        let (prefetch, in_doubt) = (self.stats.prefetch(), self.table.prefetched_count());
        assert_eq!(prefetch.asked, prefetch.used + prefetch.wasted + in_doubt, "PREFETCH_COUNTED");
        if self.slot_waited_for {
            let idle = self.table.free_count() + self.table.resident_count() + self.table.hidden_count();
            let busy = self.table.slot_count() - idle;
            assert!(busy > 0, "NO_LOST_WAITER: for a slot");
        }
    }

    fn answer_fault(&mut self, now: Instant, page: PageId, port: PortId, since: Instant) -> Fault {
        self.expect_drained();
        let elapsed_us = now.since(since);
        let now = self.clock.advance(now);
        let Some(state) = self.table.state(page) else { return Fault::Failed(Failure::NoSuchPage) };
        if state == PageState::Absent {
            // Who waited for a slot all this time begins no request that would have to be given up at once.
            if elapsed_us >= self.config.deadline_us {
                return Fault::Failed(Failure::NoSlot);
            }
            if self.table.free_count() == 0 || self.requests.is_full() {
                return self.answer_full();
            }
        }
        match self.apply(page, PageEvent::Fault) {
            Effect::SendRequest => {
                self.begin_request(now, page, port, elapsed_us);
                if self.table.free_count() + self.table.leaving_count() < self.config.evict_ahead {
                    self.evict();
                }
                Fault::Fetch
            }
            Effect::Wait => {
                self.wait_for(now, page, elapsed_us);
                Fault::Wait
            }
            Effect::Show => {
                self.show(page);
                Fault::Show
            }
            Effect::Refuse => Fault::Failed(self.table.failure(page)),
            _ => {
                self.handle_reference(page);
                Fault::Ready
            }
        }
    }

    /// No slot is free, or no request is: make a slot free, unless some are becoming free already.
    fn answer_full(&mut self) -> Fault {
        if self.table.free_count() == 0 && self.table.leaving_count() == 0 {
            self.evict();
        }
        self.slot_waited_for = true;
        Fault::Full
    }

    /// A hidden page was touched.
    fn show(&mut self, page: PageId) {
        self.stats.soft_faults += 1;
        if let Some(slot) = self.table.slot(page) {
            self.judge(slot, true);
            self.residents.handle_shown(self.table.slots_mut(), slot);
            self.push(Pending::Done(Output::Map { page, slot, bytes: PageBytes::Kept }));
        }
    }

    /// Has pages hidden, so that there are hidden ones to choose victims from.
    fn hide(&mut self) {
        for _ in 0..HIDES_PER_VICTIM * self.config.evict_batch as usize {
            let Some(slot) = self.residents.choose_to_hide(self.table.slots_mut()) else { break };
            let Some(page) = self.table.page_in(slot) else { continue };
            if let Effect::Hide = self.apply(page, PageEvent::Hide) {
                self.stats.hidden_pages += 1;
                self.push(Pending::Done(Output::Hide { page, slot }));
            }
        }
    }

    /// Chooses a batch of victims and has them taken away.
    fn evict(&mut self) {
        let mut victims = heapless::Vec::<SlotId, { EVICT_BATCH_MAX as usize }>::new();
        for _ in 0..self.config.evict_batch {
            let Some(slot) = self.residents.choose_victim(self.table.slots_mut()) else { break };
            self.table.slots_mut()[slot.index()].evictable = false; // or it might be chosen twice
            let pushed = victims.push(slot);
            debug_assert!(pushed.is_ok(), "a batch is bounded");
        }
        self.table.begin_reading(&victims);
        for slot in victims {
            self.evict_from(slot);
        }
        self.hide();
    }

    /// Has the page in `slot` taken away, which the policy has chosen.
    fn evict_from(&mut self, slot: SlotId) {
        let Some(page) = self.table.page_in(slot) else { return };
        if let Effect::Unmap = self.apply(page, PageEvent::Evict) {
            self.stats.evicted_pages += 1;
            self.judge(slot, false);
            self.push(Pending::Done(Output::Unmap { page, slot }));
            if mutants::is_on(Mutant::ReuseSlotEarly) {
                self.apply(page, PageEvent::Unmapped);
            }
        }
    }

    /// Gives `page` up. Its request has been taken out. Where nobody has waited for it yet, that is no failure.
    fn fail(&mut self, page: PageId, failure: Failure) {
        if self.is_in_doubt(page) && !mutants::is_on(Mutant::AheadFails) {
            return self.abandon(page);
        }
        if let Effect::Fail = self.apply(page, PageEvent::Expire) {
            self.table.set_failure(page, failure);
            self.stats.failed_pages += 1;
            self.wake(page);
        }
    }

    fn wake(&mut self, page: PageId) {
        if self.table.take_waited_for(page) && !mutants::is_on(Mutant::WakeNobody) {
            self.push(Pending::Done(Output::WakePage { page }));
        }
        self.wake_slots();
    }

    /// Wakes whoever waits for a slot, or for a request to ask for a page with.
    fn wake_slots(&mut self) {
        if core::mem::take(&mut self.slot_waited_for) && !mutants::is_on(Mutant::WakeNoSlotWaiter) {
            self.push(Pending::Done(Output::WakeSlots));
        }
    }

    fn apply(&mut self, page: PageId, event: PageEvent) -> Effect {
        match self.table.state(page) {
            Some(_) => self.table.apply(page, event),
            None => Effect::None,
        }
    }

    fn push(&mut self, pending: Pending) {
        let pushed = self.outbox.push_back(pending);
        debug_assert!(pushed.is_ok(), "OUTBOX_BOUNDED");
    }

    fn expect_drained(&self) {
        debug_assert!(self.outbox.is_empty(), "one input, then poll until Idle");
    }
}

#[cfg(test)]
mod tests;
