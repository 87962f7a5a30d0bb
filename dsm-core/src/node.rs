//! The state machine of a node that reads pages.
//!
//! `Node` never waits. Facts go in with the time through `handle_*`, work comes out of [`Node::poll`], the driver
//! does it. One input, then poll until [`Output::Idle`]: this bounds the outbox, and is checked.

mod config;

pub use config::{Config, ConfigError, EVICT_BATCH_MAX};

use core::fmt;

use heapless::Deque;

use crate::failure::Failure;
use crate::id::{ClusterId, Epoch, NodeId, PageId, PortId, SlotId};
use crate::page_state::{Effect, PageEvent, PageState};
use crate::page_table::PageTable;
use crate::replacement::{Policy, Replacement};
use crate::request::{Due, Request, Requests};
use crate::stats::NodeStats;
use crate::storage::Storage;
use crate::time::Instant;
use crate::wire::{Body, Message, ParseError};

/// A node that reads pages of other nodes through a bounded cache.
///
/// # Invariants
/// - `ONE_REQUEST`: a page is in state `Requested` exactly when one request for it is under way.
/// - `NO_LOST_WAITER`: a page that somebody waits for is on its way in or out, so an event that wakes them is due;
///   every request ends by its deadline.
/// - `BOUNDED`: pages that hold a slot are never more than the slots lent.
/// - `OUTBOX_BOUNDED`: one input causes at most [`OUTBOX`] outputs.
#[derive(Debug)]
pub struct Node<'s, R: Replacement = Policy> {
    config: Config,
    table: PageTable<'s>,
    requests: Requests,
    replacement: R,
    outbox: Deque<Pending, OUTBOX>,
    /// A thread waits for a slot, any slot.
    slot_waited_for: bool,
    next_number: u32,
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
    /// The bytes of `page` that came with the message belong into `slot`: fill it, make the whole page visible at
    /// once, then call [`Node::handle_filled`].
    Map {
        /// The page that arrived.
        page: PageId,
        /// The slot kept for it.
        slot: SlotId,
    },
    /// Take `page` away from its readers, then call [`Node::handle_unmapped`]. Until then nobody else gets `slot`.
    Unmap {
        /// The victim.
        page: PageId,
        /// The slot it lies in.
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

/// Why the bytes of a message were refused. The node's state has not changed, but for a counter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum MessageError {
    /// The bytes are no message.
    Parse(ParseError),
    /// It belongs to another run.
    Cluster(ClusterId),
    /// It was sent in another epoch.
    Epoch(Epoch),
    /// It is for another node.
    To(NodeId),
    /// The address space has no such page.
    NoSuchPage(PageId),
    /// `from` is not the home of the page it sent.
    NotOwner {
        /// The page.
        page: PageId,
        /// The sender.
        from: NodeId,
    },
    /// A page of another length than this cluster's.
    PageBytes {
        /// The length it gives.
        got: u32,
    },
    /// A request; those go to [`Home`](crate::home::Home).
    Request,
    /// An answer to no request that is under way: it came late, or twice.
    Late(PageId),
}

/// Outputs that one input can cause.
pub const OUTBOX: usize = EVICT_BATCH_MAX as usize + 4;

