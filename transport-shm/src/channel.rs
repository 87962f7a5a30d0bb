//! One thread's channel to one owner, seen from either end.

use core::ptr;
use std::io;
use std::os::fd::BorrowedFd;

use dsm_core::transport::Body;
use dsm_core::wire::HEADER_BYTES;

use crate::bell::Bell;
use crate::inbox::{ANSWER_PLACES, ChannelId, Layout, REQUEST_PLACES, at};
use crate::mapping::Mapping;
use crate::ring::{Consumer, Indices, Producer};

/// The shared memory of a channel. Neither end's own indices are in here.
#[derive(Debug)]
struct Memory {
    mapping: Mapping,
    page_bytes: usize,
}

/// The end of the thread that asks.
#[derive(Debug)]
pub(crate) struct ClientEnd {
    memory: Memory,
    requests: Producer,
    answers: Consumer,
    /// The answer last returned is still being copied out of its place.
    holds_answer: bool,
}

/// The end of the owner that answers.
#[derive(Debug)]
pub(crate) struct ServerEnd {
    memory: Memory,
    requests: Consumer,
    answers: Producer,
}

/// The ring has no free place.
#[derive(Debug)]
pub(crate) struct Full;

impl Memory {
    fn map(inbox: BorrowedFd<'_>, layout: Layout, channel: ChannelId) -> io::Result<Self> {
        let start = layout.channel_start(channel).ok_or(io::ErrorKind::NotFound)?;
        let mapping = Mapping::new(inbox, start as u64, layout.channel_bytes())?;
        Ok(Self { mapping, page_bytes: layout.page_bytes() })
    }

    fn request_ring(&self) -> &Indices {
        self.mapping.shared(at::REQUEST_RING)
    }

    fn answer_ring(&self) -> &Indices {
        self.mapping.shared(at::ANSWER_RING)
    }

    fn client_bell(&self) -> &Bell {
        self.mapping.shared(at::CLIENT_BELL)
    }

    fn request_header(&self, place: u32) -> *mut u8 {
        self.mapping.pointer(at::REQUEST_HEADERS + place as usize * HEADER_BYTES, HEADER_BYTES)
    }

    fn answer_header(&self, place: u32) -> *mut u8 {
        self.mapping.pointer(at::ANSWER_HEADERS + place as usize * HEADER_BYTES, HEADER_BYTES)
    }

    fn page(&self, place: u32) -> *mut u8 {
        self.mapping.pointer(at::PAGES + place as usize * self.page_bytes, self.page_bytes)
    }
}

impl ClientEnd {
    pub(crate) fn open(inbox: BorrowedFd<'_>, layout: Layout, channel: ChannelId) -> io::Result<Self> {
        Ok(Self {
            memory: Memory::map(inbox, layout, channel)?,
            requests: Producer::new(REQUEST_PLACES),
            answers: Consumer::new(ANSWER_PLACES),
            holds_answer: false,
        })
    }

    /// Puts a request into the ring. The server still has to be woken.
    pub(crate) fn ask(&mut self, header: &[u8; HEADER_BYTES]) -> Result<(), Full> {
        let place = self.requests.free_place(self.memory.request_ring()).ok_or(Full)?;
        write_header(self.memory.request_header(place), header);
        self.requests.publish(self.memory.request_ring());
        Ok(())
    }

    /// Takes the next answer, which stays in place until the next call of this or [`release`](Self::release).
    pub(crate) fn answer(&mut self) -> Option<([u8; HEADER_BYTES], Body<'_>)> {
        self.release();
        let place = self.answers.full_place(self.memory.answer_ring())?;
        self.holds_answer = true;
        let header = read_header(self.memory.answer_header(place));
        Some((header, Body::shared(self.memory.page(place), self.memory.page_bytes)))
    }

    /// Gives the answer last returned back to the server.
    pub(crate) fn release(&mut self) {
        if core::mem::take(&mut self.holds_answer) {
            self.answers.release(self.memory.answer_ring());
        }
    }

    pub(crate) fn has_answer(&self) -> bool {
        self.answers.full_place(self.memory.answer_ring()).is_some()
    }

    /// Sleeps until the server has answered, at most `timeout_us`.
    pub(crate) fn sleep(&self, timeout_us: u64) {
        self.memory.client_bell().wait(timeout_us, || self.has_answer());
    }
}

impl ServerEnd {
    pub(crate) fn open(inbox: BorrowedFd<'_>, layout: Layout, channel: ChannelId) -> io::Result<Self> {
        Ok(Self {
            memory: Memory::map(inbox, layout, channel)?,
            requests: Consumer::new(REQUEST_PLACES),
            answers: Producer::new(ANSWER_PLACES),
        })
    }

    pub(crate) fn has_request(&self) -> bool {
        self.requests.full_place(self.memory.request_ring()).is_some()
    }

    /// Takes the next request out of the ring.
    pub(crate) fn request(&mut self) -> Option<[u8; HEADER_BYTES]> {
        let place = self.requests.full_place(self.memory.request_ring())?;
        let header = read_header(self.memory.request_header(place));
        self.requests.release(self.memory.request_ring());
        Some(header)
    }

    /// Puts an answer into the ring, with the page that `fill` writes to the place it is given, and wakes the client.
    ///
    /// `fill` returns the header to send: what it meant to say, or a refusal when it could not write the page.
    pub(crate) fn answer(
        &mut self,
        fill: impl FnOnce(*mut u8, usize) -> [u8; HEADER_BYTES],
    ) -> Result<(), Full> {
        let place = self.answers.free_place(self.memory.answer_ring()).ok_or(Full)?;
        let header = fill(self.memory.page(place), self.memory.page_bytes);
        write_header(self.memory.answer_header(place), &header);
        self.answers.publish(self.memory.answer_ring());
        self.memory.client_bell().ring();
        Ok(())
    }
}

fn read_header(place: *const u8) -> [u8; HEADER_BYTES] {
    let mut header = [0; HEADER_BYTES];
    // SAFETY: the copy stays inside the mapping and inside `header`.
    // - In bounds: `Memory::request_header` and `answer_header` checked the place against the mapping.
    // - The place is the consumer's until it is released. A process that writes it all the same gives us other
    //   bytes; they are copied here once, and checked only afterwards.
    // - No reference to shared bytes is formed: another process maps them too.
    unsafe { ptr::copy_nonoverlapping(place, header.as_mut_ptr(), HEADER_BYTES) };
    header
}

fn write_header(place: *mut u8, header: &[u8; HEADER_BYTES]) {
    // SAFETY: the copy stays inside the mapping.
    // - In bounds: as for `read_header`.
    // - The place is the producer's until it is published.
    // - No reference to shared bytes is formed.
    unsafe { ptr::copy_nonoverlapping(header.as_ptr(), place, HEADER_BYTES) };
}
