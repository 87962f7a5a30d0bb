//! A message under way.

use dsm_core::id::{NodeId, PageId};
use dsm_core::wire::{Body, HEADER_BYTES, Message};

/// A message under way.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Packet {
    pub(crate) header: [u8; HEADER_BYTES],
    /// The page whose bytes follow; `None` for no bytes, or for bytes that nobody vouches for.
    pub(crate) page: Option<u32>,
}

impl Packet {
    /// Asserts that the bytes are this page's.
    pub(crate) fn assert_is_of(&self, page: PageId) {
        assert!(
            self.page.is_none_or(|carried| carried == page.0),
            "RIGHT_BYTES: bytes of page {:?} are taken for {page}",
            self.page
        );
    }

    /// What its header says.
    pub(crate) fn message(&self) -> Option<Message> {
        Message::parse(&self.header).ok()
    }
}

/// Who asked, and who is asked, in a request or its answer.
pub(crate) fn asker_and_owner(message: &Message) -> (NodeId, NodeId) {
    match message.body {
        Body::Request { .. } => (message.from, message.to),
        Body::Grant { .. } | Body::Refusal(_) => (message.to, message.from),
    }
}
