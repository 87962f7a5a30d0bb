//! The memory file in which an owner receives requests and gives answers.

use core::fmt;
use std::io;
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};

use dsm_core::wire::HEADER_BYTES;
use rustix::fs::{MemfdFlags, SealFlags, fcntl_add_seals, ftruncate, memfd_create};

use crate::bell::Bell;
use crate::ring::Indices;

/// The memory file of one owner's rings. Vanishes with the last process that holds it open.
#[derive(Debug)]
pub struct Inbox {
    file: OwnedFd,
}

/// Where things lie in an inbox. All sides compute it from the same two numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Layout {
    page_bytes: u32,
    channel_count: u16,
}

/// Names one channel of an inbox: one thread of one peer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ChannelId(pub u16);

/// Why no layout came of these numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum LayoutError {
    /// A page must be a power of two of at least 4096 bytes.
    PageBytes(u32),
    /// Somebody must be able to ask.
    NoChannels,
}

/// Requests that a channel can hold.
pub(crate) const REQUEST_PLACES: u32 = 8;

/// Answers, each with a page, that a channel can hold: as many as a thread asks for at a time.
pub(crate) const ANSWER_PLACES: u32 = 4;

/// Where things lie in a channel, in bytes from its start.
pub(crate) mod at {
    use super::{ANSWER_PLACES, Bell, HEADER_BYTES, Indices, REQUEST_PLACES};

    pub(crate) const REQUEST_RING: usize = 0;
    pub(crate) const ANSWER_RING: usize = REQUEST_RING + size_of::<Indices>();
    pub(crate) const CLIENT_BELL: usize = ANSWER_RING + size_of::<Indices>();
    pub(crate) const REQUEST_HEADERS: usize = CLIENT_BELL + size_of::<Bell>();
    pub(crate) const ANSWER_HEADERS: usize = REQUEST_HEADERS + REQUEST_PLACES as usize * HEADER_BYTES;
    pub(crate) const END: usize = ANSWER_HEADERS + ANSWER_PLACES as usize * HEADER_BYTES;
    pub(crate) const PAGES: usize = UNIT;

    /// Everything that is mapped by itself starts at a multiple of this.
    pub(crate) const UNIT: usize = 4096;

    const _: () = assert!(END <= PAGES);
}

impl Layout {
    /// The layout of an inbox with `channel_count` channels for pages of `page_bytes`.
    ///
    /// # Errors
    /// See [`LayoutError`].
    pub const fn new(page_bytes: u32, channel_count: u16) -> Result<Self, LayoutError> {
        if !page_bytes.is_power_of_two() || (page_bytes as usize) < at::UNIT {
            return Err(LayoutError::PageBytes(page_bytes));
        }
        if channel_count == 0 {
            return Err(LayoutError::NoChannels);
        }
        Ok(Self { page_bytes, channel_count })
    }

    /// Length of a page in bytes.
    #[must_use]
    pub const fn page_bytes(&self) -> usize {
        self.page_bytes as usize
    }

    /// Channels there are.
    #[must_use]
    pub const fn channel_count(&self) -> u16 {
        self.channel_count
    }

    /// Length of the whole file in bytes.
    #[must_use]
    pub const fn bytes(&self) -> usize {
        at::UNIT + self.channel_count as usize * self.channel_bytes()
    }

    pub(crate) const fn channel_bytes(&self) -> usize {
        at::PAGES + ANSWER_PLACES as usize * self.page_bytes()
    }

    /// Where `channel` starts in the file, or `None` when there is no such channel.
    pub(crate) fn channel_start(&self, channel: ChannelId) -> Option<usize> {
        (channel.0 < self.channel_count).then(|| at::UNIT + usize::from(channel.0) * self.channel_bytes())
    }
}

impl Inbox {
    /// A fresh inbox: every ring empty, nobody asleep.
    ///
    /// # Errors
    /// The system gave no memory file of that length.
    pub fn create(layout: Layout) -> io::Result<Self> {
        let file = memfd_create("memsavvy-inbox", MemfdFlags::CLOEXEC | MemfdFlags::ALLOW_SEALING)?;
        ftruncate(&file, layout.bytes() as u64)?;
        // Nobody can cut it short under a peer that has it mapped.
        fcntl_add_seals(&file, SealFlags::SHRINK | SealFlags::GROW | SealFlags::SEAL)?;
        Ok(Self { file })
    }

    /// An inbox that another process created.
    ///
    /// # Errors
    /// The file is shorter than the layout asks for, or may still be cut short.
    pub fn open(file: OwnedFd, layout: Layout) -> io::Result<Self> {
        let length = rustix::fs::fstat(&file)?.st_size;
        let sealed = rustix::fs::fcntl_get_seals(&file)?.contains(SealFlags::SHRINK);
        if u64::try_from(length).is_ok_and(|length| length >= layout.bytes() as u64) && sealed {
            return Ok(Self { file });
        }
        Err(io::Error::new(
            io::ErrorKind::InvalidData,
            format!(
                "an inbox of {length} bytes, sealed: {sealed}, where {} sealed bytes are needed",
                layout.bytes()
            ),
        ))
    }
}

impl From<Inbox> for OwnedFd {
    fn from(inbox: Inbox) -> Self {
        inbox.file
    }
}

impl AsFd for Inbox {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.file.as_fd()
    }
}

impl fmt::Display for LayoutError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::PageBytes(got) => {
                write!(f, "a page of {got} bytes is no power of two of at least {}", at::UNIT)
            }
            Self::NoChannels => write!(f, "an inbox without channels"),
        }
    }
}

impl core::error::Error for LayoutError {}
