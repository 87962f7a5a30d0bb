//! A thread that reads a region: its own transport, its own stack for the handler, its own counters.

use core::cell::UnsafeCell;
use core::ffi::c_void;
use core::fmt;
use core::marker::PhantomData;
use core::mem::MaybeUninit;
use core::ops::Range;
use core::ptr;
use std::sync::Arc;

use dsm_core::id::{PageId, PortId};
use dsm_core::node::Fault as Answer;
use dsm_core::prefetch::Foretold;
use dsm_core::stats::Histogram;
use dsm_core::transport::Transport;

use crate::area::Area;
use crate::backend::{BackendKind, Record};
use crate::failure::{PageFailure, Reason};
use crate::paging::{Paging, Work};
use crate::region::Region;
use crate::signal::{self, Fault, Outcome, Server};
use crate::sys::{self, Errno};

/// A thread's right to read a region. Lives and dies on that thread.
///
/// While it lives, loads from [`bytes`](Self::bytes) may fault and are served over its transport.
#[derive(Debug)]
pub struct Attached<T: Transport> {
    region: Arc<Region>,
    /// Also reached by the signal handler on this thread, hence the cell.
    worker: Box<UnsafeCell<Worker<T>>>,
    before: Option<Server>,
    stack: Option<HandlerStack>,
    not_send: PhantomData<*mut ()>,
}

/// What a thread has counted.
#[derive(Clone, Debug, Default)]
pub struct ThreadStats {
    /// Times from the start of the handler to the page's presence, in nanoseconds, of faults that fetched or waited.
    pub miss_ns: Histogram,
}

/// Why a thread could not be attached.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum AttachError {
    /// The thread is attached to a region already; it can be attached to one at a time.
    Already,
    /// The thread blocks SIGBUS or SIGSEGV: the kernel would kill the process at its first fault.
    SignalsBlocked,
    /// 256 threads are attached; there is no number for another.
    TooMany,
    /// No stack for the signal handler.
    Stack(Errno),
}

/// What serves the faults of one thread.
#[derive(Debug)]
struct Worker<T> {
    region: Arc<Region>,
    fetcher: Fetcher<T>,
}

/// What one thread fetches pages with.
#[derive(Debug)]
struct Fetcher<T> {
    port: PortId,
    transport: T,
    stats: ThreadStats,
    /// Faults in a row on this page that found it there: a store on a processor that does not tell.
    ready_in_a_row: (PageId, u32),
}

/// More faults in a row than races can explain: the page is there, and the access is none that reading allows.
const READY_IN_A_ROW_MAX: u32 = 10_000;

/// Pages that one thread has asked for ahead and not yet received; what a ring of shared memory has room for.
const IN_FLIGHT_MAX: usize = 4;

/// Nobody sleeps longer than this without looking again.
const SLEEP_US: u64 = 50_000;

impl Region {
    /// Lets the calling thread read this region, with `transport` as its way to the other nodes.
    ///
    /// # Errors
    /// See [`AttachError`].
    pub fn attach<T: Transport>(self: &Arc<Self>, transport: T) -> Result<Attached<T>, AttachError> {
        if signal::blocks_faults() {
            return Err(AttachError::SignalsBlocked);
        }
        let port = self.take_port().ok_or(AttachError::TooMany)?;
        let ready_in_a_row = (PageId(0), 0);
        let fetcher = Fetcher { port, transport, stats: ThreadStats::default(), ready_in_a_row };
        let worker = Box::new(UnsafeCell::new(Worker { region: self.clone(), fetcher }));
        let server = Server { worker: worker.get().cast(), serve: serve::<T> };
        let before = signal::set_server(Some(server));
        if before.is_some() {
            signal::set_server(before);
            return Err(AttachError::Already);
        }
        let stack = HandlerStack::install().map_err(|error| {
            signal::set_server(before);
            AttachError::Stack(error)
        })?;
        Ok(Attached { region: self.clone(), worker, before, stack: Some(stack), not_send: PhantomData })
    }
}

