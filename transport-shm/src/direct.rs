//! Reading an owner's pages straight out of its memory file.

use std::collections::VecDeque;
use std::fs::File;
use std::io;
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::os::unix::fs::FileExt;
use std::sync::Arc;

use dsm_core::home::{Answer, Home};
use dsm_core::id::NodeId;
use dsm_core::time::Instant;
use dsm_core::transport::{Body, Received, SendError, Transport};
use dsm_core::wire::{self, HEADER_BYTES, Message};
use rustix::fs::{MemfdFlags, SealFlags, fcntl_add_seals, ftruncate, memfd_create};
use rustix::thread::{ClockId, Timespec, clock_nanosleep_absolute};

use crate::mapping::Mapping;

/// The memory file that holds an owner's home pages, in the order of their held index.
///
/// Vanishes with the last process that holds it open. It cannot be cut short, so it may be mapped safely.
#[derive(Debug)]
pub struct PageFile {
    file: File,
}

/// One thread's way to the owners of this machine: it reads their memory files. No owner has to do anything.
///
/// It plays the part of each owner's [`Home`] itself, so requests are checked and counted as on any other transport.
/// The file is read, not mapped: the pages of others never show up in this process's resident memory.
#[derive(Debug)]
pub struct DirectPort {
    routes: Vec<Option<Route>>,
    /// What the last requests are to be answered with, the oldest first. Never grows: it is used in signal handlers.
    pending: VecDeque<Pending>,
    page: Vec<u8>,
}

/// Pages that are resident; see [`PageFile::hold`].
#[derive(Debug)]
pub struct HeldPages {
    _mapping: Option<Mapping>,
}

#[derive(Debug)]
struct Route {
    home: Home,
    pages: Arc<PageFile>,
}

#[derive(Debug)]
struct Pending {
    owner: usize,
    answer: Answer,
}

/// Requests that wait for their answer to be taken.
const PENDING_MAX: usize = 8;

impl PageFile {
    /// An empty file for `bytes` bytes of pages.
    ///
    /// # Errors
    /// The system gave no memory file of that length.
    pub fn create(bytes: u64) -> io::Result<Self> {
        let file = memfd_create("memsavvy-pages", MemfdFlags::CLOEXEC | MemfdFlags::ALLOW_SEALING)?;
        ftruncate(&file, bytes)?;
        fcntl_add_seals(&file, SealFlags::SHRINK | SealFlags::GROW)?;
        Ok(Self { file: File::from(file) })
    }

    /// Declares the pages final: from now on the kernel lets nobody write them, nor undo this.
    ///
    /// fcntl_addseals(2), EBUSY: "there exists a writable, shared mapping on the file". The kernel says so too while it holds
    /// a page itself, as it does for a moment when it moves pages about, so it is asked again.
    ///
    /// # Errors
    /// Somebody has the file mapped for writing.
    pub fn freeze(&self) -> io::Result<()> {
        const TRIES: u32 = 20;
        for _ in 1..TRIES {
            match fcntl_add_seals(&self.file, SealFlags::WRITE | SealFlags::SEAL) {
                Err(rustix::io::Errno::BUSY) => std::thread::yield_now(),
                result => return Ok(result?),
            }
        }
        Ok(fcntl_add_seals(&self.file, SealFlags::WRITE | SealFlags::SEAL)?)
    }

    /// Counts the pages as this process's resident memory for as long as the answer lives.
    ///
    /// For an owner that reads its pages through the file alone: what it holds shows in what the system counts.
    ///
    /// # Errors
    /// There is no address space for them.
    pub fn hold(&self) -> io::Result<HeldPages> {
        let length = usize::try_from(self.file.metadata()?.len()).map_err(|_| io::ErrorKind::OutOfMemory)?;
        let mapping = if length > 0 { Some(Mapping::holding(self.as_fd(), length)?) } else { None };
        Ok(HeldPages { _mapping: mapping })
    }

    /// The file, for filling it before anybody reads.
    #[must_use]
    pub const fn file(&self) -> &File {
        &self.file
    }
}

impl From<OwnedFd> for PageFile {
    fn from(file: OwnedFd) -> Self {
        Self { file: File::from(file) }
    }
}

impl From<PageFile> for OwnedFd {
    fn from(pages: PageFile) -> Self {
        pages.file.into()
    }
}

impl AsFd for PageFile {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.file.as_fd()
    }
}

impl DirectPort {
    /// A port without routes, for pages of `page_bytes`.
    #[must_use]
    pub fn new(page_bytes: u32) -> Self {
        Self {
            routes: Vec::new(),
            pending: VecDeque::with_capacity(PENDING_MAX),
            page: vec![0; page_bytes as usize],
        }
    }

    /// Opens the way to `owner`, whose pages lie in `pages` and for whom `home` answers.
    pub fn connect(&mut self, owner: NodeId, home: Home, pages: Arc<PageFile>) {
        if self.routes.len() <= owner.index() {
            self.routes.resize_with(owner.index() + 1, || None);
        }
        self.routes[owner.index()] = Some(Route { home, pages });
    }
}

impl Transport for DirectPort {
    fn send(&mut self, to: NodeId, message: &[u8]) -> Result<(), SendError> {
        let route = self.routes.get_mut(to.index()).and_then(Option::as_mut).ok_or(SendError::NoRoute(to))?;
        let answer = route.home.handle_message(message).ok();
        // Who asks so often without looking has given up the oldest.
        if self.pending.len() == PENDING_MAX {
            self.pending.pop_front();
        }
        self.pending.extend(answer.map(|answer| Pending { owner: to.index(), answer }));
        Ok(())
    }

    /// The answer is there at once or never.
    fn receive(&mut self, deadline: Instant) -> Option<Received<'_>> {
        let Some(Pending { owner, answer }) = self.pending.pop_front() else {
            sleep_until(deadline);
            return None;
        };
        let route = self.routes.get_mut(owner)?.as_mut()?;
        let message = match answer {
            Answer::Refuse { message } => message,
            Answer::Grant { message, held_index } => {
                let (start, length) = granted(&message);
                let offset = u64::from(held_index) * self.page.len() as u64 + start;
                let length = length.min(self.page.len());
                let page = &mut self.page[..length];
                match route.pages.file.read_exact_at(page, offset) {
                    Ok(()) => return Some(received(&message, Body::new(page))),
                    Err(_) => route.home.handle_unreadable(&message),
                }
            }
        };
        Some(received(&message, Body::EMPTY))
    }
}

/// Where in the page the bytes start that a message grants, and how many they are.
pub(crate) const fn granted(message: &Message) -> (u64, usize) {
    match message.body {
        wire::Body::Grant { offset, bytes } => (offset as u64, bytes as usize),
        wire::Body::Request { .. } | wire::Body::Refusal(_) => (0, 0),
    }
}

fn received<'a>(message: &Message, body: Body<'a>) -> Received<'a> {
    let mut header = [0; HEADER_BYTES];
    message.emit(&mut header);
    Received { header, body }
}

/// Sleeps until a moment of `CLOCK_MONOTONIC`. Async-signal-safe: one system call.
fn sleep_until(deadline: Instant) {
    let micros = deadline.as_micros();
    let tv_sec = i64::try_from(micros / 1_000_000).unwrap_or(i64::MAX);
    let tv_nsec = i64::try_from(micros % 1_000_000 * 1000).unwrap_or(0);
    // Interrupted is early, which the caller expects.
    let _ = clock_nanosleep_absolute(ClockId::Monotonic, &Timespec { tv_sec, tv_nsec });
}
