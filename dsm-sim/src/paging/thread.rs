//! A render thread: it thinks, touches a page, and waits if that is not there.

use dsm_core::id::PageId;
use dsm_core::time::Instant;

use crate::chance::Chance;
use crate::time::Moment;

/// A thread of a rendering node.
#[derive(Clone, Debug)]
pub(super) struct Thread {
    pub(super) doing: Doing,
    /// The page it touches or touched last.
    pub(super) page: PageId,
    /// When it touched it.
    pub(super) touched: Moment,
    /// When the state machine was told, on the node's clock.
    pub(super) since: Instant,
    /// Counts its waits, so that a call that comes late is not taken for the one it waits for.
    pub(super) wait: u32,
    /// Touches so far.
    pub(super) touches: u32,
    pub(super) chance: Chance,
}

/// What a thread is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Doing {
    /// Something that needs no page.
    Thinking,
    /// It touched an absent page, and the state machine does not know yet.
    Trapped,
    /// It is the one that fetches the page.
    Fetching,
    /// Another fetches the page, or it is on its way out.
    WaitingForPage,
    /// It takes victims away to get a slot.
    Evicting,
    /// Another does, or all slots are on their way in.
    WaitingForSlot,
    /// It has been called and is about to ask again.
    Called,
    /// It has touched all it was to.
    Done,
}

impl Thread {
    pub(super) const fn new(chance: Chance) -> Self {
        Self {
            doing: Doing::Thinking,
            page: PageId(0),
            touched: Moment::ZERO,
            since: Instant::ZERO,
            wait: 0,
            touches: 0,
            chance,
        }
    }

    pub(super) const fn is_done(&self) -> bool {
        matches!(self.doing, Doing::Done)
    }

    /// Whether it waits for something that must come.
    pub(super) const fn is_waiting(&self) -> bool {
        !matches!(self.doing, Doing::Thinking | Doing::Done)
    }
}
