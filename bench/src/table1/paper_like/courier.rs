//! The communication thread: the paper's `handlemessage`, for the answers.

use core::sync::atomic::Ordering;
use std::io::{self, ErrorKind};
use std::os::fd::AsRawFd;
use std::sync::Arc;

use super::Shared;
use crate::owner::datagram::{HEADER_BYTES, Header, PIECE_BYTES, PIECES};
use crate::space::{Numbers, PAGE_BYTES};

/// The communication thread's own part.
#[derive(Debug)]
pub(super) struct Courier {
    shared: Arc<Shared>,
    /// The pages that are mapped, at most `slots`.
    loaded: Vec<u32>,
    slots: usize,
    numbers: Numbers,
}

impl Courier {
    pub(super) fn new(shared: Arc<Shared>, slots: u32) -> Self {
        let slots = slots as usize;
        Self { shared, loaded: Vec::with_capacity(slots), slots, numbers: Numbers::new(2004) }
    }

    /// Brings page after page until the reader is gone.
    pub(super) fn run(mut self) -> io::Result<()> {
        while let Some(page) = self.next_answer()? {
            self.make_room(page)?;
            self.map(page, libc::PROT_READ | libc::PROT_WRITE)?;
            while !self.receive_into(page)? {
                // A piece was lost. Begin again under a new number, so that late ones are known.
                self.shared.ask_for(page);
            }
            self.shared.arrive();
        }
        Ok(())
    }

    /// Waits for the first piece of the answer and leaves it where it is; `None` when the reader is gone.
    fn next_answer(&self) -> io::Result<Option<u32>> {
        let Shared { socket, stop, .. } = &*self.shared;
        let mut header = [0; HEADER_BYTES];
        while !stop.load(Ordering::Relaxed) {
            match socket.peek(&mut header) {
                Ok(_) => match Header::parse(&header) {
                    Some(header) if self.shared.awaited(0) == Some(header) => return Ok(Some(header.page)),
                    _ => drop(socket.recv(&mut header)?),
                },
                Err(error) if is_impatient(&error) => {
                    if let Some(lost) = self.shared.awaited(0) {
                        self.shared.ask(lost);
                    }
                }
                Err(error) => return Err(error),
            }
        }
        Ok(None)
    }

    /// Evicts a random page if all slots are taken, and gives `page` a slot.
    fn make_room(&mut self, page: u32) -> io::Result<()> {
        if self.loaded.len() < self.slots {
            self.loaded.push(page);
            return Ok(());
        }
        let slot = self.numbers.below(self.slots);
        let victim = core::mem::replace(&mut self.loaded[slot], page);
        // Not a hole, which the paper leaves: the next mapping of anybody could land in it.
        self.map(victim, libc::PROT_NONE)
    }

    /// Puts an empty page in place of whatever is there.
    fn map(&self, page: u32, protection: i32) -> io::Result<()> {
        let flags = libc::MAP_PRIVATE | libc::MAP_ANONYMOUS | libc::MAP_NORESERVE | libc::MAP_FIXED;
        let (start, bytes) = (self.shared.address(page).cast(), PAGE_BYTES as usize);
        // SAFETY: the page lies in the reserved range. The reader waits for this thread, so nobody looks.
        let mapped = unsafe { libc::mmap(start, bytes, protection, flags, -1, 0) };
        if mapped == libc::MAP_FAILED { Err(io::Error::last_os_error()) } else { Ok(()) }
    }

    /// Receives the pieces of `page` straight into place; `false` when one of them did not come.
    fn receive_into(&self, page: u32) -> io::Result<bool> {
        let mut index = 0;
        while index < PIECES {
            let mut header = [0; HEADER_BYTES];
            let start = index * PIECE_BYTES;
            let piece = self.shared.address(page).wrapping_add(start);
            let length = PIECE_BYTES.min(PAGE_BYTES as usize - start);
            match self.receive(&mut header, piece, length) {
                Ok(()) => {}
                Err(error) if is_impatient(&error) => return Ok(false),
                Err(error) => return Err(error),
            }
            match (Header::parse(&header), self.shared.awaited(u32::try_from(index).unwrap_or(u32::MAX))) {
                (Some(got), Some(awaited)) if got == awaited => index += 1,
                // Of an earlier request: the right one will take its place.
                (Some(got), Some(awaited)) if got.request != awaited.request => {}
                _ => return Ok(false),
            }
        }
        Ok(true)
    }

    /// Receives one datagram: its header to `header`, the rest to `piece`.
    fn receive(&self, header: &mut [u8; HEADER_BYTES], piece: *mut u8, length: usize) -> io::Result<()> {
        let places = [
            libc::iovec { iov_base: header.as_mut_ptr().cast(), iov_len: HEADER_BYTES },
            libc::iovec { iov_base: piece.cast(), iov_len: length },
        ];
        // SAFETY: both places are writable for their lengths: `header` is borrowed for it, and the piece lies in a
        // page that this thread has mapped and that the reader waits for.
        let received = unsafe { libc::readv(self.shared.socket.as_raw_fd(), places.as_ptr(), 2) };
        if received < 0 { Err(io::Error::last_os_error()) } else { Ok(()) }
    }
}

fn is_impatient(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted)
}
