//! The paper's way, rebuilt as the reference: its figure 2 on today's system.
//!
//! ```text
//! reading thread    fault -> SIGSEGV handler sends a request -> waits on a semaphore ............... -> goes on
//! owner (process)             blocks in recvfrom -> sends the page in pieces of one Ethernet frame
//! communication thread        blocks in recv -> evicts a random page -> maps -> receives into place -> posts
//! ```
//!
//! Kept as it was on purpose: a thread that has to be woken for every miss, blocking sockets, a page that appears
//! empty and is filled in place. With a second reading thread that would show half-filled pages, so there is one only.
//!
//! # Source
//! DeMarle, Gribble, Parker, "Memory-Savvy Distributed Interactive Ray Tracing", EGPGV 2004, figure 2 and section 3.

mod courier;
mod signal;

use core::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};
use core::time::Duration;
use std::net::UdpSocket;
use std::os::fd::AsRawFd;
use std::sync::Arc;
use std::thread::JoinHandle;

use anyhow::Result;

use crate::memory::Memory;
use crate::owner::datagram;
use crate::space::{PAGE_BYTES, Space};
use courier::Courier;
use signal::{Caught, Semaphore};

/// A reader of a shared space in the manner of 2004.
#[derive(Debug)]
pub(super) struct PaperLike {
    shared: Arc<Shared>,
    courier: Option<JoinHandle<()>>,
}

/// What the reading thread, its signal handler and the communication thread share.
#[derive(Debug)]
struct Shared {
    space: Space,
    /// The reserved address range.
    area: Memory,
    /// Speaks with the owner alone.
    socket: UdpSocket,
    /// The paper's `page_wait_sem`.
    arrived: Semaphore,
    /// The page that the reading thread waits for and its request's number, or [`NOTHING`].
    awaited: AtomicU64,
    requests: AtomicU32,
    faults: AtomicU64,
    stop: AtomicBool,
}

const NOTHING: u64 = u64::MAX;

/// Datagrams on loopback are hardly ever lost; a lost one is asked for again after this long.
const PATIENCE: Duration = Duration::from_millis(250);

impl PaperLike {
    /// Reserves the range and starts the communication thread, which keeps `slots` pages.
    pub(super) fn new(space: Space, slots: u32, socket: UdpSocket) -> Result<Self> {
        socket.set_read_timeout(Some(PATIENCE))?;
        let shared = Arc::new(Shared {
            space,
            area: Memory::reserve(space.bytes())?,
            socket,
            arrived: Semaphore::new()?,
            awaited: AtomicU64::new(NOTHING),
            requests: AtomicU32::new(0),
            faults: AtomicU64::new(0),
            stop: AtomicBool::new(false),
        });
        let courier = Courier::new(shared.clone(), slots);
        let bring = || {
            if let Err(error) = courier.run() {
                // The reading thread waits inside a load, where nobody can tell it.
                eprintln!("error: the communication thread of the reconstruction: {error}");
                std::process::exit(1);
            }
        };
        let courier = std::thread::Builder::new().name("communication".to_owned()).spawn(bring)?;
        Ok(Self { shared, courier: Some(courier) })
    }

    /// From now on, and until the answer is dropped, faults in the range are this reader's.
    pub(super) fn catch_faults(&mut self) -> Result<Caught<'_>> {
        Ok(Caught::new(&self.shared)?)
    }
}

impl Drop for PaperLike {
    fn drop(&mut self) {
        self.shared.stop.store(true, Ordering::Relaxed);
        if let Some(courier) = self.courier.take() {
            // It looks at `stop` whenever its patience ends.
            let _ = courier.join();
        }
    }
}

impl Shared {
    /// The page that `address` lies in, if it lies in the range.
    fn page_at(&self, address: usize) -> Option<u32> {
        let offset = address.checked_sub(self.area.start().addr())?;
        (offset < self.area.bytes()).then(|| u32::try_from(offset / PAGE_BYTES as usize).ok()).flatten()
    }

    fn address(&self, page: u32) -> *mut u8 {
        debug_assert!(page < self.space.pages);
        self.area.start().wrapping_add(page as usize * PAGE_BYTES as usize)
    }

    /// What is waited for, as the header of the piece that is to come.
    fn awaited(&self, index: u32) -> Option<datagram::Header> {
        let awaited = self.awaited.load(Ordering::Acquire);
        let [page, request] =
            [awaited, awaited >> 32].map(|word| (word & u64::from(u32::MAX)).try_into().ok());
        (awaited != NOTHING).then_some(datagram::Header { page: page?, request: request?, index })
    }

    /// Asks for `page` under a new number. Called by the handler, so it makes one system call and nothing else.
    fn ask_for(&self, page: u32) {
        let request = self.requests.fetch_add(1, Ordering::Relaxed);
        self.awaited.store(u64::from(request) << 32 | u64::from(page), Ordering::Release);
        self.ask(datagram::Header { page, request, index: 0 });
    }

    fn ask(&self, header: datagram::Header) {
        let message = header.emit();
        // SAFETY: the socket is open as long as `self` is, and the message is readable for its length. What cannot be
        // sent is asked for again by the communication thread.
        unsafe { libc::send(self.socket.as_raw_fd(), message.as_ptr().cast(), message.len(), 0) };
    }

    /// The page is in place: lets the reading thread go on.
    fn arrive(&self) {
        self.awaited.store(NOTHING, Ordering::Release);
        self.arrived.post();
    }
}