impl<T: Transport> Attached<T> {
    /// Makes every page of `range` of the region's bytes present, so that it can be given to the kernel.
    ///
    /// A system call that meets an absent page does not fault, it returns `EFAULT`. A page may be evicted between
    /// this and the call, by this range itself when the cache is smaller than it: on `EFAULT`, touch and call again.
    ///
    /// # Errors
    /// A page cannot be had.
    ///
    /// # Panics
    /// When the range does not lie in the region.
    pub fn touch(&self, range: Range<usize>) -> Result<(), PageFailure> {
        let bytes = &self.bytes()[range];
        for piece in bytes.chunks(self.region.page_bytes()) {
            touch_byte(&piece[0]);
        }
        if let Some(last) = bytes.last() {
            touch_byte(last);
        }
        self.check()
    }

    /// This thread begins to draw a tile of the frame that [`Region::begin_frame`] has announced.
    ///
    /// Tiles are numbered as the caller likes, the same in each frame. What it says here and at the end of the tile tells the
    /// policy which pages are used, and what the last frame foretells of this one. It costs some ten nanoseconds a page of
    /// the tile, and may be left out. Where the region prefetches, the pages that the tile touched in the last frame and
    /// that are absent are fetched here, several at a time.
    pub fn begin_tile(&self, tile: u32) {
        let Some(paging) = self.region.paging() else { return };
        let (ahead, room) = paging.begin_tile(tile);
        if ahead.is_empty() {
            return;
        }
        // SAFETY: as in `record`: this is not the handler, and nothing called from here loads from the region.
        let worker = unsafe { &mut *self.worker.get() };
        // What goes wrong is kept, and `check` tells of it.
        let _ = worker.fetcher.bring(paging, None, &ahead, &room);
    }

    /// This thread has drawn a tile and used these pages, each given once.
    pub fn end_tile(&self, tile: u32, pages: &[PageId]) {
        if let Some(paging) = self.region.paging() {
            paging.end_tile(tile, pages);
        }
    }

    /// Tells whether every byte read so far was the scene's. A page that could not be had reads as zeros.
    ///
    /// Call it before anything made of what was read leaves the process. One failed page spoils the whole region.
    ///
    /// # Errors
    /// The first page that could not be had, and why.
    pub fn check(&self) -> Result<(), PageFailure> {
        self.region.check()
    }

    /// All bytes of the region, absent or not: whole pages, the last one padded.
    ///
    /// Other threads may be given the slice, but only threads that are attached survive reading it.
    ///
    /// # Panics
    /// With the `soft` backend, whose bytes are reached by [`record`](Self::record).
    #[must_use]
    pub fn bytes(&self) -> &[u8] {
        self.region.bytes()
    }

    /// The bytes `offset..offset + length`, held in place while the record lives; `None` when they lie outside the
    /// region, in more than one page, or in a page that cannot be had.
    ///
    /// For the `soft` backend; with the others it is a slice of [`bytes`](Self::bytes). Drop one record before asking
    /// for the next: a thread that holds the last slot and waits for another waits for itself, until that is noticed
    /// and the region fails.
    pub fn record(&self, offset: u64, length: usize) -> Option<Record<'_>> {
        loop {
            match self.region.record(offset, length) {
                Ok(found) => return found,
                Err(page) => {
                    let paging = self.region.paging()?;
                    // SAFETY: no other reference to the worker exists: its methods give none away, and the handler
                    // runs only while this thread loads from the region, which nothing called from here does.
                    let worker = unsafe { &mut *self.worker.get() };
                    let _ = worker.fetcher.resolve(paging, page).ok()?;
                }
            }
        }
    }

    /// What this thread has counted.
    #[must_use]
    pub fn stats(&self) -> ThreadStats {
        // SAFETY: as in `record`; the reference ends with this function.
        let worker = unsafe { &*self.worker.get() };
        worker.fetcher.stats.clone()
    }

    /// Faults of this thread so far that fetched a page or waited for one.
    #[must_use]
    pub fn misses(&self) -> u64 {
        // SAFETY: as in `record`; the reference ends with this function.
        let worker = unsafe { &*self.worker.get() };
        worker.fetcher.stats.miss_ns.count()
    }

    /// The region it reads.
    #[must_use]
    pub fn region(&self) -> &Arc<Region> {
        &self.region
    }
}

impl<T: Transport> Drop for Attached<T> {
    fn drop(&mut self) {
        // First nobody can call the worker any more, then it goes.
        signal::set_server(self.before);
        self.stack.take();
        // SAFETY: as in `record`; the reference ends with this function.
        let worker = unsafe { &*self.worker.get() };
        self.region.return_port(worker.fetcher.port);
    }
}

