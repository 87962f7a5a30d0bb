//! Pages coming and going: the state machine, the backend, and what connects them.
//!
//! Every step of a fault is a function here. It locks the state machine for as long as that thinks, gathers what it
//! wants done, lets go of the lock and does it.

use core::sync::atomic::{AtomicU32, Ordering};

use dsm_core::id::{NodeId, PageId, PortId, SlotId};
use dsm_core::node::{Config, ConfigError, EVICT_BATCH_MAX, Fault, Node, OUTBOX, Output};
use dsm_core::page_state::PageState;
use dsm_core::placement::Stripes;
use dsm_core::prefetch::Foretold;
use dsm_core::replacement::{Policy, PolicyKind, ReferenceSource};
use dsm_core::stats::NodeStats;
use dsm_core::storage::{PageEntry, PeerEntry, RequestEntry, SlotEntry, Storage};
use dsm_core::time::Instant;
use dsm_core::transport::Body;
use dsm_core::wire::HEADER_BYTES;

use crate::area::Area;
use crate::backend::{Backend, Record};
use crate::failure::{PageFailure, Reason};
use crate::foresight::{Ahead, Foresight};
use crate::lent::{Lent, table};
use crate::lock::{Guard, Lock};
use crate::sys::{self, Errno};
use crate::words::{Ticket, Words};

/// The part of a region through which pages come and go.
#[derive(Debug)]
pub(crate) struct Paging {
    area: Area,
    backend: Backend,
    /// The home pages, for a backend that does not map them into the area.
    home: Option<Area>,
    config: Config,
    reference: ReferenceSource,
    /// For policies that are told by hints. Locked before the node.
    foresight: Option<Lock<Foresight>>,
    /// Pages are brought before a tile starts.
    prefetches: bool,
    /// Declared, and so dropped, before the storage it works in.
    node: Lock<Node<'static>>,
    _storage: LentStorage,
    words: Words,
    failure: FailureCell,
}

/// What the state machine wants done.
#[derive(Debug, Default)]
pub(crate) struct Work<'a> {
    /// Messages to send, and to whom.
    pub(crate) requests: heapless::Vec<(NodeId, [u8; HEADER_BYTES]), SENT_MAX>,
    /// A page that arrived, and its slot.
    pub(crate) to_fill: Option<(PageId, SlotId)>,
    victims: heapless::Vec<(PageId, SlotId), { EVICT_BATCH_MAX as usize }>,
    to_hide: heapless::Vec<(PageId, SlotId), OUTBOX>,
    woken_pages: heapless::Vec<PageId, WOKEN_MAX>,
    wakes_slots: bool,
    ticket: Option<Ticket<'a>>,
}

/// Messages that one thread sends at a time: a request, and perhaps another to see whether a silent owner is back.
const SENT_MAX: usize = 4;

/// Requests that can be under way at once: one for each thread that can be attached.
const REQUESTS: usize = 256;

/// Pages whose waiters are woken at a time: those of a batch of victims, or the one that a thread has asked for.
const WOKEN_MAX: usize = EVICT_BATCH_MAX as usize;

/// The first failure, kept where every thread sees it without a lock.
#[derive(Debug)]
struct FailureCell {
    is_set: AtomicU32,
    first: Lock<Option<PageFailure>>,
}

/// Storage lent to a node that lives beside it.
type LentStorage = (Lent<PageEntry>, Lent<SlotEntry>, Lent<PeerEntry>, Lent<RequestEntry>);

impl Paging {
    /// Connects a backend that works on `area` with a state machine that has `slot_count` slots.
    pub(crate) fn new(
        area: Area,
        backend: Backend,
        home: Option<Area>,
        config: Config,
        slot_count: u32,
        policy: (PolicyKind, u64),
        (reference, prefetches): (ReferenceSource, bool),
    ) -> Result<Self, ConfigError> {
        let config = with_watermarks(config, slot_count);
        // SAFETY: `node` is declared, and so dropped, before the storage.
        let (storage, lent) = unsafe { lend(&config.placement, slot_count) };
        let node = Node::new(config, storage, Policy::new(policy.0, policy.1))?;
        let is_told = reference == ReferenceSource::Hints && slot_count > 0;
        let foresight = is_told.then(|| Lock::new(Foresight::new(config.placement.page_count())));
        Ok(Self {
            area,
            backend,
            home,
            config,
            reference,
            foresight,
            prefetches,
            node: Lock::new(node),
            _storage: lent,
            words: Words::new(),
            failure: FailureCell { is_set: AtomicU32::new(0), first: Lock::new(None) },
        })
    }

    pub(crate) const fn area(&self) -> &Area {
        &self.area
    }

    pub(crate) const fn backend(&self) -> &Backend {
        &self.backend
    }