/// Requests that one call of [`Node::handle_timeout`] looks after; each can cause two outputs.
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
        Ok(Self {
            table: PageTable::new(storage, &config.placement, config.me).map_err(ConfigError::Storage)?,
            config,
            requests: Requests::default(),
            replacement,
            outbox: Deque::new(),
            slot_waited_for: false,
            next_number: 0,
            stats: NodeStats::default(),
        })
    }

    /// Gives the lent storage back, for a node that takes this one's place.
    #[must_use]
    pub fn into_storage(self) -> Storage<'s> {
        self.table.into_storage()
    }

    /// A thread touched `page`, which was not mapped for it. It can be reached through `port`.
    pub fn handle_fault(&mut self, now: Instant, page: PageId, port: PortId) -> Fault {
        self.stats.faults += 1;
        let answer = self.answer_fault(now, page, port, now);
        match answer {
            Fault::Wait => self.stats.merged_faults += 1,
            Fault::Ready => self.stats.ready_faults += 1,
            Fault::Full => self.stats.full_faults += 1,
            Fault::Fetch | Fault::Failed(_) => {}
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
    pub fn handle_filled(&mut self, _now: Instant, page: PageId) {
        self.expect_drained();
        if let Effect::Wake = self.apply(page, PageEvent::Filled) {
            if let Some(slot) = self.table.slot(page) {
                self.replacement.handle_resident(self.table.slots_mut(), slot);
            }
            self.wake(page);
        }
    }

    /// The driver has taken `page` away from its readers.
    pub fn handle_unmapped(&mut self, _now: Instant, page: PageId) {
        self.expect_drained();
        if let Effect::Release = self.apply(page, PageEvent::Unmapped) {
            self.wake(page);
        }
    }

    /// The driver knows that `page` was used. Without effect unless it is resident.
    pub fn handle_reference(&mut self, page: PageId) {
        if self.table.state(page) == Some(PageState::Resident)
            && let Some(slot) = self.table.slot(page)
        {
            self.replacement.handle_reference(self.table.slots_mut(), slot);
        }
    }

    /// Time has passed for the requests that left through `port`. Early or repeated calls do nothing.
    pub fn handle_timeout(&mut self, now: Instant, port: PortId) {
        self.expect_drained();
        for _ in 0..DUE_MAX {
            match self.requests.next_due(now, port) {
                None => break,
                Some(Due::Resend(request)) => {
                    self.stats.resends += 1;
                    self.send(request);
                }
                Some(Due::Expired(request)) => {
                    self.fail(request.page, Failure::NoAnswer { from: request.home })
                }
            }
        }
    }

    /// The next piece of work. A message to send is written to the start of `buffer`.
    ///
    /// # Panics
    /// When `buffer` is shorter than [`HEADER_BYTES`](crate::wire::HEADER_BYTES).
    pub fn poll(&mut self, buffer: &mut [u8]) -> Output {
        match self.outbox.pop_front() {
            None => Output::Idle(self.requests.next_event(None)),
            Some(Pending::Done(output)) => output,
            Some(Pending::Send(port, message)) => {
                Output::Transmit { to: message.to, port, len: message.emit(buffer) }
            }
        }
    }

    /// When [`handle_timeout`](Self::handle_timeout) will have something to do for `port`.
    #[must_use]
    pub fn next_timeout(&self, port: PortId) -> Option<Instant> {
        self.requests.next_event(Some(port))
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
        if self.slot_waited_for {
            let busy = self.table.slot_count() - self.table.free_count() - self.table.resident_count();
            assert!(busy > 0, "NO_LOST_WAITER: for a slot");
        }
    }

    fn answer_fault(&mut self, now: Instant, page: PageId, port: PortId, since: Instant) -> Fault {
        self.expect_drained();
        let Some(state) = self.table.state(page) else { return Fault::Failed(Failure::NoSuchPage) };
        if state == PageState::Absent && (self.table.free_count() == 0 || self.requests.is_full()) {
            return self.answer_full(now, since);
        }
        match self.apply(page, PageEvent::Fault) {
            Effect::SendRequest => {
                self.begin_request(now, page, port, since);
                Fault::Fetch
            }
            Effect::Wait => Fault::Wait,
            Effect::Refuse => Fault::Failed(self.table.failure(page)),
            _ => {
                self.handle_reference(page);
                Fault::Ready
            }
        }
    }

    /// No slot is free, or no request is: make a slot free, unless some are becoming free already.
    fn answer_full(&mut self, now: Instant, since: Instant) -> Fault {
        if now.since(since) >= self.config.deadline_us {
            return Fault::Failed(Failure::NoSlot);
        }
        if self.table.free_count() == 0 && self.table.leaving_count() == 0 {
            self.evict();
        }
        self.slot_waited_for = true;
        Fault::Full
    }

    fn begin_request(&mut self, now: Instant, page: PageId, port: PortId, since: Instant) {
        let Some(home) = self.config.placement.home(page) else { return };
        let request = Request {
            page,
            home,
            port,
            number: self.next_number,
            resend_at: now.after(self.config.resend_us),
            interval_us: self.config.resend_us,
            deadline: since.after(self.config.deadline_us),
        };
        self.next_number = self.next_number.wrapping_add(1);
        self.stats.requests += 1;
        self.requests.push(request);
        self.send(request);
        if self.table.free_count() + self.table.leaving_count() < self.config.evict_ahead {
            self.evict();
        }
    }

    /// Chooses a batch of victims and has them taken away.
    fn evict(&mut self) {
        for _ in 0..self.config.evict_batch {
            let Some(slot) = self.replacement.choose_victim(self.table.slots_mut()) else { break };
            let Some(page) = self.table.page_in(slot) else { continue };
            if let Effect::Unmap = self.apply(page, PageEvent::Evict) {
                self.stats.evicted_pages += 1;
                self.push(Pending::Done(Output::Unmap { page, slot }));
            }
        }
    }

    /// Believes a message or says why not, without looking at what was asked for.
    fn check(&self, bytes: &[u8]) -> Result<Message, MessageError> {
        let message = Message::parse(bytes).map_err(MessageError::Parse)?;
        let Message { cluster, epoch, from, to, page, body, .. } = message;
        if cluster != self.config.cluster {
            return Err(MessageError::Cluster(cluster));
        }
        if epoch != self.config.epoch {
            return Err(MessageError::Epoch(epoch));
        }
        if to != self.config.me {
            return Err(MessageError::To(to));
        }
        match (self.config.placement.home(page), body) {
            (None, _) => Err(MessageError::NoSuchPage(page)),
            (_, Body::Request) => Err(MessageError::Request),
            (Some(home), _) if home != from => Err(MessageError::NotOwner { page, from }),
            (_, Body::Grant { page_bytes }) if page_bytes != self.config.page_bytes => {
                Err(MessageError::PageBytes { got: page_bytes })
            }
            _ => Ok(message),
        }
    }

    /// Acts on a message that is believed.
    fn accept(&mut self, _now: Instant, message: Message) -> Result<(), MessageError> {
        let Message { page, from, body, request, .. } = message;
        self.requests.take(page, request).ok_or(MessageError::Late(page))?;
        match body {
            Body::Grant { page_bytes } => {
                if let (Effect::Map, Some(slot)) = (self.apply(page, PageEvent::Grant), self.table.slot(page))
                {
                    self.stats.fetched_pages += 1;
                    self.stats.received_bytes += u64::from(page_bytes);
                    self.push(Pending::Done(Output::Map { page, slot }));
                }
            }
            Body::Refusal(why) => self.fail(page, Failure::Refused { by: from, why }),
            Body::Request => {}
        }
        Ok(())
    }

    /// Gives `page` up. Its request has been taken out.
    fn fail(&mut self, page: PageId, failure: Failure) {
        if let Effect::Fail = self.apply(page, PageEvent::Expire) {
            self.table.set_failure(page, failure);
            self.stats.failed_pages += 1;
            self.wake(page);
        }
    }

    fn wake(&mut self, page: PageId) {
        if self.table.take_waited_for(page) {
            self.push(Pending::Done(Output::WakePage { page }));
        }
        if core::mem::take(&mut self.slot_waited_for) {
            self.push(Pending::Done(Output::WakeSlots));
        }
    }

    fn send(&mut self, request: Request) {
        let message = Message {
            cluster: self.config.cluster,
            epoch: self.config.epoch,
            from: self.config.me,
            to: request.home,
            page: request.page,
            request: request.number,
            body: Body::Request,
        };
        self.push(Pending::Send(request.port, message));
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

impl fmt::Display for MessageError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Parse(error) => write!(f, "{error}"),
            Self::Cluster(cluster) => write!(f, "message of another cluster, {:#x}", cluster.0),
            Self::Epoch(epoch) => write!(f, "message of epoch {}", epoch.0),
            Self::To(to) => write!(f, "message for {to}"),
            Self::NoSuchPage(page) => write!(f, "message about {page}, which does not exist"),
            Self::NotOwner { page, from } => write!(f, "{from} sent {page} and is not its home"),
            Self::PageBytes { got } => write!(f, "a page of {got} bytes"),
            Self::Request => write!(f, "a request, and this is no home"),
            Self::Late(page) => write!(f, "an answer about {page} that nobody waits for"),
        }
    }
}

impl core::error::Error for MessageError {}

#[cfg(test)]
mod tests;