/// Serves a fault of the thread that `worker` belongs to.
///
/// # Safety
/// As `Server::serve` says: on that thread, and `worker` is a `Worker<T>` that nobody else uses.
unsafe fn serve<T: Transport>(worker: *mut c_void, fault: Fault) -> Outcome {
    // SAFETY: the caller vouches for both.
    let worker = unsafe { &mut *worker.cast::<Worker<T>>() };
    worker.serve(fault)
}

impl<T: Transport> Worker<T> {
    fn serve(&mut self, fault: Fault) -> Outcome {
        let Self { region, fetcher } = self;
        let Some(paging) = region.paging() else { return Outcome::NotOurs };
        let Some(page) = paging.area().page_at(fault.address) else { return Outcome::NotOurs };
        if region.is_copy_made_by_fork() {
            return Outcome::NotOurs;
        }
        if fault.is_write || !means_absent(paging, fault) {
            return Outcome::Write;
        }
        match fetcher.resolve(paging, page) {
            Ok(Answer::Ready) if fetcher.found_there_again(page) => return Outcome::Write,
            Ok(_) => {}
            // The load must end somehow: it reads zeros, and whoever uses them asks `check` first.
            Err(_) if paging.give_zeros(page).is_ok() => {}
            Err(_) => return Outcome::NotOurs,
        }
        Outcome::Served
    }
}

impl<T: Transport> Fetcher<T> {
    fn found_there_again(&mut self, page: PageId) -> bool {
        let (last, count) = self.ready_in_a_row;
        self.ready_in_a_row = (page, if last == page { count + 1 } else { 0 });
        self.ready_in_a_row.1 > READY_IN_A_ROW_MAX
    }

    /// Makes `page` present: fetches it, or waits for whoever does. Gives back what the first look found.
    fn resolve(&mut self, paging: &Paging, page: PageId) -> Result<Answer, PageFailure> {
        let start_ns = sys::now_ns();
        let since = sys::now();
        let (first, mut work) = paging.fault(page, self.port, None);
        let mut answer = first;
        loop {
            paging.check()?;
            if answer == Answer::Fetch {
                self.send(&work);
            }
            // In the shadow of the request, if there is one.
            let evicted = paging.evict(&work)?;
            paging.hide(&work)?;
            match answer {
                Answer::Ready => break,
                Answer::Fetch if self.receive_along(paging, page)? => break,
                Answer::Show => {
                    paging.show(page)?;
                    break;
                }
                Answer::Fetch => {}
                Answer::Failed(failure) => return Err(paging.fail(page, Reason::Cluster(failure))),
                Answer::Full if evicted => {}
                Answer::Wait | Answer::Full => work.wait(SLEEP_US),
            }
            (answer, work) = paging.fault(page, self.port, Some(since));
        }
        if first != Answer::Ready {
            self.ready_in_a_row = (page, 0);
            self.stats.miss_ns.record(sys::now_ns().saturating_sub(start_ns));
        }
        Ok(first)
    }

    /// Receives `page`, which has been asked for, and pages after it where those are worth bringing along. Tells whether
    /// `page` came.
    fn receive_along(&mut self, paging: &Paging, page: PageId) -> Result<bool, PageFailure> {
        let (neighbours, room) = paging.neighbours(page);
        if neighbours.is_empty() {
            self.receive(paging, page)
        } else {
            self.bring(paging, Some(page), &neighbours, &room)
        }
    }

    /// Brings pages that nobody waits for, several at a time, once `room` has been made for them: the neighbours of `asked`,
    /// which is under way, or else those of a tile. Tells whether `asked` came.
    fn bring(
        &mut self,
        paging: &Paging,
        asked: Option<PageId>,
        pages: &[PageId],
        room: &Work<'_>,
    ) -> Result<bool, PageFailure> {
        let foretold = if asked.is_some() { Foretold::ByNeighbour } else { Foretold::ByTile };
        let mut under_way = heapless::Deque::<PageId, IN_FLIGHT_MAX>::new();
        under_way.extend(asked);
        let mut came = false;
        paging.evict(room)?;
        for page in pages {
            if under_way.is_full()
                && let Some(first) = under_way.pop_front()
            {
                came |= self.receive(paging, first)? && Some(first) == asked;
            }
            if let Some(work) = paging.prefetch(*page, self.port, foretold) {
                self.send(&work);
                let pushed = under_way.push_back(*page);
                debug_assert!(pushed.is_ok(), "room was made above");
            }
        }
        while let Some(first) = under_way.pop_front() {
            came |= self.receive(paging, first)? && Some(first) == asked;
        }
        Ok(came)
    }