    pub(crate) fn stats(&self) -> NodeStats {
        self.node.lock().stats()
    }

    pub(crate) fn slot_count(&self) -> u32 {
        self.node.lock().table().slot_count()
    }

    pub(crate) const fn reference(&self) -> ReferenceSource {
        self.reference
    }

    /// A frame begins, and this node draws these tiles, in this order.
    pub(crate) fn begin_frame(&self, order: &[u32]) {
        if let Some(foresight) = &self.foresight {
            foresight.lock().begin_frame(order, &mut self.node.lock());
        }
    }

    /// A tile comes from another node, where it touched these pages in the last frame.
    pub(crate) fn adopt_tile(&self, tile: u32, pages: &[PageId]) {
        if let Some(foresight) = &self.foresight {
            foresight.lock().adopt_tile(tile, pages, &mut self.node.lock());
        }
    }

    /// The pages that a tile touched here in the last frame.
    pub(crate) fn pages_of(&self, tile: u32) -> Vec<PageId> {
        self.foresight.as_ref().map_or(Vec::new(), |foresight| foresight.lock().pages_of(tile).collect())
    }

    /// A thread begins to draw a tile. Gives the pages to bring before it does, and has slots made free for them.
    pub(crate) fn begin_tile(&self, tile: u32) -> (Ahead, Work<'_>) {
        let mut ahead = Ahead::new();
        let Some(foresight) = &self.foresight else { return (ahead, Work::default()) };
        let mut foresight = foresight.lock();
        let mut node = self.node.lock();
        foresight.begin_tile(tile, &mut node);
        if !self.prefetches {
            return (ahead, Work::default());
        }
        foresight.absent_pages_of(tile, &node, &mut ahead);
        drop(foresight);
        let count = u32::try_from(ahead.len()).unwrap_or(u32::MAX);
        let granted = node.handle_prefetch_wish(sys::now(), count);
        ahead.truncate(granted as usize);
        (ahead, self.finish(node))
    }

    /// `page` was missed and has been asked for. Gives pages to bring along with it, and has slots made free for them.
    pub(crate) fn neighbours(&self, page: PageId) -> (Ahead, Work<'_>) {
        if self.config.neighbours_max == 0 {
            return (Ahead::new(), Work::default());
        }
        let mut node = self.node.lock();
        let count = node.handle_neighbour_wish(sys::now(), page);
        let following = (1..=count).map_while(|step| page.0.checked_add(step).map(PageId));
        (following.take(EVICT_BATCH_MAX as usize).collect(), self.finish(node))
    }

