//! The owner's side of the rings: answers requests with pages out of its memory file.

use std::io;
use std::os::fd::{AsFd, AsRawFd};
use std::sync::Arc;

use dsm_core::home::{Answer, Home};
use dsm_core::time::Instant;
use dsm_core::wire::{HEADER_BYTES, Message};

use crate::bell::Bell;
use crate::channel::ServerEnd;
use crate::direct::{self, PageFile};
use crate::inbox::{ChannelId, Inbox, Layout, at};
use crate::mapping::Mapping;
use crate::port::wait_for;

/// Serves the pages of one owner to every channel of its inbox. One thread drives it.
#[derive(Debug)]
pub struct Server {
    home: Home,
    pages: Arc<PageFile>,
    channels: Vec<ServerEnd>,
    /// The first page of the inbox, where this server's bell is.
    front: Mapping,
    spin_us: u64,
}

impl Server {
    /// A server of the pages in `pages`, which `home` numbers.
    ///
    /// # Errors
    /// The inbox cannot be mapped.
    pub fn new(
        home: Home,
        pages: Arc<PageFile>,
        inbox: &Inbox,
        layout: Layout,
        spin_us: u64,
    ) -> io::Result<Self> {
        let channels = (0..layout.channel_count())
            .map(|channel| ServerEnd::open(inbox.as_fd(), layout, ChannelId(channel)))
            .collect::<io::Result<_>>()?;
        Ok(Self { home, pages, channels, front: Mapping::new(inbox.as_fd(), 0, at::UNIT)?, spin_us })
    }

    /// Answers what has been asked; waits until `deadline` for the first request. Returns how many it answered.
    pub fn serve(&mut self, deadline: Instant) -> usize {
        let bell: &Bell = self.front.shared(0);
        let is_ready = || self.channels.iter().any(ServerEnd::has_request);
        wait_for(deadline, self.spin_us, is_ready, |timeout_us| bell.wait(timeout_us, is_ready));
        let Self { home, pages, channels, .. } = self;
        // One request of each channel in turn: nobody is kept waiting by a peer that asks without end.
        channels.iter_mut().map(|channel| usize::from(answer_one(home, pages, channel))).sum()
    }

    /// What the home has counted.
    #[must_use]
    pub const fn home(&self) -> &Home {
        &self.home
    }
}

/// Answers one request of `channel`, if it has one that deserves an answer.
///
/// Where the client has left no room for the answer it gets none; it will ask again.
fn answer_one(home: &mut Home, pages: &PageFile, channel: &mut ServerEnd) -> bool {
    let Some(request) = channel.request() else { return false };
    let Ok(answer) = home.handle_message(&request) else { return false };
    let answered = channel.answer(|place, page_bytes| match answer {
        Answer::Refuse { message } => emit(&message),
        Answer::Grant { message, held_index } => {
            let read = read_page(pages, held_index, &message, place, page_bytes);
            emit(&if read { message } else { home.handle_unreadable(&message) })
        }
    });
    answered.is_ok()
}

/// Reads what was granted of a page into a place of the ring, with the kernel as the copier.
fn read_page(
    pages: &PageFile,
    held_index: u32,
    granted: &Message,
    place: *mut u8,
    page_bytes: usize,
) -> bool {
    let (start, length) = direct::granted(granted);
    let Ok(offset) = i64::try_from(u64::from(held_index) * page_bytes as u64 + start) else { return false };
    let length = length.min(page_bytes);
    // SAFETY: `pread` writes at most `length` bytes from `place` on.
    // - In bounds: the place is `page_bytes` long, checked against the mapping by `ServerEnd::answer`.
    // - The place is the server's until it is published. No reference to its bytes is formed.
    let read = unsafe { libc::pread(pages.as_fd().as_raw_fd(), place.cast(), length, offset) };
    usize::try_from(read) == Ok(length)
}

fn emit(message: &Message) -> [u8; HEADER_BYTES] {
    let mut header = [0; HEADER_BYTES];
    message.emit(&mut header);
    header
}
