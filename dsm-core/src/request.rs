//! What a node has asked for and not yet been answered.

use heapless::Vec;

use crate::id::{NodeId, PageId, PortId};
use crate::time::Instant;

/// Requests that a node can have under way at once.
pub const REQUESTS_MAX: usize = 256;

/// A page asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Request {
    pub(crate) page: PageId,
    pub(crate) home: NodeId,
    pub(crate) port: PortId,
    /// Returned with the answer; the same for every sending of this request.
    pub(crate) number: u32,
    /// When it is sent again unless an answer came.
    pub(crate) resend_at: Instant,
    /// The time to the sending after that; doubles each time.
    pub(crate) interval_us: u64,
    /// When it is given up.
    pub(crate) deadline: Instant,
}

/// The requests under way, one for each page in state `Requested`.
#[derive(Debug, Default)]
pub(crate) struct Requests {
    pending: Vec<Request, REQUESTS_MAX>,
}

/// What is due at a moment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Due {
    /// Send it again. It has been moved on to its next sending.
    Resend(Request),
    /// Give it up. It has been removed.
    Expired(Request),
}

impl Requests {
    /// Adds a request. The caller has made sure that there is room.
    pub(crate) fn push(&mut self, request: Request) {
        let pushed = self.pending.push(request);
        debug_assert!(pushed.is_ok(), "a fault is let through only when a request is free");
    }

    /// Takes out the request for `page` when it has this number.
    pub(crate) fn take(&mut self, page: PageId, number: u32) -> Option<Request> {
        let index = self.pending.iter().position(|request| request.page == page)?;
        (self.pending[index].number == number).then(|| self.pending.swap_remove(index))
    }

    /// The next thing due on `port` at `now`, if any.
    pub(crate) fn next_due(&mut self, now: Instant, port: PortId) -> Option<Due> {
        let due = |request: &Request| request.port == port && request.next_event() <= now;
        let index = self.pending.iter().position(due)?;
        let request = &mut self.pending[index];
        if request.deadline <= now {
            return Some(Due::Expired(self.pending.swap_remove(index)));
        }
        request.interval_us = request.interval_us.saturating_mul(2);
        request.resend_at = now.after(request.interval_us);
        Some(Due::Resend(*request))
    }

    pub(crate) fn is_full(&self) -> bool {
        self.pending.is_full()
    }

    pub(crate) fn iter(&self) -> impl Iterator<Item = &Request> {
        self.pending.iter()
    }

    /// When something will next be due, on `port` or, with `None`, on any.
    pub(crate) fn next_event(&self, port: Option<PortId>) -> Option<Instant> {
        let asked = |request: &&Request| port.is_none_or(|port| request.port == port);
        self.iter().filter(asked).map(Request::next_event).min()
    }
}

impl Request {
    fn next_event(&self) -> Instant {
        self.resend_at.min(self.deadline)
    }
}