    /// Asks for a page that nobody waits for, if there is room for it; the answer comes to `port`.
    pub(crate) fn prefetch(&self, page: PageId, port: PortId, foretold: Foretold) -> Option<Work<'_>> {
        let mut node = self.node.lock();
        let is_asked = node.handle_prefetch(sys::now(), page, port, foretold);
        let work = self.finish(node);
        is_asked.then_some(work)
    }

    /// A thread has drawn a tile and used these pages, each given once.
    pub(crate) fn end_tile(&self, tile: u32, pages: &[PageId]) {
        if let Some(foresight) = &self.foresight {
            let mut foresight = foresight.lock();
            let mut node = self.node.lock();
            pages.iter().for_each(|page| node.handle_reference(*page));
            foresight.end_tile(tile, pages, &mut node);
        }
    }

    /// When the request for `page`, which left through `port`, wants to be looked after; `None` when it is no more
    /// under way.
    pub(crate) fn next_timeout(&self, page: PageId, port: PortId) -> Option<Instant> {
        let node = self.node.lock();
        let under_way = node.table().state(page) == Some(PageState::Requested);
        under_way.then(|| node.next_timeout(port)).flatten()
    }

    /// Tells the state machine of a fault: for the first time, or again by a thread that faulted `since` then.
    pub(crate) fn fault(&self, page: PageId, port: PortId, since: Option<Instant>) -> (Fault, Work<'_>) {
        let mut node = self.node.lock();
        self.pass_on_touches(&mut node);
        let now = sys::now();
        let answer = match since {
            None => node.handle_fault(now, page, port),
            Some(since) => node.handle_fault_again(now, page, port, since),
        };
        // Under the lock, with the answer: what happens from now on changes the word.
        let ticket = match answer {
            Fault::Wait => Some(self.words.ticket_for_page(page)),
            Fault::Full => Some(self.words.ticket_for_slot()),
            Fault::Ready | Fault::Fetch | Fault::Show | Fault::Failed(_) => None,
        };
        (answer, Work { ticket, ..self.finish(node) })
    }

    /// Passes a message on. It is counted and has no effect when it is not believed.
    pub(crate) fn handle_message(&self, header: &[u8]) -> Work<'_> {
        let mut node = self.node.lock();
        let _ = node.handle_message(sys::now(), header);
        self.finish(node)
    }

    /// Lets the requests of `port` know what time it is.
    pub(crate) fn handle_timeout(&self, port: PortId) -> Work<'_> {
        let mut node = self.node.lock();
        node.handle_timeout(sys::now(), port);
        self.finish(node)
    }

    /// Lets the state machine know that a peer is dead. What was asked of it is asked of the next copy as soon as the
    /// thread that asked looks at its request again.
    pub(crate) fn handle_peer_down(&self, peer: NodeId) {
        let mut node = self.node.lock();
        node.handle_peer_down(sys::now(), peer);
        let work = self.finish(node);
        debug_assert!(work.requests.is_empty(), "a death alone sends nothing");
    }

    /// Puts a page in place and tells the state machine.
    pub(crate) fn fill(&self, page: PageId, slot: SlotId, body: Body<'_>) -> Result<(), PageFailure> {
        let filled = self.backend.fill(&self.area, page, slot, body);
        filled.map_err(|why| self.fail(page, Reason::System(why)))?;
        let mut node = self.node.lock();
        node.handle_filled(sys::now(), page);
        self.finish(node);
        Ok(())
    }

    /// Brings a hidden page back and tells the state machine.
    pub(crate) fn show(&self, page: PageId) -> Result<(), PageFailure> {
        let shown = self.backend.show(&self.area, page);
        shown.map_err(|why| self.fail(page, Reason::System(why)))?;
        let mut node = self.node.lock();
        node.handle_filled(sys::now(), page);
        self.finish(node);
        Ok(())
    }

    /// Hides what is to be hidden and tells the state machine.
    pub(crate) fn hide(&self, work: &Work<'_>) -> Result<(), PageFailure> {
        let Some((first, _)) = work.to_hide.first() else { return Ok(()) };
        let hidden = self.backend.hide(&self.area, &work.to_hide);
        hidden.map_err(|why| self.fail(*first, Reason::System(why)))?;
        for pages in work.to_hide.chunks(WOKEN_MAX) {
            let mut node = self.node.lock();
            let mut woken = Work::default();
            for (page, _) in pages {
                node.handle_covered(sys::now(), *page);
                woken.gather(&mut node);
            }
            drop(node);
            self.wake(&woken);
        }
        Ok(())
    }

    /// Takes the victims away, tells the state machine, and says whether there were any.
    pub(crate) fn evict(&self, work: &Work<'_>) -> Result<bool, PageFailure> {
        let Some((first, _)) = work.victims.first() else { return Ok(false) };
        let taken = self.backend.take_away(&self.area, &work.victims);
        taken.map_err(|why| self.fail(*first, Reason::System(why)))?;
        let mut node = self.node.lock();
        let mut woken = Work::default();
        for (page, _) in &work.victims {
            node.handle_unmapped(sys::now(), *page);
            woken.gather(&mut node);
        }
        drop(node);
        self.wake(&woken);
        Ok(true)
    }

    /// Makes a page that cannot be had readable as zeros, so that the load which waits for it can end.
    pub(crate) fn give_zeros(&self, page: PageId) -> Result<(), Errno> {
        self.backend.give_zeros(&self.area, page)
    }

    /// Remembers the first failure, lets every waiting thread find it, and gives it back.
    pub(crate) fn fail(&self, page: PageId, reason: Reason) -> PageFailure {
        let first = *self.failure.first.lock().get_or_insert(PageFailure { page, reason });
        // Release: pairs with the Acquire in `check`.
        self.failure.is_set.store(1, Ordering::Release);
        self.words.wake_all();
        first
    }

    /// The first failure, if there was one.
    pub(crate) fn check(&self) -> Result<(), PageFailure> {
        // Acquire: pairs with the Release in `fail`.
        if self.failure.is_set.load(Ordering::Acquire) == 0 {
            return Ok(());
        }
        self.failure.first.lock().map_or(Ok(()), Err)
    }

    /// With `soft`, the bytes `start..start + length` of `page`, or the page itself when it has to come first.
    pub(crate) fn record(&self, page: PageId, start: usize, length: usize) -> Result<Record<'_>, PageId> {
        let Backend::Soft(soft) = &self.backend else { return Err(page) };
        if let Some(record) = soft.pin(page, start, length) {
            return Ok(record);
        }
        match (&self.home, self.held_index(page)) {
            (Some(home), Some(index)) => {
                // SAFETY: inside a home page, by the caller's check. Home pages are mapped as long as `self` lives
                // and never change; see the crate's safety contract.
                let bytes =
                    unsafe { core::slice::from_raw_parts(home.address(index).wrapping_add(start), length) };
                Ok(Record::of_home(bytes))
            }
            _ => Err(page),
        }
    }

    /// The place of `page` among this node's own, as a page of the home's area.
    fn held_index(&self, page: PageId) -> Option<PageId> {
        self.config.placement.held_index(self.config.me, page).map(PageId)
    }

    /// A policy learns from `soft` which slots were used, when a victim is about to be chosen.
    fn pass_on_touches(&self, node: &mut Node<'static>) {
        let Backend::Soft(soft) = &self.backend else { return };
        if self.reference == ReferenceSource::SoftFaults && node.table().free_count() == 0 {
            for slot in soft.take_touched() {
                if let Some(page) = node.table().page_in(slot) {
                    node.handle_reference(page);
                }
            }
        }
    }

    /// Gathers what one input has caused, lets go of the lock, and wakes whoever is to be woken.
    fn finish(&self, mut node: Guard<'_, Node<'static>>) -> Work<'_> {
        let mut work = Work::default();
        work.gather(&mut node);
        drop(node);
        self.wake(&work);
        work
    }

    fn wake(&self, work: &Work<'_>) {
        work.woken_pages.iter().for_each(|page| self.words.wake_page(*page));
        if work.wakes_slots {
            self.words.wake_slots();
        }
    }
}