    /// Waits for the answer to the request that is under way and puts the page in place. Ends by the request's
    /// deadline; tells whether the page is there.
    fn receive(&mut self, paging: &Paging, page: PageId) -> Result<bool, PageFailure> {
        while let Some(deadline) = paging.next_timeout(page, self.port) {
            match self.transport.receive(deadline) {
                Some(received) => {
                    let work = paging.handle_message(&received.header);
                    if let Some((arrived, slot)) = work.to_fill {
                        paging.fill(arrived, slot, received.body)?;
                        if arrived == page {
                            return Ok(true);
                        }
                    }
                    // An owner refused: the next one is asked.
                    self.send(&work);
                }
                None => {
                    let work = paging.handle_timeout(self.port);
                    self.send(&work);
                }
            }
        }
        Ok(false)
    }

    fn send(&mut self, work: &Work<'_>) {
        for (to, message) in &work.requests {
            // A message that cannot be sent is a message lost: it is sent again when its time comes.
            let _ = self.transport.send(*to, message);
        }
    }
}

/// Whether this fault means that the page is absent. Else it is an access that reading does not allow.
fn means_absent(paging: &Paging, fault: Fault) -> bool {
    match paging.backend().kind() {
        BackendKind::Uffd => fault.signal == libc::SIGBUS,
        BackendKind::Segv => fault.signal == libc::SIGSEGV,
        BackendKind::Soft | BackendKind::Replicated => false,
    }
}

/// Loads one byte, whatever the optimiser thinks of it.
fn touch_byte(byte: &u8) {
    // SAFETY: a reference is readable.
    unsafe { ptr::read_volatile(byte) };
}

/// A stack for signal handlers, in place of the small one that Rust's library gives each thread.
///
/// The library's is 8 KB or little more, of which a processor with wide vectors takes 3.5 KB for its registers alone.
#[derive(Debug)]
struct HandlerStack {
    area: Area,
    before: libc::stack_t,
}

const STACK_BYTES: usize = 64 << 10;
const GUARD_BYTES: usize = 4096;

impl HandlerStack {
    fn install() -> Result<Self, Errno> {
        let area = Area::reserve(1, GUARD_BYTES + STACK_BYTES, libc::PROT_NONE)?;
        let bottom = area.start().wrapping_add(GUARD_BYTES);
        // SAFETY: the range lies in the area just made, which nobody knows yet. Below it stays the guard.
        unsafe { sys::map_nothing_over(bottom, STACK_BYTES, libc::PROT_READ | libc::PROT_WRITE) }?;
        let stack = libc::stack_t { ss_sp: bottom.cast(), ss_flags: 0, ss_size: STACK_BYTES };
        let mut before = MaybeUninit::uninit();
        // SAFETY: the stack stays mapped until `drop`, which puts back the one before.
        if unsafe { libc::sigaltstack(&raw const stack, before.as_mut_ptr()) } != 0 {
            return Err(Errno::last());
        }
        // SAFETY: the call has filled it.
        Ok(Self { area, before: unsafe { before.assume_init() } })
    }
}

impl Drop for HandlerStack {
    fn drop(&mut self) {
        debug_assert!(self.area.bytes() > GUARD_BYTES);
        // SAFETY: puts back what the thread had; whoever made that keeps it as long as the thread lives.
        unsafe { libc::sigaltstack(&raw const self.before, ptr::null_mut()) };
    }
}

impl fmt::Display for AttachError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Already => write!(f, "the thread is attached to a region already"),
            Self::SignalsBlocked => write!(f, "the thread blocks SIGBUS or SIGSEGV, and could not be served"),
            Self::TooMany => write!(f, "256 threads are attached to the region already"),
            Self::Stack(errno) => write!(f, "no stack for the signal handler: {errno}"),
        }
    }
}

impl core::error::Error for AttachError {}
