//! What simulated nodes send each other, and what they set themselves to do later.

use core::fmt;

use dsm_core::id::{PageId, SlotId};
use dsm_core::wire::{HEADER_BYTES, Message};

use crate::time::Moment;

/// A message of the paging protocol, as it travels in a simulation.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
pub struct Packet {
    /// Its header, byte for byte.
    pub header: [u8; HEADER_BYTES],
    /// Stands for the bytes of the page behind a grant's header.
    pub contents: u64,
}

/// What a node sets itself to do later.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Task {
    /// A thread touches its next page.
    Touch {
        /// The thread.
        thread: u8,
    },
    /// A thread that touched an absent page tells the state machine.
    Fault {
        /// The thread.
        thread: u8,
    },
    /// A thread that waited asks again.
    Again {
        /// The thread.
        thread: u8,
        /// Its wait; it may have ended otherwise.
        wait: u32,
    },
    /// The bytes of a page have been put into its slot.
    Filled {
        /// The page.
        page: PageId,
        /// Its slot.
        slot: SlotId,
        /// What stands for its bytes.
        contents: u64,
    },
    /// A victim has been taken away from its readers.
    Unmapped {
        /// The victim.
        page: PageId,
        /// The slot it lay in.
        slot: SlotId,
    },
    /// The page is out of its readers' sight and kept.
    Covered {
        /// The page.
        page: PageId,
        /// Its slot.
        slot: SlotId,
    },
    /// Requests have to be looked after.
    Timer {
        /// When this was thought to be. Another time may have been set since.
        at: Moment,
    },
    /// The owner's part has got to this request.
    Serve {
        /// The request.
        packet: Packet,
    },
}

/// As the message that it is.
impl fmt::Debug for Packet {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match Message::parse(&self.header) {
            Ok(Message { page, request, body, .. }) => write!(f, "{body:?} of {page}, request {request}"),
            Err(error) => write!(f, "{error}"),
        }
    }
}