impl Work<'_> {
    /// Sleeps until what the thread was told to wait for has happened, or for `timeout_us`.
    pub(crate) fn wait(&self, timeout_us: u64) {
        if let Some(ticket) = self.ticket {
            ticket.wait(timeout_us);
        }
    }

    /// Adds what one input has caused.
    fn gather(&mut self, node: &mut Node<'static>) {
        let mut buffer = [0; HEADER_BYTES];
        loop {
            match node.poll(&mut buffer) {
                Output::Idle(_) => return,
                Output::Transmit { to, .. } => {
                    // One too many is a message lost: it is sent again when its time comes.
                    let _ = self.requests.push((to, buffer));
                }
                Output::Map { page, slot, .. } => self.to_fill = Some((page, slot)),
                // Grants of less than a page are refused: `Config::fragments` is not set.
                Output::Store { .. } => debug_assert!(false, "a fragment that was not asked for"),
                Output::Unmap { page, slot } => {
                    let pushed = self.victims.push((page, slot));
                    debug_assert!(pushed.is_ok(), "a batch is bounded");
                }
                Output::Hide { page, slot } => {
                    let pushed = self.to_hide.push((page, slot));
                    debug_assert!(pushed.is_ok(), "one input causes no more than fits the outbox");
                }
                Output::WakePage { page } => {
                    let pushed = self.woken_pages.push(page);
                    debug_assert!(pushed.is_ok(), "no more wait than leave at a time");
                }
                Output::WakeSlots => self.wakes_slots = true,
            }
        }
    }
}

/// Lends a node its storage.
///
/// # Safety
/// The node is dropped before the second of the pair.
unsafe fn lend(placement: &Stripes, slot_count: u32) -> (Storage<'static>, LentStorage) {
    let owners = usize::from(placement.owner_count());
    // SAFETY: this function's contract is that of `Lent::lend`.
    let (pages, lent_pages) = unsafe { Lent::lend(table(PageEntry::EMPTY, placement.page_count() as usize)) };
    // SAFETY: as above.
    let (slots, lent_slots) = unsafe { Lent::lend(table(SlotEntry::EMPTY, slot_count as usize)) };
    // SAFETY: as above.
    let (peers, lent_peers) = unsafe { Lent::lend(vec![PeerEntry::EMPTY; owners]) };
    // SAFETY: as above.
    let (requests, lent_requests) = unsafe { Lent::lend(vec![RequestEntry::EMPTY; REQUESTS]) };
    (Storage { pages, slots, peers, requests }, (lent_pages, lent_slots, lent_peers, lent_requests))
}

/// Sets how many victims leave at a time, and how early.
///
/// A batch costs one shoot-down of other cores' address caches however many pages are in it; taking 16 to 32 at a
/// time makes eviction several times cheaper with two threads. A small cache cannot spare the free slots.
const fn with_watermarks(config: Config, slot_count: u32) -> Config {
    const SLOTS_PER_VICTIM: u32 = 16;
    const SLOTS_WORTH_EVICTING_AHEAD: u32 = 64;
    let batch = slot_count / SLOTS_PER_VICTIM;
    let evict_batch = if batch == 0 {
        1
    } else if batch > EVICT_BATCH_MAX {
        EVICT_BATCH_MAX
    } else {
        batch
    };
    let evict_ahead = if slot_count < SLOTS_WORTH_EVICTING_AHEAD { 0 } else { evict_batch / 4 };
    Config { evict_batch, evict_ahead, ..config }
}
